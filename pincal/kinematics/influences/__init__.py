"""What terms depend on beside readings: columns of rows, and loads of joints and links."""
