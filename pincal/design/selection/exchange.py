"""The active robot calibration algorithm: add the best pose, drop the worst, while that gains.

Sun and Hollerbach (2008), for candidates that contribute one row or several, and for any
criterion that says what adding or dropping a candidate changes; M⁻¹ follows by low-rank updates.
All starts are exchanged at once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pincal.design.selection.criteria import Criterion, Determinant, Parts
from pincal.kinematics.closing import CHUNK
from pincal.model.checks import ROUNDING

Array = NDArray[np.float64]
Index = NDArray[np.intp]


@dataclass(frozen=True)
class Effort:
    """How far exchanges of candidates go."""

    exchanges: int
    """At most."""
    pool: int
    """Candidates that are looked at between two looks at all, and by which they grow."""
    rounds: int = 1
    """Looks at all, at most."""
    tolerance: float = 0.0
    """Of the bound on det^(1/n), where it ends."""
    at_once: int = 1
    """Of the best sets, those that are exchanged against all candidates."""
    few: int = 40
    """Candidates of several rows, of those that promise most, whose gain is looked at exactly."""


_EFFORT = Effort(exchanges=1000, pool=500, rounds=100, tolerance=1e-9, at_once=5)


def exchange(
    parts: Parts,
    count: int,
    priority: Array,
    rng: np.random.Generator,
    starts: int,
    criterion: Criterion | None = None,
) -> tuple[Index, float]:
    """Return the best set of candidates found from several starts, and its value.

    The first start rounds the continuous design, the others are drawn at random. Exchange runs in
    a pool; the best sets are then exchanged against all candidates, the pool growing by those that
    would improve them, until none does.

    Args:
        parts: Rows that each candidate contributes, of each part of the parameters, shape
            (M, r, n); together of rank n.
        count: Size of the set, without repetition.
        priority: By which candidates come first into the pool, shape (M,): the continuous design.
        rng: Source of the random starts.
        starts: Number of starts.
        criterion: What is made large; log det if not given.
    """
    scales = tuple(np.linalg.norm(one.reshape(-1, one.shape[2]), axis=0) for one in parts)
    rows = tuple(one / scale for one, scale in zip(parts, scales, strict=True))
    criterion, lacking = (criterion or Determinant()).scaled(scales)
    total = len(parts[0])
    pool = np.argsort(-priority, kind="stable")[: max(_EFFORT.pool, 2 * count)]
    drawn = [pool[:count], *(rng.permutation(total)[:count] for _ in range(starts - 1))]
    sets = np.array(drawn)
    best = -np.inf
    for _ in range(_EFFORT.rounds):
        pool = np.union1d(pool, sets)
        own = tuple(one[pool] for one in rows)
        sets = pool[_improved(own, np.searchsorted(pool, sets), criterion)]
        sets = np.unique(np.sort(sets, axis=1), axis=0)
        values = np.array([_value(rows, one, criterion) for one in sets])
        order = np.argsort(-values, kind="stable")[: _EFFORT.at_once]
        sets, values = sets[order], values[order]
        if not values[0] > best + _EFFORT.tolerance:
            break
        best = values[0]
        pool = np.union1d(pool, _promising(rows, sets, criterion))
    return sets[0], float(values[0]) + lacking


def _value(rows: Parts, chosen: Index, criterion: Criterion) -> float:
    return criterion.value(tuple(one[chosen].reshape(-1, one.shape[2]) for one in rows))


def _promising(rows: Parts, sets: Index, criterion: Criterion) -> Index:
    """Return the candidates that would improve one of some sets most."""
    total = len(rows[0])
    if total <= _EFFORT.pool:
        return np.arange(total)
    inverse = _inverses(rows, sets)
    gain = np.concatenate(
        [
            criterion.promise(tuple(one[first : first + CHUNK] for one in rows), inverse)
            for first in range(0, total, CHUNK)
        ],
        axis=1,
    )
    return np.unique(np.argpartition(-gain, _EFFORT.pool, axis=1)[:, : _EFFORT.pool])


def _improved(rows: Parts, sets: Index, criterion: Criterion) -> Index:
    """Return sets, shape (S, count), that no exchange improves: the best added, the worst dropped.

    Args:
        rows: Of the candidates.
        sets: Where the exchanges start.
        criterion: What is made large.
    """
    sets, count, total = sets.copy(), sets.shape[1], len(rows[0])
    active = np.arange(len(sets) if count < total else 0)
    inverse = _inverses(rows, sets)
    for step in range(_EFFORT.exchanges):
        if not len(active):
            break
        if step % 25 == 24:  # rounding
            inverse = _inverses(rows, sets[active])
        own, each = sets[active], np.arange(len(active))
        added = _best(rows, own, inverse, criterion)
        larger = _updated(inverse, rows, added, 1.0)
        loss = criterion.change(tuple(one[own] for one in rows), larger, -1.0)
        place = loss.argmax(axis=1)
        gain = criterion.change(tuple(one[added][:, None] for one in rows), inverse, 1.0)[:, 0]
        gains = gain + loss[each, place] > _EFFORT.tolerance
        dropped = own[each, place]
        sets[active[gains], place[gains]] = added[gains]
        active = active[gains]
        larger = tuple(one[gains] for one in larger)
        inverse = _updated(larger, rows, dropped[gains], -1.0)
    return sets


def _best(rows: Parts, sets: Index, inverse: Parts, criterion: Criterion) -> Index:
    """Return the candidate that each set, shape (S, count), gains most by, shape (S,).

    Where candidates have several rows, of those that promise most: log det(I + K) is tr K at most.
    """
    several = any(one.shape[1] > 1 for one in rows)
    promised = several and len(rows[0]) > sets.shape[1] + _EFFORT.few
    gain = criterion.promise(rows, inverse) if promised else criterion.change(rows, inverse, 1.0)
    np.put_along_axis(gain, sets, -np.inf, axis=1)
    if not promised:
        return np.asarray(gain.argmax(axis=1))
    few = np.argpartition(-gain, _EFFORT.few, axis=1)[:, : _EFFORT.few]
    exact = criterion.change(tuple(one[few] for one in rows), inverse, 1.0)
    return np.take_along_axis(few, exact.argmax(axis=1)[:, None], axis=1)[:, 0]


def _inverses(rows: Parts, sets: Index) -> Parts:
    """Return (Σ Aᵀ A)⁻¹ of sets (S, n, n), with a ridge: a random start may lack rank."""
    found = []
    for one in rows:
        flat = one[sets].reshape(len(sets), -1, one.shape[2])
        M = flat.transpose(0, 2, 1) @ flat
        found.append(np.asarray(np.linalg.inv(M + ROUNDING * np.eye(len(M[0]))), np.float64))
    return tuple(found)


def _updated(inverse: Parts, rows: Parts, which: Index, sign: float) -> Parts:
    """Return (M ± Aᵀ A)⁻¹ of each choice from M⁻¹, for a candidate each (Woodbury)."""
    found = []
    for one, candidates in zip(inverse, rows, strict=True):
        A = candidates[which]
        product = one @ A.transpose(0, 2, 1)
        middle = sign * np.eye(A.shape[1]) + A @ product
        found.append(one - product @ np.linalg.solve(middle, product.transpose(0, 2, 1)))
    return tuple(found)
