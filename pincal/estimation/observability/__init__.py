"""What measurements determine, and what residuals show: rank, gauge, leverage, score tests."""
