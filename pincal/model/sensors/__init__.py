"""What is not geometry: the law of a sensor, its terms, parameters that deform, what weighs."""
