"""The ``pincal`` command: errors raised on purpose become one message and exit code 2."""

from __future__ import annotations

import io
import os
import sys

import numpy as np

import pincal.cli.commands  # noqa: F401 - registers them
from pincal.cli.app import app, listen, remember, stderr
from pincal.errors import PincalError


def main(argv: list[str] | None = None) -> None:
    """Run the command line; leaves by ``SystemExit``: 0 done, 1 not converged, 2 wrong input.

    Args:
        argv: What was typed behind ``pincal``; that of the process if not given.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # χ and ± where the encoding lacks them
            stream.reconfigure(errors="replace")
    os.environ["MPLBACKEND"] = "agg"  # nothing is drawn on a screen
    remember(sys.argv[1:] if argv is None else argv)
    listen()
    try:
        app(args=argv, prog_name="pincal")
    except PincalError as error:
        stderr.print(f"pincal: {error}", style="bold red", markup=False, highlight=False)
        sys.exit(2)
    except OSError as error:  # of files, errors are PincalErrors
        stderr.print(f"pincal: cannot write the answer: {error.strerror}", style="bold red")
        sys.exit(2)
    except MemoryError as error:
        stderr.print(
            f"pincal: not enough memory ({error}); ask for less at once",
            style="bold red",
            markup=False,
            highlight=False,
        )
        sys.exit(2)
    except np.linalg.LinAlgError as error:
        stderr.print(
            f"pincal: numbers of sizes with which nothing can be computed ({error}): look for "
            "values in the files and options that are far too large or too small",
            style="bold red",
            markup=False,
            highlight=False,
        )
        sys.exit(2)
