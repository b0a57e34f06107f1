"""The studies by name."""

from __future__ import annotations

from collections.abc import Callable

import pincal

from . import errors, five_bar, hexapod, three_rrr
from .study import Study

#: Title, paper and content of each study.
STUDIES: dict[str, tuple[str, str, Callable[[Study], None]]] = {
    "5R": (
        "Five-bar (5R): divide and conquer",
        "Kinematic identification of parallel mechanisms by a divide and conquer strategy",
        five_bar.run,
    ),
    "3RRR": (
        "3-RRR: symmetrical observability",
        "Symmetrical observability of kinematic parameters in symmetrical-parallel mechanisms",
        three_rrr.run,
    ),
    "6UPS": (
        "Hexapod (6-UPS): symmetrical workspace, calibrated",
        "Symmetrical workspace of 6-UPS parallel robot using tilt and torsion angles",
        hexapod.run,
    ),
    "errors": (
        "Errors beyond geometry: named, modelled, kept if they pay",
        "",
        errors.run,
    ),
}


def run_study(
    name: str,
    seed: int = 0,
    quick: bool = False,
    progress: Callable[[str], None] = lambda _: None,
) -> Study:
    """Return a study.

    Args:
        name: ``5R``, ``3RRR``, ``6UPS`` or ``errors``, in any case.
        seed: Of all random choices.
        quick: Fewer draws and coarser grids.
        progress: Called with what is being done.

    Raises:
        MechanismError: there is no study of that name.
    """
    known = {study.lower(): study for study in STUDIES}
    if name.lower() not in known:
        raise pincal.MechanismError(f"no study of {name!r}; expected {', '.join(STUDIES)}")
    name = known[name.lower()]
    title, paper, content = STUDIES[name]
    study = Study(name, title, paper, seed, quick, progress)
    content(study)
    return study
