"""Which poses to measure, how good that choice is, and what would be measured there."""
