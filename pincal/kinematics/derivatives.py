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
    chunks,
    least_squares,
    matrix_chunks,
    product,
    stacked,
)
from pincal.kinematics.closing import close, grouped, sensor_law
from pincal.kinematics.closure import Closure, LegClosure, each
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
        rows = (self.value[:, :, None], self.parameter, self.pose)
        value, parameter, pose = (-least_squares(self.reading, row) for row in rows)
        identity = np.eye(self.reading.shape[2])
        by_reading = np.broadcast_to(-identity, (len(value), *identity.shape))
        return Demand(value[:, :, 0], parameter, pose, by_reading)


def demands(legs: Sequence[LegClosure], closure: Closure, known: Array) -> list[Demand]:
    """Return what each of L alike legs demands, from their closures at N configurations.

    Rows of each stand below those of the one before. Known are readings, then influences, shape
    (L N, n_active [+ n_influences]).
    """
    drive, by_parameter = closure.drive, closure.constraint_by_parameter
    reading = each(_by_reading, legs, drive, known)
    parameter = each(_by_parameter, legs, by_parameter, drive, known)
    columns = (closure.constraint, parameter, closure.constraint_by_pose, reading)
    return [Demand(*rows) for rows in zip(*(np.split(c, len(legs)) for c in columns), strict=True)]


def _by_reading(leg: LegClosure, drive: Array, known: Array) -> Array:
    """Return ∂e/∂ψ, shape (N, k, n_active)."""
    return np.asarray(drive * sensor_law(leg).slopes(known)[..., None, :])


def _by_parameter(leg: LegClosure, rows: Array, drive: Array, known: Array) -> Array:
    """Return ∂e/∂φ, shape (N, k, n_params): of the geometry, of the sensors, and of deformations.

    A deformation is added to its parameter, so ∂e/∂a = ∂e/∂p · b.
    """
    law, derivatives = sensor_law(leg), rows.copy("K")
    derivatives[:, :, law.parameter_places] += product(drive, law.by_parameter(known))
    if leg.leg.deformed:
        law, names = leg.deformations, leg.leg.parameter_names
        places = [names.index(name) for name in leg.leg.deformed]
        known = np.hstack((np.zeros((len(known), len(places))), known[:, len(leg.leg.sensors) :]))
        derivatives[:, :, law.parameter_places] += rows[:, :, places] @ law.by_parameter(known)
    return derivatives


def _closed(
    legs: Sequence[LegClosure], matrices: Array, influences: Array, readings: Array | None = None
) -> tuple[Closure, Array, Mask]:
    """Return closures of alike legs, readings and influences, and which rows are reached."""
    if readings is not None:
        known = np.hstack((readings, influences))
        return nearest_closure(legs, matrices, known)[0], known, np.ones(len(known), dtype=bool)
    closed = close(legs, matrices, influences)

    def reading(leg: LegClosure, joints: Array, columns: Array) -> Array:
        return sensor_law(leg).reading(joints[:, leg.leg.active], columns)

    psi = each(reading, legs, closed.joints, influences)
    return closed.closure, np.hstack((psi, influences)), closed.reached


def leg_demands_at(
    legs: Sequence[LegClosure],
    placed: Sequence[Array],
    readings: Sequence[Array] | None = None,
    influences: Sequence[Array] | None = None,
) -> list[Demand]:
    """Return what legs demand, each at poses of its own: see ``leg_demand``.

    Args:
        legs: The legs at their parameter values.
        placed: Of each leg N poses, matrices (N, 4, 4).
        readings: Of each leg, shape (N, n_active); those of inverse kinematics if not given.
        influences: Of each leg, shape (N, n_influences); at their reference if not given.
    """
    forms = [(leg.form, len(poses)) for leg, poses in zip(legs, placed, strict=True)]
    influences = influences or [np.zeros((len(poses), 0)) for poses in placed]
    demand_of: dict[int, Demand] = {}
    for places in grouped(forms, max(map(len, placed))):
        group, parts = [legs[i] for i in places], []
        for rows in list(chunks(len(placed[places[0]]))) or [slice(0)]:
            matrices, columns = (
                stacked([values[i][rows] for i in places]) for values in (placed, influences)
            )
            psi = stacked([readings[i][rows] for i in places]) if readings else None
            parts.append(_demands_in_reach(group, *_closed(group, matrices, columns, psi)))
        demand_of |= zip(places, map(_joined, zip(*parts, strict=True)), strict=True)
    return [demand_of[place] for place in range(len(legs))]


def _demands_in_reach(
    legs: Sequence[LegClosure], closure: Closure, known: Array, reached: Mask
) -> list[Demand]:
    """Return what alike legs demand, NaN where they are not reached."""
    parts = demands(legs, closure, known)
    if not reached.all():
        for part, at_rows in zip(parts, np.split(reached, len(legs)), strict=True):
            for values in vars(part).values():
                values[~at_rows] = np.nan
    return parts


def _joined(parts: Sequence[Demand]) -> Demand:
    """Return demands of a leg below each other."""
    columns = zip(*(vars(part).values() for part in parts), strict=True)
    return parts[0] if len(parts) == 1 else Demand(*map(np.concatenate, columns))


def leg_demand(
    mechanism: Mechanism,
    leg: str,
    poses: Poses,
    parameters: Array | None = None,
    readings: Array | None = None,
    influences: Array | None = None,
) -> Demand:
    """Return what a leg demands at N poses, nominal parameters unless others are given.

    With readings of inverse kinematics its value is zero, and all is NaN out of reach; with
    readings given, shape (N, n_active), passive joints are where the leg closes best. Influences
    have shape (N, n_influences); they are at their reference if not given.

    Raises:
        MechanismError: unknown leg; poses of a wrong shape, or not finite.
    """
    closure = LegClosure(mechanism.leg(leg), mechanism.platform, parameters)
    measured = (None if columns is None else [columns] for columns in (readings, influences))
    return leg_demands_at((closure,), (mechanism.platform.matrices(poses),), *measured)[0]


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
    placed = mechanism.platform.matrices(poses)
    closure = LegClosure(mechanism.leg(leg), mechanism.platform, parameters)
    law = sensor_law(closure)
    C = np.empty((len(law.slope), len(closure.parameters), len(placed))).transpose(2, 0, 1)
    for rows, matrices in matrix_chunks(placed):
        closed, psi, reached = _closed((closure,), matrices, np.zeros((len(matrices), 0)))
        drive = _by_reading(closure, closed.drive, psi)
        C[rows] = least_squares(
            -drive, _by_parameter(closure, closed.constraint_by_parameter, closed.drive, psi)
        )
        C[rows][~reached] = np.nan
    return C.reshape(-1, C.shape[2])
