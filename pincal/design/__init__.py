"""Which poses to measure, and what they will give."""
