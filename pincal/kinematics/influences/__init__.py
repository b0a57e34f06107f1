"""What terms of sensors depend on beside readings: columns of rows, and loads of joints."""
