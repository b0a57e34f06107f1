"""What legs demand and what instruments measured, as values with derivatives."""
