"""What configurations say of the parameters: conditions, freed of the pose and whitened.

At each pose all legs demand e(x, ψ; φ) = 0, and something is measured of the platform. The Gram
matrix of these rows, freed of the pose and whitened, is the information that the best estimator
draws from the pose. Of a leg alone, with poses as measured, the rows are e, whitened by what the
noise of pose and readings does to it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from pincal.errors import MeasurementError
from pincal.estimation.observability.gauge import split_frames
from pincal.estimation.observability.indices import GENERIC
from pincal.estimation.observation import Observation
from pincal.estimation.rows import NoNoiseError, white_rows
from pincal.estimation.unknowns import ExternalUnknowns
from pincal.kinematics.closure import largest_size
from pincal.kinematics.configurations import Legs, legs_at, nearby
from pincal.kinematics.derivatives import Demand
from pincal.model.checks import described
from pincal.model.measurements import Measurements, Noise, Plan
from pincal.model.mechanism import Mechanism
from pincal.model.setup import Setup
from pincal.types import Array


def parameter_ids(mechanism: Mechanism) -> tuple[str, ...]:
    """Return the ids of all parameters, leg by leg: ``leg_1.l``."""
    return tuple(name for leg in mechanism.legs for name in leg.parameter_ids)


def leg_rows(demand: Demand, mechanism: Mechanism, noise: Noise) -> Array:
    """Return the whitened rows of a leg alone by its parameters, poses as measured, (N, k, n).

    NaN where out of reach.

    Raises:
        MeasurementError: a residual has no noise.
    """
    by_pose, by_reading = demand.pose * noise.of_poses(mechanism), demand.reading * noise.reading
    root = np.concatenate((by_pose, by_reading), axis=2)
    try:
        return white_rows(demand.pose[:, :, :0], root)(demand.parameter)
    except NoNoiseError as error:
        raise MeasurementError(
            "a residual has no noise at all; give a standard deviation above zero for position, "
            "orientation or reading (only their ratios matter to the choice)"
        ) from error


def information_rows(
    mechanism: Mechanism,
    legs: Legs,
    noise: Noise,
    measured: Sequence[str] | None,
    setup: Setup,
) -> tuple[Array, Array, tuple[str, ...], tuple[str, ...]]:
    """Return what configurations say of parameters and external unknowns, pose by pose.

    Rows free of the poses and whitened, shape (N, k, n): their Gram matrix is the information.
    Errors of these by what is off in all rows, one standard uncertainty each, shape (N, k, q). Ids
    of the unknowns. Names of what is measured.

    Args:
        mechanism: The mechanism.
        legs: What all legs demand there.
        noise: Standard deviations of what is measured.
        measured: See ``forecast``.
        setup: What measured numbers will mean.

    Raises:
        MeasurementError: unknown freedoms, or measurements without noise or equations.
    """
    platform = mechanism.platform
    matrices = platform.matrices(legs.poses)
    by_pose, by_external, systematic, scatter, names = _planned(
        mechanism, matrices, noise, measured, setup
    )
    (count, n_rows, n_legs), n_readings = legs.parameter.shape, legs.reading.shape[2]
    # ┌ A          0        ┐  legs           ┌ B ┐   ┌ σ ∂e/∂ψ    ┐
    # └ 0  by external      ┘  what is seen   └ B ┘   └          σ ┘
    width, kinds = scatter.shape[1:]
    parameter = np.zeros((count, n_rows + width, n_legs + by_external.shape[2]))
    parameter[:, :n_rows, :n_legs] = legs.parameter
    parameter[:, n_rows:, n_legs:] = by_external
    errors = np.zeros((count, n_rows + width, systematic.shape[2]))
    errors[:, n_rows:] = systematic
    root = np.zeros((count, n_rows + width, n_readings + kinds))
    root[:, :n_rows, :n_readings] = noise.reading * legs.reading
    root[:, n_rows:, n_readings:] = scatter
    try:
        white = white_rows(np.concatenate((legs.pose, by_pose), axis=1), root)
    except NoNoiseError as error:
        raise MeasurementError(
            "some measurements carry no noise at all; give standard deviations above zero for what "
            "is measured, and for readings (--noise-reading) where there are more of them than "
            "freedoms, or positions are measured in part"
        ) from error
    rows = white(parameter)
    if not rows.size:
        raise MeasurementError(
            f"{', '.join(names) or 'nothing'} measured leaves no equation: {mechanism.name!r} has "
            f"{n_rows} equations for {platform.dof} freedoms. Measure more of the platform"
        )
    oriented = bool(set(names) & set(platform.freedoms[platform.units.count("m") :]))
    external = ExternalUnknowns(platform, setup, oriented).names
    unknowns = (*parameter_ids(mechanism), *external)
    return rows, white(errors), unknowns, names


def _planned(
    mechanism: Mechanism,
    matrices: Array,
    noise: Noise,
    measured: Sequence[str] | None,
    setup: Setup,
) -> tuple[Array, Array, Array, Array, tuple[str, ...]]:
    """Return derivatives by pose and externals, what is off, roots of the noise, and names."""
    platform, count = mechanism.platform, len(matrices)
    columns = dict.fromkeys(setup.columns(mechanism), np.zeros(count))
    offered = (*platform.freedoms, *columns)
    if measured is not None and not isinstance(measured, Iterable):
        raise MeasurementError(
            f"measured: expected names of {', '.join(offered)}; got {described(measured)}"
        )
    names = offered if measured is None else tuple(measured)
    if unknown := [name for name in names if name not in offered]:
        raise MeasurementError(
            f"{mechanism.name!r} has no freedom {unknown[0]!r} to measure; it has "
            f"{', '.join(offered)}"
        )
    coordinates = platform.from_matrices(matrices)
    turning = platform.freedoms[platform.units.count("m") :]
    if not set(names) & set(turning):
        coordinates[:, platform.units.count("m") :] = np.nan
    data = Measurements(
        poses=coordinates, readings=np.zeros((count, len(mechanism.reading_names))), extra=columns
    )
    observation = Observation(mechanism, data, setup)
    value, *slopes = observation.residuals(matrices, observation.external.start)
    chosen = [observation.names.index(name) for name in names]
    predicted = {name: value[:, observation.names.index(name)] for name in columns}
    planned = replace(data, extra=predicted)  # less what was measured: zero
    by_pose, by_external = (rows[:, chosen] for rows in slopes)
    systematic = observation.systematic(matrices, observation.external.start)
    return (
        by_pose,
        by_external,
        systematic[:, chosen],
        observation.row_noise(planned, noise).roots[:, chosen],
        names,
    )


def null_directions(lengths: Array, axes: Array, rank: int) -> Array:
    """Return what rows do not determine, columns of shape (n, n_lost); see ``scaled_axes``."""
    return np.asarray(np.linalg.qr((axes[rank:] / lengths).T)[0])


def apart_from_frames(mechanism: Mechanism, legs: Legs, lost: Array) -> tuple[Array, Array, Array]:
    """Return freedoms of frames among lost directions, (n, n_lost), the others, these motions.

    Legs are at the poses to measure.
    """
    platform, size = mechanism.platform, largest_size(mechanism.legs)
    reached = Plan(legs.poses, readings=legs.readings)
    near = legs_at(mechanism, nearby(mechanism, reached, GENERIC, size))
    matrices = platform.matrices(near.poses)
    gauge, undetermined, moved = split_frames(platform, matrices, near.gain, lost, size)
    if gauge.shape[1]:  # which does not count: what is lost takes no part of it
        undetermined = undetermined - gauge @ np.linalg.lstsq(gauge, undetermined, rcond=None)[0]
    return gauge, undetermined, moved
