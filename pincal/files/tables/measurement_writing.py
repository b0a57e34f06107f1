"""CSV files of poses, readings and measurements that belong to a mechanism, written."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pincal.errors import MeasurementError, MechanismError
from pincal.files.given_mechanism import GivenMechanism, as_mechanism
from pincal.files.tables.covariances import product_unit
from pincal.files.tables.table import write_table
from pincal.files.tables.units import SI, Units
from pincal.model.checks import array_of, must_be
from pincal.model.measuring.measurements import Measurements, Plan
from pincal.model.measuring.setup import Setup
from pincal.model.mechanism import Mechanism
from pincal.model.orientation import SINGLE_ANGLES, WAYS
from pincal.model.orientation import columns_of as angles_of

Array = NDArray[np.float64]
Columns = dict[str, Array | tuple[str, ...]]


def write_poses(
    path: str | Path,
    mechanism: GivenMechanism,
    plan: Plan,
    *,
    orientation: str = "tilt-torsion",
    units: Units = SI,
    force: bool = False,
) -> None:
    """Write poses, and their sets if they have them, to a CSV file: see ``Plan.to_csv``."""
    mechanism = as_mechanism(mechanism)
    must_be(plan, Plan, "poses to write", MeasurementError)
    planned = Plan(
        plan.poses, plan.sets, plan.readings, places=plan.places, influences=plan.influences
    )
    write_table(path, columns_of(mechanism, planned, orientation), units=units, force=force)


def write_readings(
    path: str | Path,
    mechanism: GivenMechanism,
    readings: Array,
    influences: Mapping[str, Array] | None = None,
    *,
    reasons: Sequence[str] = (),
    units: Units = SI,
    force: bool = False,
) -> None:
    """Write readings to a CSV file.

    Args:
        path: The file.
        mechanism: The mechanism.
        readings: Readings; NaN becomes an empty cell.
        influences: What the readings depend on, by column, each of shape (N,).
        reasons: Why a row has none, a text for each; a column only if there is one.
        units: In which units they are written.
        force: Whether to replace the file if it exists.

    Raises:
        FileError: the file exists and ``force`` is not set, or cannot be written.
    """
    mechanism = as_mechanism(mechanism)
    columns = _reading_columns(mechanism, readings) | dict(influences or {})
    columns |= reason_column(reasons)
    write_table(path, columns, units=units, force=force)


def reason_column(reasons: Sequence[str]) -> Columns:
    """Return the column that says why rows are empty; none if no row is."""
    return {"reason": tuple(reasons)} if any(reasons) else {}


def write_measurements(
    path: str | Path,
    mechanism: GivenMechanism,
    data: Measurements,
    *,
    units: Units = SI,
    force: bool = False,
) -> None:
    """Write measurements to a CSV file: see ``Measurements.to_csv``."""
    mechanism = as_mechanism(mechanism)
    must_be(data, Measurements, "measurements to write", MeasurementError)
    write_table(path, columns_of(mechanism, data), units=units, force=force)


def columns_of(
    mechanism: GivenMechanism,
    plan: Plan,
    orientation: str = "tilt-torsion",
    setup: Setup | None = None,
) -> Columns:
    """Return the columns of a plan or of measurements, header with unit to values, SI.

    Args:
        mechanism: The mechanism.
        plan: The poses, or the measurements.
        orientation: Way to write a spatial platform's orientation, a key of ``WAYS``.
        setup: Says units of further columns that are neither lengths nor single angles.

    Raises:
        MeasurementError: numbers of another mechanism, or no such way.
    """
    mechanism = as_mechanism(mechanism)
    columns = _pose_columns(mechanism, plan, orientation)
    named: Columns = {**plan.influences}
    named |= {} if plan.places is None else {"pose": plan.places}
    if not isinstance(plan, Measurements):
        if plan.readings is not None:
            columns |= _reading_columns(mechanism, plan.readings)
        return columns | named
    columns = {  # what was never measured has no column
        header: values
        for header, values in columns.items()
        if isinstance(values, tuple) or np.isfinite(values).any()
    } | _reading_columns(mechanism, plan.readings)
    platform = mechanism.platform
    if plan.sigma_poses is not None:
        names = zip(platform.freedoms, platform.units, plan.sigma_poses.T, strict=True)
        columns |= {f"sigma_{name} [{unit}]": values for name, unit, values in names}
    if plan.sigma_readings is not None:
        read = _reading_columns(mechanism, plan.sigma_readings)
        columns |= {f"sigma_{name}": values for name, values in read.items()}
    units = dict.fromkeys(SINGLE_ANGLES, "rad")
    units |= setup.columns(mechanism) | setup.polar if setup else {}
    for prefix, more in (("", plan.extra), ("sigma_", plan.sigma_extra)):
        for name, values in more.items():
            columns[f"{prefix}{name} [{units.get(name, 'm')}]"] = values
    units |= dict(zip(platform.freedoms, platform.units, strict=True))
    for pair, values in plan.covariances.items():
        first, second = pair.split(",")
        unit = product_unit(units.get(first, "m"), units.get(second, "m"))
        columns[f"cov_{first}_{second} [{unit}]"] = values
    columns |= {} if plan.runs is None else {"run": plan.runs}
    return columns | named


def _pose_columns(mechanism: Mechanism, plan: Plan, orientation: str) -> Columns:
    platform = must_be(mechanism, Mechanism, "the mechanism", MechanismError).platform
    columns: Columns = {}
    if orientation not in WAYS:
        raise MeasurementError(f"orientation {orientation!r}; expected one of {', '.join(WAYS)}")
    array_of(plan.poses, ("N", platform.dof), f"poses of {mechanism.name!r}", MeasurementError)
    if plan.sets is not None:
        columns["set"] = plan.sets
    poses = plan.poses
    names = list(zip(platform.coordinates, platform.units, strict=True))
    if platform.turns == 3 and orientation != "tilt-torsion":
        turns = angles_of(orientation, platform.transforms(poses).rotation)
        poses = np.concatenate((poses[:, : platform.lengths], turns), axis=1)
        written, unit = WAYS[orientation]
        names = names[: platform.lengths] + [(name, unit) for name in written]
    for (name, unit), values in zip(names, poses.T, strict=True):
        columns[f"{name} [{unit}]"] = values
    return columns


def _reading_columns(mechanism: Mechanism, readings: Array) -> Columns:
    must_be(mechanism, Mechanism, "the mechanism", MechanismError)
    names, units = mechanism.reading_names, mechanism.reading_units
    values = array_of(readings, ("N", len(names)), "readings", MeasurementError)
    triples = zip(names, units, values.T, strict=True)
    return {f"{name} [{unit}]": column for name, unit, column in triples}
