"""The simulated rig, its contact laws, and the task of inserting."""
