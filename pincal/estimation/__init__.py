"""From conditions to estimates: rows, search, noise, observability, gauge."""
