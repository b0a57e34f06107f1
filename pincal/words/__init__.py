"""How things are said: sentences of findings, numbers with their ±, and tables."""
