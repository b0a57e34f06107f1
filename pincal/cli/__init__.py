"""The ``pincal`` command; modules are in the order in which help lists their commands."""

import os
import re
from importlib import import_module

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy is loaded: see pincal/blas.py
if not re.fullmatch("[0-9]{1,11}", os.environ.get("SOURCE_DATE_EPOCH", "0")):  # NumPy fails on it
    del os.environ["SOURCE_DATE_EPOCH"]
os.environ["MPLBACKEND"] = "agg"  # nothing is drawn on a screen

from pincal.cli.app import main

__all__ = ["main"]

MODULES = "mechanisms view design measure calibration many photos files"
for module in MODULES.split():
    import_module(f"{__name__}.{module}")
