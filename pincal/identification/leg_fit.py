"""How well poses and readings fit a leg at its nominal parameters: its gap, and how it bends."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pincal.identification.residuals import LegResidual
from pincal.kinematics.closure import LegClosure
from pincal.kinematics.starts import home_mode, mode_sign
from pincal.model.mechanism import Mechanism

Array = NDArray[np.float64]
_STEPS = 20  # a leg that closes needs fewer; one that does not is not worth more


@dataclass(frozen=True)
class LegFit:
    """How measurements fit a leg."""

    gap: float
    """Median closure residual over the leg's size; NaN with fewer than two rows."""
    rows: int
    """Rows with a reading."""
    bent: int
    """Of them, those that close the leg bent to the other side than at home."""

    @property
    def as_home(self) -> bool:
        """Whether the leg bends as at home in most rows."""
        return 2 * self.bent <= self.rows


def leg_fit(mechanism: Mechanism, index: int, poses: Array, column: Array) -> LegFit:
    """Return how measurements fit a leg.

    Args:
        mechanism: The mechanism.
        index: The leg.
        poses: Complete poses, shape (N, dof), [m] and [rad].
        column: Readings, shape (N,), [rad] or [m]; NaN where not measured.
    """
    known = np.isfinite(column)
    count = int(known.sum())
    if count < 2:
        return LegFit(np.nan, count, 0)
    leg, platform = mechanism.legs[index], mechanism.platform
    matrices = platform.transforms(poses[known]).as_matrix()
    closure = LegClosure(leg, platform)
    residual = LegResidual(leg, platform, column[known])
    with np.errstate(all="ignore"):  # units may be far off
        closed, _ = residual.closed(closure, matrices, steps=_STEPS)
        values = np.nan_to_num(np.abs(closed.constraint), nan=np.inf)
    bent = mode_sign(closed) * home_mode(leg, platform) < 0.0
    return LegFit(float(np.median(values)) / closure.size, count, int(bent.sum()))
