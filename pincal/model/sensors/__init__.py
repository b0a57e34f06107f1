"""Sensors of active joints: the law of a reading, its terms, and what weighs on the joints."""
