"""How well poses and readings fit a leg whose parameters are near the nominal ones.

A machine that differs from its drawing leaves gaps, as a wrong sign does; but parameters near
nominal explain the former. What such parameters leave is what readings and poses contradict each
other by, however short the motion that was measured.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pincal.calibration.hypotheses.rule import RULE
from pincal.estimation.observability.drawings import DIFFER, changes_of
from pincal.estimation.observability.frames import frame_motions
from pincal.kinematics.derivatives import demand
from pincal.kinematics.legs.closure import LegClosure
from pincal.kinematics.legs.nearest_closure import nearest_closure
from pincal.kinematics.legs.starts import home_mode, mode_sign
from pincal.model.mechanism import Mechanism

Array = NDArray[np.float64]
_STEPS = 20  # a leg that closes needs fewer; one that does not is not worth more
_ROUNDS = 5  # of least squares on the way to the least sum of absolute values


@dataclass(frozen=True)
class LegFit:
    """How measurements fit a leg; lengths over the leg's size."""

    gap: float
    """Median closure residual at the nominal parameters; NaN with fewer than two rows."""
    left: Array
    """Closure residual at the parameters near nominal that fit best, of each row, (N,); NaN
    where there is no reading."""
    stroke: float
    """By how much readings move the leg's end over the rows: median."""
    bent: int
    """Rows that close the leg in another working mode than home's."""

    @property
    def rows(self) -> int:
        """Rows with a reading."""
        return int(np.isfinite(self.left).sum())

    @property
    def as_home(self) -> bool:
        """Whether most rows close the leg in home's working mode."""
        return 2 * self.bent <= self.rows

    @property
    def near(self) -> float:
        """What machines near nominal leave of the gaps; all, if machines do not differ so far."""
        return self.gap if not self.gap <= DIFFER else min(self.gap, float(np.nanmedian(self.left)))

    @property
    def misfit(self) -> float:
        """The leg's share in a hypothesis' score: what is left, or 1 in another working mode."""
        return max(self.near, RULE.precise) if self.as_home else max(1.0, self.gap)

    @property
    def questioned(self) -> bool:
        """Whether machines near nominal leave much of what was measured."""
        most = max(min(RULE.questioned * self.stroke, DIFFER), RULE.precise)
        return self.rows > 1 and not self.near <= most


def leg_fits(
    mechanism: Mechanism, index: int, parts: Sequence[tuple[Array, Array]], *, free: bool = False
) -> list[LegFit]:
    """Return how each of several sets of measurements fits a leg.

    Args:
        mechanism: The mechanism.
        index: The leg.
        parts: Of each set, poses ``T_base_platform``, shape (N, 4, 4), and the leg's readings,
            shape (N, n_active), [rad] or [m]; NaN where not measured.
        free: Whether the base was placed by alignment only, and may lie nearby.
    """
    known = [np.asarray(np.isfinite(readings).all(axis=1)) for _, readings in parts]
    known = [own & (own.sum() > 1) for own in known]
    left = [np.full(len(own), np.nan) for own in known]
    none = [LegFit(np.nan, one, np.nan, 0) for one in left]
    if not any(own.any() for own in known):
        return none
    leg, platform = mechanism.legs[index], mechanism.platform
    closure = LegClosure(leg, platform)
    matrices = np.concatenate([one[own] for (one, _), own in zip(parts, known, strict=True)])
    readings = np.concatenate([one[own] for (_, one), own in zip(parts, known, strict=True)])
    with np.errstate(all="ignore"):  # units may be far off
        closed, _ = nearest_closure(closure, matrices, readings, steps=_STEPS)
        missed = np.nan_to_num(np.linalg.norm(closed.constraint, axis=1), nan=np.inf)
        rows = demand(closure, closed, readings)
        J = rows.parameter * changes_of(leg, closure.size)
        if free:
            base = frame_motions(platform, matrices)[:, :, : -platform.dof]
            lengths = np.arange(base.shape[2]) < platform.space
            by_base = rows.pose @ (base * DIFFER * np.where(lengths, closure.size, 1.0))
            J = np.concatenate((J, by_base), axis=2)
    # joints that are all read bend as they do
    bent = (mode_sign(closed) * home_mode(leg, platform) < 0.0) & bool(leg.passive)
    counts = np.array([own.sum() for own in known])
    first = np.cumsum(counts) - counts
    fits = list(none)
    for count in np.unique(counts[counts > 0]):  # those with as many rows at once
        which = np.flatnonzero(counts == count)
        own = first[which, None] + np.arange(count)
        with np.errstate(all="ignore"):
            lefts = _left(closure.size, J[own], rows.value[own])
            strokes = _stroke(rows.reading[own], readings[own]) / closure.size
            gaps = np.median(missed[own], axis=1) / closure.size
        for i, one in enumerate(which):
            left[one][known[one]] = lefts[i]
            fits[one] = LegFit(
                float(gaps[i]), left[one], float(strokes[i]), int(bent[own[i]].sum())
            )
    return fits


def _left(size: float, J: Array, value: Array) -> Array:
    """Return the gaps that parameters near nominal leave, over the leg's size, shape (P, N).

    To first order, of least absolute values (rows with a slip count little), parameters known as
    well as machines follow their drawings, and no farther from nominal than that.

    Args:
        size: The leg's size, [m].
        J: Change of the gaps by as much as each parameter may differ, shape (P, N, k, n), [m].
        value: The gaps in P sets of measurements, shape (P, N, k), [m].
    """
    parts, N, k, n = J.shape
    result = np.full((parts, N), 1.0)
    fine = np.isfinite(J).all(axis=(1, 2, 3)) & np.isfinite(value).all(axis=(1, 2))
    J, value = (one[fine] / (RULE.precise * size) for one in (J, value))
    weights, usual = np.ones(value.shape[:2]), np.ones((len(value), 1))
    J, value = J.reshape(-1, N * k, n), value.reshape(-1, N * k)
    for _ in range(_ROUNDS):
        each = np.repeat(weights**2, k, axis=1)
        weighted = (J * each[:, :, None]).transpose(0, 2, 1)
        normal = weighted @ J + np.square(usual)[:, :, None] * np.eye(n)
        step = np.linalg.solve(normal, -weighted @ value[:, :, None])
        step /= np.maximum(np.abs(step).max(axis=1, initial=0.0, keepdims=True), 1.0)
        rest = (value + (J @ step)[:, :, 0]).reshape(-1, N, k)
        left = np.linalg.norm(rest, axis=2)
        usual = np.maximum(np.median(left, axis=1, keepdims=True), 1.0)
        weights = 1.0 / np.sqrt(np.maximum(left / usual, 1.0))
    result[fine] = RULE.precise * left
    return result


def _stroke(by_reading: Array, readings: Array) -> Array:
    """Return the median distance over which readings move the leg's end from the usual, [m].

    Args:
        by_reading: Of P sets of measurements, shape (P, N, k, n_active).
        readings: Shape (P, N, n_active).
    """
    moved = readings - np.median(readings, axis=1, keepdims=True)
    far = np.linalg.norm(by_reading * moved[:, :, None], axis=(2, 3))
    return np.asarray(np.median(far, axis=1))
