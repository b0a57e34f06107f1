"""Hypotheses on faults of measurements, and the rule that ranks them."""
