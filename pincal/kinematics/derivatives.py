"""What one leg demands of pose, reading and parameters, linearised: the rows of identification.

A closed leg demands e = Nᵀ c(x, θ(ψ), p; φ) = 0. Its derivatives in parameters φ, pose x
and reading ψ give both residuals in use: the closure residual e itself, and the joint
residual (predicted less measured reading), whose rows are those of e over −∂e/∂ψ.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from pincal.kinematics.closure import Closure, LegClosure, least_squares, product
from pincal.kinematics.held import held
from pincal.kinematics.inverse import CHUNK, close, sensor_law
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

        They are (∂e/∂ψ)⁻¹ times those of e, of least squares where e has more rows than readings.
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


def demand(leg: LegClosure, closure: Closure, readings: Array) -> Demand:
    """Return what a leg demands, from its closure and the readings, shape (N, n_active)."""
    law = sensor_law(leg)
    return Demand(
        closure.constraint,
        closure.project(closure.parameter) + product(closure.drive, law.by_parameter(readings)),
        closure.project(closure.pose),
        closure.drive * law.slope,
    )


def demand_chunks(
    mechanism: Mechanism,
    leg: str,
    poses: Poses,
    parameters: Array | None = None,
    readings: Array | None = None,
) -> Iterator[tuple[slice, Demand]]:
    """Yield what a leg demands at poses, in chunks of bounded memory; NaN where out of reach.

    Args:
        mechanism: The mechanism.
        leg: Name of the leg.
        poses: N platform poses.
        parameters: Parameter values of the leg, shape (n_params,); nominal if not given.
        readings: Of the leg at these poses, shape (N, n_active); those of inverse kinematics if
            not given.

    Raises:
        MechanismError: unknown leg; poses of a wrong shape, or not finite.
    """
    transforms = mechanism.platform.transforms(poses)
    closure = LegClosure(mechanism.leg(leg), mechanism.platform, parameters)
    for begin in range(0, len(transforms), CHUNK):
        rows = slice(begin, min(begin + CHUNK, len(transforms)))
        matrices = transforms[rows].as_matrix()
        if readings is not None:
            told, _ = held(closure, matrices, readings[rows])
            yield rows, demand(closure, told, readings[rows])
            continue
        closed = close(closure, matrices)
        psi = sensor_law(closure).reading(closed.joints[:, closure.leg.active])
        part = demand(closure, closed.closure, psi)
        for array in (part.value, part.parameter, part.pose, part.reading):
            array[~closed.reached] = np.nan
        yield rows, part


def leg_demand(
    mechanism: Mechanism,
    leg: str,
    poses: Poses,
    parameters: Array | None = None,
    readings: Array | None = None,
) -> Demand:
    """Return what a leg demands at poses that it reaches: value zero, NaN where out of reach.

    Arguments and errors are those of ``demand_chunks``.
    """
    parts = [part for _, part in demand_chunks(mechanism, leg, poses, parameters, readings)]
    if not parts:
        one, dof = mechanism.leg(leg), mechanism.platform.dof
        k = len(mechanism.platform.closing(one.closes)) - len(one.passive)
        sizes = (len(one.parameters), dof, len(one.sensors))
        return Demand(np.empty((0, k)), *(np.empty((0, k, size)) for size in sizes))
    return Demand(
        *(np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(Demand))
    )


def identification_jacobian(
    mechanism: Mechanism, leg: str, poses: Poses, parameters: Array | None = None
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
    """
    transforms = mechanism.platform.transforms(poses)
    one = mechanism.leg(leg)
    C = np.empty((len(transforms), len(one.sensors), len(one.parameters)))
    for rows, part in demand_chunks(mechanism, leg, transforms, parameters):
        C[rows] = -least_squares(part.reading, part.parameter)
    return C.reshape(-1, len(one.parameters))
