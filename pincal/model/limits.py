"""How large a number may be: larger ones are slips, and their squares overflow."""

LARGEST = 1e12
"""Size of a mechanism's numbers, [m] or [rad], beyond which its squares mean nothing."""
