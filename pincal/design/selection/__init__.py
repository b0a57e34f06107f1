"""The search for poses that say most: criteria, exchange, orbits, and bounds that certify it."""
