"""What one leg demands of pose, reading and parameters, linearised: the rows of identification.

A closed leg demands e = Nᵀ c(x, θ(ψ), p; φ) = 0. Its derivatives are by parameters φ, pose x and
reading ψ; those of the predicted reading, the identification Jacobian, are −(∂e/∂ψ)⁻¹ ∂e/∂φ.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from pincal.files.mechanism_folders import GivenMechanism, as_mechanism
from pincal.kinematics.batches import chunks, least_squares, lengths, parted, product, stacked
from pincal.kinematics.closing import close, grouped, sensor_law, started
from pincal.kinematics.closure import Closure, LegClosure, each, evaluate
from pincal.model.checks import EXACT
from pincal.model.platform import Poses
from pincal.types import Array, Mask

_STEPS = 60  # of Newton's method
_SMALL = 1e-8  # step at which it ends: Nᵀ c is off by its square
_FAR = 1e-2  # of a leg's size, from which a gap's curvature counts


def nearest_closure(
    legs: Sequence[LegClosure], matrices: Array, known: Array, joints: Array | None = None
) -> tuple[Closure, Array]:
    """Return the closure of L alike legs at poses and readings, |c| least, and the joints.

    What is left of the closure, Nᵀ c, exists out of reach and stays tame near singularities. Poses
    are (L N, 4, 4), readings, then influences, (L N, n_active [+ n_influences]). Passive joints
    start near those that close the legs, or at joints (L N, n_joints [+ n_deformed]).
    """
    leg = legs[0].leg
    positions, count = started(legs, matrices, known, joints), len(matrices) // len(legs)
    scales = np.repeat([closure.leg.scales[leg.passive] for closure in legs], count, axis=0)
    far_gaps = _FAR * np.repeat([closure.size for closure in legs], count)
    for _ in range(_STEPS):
        closed = evaluate(legs, positions, matrices)
        step = closed.passive_step()
        if leg.passive and closed.gap.shape[1] <= 3:  # of points
            far = lengths(closed.gap) > far_gaps
            if far.any():
                step[far] = _curved_step(closed, far)
        positions[:, leg.passive] += step
        if np.abs(step / scales).max(initial=0.0) <= _SMALL:
            break
    return closed, positions


def _curved_step(closed: Closure, rows: Mask) -> Array:
    """Return Newton steps of passive joints where points stay far apart, shape (n, n_passive)."""
    # Gauss-Newton steps are right where c is 0; out of reach the paths' curvature c · (ω_i × v_j),
    # i ≤ j, counts as much, and without it they overshoot. Where |c| is no minimum along a
    # direction, the step goes down it (saddle-free Newton).
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
    least = np.maximum(EXACT * steepest, np.finfo(float).tiny)  # a slide of no length goes nowhere
    steps = vectors @ (downhill[:, :, 0] / np.maximum(np.abs(values), least))[:, :, None]
    return -np.asarray(steps)[:, :, 0]


class Demand(NamedTuple):
    """Nᵀ c of one leg and its derivatives at N poses; one row where joints are as many as rows."""

    value: Array
    """e = Nᵀ c, shape (N, k), [m]."""
    pose: Array
    """∂e/∂x for the platform's freedoms as a twist, shape (N, k, dof), [1] and [m/rad]."""
    joints: Array
    """Joint positions there, deformations behind, shape (N, n_joints [+ n_deformed])."""
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
    """Return what each of L alike legs demands, from their closures at N configurations.

    Known are readings, then influences, shape (L N, n_active [+ n_influences]).
    """
    by_parameter, drive = closure.constraint_by_parameter, closure.drive
    columns = (closure.constraint, closure.constraint_by_pose, joints, by_parameter, drive, known)
    parts = (parted(column, len(legs)) for column in columns)
    return [
        Demand(value, pose, positions, *_derivatives(leg, *geometry))
        for leg, value, pose, positions, *geometry in zip(legs, *parts, strict=True)
    ]


def _derivatives(leg: LegClosure, rows: Array, drive: Array, known: Array) -> tuple[Array, Array]:
    """Return ∂e/∂φ, (N, k, n_params), and ∂e/∂ψ, (N, k, n_active), by what rows of geometry are."""
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
    """Return what legs demand, each at N poses (N, 4, 4) of its own, alike ones in one call.

    Known are of each leg readings, then influences, (N, n_active [+ n_influences]): passive joints
    are where it closes best, searched from joints near. If not known, readings are those of inverse
    kinematics at influences, or their reference: values are zero, and all is NaN out of reach.
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
    """Return what alike legs demand, worked out in chunks of rows: see ``leg_demands_at``."""
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
        parameters: Parameter values of the leg, shape (n_params,); nominal if not given.

    Raises:
        MechanismError: unknown leg; poses of a wrong shape, or not finite.

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
