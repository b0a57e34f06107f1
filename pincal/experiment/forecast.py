"""What measurements will give before they are made: rank, standard errors, platform error.

At each pose all legs demand e(x, ψ; φ) = 0. Coordinates of the pose that are measured carry
their noise into e, as readings do; coordinates that are not are eliminated by the left
null space of their columns. What is left, whitened, is the information that the best
estimator can draw from the pose: its inverse is the Cramér-Rao bound.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pincal.errors import MeasurementError
from pincal.experiment.observability import Identifiability, identifiability
from pincal.kinematics.closure import solve
from pincal.kinematics.derivatives import Demand, leg_demand
from pincal.model.measurements import Noise
from pincal.model.mechanism import Mechanism

Array = NDArray[np.float64]
_TAKES_PART = 1e-6  # of a direction that the measurements do not tell


@dataclass(frozen=True)
class PlatformError:
    """Root mean square error of the platform over poses; infinite where it is not determined."""

    position: float
    """[m]."""
    orientation: float
    """[rad]; zero for a platform without orientation."""
    poses: int
    """Poses that all legs reach."""


@dataclass(frozen=True)
class Forecast:
    """What a plan of measurements will tell about the parameters of all legs."""

    mechanism: Mechanism
    poses: int
    """Number of poses that all legs reach."""
    measured: tuple[str, ...]
    """Freedoms of the platform that are measured."""
    equations: int
    """Equations that a pose gives."""
    rank: Identifiability
    """Of all parameters together; names are ``parameter (leg)``."""
    covariance: Array
    """Cramér-Rao bound on what is determined, shape (n, n), parameters leg by leg."""
    lost: Array
    """Directions that are not determined, orthonormal columns, shape (n, n_lost)."""

    @cached_property
    def std(self) -> Array:
        """Standard error of each parameter, shape (n,); infinite where it is not determined."""
        blurred = np.abs(self.lost).max(axis=1, initial=0.0) > _TAKES_PART
        return np.where(blurred, np.inf, np.sqrt(np.diagonal(self.covariance)))

    def platform_error(self, poses: Array) -> PlatformError:
        """Return the error to expect of the calibrated platform over poses, shape (N, dof)."""
        return platform_error(self.mechanism, self.covariance, poses, self.lost)

    def poses_for(self, accuracy: float, poses: Array) -> float:
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
        now = self.platform_error(poses).position
        if not np.isfinite(now):
            return np.inf
        least = np.ceil(self.rank.rank / self.equations)
        return float(max(least, np.ceil(self.poses * (now / accuracy) ** 2)))


def forecast(
    mechanism: Mechanism,
    poses: Array,
    noise: Noise | None = None,
    measured: Sequence[str] | None = None,
) -> Forecast:
    """Return what measurements at poses will tell about the parameters of all legs.

    Args:
        mechanism: The mechanism, at its nominal parameters.
        poses: Poses to measure, coordinates of shape (N, dof); all sensors are read.
        noise: Standard deviations of what is measured.
        measured: Freedoms of the platform that are measured (see ``Platform.freedoms``), all
            if not given; axes of the base.

    Raises:
        MeasurementError: unknown freedoms, or measurements without any noise.
        MechanismError: poses of a wrong shape, or not finite.
    """
    noise = noise or Noise()
    platform = mechanism.platform
    kept = platform.freedoms if measured is None else tuple(measured)
    if unknown := [name for name in kept if name not in platform.freedoms]:
        raise MeasurementError(
            f"{mechanism.name!r} has no freedom {unknown[0]!r} to measure; it has "
            f"{', '.join(platform.freedoms)}"
        )
    demands = [leg_demand(mechanism, leg.name, poses) for leg in mechanism.legs]
    by_parameter, by_pose = _stacked(demands)
    by_reading = np.concatenate([row.reading for row in demands], axis=1)
    ok = np.isfinite(by_pose).all(axis=(1, 2)) & np.isfinite(by_parameter).all(axis=(1, 2))
    by_parameter, by_pose, by_reading = by_parameter[ok], by_pose[ok], by_reading[ok]
    known = np.array([name in kept for name in platform.freedoms])
    Q, _ = np.linalg.qr(by_pose[:, :, ~known], mode="complete")
    free = Q[:, :, int((~known).sum()) :].transpose(0, 2, 1)  # rows free of what is not measured
    noisy = by_pose[:, :, known] * noise.of_poses(mechanism)[known]
    variance = noisy @ noisy.transpose(0, 2, 1)
    diagonal = np.arange(by_reading.shape[1])
    variance[:, diagonal, diagonal] += (noise.reading * by_reading) ** 2
    try:
        factor = np.linalg.cholesky(free @ variance @ free.transpose(0, 2, 1))
    except np.linalg.LinAlgError as error:
        raise MeasurementError(
            "some measurements carry no noise at all; give standard deviations above zero for what "
            "is measured, and for readings where positions are measured in part"
        ) from error
    rows = np.asarray(np.linalg.solve(factor, free @ by_parameter))
    rows = rows.reshape(-1, by_parameter.shape[2])
    if not rows.size:
        raise MeasurementError(
            f"{', '.join(kept) or 'nothing'} measured leaves no equation: {mechanism.name!r} has "
            f"{by_pose.shape[1]} sensors for {by_pose.shape[2]} freedoms. Measure more of the "
            "platform"
        )
    names = [f"{name} ({leg.name})" for leg in mechanism.legs for name in leg.parameter_names]
    rank = identifiability(rows, names)
    covariance, lost = _inverse(rows, rank.rank)
    return Forecast(mechanism, int(ok.sum()), kept, free.shape[1], rank, covariance, lost)


def _inverse(rows: Array, rank: int) -> tuple[Array, Array]:
    """Return the pseudo-inverse of the information of rows, and the directions it lacks."""
    n = rows.shape[1]
    scale = np.linalg.norm(rows, axis=0)
    scale[scale == 0.0] = 1.0
    _, s, axes = np.linalg.svd(rows / scale, full_matrices=len(rows) < n)
    axes = axes / scale  # directions in parameters
    kept = axes[:rank] / s[:rank, None]
    lost, _ = np.linalg.qr(axes[rank:].T) if rank < n else (np.empty((n, 0)), None)
    return kept.T @ kept, lost


def platform_error(
    mechanism: Mechanism, covariance: Array, poses: Array, lost: Array | None = None
) -> PlatformError:
    """Return what the covariance of the parameters means for the platform.

    Single parameters may be uncertain and yet well known together. What counts is where the
    platform goes: with e of all legs, δx = −(∂e/∂x)⁻¹ (∂e/∂φ) δφ.

    Args:
        mechanism: The mechanism.
        covariance: Of the parameters of all legs, shape (n, n).
        poses: Poses over which to take the mean, coordinates of shape (N, dof).
        lost: Directions of parameters that are not determined, columns of shape (n, n_lost).

    Raises:
        MechanismError: poses of a wrong shape, or not finite.
    """
    by_parameter, by_pose = _stacked([leg_demand(mechanism, n, poses) for n in mechanism.leg_names])
    if by_pose.shape[1] != by_pose.shape[2]:  # more legs than freedoms: least squares
        transposed = by_pose.transpose(0, 2, 1)
        by_pose, by_parameter = transposed @ by_pose, transposed @ by_parameter
    ok = np.isfinite(by_pose).all(axis=(1, 2))
    gain = solve(by_pose[ok], by_parameter[ok])
    variance = np.einsum("nip,pq,niq->ni", gain, covariance, gain).mean(axis=0)
    if lost is not None and lost.shape[1]:
        slides = np.abs(gain @ lost).max(axis=(0, 2)) > _TAKES_PART * np.abs(gain).max(axis=(0, 2))
        variance = np.where(slides, np.inf, variance)
    linear = np.array([unit == "m" for unit in mechanism.platform.units])
    return PlatformError(
        float(np.sqrt(variance[linear].sum())),
        float(np.sqrt(variance[~linear].sum())),
        int(ok.sum()),
    )


def _stacked(demands: list[Demand]) -> tuple[Array, Array]:
    """Return ∂e/∂φ and ∂e/∂x of all legs, shapes (N, n_rows, n_params) and (N, n_rows, dof)."""
    by_pose = np.concatenate([row.pose for row in demands], axis=1)
    sizes = [row.parameter.shape[2] for row in demands]
    by_parameter = np.zeros((*by_pose.shape[:2], sum(sizes)))
    row, column = 0, 0
    for demand, size in zip(demands, sizes, strict=True):
        k = demand.parameter.shape[1]
        by_parameter[:, row : row + k, column : column + size] = demand.parameter
        row, column = row + k, column + size
    return by_parameter, by_pose
