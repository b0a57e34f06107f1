"""Positions of a planar machine that an instrument measured in space: in the plane they lie in.

A tracker that is not level sees a plane that is tilted. Taken as they are, x and y would be too
short across the tilt, and the parameters would follow: no residual shows it.
"""

from __future__ import annotations

import logging

import numpy as np

from pincal.errors import MeasurementError
from pincal.files.table import TextTable
from pincal.model.mechanism import Mechanism
from pincal.model.setup import Setup
from pincal.types import Array
from pincal.words.numbers import amount

_log = logging.getLogger(__name__)
_MATTERS = 1.0  # of what points miss their plane by: less that they are shortened is noise


def tilt_column(mechanism: Mechanism, further: dict[str, str]) -> dict[str, str]:
    """Return the column that says how a planar machine lies in space, with its unit, if any."""
    return {"z": "m"} if mechanism.platform.space == 2 and "z" not in further else {}


def levelled(table: TextTable, setup: Setup, poses: Array) -> Array:
    """Return poses whose positions lie in the x-y plane, as a tracker that is level sees them.

    The plane is turned into x-y the shortest way, where that is more than noise. Poses are those of
    a planar machine as read, shape (N, dof), and the table has a column z.
    """
    z = table.numbers("z", "m", blank=True)
    points = np.column_stack((poses[:, :2], z))
    known = np.isfinite(points).all(axis=1)
    if known.sum() < 4:
        return poses
    middle = points[known].mean(axis=0)
    _, s, axes = np.linalg.svd(points[known] - middle)
    normal = axes[2] * (1.0 if axes[2, 2] >= 0.0 else -1.0)
    across = float(s[2] / np.sqrt(known.sum()))
    cosine = float(normal[2])
    shortened = float(np.ptp((points[known] - middle) @ axes[0])) * (1.0 - cosine)
    if not shortened > _MATTERS * across or s[1] < 10.0 * s[2]:  # a line lies in many planes
        return poses
    tilt = np.degrees(np.arccos(min(cosine, 1.0)))
    tilted = (
        f"{table.path}: positions lie in a plane that is tilted by {tilt:.2g}° to x-y (they miss "
        f"it by {amount(across, 'm', 2)}): x and y alone are too short by up to "
        f"{amount(shortened, 'm', 2)}"
    )
    if not setup.unknown_frame:
        raise MeasurementError(
            f"{tilted}. Say that the base is elsewhere in their frame (--unknown-frame), and they "
            "are turned into their plane; or give them in the base frame"
        )
    if np.isfinite(poses[:, 2:]).any() or len(setup.targets) > 1 or setup.distances:
        raise MeasurementError(
            f"{tilted}. Of orientations, further targets and distances it is not known how they "
            "lie in that plane: turn all of them into it, or leave them out"
        )
    if not known.all() and np.isfinite(poses[~known, :2]).any():
        row = int(np.flatnonzero(~known & np.isfinite(poses[:, :2]).any(axis=1))[0])
        raise MeasurementError(f"{tilted}. {table.where(row)}: no z; all positions need it")
    _log.info("%s; they were turned into their plane", tilted)
    half = np.array([-normal[1], normal[0], 0.0])  # z × normal, sin of the tilt long
    K = np.cross(np.eye(3), half)
    turned = (points - middle) @ (np.eye(3) + K + K @ K / (1.0 + cosine)) + middle
    return np.column_stack((turned[:, :2], poses[:, 2:]))
