"""How a platform is measured: in which frame, at which points of it, from where.

By default positions are those of the platform's origin in the robot's base frame. A tracker
is elsewhere, a reflector sits somewhere on the platform, a cable measures a distance.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import hypot
from pathlib import Path
from typing import Any

from pincal.errors import MeasurementError
from pincal.model.checks import array_of, must_be
from pincal.model.measuring.image import Camera
from pincal.model.measuring.instrument import Instrument
from pincal.model.measuring.uncertainty import POLAR, Systematic, Tracker
from pincal.model.mechanism import Mechanism
from pincal.model.orientation import WAYS
from pincal.model.overview import one_line
from pincal.model.parameter import listed
from pincal.model.platform import Platform

Point = tuple[float, float, float]
_FAR = 3.0  # times the longest leg: no target is that far from its platform
ORIGIN = "platform"  # the target whose position is x, y, z


def _point(values: Any, what: str) -> Point:
    x, y, z = array_of(values, (3,), what, MeasurementError).tolist()
    return x, y, z


@dataclass(frozen=True)
class Target:
    """A point of the platform whose position is measured."""

    offset: Point = (0.0, 0.0, 0.0)
    """In the platform frame, [m]; where the search starts if unknown."""
    unknown: bool = False
    """Whether the offset is identified; of ``platform``, also how the measured orientation is
    turned against the platform's."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "offset", _point(self.offset, "offset of a target"))
        must_be(self.unknown, bool, "unknown of a target", MeasurementError)


@dataclass(frozen=True)
class Distance:
    """A measured distance from a known point to a target."""

    point: Point
    """In the frame of the measurements, [m]."""
    target: str = ORIGIN

    def __post_init__(self) -> None:
        object.__setattr__(self, "point", _point(self.point, "point of a distance"))
        must_be(self.target, str, "target of a distance", MeasurementError)


@dataclass(frozen=True)
class Setup:
    """What measured numbers mean."""

    unknown_frame: bool = False
    """Whether the place of the robot's base in the frame of the measurements is unknown."""
    targets: Mapping[str, Target] = field(default_factory=lambda: {ORIGIN: Target()})
    """``platform`` is the target of x, y, z; another target t of the columns t_x, t_y, t_z."""
    distances: Mapping[str, Distance] = field(default_factory=dict)
    """By column."""
    instruments: tuple[Instrument, ...] = ()
    """Instruments of one's own, each with its columns and unknowns."""
    tracker: Tracker | None = None
    """What measures positions by a range and angles, if their noise is to be said so."""
    systematic: Systematic = field(default_factory=Systematic)
    """Uncertainties of what is off by the same in all rows."""

    def __post_init__(self) -> None:
        must_be(self.unknown_frame, bool, "unknown_frame", MeasurementError)
        kinds: dict[str, type] = {"targets": Target, "distances": Distance}
        for field_name, kind in kinds.items():
            named = must_be(getattr(self, field_name), Mapping, field_name, MeasurementError)
            for name, one in named.items():
                must_be(name, str, f"a name in {field_name}", MeasurementError)
                must_be(one, kind, f"{field_name}, {name!r}", MeasurementError)
        object.__setattr__(self, "targets", {ORIGIN: Target(), **self.targets})
        for column, one in self.distances.items():
            if one.target not in self.targets:
                raise MeasurementError(
                    f"distance {column!r} is to a target {one.target!r}; expected one of "
                    f"{', '.join(self.targets)}"
                )
        object.__setattr__(self, "instruments", tuple(self.instruments))
        if self.tracker is not None:
            must_be(self.tracker, Tracker, "tracker", MeasurementError)
        must_be(self.systematic, Systematic, "systematic", MeasurementError)
        self._check_instruments()

    @staticmethod
    def from_yaml(path: str | Path) -> Setup:
        """Return the setup that a YAML file says.

        Raises:
            FileError: the file is missing or cannot be read.
            MeasurementError: it does not parse, or says something else than it should.
        """
        from pincal.files.setups import read_setup

        return read_setup(path)

    def _check_instruments(self) -> None:
        """Raise if an instrument is none, or its names are another's.

        Raises:
            MeasurementError: saying which.
        """
        names = {"tracker", "target", *self.targets}
        for one in self.instruments:
            must_be(one, Instrument, "an instrument", MeasurementError)
            if one.name in names or not one.name.isidentifier():
                raise MeasurementError(
                    f"an instrument is named {one.name!r}; expected a word that no target and no "
                    "other instrument has"
                )
            names.add(one.name)
            for column, unit in one.columns.items():
                if unit not in ("m", "rad"):
                    raise MeasurementError(
                        f"column {column!r} of instrument {one.name!r} is in {unit!r}; expected m "
                        "or rad"
                    )
            if isinstance(one, Camera):
                seen = {c for pair in one.image.points.values() for c in pair}
                if unknown := sorted(seen - set(one.columns)):
                    raise MeasurementError(
                        f"the image of instrument {one.name!r} has a column {unknown[0]!r}; "
                        f"expected its own: {listed(one.columns)}"
                    )
            for parameter in one.parameters:
                if parameter.owner != one.name:
                    raise MeasurementError(
                        f"parameter {parameter.id!r} is of instrument {one.name!r}; expected "
                        f"'{one.name}.{parameter.name}'"
                    )

    def __repr__(self) -> str:
        targets = [n + " (unknown)" * t.unknown for n, t in self.targets.items() if t != Target()]
        return one_line(
            "Setup",
            "unknown frame" if self.unknown_frame else "base frame",
            f"targets {listed(targets)}" if targets else "",
            f"distances {listed(self.distances)}" if self.distances else "",
            f"instruments {listed(one.name for one in self.instruments)}"
            if self.instruments
            else "",
            "" if self.tracker is None else "tracker",
            "systematic uncertainties" if self.systematic != Systematic() else "",
        )

    @property
    def plain(self) -> bool:
        """Whether poses are those of the platform in the base frame, and nothing else."""
        further = self.distances or self.instruments or self.targets != {ORIGIN: Target()}
        return not (self.unknown_frame or further)

    @property
    def polar(self) -> dict[str, str]:
        """Columns ``sigma_…`` that say a tracker's noise, and units; none without a tracker."""
        return {} if self.tracker is None else POLAR

    @property
    def required(self) -> dict[str, str]:
        """Columns that measurements must have, and whose they are."""
        return dict.fromkeys(self.distances, "a distance that the setup names") | {
            column: f"which instrument {one.name!r} reads"
            for one in self.instruments
            for column in one.columns
        }

    def points(self, platform: Platform) -> dict[str, str]:
        """Return the columns of further targets' positions, and their units."""
        further = [name for name in self.targets if name != ORIGIN]
        return {f"{name}_{axis}": "m" for name in further for axis in "xyz"[: platform.space]}

    def columns(self, mechanism: Mechanism) -> dict[str, str]:
        """Return columns that this setup adds to those of the pose, and their units.

        Raises:
            MeasurementError: a column that means something else; a target far off the mechanism.
        """
        size = max(leg.size for leg in mechanism.legs)
        for name, target in self.targets.items():
            if (far := hypot(*target.offset)) > _FAR * size:
                raise MeasurementError(
                    f"target {name!r} is {far:.4g} m from the platform's origin, and the longest "
                    f"leg of {mechanism.name!r} is {size:.3g} m; expected metres: is this "
                    "millimetres?"
                )
        points = self.points(mechanism.platform)
        columns = points | dict.fromkeys(self.distances, "m")
        taken_twice = set(points) & set(self.distances)
        for one in self.instruments:
            taken_twice |= set(columns) & set(one.columns)
            columns |= one.columns
        platform = mechanism.platform
        taken = {
            *mechanism.leg_names,
            *mechanism.reading_names,
            *platform.coordinates,
            *platform.freedoms,
            "set",
            "run",
        }
        if owners := {one.name for one in self.instruments} & set(mechanism.leg_names):
            raise MeasurementError(
                f"an instrument is named {sorted(owners)[0]!r}, as a leg of {mechanism.name!r}; "
                "choose another name"
            )
        taken |= {"pose", "rx", "ry", "rz", *(n for names, _ in WAYS.values() for n in names)}
        taken |= {name for name in columns if name.startswith("sigma_")} | set(self.polar)
        taken |= taken_twice
        if both := taken & set(columns):
            raise MeasurementError(
                f"the setup names a column {sorted(both)[0]!r}, which means something else in "
                "measurements; choose another name"
            )
        return columns
