"""Probabilities by chance: of a part of residuals along errors, and of many tests as one.

Errors whose amplitudes are as large as each other, for all that is known, leave W a in the
residuals: along them lies |Wᵀ M r|², by chance a sum of squares of normal numbers weighted by the
eigenvalues of Wᵀ M W (the score test of a variance: X. Lin, Biometrika 84, 1997). So directions
that parameters hide count as little as they can show; an F test counts all alike. The scale of the
noise is that of all residuals: P(Σ λᵢ zᵢ² > t Σ zⱼ²) is that of a weighted sum above zero, by its
saddle point (D. Kuonen, Biometrika 86, 1999).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtrc, ndtr

from pincal.estimation.observability.indices import NEGLIGIBLE, RANK_TOLERANCE
from pincal.estimation.residuals.losses import UNLIKELY
from pincal.model.checks import ROUNDING

Array = NDArray[np.float64]
_HALVINGS = int(np.ceil(-np.log2(ROUNDING)))  # of the interval in which a saddle point lies


@dataclass(frozen=True)
class Form:
    """What residuals say of errors: how much of them could be seen, and what is."""

    weights: Array
    """Eigenvalues of Wᵀ M W, shape (f,), the largest last."""
    inside: float
    """|Wᵀ M r|²."""
    length: float
    """Tr WᵀW: what there would be to see if parameters took up nothing."""

    @property
    def seen(self) -> bool:
        """Whether parameters leave anything of these errors."""
        return bool(self.weights[-1] > NEGLIGIBLE**2 * self.length > 0.0)


def of_forms(forms: Sequence[Form], chi2: float, degrees_of_freedom: int) -> Array:
    """Return the probability of so much along errors, or more, of each form; 1 if nothing is seen.

    Args:
        forms: Of different errors.
        chi2: Of all residuals.
        degrees_of_freedom: Of them.
    """
    found = np.ones(len(forms))
    known = [i for i, one in enumerate(forms) if one.seen and len(one.weights) < degrees_of_freedom]
    if not known or not chi2 > 0.0:
        return found
    weights = np.zeros((len(known), max(len(forms[i].weights) for i in known)))
    for row, i in zip(weights, known, strict=True):
        own = forms[i].weights
        row[: len(own)] = own.clip(0.0) / own[-1]
    shares = np.array([forms[i].inside / forms[i].weights[-1] for i in known]) / chi2
    found[known] = above(weights, shares.clip(0.0, 1.0), degrees_of_freedom)
    return found


def above(weights: Array, shares: Array, degrees_of_freedom: int) -> Array:
    """Return the probability that a weighted sum of squares is above a share of all squares.

    Σ λᵢ zᵢ² > t Σ zⱼ² of independent normal numbers z, i to k and j to all degrees of freedom.

    Args:
        weights: λ, 0 to 1 with a 1 among them, shape (M, k).
        shares: t, 0 to 1, shape (M,).
        degrees_of_freedom: More than k.
    """
    rest = degrees_of_freedom - weights.shape[1]
    alone = (weights > RANK_TOLERANCE).sum(axis=1) == 1
    t = np.clip(shares, RANK_TOLERANCE, 1.0 - RANK_TOLERANCE)[:, None]
    c = np.concatenate((weights - t, -t), axis=1)
    count = np.append(np.ones(weights.shape[1]), rest)
    low, high = -0.5 / t, 0.5 / (1.0 - t)
    for _ in range(_HALVINGS):
        at = 0.5 * (low + high)
        rising = (count * c / (1.0 - 2.0 * at * c)).sum(axis=1, keepdims=True) > 0.0
        low, high = np.where(rising, low, at), np.where(rising, at, high)
    at = 0.5 * (low + high)
    left = 1.0 - 2.0 * at * c
    K = -0.5 * (count * np.log(left)).sum(axis=1)
    bend = 2.0 * (count * (c / left) ** 2).sum(axis=1)
    w, v = np.sign(at[:, 0]) * np.sqrt((-2.0 * K).clip(0.0)), at[:, 0] * np.sqrt(bend)
    flat = np.abs(w) < UNLIKELY  # so near to the mean it is a half
    w, v = np.where(flat, 1.0, w), np.where(flat, 1.0, v)
    found = np.where(flat, 0.5, ndtr(-(w + np.log(v / w) / w)))
    free = degrees_of_freedom - 1
    exact = fdtrc(1, free, free * t[:, 0] / (1.0 - t[:, 0]))  # of one square
    return np.where(alone, exact, found)


def together(p_values: Array, weights: Array) -> float:
    """Return the probability that tests, which need not be independent, find so much by chance.

    By Cauchy's distribution: the mean of 1/p but for what all tests are when nothing is there
    (Y. Liu, J. Xie, J. Am. Stat. Assoc. 115, 2020). Tests that agree strengthen each other.

    Args:
        p_values: Of some tests, shape (k,).
        weights: Of these tests; of all that were made they sum to 1, shape (k,).
    """
    p = np.clip(p_values, 1e-300, 1.0 - weights)
    mean = float((weights / np.tan(np.pi * p)).sum())
    return float(0.5 - np.arctan(mean) / np.pi) if mean < 1e9 else 1.0 / (np.pi * mean)
