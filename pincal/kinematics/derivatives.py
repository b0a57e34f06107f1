"""What one leg demands of pose, reading and parameters, linearised: the rows of identification.

A closed leg demands e = Nᵀ c(x, θ(ψ), p; φ) = 0. Its derivatives in parameters φ, pose x
and reading ψ give both residuals in use: the closure residual e itself, and the joint
residual (predicted less measured reading), whose rows are those of e over −∂e/∂ψ.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from pincal.files.mechanism_folders import GivenMechanism, as_mechanism
from pincal.kinematics.batches import least_squares, product
from pincal.kinematics.closing import close, matrix_chunks, sensor_law
from pincal.kinematics.closure import Closure, LegClosure
from pincal.kinematics.nearest_closure import each, nearest_closure
from pincal.model.mechanism import Mechanism
from pincal.model.platform import Poses

Array = NDArray[np.float64]


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


def demand(leg: LegClosure, closure: Closure, known: Array) -> Demand:
    """Return what a leg demands, from its closure and what is known of readings and influences.

    Args:
        leg: The leg at its parameter values.
        closure: Its closure at N configurations.
        known: Readings, then influences, shape (N, n_active [+ n_influences]).
    """
    return demands((leg,), closure, (known,))[0]


def demands(legs: Sequence[LegClosure], closure: Closure, known: Sequence[Array]) -> list[Demand]:
    """Return what each of some alike legs demands, from their closures: see ``demand``.

    Args:
        legs: L legs of one form at their parameter values.
        closure: Their closures at N configurations, rows of each below the one before.
        known: Of each leg readings, then influences, shape (N, n_active [+ n_influences]).
    """
    value, rows_of = closure.constraint, each(len(legs), len(closure.gap))
    rows, drive, pose = closure.constraint_by_parameter, closure.drive, closure.constraint_by_pose
    found = []
    for own, leg, said in zip(rows_of, legs, known, strict=True):
        reading = drive[own] * sensor_law(leg).slopes(said)[..., None, :]
        by_parameter = _by_parameter(leg, rows[own], drive[own], said)
        found.append(Demand(value[own], by_parameter, pose[own], reading))
    return found


def _by_parameter(leg: LegClosure, rows: Array, drive: Array, known: Array) -> Array:
    """Return ∂e/∂φ, shape (N, k, n_params): of the geometry, of the sensors, and of deformations.

    A deformation is added to its parameter, so ∂e/∂a = ∂e/∂p · b.
    """
    found = rows + product(drive, sensor_law(leg).by_parameter(known))
    if leg.leg.deformed:
        by = leg.deformations.by_parameter(known[:, len(leg.leg.sensors) :])
        found += rows[:, :, leg.deformations.parameters] @ by
    return found


def _closed_chunks(
    leg: LegClosure,
    placed: RigidTransform | Array,
    readings: Array | None = None,
    influences: Array | None = None,
) -> Iterator[tuple[slice, Closure, Array, NDArray[np.bool_]]]:
    """Yield rows, closure, what is known and which rows are reached, in chunks of bounded memory.

    Known are readings, and influences if there are any.
    """
    for rows, matrices in matrix_chunks(placed):
        more = np.zeros((len(matrices), 0)) if influences is None else influences[rows]
        if readings is not None:
            known = np.hstack((readings[rows], more))
            closure, _ = nearest_closure(leg, matrices, known)
            yield rows, closure, known, np.ones(len(matrices), dtype=bool)
            continue
        closed = close(leg, matrices, more)
        psi = sensor_law(leg).reading(closed.joints[:, leg.leg.active], more)
        yield rows, closed.closure, np.hstack((psi, more)), closed.reached


def leg_demand(
    mechanism: Mechanism,
    leg: str,
    poses: Poses,
    parameters: Array | None = None,
    readings: Array | None = None,
    influences: Array | None = None,
) -> Demand:
    """Return what a leg demands at poses that it reaches: value zero, NaN where out of reach.

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
    placed = mechanism.platform.placed(poses)
    return leg_demand_at(mechanism, leg, placed, parameters, readings, influences)


def leg_demand_at(
    mechanism: Mechanism,
    leg: str,
    placed: RigidTransform | Array,
    parameters: Array | None = None,
    readings: Array | None = None,
    influences: Array | None = None,
) -> Demand:
    """Return what a leg demands at transforms, or matrices (N, 4, 4): see ``leg_demand``."""
    platform, one = mechanism.platform, mechanism.leg(leg)
    closure = LegClosure(one, platform, parameters)
    count, k = len(placed), len(platform.closing(one.closes)) - len(one.passive)
    sizes = (len(one.parameters), platform.dof, len(one.sensors))
    whole = Demand(np.empty((count, k)), *(np.empty((count, k, size)) for size in sizes))
    for rows, closed, known, reached in _closed_chunks(closure, placed, readings, influences):
        part = demand(closure, closed, known)
        for target, values in zip(vars(whole).values(), vars(part).values(), strict=True):
            target[rows] = values
            if not reached.all():
                target[rows][~reached] = np.nan
    return whole


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
    C = np.empty((len(placed), len(law.slope), len(closure.parameters)))
    for rows, closed, psi, reached in _closed_chunks(closure, placed):
        drive = closed.drive * law.slopes(psi)[..., None, :]
        C[rows] = least_squares(
            -drive, _by_parameter(closure, closed.constraint_by_parameter, closed.drive, psi)
        )
        C[rows][~reached] = np.nan
    return C.reshape(-1, C.shape[2])
