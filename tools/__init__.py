"""Tools for those who work on pincal; no part of what is installed."""
