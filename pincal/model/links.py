"""Where the links of a leg are: placements of every link at many poses, for drawing.

The leg as its URDF says it, origins and axes, without parameters. Arrays over poses, so that
nothing is asked of Pinocchio one configuration at a time.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pincal.model.joint import Joint
from pincal.model.leg import Leg

Array = NDArray[np.float64]


def link_placements(leg: Leg, joints: Array) -> Array:
    """Return ``T_base_link`` of the link after each joint, shape (N, n_all_joints, 4, 4), [m].

    Args:
        leg: The leg; fixed joints count, the last link is the tip.
        joints: Positions of the moving joints, shape (N, n_joints), [rad] or [m]; where they
            are NaN, so are the links that they move.
    """
    positions = iter(np.asarray(joints, dtype=np.float64).T)
    T_base_link = np.broadcast_to(np.eye(4), (len(joints), 4, 4))
    placements = []
    for joint in leg.joints:
        T_base_link = T_base_link @ joint.placement.origin()
        if joint.kind != "fixed":
            T_base_link = T_base_link @ _motion(joint, next(positions))
        placements.append(T_base_link)
    return np.stack(placements, axis=1)


def _motion(joint: Joint, positions: Array) -> Array:
    """Return the motion of a joint by its positions, shape (N,) to (N, 4, 4)."""
    x, y, z = joint.axis
    motion = np.zeros((len(positions), 4, 4))
    motion[:] = np.eye(4)
    if joint.kind == "prismatic":
        motion[:, :3, 3] = positions[:, None] * joint.axis
    else:
        K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        sin, cos = np.sin(positions)[:, None, None], np.cos(positions)[:, None, None]
        motion[:, :3, :3] += sin * K + (1.0 - cos) * (K @ K)  # Rodrigues
    return motion
