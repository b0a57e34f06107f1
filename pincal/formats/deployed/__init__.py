"""Kinematics that need nothing of pincal: one Python file, one C header, and their tables."""
