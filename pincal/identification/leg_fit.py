"""How well poses and readings fit a leg at its nominal parameters: its gap, and how it bends."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pincal.kinematics.closure import LegClosure
from pincal.kinematics.held import held
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


def leg_fit(mechanism: Mechanism, index: int, poses: Array, readings: Array) -> LegFit:
    """Return how measurements fit a leg.

    Args:
        mechanism: The mechanism.
        index: The leg.
        poses: Complete poses, shape (N, dof), [m] and [rad].
        readings: Of the leg, shape (N, n_active), [rad] or [m]; NaN where not measured.
    """
    known = np.isfinite(readings).all(axis=1)
    count = int(known.sum())
    if count < 2:
        return LegFit(np.nan, count, 0)
    leg, platform = mechanism.legs[index], mechanism.platform
    matrices = platform.transforms(poses[known]).as_matrix()
    closure = LegClosure(leg, platform)
    with np.errstate(all="ignore"):  # units may be far off
        closed, _ = held(closure, matrices, readings[known], steps=_STEPS)
        missed = np.linalg.norm(closed.constraint, axis=1)
        values = np.nan_to_num(missed, nan=np.inf)
    bent = mode_sign(closed) * home_mode(leg, platform) < 0.0
    sides = int(bent.sum()) if leg.passive else 0  # joints that are all read bend as they do
    return LegFit(float(np.median(values)) / closure.size, count, sides)


def leg_fits(mechanism: Mechanism, poses: Array, readings: Array) -> list[LegFit]:
    """Return how measurements fit each leg.

    Args:
        mechanism: The mechanism.
        poses: Complete poses, shape (N, dof), [m] and [rad].
        readings: Shape (N, n_readings), [rad] or [m]; NaN where not measured.
    """
    columns = mechanism.reading_columns
    return [leg_fit(mechanism, i, poses, readings[:, own]) for i, own in enumerate(columns)]
