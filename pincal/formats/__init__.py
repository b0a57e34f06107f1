"""Files of neighbours: firmware of printers and other calibration tools, read and written."""
