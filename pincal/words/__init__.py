"""Wording of output: sentences for findings, numbers with their ±, and tables."""
