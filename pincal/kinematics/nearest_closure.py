"""The nearest closure of a leg: at poses and readings that need not agree, passive joints do best.

What is left of the closure, Nᵀ c, exists out of reach and stays tame near singularities.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pincal.kinematics.closure import Closure, LegClosure, Newton
from pincal.kinematics.inverse import sensor_law
from pincal.kinematics.starts import start_joints

Array = NDArray[np.float64]
_NEWTON = Newton(steps=60, small=1e-8)  # of the square of that step, Nᵀ c is off at most


def nearest_closure(
    leg: LegClosure,
    matrices: Array,
    readings: Array,
    joints: Array | None = None,
    steps: int = _NEWTON.steps,
) -> tuple[Closure, Array]:
    """Return a leg's closure at poses and readings, |c| least, and the joint positions there.

    Args:
        leg: The leg at its parameter values.
        matrices: Poses ``T_base_platform``, shape (N, 4, 4).
        readings: Shape (N, n_active), [rad] or [m].
        joints: Where the search for passive joints starts, shape (N, n_joints).
        steps: Most Gauss-Newton steps.
    """
    active, passive = leg.leg.active, leg.leg.passive
    if joints is not None:
        joints = joints.copy()
    elif passive:
        joints = start_joints(leg, matrices)[0]
    else:
        joints = np.empty((len(matrices), len(active)))
    joints[:, active] = sensor_law(leg).position(readings)
    for _ in range(steps):
        closed = leg.evaluate(joints, matrices)
        step = closed.passive_step()
        joints[:, passive] += step
        if np.abs(step).max(initial=0.0) <= _NEWTON.small * max(1.0, leg.size):
            break
    return closed, joints


def arm_poses(leg: LegClosure, readings: Array, gap: Array | None = None) -> Array:
    """Return where readings of an arm put the platform, ``T_base_platform``, shape (N, 4, 4).

    Args:
        leg: A leg that is an arm (see ``Leg``), at its parameter values.
        readings: Shape (N, n_active), [rad] or [m].
        gap: What the closure is to be there, shape (N, 6); nothing if not given.
    """
    joints = np.empty((len(readings), len(leg.leg.moving)))
    joints[:, leg.leg.active] = sensor_law(leg).position(readings)
    return leg.frame(joints, gap)
