"""The active robot calibration algorithm: add the best pose, drop the worst, while that gains.

Sun and Hollerbach (2008), for candidates that contribute one row or several, and for any
criterion that says what adding or dropping a candidate changes; M⁻¹ follows by low-rank updates.
All starts are exchanged at once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pincal.design.selection.candidates import Held, Rows, most_of, squares
from pincal.design.selection.criteria import Criterion, Determinant, Parts
from pincal.errors import ObservabilityError
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
    swaps: int = 50
    """Of these, at most."""
    out: int = 24
    """Of a set, those that it would miss least, which are swapped."""
    few: int = 40
    """Candidates of several rows, those that promise most, whose gain is looked at first."""


_EFFORT = Effort(exchanges=1000, pool=500, rounds=100, tolerance=1e-9, at_once=2)


def exchange(
    given: Rows | Parts,
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
        given: Rows of candidates; or those that each contributes, of each part of the parameters,
            shape (M, r, n); together of rank n.
        count: Size of the set, without repetition.
        priority: By which candidates come first into the pool, shape (M,): the continuous design;
            −∞ for those that do not count.
        rng: Source of the random starts.
        starts: Number of starts.
        criterion: What is made large; log det if not given.

    Raises:
        ObservabilityError: fewer candidates than the set is to have.
    """
    rows = Held(given) if isinstance(given, tuple) else given
    places = np.flatnonzero(np.isfinite(priority))
    first = places[most_of(priority[places], max(_EFFORT.pool, 2 * count))]
    others = places[rng.permutation(len(places))[: len(first)]]
    pool = rows.admitted(np.union1d(first, others))
    pool = pool if len(pool) >= count else rows.admitted(places)
    if len(pool) < count:
        raise ObservabilityError(
            f"{len(pool)} of {rows.total} candidates are in reach, no two of them alike; "
            f"{count} are to be chosen"
        )
    scales = tuple(np.linalg.norm(one.reshape(-1, one.shape[2]), axis=0) for one in rows(pool))
    criterion, lacking = (criterion or Determinant()).scaled(scales)
    foremost = pool[np.argsort(-priority[pool], kind="stable")[:count]]
    drawn = [pool[rng.permutation(len(pool))[:count]] for _ in range(starts - 1)]
    sets, best = np.array([foremost, *drawn]), -np.inf
    for _ in range(_EFFORT.rounds):
        own = tuple(one / scale for one, scale in zip(rows(pool), scales, strict=True))
        sets = np.sort(_improved(own, np.searchsorted(pool, sets), criterion), axis=1)
        sets, values = _sorted(own, np.unique(sets, axis=0), criterion)
        sets = np.array([_swapped(own, one, criterion) for one in sets[: _EFFORT.at_once]])
        sets, values = _sorted(own, sets, criterion)
        inverse = _inverses(own, sets)
        sets = pool[sets]
        if not values[0] > best + _EFFORT.tolerance:
            break
        best = values[0]
        turns = zip(criterion.turns(inverse), scales, strict=True)
        by = tuple(turn / scale[:, None] for turn, scale in turns)
        gains = [squares(rows, places, tuple(one[i] for one in by)) for i in range(len(sets))]
        more = [places[most_of(gain, _EFFORT.pool)] for gain in gains]
        others = np.setdiff1d(np.concatenate(more), pool)
        pool = np.sort(
            rows.admitted(np.concatenate((pool, others)))
        )  # of two alike the earlier stays
    return sets[0], float(values[0]) + lacking


def _sorted(rows: Parts, sets: Index, criterion: Criterion) -> tuple[Index, Array]:
    """Return sets, shape (S, count), and their values, the best first."""
    chosen = [tuple(part[one].reshape(-1, part.shape[2]) for part in rows) for one in sets]
    values = np.array([criterion.value(one) for one in chosen])
    order = np.argsort(-values, kind="stable")
    return sets[order], values[order]


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
        added, gain = _best(rows, own, inverse, criterion)
        larger = _updated(inverse, rows, added, 1.0)
        loss = criterion.change(tuple(one[own] for one in rows), larger, -1.0)
        place = loss.argmax(axis=1)
        gains = gain + loss[each, place] > _EFFORT.tolerance
        dropped = own[each, place]
        sets[active[gains], place[gains]] = added[gains]
        active = active[gains]
        larger = tuple(one[gains] for one in larger)
        inverse = _updated(larger, rows, dropped[gains], -1.0)
    return sets


def _swapped(rows: Parts, chosen: Index, criterion: Criterion) -> Index:
    """Return a set, shape (count,), that no swap of one of it for another candidate improves.

    Where a set without one of it lacks rank, gains are those beside a ridge: some may be missed.
    """
    own = chosen.copy()
    for _ in range(_EFFORT.swaps if len(own) < len(rows[0]) else 0):
        inverse = _inverses(rows, own[None])
        loss = criterion.change(tuple(one[own] for one in rows), inverse, -1.0)[0]
        least = np.argsort(-loss, kind="stable")[: _EFFORT.out]
        each = tuple(np.repeat(one, len(least), axis=0) for one in inverse)
        less = _updated(each, rows, own[least], -1.0)
        into, gain = _best(rows, np.tile(own, (len(least), 1)), less, criterion)
        gain = gain + loss[least]
        out = int(gain.argmax())
        if not gain[out] > _EFFORT.tolerance:
            break
        own[least[out]] = into[out]
    return own


def _best(rows: Parts, sets: Index, inverse: Parts, criterion: Criterion) -> tuple[Index, Array]:
    """Return the candidate that each set, shape (S, count), gains most by, and the gain, (S,).

    Where candidates have several rows, those that promise most are looked at first, and the others
    where their promise leaves that open.
    """
    width = sum(one.shape[1] for one in rows)
    if width == len(rows) or len(rows[0]) <= sets.shape[1] + _EFFORT.few:
        return _best_of_all(rows, sets, inverse, criterion)
    pairs = zip(rows, criterion.turns(inverse), strict=True)
    promised = np.asarray(sum(_promise(*pair) for pair in pairs))
    np.put_along_axis(promised, sets, -np.inf, axis=1)
    few = np.argpartition(-promised, _EFFORT.few, axis=1)[:, : _EFFORT.few]
    gains = criterion.change(tuple(one[few] for one in rows), inverse, 1.0)
    place = gains.argmax(axis=1)[:, None]
    best = np.take_along_axis(few, place, axis=1)[:, 0]
    gain = np.take_along_axis(gains, place, axis=1)[:, 0]
    np.put_along_axis(promised, few, 0.0, axis=1)
    open_ = criterion.most(promised.max(axis=1), inverse, width) > gain
    if open_.any():
        some = tuple(one[open_] for one in inverse)
        best[open_], gain[open_] = _best_of_all(rows, sets[open_], some, criterion)
    return best, gain


def _best_of_all(
    rows: Parts, sets: Index, inverse: Parts, criterion: Criterion
) -> tuple[Index, Array]:
    gain = criterion.change(rows, inverse, 1.0)
    np.put_along_axis(gain, sets, -np.inf, axis=1)
    best = gain.argmax(axis=1)
    return best, gain[np.arange(len(best)), best]


def _promise(rows: Array, turns: Array) -> Array:
    """Return |Aⱼ T|², shape (S, M), of candidates (M, r, n) and of T (S, n, k)."""
    turned = rows.reshape(-1, rows.shape[2]) @ turns
    return np.einsum("sjk,sjk->sj", turned, turned).reshape(len(turns), *rows.shape[:2]).sum(axis=2)


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
