"""What people type: the ``pincal`` command."""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy is loaded: see pincal/blas.py

import pincal.cli.commands  # noqa: F401 - registers them
from pincal.cli.app import main

__all__ = ["main"]
