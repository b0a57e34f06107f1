"""Robust losses: how much a row of measurements counts, by how far off it is.

A row is judged as a whole, by the sum of its squared residuals in standard deviations, which
of good rows is χ² with as many degrees of freedom as the row gives equations. Tuning constants
are those in use for one residual (Huber 1.345, Cauchy 2.385, Tukey 4.685: 95 % efficiency),
carried to more by equal probability.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.special import chdtr, chdtrc, chdtri, gammaincinv

from pincal.errors import MeasurementError
from pincal.types import Array, Index, Mask

LossName = Literal["none", "huber", "cauchy", "tukey", "reject"]
UNLIKELY = 1e-3  # probability that a good row is left out; that fit and held-out rows part
_STEP = 1e-4  # of the logarithm of a residual, for slopes
_LEAST_BEND = 1e-2
CLEAR = 3.0  # standard errors, from which what is seen is there
FALSE_ALARM = 0.01  # probability of anything found, of a kind, where the model holds


@dataclass(frozen=True)
class Loss:
    """Weights of rows by the root of their χ²."""

    name: str
    weigh: Callable[[Array], Array]
    """Weight by the root of χ² over the tuning constant."""
    probability: float
    """Probability below which a good row's χ² lies under the square of the constant."""

    def constant(self, equations: Index) -> Array:
        """Return the tuning constant of rows by their number of equations, same shape."""
        return np.sqrt(_quantile(self.probability, np.maximum(equations, 1)))

    def weights(self, squares: Array, equations: Index) -> Array:
        """Return the weight of each row, shape (N,), by its χ² and its number of equations."""
        return self.weigh(np.sqrt(squares) / self.constant(equations))

    def slope(self, squares: Array, equations: Index) -> Array:
        """Return the curvature along the residuals, d(u w)/du, shape (N,)."""
        u, h = np.sqrt(squares) / self.constant(equations), _STEP
        less, upper = (np.exp(step) * self.weigh(u * np.exp(step)) for step in (-h, h))
        return np.asarray((upper - less) / (2.0 * np.sinh(h)))

    def bend(self, squares: Array, equations: Index) -> Array:
        """Return the curvature along the residuals over the weight, shape (N,).

        Kept above zero, as what is minimised must rise on both sides.
        """
        w = self.weights(squares, equations)
        bend = np.divide(self.slope(squares, equations), w, out=np.ones_like(w), where=w > 0.0)
        return np.clip(bend, _LEAST_BEND, 1.0)

    def moments(
        self, squares: Array, equations: Index, free: int = 0
    ) -> tuple[float, float, float]:
        """Return slope and square of ψ of rows that fit, and Huber's factor for few of them.

        Over all n equations and p free parameters: m, the mean of ψ's slopes (w across the
        residuals, d(u w)/du along them), the square Σ w² d² / (n − p), and K = 1 + (p / n) v / m²,
        v the slopes' variance (P. J. Huber, Robust Statistics, 1981, 7.6).
        """
        k, w = equations.astype(float), self.weights(squares, equations)
        n, along = max(float(k.sum()), 1.0), self.slope(squares, equations)
        along, across = np.where(k > 0.0, along, 0.0), np.maximum(k - 1.0, 0.0)
        m = max(float(across @ w + along.sum()) / n, _LEAST_BEND)
        v = float(across @ w**2 + (along**2).sum()) / n - m**2
        return m, float(w**2 @ squares) / max(n - free, 1.0), 1.0 + free / n * v / m**2


_WEIGHTS: dict[str, tuple[Callable[[Array], Array], float]] = {
    "huber": (lambda u: 1.0 / np.maximum(1.0, u), float(chdtr(1, 1.345**2))),
    "cauchy": (lambda u: 1.0 / (1.0 + u**2), float(chdtr(1, 2.385**2))),
    "tukey": (lambda u: (1.0 - np.minimum(u, 1.0) ** 2) ** 2, float(chdtr(1, 4.685**2))),
    "reject": (lambda u: np.where(u < 1.0, 1.0, 0.0), 1.0 - UNLIKELY),
}
LOSSES: dict[str, Loss] = {name: Loss(name, *weights) for name, weights in _WEIGHTS.items()}


def outlying(squares: Array, equations: Index) -> Mask:
    """Return which rows have a χ² that one good row in a thousand exceeds, shape (N,)."""
    return np.asarray(squares > chdtri(np.maximum(equations, 1), UNLIKELY))


def suspected(squares: Array, equations: Index) -> Mask:
    """Return which rows are outliers however many there are (S. Holm 1979), shape (N,).

    Of good data, one set of rows in a hundred has any.
    """
    p = chdtrc(np.maximum(equations, 1), squares)
    order = np.argsort(p)
    clear = p[order] <= FALSE_ALARM / (len(p) - np.arange(len(p)))
    outliers = np.zeros(len(p), dtype=bool)
    outliers[order[: len(p) if clear.all() else int(np.argmin(clear))]] = True
    return outliers


def robust_scale(squares: Array, equations: Index, share: float) -> float:
    """Return the scale of the noise that the median of the rows' χ² tells.

    Residuals of a fit are smaller than the noise, by the share of degrees of freedom in equations.
    """
    counts = equations > 0
    ratio = squares[counts] / _quantile(0.5, equations[counts])
    return float(np.sqrt(np.median(ratio) / share)) if counts.any() else 1.0


def loss_of(loss: LossName | Loss) -> Loss | None:
    """Return a loss by its name, or one of one's own; none for ``"none"``.

    Raises:
        MeasurementError: no such loss.
    """
    if isinstance(loss, Loss):
        return loss
    if loss == "none":
        return None
    if loss not in LOSSES:
        raise MeasurementError(
            f"unknown loss {loss!r}; expected one of none, {', '.join(LOSSES)}, or a pincal.Loss"
        )
    return LOSSES[loss]


def _quantile(probability: Array | float, equations: Index | int) -> Array:
    """Return what χ² lies below with a probability."""
    return np.asarray(2.0 * gammaincinv(np.asarray(equations) / 2.0, probability))
