"""Influence quantities of rows: columns that terms depend on beside readings.

The side from which a joint approaches follows from the order of rows if no column has it.
"""

from collections.abc import Mapping, Sequence
from numbers import Real

import numpy as np

from pincal.errors import MeasurementError
from pincal.kinematics.batches import block_diagonal, least_squares, left_null, product
from pincal.kinematics.chain import body_chain
from pincal.kinematics.closure import LegClosure, nominal_legs
from pincal.kinematics.derivatives import nearest_closure
from pincal.model import Load, Measurements, Mechanism, Plan
from pincal.model.checks import array_of, must_be
from pincal.model.terms import APPROACH
from pincal.types import Array

_STILL = 1e-3  # motion over the range of a reading, below which it stands still
Influences = Mapping[str, Array | float] | Array


def influence_columns(mechanism: Mechanism, measured: Influences | None, count: int) -> Array:
    """Return the columns of a mechanism's influences, shape (N, n_influences).

    ``measured`` has, by column, a number for all rows or one for each; or it is all columns. What
    is not given is NaN, at its reference.

    Raises:
        MeasurementError: no term depends on a column, or it has a wrong shape.
    """
    names = mechanism.influences
    if isinstance(measured, np.ndarray):
        return array_of(measured, (count, len(names)), "influences", MeasurementError)
    named: Mapping[str, object] = must_be(measured or {}, Mapping, "influences", MeasurementError)
    if unknown := [name for name in named if name not in names]:
        raise MeasurementError(
            f"no term of {mechanism.name!r} depends on {unknown[0]!r}; its influences: "
            f"{', '.join(names) or 'none'}"
        )
    columns = np.full((count, len(names)), np.nan)
    for name, value in named.items():
        values = [value] * count if isinstance(value, Real) else value
        checked = array_of(values, (count,), f"influence {name!r}", MeasurementError)
        columns[:, names.index(name)] = checked
    if np.isinf(columns).any():
        raise MeasurementError("an influence is infinite; expected numbers, or NaN where not known")
    return columns


def influences_of(mechanism: Mechanism, plan: Plan, readings: Array | None = None) -> Array:
    """Return the influences of rows in the order of time, shape (N, n_influences).

    ``readings``, shape (N, n_readings), are by default those of the plan or measurements.
    """
    measured = own_influences(mechanism, plan.influences)
    columns = influence_columns(mechanism, measured, len(plan))
    readings = plan.readings if readings is None else readings
    if readings is None:
        return columns
    runs = plan.runs if isinstance(plan, Measurements) else None
    for place, name in enumerate(mechanism.reading_names):
        column = f"{APPROACH}_{name}"
        if column in mechanism.influences and column not in measured:
            columns[:, mechanism.influences.index(column)] = sides(readings[:, place], runs)
    return columns


def own_influences(mechanism: Mechanism, columns: Mapping[str, Array]) -> dict[str, Array]:
    """Return the columns on which terms of a mechanism depend."""
    return {name: columns[name] for name in mechanism.influences if name in columns}


def by_name(mechanism: Mechanism, columns: Array) -> dict[str, Array]:
    """Return columns of a mechanism's influences by name, each of shape (N,)."""
    return dict(zip(mechanism.influences, columns.T, strict=True))


def sides(readings: Array, runs: Sequence[str] | None = None) -> Array:
    """Return the side from which each reading was approached, (N,): +1 from below, -1 from above.

    Readings are in the order of time. A reading that stays, or goes back by less than a thousandth
    of its range (noise), keeps its side. NaN until it first moves, in each run, and where not read.
    """
    sides_of_rows = np.full(len(readings), np.nan)
    read = np.flatnonzero(np.isfinite(readings))
    if not len(read):
        return sides_of_rows
    noise = _STILL * float(np.ptp(readings[read]))
    names = np.array(runs)[read] if runs is not None else np.zeros(len(read))
    for rows in np.split(read, 1 + np.flatnonzero(names[1:] != names[:-1])):
        side, turned = np.nan, readings[rows[0]]  # where it last reversed by more than noise
        for row in rows:
            moved = readings[row] - turned
            if abs(moved) > noise and not moved * side > 0.0:
                side = float(np.sign(moved))
            if moved * side > 0.0:
                turned = readings[row]  # the farthest so far
            sides_of_rows[row] = side
    return sides_of_rows


def weight(mechanism: Mechanism, matrices: Array) -> Array:
    """Return the weight of platform and payload at poses (N, 4, 4), a wrench of shape (N, dof)."""
    load = mechanism.load or Load()
    force, arms = load.mass * np.array(load.gravity), matrices[:, :3, :3] @ np.array(load.centre)
    wrench = np.concatenate((np.broadcast_to(force, arms.shape), np.cross(arms, force)), axis=1)
    return np.asarray(wrench[:, list(mechanism.platform.twist_rows)])


def gravity_loads(mechanism: Mechanism, readings: Array, matrices: Array) -> dict[str, Array]:
    """Return forces and torques of gravity by name (``Mechanism.load_names``), of shape (N,) each.

    They are along a joint's positive direction, [N] or [N m], with all other active joints held; of
    redundant drives they are the least that hold the machine. Readings (N, n_readings) belong to
    poses (N, 4, 4).
    """
    load, legs = mechanism.load or Load(), nominal_legs(mechanism)
    gravity, closures, links = np.array(load.gravity), [], []
    carried = weight(mechanism, matrices)
    for index, leg in enumerate(legs):
        closed, joints = nearest_closure((leg,), matrices, mechanism.known(index, readings))
        lost, n = _links(leg, joints, gravity), len(leg.leg.moving)
        by_joint, by_parameter = lost[:, leg.leg.active], lost[:, n:]
        if lost.any():  # λ₀ holds the links on passive joints
            passive = lost[:, leg.leg.passive, None]
            held = -least_squares(closed.passive.transpose(0, 2, 1), passive)[:, :, 0]
            by_joint = by_joint + _along(closed.active, held)
            by_parameter = by_parameter + _along(closed.parameter, held)
            carried = carried + _along(closed.pose, held)
        closures.append(closed)
        links.append((by_joint, by_parameter))
    # closure forces are λ = λ₀ + N μ, where N μ does not act on passive joints
    lines = np.concatenate([closed.constraint_by_pose for closed in closures], axis=1)
    mu = -least_squares(lines.transpose(0, 2, 1), carried[:, :, None])
    if lines.shape[1] > lines.shape[2]:  # internal forces are those of least joint forces
        drive = block_diagonal([closed.drive for closed in closures]).transpose(0, 2, 1)
        inner, in_joints = left_null(lines), np.concatenate([joints for joints, _ in links], axis=1)
        against = in_joints[:, :, None] + product(drive, mu)
        mu = mu - product(inner, least_squares(product(drive, inner), against))
    ends = np.cumsum([closed.constraint.shape[1] for closed in closures])[:-1]
    named: dict[str, Array] = {}
    parts = zip(legs, closures, links, np.split(mu[:, :, 0], ends, axis=1), strict=True)
    for leg, closed, (by_joint, by_parameter), force in parts:
        by_joint = by_joint + _along(closed.drive, force)
        by_parameter = by_parameter + _along(closed.constraint_by_parameter, force)
        names = (*leg.leg.reading_names, *leg.leg.parameter_ids)
        named |= zip(names, (*by_joint.T, *by_parameter.T), strict=True)
    return named


def _along(rows: Array, force: Array) -> Array:
    """Return Aᵀ λ of rows (N, m, k) and a force (N, m), shape (N, k)."""
    return np.einsum("nmk,nm->nk", rows, force)


def _links(leg: LegClosure, joints: Array, gravity: Array) -> Array:
    """Return the generalised forces of the links' weight by joints, then parameters, (N, n + k)."""
    n = len(leg.leg.moving)
    lost_height = np.zeros((len(joints), n + len(leg.parameters)))
    for joint in leg.leg.joints:
        if joint.mass:
            chain = body_chain(leg.leg, joint)
            motion = chain.motion(leg.parameters, joints[:, chain.columns])
            lost = joint.mass * np.einsum("x,xjn->nj", gravity, motion.twists()[:3])
            lost_height[:, chain.columns] += lost[:, : len(chain.columns)]
            lost_height[:, n:] += lost[:, len(chain.columns) :]
    return lost_height
