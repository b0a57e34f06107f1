"""What may be wrong with measurements: hypotheses, and the one rule that ranks them."""
