"""What a choice of poses is to make large: the information, or the platform's accuracy.

D-optimality: log det M, M = Σ Aⱼᵀ Aⱼ. L-optimality (I- and V-optimality where L is a mean over a
region): −log tr L M⁻¹, the platform's mean variance over the workspace, correlations of all
parameters included. A. C. Atkinson, A. N. Donev, R. D. Tobias, Optimum Experimental Designs, with
SAS (2007), 10.5 and 10.6. Adding A to M, or dropping it, changes both by what K = A M⁻¹ Aᵀ and
Q = A M⁻¹ L M⁻¹ Aᵀ say, r × r matrices for a candidate of r rows (Woodbury).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Criterion(Protocol):
    """What is made large."""

    def scaled(self, scale: Array) -> tuple[Criterion, float]:
        """Return the criterion of rows over ``scale``, shape (n,), and what its value lacks."""

    def value(self, rows: Array) -> float:
        """Return the value of rows, shape (m, n)."""

    def change(self, blocks: Array, inverse: Array, sign: float) -> Array:
        """Return what each candidate, shape (M, r, n), changes, added (1) or dropped (-1)."""

    def promise(self, blocks: Array, inverse: Array) -> Array:
        """Return the change by a small weight on each candidate, to first order, shape (M,)."""


@dataclass(frozen=True)
class Determinant:
    """log det M."""

    def scaled(self, scale: Array) -> tuple[Criterion, float]:
        """See ``Criterion``."""
        return self, 2.0 * float(np.log(scale).sum())

    def value(self, rows: Array) -> float:
        """See ``Criterion``."""
        sign, value = np.linalg.slogdet(rows.T @ rows)
        return float(value) if sign > 0 else -np.inf

    def change(self, blocks: Array, inverse: Array, sign: float) -> Array:
        """See ``Criterion``: log det(I ± K)."""
        K = inner(blocks, inverse)
        if K.shape[1] == 1:
            det = 1.0 + sign * K[:, 0, 0]
        else:
            det = np.linalg.det(np.eye(K.shape[1]) + sign * K)
        with np.errstate(divide="ignore"):
            return np.asarray(np.log(np.maximum(det, 0.0)))

    def promise(self, blocks: Array, inverse: Array) -> Array:
        """See ``Criterion``: tr K."""
        return np.asarray(np.trace(inner(blocks, inverse), axis1=1, axis2=2))


@dataclass(frozen=True)
class MeanVariance:
    """−log tr C Cᵀ M⁻¹: of quantities Cᵀφ, the sum of the variances."""

    C: Array
    """What is to be known, in the unknowns, shape (n, q)."""

    def scaled(self, scale: Array) -> tuple[Criterion, float]:
        """See ``Criterion``."""
        return MeanVariance(self.C / scale[:, None]), 0.0

    def value(self, rows: Array) -> float:
        """See ``Criterion``."""
        triangle = np.asarray(np.linalg.qr(rows, mode="r"))
        if len(triangle) < len(self.C) or not np.abs(np.diagonal(triangle)).min() > 0.0:
            return -np.inf
        return -float(np.log((np.linalg.solve(triangle.T, self.C) ** 2).sum()))

    def change(self, blocks: Array, inverse: Array, sign: float) -> Array:
        """See ``Criterion``: tr L M⁻¹ falls, or grows, by tr (I ± K)⁻¹ Q."""
        flat = blocks.reshape(-1, blocks.shape[2]) @ (inverse @ self.C)
        half = flat.reshape(*blocks.shape[:2], -1)
        middle = np.eye(blocks.shape[1]) + sign * inner(blocks, inverse)
        now = float(np.einsum("nq,nm,mq->", self.C, inverse, self.C))
        by = (half * np.linalg.solve(middle, half)).sum(axis=(1, 2))
        with np.errstate(divide="ignore", invalid="ignore"):
            changed = -np.log(np.maximum(1.0 - sign * by / now, 0.0))
        return np.where(by >= 0.0, changed, -np.inf)  # below, what is dropped was all there was

    def promise(self, blocks: Array, inverse: Array) -> Array:
        """See ``Criterion``: tr Q over tr L M⁻¹."""
        flat = blocks.reshape(-1, blocks.shape[2]) @ (inverse @ self.C)
        now = float(np.einsum("nq,nm,mq->", self.C, inverse, self.C))
        return np.asarray((flat**2).sum(axis=1).reshape(len(blocks), -1).sum(axis=1) / now)


def inner(blocks: Array, inverse: Array) -> Array:
    """Return K = Aⱼ M⁻¹ Aⱼᵀ, shape (M, r, r), of candidates of shape (M, r, n)."""
    left = (blocks.reshape(-1, blocks.shape[2]) @ inverse).reshape(blocks.shape)
    if blocks.shape[1] == 1:
        return (left * blocks).sum(axis=2)[:, :, None]
    return left @ blocks.transpose(0, 2, 1)
