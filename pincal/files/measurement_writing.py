"""CSV files of poses, readings and measurements that belong to a mechanism, written."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pincal.errors import MeasurementError, MechanismError
from pincal.files.measurements import product_unit
from pincal.files.mechanism_folders import GivenMechanism, as_mechanism
from pincal.files.table import dataframe, write_table
from pincal.model.checks import array_of, must_be
from pincal.model.measurements import Measurements, Plan
from pincal.model.mechanism import Mechanism
from pincal.model.orientation import SINGLE_ANGLES, WAYS
from pincal.model.orientation import columns_of as angles_of
from pincal.model.setup import Setup
from pincal.model.units import SI, UNITS, Units
from pincal.types import Array

Columns = dict[str, Array | tuple[str, ...]]

_LEGEND = ("column", "fill in", "what it is")
_ROW = "number of the pose, in the order of measuring"
_SET = "'all': for the calibration; 'verify': for its check, by poses that it has not seen"
_PLANNED = "where to drive the platform: {name}"
_DRIVEN = "what {name} reads there by the drawing: drive to it if the machine takes no poses"
_MEASURED = "{name} as measured, in the base frame; leave the column empty if it is not measured"
_READ = "what the machine reads at joint {joint} of {leg}, {counted}; needed in every row"


def write_plan(
    plan: Plan,
    path: str | Path,
    mechanism: GivenMechanism,
    *,
    orientation: str = "tilt-torsion",
    setup: Setup | None = None,
    units: Units = SI,
    force: bool = False,
) -> None:
    """Write a plan, or measurements, to a CSV file: see ``Plan.to_csv``."""
    columns = columns_of(mechanism, plan, orientation, setup)
    write_table(path, columns, units=units, force=force)


def dataframe_of(
    plan: Plan,
    mechanism: GivenMechanism,
    *,
    orientation: str = "tilt-torsion",
    setup: Setup | None = None,
) -> Any:
    """Return a plan, or measurements, as a pandas DataFrame: see ``Plan.to_dataframe``."""
    return dataframe(columns_of(mechanism, plan, orientation, setup))


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
    must_be(plan, Plan, "poses or measurements to write", MeasurementError)
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


_HANDY = {"m": "mm", "rad": "deg"}
_DECIMALS = 4  # of planned poses, in mm and degrees


@dataclass(frozen=True)
class SheetColumn:
    """A column of a measuring sheet."""

    head: str
    """Name and unit: ``x [mm]``."""
    what: str
    """What it is, for people."""
    values: tuple[float, ...] | tuple[str, ...]
    """One a row, in the unit of the head."""
    measured: bool = False
    """Whether it is empty, to be filled in."""


def sheet_columns(mechanism: Mechanism, plan: Plan) -> list[SheetColumn]:
    """Return the columns of a measuring sheet.

    Args:
        mechanism: The mechanism.
        plan: What to measure, with the readings there.

    Raises:
        MeasurementError: a plan without readings, or of another mechanism.
    """
    if plan.readings is None:
        raise MeasurementError(f"a sheet for {mechanism.name!r} needs the readings of its plan")
    poses = columns_of(mechanism, Plan(plan.poses), "zyx")
    both = columns_of(mechanism, Plan(plan.poses, readings=plan.readings), "zyx")
    read = {head: values for head, values in both.items() if head not in poses}
    blank = ("",) * len(plan)
    found = [SheetColumn("row", _ROW, tuple(str(1 + row) for row in range(len(plan))))]
    if plan.sets is not None:
        found.append(SheetColumn("set", _SET, plan.sets))
    for columns, text in ((poses, _PLANNED), (read, _DRIVEN)):
        for head, name, values in _handy(columns):
            found.append(SheetColumn(f"planned_{head}", text.format(name=name), values))
    for head, name, _ in _handy(poses):
        found.append(SheetColumn(head, _MEASURED.format(name=name), blank, measured=True))
    sensors = [(leg, sensor) for leg in mechanism.legs for sensor in leg.sensors]
    for (head, _, _), (leg, sensor) in zip(_handy(read), sensors, strict=True):
        counted = "counted from the home pose" if sensor.homed else "with the zero of the drawing"
        what = _READ.format(joint=sensor.joint, leg=leg.name, counted=counted)
        found.append(SheetColumn(head, what, blank, measured=True))
    return found


def _handy(
    columns: dict[str, Array | tuple[str, ...]],
) -> Iterator[tuple[str, str, tuple[float, ...]]]:
    """Yield head, name and values of columns, in mm and degrees."""
    for head, values in columns.items():
        name, _, unit = head.removesuffix("]").partition(" [")
        shown = np.asarray(values, dtype=np.float64) / UNITS[_HANDY[unit]][1]
        yield f"{name} [{_HANDY[unit]}]", name, tuple((np.round(shown, _DECIMALS) + 0.0).tolist())


def write_sheet(
    sheet: str | Path, legend: str | Path, mechanism: Mechanism, plan: Plan, *, force: bool = False
) -> None:
    """Write a measuring sheet, and beside it a table of what its columns are, as CSV.

    Args:
        sheet: The sheet.
        legend: The table of columns.
        mechanism: The mechanism.
        plan: What to measure, with the readings there.
        force: Whether to replace files that exist.

    Raises:
        MeasurementError: a plan without readings, or of another mechanism.
        FileError: a file exists and ``force`` is not set, or cannot be written.
    """
    columns = sheet_columns(mechanism, plan)
    write_table(sheet, {one.head: one.values for one in columns}, force=force)
    rows = [(one.head, "yes" if one.measured else "no", one.what) for one in columns]
    write_table(legend, dict(zip(_LEGEND, zip(*rows, strict=True), strict=True)), force=force)
