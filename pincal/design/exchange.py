"""The active robot calibration algorithm: add the best pose, drop the worst, while that gains.

Sun and Hollerbach (2008), for candidates that contribute one row or several, and for any
criterion that says what adding or dropping a candidate changes; M⁻¹ follows by low-rank updates.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pincal.design.criteria import Criterion, Determinant
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


_EFFORT = Effort(exchanges=1000, pool=500)


def exchange(
    blocks: Array,
    count: int,
    weights: Array,
    rng: np.random.Generator,
    starts: int,
    criterion: Criterion | None = None,
) -> tuple[Index, float]:
    """Return the best set of candidates found from several starts, and its value.

    The first start rounds the continuous design, the others are drawn at random. Exchange
    runs in a pool that grows by the candidates that would improve the set, so that the
    result is exchanged against all candidates.

    Args:
        blocks: Rows that each candidate contributes, shape (M, r, n); together of rank n.
        count: Size of the set, without repetition.
        weights: Continuous design on the candidates, shape (M,).
        rng: Source of the random starts.
        starts: Number of starts.
        criterion: What is made large; log det if not given.
    """
    n = blocks.shape[2]
    scale = np.linalg.norm(blocks.reshape(-1, n), axis=0)
    blocks = blocks / scale
    criterion, lacking = (criterion or Determinant()).scaled(scale)
    pool = np.argsort(-weights, kind="stable")[: max(_EFFORT.pool, 2 * count)]
    best, best_value = pool[:count], -np.inf
    for number in range(starts):
        chosen = pool[:count] if number == 0 else rng.permutation(len(blocks))[:count]
        chosen, value, pool = _improve_among_all(blocks, chosen, pool, criterion)
        if value > best_value:
            best, best_value = chosen, value
    return np.sort(best), best_value + lacking


def _improve_among_all(
    blocks: Array, chosen: Index, pool: Index, criterion: Criterion
) -> tuple[Index, float, Index]:
    """Return a set that no exchange improves, its value, and the pool with what was needed."""
    value = -np.inf
    while True:
        pool = np.union1d(pool, chosen)
        inside, new_value = _improve(blocks[pool], np.searchsorted(pool, chosen), criterion)
        if new_value <= value + 1e-9:
            return chosen, value, pool
        chosen, value = pool[inside], new_value
        gain = criterion.promise(blocks, _inverse(blocks[chosen]))
        pool = np.union1d(pool, np.argsort(-gain, kind="stable")[: _EFFORT.pool])


def _improve(blocks: Array, chosen: Index, criterion: Criterion) -> tuple[Index, float]:
    """Return a set that no exchange of the best addition for the worst member improves."""
    members = np.zeros(len(blocks), dtype=bool)
    members[chosen] = True
    inverse = _inverse(blocks[members])
    for step in range(0 if members.all() else _EFFORT.exchanges):
        if step % 25 == 24:  # rounding
            inverse = _inverse(blocks[members])
        gain = criterion.change(blocks, inverse, 1.0)
        gain[members] = -np.inf
        added = int(np.argmax(gain))
        inverse = _updated(inverse, blocks[added], 1.0)
        members[added] = True
        inside = np.flatnonzero(members)
        loss = criterion.change(blocks[inside], inverse, -1.0)
        dropped = int(inside[np.argmax(loss)])
        if dropped == added or gain[added] + loss.max() <= 1e-9:
            members[added] = False
            break
        members[dropped] = False
        inverse = _updated(inverse, blocks[dropped], -1.0)
    chosen = np.flatnonzero(members)
    return chosen, criterion.value(blocks[chosen].reshape(-1, blocks.shape[2]))


def _inverse(blocks: Array) -> Array:
    """Return (Σ Aᵀ A)⁻¹, shape (n, n), with a ridge: a random start may lack rank."""
    rows = blocks.reshape(-1, blocks.shape[2])
    return np.asarray(np.linalg.inv(rows.T @ rows + ROUNDING * np.eye(rows.shape[1])), np.float64)


def _updated(inverse: Array, rows: Array, sign: float) -> Array:
    """Return (M ± Aᵀ A)⁻¹ from M⁻¹ (Sherman, Morrison, Woodbury)."""
    product = inverse @ rows.T
    return inverse - product @ np.linalg.solve(sign * np.eye(len(rows)) + rows @ product, product.T)
