"""What people type: the ``pincal`` command."""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy is loaded: see pincal/blas.py

from pincal.cli.run import main

__all__ = ["main"]
