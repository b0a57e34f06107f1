"""What geometry does not explain: terms, screened, chosen and kept if they pay."""
