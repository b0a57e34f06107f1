"""What residuals say: losses, outliers, and tests for what the model lacks."""
