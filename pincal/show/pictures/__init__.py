"""A mechanism as a flat picture, in files and on pages."""
