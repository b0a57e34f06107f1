"""How an estimate spreads: its covariance, and how it follows the noise of each row.

At the optimum Σ Jᵀψ = 0, and δz = −B⁻¹ Σ Jᵀψ, B = Σ Jᵀ ψ' J, has the covariance B⁻¹ M B⁻¹,
M = Σ Jᵀ E[ψψᵀ] J. Of least squares M = B. With a robust loss, rows that fit give to B and M what
such rows give on average; an outlier gives its own ψψᵀ, for nobody knows what it is drawn from
(P. J. Huber, Robust Statistics, 1981, 7.6).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from pincal.estimation.linear import Linear
from pincal.estimation.residuals.losses import FALSE_ALARM
from pincal.estimation.system import Normal, System

Array = NDArray[np.float64]
_FALLEN = 0.9  # of what determines a direction, that falling slopes may take away


@dataclass(frozen=True)
class Spread:
    """What each row gives to B and M."""

    system: System
    linear: Linear
    slopes: Array
    """Of ψ, in B: the mean one of rows that fit, an outlier's weight; shape (N,)."""
    falls: Array
    """By how much an outlier's slope along its residuals is less, shape (N,)."""
    noises: Array
    """Root mean square of ψ in M of rows that fit, 0 of outliers, shape (N,)."""
    pulls: Array
    """ψ over the residuals of outliers, 0 of rows that fit, shape (N,)."""

    @classmethod
    def of(
        cls, system: System, linear: Linear, weights: Array, scale: float, variance: float
    ) -> Spread:
        """Return how the optimum of a system spreads.

        Args:
            system: What was minimised.
            linear: Conditions at the optimum.
            weights: Of the rows, shape (N,).
            scale: Of the noise, as the loss estimates it.
            variance: Of white residuals of rows that are not outliers.
        """
        if system.loss is None:
            none = np.zeros_like(weights)
            return cls(system, linear, weights, none, weights, none)
        counts = np.ones(len(weights), bool) if system.kept is None else system.kept
        squares, equations, unit = (
            linear.squares / scale**2,
            linear.equations,
            max(variance, 1e-300),
        )
        far = squares > chdtri(np.maximum(equations, 1), FALSE_ALARM)
        good, n = counts & ~far, system.unknowns.map.shape[1]
        slope, square, factor = system.loss.moments(squares[good], equations[good], n)
        return cls(
            system,
            linear,
            np.where(good, slope, weights),
            np.where(counts & far, weights - system.loss.slope(squares, equations), 0.0),
            np.where(good, factor * np.sqrt(square * scale**2 / unit), 0.0),
            np.where(counts & far, factor * weights / np.sqrt(unit), 0.0),
        )

    @cached_property
    def root(self) -> Array:
        """Root of B⁻¹, shape (n_free, n_free): that of (RᵀR − GᵀG)⁻¹, G what outliers' slopes fall.

        Of least squares R⁻¹.
        """
        normal = Normal.of(self.system.triangle(self.linear, self.slopes))
        half = np.asarray(np.linalg.inv(normal.R)) / normal.lengths[:, None]
        if not self.falls.any():
            return half
        along = self._along / np.sqrt(np.maximum(self.linear.squares, 1e-300))[:, None]
        C = np.sqrt(np.maximum(self.falls, 0.0))[:, None] * along @ self.system.unknowns.map @ half
        share, V = np.linalg.eigh(C.T @ C)
        return np.asarray(half @ (V / np.sqrt(1.0 - np.minimum(share, _FALLEN))))

    @property
    def bread(self) -> Array:
        """B⁻¹, shape (n_free, n_free)."""
        return np.asarray(self.root @ self.root.T)

    @property
    def meat_in_root(self) -> Array:
        """Root of B⁻¹, transposed, M, root of B⁻¹: 1 of least squares, shape (n_free, n_free)."""
        if (rows := self._meat) is None:
            return np.eye(len(self.root))
        half = rows @ self.root
        return np.asarray(half.T @ half)

    @property
    def covariance(self) -> Array:
        """Covariance of all unknowns in units of the noise, shape (n, n).

        Of unweighted residuals with the covariance V = S Sᵀ of each row, M = Σ Jᵀ V J.
        """
        T, bread = self.system.unknowns.map, self.bread
        if (rows := self._meat) is None:
            return np.asarray(T @ bread @ T.T)
        half = rows @ bread
        return np.asarray(T @ (half.T @ half) @ T.T)

    @property
    def _meat(self) -> Array | None:
        """Rows whose squares are M, shape (k, n_free); None of least squares, where M = B."""
        system, linear, T = self.system, self.linear, self.system.unknowns.map
        if system.problem.weighted:
            if system.loss is None:
                return None
            n = T.shape[1]
            rows = [system.triangle(linear, self.noises**2)[:n, :n]]
        else:
            J = system.derivatives(linear) @ T
            meat = linear.white.noise.transpose(0, 2, 1) / system.unit @ J
            fits = self.noises > 0.0
            rows = [(self.noises[:, None, None] * meat)[fits].reshape(-1, T.shape[1])]
        return np.concatenate((*rows, self._pulled[self.pulls > 0.0] @ T))

    @property
    def _along(self) -> Array:
        """rᵀ J of each row, shape (N, n)."""
        J, r = self.system.derivatives(self.linear), self.system.residuals(self.linear)
        return np.asarray(np.einsum("nm,nmk->nk", r, J))

    @property
    def _pulled(self) -> Array:
        """ψᵀ J of outliers, shape (N, n)."""
        return np.where(self.pulls[:, None] > 0.0, self.pulls[:, None] * self._along, 0.0)

    def response(self, errors: Array) -> Array:
        """Return how all unknowns follow errors of the conditions, −B⁻¹ Σ Jᵀ ψ' c, shape (n, q).

        Args:
            errors: c, by how much the conditions are off for each, shape (N, k, q).
        """
        linear, system, T = self.linear, self.system, self.system.unknowns.map
        white = linear.white(errors) if system.problem.weighted else errors / system.unit
        weighted = self.slopes[:, None, None] * white
        moved = np.einsum("nmk,nmq->kq", system.derivatives(linear), weighted, optimize=True)
        return np.asarray(-(T @ self.bread @ T.T) @ moved)

    @property
    def influence(self) -> Array:
        """How all unknowns follow the noise in standard deviations, shape (N, n, s + 1).

        K = −B⁻¹ Jᵀ W at each pose, W = L⁻¹NᵀS; the last column is what an outlier moves.
        """
        linear, system, T = self.linear, self.system, self.system.unknowns.map
        W = linear.white.by_noise if system.problem.weighted else linear.white.noise / system.unit
        fits = (self.noises > 0.0)[:, None, None]
        J = system.derivatives(linear)
        noise = self.noises[:, None, None] * (J.transpose(0, 2, 1) @ W)
        both = np.concatenate((np.where(fits, noise, 0.0), self._pulled[:, :, None]), axis=2)
        return np.asarray(-(T @ self.bread @ T.T) @ both)
