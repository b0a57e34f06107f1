"""The continuous D-optimal design: a bound on what any choice of poses can reach.

Weights w on the candidates maximise det M(w), M(w) = Σ wⱼ Aⱼᵀ Aⱼ. By the equivalence
theorem of Kiefer and Wolfowitz, any weights w bound the best ones: det M(w*) ≤
det M(w) · (maxⱼ dⱼ / n)ⁿ with dⱼ = tr Aⱼ M(w)⁻¹ Aⱼᵀ. No set of N candidates has more
information than Nⁿ det M(w*), so the bound is a proof whether or not w has converged.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pincal.design.exchange import Effort
from pincal.errors import ObservabilityError
from pincal.model.checks import ROUNDING

Array = NDArray[np.float64]
_EFFORT = Effort(exchanges=1500, pool=400, rounds=50, tolerance=1e-3)


@dataclass(frozen=True)
class ContinuousDesign:
    """Weights on candidates, near the D-optimal ones, and the bound that they prove."""

    weights: Array
    """Shape (M,), sum 1."""
    variance: Array
    """dⱼ, shape (M,); n where the design rests, at most n (1 + gap) elsewhere."""
    log_det: float
    """log det M(w)."""
    log_det_bound: float
    """Upper bound of log det M of any weights."""

    def efficiency(self, log_det: float, count: int, n_params: int) -> float:
        """Return (det/det of the bound)^(1/n) of a set of candidates, at most 1.

        Args:
            log_det: log det of the set's information matrix Σ Aⱼᵀ Aⱼ.
            count: Number of candidates in it.
            n_params: Number of parameters n.
        """
        return float(np.exp((log_det - self.log_det_bound) / n_params) / count)


def continuous_design(blocks: Array) -> ContinuousDesign:
    """Return a nearly D-optimal continuous design and its bound, by vertex exchange.

    Args:
        blocks: Rows that each candidate contributes, shape (M, r, n).

    Raises:
        ObservabilityError: all candidates together leave a parameter undetermined.
    """
    count, r, n = blocks.shape
    factor = np.asarray(np.linalg.qr(blocks.reshape(-1, n), mode="r"))
    scale = np.abs(np.diagonal(factor))
    if len(factor) < n or scale.min() <= ROUNDING * np.linalg.norm(factor, axis=0).max():
        raise ObservabilityError("the candidate poses leave a parameter undetermined")
    shift = 2.0 * float(np.log(scale).sum())
    rows = np.linalg.solve(factor.T, blocks.reshape(-1, n).T).T.reshape(count, r, n)

    weights = np.full(count, 1.0 / count)
    variance = _variance(rows, weights)
    pool = np.argsort(-variance, kind="stable")[: max(_EFFORT.pool, 4 * n)]
    weights = np.zeros(count)
    weights[pool] = _multiplicative(rows[pool])
    for _ in range(_EFFORT.rounds):
        weights[pool] = _vertex_exchange(rows[pool], weights[pool])
        variance = _variance(rows, weights)
        if variance.max() <= n * (1.0 + _EFFORT.tolerance):
            break
        support = np.flatnonzero(weights)
        worst = np.argsort(-variance, kind="stable")[: _EFFORT.pool]
        pool = np.union1d(support, worst)
    _, log_det = np.linalg.slogdet(_information(rows, weights))
    log_det = float(log_det) + shift
    bound = log_det + n * float(np.log(max(1.0, variance.max() / n)))
    return ContinuousDesign(weights, variance, log_det, bound)


def _information(rows: Array, weights: Array) -> Array:
    used = np.flatnonzero(weights)
    flat = rows[used].reshape(-1, rows.shape[2])
    return (flat * np.repeat(weights[used], rows.shape[1])[:, None]).T @ flat


def _variance(rows: Array, weights: Array) -> Array:
    """Return dⱼ = tr Aⱼ M(w)⁻¹ Aⱼᵀ, shape (M,)."""
    inverse = np.linalg.inv(_information(rows, weights))
    flat = rows.reshape(-1, rows.shape[2])
    return np.asarray(((flat @ inverse) * flat).sum(axis=1).reshape(len(rows), -1).sum(axis=1))


def _multiplicative(rows: Array) -> Array:
    """Return weights after steps wⱼ ← wⱼ dⱼ / n, small ones dropped: a start for exchange."""
    weights = np.full(len(rows), 1.0 / len(rows))
    for _ in range(60):
        weights = weights * _variance(rows, weights)
        weights /= weights.sum()
    small = weights < 0.05 * weights.max()
    if np.linalg.matrix_rank(rows[~small].reshape(-1, rows.shape[2])) == rows.shape[2]:
        weights[small] = 0.0
    return weights / weights.sum()


def _vertex_exchange(rows: Array, weights: Array) -> Array:
    """Return weights after moving weight from the worst of the support to the best candidate."""
    weights = weights.copy()
    n = rows.shape[2]
    inverse = np.linalg.inv(_information(rows, weights))
    flat = rows.reshape(-1, n)
    for step in range(_EFFORT.exchanges):
        if step % 50 == 49:  # rounding
            inverse = np.linalg.inv(_information(rows, weights))
        variance = ((flat @ inverse) * flat).sum(axis=1).reshape(len(rows), -1).sum(axis=1)
        best = int(np.argmax(variance))
        support = np.flatnonzero(weights)
        worst = int(support[np.argmin(variance[support])])
        if variance[best] - variance[worst] <= 0.5 * _EFFORT.tolerance * n:
            break
        both = np.concatenate((rows[best], rows[worst]))
        sign = np.repeat([1.0, -1.0], rows.shape[1])
        inner = both @ inverse @ both.T
        amount = _line_search(inner, sign, float(weights[worst]))
        weights[best] += amount
        weights[worst] = 0.0 if amount == weights[worst] else weights[worst] - amount
        middle = np.linalg.inv(np.diag(sign / amount) + inner)
        product = inverse @ both.T
        inverse = inverse - product @ middle @ product.T
    return weights


def _line_search(inner: Array, sign: Array, most: float) -> float:
    """Return the α in (0, most] that maximises log det(I + α K S), K = inner, S = diag(sign)."""
    values, vectors = np.linalg.eigh(inner)
    root = vectors * np.sqrt(np.clip(values, 0.0, None))
    slopes = np.linalg.eigvalsh(root.T @ (sign[:, None] * root))

    if slopes.min() > -1.0 / most and (slopes / (1.0 + most * slopes)).sum() >= 0.0:
        return most
    low, high = 0.0, min(most, -1.0 / float(slopes.min()))
    alpha = high / 2
    for _ in range(60):  # Newton's method, kept inside the bracket
        ratio = slopes / (1.0 + alpha * slopes)
        slope, curvature = float(ratio.sum()), -float((ratio**2).sum())
        low, high = (alpha, high) if slope > 0.0 else (low, alpha)
        step = alpha - slope / curvature
        following = step if low < step < high else (low + high) / 2
        if abs(following - alpha) <= 1e-9 * high:
            break
        alpha = following
    return alpha
