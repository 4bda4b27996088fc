"""What the exit code of a command says to a script; 0 is success."""

BAD_INPUT = 2
"""What the user can cure, bad input or a place that cannot be written, with a message on the error stream."""

EPISODE_FAILED = 3
"""`run` went through, but an episode did not succeed."""

INTERRUPTED = 130
"""Stopped with Ctrl-C."""
