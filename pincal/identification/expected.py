"""The platform error to expect of a calibration, by the covariance of its parameters."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pincal.experiment.platform_error import PlatformError, platform_error
from pincal.identification.result import CalibrationResult

Array = NDArray[np.float64]


def expected_error(result: CalibrationResult, poses: Array) -> PlatformError:
    """Return the platform error to expect of the calibrated mechanism.

    Where frames were fixed by choice, less what a motion of these frames explains.

    Args:
        result: The calibration.
        poses: Poses over which to take the mean, coordinates of shape (N, dof).

    Raises:
        MechanismError: poses of a wrong shape, or not finite.
    """
    return platform_error(
        result.identified,
        result.covariance,
        poses,
        lost=result.undetermined_directions,
        frames=result.frames_moved,
    )
