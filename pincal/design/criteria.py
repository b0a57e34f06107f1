"""Criteria that a choice of poses makes large: information, or accuracy of the platform.

Candidate j contributes rows Aⱼ, shape (r, n); weights make M = Σ wⱼ Aⱼᵀ Aⱼ. D-optimality: log det
M. L-optimality (I- and V-optimality where L is a mean over a region): −log tr L M⁻¹, the platform's
mean variance over the workspace, correlations of all parameters included. A. C. Atkinson,
A. N. Donev, R. D. Tobias, Optimum Experimental Designs, with SAS (2007), 10.5 and 10.6.

They are Kiefer's criteria of order p = 0 and 1: concave in M, and read off two products of
candidates. With M⁻¹ = R Rᵀ and a direction H of the criterion,

    W = A R,   K = W Wᵀ,   Q = W H (W H)ᵀ,
    gradient  gⱼ = tr Qⱼⱼ,   minus Hessian  (1 + p) tr Kᵢⱼ Qⱼᵢ − p gᵢ gⱼ,

and rows that come add to the value a function of the same K and Q (Woodbury). Parameters that
share no row, such as those of two legs, share no information: M falls into parts, and their
determinants multiply. Rows are a tuple with an array for each part.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from pincal.kinematics.batches import solve
from pincal.model.checks import ROUNDING
from pincal.types import Array

Parts: TypeAlias = tuple[Array, ...]
"""An array for each part of the parameters, such as rows of candidates, (M, r, n)."""


@dataclass(frozen=True)
class Criterion:
    """log det M or, of quantities Cᵀφ, minus the logarithm of the sum of the variances."""

    C: Array | None = None
    """Quantities that are to be known, in the unknowns, which are one part, shape (n, q)."""

    def value(self, rows: Parts) -> float:
        """Return the value of rows, shape (m, r, n) for each part; −∞ if they lack rank."""
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
        """Return H by roots R of M⁻¹, shape (S, n, n): the unit matrix, or Rᵀ C over its norm."""
        if self.C is None:
            return np.broadcast_to(np.eye(root.shape[-1]), root.shape)
        half = root.mT @ self.C
        return np.asarray(half / np.linalg.norm(half, axis=(1, 2), keepdims=True))

    def gain(self, rows: Array, root: Array) -> Array:
        """Return what each of M candidates adds to the value of one part, shape (S, M).

        log det(1 + K), or −log(1 − tr (1 + K)⁻¹ Q): see the module.

        Args:
            rows: Rows of the candidates, shape (M, r, n).
            root: R of M⁻¹ = R Rᵀ of S sets to which they come, shape (S, n, n).
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
    """Return Wⱼ Wⱼᵀ of candidates with r rows each, shape (S, M r, k) to (S M, r, r)."""
    W = W.reshape(-1, r, W.shape[2])
    return np.einsum("mik,mik->m", W, W)[:, None, None] if r == 1 else W @ W.mT


def triangles(rows: Parts) -> Parts:
    """Return a triangle R of each part, shape (n, n) or less: Rᵀ R is the Gram of all rows."""
    flat = (part.reshape(-1, part.shape[-1]) for part in rows)
    return tuple(np.asarray(np.linalg.qr(part, mode="r")) for part in flat)


def gradient(rows: Parts, turns: Parts) -> Array:
    """Return |Aⱼ T|² of each candidate, shape (M,), by T of each part, shape (n, k).

    With T = R H it is the change of the value by a small weight on the candidate.
    """
    total = np.zeros(len(rows[0]))
    for part, turn in zip(rows, turns, strict=True):
        turned = (part.reshape(-1, len(turn)) @ turn).reshape(len(part), -1)
        total += np.einsum("mk,mk->m", turned, turned)
    return total


def inverse_roots(information: Array) -> Array:
    """Return R of M⁻¹ = R Rᵀ, shape (S, n, n) for both."""
    return np.linalg.inv(np.linalg.cholesky(information)).mT
