"""Exchange of candidates: one of a set is swapped for another as long as that gains something.

Fedorov (1972); of robot poses Sun and Hollerbach (2008). A criterion is concave in M, so that a
swap gains less than its gradients differ: swaps are ranked by that, the most promising tried
exactly, and no swap is overlooked by leaving out those that promise nothing. All starts are
swapped at once.
"""

from __future__ import annotations

import numpy as np

from pincal.design.certificate import continuous_design
from pincal.design.criteria import (
    Candidates,
    Criterion,
    Determinant,
    Parts,
    as_candidates,
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
_TRIED = 8  # weakest members that are swapped for as many of the strongest candidates
_CHUNK = 4096  # swaps that are tried together
_SWAPS = 1000  # swaps of a set between two looks at all candidates, at most
_LOOKS = 100  # looks at all candidates, at most

_GAIN = 1e-9  # least gain of a swap
_WEIGHTED = (0.95, 0.7)  # share of priority by which the first and the last start are drawn


def best_choice(
    rows: Candidates | Parts,
    count: int,
    rng: np.random.Generator,
    starts: int,
    criterion: Criterion | None = None,
    factors: Parts | None = None,
) -> tuple[Index, float]:
    """Return the best choice of candidates, and its efficiency against the bound on any choice.

    Args:
        rows: Rows that each candidate contributes, of each part of the parameters, shape (M, r, n);
            together of rank n.
        count: Size of the choice, without repetition.
        rng: Source of the random starts.
        starts: Number of starts.
        criterion: Criterion to maximise; log det if not given.
        factors: See ``continuous_design``.

    Raises:
        ObservabilityError: the candidates leave a parameter undetermined, or are too few.
    """
    design = continuous_design(rows, criterion, factors)
    chosen, value = exchange(rows, count, design.priority, rng, starts, criterion)
    return chosen, design.efficiency(value, count)


def exchange(
    rows: Candidates | Parts,
    count: int,
    priority: Array,
    rng: np.random.Generator,
    starts: int,
    criterion: Criterion | None = None,
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
    candidates, criterion = as_candidates(rows), criterion or Determinant()
    if len(candidates) < count:
        raise ObservabilityError(
            f"{len(candidates)} candidates are in reach, no two of them alike; {count} are to be "
            "chosen"
        )
    size = max(_POOL, _POOL_PER_CHOSEN * count)
    drawn = rng.integers(len(candidates), size=_RANDOM)
    pool = np.union1d(largest(priority, size), drawn)
    raw = candidates[pool]
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
        slopes = gradient(candidates, turns)
        better = np.flatnonzero(slopes > slopes[pool[best]].min())
        joining = np.setdiff1d(better[largest(slopes[better], size)], pool)
        pool = np.concatenate((pool, joining))
        raw = tuple(map(np.concatenate, zip(raw, candidates[joining], strict=True)))
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
    sets, total = sets.copy(), len(rows[0])

    def improved(active: Index, tried: int) -> Index:
        """Swap in some sets, and return those that it improves."""
        leaving, coming, gain = _best_swaps(rows, sets[active], criterion, tried)
        better = gain > _GAIN
        sets[active[better], leaving[better]] = coming[better]
        return active[better]

    active = np.arange(len(sets) if sets.shape[1] < total else 0)
    for _ in range(_SWAPS):
        if not len(active):
            break
        promising = active
        for _ in range(_SWAPS):
            promising = improved(promising, _TRIED)
            if not len(promising):
                break
        _, first = np.unique(np.sort(sets[active], axis=1), axis=0, return_index=True)
        active = improved(active[first], total)
    return sets


def _best_swaps(
    rows: Parts, sets: Index, criterion: Criterion, tried: int
) -> tuple[Index, Index, Array]:
    """Return where in each set a candidate leaves, which one comes, and what that gains, (S,)."""
    index, roots = np.arange(len(sets)), _roots(rows, sets)
    W = tuple(part @ root[:, None] for part, root in zip(rows, roots, strict=True))
    V = tuple(
        part @ criterion.direction(root)[:, None] for part, root in zip(W, roots, strict=True)
    )
    slopes = np.sum([(part * part).sum(axis=(2, 3)) for part in V], axis=0)
    inside = np.take_along_axis(slopes, sets, axis=1)
    np.put_along_axis(slopes, sets, -np.inf, axis=1)
    weakest = np.argsort(inside, axis=1)[:, :tried]
    strongest = np.argsort(-slopes, axis=1)[:, :tried]
    lost = np.take_along_axis(inside, weakest, axis=1)[:, :, None]
    promise = np.take_along_axis(slopes, strongest, axis=1)[:, None] - lost
    owner, i, j = np.nonzero(promise > _GAIN)
    pairs = np.column_stack((sets[owner, weakest[owner, i]], strongest[owner, j]))
    gain = np.full(promise.shape, -np.inf)
    gain[owner, i, j] = _gains(W, V, owner, pairs, criterion)
    i, j = np.divmod(gain.reshape(len(sets), -1).argmax(axis=1), promise.shape[2])
    return weakest[index, i], strongest[index, j], gain[index, i, j]


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
