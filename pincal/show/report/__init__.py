"""A calibration as one page: to read, print and keep."""
