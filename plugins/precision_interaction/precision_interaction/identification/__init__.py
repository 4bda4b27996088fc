"""From repeated insertions on a rig to the contact model of an experiment (Eq. 1, Fig. 9-10)."""
