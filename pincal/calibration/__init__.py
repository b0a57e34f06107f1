"""From measurements to parameters with uncertainties, and what to make of them."""
