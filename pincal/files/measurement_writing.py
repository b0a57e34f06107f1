"""CSV files of poses, readings and measurements that belong to a mechanism, written."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pincal.errors import MeasurementError
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
    columns = _reading_columns(as_mechanism(mechanism), readings) | dict(influences or {})
    write_table(path, columns | reason_column(reasons), units=units, force=force)


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
    columns: Columns = {} if plan.sets is None else {"set": plan.sets}
    poses = _pose_columns(mechanism, plan, orientation)
    if isinstance(plan, Measurements):  # what was never measured has no column
        poses = {header: values for header, values in poses.items() if np.isfinite(values).any()}
    columns |= poses
    if plan.readings is not None:
        columns |= _reading_columns(mechanism, plan.readings)
    if isinstance(plan, Measurements):
        columns |= _measured_columns(mechanism, plan, setup)
    columns |= plan.influences
    return columns if plan.places is None else columns | {"pose": plan.places}


def _headed(units: Iterable[tuple[str, str]], values: Array, prefix: str = "") -> dict[str, Array]:
    """Return the columns of an array, shape (N, n), under the names and units of n quantities."""
    heads = [f"{prefix}{name} [{unit}]" for name, unit in units]
    return dict(zip(heads, values.T, strict=True))


def _pose_columns(mechanism: Mechanism, plan: Plan, orientation: str) -> dict[str, Array]:
    platform = mechanism.platform
    if orientation not in WAYS:
        raise MeasurementError(f"orientation {orientation!r}; expected one of {', '.join(WAYS)}")
    array_of(plan.poses, ("N", platform.dof), f"poses of {mechanism.name!r}", MeasurementError)
    units = list(zip(platform.coordinates, platform.units, strict=True))
    if platform.turns < 3 or orientation == "tilt-torsion":
        return _headed(units, plan.poses)
    lengths, (angles, unit) = platform.lengths, WAYS[orientation]
    turns = angles_of(orientation, platform.transforms(plan.poses).rotation)
    columns = _headed(units[:lengths], plan.poses[:, :lengths])
    return columns | _headed([(name, unit) for name in angles], turns)


def _reading_columns(mechanism: Mechanism, readings: Array, prefix: str = "") -> Columns:
    names, units = mechanism.reading_names, mechanism.reading_units
    values = array_of(readings, ("N", len(names)), "readings", MeasurementError)
    return {**_headed(zip(names, units, strict=True), values, prefix)}


def _measured_columns(mechanism: Mechanism, data: Measurements, setup: Setup | None) -> Columns:
    """Return the columns that measurements have besides poses and readings."""
    freedoms = dict(zip(mechanism.platform.freedoms, mechanism.platform.units, strict=True))
    units = dict.fromkeys(SINGLE_ANGLES, "rad")
    units |= setup.columns(mechanism) | setup.polar if setup else {}
    columns: Columns = {}
    if data.sigma_poses is not None:
        columns |= _headed(freedoms.items(), data.sigma_poses, "sigma_")
    if data.sigma_readings is not None:
        columns |= _reading_columns(mechanism, data.sigma_readings, "sigma_")
    for prefix, quantities in (("", data.extra), ("sigma_", data.sigma_extra)):
        for name, values in quantities.items():
            columns[f"{prefix}{name} [{units.get(name, 'm')}]"] = values
    units |= freedoms
    for pair, values in data.covariances.items():
        first, second = pair.split(",")
        unit = product_unit(units.get(first, "m"), units.get(second, "m"))
        columns[f"cov_{first}_{second} [{unit}]"] = values
    return columns if data.runs is None else columns | {"run": data.runs}


_HANDY = {"m": "mm", "rad": "deg"}
_DECIMALS = 4  # of planned poses, in mm and degrees


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
    if plan.readings is None:
        raise MeasurementError(f"a sheet for {mechanism.name!r} needs the readings of its plan")
    poses = _handy(_pose_columns(mechanism, plan, "zyx"))
    readings = _handy(_reading_columns(mechanism, plan.readings))
    numbers = tuple(str(1 + row) for row in range(len(plan)))
    columns: dict[str, tuple[float, ...] | tuple[str, ...]] = {"row": numbers}
    meanings = [_ROW]
    if plan.sets is not None:
        columns["set"] = plan.sets
        meanings.append(_SET)
    for planned, text in ((poses, _PLANNED), (readings, _DRIVEN)):
        columns |= {f"planned_{head}": values for head, values in planned.items()}
        meanings += [text.format(name=head.partition(" [")[0]) for head in planned]
    measured: dict[str, tuple[float, ...] | tuple[str, ...]] = {}
    measured |= dict.fromkeys([*poses, *readings], ("",) * len(plan))
    meanings += [_MEASURED.format(name=head.partition(" [")[0]) for head in poses]
    meanings += [
        _READ.format(
            joint=sensor.joint,
            leg=leg.name,
            counted="counted from the home pose"
            if sensor.homed
            else "with the zero of the drawing",
        )
        for leg in mechanism.legs
        for sensor in leg.sensors
    ]
    write_table(sheet, columns | measured, force=force)
    filled_in = ["yes" if head in measured else "no" for head in (*columns, *measured)]
    rows = ([*columns, *measured], filled_in, meanings)
    write_table(legend, dict(zip(_LEGEND, rows, strict=True)), force=force)


def _handy(columns: Mapping[str, Any]) -> dict[str, tuple[float, ...]]:
    """Return columns in mm and degrees."""
    handy = {}
    for head, values in columns.items():
        name, _, unit = head.removesuffix("]").partition(" [")
        shown = np.round(np.asarray(values) / UNITS[_HANDY[unit]][1], _DECIMALS) + 0.0
        handy[f"{name} [{_HANDY[unit]}]"] = tuple(shown.tolist())
    return handy
