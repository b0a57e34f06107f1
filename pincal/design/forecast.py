"""What measurements will give before they are made: rank, standard errors, platform error.

At each pose all legs demand e(x, ψ; φ) = 0, and something is measured of the platform. The pose
is eliminated from these rows by the left null space of its columns. What is left, whitened by
the noise that it carries, is the information that the best estimator can draw from the pose:
its inverse is the Cramér-Rao bound.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pincal.design.platform_error import PlatformError, platform_error
from pincal.errors import MeasurementError
from pincal.estimation.external import ExternalUnknowns
from pincal.estimation.frames import frames_moved, split_frames
from pincal.estimation.observability import Identifiability, identifiability, scaled_axes
from pincal.estimation.observation import Observation, Rows
from pincal.estimation.weak import WeakPair, weakly_told
from pincal.kinematics.closure import largest_size
from pincal.kinematics.configurations import Legs, check_reached, legs_at, nearby
from pincal.model.measurements import Measurements, Noise, Plan
from pincal.model.mechanism import Mechanism
from pincal.model.platform import Platform
from pincal.model.setup import Setup

Array = NDArray[np.float64]
_GENERIC = 100  # poses at which frames are told from parameters, at least
_TAKES_PART = 1e-6  # of a direction that the measurements do not tell


@dataclass(frozen=True)
class Forecast:
    """What a plan of measurements will tell about the parameters of all legs."""

    mechanism: Mechanism
    poses: int
    """Number of poses that all legs reach."""
    measured: tuple[str, ...]
    """What is measured of the platform."""
    equations: int
    """Equations that a pose gives."""
    rank: Identifiability
    """Of all parameters and external unknowns together; names are ``leg.parameter``."""
    covariance: Array
    """Cramér-Rao bound on what is determined, shape (n, n), parameters leg by leg."""
    lost: Array
    """Directions that are not determined, columns of shape (n, n_lost)."""
    gauge: Array
    """Directions that only move frames that are not measured, columns of shape (n, n_gauge):
    parameters are those nearest to the nominal ones."""

    frames: Array
    """Motions of frames that these are (see ``frames_moved``), shape (k, n_moved)."""

    @cached_property
    def std(self) -> Array:
        """Standard error of each parameter, shape (n,); infinite where it is not determined."""
        blurred = np.abs(self.lost).max(axis=1, initial=0.0) > _TAKES_PART
        return np.where(blurred, np.inf, np.sqrt(np.diagonal(self.covariance)))

    @cached_property
    def weak(self) -> tuple[WeakPair, ...]:
        """Parameters that are determined, but weakly told apart, the weakest first."""
        names = [(leg.name, name) for leg in self.mechanism.legs for name in leg.parameter_names]
        determined = np.isfinite(self.std)
        clear = np.outer(determined, determined)
        return weakly_told(names, np.where(clear, self.covariance, 0.0), self.gauge)

    def platform_error(self, poses: Plan | Array) -> PlatformError:
        """Return the error to expect of the calibrated platform over poses, shape (N, dof).

        Where frames are not measured, less what a motion of the frames explains.
        """
        return platform_error(self.mechanism, self.covariance, poses, self.lost, self.frames)

    def poses_for(self, accuracy: float, poses: Plan | Array) -> float:
        """Return how many poses like the planned ones bring the position error to a value.

        Errors fall with the root of the number of poses. Infinite if no number does.

        Args:
            accuracy: Wanted root mean square position error over ``poses``, [m].
            poses: Where the platform is to be accurate, shape (N, dof).

        Raises:
            MeasurementError: an accuracy that is not positive.
        """
        if not accuracy > 0.0:
            raise MeasurementError(f"the wanted accuracy is {accuracy:g} m; expected more than 0")
        least = np.ceil(self.rank.rank / self.equations)
        now = self.platform_error(poses).position
        return float(max(least, poses_needed(self.poses, now, accuracy)))


def poses_needed(count: int, error: float, accuracy: float) -> float:
    """Return how many poses bring an error to an accuracy if ``count`` of them give the error.

    Errors fall with the root of the number of poses; infinite if no number does.
    """
    return float(np.ceil(count * (error / accuracy) ** 2))


def forecast(
    mechanism: Mechanism,
    poses: Plan | Array,
    noise: Noise | None = None,
    measured: Sequence[str] | None = None,
    setup: Setup | None = None,
) -> Forecast:
    """Return what measurements at poses will tell about the parameters of all legs.

    Args:
        mechanism: The mechanism, at its nominal parameters.
        poses: Poses to measure, coordinates of shape (N, dof), or a plan; all sensors are read.
        noise: Standard deviations of what is measured.
        measured: Freedoms of the platform that are measured (see ``Platform.freedoms``; axes of
            the measurements' frame) and columns of the setup; all if not given.
        setup: What measured numbers will mean: unknown frame, targets, distances.

    Raises:
        MeasurementError: unknown freedoms, measurements without any noise, or no pose in reach.
        MechanismError: poses of a wrong shape, or not finite.
    """
    noise, setup, platform = noise or Noise(), setup or Setup(), mechanism.platform
    legs = legs_at(mechanism, poses)
    if not len(legs.poses):
        check_reached(mechanism, poses)
    rows, unknowns, kept = information_rows(mechanism, legs, noise, measured, setup)
    n = rows.shape[2]
    n_legs = legs.parameter.shape[2]
    flat = rows.reshape(-1, n)
    rank = identifiability(flat, unknowns)
    covariance, lost = _inverse(flat, rank.rank)
    size = largest_size(mechanism.legs, platform)
    plan = Plan(legs.poses, readings=legs.readings)
    near = legs_at(mechanism, nearby(mechanism, plan, _GENERIC, size))
    there = platform.transforms(near.poses).as_matrix()
    gauge, lost = split_frames(platform, there, near.gain, lost[:n_legs], size)
    if gauge.shape[1]:  # which does not count: what is lost takes no part of it
        lost = lost - gauge @ np.linalg.lstsq(gauge, lost, rcond=None)[0]
    return Forecast(
        mechanism,
        len(legs.poses),
        kept,
        rows.shape[1],
        rank,
        covariance[:n_legs, :n_legs],
        lost,
        gauge,
        frames_moved(platform, there, near.gain, gauge),
    )


def information_rows(
    mechanism: Mechanism,
    legs: Legs,
    noise: Noise,
    measured: Sequence[str] | None,
    setup: Setup,
) -> tuple[Array, list[str], tuple[str, ...]]:
    """Return what configurations tell about parameters and external unknowns, pose by pose.

    Rows free of the poses and whitened, shape (N, k, n): their Gram matrix is the information.

    Args:
        mechanism: The mechanism.
        legs: What all legs demand there.
        noise: Standard deviations of what is measured.
        measured: See ``forecast``.
        setup: What measured numbers will mean.

    Returns:
        The rows, the names of the unknowns, and what is measured.

    Raises:
        MeasurementError: unknown freedoms, or measurements without noise or equations.
    """
    platform = mechanism.platform
    matrices = platform.transforms(legs.poses).as_matrix()
    seen, sigma, kept = _planned(mechanism, matrices, noise, measured, setup)
    (count, n_rows, n_legs), n_readings = legs.parameter.shape, legs.reading.shape[2]
    parameter = np.zeros((count, n_rows + len(sigma), n_legs + seen.external.shape[2]))
    parameter[:, :n_rows, :n_legs] = legs.parameter
    parameter[:, n_rows:, n_legs:] = seen.external
    pose = np.concatenate((legs.pose, seen.pose), axis=1)
    root = np.zeros((count, n_rows + len(sigma), n_readings + len(sigma)))
    root[:, :n_rows, :n_readings] = noise.reading * legs.reading
    root[:, n_rows:, n_readings:] = np.diag(sigma)
    rows = _whitened(pose, parameter, root)
    if not rows.size:
        raise MeasurementError(
            f"{', '.join(kept) or 'nothing'} measured leaves no equation: {mechanism.name!r} has "
            f"{n_rows} equations for {pose.shape[2]} freedoms. Measure more of the platform"
        )
    names = [f"{leg.name}.{name}" for leg in mechanism.legs for name in leg.parameter_names]
    return rows, [*names, *seen_names(platform, setup, kept)], kept


def seen_names(platform: Platform, setup: Setup, measured: Sequence[str]) -> tuple[str, ...]:
    """Return the names of the external unknowns of planned measurements."""
    oriented = any(name in platform.freedoms[platform.units.count("m") :] for name in measured)
    return ExternalUnknowns(platform, setup, oriented).names


def _planned(
    mechanism: Mechanism,
    matrices: Array,
    noise: Noise,
    measured: Sequence[str] | None,
    setup: Setup,
) -> tuple[Rows, Array, tuple[str, ...]]:
    """Return the rows of planned measurements, their standard deviations, and their names.

    Raises:
        MeasurementError: unknown freedoms.
    """
    platform, count = mechanism.platform, len(matrices)
    columns = dict.fromkeys(setup.columns(mechanism), np.zeros(count))
    offered = (*platform.freedoms, *columns)
    kept = offered if measured is None else tuple(measured)
    if unknown := [name for name in kept if name not in offered]:
        raise MeasurementError(
            f"{mechanism.name!r} has no freedom {unknown[0]!r} to measure; it has "
            f"{', '.join(offered)}"
        )
    coordinates = platform.from_matrices(matrices)
    turning = platform.freedoms[platform.units.count("m") :]
    if not set(kept) & set(turning):
        coordinates[:, platform.units.count("m") :] = np.nan
    data = Measurements(
        poses=coordinates, readings=np.zeros((count, len(mechanism.reading_names))), extra=columns
    )
    observation = Observation(mechanism, data, setup)
    rows = observation.evaluate(matrices, observation.external.start)
    chosen = [observation.names.index(name) for name in kept]
    some = Rows(rows.value[:, chosen], rows.pose[:, chosen], rows.external[:, chosen])
    sigma = observation.sigma(data, noise)[0, chosen] if count else np.zeros(len(chosen))
    return some, sigma, kept


def _whitened(pose: Array, parameter: Array, root: Array) -> Array:
    """Return rows free of the poses, over their noise, shape (N, k, n).

    Args:
        pose: Derivatives by the pose, shape (N, r, dof).
        parameter: By parameters and external unknowns, shape (N, r, n).
        root: Of the rows' covariance, how they follow what is measured, shape (N, r, s).

    Raises:
        MeasurementError: rows without noise.
    """
    Q, _ = np.linalg.qr(pose, mode="complete")
    free = Q[:, :, pose.shape[2] :].transpose(0, 2, 1)
    noisy = free @ root
    try:
        factor = np.linalg.cholesky(noisy @ noisy.transpose(0, 2, 1))
    except np.linalg.LinAlgError as error:
        raise MeasurementError(
            "some measurements carry no noise at all; give standard deviations above zero for what "
            "is measured, and for readings (--noise-reading) where there are more of them than "
            "freedoms, or positions are measured in part"
        ) from error
    return np.asarray(np.linalg.solve(factor, free @ parameter))


def _inverse(rows: Array, rank: int) -> tuple[Array, Array]:
    """Return the pseudo-inverse of the information of rows, and the directions it lacks."""
    n = rows.shape[1]
    scale, s, axes = scaled_axes(rows)
    axes = axes / scale  # directions in parameters
    kept = axes[:rank] / s[:rank, None]
    lost, _ = np.linalg.qr(axes[rank:].T) if rank < n else (np.empty((n, 0)), None)
    return kept.T @ kept, lost
