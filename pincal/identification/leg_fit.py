"""How well poses and readings fit a leg near its nominal parameters: gaps, and how it bends.

A machine that differs from its drawing leaves gaps, as a wrong sign does; but parameters near
nominal explain the former. What such parameters leave is what readings and poses contradict each
other by, however short the motion that was measured.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pincal.kinematics.closure import LegClosure
from pincal.kinematics.derivatives import Demand, demand
from pincal.kinematics.held import held
from pincal.kinematics.starts import home_mode, mode_sign
from pincal.model.mechanism import Mechanism

Array = NDArray[np.float64]
_STEPS = 20  # a leg that closes needs fewer; one that does not is not worth more
_NEAR = 0.01  # of the leg's size, [rad] and [1]: by which parameters differ from a drawing
_FARTHEST = 5.0  # times that: farther no machine differs
_PRECISE = 1e-4  # of the leg's size: gaps that are none


@dataclass(frozen=True)
class LegFit:
    """How measurements fit a leg."""

    gap: float
    """Median closure residual over the leg's size; NaN with fewer than two rows."""
    left: float
    """The same at the parameters near nominal that fit best, to first order."""
    stroke: float
    """By how much readings move the leg's end over the rows: median, over the leg's size."""
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
        return LegFit(np.nan, np.nan, np.nan, count, 0)
    leg, platform = mechanism.legs[index], mechanism.platform
    matrices = platform.transforms(poses[known]).as_matrix()
    closure = LegClosure(leg, platform)
    with np.errstate(all="ignore"):  # units may be far off
        closed, _ = held(closure, matrices, readings[known], steps=_STEPS)
        missed = np.linalg.norm(closed.constraint, axis=1)
        values = np.nan_to_num(missed, nan=np.inf)
        rows = demand(closure, closed, readings[known])
        left, stroke = _left(closure, rows), _stroke(rows, readings[known])
    bent = mode_sign(closed) * home_mode(leg, platform) < 0.0
    sides = int(bent.sum()) if leg.passive else 0  # joints that are all read bend as they do
    gap = float(np.median(values)) / closure.size
    return LegFit(gap, min(gap, left), stroke / closure.size, count, sides)


def leg_fits(mechanism: Mechanism, poses: Array, readings: Array) -> list[LegFit]:
    """Return how measurements fit each leg.

    Args:
        mechanism: The mechanism.
        poses: Complete poses, shape (N, dof), [m] and [rad].
        readings: Shape (N, n_readings), [rad] or [m]; NaN where not measured.
    """
    columns = mechanism.reading_columns
    return [leg_fit(mechanism, i, poses, readings[:, own]) for i, own in enumerate(columns)]


def _left(closure: LegClosure, rows: Demand) -> float:
    """Return the median gap that parameters near nominal leave, over the leg's size.

    To first order, by least squares with nominal values known to 1 %; no farther than 5 %.
    """
    units = [closure.leg.units[name] for name in closure.leg.parameter_names]
    near = [_NEAR * (closure.size if unit == "m" else 1.0) for unit in units]
    J = np.concatenate(rows.parameter) * near / (_PRECISE * closure.size)
    value = rows.value.ravel() / (_PRECISE * closure.size)
    if not (np.isfinite(J).all() and np.isfinite(value).all()):
        return np.inf
    n = J.shape[1]
    stacked = np.concatenate((J, np.eye(n)))
    step = np.linalg.lstsq(stacked, -np.concatenate((value, np.zeros(n))), rcond=None)[0]
    step *= min(1.0, _FARTHEST / max(np.abs(step).max(initial=0.0), 1e-300))
    left = (value + J @ step).reshape(rows.value.shape)
    return _PRECISE * float(np.median(np.linalg.norm(left, axis=1)))


def _stroke(rows: Demand, readings: Array) -> float:
    """Return the median distance over which readings move the leg's end from the usual, [m]."""
    moved = readings - np.median(readings, axis=0)
    return float(np.median(np.linalg.norm(rows.reading * moved[:, None], axis=(1, 2))))
