"""The linearised condition of one leg on pose, readings and parameters.

A closed leg satisfies e = Nᵀ c(x, θ(ψ), p; φ) = 0. Its derivatives are by parameters φ, pose x and
readings ψ; those of the predicted reading, the identification Jacobian, are −(∂e/∂ψ)⁻¹ ∂e/∂φ.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from pincal.files.mechanism_folders import GivenMechanism, as_mechanism
from pincal.kinematics.batches import chunks, least_squares, lengths, parted, product, stacked
from pincal.kinematics.closing import close, grouped, sensor_law, started
from pincal.kinematics.closure import Closure, LegClosure, each, evaluate
from pincal.model import Poses
from pincal.model.checks import EXACT
from pincal.types import Array, Mask

_STEPS = 60  # largest number of Newton steps
_SMALL = 1e-8  # last step; Nᵀ c is off by its square
_LAST = 4  # share of the poses, its inverse, below which those that still move go on alone
_LONGEST = 0.5  # longest step, [rad] or of the leg's size: it has no bound beside a gimbal lock
_FAR = 1e-2  # gap over a leg's size, above which its curvature counts


def nearest_closure(
    legs: Sequence[LegClosure], matrices: Array, known: Array, joints: Array | None = None
) -> tuple[Closure, Array]:
    """Return the closures of L legs of one form at poses and readings with least |c|, and joints.

    The residual Nᵀ c exists out of reach and is smooth near singularities. Poses are (L N, 4, 4),
    readings with influences (L N, n_active [+ n_influences]). Passive joints start near those that
    close the legs, or at ``joints``, (L N, n_joints [+ n_deformed]).
    """
    leg = legs[0].leg
    positions, count = started(legs, matrices, known, joints), len(matrices) // len(legs)
    scales = np.repeat([closure.leg.scales[leg.passive] for closure in legs], count, axis=0)
    far_gaps = _FAR * np.repeat([closure.size for closure in legs], count)
    moving = np.arange(len(matrices)).reshape(len(legs), count)
    for _ in range(_STEPS):
        rows = moving.ravel()
        closed = evaluate(legs, positions[rows], matrices[rows])
        step = closed.passive_step()
        if leg.passive and closed.gap.shape[1] <= 3:  # of points
            far = lengths(closed.gap) > far_gaps[rows]
            if far.any():
                step[far] = _curved_step(closed, far)
        longest = np.abs(step / scales[rows]).max(axis=1, initial=0.0)
        positions[rows[:, None], leg.passive] += step * (_LONGEST / longest.clip(_LONGEST))[:, None]
        large = longest > _SMALL
        last = large.reshape(moving.shape).any(axis=0)
        if not last.any():
            break
        if _LAST * last.sum() <= len(last):  # those that close take no more steps
            moving = moving[:, last]
    return closed if len(rows) == len(matrices) else evaluate(legs, positions, matrices), positions


def _curved_step(closed: Closure, rows: Mask) -> Array:
    """Return Newton steps of passive joints where points stay far apart, (n, n_passive)."""
    # Gauss-Newton steps are right where c is 0; out of reach the curvature of the paths, c · (ω_i ×
    # v_j) for i ≤ j, counts as much, and without it steps overshoot. Along directions of negative
    # curvature the step goes downhill (saddle-free Newton).
    gap, J = closed.gap[rows], closed.passive[rows]
    n, m = len(gap), gap.shape[1]
    turning, space = np.zeros((3, J.shape[2], n)), np.zeros((n, 3, J.shape[2] + 1))
    twists = closed.motion.twists_at_tip(list(closed.leg.leg.passive))
    rates = twists[len(closed.motion.tips) :, :, rows]
    turning[3 - len(rates) :] = rates
    space[:, :m, :-1], space[:, :m, -1] = J, gap
    v, c = space[:, :, :-1], space[:, :, -1]
    (x, y, z), (u, w, t) = c.T, turning
    crossed = np.array((y * t - z * w, z * u - x * t, x * w - y * u))
    pulled = crossed.transpose(2, 1, 0)  # c · (ω × v) = (c × ω) · v
    bend = np.triu(pulled @ v)
    bend += np.triu(bend, 1).transpose(0, 2, 1)
    transposed = J.transpose(0, 2, 1)
    values, vectors = np.linalg.eigh(product(transposed, J) + bend)
    downhill = vectors.transpose(0, 2, 1) @ product(transposed, gap[:, :, None])
    steepest = np.abs(values).max(axis=1, keepdims=True)
    least = np.maximum(EXACT * steepest, np.finfo(float).tiny)  # not zero
    steps = vectors @ (downhill[:, :, 0] / np.maximum(np.abs(values), least))[:, :, None]
    return -np.asarray(steps)[:, :, 0]


class Demand(NamedTuple):
    """Nᵀ c of one leg and its derivatives at N poses."""

    value: Array
    """e = Nᵀ c, shape (N, k), [m]."""
    pose: Array
    """∂e/∂x for the platform's freedoms as a twist, shape (N, k, dof), [1] and [m/rad]."""
    joints: Array
    """Joint positions with deformations, shape (N, n_joints [+ n_deformed])."""
    parameter: Array
    """∂e/∂φ, shape (N, k, n_params), [m/unit]."""
    reading: Array
    """∂e/∂ψ, shape (N, k, n_active), [m/rad] or [1]."""

    @property
    def jacobian(self) -> Array:
        """∂(predicted reading)/∂φ, (N, n_active, n_params): −(∂e/∂ψ)⁻¹ ∂e/∂φ, by least squares."""
        return -least_squares(self.reading, self.parameter)


def demands(
    legs: Sequence[LegClosure], known: Array, closure: Closure, joints: Array
) -> list[Demand]:
    """Return the demands of L legs of one form by their closures at N configurations.

    ``known`` are readings with influences, shape (L N, n_active [+ n_influences]).
    """
    by_parameter, drive = closure.constraint_by_parameter, closure.drive
    columns = (closure.constraint, closure.constraint_by_pose, joints, by_parameter, drive, known)
    parts = (parted(column, len(legs)) for column in columns)
    return [
        Demand(value, pose, positions, *_derivatives(leg, *geometry))
        for leg, value, pose, positions, *geometry in zip(legs, *parts, strict=True)
    ]


def _derivatives(leg: LegClosure, rows: Array, drive: Array, known: Array) -> tuple[Array, Array]:
    """Return ∂e/∂φ, (N, k, n_params), and ∂e/∂ψ, (N, k, n_active), from the geometry's rows."""
    law, parameter = sensor_law(leg), rows.copy("K")
    parameter[:, :, law.parameter_places] += product(drive, law.by_parameter(known))
    reading = drive * law.slopes(known)[..., None, :]
    if leg.leg.deformed:
        law, names = leg.deformations, leg.leg.parameter_names
        places = [names.index(name) for name in leg.leg.deformed]
        known = np.hstack((np.zeros((len(known), len(places))), known[:, len(leg.leg.sensors) :]))
        parameter[:, :, law.parameter_places] += rows[:, :, places] @ law.by_parameter(known)
    return parameter, reading


def leg_demands_at(
    legs: Sequence[LegClosure],
    placed: Sequence[Array],
    known: Sequence[Array] | None = None,
    influences: Sequence[Array] | None = None,
    near: Sequence[Array] = (),
) -> list[Demand]:
    """Return the demands of legs, each at its own poses (N, 4, 4); legs of one form in one call.

    ``known`` has each leg's readings with influences, (N, n_active [+ n_influences]); passive
    joints are at best closure, searched from joints ``near``. Without it, readings are by inverse
    kinematics at ``influences``, or their reference: values are zero, and NaN out of reach.
    """
    forms = [(leg.form, len(poses)) for leg, poses in zip(legs, placed, strict=True)]
    influences = influences or [np.zeros((len(poses), 0)) for poses in placed]
    demand_of: dict[int, Demand] = {}
    for places in grouped(forms, max(map(len, placed))):
        columns: tuple[Any, ...] = (legs, placed, influences, known, near or None)
        of_group: list[Any] = [c and [c[place] for place in places] for c in columns]
        demand_of |= zip(places, _alike_demands(*of_group), strict=True)
    return [demand_of[place] for place in range(len(legs))]


def _alike_demands(
    legs: Sequence[LegClosure],
    placed: Sequence[Array],
    influences: Sequence[Array],
    known: Sequence[Array] | None,
    near: Sequence[Array] | None,
) -> list[Demand]:
    """Return the demands of legs of one form in chunks of rows: see ``leg_demands_at``."""
    parts = []
    for rows in list(chunks(len(placed[0]))) or [slice(0)]:
        matrices = stacked([poses[rows] for poses in placed])
        if known is not None:
            columns = stacked([values[rows] for values in known])
            start = stacked([joints[rows] for joints in near]) if near else None
            parts.append(demands(legs, columns, *nearest_closure(legs, matrices, columns, start)))
            continue
        columns = stacked([values[rows] for values in influences])
        closed = close(legs, matrices, columns)
        columns = np.hstack((each(_readings, legs, closed.joints, columns), columns))
        parts.append(demands(legs, columns, closed.closure, closed.joints))
        for demand, reached in zip(parts[-1], parted(closed.reached, len(legs)), strict=True):
            if not reached.all():
                for values in demand:
                    values[~reached] = np.nan
    if len(parts) == 1:
        return parts[0]
    of_legs = zip(*parts, strict=True)
    return [Demand(*map(np.concatenate, zip(*of_leg, strict=True))) for of_leg in of_legs]


def _readings(leg: LegClosure, joints: Array, influences: Array) -> Array:
    return sensor_law(leg).reading(joints[:, leg.leg.active], influences)


def identification_jacobian(
    mechanism: GivenMechanism, leg: str, poses: Poses, parameters: Array | None = None
) -> Array:
    """Return the identification Jacobian of one leg: ∂(predicted reading)/∂parameter.

    C = ∂g/∂φ (5R paper, Eq. 6; 3-RRR paper, Eq. 11), by implicit differentiation of the closure;
    inverse kinematics is included. Shape (N, n_params), [rad/unit] or [m/unit], NaN where the leg
    does not reach; with several sensors a row for each, pose by pose.

    Args:
        mechanism: The mechanism.
        leg: Name of the leg.
        poses: N platform poses: coordinates, shape (N, dof), or transforms.
        parameters: Parameter values of the leg, shape (n_params,); by default nominal.

    Raises:
        MechanismError: the leg is unknown; poses have a wrong shape, or are not finite.

    Example:
        >>> import pincal
        >>> pincal.identification_jacobian("5R", "leg_1", [[0.0, 1.1], [0.2, 1.2]]).shape
        (2, 6)
    """
    mechanism = as_mechanism(mechanism)
    closure = LegClosure(mechanism.leg(leg), mechanism.platform, parameters)
    placed = mechanism.platform.matrices(poses)
    C = np.empty((len(closure.leg.sensors), len(closure.parameters), len(placed)))
    for rows in chunks(len(placed)):
        closed, none = close((closure,), placed[rows]), np.zeros((len(placed[rows]), 0))
        geometry, drive = closed.closure.constraint_by_parameter, closed.closure.drive
        known = _readings(closure, closed.joints, none)
        parameter, reading = _derivatives(closure, geometry, drive, known)
        C[:, :, rows] = -least_squares(reading, parameter).transpose(1, 2, 0)
        C[:, :, rows][:, :, ~closed.reached] = np.nan
    return C.transpose(2, 0, 1).reshape(-1, len(closure.parameters))
