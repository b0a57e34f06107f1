"""How well poses and readings fit a leg whose parameters are near the nominal ones.

A machine that differs from its drawing leaves gaps, as a wrong sign does; but parameters near
nominal explain the former. What such parameters leave is what readings and poses contradict each
other by, however short the motion that was measured.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pincal.calibration.hypotheses.rule import RULE
from pincal.estimation.observability.drawings import DIFFER, changes_of
from pincal.estimation.observability.frames import frame_motions
from pincal.kinematics.batches import CHUNK, chunks, stacked
from pincal.kinematics.derivatives import demands
from pincal.kinematics.legs.closure import LegClosure, nominal_legs
from pincal.kinematics.legs.nearest_closure import NEWTON, begun, nearest_closures
from pincal.kinematics.legs.starts import home_mode, mode_sign
from pincal.model.mechanism import Mechanism

Array = NDArray[np.float64]
_SEARCH = replace(NEWTON, steps=20)  # legs that close need fewer
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


@dataclass(frozen=True)
class LegMeasurements:
    """What was measured of one leg."""

    leg: int
    """Which, of the mechanism's."""
    matrices: Array
    """Poses ``T_base_platform``, shape (N, 4, 4)."""
    readings: Array
    """Shape (N, n_active), [rad] or [m]; NaN where not measured."""

    @property
    def whole(self) -> NDArray[np.bool_]:
        """Which rows have readings, shape (N,); none of a single one."""
        found = np.isfinite(self.readings).all(axis=1)
        return np.asarray(found & (found.sum() > 1))

    def known(self) -> LegMeasurements:
        """Return the rows with readings."""
        own = self.whole
        return replace(self, matrices=self.matrices[own], readings=self.readings[own])


def leg_fits(
    mechanism: Mechanism, given: Sequence[LegMeasurements], *, free: bool = False
) -> list[LegFit]:
    """Return how each of several sets of measurements fits its leg.

    Those of alike legs, as many rows each, are evaluated in one call.

    Args:
        mechanism: The mechanism.
        given: The sets.
        free: Whether the base was placed by alignment only, and may lie nearby.
    """
    known, legs = [one.known() for one in given], nominal_legs(mechanism)
    fits = [LegFit(np.nan, np.full(len(one.readings), np.nan), np.nan, 0) for one in given]
    groups: dict[tuple[object, int], list[int]] = {}
    for place, one in enumerate(known):
        if count := len(one.readings):
            groups.setdefault((legs[one.leg].form, count), []).append(place)
    for (_, count), group in groups.items():
        for some in chunks(len(group), max(1, CHUNK // count)):
            found = _fitted(legs, [known[place] for place in group[some]], free)
            for place, fit in zip(group[some], found, strict=True):
                left = fits[place].left
                left[given[place].whole] = fit.left
                fits[place] = replace(fit, left=left)
    return fits


def _fitted(
    legs: Sequence[LegClosure], sets: Sequence[LegMeasurements], free: bool
) -> list[LegFit]:
    """Return how sets of alike legs fit, all rows of which are known, as many in each set."""
    own, count = [legs[one.leg] for one in sets], len(sets[0].readings)
    leg, matrices = own[0].leg, stacked([one.matrices for one in sets])
    said = [one.readings for one in sets]
    # rows of one leg are rows of one call, whatever its form; alike legs stand below each other
    alone = len({one.leg for one in sets}) == 1
    called, known = (own[:1], [stacked(said)]) if alone else (own, said)
    there = np.split(matrices, len(called))

    def by_set(parts: Sequence[Array]) -> Array:
        whole: Array = stacked(parts)
        return whole.reshape(len(sets), count, *whole.shape[1:])

    with np.errstate(all="ignore"):  # units may be far off
        start = [begun(*one, None) for one in zip(called, there, known, strict=True)]
        closed, _ = nearest_closures(called, matrices, stacked(start), _SEARCH)
        missed = np.nan_to_num(np.linalg.norm(closed.constraint, axis=1), nan=np.inf)
        rows = demands(called, closed, known)
        sizes = np.array([one.size for one in own])
        changes = np.stack([changes_of(one.leg, one.size) for one in own])
        J = by_set([one.parameter for one in rows]) * changes[:, None, None]
        if free:
            platform = own[0].platform
            base = frame_motions(platform, matrices)[:, :, : -platform.dof]
            base = base.reshape(len(sets), count, *base.shape[1:])
            lengths = np.arange(base.shape[3]) < platform.space
            scales = DIFFER * np.where(lengths, sizes[:, None, None, None], 1.0)
            by_base = by_set([one.pose for one in rows]) @ (base * scales)
            J = np.concatenate((J, by_base), axis=3)
        lefts = _left(sizes, J, by_set([one.value for one in rows]))
        strokes = _stroke(by_set([one.reading for one in rows]), np.stack(said)) / sizes
        gaps = np.median(missed.reshape(len(sets), count), axis=1) / sizes
    modes = np.repeat([home_mode(one.leg, one.platform) for one in own], count)
    # joints that are all read bend as they do
    bent = (mode_sign(closed) * modes < 0.0) & bool(leg.passive)
    bends = bent.reshape(len(sets), count).sum(axis=1)
    found = zip(gaps.tolist(), lefts, strokes.tolist(), bends.tolist(), strict=True)
    return [LegFit(*one) for one in found]


def _left(sizes: Array, J: Array, value: Array) -> Array:
    """Return the gaps that parameters near nominal leave, over the legs' sizes, shape (P, N).

    To first order, of least absolute values (rows with a slip count little), parameters known as
    well as machines follow their drawings, and no farther from nominal than that.

    Args:
        sizes: Of the legs, shape (P,), [m].
        J: Change of the gaps by as much as each parameter may differ, shape (P, N, k, n), [m].
        value: The gaps in P sets of measurements, shape (P, N, k), [m].
    """
    parts, N, k, n = J.shape
    result = np.full((parts, N), 1.0)
    fine = np.isfinite(J).all(axis=(1, 2, 3)) & np.isfinite(value).all(axis=(1, 2))
    precise = RULE.precise * sizes[fine, None, None]
    J, value = J[fine] / precise[..., None], value[fine] / precise
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
