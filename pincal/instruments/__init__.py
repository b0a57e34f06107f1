"""Instruments that need more than a column: cameras, their lenses, boards, what photos show."""
