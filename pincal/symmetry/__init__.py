"""Dihedral symmetry: elements and their action, generated mechanisms, detected groups."""
