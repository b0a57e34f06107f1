"""Measurement tables as FIGAROH has them: pose columns of a marker, and a column for each joint.

Headers are ``x1, y1, z1`` and, if the marker's orientation was measured, ``phix1, phiy1, phiz1``
(roll, pitch and yaw, R = Rz Ry Rx), then the joints' names; metres and radians, no units.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from pincal.errors import MeasurementError
from pincal.files.table import TextTable, read_table
from pincal.model.measurements import Measurements
from pincal.model.mechanism import Mechanism
from pincal.model.platform import Platform
from pincal.types import Array


def read_figaroh(path: str | Path, mechanism: Mechanism) -> tuple[Measurements, tuple[str, ...]]:
    """Return the measurements of a table of FIGAROH's, and remarks on columns that were left out.

    A joint's column has the name of the reading (the leg's, if it has one drive) or, if no other
    drive is called so, of the joint.
    """
    table = read_table(path)
    headers = _headers_of_readings(table, mechanism)
    readings = np.column_stack([_numbers(table, name) for name in headers])
    poses, used = _poses(table, mechanism.platform, len(readings))
    if not np.isfinite(poses).any():
        raise MeasurementError(
            f"{table.path}: nothing of the platform's pose; expected columns x1, y1, z1 and, of a "
            "platform that turns, phix1, phiy1, phiz1"
        )
    unread = [name for name in table.units if name not in (*headers, *used)]
    remarks = (f"columns left out: {', '.join(unread)}",) if unread else ()
    return Measurements(poses=poses, readings=readings), remarks


def _headers_of_readings(table: TextTable, mechanism: Mechanism) -> list[str]:
    """Return the column of each reading."""
    drives = [sensor.joint for leg in mechanism.legs for sensor in leg.sensors]
    headers = []
    for name, drive in zip(mechanism.reading_names, drives, strict=True):
        names = [name] if drives.count(drive) > 1 else [name, drive]
        present = [header for header in names if header in table]
        if not present:
            raise MeasurementError(
                f"{table.path}: no column {' or '.join(map(repr, names))}; the file has "
                f"{', '.join(table.units)}"
            )
        headers.append(present[0])
    return headers


def _poses(table: TextTable, platform: Platform, count: int) -> tuple[Array, list[str]]:
    """Return the poses, NaN where there is no column, and the columns that they are from."""
    poses, used = np.full((count, platform.dof), np.nan), []
    for place, axis in enumerate("xyz"[: platform.lengths]):
        if f"{axis}1" in table:
            poses[:, place] = _numbers(table, f"{axis}1")
            used.append(f"{axis}1")
    turns = [f"phi{axis}1" for axis in "xyz"]
    if platform.turns and all(name in table for name in turns):
        angles = np.column_stack([_numbers(table, name) for name in turns])
        turned = Rotation.from_euler("xyz", angles)
        transforms = RigidTransform.from_components(np.zeros((count, 3)), turned)
        poses[:, platform.lengths :] = platform.coordinates_of(transforms)[:, platform.lengths :]
        used += turns
    return poses, used


def _numbers(table: TextTable, name: str) -> Array:
    """Return a column's numbers, which must have no unit."""
    if table.units[name] is not None:
        raise MeasurementError(
            f"{table.path}: column {name!r} has a unit, which FIGAROH's have not (m and rad); "
            "a table of pincal's own needs no import"
        )
    return table.plain(name)
