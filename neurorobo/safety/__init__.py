"""Safety outside the brain: limits of what sensors report, and the states of whatever moves."""
