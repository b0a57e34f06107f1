"""The continuous L-optimal design: a bound on how accurate any choice of poses makes the platform.

Weights w on the candidates minimise Φ = tr L M(w)⁻¹, M(w) = Σ wⱼ Aⱼᵀ Aⱼ. 1 / Φ is concave and of
first degree in M, so that any weights bound the best ones: Φ(w*) ≥ Φ(w)² / maxⱼ ψⱼ with
ψⱼ = tr Aⱼ M⁻¹ L M⁻¹ Aⱼᵀ (equivalence theorem; F. Pukelsheim, Optimal Design of Experiments, 1993,
7.19). No set of N candidates has less than Φ(w*) / N, whether or not w has converged.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pincal.design.selection.exchange import Effort

Array = NDArray[np.float64]
_EFFORT = Effort(exchanges=100, pool=400, rounds=40, tolerance=1e-2)


@dataclass(frozen=True)
class AccurateDesign:
    """Weights on candidates, near the L-optimal ones, and the bound that they prove."""

    weights: Array
    """Shape (M,), sum 1."""
    least: float
    """Lower bound of tr L M⁻¹ of any weights."""

    def efficiency(self, variance: float, count: int) -> float:
        """Return the bound over tr L M⁻¹ of a set of so many candidates, at most 1."""
        return self.least / count / variance


def accurate_design(blocks: Array, C: Array) -> AccurateDesign:
    """Return a nearly L-optimal continuous design and its bound.

    Multiplicative steps wⱼ ← wⱼ √(ψⱼ / Φ) (Fellman 1974) in a pool that grows by the candidates
    that would improve it most.

    Args:
        blocks: Rows that each candidate contributes, shape (M, r, n); together of rank n.
        C: L = C Cᵀ, shape (n, q).
    """
    count, r, n = blocks.shape
    factor = np.asarray(np.linalg.qr(blocks.reshape(-1, n), mode="r"))  # M(1 / count) becomes 1
    rows = np.linalg.solve(factor.T, blocks.reshape(-1, n).T).T.reshape(count, r, n)
    C = np.linalg.solve(factor.T, C)

    def share(pool: NDArray[np.intp], weights: Array) -> Array:
        """Return ψⱼ / Φ of all candidates at weights of some, and Φ behind."""
        used = rows[pool].reshape(-1, n)
        M = (used * np.repeat(weights, r)[:, None]).T @ used
        half = np.linalg.solve(M, C)
        psi = ((rows.reshape(-1, n) @ half) ** 2).sum(axis=1).reshape(count, r).sum(axis=1)
        total = float((half * C).sum())
        return np.append(psi / total, total)

    pool, weights = np.arange(count), np.full(count, 1.0 / count)
    least = 0.0
    for _ in range(_EFFORT.rounds):
        psi = share(pool, weights)
        least = max(least, psi[-1] / psi[:-1].max())
        if psi[:-1].max() <= 1.0 + _EFFORT.tolerance:
            break
        every = np.zeros(count)
        every[pool] = weights
        first = len(pool) == count > _EFFORT.pool
        heavy = np.flatnonzero(every > (np.inf if first else 1e-3 / n))
        more = np.argsort(-psi[:-1], kind="stable")[: _EFFORT.pool if first else 50]
        pool = np.union1d(heavy, more)
        weights = np.maximum(every[pool], _EFFORT.tolerance / len(pool))
        weights = _multiplied(rows[pool], C, weights / weights.sum())
    found = np.zeros(count)
    found[pool] = weights
    return AccurateDesign(found, least)


def _multiplied(rows: Array, C: Array, weights: Array) -> Array:
    """Return weights after multiplicative steps, shape (M,)."""
    n = rows.shape[2]
    flat = rows.reshape(-1, n)
    for _ in range(_EFFORT.exchanges):
        M = (flat * np.repeat(weights, rows.shape[1])[:, None]).T @ flat
        half = np.linalg.solve(M, C)
        psi = ((flat @ half) ** 2).sum(axis=1).reshape(len(rows), -1).sum(axis=1)
        weights = weights * np.sqrt(psi / (half * C).sum())
        weights = weights / weights.sum()
    return np.asarray(weights)
