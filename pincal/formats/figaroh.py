"""Measurement tables as FIGAROH has them: pose columns of a marker, and a column for each joint.

Headers are ``x1, y1, z1`` and, if the marker's orientation was measured, ``phix1, phiy1, phiz1``
(roll, pitch and yaw, R = Rz Ry Rx), then the joints' names; metres and radians, no units.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from pincal.errors import MeasurementError
from pincal.files.table import read_table
from pincal.model.measurements import Measurements
from pincal.model.mechanism import Mechanism
from pincal.types import Array


def read_figaroh(path: str | Path, mechanism: Mechanism) -> tuple[Measurements, tuple[str, ...]]:
    """Return the measurements of a table of FIGAROH's, and remarks on columns that were left out.

    A joint's column has the name of the reading (the leg's, if it has one drive) or, if no other
    drive is called so, of the joint.
    """
    table = read_table(path)
    taken: set[str] = set()

    def column(*names: str) -> Array:
        name = next((name for name in names if name in table), None)
        if name is None:
            raise MeasurementError(
                f"{table.path}: no column {' or '.join(map(repr, names))}; the file has "
                f"{', '.join(table.units)}"
            )
        if table.units[name] is not None:
            raise MeasurementError(
                f"{table.path}: column {name!r} has a unit, which FIGAROH's have not (m and rad); "
                "a table of pincal's own needs no import"
            )
        taken.add(name)
        return table.plain(name)

    drives = [sensor.joint for leg in mechanism.legs for sensor in leg.sensors]
    readings = [
        column(name, *([] if drives.count(drive) > 1 else [drive]))
        for name, drive in zip(mechanism.reading_names, drives, strict=True)
    ]
    platform, count = mechanism.platform, len(readings[0])
    poses = np.full((count, platform.dof), np.nan)
    lengths = platform.lengths
    for place, axis in enumerate("xyz"[:lengths]):
        if f"{axis}1" in table:
            poses[:, place] = column(f"{axis}1")
    turns = [f"phi{axis}1" for axis in "xyz"]
    if platform.turns and all(name in table for name in turns):
        turned = Rotation.from_euler("xyz", np.column_stack([column(name) for name in turns]))
        transforms = RigidTransform.from_components(np.zeros((count, 3)), turned)
        poses[:, lengths:] = platform.coordinates_of(transforms)[:, lengths:]
    if not np.isfinite(poses).any():
        raise MeasurementError(
            f"{table.path}: nothing of the platform's pose; expected columns x1, y1, z1 and, of a "
            "platform that turns, phix1, phiy1, phiz1"
        )
    unread = [name for name in table.units if name not in taken]
    remarks = () if not unread else (f"columns left out: {', '.join(unread)}",)
    return Measurements(poses=poses, readings=np.column_stack(readings)), remarks
