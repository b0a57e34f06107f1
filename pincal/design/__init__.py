"""Choice of poses to measure, and forecasts of the accuracy that they give."""
