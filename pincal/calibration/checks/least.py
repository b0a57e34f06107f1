"""The least of several folds' probabilities: folds share rows, so their tests are dependent.

To first order all of them follow from one fit of all rows, J = Q R: a fold's residuals are
e = z − Q_f c, c = Σ Q_fᵀ z, z of unit variance, and its statistic is eᵀ (1 − Q_f Q_fᵀ)⁻¹ e. Only
the part of z in the range of Q_f is shared with other folds, so few numbers need be drawn.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import bdtrc, betaincinv, chdtri

from pincal.design.platform_error import DRAWS
from pincal.estimation.fit import Fit
from pincal.estimation.linear import Orthonormal
from pincal.estimation.residuals.robust import Robust

Array = NDArray[np.float64]
_RANK = 1e-10  # least share of a direction in a fold


def least_of_folds(
    least: float, fits: Sequence[Robust], groups: NDArray[np.intp], *, known: bool
) -> float:
    """Return the probability that the least of all folds' probabilities is so small, or smaller.

    By draws from what the model would make of noise; where none is as small, what independent folds
    would give (Šidák 1967) if that is less.

    Args:
        least: The least probability of a fold.
        fits: Of all rows.
        groups: The fold of each row of the measurements, shape (N,); below 0 in none.
        known: Whether the scale of the noise is known, else folds are compared with the others.
    """
    count = int(groups.max()) + 1
    bound = float(bdtrc(0, count, least))
    if count < 2 or (groups < 0).any():
        return bound
    random = np.random.default_rng(0)
    parts = [_drawn(robust.fit, groups[robust.rows], count, random) for robust in fits]
    inside, own, equations = (np.sum(one, axis=0) for one in zip(*parts, strict=True))
    dof = sum(one.fit.degrees_of_freedom for one in fits)
    if known:
        unlikely = inside >= chdtri(equations, least)
    else:  # of a share x of all, or more: the chance that 1 − x follows a beta distribution
        rest = own.sum(axis=1, keepdims=True) - inside
        share = betaincinv(0.5 * (dof - equations), 0.5 * equations, least)
        unlikely = (rest > 0.0) & (inside * share >= rest * (1.0 - share))
    below = int(unlikely.any(axis=1).sum())
    return (1 + below) / (1 + DRAWS) if below else min(bound, 1 / (1 + DRAWS))


def _drawn(
    one: Fit, folds: NDArray[np.intp], count: int, random: np.random.Generator
) -> tuple[Array, Array, Array]:
    """Return drawn statistics and squared residuals of folds, (draws, count), their equations."""
    weights = (one.weights > 0.0)[:, None, None]
    J = np.where(weights, one.last.jacobian @ one.unknowns.map, 0.0)
    _, prior = one.unknowns.prior_rows(one.unknowns.start)
    by = Orthonormal.of(J, prior)
    Q = by(J).transpose(0, 2, 1)
    roots, kept = [], []  # draws need no more than single precision
    for fold in range(count):
        part = Q[folds == fold]
        share, V = np.linalg.eigh(np.einsum("nim,njm->ij", part, part))
        has = share > _RANK
        root = np.sqrt(share[has])[:, None] * V[:, has].T
        roots.append((root.astype(np.float32), (1.0 - share[has]).astype(np.float32)))
        kept.append(int(one.last.equations[folds == fold][weights[folds == fold, 0, 0]].sum()))
    drawn = [random.standard_normal((DRAWS, len(left)), np.float32) for _, left in roots]
    taken = sum(u @ root for u, (root, _) in zip(drawn, roots, strict=True))
    if len(prior):
        held = by(prior).astype(np.float32)
        taken = taken + random.standard_normal((DRAWS, len(prior)), np.float32) @ held
    inside, own = np.empty((DRAWS, count)), np.empty((DRAWS, count))
    for fold, (u, (root, left)) in enumerate(zip(drawn, roots, strict=True)):
        squares = np.square(u - taken @ root.T)
        rest = random.chisquare(max(kept[fold] - len(left), 1e-9), DRAWS)
        inside[:, fold] = squares @ (1.0 / np.maximum(left, _RANK)) + rest
        own[:, fold] = squares.sum(axis=1) + rest
    return inside, own, np.array(kept, dtype=float)
