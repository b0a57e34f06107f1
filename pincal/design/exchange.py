"""Exchange of candidates: one of a set is swapped for another as long as that gains something.

Fedorov (1972); of robot poses Sun and Hollerbach (2008). A criterion is concave in M, so that a
swap gains less than its gradients differ, and about that less half of how they bend. Swaps are
ranked by the second and tried exactly; none is overlooked, as those that promise nothing by the
first gain nothing. All starts are swapped at once.
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
from pincal.kinematics.batches import chunks
from pincal.model.checks import ROUNDING
from pincal.types import Array, Index

_POOL = 200  # candidates that swaps come from, at least; by as many the pool grows
_POOL_PER_CHOSEN = 4  # candidates in the pool for each of a set, at least
_RANDOM = 50  # further candidates in the pool, drawn from all
_CHUNK = 4096  # swaps that are tried together
_SWAPS = 1000  # swaps of a set between two looks at all candidates, at most
_LOOKS = 100  # looks at all candidates, at most

_GAIN = 1e-9  # least gain of a swap
_WEIGHTED = (0.95, 0.7)  # share of priority by which the first and the last start are drawn


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
    raw = tuple(part[pool] for part in rows)
    scales = tuple(1.0 / np.linalg.norm(part, axis=(0, 1)) for part in raw)
    scaled = criterion.transformed(tuple(map(np.diag, scales)))
    best, best_value, near = np.arange(0), -np.inf, priority[pool]
    for _ in range(_LOOKS):
        parts = tuple(part * scale for part, scale in zip(raw, scales, strict=True))
        sets = np.sort(_swapped(parts, _starts(near, count, rng, starts), scaled), axis=1)
        values = [criterion.value(tuple(part[members] for part in raw)) for members in sets]
        first = int(np.argmax(values))
        if not values[first] > best_value + _GAIN:
            break
        best, best_value = sets[first], values[first]
        turns = tuple(
            scale[:, None] * (root @ scaled.direction(root))[0]
            for root, scale in zip(_roots(parts, best[None]), scales, strict=True)
        )
        slopes = gradient(rows, turns)
        better = np.flatnonzero(slopes > slopes[pool[best]].min())
        joining = np.setdiff1d(better[largest(slopes[better], size)], pool)
        pool = np.concatenate((pool, joining))
        raw = tuple(part[pool] for part in rows)
        near = np.isin(np.arange(len(pool)), best).astype(float)
    return np.sort(pool[best]), best_value


def _starts(priority: Array, count: int, rng: np.random.Generator, starts: int) -> Index:
    """Return the candidates of highest priority, and sets drawn by it, shape (starts, count)."""
    weights = np.maximum(priority, 0.0)
    share = np.linspace(*_WEIGHTED, starts)[:, None]
    chances = share * weights / weights.sum() + (1.0 - share) / len(weights)
    keys = np.log(chances) + rng.gumbel(size=(starts, len(weights)))
    keys[0] = priority
    return np.argsort(-keys, axis=1, kind="stable")[:, :count]


def _roots(rows: Parts, sets: Index) -> Parts:
    """Return R of M⁻¹ = R Rᵀ of sets (S, count), with a ridge: a random start may lack rank."""
    stacks = (part[sets].reshape(len(sets), -1, part.shape[2]) for part in rows)
    return tuple(
        inverse_roots(stack.swapaxes(1, 2) @ stack + ROUNDING * np.eye(stack.shape[2]))
        for stack in stacks
    )


def _swapped(rows: Parts, sets: Index, criterion: Criterion) -> Index:
    """Return sets, shape (S, count), that no swap of one of each for another one improves.

    Swaps of a set that lacks rank are judged beside a ridge.
    """
    sets = sets.copy()
    active = np.arange(len(sets) if sets.shape[1] < len(rows[0]) else 0)
    for _ in range(_SWAPS):
        if not len(active):
            break
        leaving, coming, gain = _best_swaps(rows, sets[active], criterion)
        better = gain > _GAIN
        sets[active[better], leaving[better]] = coming[better]
        active = active[better]
    return sets


def _best_swaps(rows: Parts, sets: Index, criterion: Criterion) -> tuple[Index, Index, Array]:
    """Return where in each set a candidate leaves, which one comes, and what that gains, (S,).

    For each that leaves, the one that promises most to second order is tried exactly; where none
    gains, all that promise anything to first order.
    """
    roots = _roots(rows, sets)
    W = tuple(part @ root[:, None] for part, root in zip(rows, roots, strict=True))
    V = tuple(
        part @ criterion.direction(root)[:, None] for part, root in zip(W, roots, strict=True)
    )
    promise, estimate = _promises(W, V, sets, criterion.order)
    worthy = promise > _GAIN
    first = np.zeros(worthy.shape, dtype=bool)
    strongest = np.where(worthy, estimate, -np.inf).argmax(axis=2)
    np.put_along_axis(first, strongest[:, :, None], True, axis=2)
    best, gain = np.zeros((len(sets), 2), dtype=np.int64), np.full(len(sets), -np.inf)
    for tried in (worthy & first, worthy):
        owner, out, coming = np.nonzero(tried & (gain <= _GAIN)[:, None, None])
        exact = _gains(W, V, owner, np.column_stack((sets[owner, out], coming)), criterion)
        order = np.argsort(exact, kind="stable")
        best[owner[order]] = np.column_stack((out, coming))[order]
        gain[owner[order]] = exact[order]
    return best[:, 0], best[:, 1], gain


def _promises(W: Parts, V: Parts, sets: Index, order: int) -> tuple[Array, Array]:
    """Return what swaps gain to first and to second order, shape (S, count, P).

    Args:
        W: Rows of candidates times the root R of the inverse of each set, shape (S, P, r, n).
        V: W times the criterion's direction, shape (S, P, r, k).
        sets: Members, shape (S, count).
        order: Of the criterion.
    """
    index = np.arange(len(sets))[:, None]
    slopes = np.sum([(part * part).sum(axis=(2, 3)) for part in V], axis=0)
    bend = np.zeros((*sets.shape, slopes.shape[1]))
    for w, v in zip(W, V, strict=True):
        S, P, r, _ = w.shape
        K, Q = (
            part[index, sets].reshape(S, -1, part.shape[3]) @ part.reshape(S, P * r, -1).mT
            for part in (w, v)
        )
        bend -= 2.0 * (K * Q).reshape(S, -1, r, P, r).sum(axis=(2, 4))
        own = ((w @ w.mT) * (v @ v.mT)).sum(axis=(2, 3))
        bend += own[:, None] + own[index, sets][:, :, None]
    promise = slopes[:, None] - slopes[index, sets][:, :, None]
    np.put_along_axis(
        promise, np.broadcast_to(sets[:, None], (*sets.shape, sets.shape[1])), -np.inf, axis=2
    )
    with np.errstate(invalid="ignore"):
        estimate = promise - 0.5 * (1 + order) * bend + 0.5 * order * promise**2
    return promise, estimate


def _gains(W: Parts, V: Parts, owners: Index, pairs: Index, criterion: Criterion) -> Array:
    """Return what swaps gain exactly, shape (m,).

    Args:
        W: Rows of candidates times the root R of the inverse of each set, shape (S, P, r, n).
        V: W times the criterion's direction, shape (S, P, r, k).
        owners: Sets in which to swap, shape (m,).
        pairs: Candidates that leave and that come, shape (m, 2).
        criterion: The criterion.
    """
    total = np.zeros(len(owners))
    for chunk in chunks(len(owners), _CHUNK):
        owner, pair = owners[chunk, None], pairs[chunk]
        for W_part, V_part in zip(W, V, strict=True):
            r = W_part.shape[2]
            w, v = (
                part[owner, pair].reshape(len(pair), 2 * r, part.shape[3])
                for part in (W_part, V_part)
            )
            K = w @ w.swapaxes(1, 2)
            Q = v @ v.swapaxes(1, 2) if criterion.order else K
            total[chunk] += criterion.change(K, Q, np.repeat((-1.0, 1.0), r))
    return total
