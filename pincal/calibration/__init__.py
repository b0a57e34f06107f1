"""Calibration of a mechanism: checks before the fit, hypotheses about what may be wrong."""
