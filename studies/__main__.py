"""``python -m studies 5R -o FOLDER``: a paper's figures and tables, recomputed.

FOLDER gets study.md, tables as CSV, figures as SVG and PNG. The same seed gives the same text and
tables; times are in figures only.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from pincal import FileError, PincalError

from .catalogue import STUDIES, run_study


def main(argv: Sequence[str] | None = None) -> int:
    """Write a study; return the exit code, 2 of wrong input."""
    parser = argparse.ArgumentParser(prog="python -m studies", description=__doc__)
    parser.add_argument("name", metavar="NAME", help=", ".join(STUDIES))
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="FOLDER")
    parser.add_argument("--quick", action="store_true", help="fewer draws, coarser grids")
    parser.add_argument("--seed", type=int, default=0, help="of all random choices")
    asked = parser.parse_args(argv)
    folder: Path = asked.output
    try:
        if folder.exists() or not folder.absolute().parent.is_dir():
            raise FileError(f"{folder} exists, or its parent does not; name a new folder")
        study = run_study(asked.name, asked.seed, asked.quick, lambda step: print(f"{step} …"))
        folder.mkdir()
        study.write(folder)
    except PincalError as error:
        print(f"studies: {error}", file=sys.stderr)
        return 2
    print(f"wrote {folder}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
