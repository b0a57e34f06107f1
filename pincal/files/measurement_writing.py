"""CSV files of poses, readings and measurements that belong to a mechanism, written."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pincal.errors import MeasurementError
from pincal.files.columns import product_unit
from pincal.files.mechanism_folders import GivenMechanism, as_mechanism
from pincal.files.table import write_table
from pincal.model.checks import array_of, must_be
from pincal.model.measurements import Measurements, Plan
from pincal.model.mechanism import Mechanism
from pincal.model.orientation import SINGLE_ANGLES, WAYS
from pincal.model.orientation import columns_of as angles_of
from pincal.model.setup import Setup
from pincal.model.units import Units
from pincal.types import Array

Columns = dict[str, Array | tuple[str, ...]]


def write_plan(
    plan: Plan, path: str | Path, mechanism: GivenMechanism, *, force: bool = False, **ways: Any
) -> None:
    """Write a plan, or measurements, to a CSV file: see ``Plan.to_csv``."""
    write_table(path, columns_of(mechanism, plan, **ways), force=force)


def dataframe_of(plan: Plan, mechanism: GivenMechanism, **ways: Any) -> Any:
    """Return a plan, or measurements, as a pandas DataFrame: see ``Plan.to_dataframe``."""
    try:
        import pandas
    except ImportError as error:
        raise MeasurementError(
            "a DataFrame needs the package pandas: python -m pip install 'pincal[pandas]'"
        ) from error
    columns = columns_of(mechanism, plan, **ways)
    return pandas.DataFrame({name: list(values) for name, values in columns.items()})


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

    Orientations in space are written in a way of ``WAYS``; the setup says units of further columns
    that are neither lengths nor single angles.
    """
    mechanism = as_mechanism(mechanism)
    must_be(plan, Plan, "poses or measurements to write", MeasurementError)
    measured = isinstance(plan, Measurements)
    columns: Columns = {} if plan.sets is None else {"set": plan.sets}
    for header, values in _pose_columns(mechanism, plan, orientation).items():
        if not measured or np.isfinite(values).any():  # what was never measured has no column
            columns[header] = values
    if plan.readings is not None:
        columns |= reading_columns(mechanism, plan.readings)
    columns |= _measured_columns(mechanism, plan, setup) if isinstance(plan, Measurements) else {}
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


def reading_columns(mechanism: GivenMechanism, readings: Array, prefix: str = "") -> Columns:
    """Return the columns of readings, shape (N, n_readings), header with unit to values, SI."""
    mechanism = as_mechanism(mechanism)
    names, units = mechanism.reading_names, mechanism.reading_units
    values = array_of(readings, ("N", len(names)), "readings", MeasurementError)
    return {**_headed(zip(names, units, strict=True), values, prefix)}


def _measured_columns(mechanism: Mechanism, data: Measurements, setup: Setup | None) -> Columns:
    """Return the columns that measurements have besides poses and readings."""
    freedoms = dict(zip(mechanism.platform.freedoms, mechanism.platform.units, strict=True))
    units = dict.fromkeys(SINGLE_ANGLES, "rad")
    units |= setup.columns(mechanism) if setup else {}
    columns: Columns = {}
    if data.sigma_poses is not None:
        columns |= _headed(freedoms.items(), data.sigma_poses, "sigma_")
    if data.sigma_readings is not None:
        columns |= reading_columns(mechanism, data.sigma_readings, "sigma_")
    for prefix, quantities in (("", data.extra), ("sigma_", data.sigma_extra)):
        for name, values in quantities.items():
            columns[f"{prefix}{name} [{units.get(name, 'm')}]"] = values
    units |= freedoms
    for pair, values in data.covariances.items():
        first, second = pair.split(",")
        unit = product_unit(units.get(first, "m"), units.get(second, "m"))
        columns[f"cov_{first}_{second} [{unit}]"] = values
    return columns if data.runs is None else columns | {"run": data.runs}


def write_sheet(path: str | Path, mechanism: Mechanism, plan: Plan) -> None:
    """Write a measuring sheet in mm and degrees: what is planned, and empty columns to fill in."""
    if plan.readings is None:
        raise MeasurementError(f"a sheet for {mechanism.name!r} needs the readings of its plan")
    planned: dict[str, Any] = {**_pose_columns(mechanism, plan, "zyx")}
    planned |= reading_columns(mechanism, plan.readings)
    planned = dict(Units({"m": "mm", "rad": "deg"}, last=1e-7).written(planned))
    columns: dict[str, Any] = {"row": tuple(str(1 + row) for row in range(len(plan)))}
    columns |= {} if plan.sets is None else {"set": plan.sets}
    columns |= {f"planned_{head}": values for head, values in planned.items()}
    write_table(path, columns | dict.fromkeys(planned, ("",) * len(plan)))
