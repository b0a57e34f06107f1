"""What a wrong scale of the measuring instrument would do, which no residual may show.

Lengths that are all measured a part too long are a column of the rows, like a parameter's. What
parameters take up of it moves them, and the platform with them; only the rest is left in residuals.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pincal.design.estimable import pseudo_inverse
from pincal.design.forecast import Forecast
from pincal.design.information import information_rows
from pincal.design.platform_error import PlatformError, platform_error
from pincal.estimation.observability.drawings import nearest_to_nominal
from pincal.kinematics.configurations import legs_at
from pincal.model.measuring.measurements import Noise, Plan
from pincal.model.measuring.setup import Setup
from pincal.model.measuring.uncertainty import Systematic

Array = NDArray[np.float64]
SCALE = 1e-4
"""Relative: a tracker or camera that was set up badly."""


@dataclass(frozen=True)
class ScaleEffect:
    """What lengths do that are all measured a ten-thousandth too long."""

    seen: float
    """Root of what that adds to χ²: standard deviations by which a test made for it sees it."""
    platform: PlatformError
    """By how much it is off then."""
    said: bool
    """Whether the setup says how well the scale is known."""


def scale_effect(
    found: Forecast, plan: Plan, over: Plan | Array, noise: Noise, setup: Setup
) -> ScaleEffect | None:
    """Return what a wrong scale would do to what was forecast; None if no lengths are measured.

    Args:
        found: The forecast, of all legs together.
        plan: The plan of which it is.
        over: Where the platform's errors are taken, shape (N, dof), or a plan.
        noise: Standard deviations of what is measured.
        setup: What measured numbers will mean.
    """
    mechanism = found.mechanism
    legs = legs_at(mechanism, plan.rows(~plan.verifying))
    scaled = replace(setup, systematic=Systematic(scale=SCALE))
    known = information_rows(mechanism, legs, noise, found.measured, scaled)
    rows, off = known.rows.reshape(-1, known.rows.shape[2]), known.off.reshape(-1)
    if not off.size or not off.any():
        return None
    root, _ = pseudo_inverse(rows, found.rank.rank)
    taken = root.T @ (root @ (rows.T @ off))
    n = legs.parameter.shape[2]
    shift = nearest_to_nominal(mechanism, found.gauge) @ taken[:n]
    return ScaleEffect(
        seen=float(np.linalg.norm(off - rows @ taken)),
        platform=platform_error(mechanism, np.outer(shift, shift), over, found.lost, found.frames),
        said=setup.systematic.scale > 0.0,
    )
