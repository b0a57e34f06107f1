"""What one leg demands of pose, reading and parameters, linearised: the rows of identification.

A closed leg demands e = Nᵀ c(x, θ(ψ), p; φ) = 0. Its derivatives in parameters φ, pose x
and reading ψ give both residuals in use: the closure residual e itself, and the joint
residual (predicted less measured reading), whose rows are those of e over −∂e/∂ψ.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pincal.files.mechanism_folders import GivenMechanism, as_mechanism
from pincal.kinematics.batches import (
    Matrices,
    chunks,
    least_squares,
    matrix_chunks,
    product,
    stacked,
)
from pincal.kinematics.closing import close, grouped, sensor_law
from pincal.kinematics.closure import Closure, LegClosure, rows_of_each
from pincal.kinematics.nearest_closure import nearest_closure
from pincal.model.mechanism import Mechanism
from pincal.model.platform import Poses
from pincal.types import Array, Mask


@dataclass(frozen=True)
class Demand:
    """Nᵀ c of one leg and its derivatives at N poses; one row where joints are as many as rows."""

    value: Array
    """e = Nᵀ c, shape (N, k), [m]."""
    parameter: Array
    """∂e/∂φ, shape (N, k, n_params), [m/unit]."""
    pose: Array
    """∂e/∂x for the platform's freedoms as a twist, shape (N, k, dof), [1] and [m/rad]."""
    reading: Array
    """∂e/∂ψ, shape (N, k, n_active), [m/rad] or [1]."""

    def as_joint(self) -> Demand:
        """Return the rows of the joint residual: predicted less measured readings.

        They are −(∂e/∂ψ)⁻¹ times those of e, of least squares where e has more rows than readings.
        """

        def turned(rows: Array) -> Array:
            return -least_squares(self.reading, rows)

        by_reading = -np.broadcast_to(
            np.eye(self.reading.shape[2]), (len(self.value), *2 * self.reading.shape[2:])
        )
        return Demand(
            turned(self.value[:, :, None])[:, :, 0],
            turned(self.parameter),
            turned(self.pose),
            by_reading,
        )


def demands(legs: Sequence[LegClosure], closure: Closure, known: Sequence[Array]) -> list[Demand]:
    """Return what each of some alike legs demands, from closures, readings and influences.

    Args:
        legs: L legs of one form at their parameter values.
        closure: Their closures at N configurations, rows of each below the one before.
        known: Of each leg readings, then influences, shape (N, n_active [+ n_influences]).
    """
    value, rows_of_leg = closure.constraint, rows_of_each(len(legs), len(closure.gap))
    by_parameter, pose = closure.constraint_by_parameter, closure.constraint_by_pose
    drive, found = closure.drive, []
    for rows, leg, leg_known in zip(rows_of_leg, legs, known, strict=True):
        reading = drive[rows] * sensor_law(leg).slopes(leg_known)[..., None, :]
        parameter = _by_parameter(leg, by_parameter[rows], drive[rows], leg_known)
        found.append(Demand(value[rows], parameter, pose[rows], reading))
    return found


def _by_parameter(leg: LegClosure, rows: Array, drive: Array, known: Array) -> Array:
    """Return ∂e/∂φ, shape (N, k, n_params): of the geometry, of the sensors, and of deformations.

    A deformation is added to its parameter, so ∂e/∂a = ∂e/∂p · b.
    """
    law, found = sensor_law(leg), rows.copy("K")
    found[:, :, law.parameter_places] += product(drive, law.by_parameter(known))
    if leg.leg.deformed:
        by = leg.deformations.by_parameter(known[:, len(leg.leg.sensors) :])
        found += rows[:, :, leg.deformations.parameters] @ by
    return found


def _closed(
    legs: Sequence[LegClosure],
    matrices: Array,
    readings: Sequence[Array] | None = None,
    influences: Sequence[Array] | None = None,
) -> tuple[Closure, list[Array], Mask]:
    """Return closures of alike legs, what is known of each, and which rows are reached.

    Known are readings, and influences if there are any; rows of each leg stand below those of the
    one before.
    """
    rows = rows_of_each(len(legs), len(matrices))
    more = influences or [np.zeros((len(matrices[own]), 0)) for own in rows]
    if readings is not None:
        known = [np.hstack(pair) for pair in zip(readings, more, strict=True)]
        closure, _ = nearest_closure(legs, matrices, known)
        return closure, known, np.ones(len(matrices), dtype=bool)
    closed = close(legs, matrices, more[0])  # one that deforms is alone
    known = []
    for leg, own, said in zip(legs, rows, more, strict=True):
        psi = sensor_law(leg).reading(closed.joints[own][:, leg.leg.active], said)
        known.append(np.hstack((psi, said)))
    return closed.closure, known, closed.reached


def leg_demands_at(
    legs: Sequence[LegClosure],
    placed: Sequence[Matrices],
    readings: Sequence[Array] | None = None,
    influences: Sequence[Array] | None = None,
) -> list[Demand]:
    """Return what legs demand, each at poses of its own: see ``leg_demand``.

    Args:
        legs: The legs at their parameter values.
        placed: Of each leg N poses, ``PoseMatrices`` or matrices (N, 4, 4).
        readings: Of each leg, shape (N, n_active); those of inverse kinematics if not given.
        influences: Of each leg, shape (N, n_influences); at their reference if not given.
    """
    forms = [(leg.form, len(at)) for leg, at in zip(legs, placed, strict=True)]
    found: dict[int, Demand] = {}
    for places in grouped(forms, max(map(len, placed))):
        given = ([one[i] for i in places] if one else None for one in (readings, influences))
        own = _demands_of([legs[i] for i in places], [placed[i] for i in places], *given)
        found |= zip(places, own, strict=True)
    return [found[place] for place in range(len(legs))]


def _demands_of(
    legs: Sequence[LegClosure],
    placed: Sequence[Matrices],
    readings: Sequence[Array] | None,
    influences: Sequence[Array] | None,
) -> list[Demand]:
    """Return what alike legs demand at as many poses each: see ``leg_demands_at``."""
    count = len(placed[0])
    whole: list[Demand] = []
    for rows in chunks(count) if count else [slice(0)]:
        there = stacked([one[rows] for one in placed])
        given = ([one[rows] for one in own] if own else None for own in (readings, influences))
        closure, known, reached = _closed(legs, there, *given)
        parts = demands(legs, closure, known)
        for one, own in zip(parts, rows_of_each(len(legs), len(there)), strict=True):
            if not reached[own].all():
                for values in vars(one).values():
                    values[~reached[own]] = np.nan
        if len(parts[0].value) == count:
            return parts
        whole = whole or [_room(one, count) for one in parts]
        for one, part in zip(whole, parts, strict=True):
            for target, values in zip(vars(one).values(), vars(part).values(), strict=True):
                target[rows] = values
    return whole


def _room(part: Demand, count: int) -> Demand:
    """Return room for what is demanded at so many poses, as at some."""
    return Demand(*(np.empty((count, *values.shape[1:])) for values in vars(part).values()))


def leg_demand(
    mechanism: Mechanism,
    leg: str,
    poses: Poses,
    parameters: Array | None = None,
    readings: Array | None = None,
    influences: Array | None = None,
) -> Demand:
    """Return what a leg demands at poses.

    With readings of inverse kinematics its value is zero, and all is NaN out of reach; with others
    passive joints are where the leg closes best.

    Args:
        mechanism: The mechanism.
        leg: Name of the leg.
        poses: N platform poses.
        parameters: Parameter values of the leg, shape (n_params,); nominal if not given.
        readings: Of the leg at these poses, shape (N, n_active); those of inverse kinematics if
            not given.
        influences: Of the leg at these poses, shape (N, n_influences); at their reference if not
            given.

    Raises:
        MechanismError: unknown leg; poses of a wrong shape, or not finite.
    """
    closure = LegClosure(mechanism.leg(leg), mechanism.platform, parameters)
    measured = (None if columns is None else [columns] for columns in (readings, influences))
    return leg_demands_at((closure,), (mechanism.platform.placed(poses),), *measured)[0]


def identification_jacobian(
    mechanism: GivenMechanism, leg: str, poses: Poses, parameters: Array | None = None
) -> Array:
    """Return the identification Jacobian of one leg: ∂(predicted reading)/∂parameter.

    C = ∂g/∂φ (5R paper, Eq. 6; 3-RRR paper, Eq. 11), by implicit differentiation of the
    closure with Pinocchio's joint columns; inverse kinematics is included.

    Args:
        mechanism: The mechanism.
        leg: Name of the leg.
        poses: N platform poses: coordinates, shape (N, dof), or transforms.
        parameters: Parameter values of the leg, shape (n_params,); nominal if not given.

    Returns:
        Shape (N, n_params), [rad/unit] or [m/unit]; NaN where the leg does not reach. With
        several sensors a row for each, pose by pose.

    Raises:
        MechanismError: unknown leg; poses of a wrong shape, or not finite.

    Example:
        >>> import pincal
        >>> pincal.identification_jacobian("5R", "leg_1", [[0.0, 1.1], [0.2, 1.2]]).shape
        (2, 6)
    """
    mechanism = as_mechanism(mechanism)
    placed = mechanism.platform.placed(poses)
    closure = LegClosure(mechanism.leg(leg), mechanism.platform, parameters)
    law = sensor_law(closure)
    C = np.empty((len(law.slope), len(closure.parameters), len(placed))).transpose(2, 0, 1)
    for rows, matrices in matrix_chunks(placed):
        closed, (psi,), reached = _closed((closure,), matrices)
        drive = closed.drive * law.slopes(psi)[..., None, :]
        C[rows] = least_squares(
            -drive, _by_parameter(closure, closed.constraint_by_parameter, closed.drive, psi)
        )
        C[rows][~reached] = np.nan
    return C.reshape(-1, C.shape[2])
