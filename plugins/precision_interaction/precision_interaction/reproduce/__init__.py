"""The paper's experiments, measured again: one row for each figure or table, in a report."""
