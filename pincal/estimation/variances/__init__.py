"""How large noise and deviations are: given, from residuals, or by evidence."""
