"""Trees of links whose loops are closed: URDF with YAML, and MJCF, read and written."""
