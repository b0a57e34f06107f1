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
from pincal.kinematics.batches import block_diagonal
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
    of the unknowns. Names of what is measured (see ``forecast``).

    Raises:
        MeasurementError: unknown freedoms, or measurements without noise or equations.
    """
    platform, count = mechanism.platform, len(legs.poses)
    matrices, turning = platform.matrices(legs.poses), platform.freedoms[platform.lengths :]
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
    if not set(names) & set(turning):
        coordinates[:, platform.lengths :] = np.nan
    readings = np.zeros((count, legs.reading.shape[2]))
    data = Measurements(poses=coordinates, readings=readings, extra=columns)
    observation = Observation(mechanism, data, setup)
    start, chosen = observation.external.start, [observation.names.index(name) for name in names]
    value, *slopes = observation.residuals(matrices, start)
    by_pose, by_external = (rows[:, chosen] for rows in slopes)
    predicted = {name: value[:, observation.names.index(name)] for name in columns}
    planned = replace(data, extra=predicted)  # less what was measured: zero
    scatter = observation.row_noise(planned, noise).roots[:, chosen]
    # ┌ A          0        ┐  legs           ┌ B ┐   ┌ σ ∂e/∂ψ    ┐
    # └ 0  by external      ┘  what is seen   └ B ┘   └          σ ┘
    pose = np.concatenate((legs.pose, by_pose), axis=1)
    n_rows = legs.parameter.shape[1]
    try:
        white = white_rows(pose, block_diagonal((noise.reading * legs.reading, scatter)))
    except NoNoiseError as error:
        raise MeasurementError(
            "some measurements carry no noise at all; give standard deviations above zero for what "
            "is measured, and for readings (--noise-reading) where there are more of them than "
            "freedoms, or positions are measured in part"
        ) from error
    rows = white(block_diagonal((legs.parameter, by_external)))
    if not rows.size:
        raise MeasurementError(
            f"{', '.join(names) or 'nothing'} measured leaves no equation: {mechanism.name!r} has "
            f"{n_rows} equations for {platform.dof} freedoms. Measure more of the platform"
        )
    off = observation.systematic(matrices, start)[:, chosen]
    errors = white(np.pad(off, ((0, 0), (n_rows, 0), (0, 0))))
    return rows, errors, (*parameter_ids(mechanism), *observation.external.names), names


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
