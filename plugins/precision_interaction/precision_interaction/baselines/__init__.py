"""What the paper compares with, and PID controllers tuned by rule and by search."""
