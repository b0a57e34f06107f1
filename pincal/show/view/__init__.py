"""A page in the browser that shows a moving mechanism."""
