"""What the exit code of a command says to a script; 0 is success."""

BAD_INPUT = 2
"""A fault of the user's, with a message on the error stream."""

EPISODE_FAILED = 3
"""The run went through, but an episode did not succeed."""

INTERRUPTED = 130
"""Stopped with Ctrl-C."""
