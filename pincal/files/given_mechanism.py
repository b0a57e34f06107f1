"""A mechanism as people give it: as such, by its name or folder, or as a calibration's result."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

from pincal.errors import MechanismError
from pincal.model.checks import must_be
from pincal.model.mechanism import Mechanism


class Calibrated(Protocol):
    """What holds a calibrated mechanism, such as a ``CalibrationResult``."""

    @property
    def identified(self) -> Mechanism:
        """The calibrated mechanism."""

    @property
    def converged(self) -> bool:
        """Whether it is one."""


GivenMechanism = Mechanism | str | Path | Calibrated
"""A mechanism, its bundled name, its folder, or a calibration's result."""


def as_mechanism(given: GivenMechanism) -> Mechanism:
    """Return a mechanism that is given as such, by its bundled name, folder, or calibration.

    Raises:
        FileError: no such folder, or a file in it is missing.
        MechanismError: something else, a file that does not say what it should, or a calibration
            that did not converge.
    """
    if isinstance(given, Mechanism):
        return given
    if isinstance(found := getattr(given, "identified", None), Mechanism):
        if not getattr(given, "converged", False):
            raise MechanismError("the calibration did not converge: it has no calibrated mechanism")
        return found
    from pincal.files.mechanism_folders import load_mechanism  # reads files: slow to load

    kinds, what = (Mechanism, str, Path), "a mechanism, its name or folder, or a result"
    return load_mechanism(must_be(given, kinds, what, MechanismError))
