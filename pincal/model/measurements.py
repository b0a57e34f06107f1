"""Noise, planned poses and measurements: rows that belong to a mechanism."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Self

import numpy as np

from pincal.attached import attached
from pincal.errors import MeasurementError
from pincal.model.checks import LARGEST, array_of, counted, must_be, names_of, number_of, one_line
from pincal.model.mechanism import Mechanism
from pincal.model.relations import ROW, TO
from pincal.model.setup import Setup
from pincal.option import option
from pincal.types import Array, Index, Mask

EVERY_LEG, VERIFY = "all", "verify"
SMALLEST_SIGMA = 1e-50
"""Smallest standard deviation, [m] or [rad], whose weights do not overflow; 0 means exact."""
_ROWS, _READ = ("N", "dof"), ("N", "n_readings")
_SHAPES = {"poses": _ROWS, "readings": _READ, "sigma_poses": _ROWS, "sigma_readings": _READ}
_NAMES, _COLUMNS = ("sets", "places", "runs"), ("influences", "contacts", "extra", "sigma_extra")


def _column_of(values: Any, count: int, label: str, error_type: type[MeasurementError]) -> Array:
    return array_of(values, (count,), label, error_type)


@dataclass(frozen=True)
class Noise:
    """Standard deviations of measured quantities; zero means exact."""

    position: float = option(
        1e-4,
        "Standard deviation of each measured position coordinate [m], or as 20um.",
        unit="m",
        name="noise_position",
    )
    orientation: float = option(
        1e-4,
        "Standard deviation of each measured orientation coordinate [rad], or as 5mrad.",
        unit="rad",
        name="noise_orientation",
    )
    reading: float = option(
        0.0,
        "Standard deviation of each sensor reading [rad or m], or as 5mrad.",
        unit="m rad",
        name="noise_reading",
    )
    pixel: float = option(
        0.2,
        "Standard deviation of each coordinate that a camera sees [px].",
        unit="px",
        name="noise_pixel",
    )

    def __post_init__(self) -> None:
        for name, entry in vars(self).items():
            value = number_of(entry, f"the noise of {name}", MeasurementError)
            object.__setattr__(self, name, value)
            if value != 0.0 and not SMALLEST_SIGMA <= value <= LARGEST:
                raise MeasurementError(
                    f"the noise of {name} is {value}; expected a standard deviation, 0 or more "
                    f"({SMALLEST_SIGMA:g} to {LARGEST:g}, or 0 for an exact quantity)"
                )

    def of_poses(self, mechanism: Mechanism) -> Array:
        """Return the standard deviation of each platform coordinate, shape (dof,)."""
        return np.array([self.of_unit(unit) for unit in mechanism.platform.units])

    def of_unit(self, unit: str) -> float:
        """Return the standard deviation of platform coordinates in m or rad, or of pixels in px."""
        return {"m": self.position, "rad": self.orientation, "px": self.pixel}[unit]


@dataclass(frozen=True, eq=False)
class Plan:
    """Poses to measure, and the leg for which each was chosen."""

    poses: Array
    """Coordinates of the poses, shape (N, dof), [m] and [rad]."""
    sets: tuple[str, ...] | None = None
    """Leg for which each pose was chosen: ``"leg_1+leg_2"`` for several, ``"all"`` for every leg,
    ``"verify"`` for a pose that no fit uses, kept to check the calibrated mechanism; or None."""
    readings: Array | None = None
    """Readings to command, shape (N, n_readings), where poses do not determine them."""
    places: tuple[str, ...] | None = field(default=None, kw_only=True)
    """Name of the pose of each row: rows with the same name are repeated measurements."""
    influences: Mapping[str, Array] = field(default_factory=dict, kw_only=True)
    """Influence quantities, on which terms depend, by column (``Mechanism.influences``), each of
    shape (N,); an unknown value is NaN and counts as the term's reference."""
    contacts: Mapping[str, tuple[str, ...]] = field(default_factory=dict, kw_only=True)
    """Names of the points that a setup's contacts touch, by column, length N; empty for none."""
    lines: tuple[int, ...] | None = field(default=None, kw_only=True)
    """Line number of each row in the file; None if the rows were not read from a file."""
    written: str | None = field(default=None, kw_only=True)
    """Way in which the file gives a spatial platform's orientation, a key of ``WAYS``; None if
    the rows were not read from a file."""

    def __post_init__(self) -> None:
        """Convert fields to arrays, tuples of names, and mappings of these, with N entries each."""
        error, sizes = MeasurementError, dict[str, int]()
        for name, values in list(vars(self).items()):
            if name in _SHAPES and (values is not None or name == "poses"):
                shape = tuple(sizes.get(letter, letter) for letter in _SHAPES[name])
                values = array_of(values, shape, name, error)
                sizes |= zip(_SHAPES[name], values.shape, strict=True)
            elif name in _NAMES and values is not None:
                values = names_of(values, sizes["N"], name, error)
            elif name in _COLUMNS:
                columns = must_be(values, Mapping, name, error).items()
                count, check = sizes["N"], names_of if name == "contacts" else _column_of
                values = {key: check(c, count, f"{name} {key!r}", error) for key, c in columns}
            object.__setattr__(self, name, values)

    @staticmethod
    @attached
    def from_csv(
        source: str | Path, mechanism: Mechanism | str | Path, *, partial: bool = False
    ) -> Plan:
        """Return the poses of a table, with its ``set`` column if there is one.

        Readings are read too if the mechanism's poses do not determine them.

        Args:
            source: CSV file.
            mechanism: The mechanism, or its name or folder.
            partial: Whether columns or cells of the pose may be missing; they are then NaN.

        Raises:
            FileError: the file is missing or cannot be read.
            MeasurementError: a column or cell that is missing or wrong; the message says where.
        """

    @attached
    def to_csv(
        self,
        path: str | Path,
        mechanism: Mechanism | str | Path,
        *,
        orientation: str = "tilt-torsion",
        setup: Setup | None = None,
        force: bool = False,
    ) -> None:
        """Write the rows to a CSV file.

        Args:
            path: The file.
            mechanism: The mechanism, or its name or folder.
            orientation: Way to write a spatial platform's orientation, a key of ``WAYS``.
            setup: Setup that knows the units of further columns other than lengths.
            force: Whether to replace the file if it exists.

        Raises:
            FileError: the file exists and ``force`` is not set, or cannot be written.
        """

    def __repr__(self) -> str:
        rows = f"{counted(len(self), 'row')}: {counted(self.poses.shape[1], 'coordinate')}"
        if lacks := int(np.isnan(self.poses).any(axis=1).sum()):
            rows += f" (not all in {counted(lacks, 'row')})"
        if self.readings is not None:
            rows += f", {counted(self.readings.shape[1], 'reading')}"
        further = ("sets", "places", "runs", "sigma_poses", "sigma_readings")
        has = [name for name in further if getattr(self, name, None) is not None]
        return one_line(
            type(self).__name__, rows, *has, *getattr(self, "extra", ()), *self.influences
        )

    def __len__(self) -> int:
        return len(self.poses)

    def place(self, row: int) -> str:
        """Return where a row is, for messages: its line in the file, or else its number."""
        return f"row {row + 1}" if self.lines is None else f"line {self.lines[row]}"

    def rows(self, chosen: Index | Mask) -> Self:
        """Return the rows of an index or mask; distances to rows that are left out are dropped."""
        index = np.arange(len(self))[chosen]

        def selected(values: Any) -> Any:
            if isinstance(values, Mapping):
                return {name: selected(column) for name, column in values.items()}
            if isinstance(values, tuple):
                return tuple(values[i] for i in index)
            return values[index] if isinstance(values, np.ndarray) else values

        parts = {column.name: selected(getattr(self, column.name)) for column in fields(self)}
        among = {"", *parts["contacts"].get(ROW, ())}
        parts["contacts"] |= {
            column: tuple(name if name in among else "" for name in names)
            for column, names in parts["contacts"].items()
            if column.endswith(TO)
        }
        return replace(self, **parts)

    @property
    def touched(self) -> list[tuple[str, ...]]:
        """Names of the touched points, a tuple for each contact, without columns that name rows."""
        return [names for n, names in self.contacts.items() if n != ROW and not n.endswith(TO)]

    @property
    def serving(self) -> tuple[str, ...]:
        """The set of each row, length N: ``all`` if the rows have no sets."""
        return self.sets or (EVERY_LEG,) * len(self)

    @property
    def verifying(self) -> Mask:
        """Mask of the rows that no fit uses because their set is ``verify``, shape (N,)."""
        return np.array([name == VERIFY for name in self.serving], dtype=bool)

    def serves(self, leg: str) -> Mask:
        """Return the mask of the poses that were chosen for a leg, shape (N,)."""
        served = (leg in name.split("+") or name in (EVERY_LEG, "") for name in self.serving)
        return np.array(list(served), dtype=bool)


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class Measurements(Plan):
    """Measured poses, readings and further quantities, row by row; NaN where not measured.

    Unless a ``Setup`` says otherwise, ``poses`` are poses of the platform in the base frame. If all
    legs are fitted together, a row may lack coordinates of the position, the orientation, or the
    whole pose: they are NaN.
    """

    readings: Array = field()
    """Sensor readings, shape (N, n_readings), legs in order, [rad] or [m]."""
    sigma_poses: Array | None = None
    """Standard deviation of each freedom, shape (N, dof), if the file gives it."""
    sigma_readings: Array | None = None
    """Standard deviation of each reading, shape (N, n_readings), if the file gives it."""
    extra: Mapping[str, Array] = field(default_factory=dict)
    """Further measured quantities by column, each of shape (N,): positions of further targets
    and distances [m], columns of instruments (see ``Setup``)."""
    sigma_extra: Mapping[str, Array] = field(default_factory=dict)
    """Standard deviations of further quantities by column, each of shape (N,); a tracker's columns
    are ``range``, ``azimuth`` and ``elevation``."""
    runs: tuple[str, ...] | None = None
    """Run of the experiment to which each row belongs, if there were several runs."""

    def __post_init__(self) -> None:
        array_of(self.readings, _READ, "readings", MeasurementError)  # they are needed
        super().__post_init__()

    @staticmethod
    @attached
    def from_csv(
        source: str | Path,
        mechanism: Mechanism | str | Path,
        setup: Setup | None = None,
        *,
        partial: bool = False,
        pairs: str | Path | None = None,
    ) -> Measurements:
        """Return the measurements of a table: poses, readings, sets and standard deviations.

        Arguments and errors are those of ``Plan.from_csv``. In addition, ``setup`` describes what
        was measured beside the platform's pose, and ``pairs`` is a table of distances between rows
        with the columns ``row a``, ``row b``, ``distance [mm]``.
        """
