"""What may be a seed."""

LARGEST_SEED = 2**63 - 1
"""Seeds are whole numbers from 0 to this one, which every generator and every table can hold."""
