"""What people type: the ``pincal`` command."""

import gc
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy is loaded: see pincal/blas.py

from pincal.collection import no_collection

__all__ = ["main"]


def main(argv: list[str] | None = None) -> None:
    """Run the command line; leaves by ``SystemExit``: 0 done, 1 not converged, 2 wrong input.

    Args:
        argv: What was typed behind ``pincal``; that of the process if not given, which then ends.
    """
    with no_collection():
        from pincal.cli.run import run

    try:
        run(argv)
    finally:
        if argv is None:
            gc.freeze()  # the process ends: no rings are looked for among all that it holds
