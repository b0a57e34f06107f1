"""The continuous optimal design: a bound on what any choice of poses can reach.

Weights w on the candidates maximise a criterion of M(w) = Σ wⱼ Aⱼᵀ Aⱼ. By the equivalence theorem
of Kiefer and Wolfowitz any weights bound the best ones: of a criterion of degree d with gradient g,
value(w*) ≤ value(w) + d log(maxⱼ gⱼ / d). No set of N candidates has more than N M(w*), so the
bound is a proof whether or not w has converged.

Few candidates carry weight. On these the criterion is maximised by interior-point steps; then those
that violate gⱼ ≤ d most join them, until none does (column generation).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import qr

from pincal.design.criteria import (
    DETERMINANT,
    Criterion,
    Parts,
    gradient,
    inverse_roots,
    largest,
    triangles,
)
from pincal.errors import ObservabilityError
from pincal.model.checks import ROUNDING
from pincal.types import Array, Index

TOLERANCE = 2e-5
"""Relative gap between gradient and degree at which a design is near enough to the best one."""
_FIRST = 200  # candidates that the first weights are on
_SAMPLE = 1000  # candidates, drawn by leverage, of which some keep the rank of the first ones
_ROUNDS = 100  # looks at all candidates, at most
_STEPS = 40  # interior-point steps between two looks, at most
_WITHIN = 0.1  # share of the gap at the last look to which steps go
_JOINING = 4  # candidates for each parameter that join after a look, at most
_SHARE = 1e-3  # weight that these get, at most
_MIXED = 0.1  # share of equal weights that steps begin with, and of the degree the least slack
_CENTRED = 0.03  # share of the mean complementarity at which a step aims
_DROPPED = 0.3  # share of the gap that dropping the least weights may cost
_INSIDE = 0.99  # share of the way to the boundary that a step goes


@dataclass(frozen=True)
class ContinuousDesign:
    """Weights on candidates, near the optimal ones, and the bound that they prove."""

    weights: Array
    """Weights of sum 1, shape (M,)."""
    gradient: Array
    """gⱼ, shape (M,): the degree where the design rests, at most (1 + gap) times it elsewhere."""
    value: float
    """Value of M(w)."""
    bound: float
    """Upper bound of the value of any weights."""
    degree: int
    """Degree of the criterion."""

    @property
    def priority(self) -> Array:
        """Order of candidates: those with weight first, then those of large gⱼ, shape (M,)."""
        return self.weights + ROUNDING * self.gradient

    def efficiency(self, value: float, count: int) -> float:
        """Return the efficiency of a set of candidates, at most 1.

        It is the share of the poses that the best weights would need to give as much.

        Args:
            value: Value of the set's information Σ Aⱼᵀ Aⱼ.
            count: Number of candidates in it.
        """
        return float(np.exp((value - self.bound) / self.degree) / count)


def continuous_design(rows: Parts, criterion: Criterion = DETERMINANT) -> ContinuousDesign:
    """Return a nearly optimal continuous design and its bound.

    Args:
        rows: Rows that each candidate contributes, of each part of the parameters, shape (M, r, n).
        criterion: Criterion to maximise; log det if not given.

    Raises:
        ObservabilityError: all candidates together leave a parameter undetermined.
    """
    factors, total = triangles(rows), len(rows[0])
    if any(map(_lacks_rank, factors)):
        raise ObservabilityError("the candidate poses leave a parameter undetermined")
    # In these coordinates the information of equal weights is 1.
    turns = tuple(np.linalg.inv(factor) * np.sqrt(total) for factor in factors)
    turned = criterion.transformed(turns)
    n = sum(len(turn) for turn in turns)
    degree, gap = criterion.degree(n), 1.0
    support = _first_support(rows, turns, max(_FIRST, 4 * n))
    weights = np.full(len(support), 1.0 / len(support))
    for _ in range(_ROUNDS):
        parts = _turned(rows, support, turns)
        weights = _interior_point(parts, weights, turned, gap)
        carrying = weights > 0.0
        support, weights = support[carrying], weights[carrying]
        roots = [_inverse_root(part[carrying], weights) for part in parts]
        tangents = tuple(
            turn @ root @ turned.direction(root[None])[0]
            for turn, root in zip(turns, roots, strict=True)
        )
        slopes = gradient(rows, tangents)
        gap = float(slopes.max()) / degree - 1.0
        if gap <= TOLERANCE:
            break
        joining = largest(slopes, _JOINING * n)
        joining = np.setdiff1d(joining[slopes[joining] > degree], support)
        share = min(_SHARE, gap) if len(joining) else 0.0
        support = np.concatenate((support, joining))
        equal = np.full(len(joining), share / max(1, len(joining)))
        weights = np.append((1.0 - share) * weights, equal)
    carrying = weights > 0.0
    roots = np.sqrt(weights[carrying])[:, None, None]
    value = criterion.value(tuple(part[support[carrying]] * roots for part in rows))
    all_weights = np.zeros(total)
    all_weights[support] = weights
    bound = value + degree * float(np.log1p(max(0.0, gap)))
    return ContinuousDesign(all_weights, slopes, value, bound, degree)


def _lacks_rank(factor: Array) -> bool:
    """Return whether a triangle, shape (m, n), has less than full rank."""
    scale = np.linalg.norm(factor, axis=0).max()
    return len(factor) < factor.shape[1] or bool(
        np.abs(np.diagonal(factor)).min() <= ROUNDING * scale
    )


def _first_support(rows: Parts, turns: Parts, size: int) -> Index:
    """Return the candidates of largest leverage, and some that together have full rank.

    The largest may be copies of few; candidates drawn by leverage determine all that all determine.
    """
    leverage = gradient(rows, turns)
    cumulated = np.cumsum(leverage)
    levels = (np.arange(_SAMPLE) + 0.5) / _SAMPLE * cumulated[-1]
    sample = np.unique(np.searchsorted(cumulated, levels))
    support = [largest(leverage, size)]
    for part in _turned(rows, sample, turns):
        r, n = part.shape[1:]
        _, pivots = qr(part.reshape(-1, n).T, mode="r", pivoting=True)
        support.append(sample[pivots[:n] // r])
    return np.unique(np.concatenate(support))


def _turned(rows: Parts, places: Index, turns: Parts) -> Parts:
    return tuple(part[places] @ turn for part, turn in zip(rows, turns, strict=True))


def _inverse_root(rows: Array, weights: Array) -> Array:
    """Return R of M(w)⁻¹ = R Rᵀ, shape (n, n), of rows of one part, shape (s, r, n)."""
    flat = (rows * np.sqrt(weights)[:, None, None]).reshape(-1, rows.shape[2])
    return inverse_roots(flat.T @ flat)


def _interior_point(rows: Parts, weights: Array, criterion: Criterion, gap: float) -> Array:
    """Return the best weights of few candidates, from others, by an interior-point method.

    Slacks z of gⱼ + zⱼ = d, and wⱼ zⱼ = μ → 0; a step eliminates z, and the multiplier of Σ w = 1.
    Steps go to a share of the relative gap at the last look.
    """
    s, degree = len(weights), criterion.degree(sum(part.shape[2] for part in rows))
    gap = max(_WITHIN * gap, 0.1 * TOLERANCE)
    w = (1.0 - _MIXED) * weights + _MIXED / s
    hessian, slopes, leverage = derivatives(rows, w, criterion)
    z = np.maximum(degree - slopes, _MIXED * degree)
    for _ in range(_STEPS):
        middle = _CENTRED * float(w @ z) / s
        hessian[np.diag_indices(s)] += z / w
        sides = np.column_stack((slopes + middle / w, np.ones(s)))
        step, level = np.linalg.solve(hessian, sides).T
        step = step - (step.sum() + w.sum() - 1.0) / level.sum() * level
        slack_step = middle / w - z - z / w * step
        w, z = w + _inside(w, step) * step, z + _inside(z, slack_step) * slack_step
        hessian, slopes, leverage = derivatives(rows, w, criterion)
        if slopes.max() <= degree * (1.0 + gap):
            # Σ wⱼ leverageⱼ bounds the part of M that goes with some: at least half of it stays.
            order = np.argsort(w)
            cost = np.cumsum((w * leverage)[order])
            w[order[cost <= min(_DROPPED * gap * degree, 0.5)]] = 0.0
            break
    return np.asarray(w / w.sum())


def _inside(values: Array, change: Array) -> float:
    """Return how much of a change leaves positive values positive, 1 at most."""
    falling = change < 0.0
    return float(np.min(_INSIDE * values[falling] / -change[falling], initial=1.0))


def derivatives(rows: Parts, weights: Array, criterion: Criterion) -> tuple[Array, Array, Array]:
    """Return minus the Hessian by the weights of few candidates, (s, s), gradient and leverages.

    Leverages are tr Aⱼ M⁻¹ Aⱼᵀ, of rows of shape (s, r, n) for each part and weights (s,).
    """
    s, p = len(weights), criterion.order
    hessian, slopes, leverage = np.zeros((s, s)), np.zeros(s), np.zeros(s)
    for part in rows:
        root, r = _inverse_root(part, weights), part.shape[1]
        W = part.reshape(s * r, -1) @ root
        V = W @ criterion.direction(root[None])[0] if p else W
        K = W @ W.T
        products = K * (V @ V.T if p else K)
        hessian += (1 + p) * products.reshape(s, r, s, r).sum(axis=(1, 3))
        slopes += (V * V).reshape(s, -1).sum(axis=1)
        leverage += (W * W).reshape(s, -1).sum(axis=1)
    return hessian - p * np.outer(slopes, slopes), slopes, leverage
