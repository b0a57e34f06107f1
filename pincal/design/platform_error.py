"""What uncertain parameters mean for the platform: the error of where it goes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pincal.estimation.frames import beyond, frame_motions
from pincal.kinematics.closure import largest_size
from pincal.kinematics.configurations import legs_at
from pincal.model.measurements import Plan
from pincal.model.mechanism import Mechanism

Array = NDArray[np.float64]
_SLIDES = 1e-6  # of the largest motion, from which a direction is said to move the platform


@dataclass(frozen=True)
class PlatformError:
    """Root mean square error of the platform over poses; infinite where it is not determined."""

    position: float
    """[m]."""
    orientation: float
    """[rad]; zero for a platform without orientation."""
    poses: int
    """Poses that all legs reach."""


def platform_error(
    mechanism: Mechanism,
    covariance: Array,
    planned: Plan | Array,
    lost: Array | None = None,
    frames: Array | None = None,
) -> PlatformError:
    """Return what the covariance of the parameters means for the platform.

    Single parameters may be uncertain and yet well known together. What counts is where the
    platform goes: with e of all legs, δx = −(∂e/∂x)⁻¹ (∂e/∂φ) δφ.

    Args:
        mechanism: The mechanism.
        covariance: Of the parameters of all legs, shape (n, n).
        planned: Poses over which to take the mean, coordinates of shape (N, dof), or a plan.
        lost: Directions of parameters that are not determined, columns of shape (n, n_lost).
        frames: Motions of frames that are not measured (see ``frames_moved``), shape (k, n_moved):
            what they explain is left out.

    Raises:
        MechanismError: poses of a wrong shape, or not finite.
    """
    legs = legs_at(mechanism, planned)
    gain = legs.gain
    if frames is not None and frames.shape[1]:
        size = largest_size(mechanism.legs, mechanism.platform)
        matrices = mechanism.platform.transforms(legs.poses).as_matrix()
        motions = frame_motions(mechanism.platform, matrices) @ frames
        gain = beyond(mechanism.platform, gain, motions, size)
    variance = np.einsum("nip,pq,niq->ni", gain, covariance, gain).mean(axis=0)
    if lost is not None and lost.shape[1]:
        variance = np.where(_sliding(gain, lost).any(axis=0), np.inf, variance)
    linear = np.array([unit == "m" for unit in mechanism.platform.units])
    return PlatformError(
        float(np.sqrt(variance[linear].sum())),
        float(np.sqrt(variance[~linear].sum())),
        len(gain),
    )


def slides(
    mechanism: Mechanism, planned: Plan | Array, lost: Array, least: Array
) -> NDArray[np.bool_]:
    """Return at which planned configurations which freedoms are not told, shape (M, dof).

    Args:
        mechanism: The mechanism at which directions were found to be lost.
        planned: Poses, coordinates of shape (M, dof), or a plan.
        lost: Directions of parameters that are not determined, as far as these may differ from
            nominal, columns of shape (n, n_lost).
        least: By how much each freedom is uncertain anyway, shape (dof,), [m] and [rad].
    """
    legs = legs_at(mechanism, planned)
    found = np.zeros((len(legs.reached), mechanism.platform.dof), dtype=bool)
    found[legs.reached] = _sliding(legs.gain, lost, least)
    return found


def _sliding(gain: Array, lost: Array, least: Array | float = 0.0) -> NDArray[np.bool_]:
    """Return where lost directions move the platform, shape (N, dof)."""
    most = np.abs(gain).max(axis=(0, 2), initial=0.0) * np.abs(lost).max(initial=0.0)
    moved = np.abs(gain @ lost).max(axis=2, initial=0.0)
    return np.asarray(moved > np.maximum(_SLIDES * most, least))
