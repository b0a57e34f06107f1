"""Firmware of delta printers: Klipper and RepRapFirmware, read and written."""
