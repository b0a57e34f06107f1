"""What people type: the ``pincal`` command."""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy is loaded: see pincal/blas.py
if not os.environ.get("SOURCE_DATE_EPOCH", "0").isdecimal():  # NumPy and matplotlib fail on it
    del os.environ["SOURCE_DATE_EPOCH"]

import pincal.cli.commands  # noqa: F401 - registers them
from pincal.cli.app import main

__all__ = ["main"]
