"""From measurements to parameters with uncertainties."""
