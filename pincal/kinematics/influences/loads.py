"""Loads by gravity of active joints, lengths and angles, at poses of a machine.

Of virtual work. Where λ is the force by which a leg's closure c holds it to the platform, the
leg's joints carry f = h + (∂c/∂q)ᵀ λ, h what links lose in height with each joint, times their
weight; passive joints carry nothing. The platform rests on all legs: w + Σ (∂c/∂x)ᵀ λ = 0, w its
own weight along each freedom. A length or an angle is a joint too, which the link holds: its load
is h + (∂c/∂φ)ᵀ λ.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pincal.kinematics.batches import block_diagonal, least_squares, left_null, product
from pincal.kinematics.chain import body_chain
from pincal.kinematics.closure import Closure, LegClosure, nominal_legs
from pincal.kinematics.nearest_closure import nearest_closure
from pincal.model.mechanism import Mechanism
from pincal.model.sensors.load import Load

Array = NDArray[np.float64]


def gravity_loads(mechanism: Mechanism, readings: Array, matrices: Array) -> dict[str, Array]:
    """Return forces and torques of gravity by name (``Mechanism.load_names``), of shape (N,) each.

    Of an active joint, a length or an angle, along its positive direction, [N] or [N m]: what
    gravity does along it while all (other) active joints are held. With more active joints than
    freedoms, those of the least that hold the machine.

    Args:
        mechanism: The mechanism, with its load; its terms do not count.
        readings: Of all legs, shape (N, n_readings), [rad] or [m].
        matrices: Poses that belong to them, ``T_base_platform``, shape (N, 4, 4).
    """
    load = mechanism.load or Load()
    closures, weights = [], []
    for index, own in enumerate(nominal_legs(mechanism)):
        closed, joints = nearest_closure(own, matrices, mechanism.known(index, readings))
        closures.append(closed)
        weights.append(_links(own, joints, np.array(load.gravity)))
    forces = _forces(mechanism, closures, weights, _weight(mechanism, load, matrices))
    found: dict[str, Array] = {}
    of_parameters: dict[str, Array] = {}
    for leg, closed, lost, force in zip(mechanism.legs, closures, weights, forces, strict=True):
        by_joint = lost[:, leg.active] + _along(closed.active, force)
        by_parameter = lost[:, len(leg.moving) :] + _along(closed.parameter, force)
        found |= zip(leg.reading_names, by_joint.T, strict=True)
        ids = (f"{leg.name}.{name}" for name in leg.parameter_names)
        of_parameters |= zip(ids, by_parameter.T, strict=True)
    return found | of_parameters


def _forces(
    mechanism: Mechanism, closures: Sequence[Closure], weights: Sequence[Array], weight: Array
) -> list[Array]:
    """Return by what force each leg's closure holds it to the platform: λ, shape (N, m) each.

    λ = λ₀ + N μ: λ₀ holds the links on passive joints, and N μ is what these do not feel, of which
    (Nᵀ ∂c/∂x)ᵀ μ carries the platform.

    Args:
        mechanism: The mechanism.
        closures: Of its legs.
        weights: What links of each leg lose in height with each joint, times weight, shape (N, n).
        weight: The same of the platform with each freedom, shape (N, dof).
    """
    held, active, left = [], [], weight
    for leg, closed, own in zip(mechanism.legs, closures, weights, strict=True):
        if not own.any():  # links without masses
            held.append(np.zeros(closed.gap.shape))
            active.append(own[:, leg.active])
            continue
        passive = closed.passive.transpose(0, 2, 1)
        held.append(-least_squares(passive, own[:, leg.passive, None])[:, :, 0])
        active.append(own[:, leg.active] + _along(closed.active, held[-1]))
        left = left + _along(closed.pose, held[-1])
    lines = np.concatenate([one.project(one.pose) for one in closures], axis=1)
    mu = -least_squares(lines.transpose(0, 2, 1), left[:, :, None])
    if lines.shape[1] > lines.shape[2]:  # forces of legs against each other: the least in joints
        drive = block_diagonal([one.drive for one in closures]).transpose(0, 2, 1)
        inner = left_null(lines)
        joints = np.concatenate(active, axis=1)[:, :, None] + product(drive, mu)
        mu = mu - product(inner, least_squares(product(drive, inner), joints))
    ends = np.cumsum([one.constraint.shape[1] for one in closures])[:-1]
    parts = np.split(mu, ends, axis=1)
    return [
        own + product(one.normal, part)[:, :, 0]
        for own, one, part in zip(held, closures, parts, strict=True)
    ]


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
