"""Terms for errors that geometry does not explain: screened, chosen, and kept if they pay."""
