"""The studies by name."""

from __future__ import annotations

from collections.abc import Callable

import pincal

from . import five_bar, hexapod, three_rrr
from .study import Study

STUDIES: dict[str, Callable[[int, bool, Callable[[str], None]], Study]] = {
    "5R": five_bar.run,
    "3RRR": three_rrr.run,
    "6UPS": hexapod.run,
}


def named(name: str) -> list[str]:
    """Return the names of the studies that are asked for, whatever their case.

    Raises:
        MechanismError: there is no study of that name.
    """
    found = [one for one in STUDIES if name == "all" or one.lower() == name.lower()]
    if not found:
        raise pincal.MechanismError(f"no study of {name!r}; expected {', '.join(STUDIES)} or all")
    return found


def run_study(
    name: str,
    seed: int = 0,
    quick: bool = False,
    progress: Callable[[str], None] = lambda _: None,
) -> Study:
    """Return a study.

    Args:
        name: ``5R``, ``3RRR`` or ``6UPS``.
        seed: Of all random choices.
        quick: Fewer draws and coarser grids.
        progress: Called with what is being done.

    Raises:
        MechanismError: there is no study of that name.
    """
    (name,) = named(name)
    study = STUDIES[name](seed, quick, progress)
    study.command += f" --seed {seed}" * bool(seed) + " --quick" * quick + " -o FOLDER"
    return study
