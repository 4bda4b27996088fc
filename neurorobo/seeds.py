"""What may be a seed, and of what."""

LARGEST_SEED = 2**63 - 1
"""Seeds are whole numbers from 0 to this one, which every generator and every table can hold."""

TRAINING_SEEDS = (1_000_000, 2**31)
"""The seeds of the episodes that regions learn from, first and end: none of those with which people count."""
