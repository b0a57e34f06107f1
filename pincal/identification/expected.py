"""The platform error to expect of a calibration, by the covariance of its parameters."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pincal.design.platform_error import PlatformError, platform_error, slides
from pincal.identification.result import CalibrationResult

Array = NDArray[np.float64]


def expected_error(result: CalibrationResult, poses: Array) -> PlatformError:
    """Return the platform error to expect of the calibrated mechanism.

    Where frames were fixed by choice, less what a motion of these frames explains. Infinite where
    what was held, as the measurements do not tell it, moves the platform at one of the poses.

    Args:
        result: The calibration.
        poses: Poses over which to take the mean, coordinates of shape (N, dof).

    Raises:
        MechanismError: poses of a wrong shape, or not finite.
    """
    found = platform_error(result.identified, result.covariance, poses, frames=result.frames_moved)
    lost = result.undetermined_directions
    if lost is None:
        return found
    linear = np.array([unit == "m" for unit in result.nominal.platform.units])
    least = np.where(linear, found.position, found.orientation)
    untold = np.asarray(slides(result.nominal, poses, lost, least).any(axis=0))
    return replace(
        found,
        position=np.inf if untold[linear].any() else found.position,
        orientation=np.inf if untold[~linear].any() else found.orientation,
    )
