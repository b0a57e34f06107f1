"""What a drift over the run would do: bias by the order of the poses, which no residual may show.

Each measured quantity and each reading drifts in turn, linearly by one standard deviation over the
run, about its middle. Parameters follow by δ = Σ K_n t_n, K_n their influence at pose n and t_n the
time there: in turns that averages out, leg after leg it does not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pincal.design.forecast import Forecast
from pincal.design.information import parameter_ids
from pincal.design.platform_error import PlatformError, platform_error
from pincal.model.checks import ALIKE
from pincal.model.measuring.measurements import Plan

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Drift:
    """What drifts of all quantities, each by one standard deviation over the run, leave as bias."""

    shifts: Array
    """Of each parameter by each reading, then by each quantity measured, but for a sign, shape
    (n, s), [m], [rad] or [1]."""
    relative: Array
    """Of each parameter by all quantities, root of the sum of squares, in standard errors, (n,);
    NaN where these are not known."""
    most: float
    """The largest of these; NaN where no standard error is known."""
    worst: str
    """Id of the parameter that this moves most, of those whose standard errors are known."""
    platform: PlatformError
    """What it leaves of errors of the platform."""
    share: float
    """Of the platform's position, or of its orientation if that is more: over the standard
    error; NaN where that is not known."""


def drift(found: Forecast, poses: Plan | Array, expected: PlatformError | None = None) -> Drift:
    """Return what a drift over the run would do to what was forecast.

    Args:
        found: The forecast of a plan in its order.
        poses: Where the platform's errors are taken, shape (N, dof), or a plan.
        expected: The error that the noise leaves there, if it is known already.
    """
    shifts = np.einsum("n,nis->is", found.when, found.influence)
    bias = np.linalg.norm(shifts, axis=1)
    known = np.isfinite(found.std) & (found.std > 0.0)
    relative = np.where(known, bias / np.where(known, found.std, 1.0), np.nan)
    there = platform_error(found.mechanism, shifts @ shifts.T, poses, found.lost, found.frames)
    error = expected or found.platform_error(poses)
    pairs = ((there.position, error.position), (there.orientation, error.orientation))
    shares = [a / b for a, b in pairs if 0.0 < b < np.inf]
    return Drift(
        shifts=shifts,
        relative=relative,
        most=float(np.nan_to_num(relative).max()) if known.any() else np.nan,
        worst=parameter_ids(found.mechanism)[_first_largest(np.nan_to_num(relative))],
        platform=there,
        share=max(shares, default=np.nan),
    )


def _first_largest(values: Array) -> int:
    """Return where the largest value is; the first, where symmetry makes several alike."""
    return int(np.argmax(values >= (1.0 - ALIKE) * values.max()))
