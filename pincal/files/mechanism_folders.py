"""A mechanism folder: ``mechanism.yaml``, one URDF per leg, ``platform.urdf``."""

from __future__ import annotations

import logging
from dataclasses import replace
from difflib import get_close_matches
from functools import lru_cache
from pathlib import Path
from typing import Any, Protocol

from pincal.errors import FileError, MechanismError
from pincal.files.mechanism_writing import MECHANISM_FILES, YAML, write_mechanism
from pincal.files.output import writing
from pincal.files.schema import LegSpec, LoadSpec, MechanismSpec, SensorSpec, read_spec, term_of
from pincal.files.urdf import read_chain, read_points
from pincal.model.checks import must_be
from pincal.model.home import check_home
from pincal.model.leg import Joint, Leg
from pincal.model.mechanism import Mechanism
from pincal.model.placement import Coordinate, Placement
from pincal.model.platform import Platform, PlatformKind
from pincal.model.sensor import Sensor
from pincal.model.terms import Load

_log = logging.getLogger(__name__)


def bundled() -> dict[str, Path]:
    """Return the folders of the mechanisms that come with pincal, by name."""
    package = Path(__file__).resolve().parents[1]
    for robots in (package / "robots", package.parent / "robots"):
        if robots.is_dir():
            return {p.parent.name: p.parent for p in sorted(robots.glob("*/mechanism.yaml"))}
    return {}


def load_mechanism(name_or_path: str | Path) -> Mechanism:
    """Return a mechanism from a bundled name (``"3RRR"``), its folder, or a result folder.

    Args:
        name_or_path: Name of a bundled mechanism, or a folder.

    Raises:
        FileError: no such folder, or a file in it is missing.
        MechanismError: a file that does not say what it should; the message names the place.
    """
    folder = _folder(name_or_path)
    if folder not in bundled().values():
        return _read(folder)
    files = [(one.name, one.stat()) for one in sorted(folder.iterdir())]
    return _kept(folder, tuple((name, stat.st_mtime_ns, stat.st_size) for name, stat in files))


@lru_cache(maxsize=64)
def _kept(folder: Path, _: tuple[tuple[str, int, int], ...]) -> Mechanism:
    """Return a mechanism read once, as long as no file of its folder changes."""
    return _read(folder)


def _read(folder: Path) -> Mechanism:
    path = folder / YAML
    try:
        spec = read_spec(_inside(folder, YAML))
        return _mechanism(spec, folder)
    except MechanismError as error:
        raise MechanismError(
            str(error) if str(folder) in str(error) else f"{path}: {error}"
        ) from error


def mechanism_files(name_or_path: str | Path) -> list[Path]:
    """Return the files that ``load_mechanism`` reads: ``mechanism.yaml`` and the URDFs.

    Raises:
        FileError: no such folder, or ``mechanism.yaml`` is missing.
        MechanismError: it does not say what it should.
    """
    folder = _folder(name_or_path)
    spec = read_spec(_inside(folder, YAML))
    urdfs = dict.fromkeys((spec.platform.urdf, *(leg.urdf for leg in spec.legs)))
    return [folder / YAML, *(folder / name for name in urdfs)]


def _folder(name_or_path: str | Path) -> Path:
    """Return the folder of a mechanism.

    Raises:
        FileError: no such folder.
    """
    folder = Path(
        must_be(name_or_path, (str, Path), "a mechanism's name or folder", MechanismError)
    )
    if str(name_or_path) in bundled():
        if not is_folder(folder):
            folder = bundled()[str(name_or_path)]
        elif not folder.samefile(bundled()[str(name_or_path)]):
            _log.info("%s: the folder here, not the bundled mechanism of that name", name_or_path)
    name = str(name_or_path)[:200]
    if not is_folder(folder):
        alike = get_close_matches(name.lower(), known := {one.lower(): one for one in bundled()}, 1)
        question = f"; did you mean {known[alike[0]]!r}?" if alike else ""
        raise FileError(
            f"no mechanism {name!r}: neither a folder nor one of the bundled "
            f"ones ({', '.join(bundled()) or 'none found'}){question}"
        )
    if (folder / "result.json").is_file() and (folder / "mechanism").is_dir():
        return folder / "mechanism"  # a result of 'pincal calibrate'
    if not (folder / YAML).is_symlink() and not (folder / YAML).exists():
        result = (folder / "result.json").is_file()
        why = "a result whose fit did not converge" if result else "no mechanism folder"
        hides = "; it hides the bundled mechanism of that name" if name in bundled() else ""
        raise FileError(f"{name!r} is {why}: it has no {'mechanism' if result else YAML}{hides}")
    return folder


def is_folder(path: Path) -> bool:
    """Return whether a path is a folder; False for names that no file can have."""
    try:
        return path.is_dir()
    except (OSError, ValueError):
        return False


def _mechanism(spec: MechanismSpec, folder: Path) -> Mechanism:
    home = spec.platform.home
    kind = spec.platform.kind
    own = kind if isinstance(kind, str) else PlatformKind(kind.name, tuple(kind.freedoms))
    platform = Platform(own, tuple(home.values()))
    if tuple(home) != platform.coordinates:
        raise MechanismError(
            f"platform.home has {', '.join(home)}; expected {', '.join(platform.coordinates)}"
        )
    points = read_points(_inside(folder, spec.platform.urdf))
    legs = tuple(_leg(leg, folder, points) for leg in spec.legs)
    load = None if spec.load is None else _load(spec.load)
    labels = tuple(spec.labels.items())
    mechanism = Mechanism(spec.name, platform, legs, spec.description, labels, load)
    identified = (folder.parent / "result.json").is_file()  # at the nominal home
    for leg in () if identified else legs:
        check_home(leg, platform)
    return mechanism


def _load(spec: LoadSpec) -> Load:
    return Load(spec.mass, spec.centre, spec.gravity, tuple(spec.drawn.items()))


def _leg(spec: LegSpec, folder: Path, points: dict[str, Joint]) -> Leg:
    path = _inside(folder, spec.urdf)
    chain = read_chain(path, spec.tip)
    if spec.platform_point not in points:
        raise MechanismError(
            f"{spec.name}: the platform has no point {spec.platform_point!r}; its fixed frames are "
            f"{', '.join(sorted(points)) or 'none'}"
        )
    point = points[spec.platform_point]
    names = {joint.name for joint in (*chain, point)}
    for key in (*spec.placements, *spec.home, *(sensor.joint for sensor in spec.sensors)):
        if key not in names:
            raise MechanismError(
                f"{spec.name}: unknown joint {key!r}; {path.name} has "
                f"{', '.join(joint.name for joint in chain)}, the platform point is {point.name!r}"
            )
    moving = [joint.name for joint in chain if joint.kind != "fixed"]
    if set(spec.home) != set(moving):
        raise MechanismError(
            f"{spec.name}: 'home' gives {', '.join(spec.home) or 'nothing'}; it needs the home "
            f"position of each moving joint: {', '.join(moving)}"
        )

    def described(joint: Joint) -> Joint:
        coordinates = tuple(
            _coordinate(item, spec.name, joint.name) for item in spec.placements.get(joint.name, [])
        )
        placement = Placement(coordinates, joint.placement.xyz, joint.placement.rpy)
        home = spec.home.get(joint.name, 0.0)
        return replace(joint, placement=placement, home=home)

    return Leg(
        name=spec.name,
        joints=tuple(described(joint) for joint in chain),
        sensors=tuple(_sensor(sensor, spec.name) for sensor in spec.sensors),
        parameters=tuple(spec.parameters.items()),
        point=described(point),
        tip=spec.tip,
        closes=spec.closes,
        terms=tuple(
            (name, term_of(amplitude, term, f"{spec.name}, parameter {name!r}"))
            for name, own in spec.terms.items()
            for amplitude, term in own.items()
        ),
    )


def _sensor(spec: SensorSpec, leg: str) -> Sensor:
    terms = tuple(term_of(name, term, leg) for name, term in spec.terms.items())
    return Sensor(**spec.model_dump(exclude={"terms"}), terms=terms)


def _coordinate(item: dict[str, Any], leg: str, joint: str) -> Coordinate:
    if len(item) != 1:
        raise MechanismError(
            f"{leg}, placement of {joint!r}: each entry is one coordinate, such as "
            f"'- polar: [OA, beta]'; got {list(item)}"
        )
    ((kind, values),) = item.items()
    try:
        return Coordinate(kind, tuple(values) if isinstance(values, list) else (values,))
    except MechanismError as error:
        raise MechanismError(f"{leg}, placement of {joint!r}: {error}") from error


def _inside(folder: Path, name: str) -> Path:
    """Return a file of the mechanism's folder; paths that lead out of it are refused."""
    try:
        inside = (folder / name).resolve().is_relative_to(folder.resolve())
    except (OSError, ValueError, RuntimeError) as error:  # RuntimeError: links in a circle
        raise MechanismError(f"{name[:200]!r} cannot be a file's name: {error}") from error
    if not inside:
        raise MechanismError(f"{name!r} leads out of the mechanism's folder; keep its files inside")
    return folder / name


def save_mechanism(mechanism: Mechanism, folder: str | Path, *, force: bool = False) -> Path:
    """Write a mechanism to a folder, whole or not at all, and return the folder.

    Raises:
        FileError: the folder exists and ``force`` is not set, or cannot be written.
    """
    must_be(mechanism, Mechanism, "a mechanism to write", MechanismError)
    with writing(folder, force=force, folder=MECHANISM_FILES) as scratch:
        write_mechanism(mechanism, scratch)
    return Path(folder)


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

    kinds, what = (Mechanism, str, Path), "a mechanism, its name or folder, or a result"
    return load_mechanism(must_be(given, kinds, what, MechanismError))
