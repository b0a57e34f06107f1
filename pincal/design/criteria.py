"""What a choice of poses is to make large: the information, or the platform's accuracy.

D-optimality: log det M, M = Σ Aⱼᵀ Aⱼ. L-optimality (I- and V-optimality where L is a mean over a
region): −log tr L M⁻¹, the platform's mean variance over the workspace, correlations of all
parameters included. A. C. Atkinson, A. N. Donev, R. D. Tobias, Optimum Experimental Designs, with
SAS (2007), 10.5 and 10.6. Adding A to M, or dropping it, changes both by what K = A M⁻¹ Aᵀ and
Q = A M⁻¹ L M⁻¹ Aᵀ say, r × r matrices for a candidate of r rows (Woodbury).

Parameters that share no row, such as those of two legs, share no information: M falls into parts,
and their determinants multiply. Rows are a tuple, an array (…, M, r, n) for each part; several
choices, S of them, are looked at together.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Protocol, TypeAlias

import numpy as np

from pincal.kinematics.batches import chunks
from pincal.types import Array, Index

Parts: TypeAlias = tuple[Array, ...]
"""Of each part of the parameters, the rows of candidates, (M, r, n), or its M⁻¹, (S, n, n)."""


class Criterion(Protocol):
    """What is made large."""

    def scaled(self, scales: tuple[Array, ...]) -> tuple[Criterion, float]:
        """Return the criterion of rows over ``scales``, (n,) each, and what its value lacks."""

    def value(self, rows: Parts) -> float:
        """Return the value of rows, shape (m, n) for each part."""

    def change(self, rows: Parts, inverse: Parts, sign: float) -> Array:
        """Return what each candidate changes, added (1) or dropped (-1), shape (S, M).

        Args:
            rows: Of candidates, shape (M, r, n), or of each choice its own, (S, M, r, n).
            inverse: M⁻¹ of each choice, shape (S, n, n).
            sign: 1 or -1.
        """

    def turns(self, inverse: Parts) -> Parts:
        """Return T, shape (S, n, k) for each part.

        |Aⱼ T|² is the change by a small weight on a candidate, to first order, but for a factor.
        """

    def slope(self, squared: Parts, inverse: Parts) -> Array:
        """Return the change by a small weight on each candidate, to first order, shape (S, M).

        Swaps change the value by less than these differ: it is concave.

        Args:
            squared: See ``grams``.
            inverse: M⁻¹ of each choice, shape (S, n, n).
        """

    def most(self, squared: Parts, inverse: Parts, widths: tuple[int, ...]) -> Array:
        """Return exp of what each candidate changes at most, added, shape (S, M).

        It is what it changes where candidates have one row of each part.

        Args:
            squared: See ``grams``.
            inverse: M⁻¹ of each choice, shape (S, n, n).
            widths: r of each part.
        """


@dataclass(frozen=True)
class Determinant:
    """log det M."""

    def scaled(self, scales: tuple[Array, ...]) -> tuple[Criterion, float]:
        """See ``Criterion``."""
        return self, 2.0 * sum(float(np.log(scale).sum()) for scale in scales)

    def value(self, rows: Parts) -> float:
        """See ``Criterion``."""
        found = [np.linalg.slogdet(one.T @ one) for one in rows]
        return sum(float(value) if sign > 0 else -np.inf for sign, value in found)

    def change(self, rows: Parts, inverse: Parts, sign: float) -> Array:
        """See ``Criterion``: log det(I ± K)."""
        found = [_log_det(inner(*pair), sign) for pair in zip(rows, inverse, strict=True)]
        return np.asarray(sum(found))

    def turns(self, inverse: Parts) -> Parts:
        """See ``Criterion``: M⁻¹ = T Tᵀ, which rounding may have left not quite positive."""
        pairs = [np.linalg.eigh(one) for one in inverse]
        return tuple(axes * np.sqrt(np.maximum(values, 0.0))[:, None] for values, axes in pairs)

    def slope(self, squared: Parts, inverse: Parts) -> Array:
        """See ``Criterion``: tr K."""
        pairs = zip(squared, inverse, strict=True)
        return np.asarray(sum(_forms(one, by) for one, by in pairs))

    def most(self, squared: Parts, inverse: Parts, widths: tuple[int, ...]) -> Array:
        """See ``Criterion``: det(I + K) ≤ (1 + tr K / r)ʳ."""
        found = np.ones((len(inverse[0]), squared[0].shape[1]))
        for one, by, r in zip(squared, inverse, widths, strict=True):
            factor = 1.0 + _forms(one, by) / r
            for _ in range(r):
                found *= factor
        return found


@dataclass(frozen=True)
class MeanVariance:
    """−log tr C Cᵀ M⁻¹: of quantities Cᵀφ, the sum of the variances; parameters are one part."""

    C: Array
    """What is to be known, in the unknowns, shape (n, q)."""

    def scaled(self, scales: tuple[Array, ...]) -> tuple[Criterion, float]:
        """See ``Criterion``."""
        (scale,) = scales
        return MeanVariance(self.C / scale[:, None]), 0.0

    def value(self, rows: Parts) -> float:
        """See ``Criterion``."""
        (own,) = rows
        triangle = np.asarray(np.linalg.qr(own, mode="r"))
        if len(triangle) < len(self.C) or not np.abs(np.diagonal(triangle)).min() > 0.0:
            return -np.inf
        return -float(np.log((np.linalg.solve(triangle.T, self.C) ** 2).sum()))

    def change(self, rows: Parts, inverse: Parts, sign: float) -> Array:
        """See ``Criterion``: tr L M⁻¹ falls, or grows, by tr (I ± K)⁻¹ Q."""
        (own,), (by,) = rows, inverse
        half = _times(own, by @ self.C)
        middle = np.eye(own.shape[-2]) + sign * inner(own, by)
        change = (half * np.linalg.solve(middle, half)).sum(axis=(2, 3))
        with np.errstate(divide="ignore", invalid="ignore"):
            changed = -np.log(np.maximum(1.0 - sign * change / self._now(by), 0.0))
        return np.where(change >= 0.0, changed, -np.inf)  # below, what is dropped was all there was

    def turns(self, inverse: Parts) -> Parts:
        """See ``Criterion``: M⁻¹ C."""
        (by,) = inverse
        return (by @ self.C,)

    def slope(self, squared: Parts, inverse: Parts) -> Array:
        """See ``Criterion``: tr Q / tr L M⁻¹."""
        (own,), (by,) = squared, inverse
        half = by @ self.C
        return _forms(own, half @ half.swapaxes(1, 2)) / self._now(by)

    def most(self, squared: Parts, inverse: Parts, widths: tuple[int, ...]) -> Array:
        """See ``Criterion``: tr (I + K)⁻¹ Q ≤ tr Q."""
        (own,), (by,) = squared, inverse
        half = by @ self.C
        change = _forms(own, half @ half.swapaxes(1, 2))
        if widths == (1,):
            change /= 1.0 + _forms(own, by)
        left = 1.0 - change / self._now(by)
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(left > 0.0, 1.0 / left, np.inf)

    def _now(self, inverse: Array) -> Array:
        """Return tr L M⁻¹ of each choice, shape (S, 1)."""
        return np.einsum("nq,snm,mq->s", self.C, inverse, self.C)[:, None]


def grams(rows: Array) -> Array:
    """Return the upper halves of Aᵀ A of candidates (M, r, n), shape (n (n + 1) / 2, M)."""
    along = np.ascontiguousarray(rows.transpose(1, 2, 0))
    upper, lower, _ = _half(rows.shape[2])
    found = np.zeros((len(upper), len(rows)))
    for row in along:
        found += row[upper] * row[lower]
    return found


def _forms(squared: Array, matrices: Array) -> Array:
    """Return tr A F Aᵀ, shape (S, M), by upper halves (q, M) of Aᵀ A, and symmetric F (S, n, n)."""
    upper, lower, times = _half(matrices.shape[1])
    return np.asarray((matrices[:, upper, lower] * times) @ squared)


@lru_cache(maxsize=16)
def _half(n: int) -> tuple[Index, Index, Array]:
    """Return rows and columns of the upper half of a matrix, and how often each number is there."""
    upper, lower = np.triu_indices(n)
    return upper, lower, np.where(upper == lower, 1.0, 2.0)


def _times(rows: Array, matrix: Array) -> Array:
    """Return rows (M, r, n) or (S, M, r, n) times matrices (S, n, q), shape (S, M, r, q)."""
    flat = rows.reshape(*rows.shape[:-3], -1, rows.shape[-1])
    return (flat @ matrix).reshape(len(matrix), *rows.shape[-3:-1], matrix.shape[2])


def inner(rows: Array, inverse: Array) -> Array:
    """Return K = Aⱼ M⁻¹ Aⱼᵀ, shape (S, M, r, r), of candidates and choices."""
    left, r, own = _times(rows, inverse), rows.shape[-2], rows.reshape(-1, *rows.shape[-3:])
    K = np.empty((*left.shape[:2], r, r))
    for a in range(r):
        for b in range(a, r):
            both = np.einsum("smn,smn->sm", left[:, :, a], own[:, :, b])
            K[:, :, a, b] = K[:, :, b, a] = both
    return K


def _log_det(K: Array, sign: float) -> Array:
    """Return log det(I ± K) by elimination, shape (S, M); −∞ where it is not above zero."""
    r = K.shape[-1]
    A, found = np.eye(r) + sign * K, np.zeros(K.shape[:2])
    with np.errstate(divide="ignore", invalid="ignore"):
        for i in range(r):
            pivot = np.maximum(A[..., i, i], 0.0)
            found = found + np.log(pivot)
            for j in range(i + 1, r):
                factor = np.where(pivot > 0.0, A[..., j, i] / pivot, 0.0)
                A[..., j, i + 1 :] -= factor[..., None] * A[..., i, i + 1 :]
    return found


Some: TypeAlias = Index | slice
"""Places of candidates."""
_AT_ONCE = 8192  # candidates looked at: their products stay near the processor


class Rows(Protocol):
    """Rows of M candidates, by their places; NaN where one is out of reach."""

    @property
    def total(self) -> int:
        """M."""

    def __call__(self, places: Some) -> Parts:
        """Return the rows of some, of each part of the parameters, shape (s, r, n)."""


class Held:
    """Rows in memory."""

    def __init__(self, parts: Parts) -> None:
        self.parts = parts
        self.total = len(parts[0])

    def __call__(self, places: Some) -> Parts:
        """See ``Rows``."""
        return tuple(one[places] for one in self.parts)


def squares(rows: Rows, places: Index, turns: Parts) -> Array:
    """Return Σ |Aⱼ T|² over all parts of each candidate, shape (s,): in parts that memory holds.

    Args:
        rows: The rows.
        places: Candidates.
        turns: T of each part, shape (n, k).
    """
    found, whole = np.zeros(len(places)), len(places) == rows.total
    for some in chunks(len(places), _AT_ONCE):
        for one, turn in zip(rows(some if whole else places[some]), turns, strict=True):
            for row in one.transpose(1, 2, 0):
                turned = turn.T @ row  # one number of all candidates beside the other in memory
                found[some] += np.einsum("km,km->m", turned, turned)
    return found


def most_of(values: Array, count: int) -> Index:
    """Return where the largest values are, in order of their places."""
    count = min(count, len(values))
    return np.sort(np.argpartition(-values, count - 1)[:count]) if count else np.arange(0)
