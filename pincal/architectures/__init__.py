"""Mechanisms from the dimensions of a data sheet."""
