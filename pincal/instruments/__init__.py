"""Instruments that need more than a column: boards, what photos show of them."""
