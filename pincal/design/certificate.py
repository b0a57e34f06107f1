"""The continuous D-optimal design: a bound on what any choice of poses can reach.

Weights w on the candidates maximise det M(w), M(w) = Σ wⱼ Aⱼᵀ Aⱼ. By the equivalence
theorem of Kiefer and Wolfowitz, any weights w bound the best ones: det M(w*) ≤
det M(w) · (maxⱼ dⱼ / n)ⁿ with dⱼ = tr Aⱼ M(w)⁻¹ Aⱼᵀ. No set of N candidates has more
information than Nⁿ det M(w*), so the bound is a proof whether or not w has converged.

Few candidates carry weight. On these, log det M is maximised by interior-point steps; then
those that violate dⱼ ≤ n most join them, until none does (column generation). Every look at the
candidates leaves out those that no optimal design rests on: dⱼ < n h(ε), where
maxⱼ dⱼ = n (1 + ε) (R. Harman and L. Pronzato, Statistics & Probability Letters 77, 2007, 90–94;
for candidates of several rows R. Harman and M. Trnovská, Mathematica Slovaca 59, 2009, 693–704).
The first look is at all.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import lapack, qr

from pincal.design.criteria import Held, Parts, Rows, most_of, squares
from pincal.errors import ObservabilityError
from pincal.model.checks import ROUNDING
from pincal.types import Array, Index


@dataclass(frozen=True)
class Generation:
    """How candidates with weight are found, and how near to the best weights."""

    sample: int = 1000
    """Candidates that are looked at before all are."""
    first: int = 200
    """Candidates that the first weights are on."""
    multiplied: int = 15
    """Multiplicative steps of these."""
    small: float = 0.05
    """Of the largest weight: those below are dropped after these."""
    added: int = 4
    """Times n: candidates that join after a look, at most."""
    share: float = 1e-3
    """Of the weight that these get, at most."""
    mixed: float = 0.1
    """Share of equal weights that interior steps begin with; and of n, the least of slacks then."""
    centred: float = 0.03
    """Of the mean complementarity, where a step aims."""
    within: float = 0.1
    """Of the gap at the last look, to which steps go."""
    dropped: float = 0.3
    """Weight of the least that is dropped then, of that gap; never so much that rank is lost."""
    steps: int = 40
    """Between two looks at all candidates, at most."""
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
    """dⱼ when the candidate was looked at last, shape (M,): n where the design rests, at most
    n (1 + gap) elsewhere; −∞ where the candidate has no rows."""
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


def continuous_design(given: Rows | Parts, places: Index | None = None) -> ContinuousDesign:
    """Return a nearly D-optimal continuous design and its bound.

    Args:
        given: Rows of candidates; or those that each candidate contributes, of each part of the
            parameters, shape (M, r, n).
        places: Candidates that count; all if not given. Those whose rows are NaN do not.

    Raises:
        ObservabilityError: all candidates together leave a parameter undetermined.
    """
    rows = Held(given) if isinstance(given, tuple) else given
    left = np.arange(rows.total) if places is None else places
    some, turns, shift = _normal(rows, left)
    n, gap = sum(len(turn) for turn in turns), 1.0
    size = max(_BY.first, 4 * n)
    most = some[most_of(squares(rows, some, turns), size)]  # uniform: M = 1
    at = _of_whole_rank(rows, some, most, turns)
    weights = _multiplicative(_stacked(_turned(rows(at), turns)))
    seen = np.full(rows.total, -np.inf)
    for _ in range(_BY.rounds):
        own = _turned(rows(at), turns)
        weights = _interior(_stacked(own), weights, max(_BY.within * gap, 0.1 * _BY.tolerance))
        kept = weights > 0.0
        at, weights = at[kept], weights[kept]
        information = [_information(one[None, kept], weights)[0] for one in own]
        roots = [np.linalg.inv(np.linalg.cholesky(M)).T for M in information]
        half = tuple(turn @ root for turn, root in zip(turns, roots, strict=True))
        found = squares(rows, left, half)
        seen[left] = found = np.where(np.isfinite(found), found, -np.inf)
        gap = float(found.max()) / n - 1.0
        design = _weighted(rows.total, at, weights)
        if gap <= _BY.tolerance:
            break
        left = left[found >= n * least_share(gap, n)]
        worst = left[most_of(seen[left], _BY.added * n)]
        worst = np.setdiff1d(worst[seen[worst] > n], at)
        share = min(_BY.share, gap) if len(worst) else 0.0
        at = np.concatenate((at, worst))
        more = np.full(len(worst), share / max(1, len(worst)))
        weights = np.append((1.0 - share) * weights, more)
    log_det = sum(float(np.linalg.slogdet(M)[1]) for M in information) + shift
    bound = log_det + n * float(np.log1p(max(0.0, gap)))
    return ContinuousDesign(design, seen, log_det, bound)


def _weighted(total: int, at: Index, weights: Array) -> Array:
    every = np.zeros(total)
    every[at] = weights
    return every


def least_share(gap: float, n: int) -> float:
    """Return h: where dⱼ < h n no optimal design rests, if no dⱼ exceeds n (1 + gap)."""
    return 1.0 + gap / 2.0 - float(np.sqrt(gap * (4.0 + gap - 4.0 / n))) / 2.0


def _normal(rows: Rows, places: Index) -> tuple[Index, tuple[Array, ...], float]:
    """Return a sample of candidates, what makes its information 1, and log det of what it was.

    The sample grows until its rank is whole.

    Raises:
        ObservabilityError: the candidates leave a parameter undetermined.
    """
    size = _BY.sample
    while True:
        some = places[:: max(1, len(places) // size)]
        parts = rows(some)
        whole = np.logical_and.reduce([np.isfinite(one).all(axis=(1, 2)) for one in parts])
        looked, some = len(some), some[whole]
        turns, shift = [], 0.0
        for one in (part[whole] for part in parts):
            n = one.shape[2]
            factor = np.asarray(np.linalg.qr(one.reshape(-1, n), mode="r"))
            scale = np.abs(np.diagonal(factor))
            if len(factor) < n or scale.min() <= ROUNDING * np.linalg.norm(factor, axis=0).max():
                break
            turns.append(np.linalg.inv(factor) * np.sqrt(len(some)))
            shift += 2.0 * float(np.log(scale).sum()) - n * np.log(len(some))
        else:
            return some, tuple(turns), shift
        if looked == len(places):
            raise ObservabilityError("the candidate poses leave a parameter undetermined")
        size *= 8


def _of_whole_rank(rows: Rows, sample: Index, most: Index, turns: Parts) -> Index:
    """Return candidates, and if they lack rank, as copies do, those of a sample that have it all.

    Args:
        rows: The rows.
        sample: Candidates whose rows have all of the rank.
        most: Some of them.
        turns: What makes their information 1.
    """
    at = [most]
    for one, every in zip(_turned(rows(most), turns), _turned(rows(sample), turns), strict=True):
        r, n = one.shape[1:]
        if np.linalg.matrix_rank(one.reshape(-1, n)) < n:
            _, pivots = qr(every.reshape(-1, n).T, mode="r", pivoting=True)
            at.append(sample[pivots[:n] // r])
    return np.unique(np.concatenate(at))


def _turned(rows: Parts, turns: Parts) -> Parts:
    return tuple(one @ turn for one, turn in zip(rows, turns, strict=True))


def _stacked(rows: Parts) -> Parts:
    """Return rows of candidates (s, r, n) of parts, those of one shape together, (p, s, r, n)."""
    shapes = dict.fromkeys(one.shape for one in rows)
    return tuple(np.stack([one for one in rows if one.shape == shape]) for shape in shapes)


def _information(rows: Array, weights: Array) -> Array:
    """Return M of parts of one shape, shape (p, n, n)."""
    p, _, _, n = rows.shape
    flat = (rows * np.sqrt(weights)[:, None, None]).reshape(p, -1, n)
    return np.asarray(flat.swapaxes(1, 2) @ flat)


def _turned_by_inverse(rows: Array, weights: Array) -> tuple[Array, Array]:
    """Return A M⁻¹ of parts of one shape, shape (p, s r, n), and their dⱼ together, shape (s,)."""
    p, s, r, n = rows.shape
    flat = rows.reshape(p, s * r, n)
    turned = flat @ np.linalg.inv(_information(rows, weights))
    shares = np.einsum("pmn,pmn->m", turned, flat).reshape(s, r).sum(axis=1)
    return turned, shares


def _shares(rows: Parts, weights: Array) -> Array:
    """Return dⱼ = tr Aⱼ M⁻¹ Aⱼᵀ of few candidates, shape (s,)."""
    return np.sum([_turned_by_inverse(one, weights)[1] for one in rows], axis=0)


def _multiplicative(rows: Parts) -> Array:
    """Return weights after steps wⱼ ← wⱼ dⱼ / n, small ones dropped: where interior steps begin."""
    weights = np.full(rows[0].shape[1], 1.0 / rows[0].shape[1])
    for _ in range(_BY.multiplied):
        weights = weights * _shares(rows, weights)
        weights = weights / weights.sum()
    large = weights >= _BY.small * weights.max()
    if all(_whole(one[:, large]) for one in rows):
        weights[~large] = 0.0
    return np.asarray(weights / weights.sum())


def _whole(rows: Array) -> bool:
    """Return whether rows of parts, shape (p, s, r, n), have all of the rank."""
    n = rows.shape[3]
    return bool((np.linalg.matrix_rank(rows.reshape(len(rows), -1, n)) == n).all())


def _interior(rows: Parts, weights: Array, gap: float) -> Array:
    """Return the weights of few candidates that maximise log det M, by an interior-point method.

    Slacks z of dⱼ + zⱼ = n, and wⱼ zⱼ = μ → 0. The gradient is dⱼ, the Hessian −|Aᵢ M⁻¹ Aⱼᵀ|².

    Args:
        rows: Of the candidates: see ``_stacked``.
        weights: Where it begins.
        gap: Part by which dⱼ may exceed n; the least weights are dropped then.
    """
    s, n = len(weights), sum(len(one) * one.shape[3] for one in rows)
    w = (1.0 - _BY.mixed) * weights + _BY.mixed / s
    hessian, gradient = _derivatives(rows, w)
    z = np.maximum(n - gradient, _BY.mixed * n)
    for _ in range(_BY.steps):
        middle = _BY.centred * float(w @ z) / s
        sides = np.column_stack((gradient + middle / w, np.ones(s)))
        hessian[np.diag_indices(s)] += z / w
        _, both, failed = lapack.dposv(hessian, sides)
        both = np.linalg.solve(hessian, sides) if failed else both  # rounding: not quite positive
        level = (both[:, 0].sum() + w.sum() - 1.0) / both[:, 1].sum()
        by_w = both[:, 0] - level * both[:, 1]
        by_z = middle / w - z - z / w * by_w
        w, z = w + _inside(w, by_w) * by_w, z + _inside(z, by_z) * by_z
        hessian, gradient = _derivatives(rows, w)
        if gradient.max() <= n * (1.0 + gap):
            least = np.argsort(w)
            most = min(_BY.dropped * gap, 0.5 / (n * (1.0 + gap)))  # at least M / 2 stays
            w[least[np.cumsum(w[least]) <= most]] = 0.0
            break
    return np.asarray(w / w.sum())


def _inside(values: Array, change: Array) -> float:
    """Return how much of a change leaves positive values positive, 1 at most."""
    falling = change < 0.0
    return float(np.min(0.99 * values[falling] / -change[falling], initial=1.0))


def _derivatives(rows: Parts, weights: Array) -> tuple[Array, Array]:
    """Return what log det M is by weights: minus its Hessian, (s, s), and its gradient, (s,)."""
    s = len(weights)
    hessian, gradient = np.zeros((s, s)), np.zeros(s)
    for one in rows:
        (turned, shares), (p, _, r, n) = _turned_by_inverse(one, weights), one.shape
        gradient += shares
        if r * r < n:  # |Aᵢ M⁻¹ Aⱼᵀ|² itself
            K = turned @ one.reshape(p, s * r, n).swapaxes(1, 2)
            squared = np.einsum("pij,pij->ij", K, K)
            hessian += squared if r == 1 else squared.reshape(s, r, s, r).sum(axis=(1, 3))
        else:  # tr Pᵢ Pⱼ
            products = turned.reshape(p, s, r, n).swapaxes(2, 3) @ one
            for P in products.reshape(p, s, n, n):
                hessian += P.reshape(s, -1) @ P.swapaxes(1, 2).reshape(s, -1).T
    return hessian, gradient
