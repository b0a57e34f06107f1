"""What contradicts a calibration: held-out rows, drift, runs, ties."""
