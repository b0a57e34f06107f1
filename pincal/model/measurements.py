"""Poses, readings and measurements: rows that belong to a mechanism, and their files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from pincal.errors import MeasurementError
from pincal.model.mechanism import Mechanism
from pincal.model.orientation import WAYS, columns_of, rotation_of
from pincal.model.table import Table, read_table, write_table

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
EVERY_LEG = "all"


@dataclass(frozen=True)
class Noise:
    """Standard deviations of what is measured; zero is exact."""

    position: float = 1e-4
    """Of each position coordinate, [m]."""
    orientation: float = 1e-4
    """Of each orientation coordinate, [rad]."""
    reading: float = 0.0
    """Of each sensor reading, [rad] or [m]."""

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not (np.isfinite(value) and value >= 0.0):
                raise MeasurementError(
                    f"the noise of {name} is {value}; expected a standard deviation, 0 or more"
                )

    def of_poses(self, mechanism: Mechanism) -> Array:
        """Return the standard deviation of each platform coordinate, shape (dof,)."""
        units = mechanism.platform.units
        return np.array([self.position if unit == "m" else self.orientation for unit in units])


@dataclass(frozen=True)
class Plan:
    """Poses to measure, and for which leg each was chosen."""

    poses: Array
    """Coordinates, shape (N, dof), [m] and [rad]."""
    sets: tuple[str, ...] | None = None
    """Leg for which each pose was chosen, ``"all"`` for every leg; None if not said."""

    def serves(self, leg: str) -> Mask:
        """Return which poses were chosen for a leg, shape (N,)."""
        if self.sets is None:
            return np.ones(len(self.poses), dtype=bool)
        return np.array([s in (leg, EVERY_LEG, "") for s in self.sets], dtype=bool)


@dataclass(frozen=True, kw_only=True)
class Measurements(Plan):
    """Measured poses with the readings of all sensors."""

    readings: Array
    """Shape (N, n_legs), legs in order, [rad] or [m]."""
    sigma_poses: Array | None = None
    """Standard deviation of each coordinate, shape (N, dof), if the file gives it."""
    sigma_readings: Array | None = None
    """Standard deviation of each reading, shape (N, n_legs), if the file gives it."""

    def __len__(self) -> int:
        return len(self.poses)


def read_poses(path: str | Path, mechanism: Mechanism) -> Plan:
    """Return the poses of a CSV file, with its ``set`` column if there is one.

    Raises:
        FileError: the file is missing or cannot be read.
        MeasurementError: a column or cell that is missing or wrong; the message says where.
    """
    table = _read(path, mechanism)
    return Plan(_poses(table, mechanism), _sets(table, mechanism))


def read_readings(path: str | Path, mechanism: Mechanism) -> Array:
    """Return the readings of a CSV file, shape (N, n_legs), [rad] or [m].

    Raises:
        FileError: the file is missing or cannot be read.
        MeasurementError: a column or cell that is missing or wrong; the message says where.
    """
    return _readings(_read(path, mechanism), mechanism)


def read_measurements(path: str | Path, mechanism: Mechanism) -> Measurements:
    """Return the measurements of a CSV file: poses, readings, sets and standard deviations.

    Raises:
        FileError: the file is missing or cannot be read.
        MeasurementError: a column or cell that is missing or wrong; the message says where.
    """
    table = _read(path, mechanism)
    platform = mechanism.platform
    sigma_poses = _sigmas(table, dict(zip(platform.freedoms, platform.units, strict=True)))
    units = {leg.name: leg.reading_unit for leg in mechanism.legs}
    return Measurements(
        poses=_poses(table, mechanism),
        sets=_sets(table, mechanism),
        readings=_readings(table, mechanism),
        sigma_poses=sigma_poses,
        sigma_readings=_sigmas(table, units),
    )


def write_poses(
    path: str | Path,
    mechanism: Mechanism,
    plan: Plan,
    *,
    orientation: str = "tilt-torsion",
    force: bool = False,
) -> None:
    """Write poses, and their sets if they have them, to a CSV file.

    Args:
        path: The file.
        mechanism: The mechanism.
        plan: The poses.
        orientation: Way to write a spatial platform's orientation, a key of ``WAYS``.
        force: Whether to replace the file if it exists.

    Raises:
        FileError: the file exists and ``force`` is not set, or cannot be written.
    """
    write_table(path, _pose_columns(mechanism, plan, orientation), force=force)


def write_readings(
    path: str | Path, mechanism: Mechanism, readings: Array, *, force: bool = False
) -> None:
    """Write readings to a CSV file.

    Raises:
        FileError: the file exists and ``force`` is not set, or cannot be written.
    """
    write_table(path, _reading_columns(mechanism, readings), force=force)


def write_measurements(
    path: str | Path, mechanism: Mechanism, data: Measurements, *, force: bool = False
) -> None:
    """Write measurements to a CSV file.

    Raises:
        FileError: the file exists and ``force`` is not set, or cannot be written.
    """
    columns = _pose_columns(mechanism, data) | _reading_columns(mechanism, data.readings)
    platform = mechanism.platform
    if data.sigma_poses is not None:
        names = zip(platform.freedoms, platform.units, data.sigma_poses.T, strict=True)
        columns |= {f"sigma_{name} [{unit}]": values for name, unit, values in names}
    if data.sigma_readings is not None:
        legs = zip(mechanism.legs, data.sigma_readings.T, strict=True)
        columns |= {f"sigma_{leg.name} [{leg.reading_unit}]": values for leg, values in legs}
    write_table(path, columns, force=force)


def _read(path: str | Path, mechanism: Mechanism) -> Table:
    """Return a table; a column whose name differs from a known one by its case is refused."""
    table = read_table(path)
    turns = [name for names, _ in WAYS.values() for name in names]
    values = [*mechanism.platform.coordinates, *turns, *mechanism.leg_names]
    known = ["set", *values, *(f"sigma_{name}" for name in values)]
    for column in table.units:
        bare = column.split("(")[0].strip().lower()
        meant = [name for name in known if name.lower() == bare and name not in table]
        if column not in known and meant:
            raise MeasurementError(
                f"{table.path}: column {column!r} is ignored as it stands; write {meant[0]!r}, and "
                "units in brackets: 'x [mm]'"
            )
    return table


def _poses(table: Table, mechanism: Mechanism) -> Array:
    """Return the coordinates of poses; a spatial platform's orientation in any of the ways."""
    platform = mechanism.platform
    columns = dict(zip(platform.coordinates, platform.units, strict=True))
    ways = [way for way, (names, _) in WAYS.items() if all(name in table for name in names)]
    if platform.kind != "spatial" or not ways or ways[0] == "tilt-torsion":
        return np.column_stack([table.numbers(name, unit) for name, unit in columns.items()])
    names, unit = WAYS[ways[0]]
    position = np.column_stack([table.numbers(name, "m") for name in "xyz"])
    values = np.column_stack([table.numbers(name, unit) for name in names])
    try:
        rotation = rotation_of(ways[0], values)
    except MeasurementError as error:
        raise MeasurementError(f"{table.path}: {error}") from error
    return platform.coordinates_of(RigidTransform.from_components(position, rotation))


def _readings(table: Table, mechanism: Mechanism) -> Array:
    return np.column_stack([table.numbers(leg.name, leg.reading_unit) for leg in mechanism.legs])


def _sets(table: Table, mechanism: Mechanism) -> tuple[str, ...] | None:
    if "set" not in table:
        return None
    known = {*mechanism.leg_names, EVERY_LEG, ""}
    sets = tuple(cell.strip() for cell in table.text["set"])
    for name, line in zip(sets, table.lines, strict=True):
        if name not in known:
            raise MeasurementError(
                f"{table.path}, line {line}: set {name!r} is no leg of {mechanism.name!r}; "
                f"expected {', '.join(mechanism.leg_names)} or {EVERY_LEG}"
            )
    return sets


def _sigmas(table: Table, units: dict[str, str]) -> Array | None:
    """Return the ``sigma_…`` columns, shape (N, n), or None where there are none."""
    present = [name for name in units if f"sigma_{name}" in table]
    if not present:
        return None
    columns = [table.numbers(f"sigma_{name}", unit) for name, unit in units.items()]
    sigmas = np.column_stack(columns)
    if (sigmas < 0.0).any():
        row, column = (int(i) for i in np.argwhere(sigmas < 0.0)[0])
        raise MeasurementError(
            f"{table.path}, line {table.lines[row]}: 'sigma_{list(units)[column]}' is negative; a "
            "standard deviation is 0 or more"
        )
    return sigmas


def _pose_columns(
    mechanism: Mechanism, plan: Plan, orientation: str = "tilt-torsion"
) -> dict[str, Array | tuple[str, ...]]:
    platform = mechanism.platform
    columns: dict[str, Array | tuple[str, ...]] = {}
    if plan.sets is not None:
        columns["set"] = plan.sets
    poses = plan.poses
    names = list(zip(platform.coordinates, platform.units, strict=True))
    if platform.kind == "spatial" and orientation != "tilt-torsion":
        turns = columns_of(orientation, platform.transforms(poses).rotation)
        poses = np.concatenate((poses[:, :3], turns), axis=1)
        written, unit = WAYS[orientation]
        names = names[:3] + [(name, unit) for name in written]
    for (name, unit), values in zip(names, poses.T, strict=True):
        columns[f"{name} [{unit}]"] = values
    return columns


def _reading_columns(mechanism: Mechanism, readings: Array) -> dict[str, Array | tuple[str, ...]]:
    return {
        f"{leg.name} [{leg.reading_unit}]": values
        for leg, values in zip(mechanism.legs, readings.T, strict=True)
    }
