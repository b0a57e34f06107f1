"""Symmetry: elements and their action on mechanisms, generated mechanisms, detected groups."""
