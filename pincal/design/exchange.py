"""Exchange of candidates: one of a set is swapped for another as long as that gains something.

Fedorov (1972), place by place as Cook and Nachtsheim (1980); of robot poses Sun and Hollerbach
(2008). All starts are swapped at once.
"""

from __future__ import annotations

import numpy as np

from pincal.design.certificate import continuous_design
from pincal.design.criteria import (
    DETERMINANT,
    Criterion,
    Parts,
    gradient,
    inverse_roots,
    largest,
)
from pincal.errors import ObservabilityError
from pincal.model.checks import ROUNDING
from pincal.types import Array, Index

_POOL = 200  # candidates that swaps come from, at least; by as many the pool grows
_POOL_PER_CHOSEN = 4  # candidates in the pool for each of a set, at least
_RANDOM = 50  # further candidates in the pool, drawn from all
_TURNS = 100  # visits of each place of a set between two looks at all candidates, at most
_GAIN = 1e-9  # least gain of a swap
_WEIGHTED = (0.97, 0.75)  # share of priority by which the first and the last start are drawn


def best_choice(
    rows: Parts,
    count: int,
    rng: np.random.Generator,
    starts: int,
    criterion: Criterion = DETERMINANT,
) -> tuple[Index, float]:
    """Return the best choice of candidates, and its efficiency against the bound on any choice.

    Args:
        rows: Rows that each candidate contributes, of each part of the parameters, shape (M, r, n);
            together of rank n.
        count: Size of the choice, without repetition.
        rng: Source of the random starts.
        starts: Number of starts.
        criterion: Criterion to maximise; log det if not given.

    Raises:
        ObservabilityError: the candidates leave a parameter undetermined, or are too few.
    """
    design = continuous_design(rows, criterion)
    chosen, value = exchange(rows, count, design.priority, rng, starts, criterion)
    return chosen, design.efficiency(value, count)


def exchange(
    rows: Parts,
    count: int,
    priority: Array,
    rng: np.random.Generator,
    starts: int,
    criterion: Criterion = DETERMINANT,
) -> tuple[Index, float]:
    """Return the best set of candidates from several starts, and its value.

    The first start rounds the continuous design, the others are drawn by its weights. Swaps run in
    a pool, which then grows by those of all candidates that would improve the best set to first
    order; the next starts are this set and others near it. It ends when none is better.

    Args:
        rows: Rows that each candidate contributes, of each part of the parameters, shape (M, r, n);
            together of rank n.
        count: Size of the set, without repetition.
        priority: Order in which candidates come into the pool, the largest first, shape (M,).
        rng: Source of the random starts.
        starts: Number of starts.
        criterion: Criterion to maximise; log det if not given.

    Raises:
        ObservabilityError: fewer candidates than the set is to have.
    """
    total = len(rows[0])
    if total < count:
        raise ObservabilityError(
            f"{total} candidates are in reach, no two of them alike; {count} are to be chosen"
        )
    size = max(_POOL, _POOL_PER_CHOSEN * count)
    drawn = rng.integers(total, size=_RANDOM)
    pool = np.union1d(largest(priority, size), drawn)
    best, value, near = np.arange(0), -np.inf, priority[pool]
    while True:
        parts = tuple(part[pool] for part in rows)
        sets = np.sort(_swapped(parts, _starts(near, count, rng, starts), criterion), axis=1)
        values = [criterion.value(tuple(part[members] for part in parts)) for members in sets]
        first = int(np.argmax(values))
        if not values[first] > value + _GAIN:
            return best, value
        best, value = pool[sets[first]], values[first]
        roots = [_inverse_roots(part, sets[first][None]) for part in parts]
        slopes = gradient(rows, tuple(root[0] @ criterion.direction(root)[0] for root in roots))
        better = np.flatnonzero(slopes > slopes[best].min())
        pool = np.union1d(pool, better[largest(slopes[better], size)])
        near = np.isin(pool, best).astype(float)


def _starts(priority: Array, count: int, rng: np.random.Generator, starts: int) -> Index:
    """Return the candidates of highest priority, and sets drawn by it, shape (starts, count)."""
    weights = np.maximum(priority, 0.0)
    share = np.linspace(*_WEIGHTED, starts)[:, None]
    chances = share * weights / weights.sum() + (1.0 - share) / len(weights)
    keys = np.log(chances) + rng.gumbel(size=(starts, len(weights)))
    keys[0] = priority
    return np.argsort(-keys, axis=1, kind="stable")[:, :count]


def _inverse_roots(rows: Array, sets: Index) -> Array:
    """Return R of M⁻¹ = R Rᵀ of sets (S, count), (S, n, n), beside a ridge: some lack rank."""
    members = rows[sets].reshape(len(sets), -1, rows.shape[2])
    ridge = np.diag(ROUNDING * (rows * rows).sum(axis=(0, 1)))
    return inverse_roots(members.mT @ members + ridge)


def _swapped(rows: Parts, sets: Index, criterion: Criterion) -> Index:
    """Return sets (S, count) improved in turns at each place: what gains most comes there."""
    sets, count = sets.copy(), sets.shape[1]
    unchanged = np.zeros(len(sets), dtype=int)  # places in a row at which a set stayed as it was
    for turn in range(_TURNS * count):
        active, place = np.flatnonzero(unchanged < count), turn % count
        if not len(active):
            break
        others, gains = (
            np.delete(sets[active], place, axis=1),
            np.zeros((len(active), len(rows[0]))),
        )
        for part in rows:
            gains += criterion.gain(part, _inverse_roots(part, others))
        np.put_along_axis(gains, others, -np.inf, axis=1)
        coming, index = gains.argmax(axis=1), np.arange(len(active))
        better = gains[index, coming] > gains[index, sets[active, place]] + _GAIN
        sets[active[better], place] = coming[better]
        unchanged[active] = np.where(better, 0, unchanged[active] + 1)
    return sets
