"""Loads by gravity of active joints, lengths and angles, at poses of a machine.

Of virtual work. Where λ is the force by which a leg's closure c holds it to the platform, the
leg's joints carry f = h + (∂c/∂q)ᵀ λ, h what links lose in height with each joint, times their
weight; passive joints carry nothing. The platform rests on all legs: w + Σ (∂c/∂x)ᵀ λ = 0, w its
own weight along each freedom. A length or an angle is a joint too, which the link holds: its load
is h + (∂c/∂φ)ᵀ λ.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pincal.kinematics.batches import block_diagonal, least_squares, left_null, product
from pincal.kinematics.legs.chain import body_chain
from pincal.kinematics.legs.closure import LegClosure, nominal_legs
from pincal.kinematics.legs.nearest_closure import nearest_closure
from pincal.model.mechanism import Mechanism
from pincal.model.sensors.load import Load

Array = NDArray[np.float64]


def gravity_loads(mechanism: Mechanism, readings: Array, matrices: Array) -> dict[str, Array]:
    """Return forces and torques of gravity by name (``Mechanism.load_names``), of shape (N,) each.

    Of an active joint, a length or an angle, along its positive direction, [N] or [N m]: what
    gravity does along it while all (other) active joints are held. With more active joints than
    freedoms, those of the least that hold the machine.

    Args:
        mechanism: The mechanism, with its load; what terms follow is loads of its ``drawing``.
        readings: Of all legs, shape (N, n_readings), [rad] or [m].
        matrices: Poses that belong to them, ``T_base_platform``, shape (N, 4, 4).
    """
    load = mechanism.load or Load()
    gravity = np.array(load.gravity)
    legs = [
        _held(own, matrices, mechanism.known(index, readings), gravity)
        for index, own in enumerate(nominal_legs(mechanism))
    ]
    found: dict[str, Array] = {}
    of_parameters: dict[str, Array] = {}
    forces = _carrying(legs, _weight(mechanism, load, matrices))
    for leg, own, mu in zip(mechanism.legs, legs, forces, strict=True):
        found |= zip(leg.reading_names, (own.joints + _along(own.drive, mu)).T, strict=True)
        ids = (f"{leg.name}.{name}" for name in leg.parameter_names)
        by_parameter = own.parameters + _along(own.parameter, mu)
        of_parameters |= zip(ids, by_parameter.T, strict=True)
    return found | of_parameters


@dataclass(frozen=True)
class _Held:
    """A leg whose links are held on its passive joints, and what more it can carry.

    The force by which its closure holds it to the platform is λ = λ₀ + N μ: λ₀ holds the links on
    passive joints, and N μ is what these do not feel.
    """

    joints: Array
    """Loads of active joints by the links, λ₀ at work, shape (N, n_active)."""
    parameters: Array
    """The same of parameters, shape (N, n_params)."""
    platform: Array
    """What λ₀ does along the platform's freedoms, shape (N, dof)."""
    drive: Array
    """Nᵀ ∂c/∂θ, shape (N, k, n_active)."""
    parameter: Array
    """Nᵀ ∂c/∂φ, shape (N, k, n_params)."""
    pose: Array
    """Nᵀ ∂c/∂x, shape (N, k, dof)."""


def _held(leg: LegClosure, matrices: Array, known: Array, gravity: Array) -> _Held:
    """Return a leg at poses and what is known of its readings and influences."""
    closed, joints = nearest_closure(leg, matrices, known)
    lost, n = _links(leg, joints, gravity), len(leg.leg.moving)
    by_joint, by_parameter = lost[:, leg.leg.active], lost[:, n:]
    platform = np.zeros((len(matrices), leg.platform.dof))
    if lost.any():  # links with masses
        passive = closed.passive.transpose(0, 2, 1)
        force = -least_squares(passive, lost[:, leg.leg.passive, None])[:, :, 0]
        by_joint = by_joint + _along(closed.active, force)
        by_parameter = by_parameter + _along(closed.parameter, force)
        platform = _along(closed.pose, force)
    rows = (closed.drive, closed.constraint_by_parameter, closed.constraint_by_pose)
    return _Held(by_joint, by_parameter, platform, *rows)


def _carrying(legs: Sequence[_Held], weight: Array) -> list[Array]:
    """Return by what forces the legs carry the platform: μ, shape (N, k) each.

    With Σ (Nᵀ ∂c/∂x)ᵀ μ, its weight and what the links do to it are nothing; of forces of legs
    against each other, those of the least in joints.

    Args:
        legs: The legs.
        weight: What the platform loses in height with each freedom, times weight, shape (N, dof).
    """
    left = weight + sum(one.platform for one in legs)
    lines = np.concatenate([one.pose for one in legs], axis=1)
    mu = -least_squares(lines.transpose(0, 2, 1), left[:, :, None])
    if lines.shape[1] > lines.shape[2]:
        drive = block_diagonal([one.drive for one in legs]).transpose(0, 2, 1)
        inner = left_null(lines)
        joints = np.concatenate([one.joints for one in legs], axis=1)
        joints = joints[:, :, None] + product(drive, mu)
        mu = mu - product(inner, least_squares(product(drive, inner), joints))
    ends = np.cumsum([one.pose.shape[1] for one in legs])[:-1]
    return np.split(mu[:, :, 0], ends, axis=1)


def _along(rows: Array, force: Array) -> Array:
    """Return Aᵀ λ of rows (N, m, k) and a force (N, m), shape (N, k)."""
    return np.einsum("nmk,nm->nk", rows, force)


def _weight(mechanism: Mechanism, load: Load, matrices: Array) -> Array:
    """Return what the platform loses in height with each freedom, times weight, shape (N, dof)."""
    force = load.mass * np.array(load.gravity)
    arms = matrices[:, :3, :3] @ np.array(load.centre)
    wrench = np.concatenate((np.broadcast_to(force, arms.shape), np.cross(arms, force)), axis=1)
    return wrench[:, list(mechanism.platform.twist_rows)]


def _links(leg: LegClosure, joints: Array, gravity: Array) -> Array:
    """Return what links lose in height with each joint, then each parameter, times weight.

    Shape (N, n_joints + n_params).
    """
    n, moving = len(leg.leg.moving), 0
    found = np.zeros((len(joints), n + len(leg.parameters)))
    for index, joint in enumerate(leg.leg.joints):
        moving += joint.kind != "fixed"
        if joint.mass:
            motion = body_chain(leg.leg, index).motion(leg.parameters, joints[:, :moving])
            lost = joint.mass * np.einsum("x,xjn->nj", gravity, motion.linear)
            found[:, :moving] += lost[:, :moving]
            found[:, n:] += lost[:, moving:]
    return found
