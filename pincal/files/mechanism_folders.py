"""A mechanism folder: ``mechanism.yaml``, one URDF per leg, ``platform.urdf``."""

from __future__ import annotations

import logging
import os
from difflib import get_close_matches
from functools import lru_cache
from pathlib import Path
from typing import Protocol

from pincal.errors import FileError, MechanismError, located
from pincal.files.mechanism_yaml import YAML, mechanism_yaml, read_mechanism
from pincal.files.output import writing
from pincal.files.urdf import leg_urdf, platform_urdf
from pincal.model import Mechanism
from pincal.model.checks import must_be

_log = logging.getLogger(__name__)
MECHANISM_FILES = (YAML, "*.urdf")
"""Files of a mechanism folder that are replaced together; the first identifies such a folder."""


def bundled() -> dict[str, Path]:
    """Return the folders of the mechanisms that come with pincal, by name."""
    package = Path(__file__).resolve().parents[1]
    for robots in (package / "robots", package.parent / "robots"):
        if robots.is_dir():
            return {p.parent.name: p.parent for p in sorted(robots.glob("*/mechanism.yaml"))}
    return {}


def load_mechanism(name_or_path: str | Path) -> Mechanism:
    """Return a mechanism by ``name_or_path``: a bundled name, ``"3RRR"``, its or a result's folder.

    Raises:
        FileError: there is no such folder, or a file in it is missing.
        MechanismError: a file has wrong contents; the message names the place.
    """
    folder = _folder(name_or_path)
    return _read_once(folder) if folder in bundled().values() else _read(folder)


def _read(folder: Path) -> Mechanism:
    with located(folder / YAML, MechanismError, within=folder):
        return read_mechanism(folder)


_read_once = lru_cache(maxsize=64)(_read)


def mechanism_files(name_or_path: str | Path) -> list[Path]:
    """Return the files of a mechanism's folder: ``mechanism.yaml`` and the URDFs."""
    folder = _folder(name_or_path)
    return [path for pattern in MECHANISM_FILES for path in sorted(folder.glob(pattern))]


def _folder(name_or_path: str | Path) -> Path:
    """Return the folder of a mechanism by its name or path; in a result, the one inside."""
    expected = "a mechanism's name or folder"
    folder = Path(must_be(name_or_path, (str, Path), expected, MechanismError))
    name, folders = str(name_or_path), bundled()
    if not is_folder(folder):
        if name in folders:
            return folders[name]
        if folder.suffix.lower() in (".urdf", ".xml", ".cfg", ".g", ".yaml"):
            raise FileError(
                f"{name}: a mechanism is a folder; give the folder of mechanism.yaml, or import a "
                f"robot's file first (pincal import {name} -o MECH; an arm: --tip LINK)"
            )
        known = {mechanism.lower(): mechanism for mechanism in folders}
        nearest = get_close_matches(name.lower(), known, 1)
        question = f"; did you mean {known[nearest[0]]!r}?" if nearest else ""
        raise FileError(
            f"no mechanism {name!r}: neither a folder nor one of the bundled "
            f"ones ({', '.join(folders) or 'none found'}){question}"
        )
    if name in folders and not folder.samefile(folders[name]):
        _log.info("%s: the folder here, not the bundled mechanism of that name", name)
    result = (folder / "result.json").is_file()
    if result and (folder / "mechanism").is_dir():
        return folder / "mechanism"  # a result of 'pincal calibrate'
    if not os.path.lexists(folder / YAML):
        kind = "a result whose fit did not converge" if result else "no mechanism folder"
        raise FileError(f"{name!r} is {kind}: it has no {'mechanism' if result else YAML}")
    return folder


def is_folder(path: Path) -> bool:
    """Return whether a path is a folder; False for names that no file can have."""
    try:
        return path.is_dir()
    except (OSError, ValueError):
        return False


def write_mechanism(mechanism: Mechanism, folder: Path) -> None:
    """Write a mechanism's files into a folder that exists."""
    (folder / YAML).write_text(mechanism_yaml(mechanism), encoding="utf-8")
    for leg in mechanism.legs:
        (folder / f"{leg.name}.urdf").write_text(leg_urdf(leg), encoding="utf-8")
    platform = platform_urdf(mechanism.name, mechanism.legs)
    (folder / "platform.urdf").write_text(platform, encoding="utf-8")


def save_mechanism(mechanism: Mechanism, folder: str | Path, *, force: bool = False) -> Path:
    """Write a mechanism to a new folder, whole or not at all: see ``Mechanism.save``."""
    with writing(folder, force=force, folder=MECHANISM_FILES) as scratch:
        write_mechanism(mechanism, scratch)
    return Path(folder)


class Calibrated(Protocol):
    """An object with a calibrated mechanism, such as a ``CalibrationResult``."""

    @property
    def identified(self) -> Mechanism:
        """The calibrated mechanism."""

    @property
    def converged(self) -> bool:
        """Whether the fit converged, so that there is a calibrated mechanism."""


GivenMechanism = Mechanism | str | Path | Calibrated
"""A mechanism, its bundled name, its folder, or a calibration's result."""


def as_mechanism(source: GivenMechanism) -> Mechanism:
    """Return a mechanism given as such, or by its bundled name, its folder, or a calibration."""
    if isinstance(source, Mechanism):
        return source
    if isinstance(identified := getattr(source, "identified", None), Mechanism):
        if not getattr(source, "converged", False):
            raise MechanismError("the calibration did not converge: it has no calibrated mechanism")
        return identified
    expected = "a mechanism, its name or folder, or a result"
    return load_mechanism(must_be(source, (Mechanism, str, Path), expected, MechanismError))
