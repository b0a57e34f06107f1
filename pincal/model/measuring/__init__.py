"""What was measured: rows, targets and frames, instruments, and how well they measure."""
