"""CSV files of poses, readings and measurements that belong to a mechanism, written."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pincal.files.tables import write_table
from pincal.model.measurements import Measurements, Plan
from pincal.model.mechanism import Mechanism
from pincal.model.orientation import SINGLE_ANGLES, WAYS, columns_of

Array = NDArray[np.float64]


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
    columns = _pose_columns(mechanism, plan, orientation)
    if plan.readings is not None:
        columns |= _reading_columns(mechanism, plan.readings)
    write_table(path, columns, force=force)


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
    columns = _pose_columns(mechanism, data)
    columns = {  # what was never measured has no column
        header: values
        for header, values in columns.items()
        if isinstance(values, tuple) or np.isfinite(values).any()
    } | _reading_columns(mechanism, data.readings)
    platform = mechanism.platform
    if data.sigma_poses is not None:
        names = zip(platform.freedoms, platform.units, data.sigma_poses.T, strict=True)
        columns |= {f"sigma_{name} [{unit}]": values for name, unit, values in names}
    if data.sigma_readings is not None:
        read = _reading_columns(mechanism, data.sigma_readings)
        columns |= {f"sigma_{name}": values for name, values in read.items()}
    columns |= {f"{name} [{_unit(name)}]": values for name, values in data.extra.items()}
    more = data.sigma_extra.items()
    columns |= {f"sigma_{name} [{_unit(name)}]": values for name, values in more}
    columns |= {} if data.runs is None else {"run": data.runs}
    columns |= {} if data.places is None else {"pose": data.places}
    write_table(path, columns, force=force)


def _unit(column: str) -> str:
    return "rad" if column in SINGLE_ANGLES else "m"


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
        f"{name} [{unit}]": values
        for name, unit, values in zip(
            mechanism.reading_names, mechanism.reading_units, readings.T, strict=True
        )
    }
