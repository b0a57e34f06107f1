"""Optimal choice of candidates: criteria, a bound on any choice, and an exchange algorithm.

Candidate j contributes rows Aⱼ, shape (r, n); weights make M = Σ wⱼ Aⱼᵀ Aⱼ. D-optimality: log det
M. L-optimality (I- and V-optimality where L is a mean over a region): −log tr L M⁻¹, the platform's
mean variance over the workspace, correlations of all parameters included. A. C. Atkinson,
A. N. Donev, R. D. Tobias, Optimum Experimental Designs, with SAS (2007), 10.5 and 10.6.

They are Kiefer's criteria of order p = 0 and 1: concave in M, with derivatives from two products
of candidates. With M⁻¹ = R Rᵀ and a direction H of the criterion,

    W = A R,   K = W Wᵀ,   Q = W H (W H)ᵀ,
    gradient  gⱼ = tr Qⱼⱼ,   minus Hessian  (1 + p) tr Kᵢⱼ Qⱼᵢ − p gᵢ gⱼ,

and the value gained by further rows is a function of the same K and Q (Woodbury). Parameters that
share no row, such as those of two legs, share no information: M falls into parts, and their
determinants multiply. Rows are a tuple with an array for each part.

Weights w on the candidates maximise a criterion of M(w) = Σ wⱼ Aⱼᵀ Aⱼ. By the equivalence theorem
of Kiefer and Wolfowitz any weights w bound the best weights w*: for a criterion of degree d with
gradient g, value(w*) ≤ value(w) + d log(maxⱼ gⱼ / d). No set of N candidates exceeds the value of
N M(w*), so the bound is a proof whether or not w has converged. Few candidates carry weight. On
these interior-point steps maximise the criterion; then the candidates that violate gⱼ ≤ d most
join, until none does (column generation).

Exchange improves sets of N: a member is swapped for another candidate as long as the value grows
(Fedorov 1972; place by place as Cook and Nachtsheim 1980; for robot poses Sun and Hollerbach 2008).
All starts are improved at once.
"""

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from scipy.linalg import qr

from pincal.errors import ObservabilityError
from pincal.kinematics.batches import solve
from pincal.model.checks import ROUNDING
from pincal.types import Array, Index

Parts: TypeAlias = tuple[Array, ...]
"""An array for each part of the parameters, such as rows of candidates, (M, r, n)."""
TOLERANCE = 2e-5
"""Relative gap between gradient and degree at which a design counts as optimal."""
_FIRST = 200  # candidates with weight at the start
_SAMPLE = 1000  # candidates drawn by leverage, from which the start is completed to full rank
_ROUNDS = 100  # most passes over all candidates
_STEPS = 40  # most interior-point steps between two passes
_WITHIN = 0.1  # tolerance of the steps, as a share of the gap at the last pass
_JOINING = 4  # most candidates per parameter that join after a pass
_SHARE = 1e-3  # largest weight of all joining candidates together
_MIXED = 0.1  # share of equal weights in the first weights; least first slack, over the degree
_CENTRED = 0.03  # target of a step, as a share of the mean complementarity
_DROPPED = 0.3  # share of the gap that dropping the smallest weights may cost
_INSIDE = 0.99  # share of the way to the boundary that a step goes

_POOL = 200  # least size of the pool of candidates for swaps, and size of its growth
_POOL_PER_CHOSEN = 4  # least number of candidates in the pool per member of a set
_RANDOM = 50  # further candidates in the pool, drawn from all
_TURNS = 100  # most visits to each place of a set between two passes over all candidates
_GAIN = 1e-9  # least gain of a swap
_WEIGHTED = (0.97, 0.75)  # influence of the priority on the draw of the first and the last start


@dataclass(frozen=True)
class Criterion:
    """log det M or, for quantities Cᵀφ, minus the logarithm of the sum of their variances."""

    C: Array | None = None
    """Coefficients of q quantities in the n unknowns, which are a single part, shape (n, q)."""

    def value(self, rows: Parts) -> float:
        """Return the criterion's value for rows, (m, r, n) per part; −∞ if they lack rank."""
        total = 0.0
        for triangle in triangles(rows):
            diagonal = np.abs(np.diagonal(triangle))
            if len(triangle) < triangle.shape[1] or not diagonal.min() > 0.0:
                return -np.inf
            if self.C is None:
                total += 2.0 * float(np.log(diagonal).sum())
            else:
                total -= float(np.log((np.linalg.solve(triangle.T, self.C) ** 2).sum()))
        return total

    def direction(self, root: Array) -> Array:
        """Return H for roots R of M⁻¹, shape (S, n, n): the identity, or Rᵀ C over its norm."""
        if self.C is None:
            return np.broadcast_to(np.eye(root.shape[-1]), root.shape)
        half = root.mT @ self.C
        return np.asarray(half / np.linalg.norm(half, axis=(1, 2), keepdims=True))

    def gain(self, rows: Array, root: Array) -> Array:
        """Return the gain in value of one part by adding each of M candidates, shape (S, M).

        It is log det(1 + K), or −log(1 − tr (1 + K)⁻¹ Q): see the module.

        Args:
            rows: Rows of the candidates, shape (M, r, n).
            root: R of M⁻¹ = R Rᵀ of the S sets that they would join, shape (S, n, n).
        """
        r, n = rows.shape[1:]
        W = rows.reshape(-1, n) @ root
        K = _blocks(W, r)
        if self.C is None:
            gain = np.log1p(K[:, 0, 0]) if r == 1 else np.linalg.slogdet(np.eye(r) + K)[1]
        else:
            Q = _blocks(W @ self.direction(root), r)
            share = np.trace(solve(np.eye(r) + K, Q), axis1=1, axis2=2)
            gain = -np.log(np.maximum(1.0 - share, ROUNDING))
        return np.asarray(gain.reshape(len(root), -1))


DETERMINANT = Criterion()


def _blocks(W: Array, r: int) -> Array:
    """Return Wⱼ Wⱼᵀ for M candidates with r rows each; W is (S, M r, k), the result (S M, r, r)."""
    W = W.reshape(-1, r, W.shape[2])
    return np.einsum("mik,mik->m", W, W)[:, None, None] if r == 1 else W @ W.mT


def triangles(rows: Parts) -> Parts:
    """Return the triangle R of each part's QR, (n, n) or less; Rᵀ R is the rows' Gram matrix."""
    flat = (part.reshape(-1, part.shape[-1]) for part in rows)
    return tuple(np.asarray(np.linalg.qr(part, mode="r")) for part in flat)


def gradient(rows: Parts, turns: Parts) -> Array:
    """Return |Aⱼ T|² of each candidate, shape (M,), for a T per part, shape (n, k).

    With T = R H it is the derivative of the value by the candidate's weight.
    """
    total = np.zeros(len(rows[0]))
    for part, turn in zip(rows, turns, strict=True):
        turned = (part.reshape(-1, len(turn)) @ turn).reshape(len(part), -1)
        total += np.einsum("mk,mk->m", turned, turned)
    return total


def inverse_roots(information: Array) -> Array:
    """Return R of M⁻¹ = R Rᵀ for information matrices M, both of shape (S, n, n)."""
    return np.linalg.inv(np.linalg.cholesky(information)).mT


@dataclass(frozen=True)
class ContinuousDesign:
    """Nearly optimal weights on candidates, and the bound that they prove."""

    weights: Array
    """Weights of sum 1, shape (M,)."""
    gradient: Array
    """gⱼ, shape (M,): the degree at candidates with weight, else at most (1 + gap) times it."""
    value: float
    """Value of M(w)."""
    bound: float
    """Upper bound of the value of any weights."""
    degree: int
    """d of value(c M) = value(M) + d log c."""

    @property
    def priority(self) -> Array:
        """Priority of candidates: first those with weight, then by gⱼ, shape (M,)."""
        return self.weights + ROUNDING * self.gradient

    def efficiency(self, value: float, count: int) -> float:
        """Return the efficiency of ``count`` candidates with a value: 1 for the optimal weights."""
        return float(np.exp((value - self.bound) / self.degree) / count)


def continuous_design(rows: Parts, criterion: Criterion = DETERMINANT) -> ContinuousDesign:
    """Return a nearly optimal continuous design of M candidates, and its bound.

    Raises:
        ObservabilityError: all candidates together leave a parameter undetermined.
    """
    factors, total = triangles(rows), len(rows[0])
    for factor in factors:
        least = ROUNDING * np.linalg.norm(factor, axis=0).max()
        if len(factor) < factor.shape[1] or np.abs(np.diagonal(factor)).min() <= least:
            raise ObservabilityError("the candidate poses leave a parameter undetermined")
    # In these coordinates the information of equal weights is the identity.
    turns = tuple(np.linalg.inv(factor) * np.sqrt(total) for factor in factors)
    n = sum(len(turn) for turn in turns)
    turned, degree, gap = criterion, n, 1.0
    if criterion.C is not None:
        turned, degree = Criterion(turns[0].T @ criterion.C), 1
    support = _first_support(rows, turns, max(_FIRST, 4 * n))
    weights = np.full(len(support), 1.0 / len(support))
    for _ in range(_ROUNDS):
        parts = tuple(part[support] @ turn for part, turn in zip(rows, turns, strict=True))
        weights = _interior_point(parts, weights, turned, degree, gap)
        carrying = weights > 0.0
        support, weights = support[carrying], weights[carrying]
        roots = [_weighted_root(part[carrying], weights) for part in parts]
        tangents = tuple(
            turn @ root @ turned.direction(root[None])[0]
            for turn, root in zip(turns, roots, strict=True)
        )
        slopes = gradient(rows, tangents)
        gap = float(slopes.max()) / degree - 1.0
        if gap <= TOLERANCE:
            break
        joining = np.argsort(-slopes)[: _JOINING * n]
        joining = np.setdiff1d(joining[slopes[joining] > degree], support)
        share = min(_SHARE, gap) if len(joining) else 0.0
        support = np.concatenate((support, joining))
        equal = np.full(len(joining), share / max(1, len(joining)))
        weights = np.append((1.0 - share) * weights, equal)
    carrying = weights > 0.0
    scale = np.sqrt(weights[carrying])[:, None, None]
    value = criterion.value(tuple(part[support[carrying]] * scale for part in rows))
    all_weights = np.zeros(total)
    all_weights[support] = weights
    bound = value + degree * float(np.log1p(max(0.0, gap)))
    return ContinuousDesign(all_weights, slopes, value, bound, degree)


def _first_support(rows: Parts, turns: Parts, size: int) -> Index:
    """Return the candidates of largest leverage, and further ones that together have full rank.

    The largest may be copies of few; a sample drawn by leverage has the rank of all candidates.
    """
    leverage = gradient(rows, turns)
    cumulated = np.cumsum(leverage)
    levels = (np.arange(_SAMPLE) + 0.5) / _SAMPLE * cumulated[-1]
    sample = np.unique(np.searchsorted(cumulated, levels))
    support = [np.argsort(-leverage)[:size]]
    for part, turn in zip(rows, turns, strict=True):
        r, n = part.shape[1:]
        _, pivots = qr((part[sample] @ turn).reshape(-1, n).T, mode="r", pivoting=True)
        support.append(sample[pivots[:n] // r])
    return np.unique(np.concatenate(support))


def _weighted_root(rows: Array, weights: Array) -> Array:
    """Return R of M(w)⁻¹ = R Rᵀ, shape (n, n), for the rows of one part, shape (s, r, n)."""
    flat = (rows * np.sqrt(weights)[:, None, None]).reshape(-1, rows.shape[2])
    return inverse_roots(flat.T @ flat)


def _interior_point(
    rows: Parts, weights: Array, criterion: Criterion, degree: int, gap: float
) -> Array:
    """Return the best weights of few candidates by an interior-point method from given weights.

    Slacks z satisfy gⱼ + zⱼ = d and wⱼ zⱼ = μ → 0; a step eliminates z and the multiplier of
    Σ w = 1. ``gap`` is the relative gap at the last pass; steps end at a share of it.
    """
    s, gap = len(weights), max(_WITHIN * gap, 0.1 * TOLERANCE)
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
            # Σ wⱼ leverageⱼ bounds the part of M that dropped candidates take: half of it stays.
            order = np.argsort(w)
            cost = np.cumsum((w * leverage)[order])
            w[order[cost <= min(_DROPPED * gap * degree, 0.5)]] = 0.0
            break
    return np.asarray(w / w.sum())


def _inside(values: Array, change: Array) -> float:
    """Return the factor, at most 1, on a change that keeps positive values positive."""
    falling = change < 0.0
    return float(np.min(_INSIDE * values[falling] / -change[falling], initial=1.0))


def derivatives(rows: Parts, weights: Array, criterion: Criterion) -> tuple[Array, Array, Array]:
    """Return minus the Hessian by the weights of s candidates, (s, s), the gradient and leverages.

    Rows are (s, r, n) for each part, weights (s,); leverages are tr Aⱼ M⁻¹ Aⱼᵀ.
    """
    s, p = len(weights), 0 if criterion.C is None else 1
    hessian, slopes, leverage = np.zeros((s, s)), np.zeros(s), np.zeros(s)
    for part in rows:
        root, shape = _weighted_root(part, weights), part.shape
        W = (part.reshape(-1, shape[2]) @ root).reshape(shape)
        V = W @ criterion.direction(root[None])[0] if p else W
        products = (W.swapaxes(1, 2) @ V).reshape(s, -1)  # Σ w vᵀ over a candidate's rows
        hessian += (1 + p) * (products @ products.T)
        slopes += (V * V).sum(axis=(1, 2))
        leverage += (W * W).sum(axis=(1, 2))
    return hessian - p * np.outer(slopes, slopes), slopes, leverage


def exchange(
    rows: Parts,
    count: int,
    priority: Array,
    rng: np.random.Generator,
    starts: int,
    criterion: Criterion = DETERMINANT,
) -> tuple[Index, float]:
    """Return the best set of candidates from several starts, and its value.

    The first start rounds the continuous design, the others are drawn by its weights. Swaps use a
    pool of candidates, which then grows by the candidates that would improve the best set to first
    order; the next starts are this set and others near it. The search ends without improvement.
    The pool begins with the candidates of largest ``priority``, shape (M,).

    Raises:
        ObservabilityError: there are fewer candidates than the set needs.
    """
    total = len(rows[0])
    if total < count:
        raise ObservabilityError(
            f"{total} different candidates are in reach; {count} are to be chosen. "
            "Give more candidates"
        )
    size = max(_POOL, _POOL_PER_CHOSEN * count)
    drawn = rng.integers(total, size=_RANDOM)
    pool = np.union1d(np.argsort(-priority)[:size], drawn)
    best, value, near = np.arange(0), -np.inf, priority[pool]
    while True:
        parts = tuple(part[pool] for part in rows)
        sets = np.sort(_swapped(parts, _starts(near, count, rng, starts), criterion), axis=1)
        values = [criterion.value(tuple(part[members] for part in parts)) for members in sets]
        first = int(np.argmax(values))
        if not values[first] > value + _GAIN:
            return best, value
        best, value = pool[sets[first]], values[first]
        roots = [_roots_of_sets(part, sets[first][None]) for part in parts]
        slopes = gradient(rows, tuple(root[0] @ criterion.direction(root)[0] for root in roots))
        better = np.flatnonzero(slopes > slopes[best].min())
        pool = np.union1d(pool, better[np.argsort(-slopes[better])[:size]])
        near = np.isin(pool, best).astype(float)


def _starts(priority: Array, count: int, rng: np.random.Generator, starts: int) -> Index:
    """Return the candidates of highest priority, and sets drawn by it, shape (starts, count)."""
    weights = np.maximum(priority, 0.0)
    share = np.linspace(*_WEIGHTED, starts)[:, None]
    chances = share * weights / weights.sum() + (1.0 - share) / len(weights)
    keys = np.log(chances) + rng.gumbel(size=(starts, len(weights)))
    keys[0] = priority
    return np.argsort(-keys, axis=1, kind="stable")[:, :count]


def _roots_of_sets(rows: Array, sets: Index) -> Array:
    """Return R of M⁻¹ = R Rᵀ, (S, n, n), for sets (S, count); a ridge helps those of low rank."""
    members = rows[sets].reshape(len(sets), -1, rows.shape[2])
    ridge = np.diag(ROUNDING * (rows * rows).sum(axis=(0, 1)))
    return inverse_roots(members.mT @ members + ridge)


def _swapped(rows: Parts, sets: Index, criterion: Criterion) -> Index:
    """Return sets, (S, count), improved place by place by the candidate that gains most."""
    sets, count = sets.copy(), sets.shape[1]
    unchanged = np.zeros(len(sets), dtype=int)  # successive places at which a set did not change
    for turn in range(_TURNS * count):
        active, place = np.flatnonzero(unchanged < count), turn % count
        if not len(active):
            break
        remaining = np.delete(sets[active], place, axis=1)
        gains = np.zeros((len(active), len(rows[0])))
        for part in rows:
            gains += criterion.gain(part, _roots_of_sets(part, remaining))
        np.put_along_axis(gains, remaining, -np.inf, axis=1)
        coming, index = gains.argmax(axis=1), np.arange(len(active))
        better = gains[index, coming] > gains[index, sets[active, place]] + _GAIN
        sets[active[better], place] = coming[better]
        unchanged[active] = np.where(better, 0, unchanged[active] + 1)
    return sets
