"""A mechanism that moves, as a page in the browser."""
