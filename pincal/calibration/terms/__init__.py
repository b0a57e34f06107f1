"""What geometry does not explain: terms of sensors, screened, chosen and kept if they pay."""
