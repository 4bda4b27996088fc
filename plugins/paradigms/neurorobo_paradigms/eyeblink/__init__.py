"""Delay conditioning of the eyelid: a tone, an air puff at its end, and an eyelid that learns to be closed by then."""
