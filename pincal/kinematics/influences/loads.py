"""Loads of joints: what gravity asks of them, at poses of a machine.

Of virtual work: as the platform moves by a twist t, all joints of a leg move by G t, and
what platform and links lose in height is what the active joints give, (G_a)ᵀ f = Σ Gᵀ h + w, with
h the weights of links along each joint and w that of the platform along each of its freedoms.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pincal.kinematics.batches import least_squares, product
from pincal.kinematics.chain import body_chain
from pincal.kinematics.closure import LegClosure, nominal_legs
from pincal.kinematics.nearest_closure import nearest_closure
from pincal.model.mechanism import Mechanism
from pincal.model.sensors.load import Load

Array = NDArray[np.float64]


def gravity_loads(mechanism: Mechanism, readings: Array, matrices: Array) -> Array:
    """Return forces and torques of gravity on active joints, along their positive direction.

    With more active joints than freedoms, the least that hold the machine.

    Args:
        mechanism: The mechanism, with its load; terms of its sensors do not count.
        readings: Of all legs, shape (N, n_readings), [rad] or [m].
        matrices: Poses that belong to them, ``T_base_platform``, shape (N, 4, 4).

    Returns:
        Shape (N, n_readings), [N m] or [N].
    """
    load = mechanism.load or Load()
    weight = _weight(mechanism, load, matrices)
    drives, pulls = [], weight[:, :, None]
    for index, leg in enumerate(nominal_legs(mechanism)):
        closed, joints = nearest_closure(leg, matrices, mechanism.known(index, readings))
        own = _links(leg, joints, np.array(load.gravity))
        active, passive = leg.leg.active, leg.leg.passive
        if leg.leg.is_arm and len(mechanism.legs) == 1:  # the platform goes where joints take it
            follows = -least_squares(closed.pose, closed.active)
            return np.asarray(own[:, active] + product(follows.transpose(0, 2, 1), pulls)[:, :, 0])
        by_joint = np.empty((len(joints), closed.gap.shape[1], joints.shape[1]))
        by_joint[:, :, active], by_joint[:, :, passive] = closed.active, closed.passive
        G = -least_squares(by_joint, closed.pose)
        pulls = pulls + product(G.transpose(0, 2, 1), own[:, :, None])
        drives.append(G[:, active])
    by_twist = np.concatenate(drives, axis=1).transpose(0, 2, 1)
    return np.asarray((np.linalg.pinv(by_twist) @ pulls)[:, :, 0])


def _weight(mechanism: Mechanism, load: Load, matrices: Array) -> Array:
    """Return what the platform loses in height with each freedom, times weight, shape (N, dof)."""
    force = load.mass * np.array(load.gravity)
    arms = matrices[:, :3, :3] @ np.array(load.centre)
    wrench = np.concatenate((np.broadcast_to(force, arms.shape), np.cross(arms, force)), axis=1)
    return wrench[:, list(mechanism.platform.twist_rows)]


def _links(leg: LegClosure, joints: Array, gravity: Array) -> Array:
    """Return what links lose in height with each joint, times weight, shape (N, n_joints)."""
    found, moving = np.zeros(joints.shape), 0
    for index, joint in enumerate(leg.leg.joints):
        moving += joint.kind != "fixed"
        if joint.mass and moving:
            motion = body_chain(leg.leg, index).motion(leg.parameters, joints[:, :moving])
            rows = motion.linear[:, :moving]
            found[:, :moving] += joint.mass * np.einsum("x,xjn->nj", gravity, rows)
    return found
