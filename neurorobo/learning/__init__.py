"""Learning: the phases that train regions."""
