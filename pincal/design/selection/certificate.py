"""The continuous D-optimal design: a bound on what any choice of poses can reach.

Weights w on the candidates maximise det M(w), M(w) = Σ wⱼ Aⱼᵀ Aⱼ. By the equivalence
theorem of Kiefer and Wolfowitz, any weights w bound the best ones: det M(w*) ≤
det M(w) · (maxⱼ dⱼ / n)ⁿ with dⱼ = tr Aⱼ M(w)⁻¹ Aⱼᵀ. No set of N candidates has more
information than Nⁿ det M(w*), so the bound is a proof whether or not w has converged.

Few candidates carry weight. On these, log det M is maximised by Newton's method; then those that
violate dⱼ ≤ n most join them, until none does (column generation).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pincal.design.selection.criteria import Parts, variance
from pincal.errors import ObservabilityError
from pincal.kinematics.closing import CHUNK
from pincal.model.checks import ROUNDING

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Generation:
    """How candidates with weight are found, and how near to the best weights."""

    first: int = 400
    """Candidates that the first weights are on."""
    multiplied: int = 30
    """Multiplicative steps of these."""
    small: float = 0.05
    """Of the largest weight: those below are dropped before Newton's steps begin."""
    newton: int = 100
    """Steps between two looks at all candidates, at most."""
    rounds: int = 100
    """Looks at all, at most."""
    tolerance: float = 1e-4
    """Of the bound on det^(1/n), where it ends."""


_BY = Generation()


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

    @property
    def priority(self) -> Array:
        """By which candidates come first: those with weight, then those of large dⱼ, shape (M,)."""
        return self.weights + ROUNDING * self.variance

    def efficiency(self, log_det: float, count: int, n_params: int) -> float:
        """Return (det/det of the bound)^(1/n) of a set of candidates, at most 1.

        Args:
            log_det: log det of the set's information matrix Σ Aⱼᵀ Aⱼ.
            count: Number of candidates in it.
            n_params: Number of parameters n.
        """
        return float(np.exp((log_det - self.log_det_bound) / n_params) / count)


def continuous_design(parts: Parts) -> ContinuousDesign:
    """Return a nearly D-optimal continuous design and its bound.

    Args:
        parts: Rows that each candidate contributes, of each part of the parameters, (M, r, n).

    Raises:
        ObservabilityError: all candidates together leave a parameter undetermined.
    """
    rows, shift = _normal(parts)
    n = sum(one.shape[2] for one in rows)
    count = len(rows[0])
    seen = _variances(rows, tuple(np.eye(one.shape[2]) for one in rows))  # uniform: M = 1
    pool = np.argsort(-seen, kind="stable")[: max(_BY.first, 4 * n)]
    weights = np.zeros(count)
    weights[pool] = _multiplicative(tuple(one[pool] for one in rows))
    for _ in range(_BY.rounds):
        support = np.flatnonzero(weights)
        weights[support] = _newton(tuple(one[support] for one in rows), weights[support])
        seen = _variances(rows, _inverse(rows, weights))
        if seen.max() <= n * (1.0 + _BY.tolerance):
            break
        worst = np.argpartition(-seen, min(2 * n, count - 1))[: 2 * n]
        worst = worst[seen[worst] > n]
        weights *= 1.0 - _BY.tolerance
        weights[worst] += _BY.tolerance / len(worst)
    log_det = sum(float(np.linalg.slogdet(M)[1]) for M in _information(rows, weights)) + shift
    bound = log_det + n * float(np.log(max(1.0, seen.max() / n)))
    return ContinuousDesign(weights, seen, log_det, bound)


def _normal(parts: Parts) -> tuple[Parts, float]:
    """Return rows of which the information of uniform weights is 1, and log det of what it was.

    Raises:
        ObservabilityError: the candidates leave a parameter undetermined.
    """
    rows, shift = [], 0.0
    for one in parts:
        count, r, n = one.shape
        factor = np.asarray(np.linalg.qr(one.reshape(-1, n), mode="r"))
        scale = np.abs(np.diagonal(factor))
        if len(factor) < n or scale.min() <= ROUNDING * np.linalg.norm(factor, axis=0).max():
            raise ObservabilityError("the candidate poses leave a parameter undetermined")
        inverse = np.linalg.inv(factor) * np.sqrt(count)
        rows.append((one.reshape(-1, n) @ inverse).reshape(count, r, n))
        shift += 2.0 * float(np.log(scale).sum()) - n * np.log(count)
    return tuple(rows), shift


def _information(rows: Parts, weights: Array) -> Parts:
    used = np.flatnonzero(weights)
    found = []
    for one in rows:
        flat = (one[used] * np.sqrt(weights[used])[:, None, None]).reshape(-1, one.shape[2])
        found.append(flat.T @ flat)
    return tuple(found)


def _inverse(rows: Parts, weights: Array) -> Parts:
    return tuple(np.asarray(np.linalg.inv(M), np.float64) for M in _information(rows, weights))


def _variances(rows: Parts, inverse: Parts) -> Array:
    """Return dⱼ = tr Aⱼ M⁻¹ Aⱼᵀ, shape (M,), in parts that memory holds."""
    found = np.zeros(len(rows[0]))
    for first in range(0, len(found), CHUNK):
        some = slice(first, first + CHUNK)
        for one, M in zip(rows, inverse, strict=True):
            found[some] += variance(one[some], M[None])[0]
    return found


def _multiplicative(rows: Parts) -> Array:
    """Return weights after steps wⱼ ← wⱼ dⱼ / n, small ones dropped: where Newton's steps begin."""
    weights = np.full(len(rows[0]), 1.0 / len(rows[0]))
    for _ in range(_BY.multiplied):
        weights = weights * _variances(rows, _inverse(rows, weights))
        weights /= weights.sum()
    large = weights >= _BY.small * weights.max()
    ranks = [np.linalg.matrix_rank(one[large].reshape(-1, one.shape[2])) for one in rows]
    if all(rank == one.shape[2] for rank, one in zip(ranks, rows, strict=True)):
        weights[~large] = 0.0
    return weights / weights.sum()


def _newton(rows: Parts, weights: Array) -> Array:
    """Return the weights of few candidates that maximise log det M, those at zero dropped.

    With M⁻¹ = F Fᵀ, the gradient is dⱼ and the Hessian −|Aᵢ M⁻¹ Aⱼᵀ|²; weights stay a share of 1.
    """
    weights = weights.copy()
    n = sum(one.shape[2] for one in rows)
    for _ in range(_BY.newton):
        used = np.flatnonzero(weights)
        own = tuple(one[used] for one in rows)
        hessian, gradient = _derivatives(own, weights[used])
        if np.abs(gradient - n).max() <= 0.1 * _BY.tolerance * n:
            break
        step = _step(hessian, gradient)
        falling = step < 0.0
        reach = np.min(weights[used][falling] / -step[falling], initial=np.inf)
        size, value = min(1.0, reach), _log_det(own, weights[used])
        while size > ROUNDING:
            trial = np.maximum(weights[used] + size * step, 0.0)
            if _log_det(own, trial) >= value:
                break
            size /= 2.0
        else:
            break
        trial[trial <= ROUNDING] = 0.0
        weights[used] = trial / trial.sum()
    return weights


def _derivatives(rows: Parts, weights: Array) -> tuple[Array, Array]:
    """Return what log det M is by weights: minus its Hessian, (s, s), and its gradient, (s,)."""
    s = len(weights)
    hessian, gradient = np.zeros((s, s)), np.zeros(s)
    for one, M in zip(rows, _inverse(rows, weights), strict=True):
        P = M @ (one.transpose(0, 2, 1) @ one)  # M⁻¹ Aᵢᵀ Aᵢ, and |Aᵢ M⁻¹ Aⱼᵀ|² = tr Pᵢ Pⱼ
        hessian += P.reshape(s, -1) @ P.transpose(0, 2, 1).reshape(s, -1).T
        gradient += np.einsum("saa->s", P)
    return hessian, gradient


def _step(hessian: Array, gradient: Array) -> Array:
    """Return Newton's step of weights whose sum stays."""
    s = len(gradient)
    ridge = ROUNDING * float(np.trace(hessian)) * np.eye(s)
    both = np.linalg.solve(hessian + ridge, np.column_stack((gradient, np.ones(s))))
    level = both[:, 0].sum() / both[:, 1].sum()
    return np.asarray(both[:, 0] - level * both[:, 1])


def _log_det(rows: Parts, weights: Array) -> float:
    found = [np.linalg.slogdet(M) for M in _information(rows, weights)]
    return sum(float(value) if sign > 0.0 else -np.inf for sign, value in found)
