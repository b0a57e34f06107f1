"""What a controller lacks that knows the exported geometry alone: tables and code."""
