"""Noise that was not given: variance components of positions, orientations and readings.

With white rows r = L⁻¹Nᵀe of covariance Σ_g s_g V_g, V_g = U_g U_gᵀ the part of group g, and M the
projection on what parameters do not take up, the expectation of rᵀ M V_g M r is Σ_h F_gh s_h,
F_gh = tr(M V_g M V_h). Solved for s, and repeated with the rows whitened by it, that is the
restricted maximum likelihood estimator (Patterson and Thompson 1971; Helmert, in geodesy); its
covariance is 2 F⁻¹.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pincal.estimation.fit import Fit
from pincal.estimation.linear import Orthonormal
from pincal.estimation.problem import Problem
from pincal.estimation.residuals.losses import outlying
from pincal.model.measurements import Noise

Array = NDArray[np.float64]
_P, _O, _R = range(3)  # position, orientation, reading
Pools = tuple[tuple[int, ...], ...]


@dataclass(frozen=True)
class Steps:
    """How variances are told apart, and how far they go at once."""

    clear: float = 3.0
    """Standard errors from which a component is none of chance."""
    most: float = 10.0
    """Times that a variance changes at once."""
    rounding: float = 1e-10
    """Standard deviation over the assumed one, below which residuals are rounding."""


_BY = Steps()


@dataclass(frozen=True)
class Normal:
    """What one fit says of the variances of groups; parameters projected out by Q R = J."""

    F: Array
    """Shape (3, 3): positions, orientations, readings."""
    q: Array
    """rᵀ M V_g M r, shape (3,)."""
    chi2: float
    """rᵀ M r."""
    P: Array
    """Qᵀ V_g Q, shape (3, n_free, n_free)."""
    back: Array
    """R⁻ᵀ Tᵀ: its columns squared are the variances of the unknowns, shape (n_free, n)."""


@dataclass(frozen=True)
class Moments:
    """What the residuals of fits say of the variances of groups, relative to the assumed ones."""

    F: Array
    """Shape (3, 3): positions, orientations, readings."""
    q: Array
    """Shape (3,)."""
    scale: float
    """χ² over degrees of freedom."""
    parts: tuple[Normal, ...]
    """Of each fit."""

    @classmethod
    def of(cls, fits: Sequence[tuple[Fit, Problem]], reading: float) -> Moments:
        """Return the moments of fits of groups of legs.

        To first order they need no new fit: what parameters take up is projected out.

        Args:
            fits: Of groups of legs, each with its problem at the noise in question.
            reading: Standard deviation to which that of readings is relative, [rad] or [m].
        """
        parts = tuple(_normal(one, problem, reading) for one, problem in fits)
        F, q = (np.sum([getattr(one, name) for one in parts], axis=0) for name in ("F", "q"))
        dof = max(sum(one.degrees_of_freedom for one, _ in fits), 1)
        return cls(F, q, sum(one.chi2 for one in parts) / dof, parts)

    @property
    def rounding(self) -> bool:
        """Whether the residuals are rounding errors."""
        return not self.scale > _BY.rounding**2

    def components(self, P: Array) -> tuple[Array, Array]:
        """Return variances s of V = Σ_g (P s)_g V_g and their standard errors, shape (k,) each."""
        part = P.T @ self.F @ P
        size = np.sqrt(np.diagonal(part))
        inverse = np.linalg.pinv(part / np.outer(size, size), rcond=1e-10, hermitian=True)
        inverse /= np.outer(size, size)
        std = self.scale * np.sqrt(2.0 * np.diagonal(inverse))
        return np.asarray(inverse @ (P.T @ self.q)), std

    def covariance(self, pools: Pools) -> Array:
        """Return that of the pools' variances, relative to these, shape (k, k)."""
        P = _columns(pools)
        return np.asarray(2.0 * np.linalg.pinv(P.T @ self.F @ P, rcond=1e-10, hermitian=True))

    def first_pools(self, *, exact: bool) -> Pools:
        """Return one pool of all groups that were measured; without readings if they are exact."""
        return (tuple(g for g in range(3) if self.F[g, g] > 0.0 and not (g == _R and exact)),)

    def split(self, pools: Pools) -> Pools | None:
        """Return pools with the group apart that differs most clearly from its pool.

        Readings may also appear, if they were exact and their variance is clearly above zero. None
        if no group differs so.
        """
        pooled = {group: pool for pool in pools for group in pool}
        best, most = None, _BY.clear
        for group in (_O, _R):
            if not self.F[group, group] > 0.0 or len(pooled.get(group, (0, 0))) < 2:
                continue
            P = _columns((*pools, (group,)))
            variance, std = self.components(P)
            z = variance[-1] / std[-1]
            if (abs(z) if group in pooled else z) > most:
                best, most = group, float(abs(z))
        if best is None:
            return None
        rest = (tuple(one for one in pool if one != best) for pool in pools)
        return (*(pool for pool in rest if pool), (best,))


def _columns(pools: Pools) -> Array:
    P = np.zeros((3, len(pools)))
    for column, pool in enumerate(pools):
        P[list(pool), column] = 1.0
    return P


def freedoms(one: Normal, pools: Pools, covariance: Array) -> Array:
    """Return the degrees of freedom of the unknowns' variances (Satterthwaite 1946), shape (n,).

    A variance is v = Σ_g s_g v_g, v_g the part of pool g: 2 v² / var(v), var(v) = vᵀ cov(s) v.

    Args:
        one: Of the fit.
        pools: Which groups share a variance.
        covariance: Of the pools' relative variances, shape (k, k).
    """
    by_group = np.einsum("in,gij,jn->gn", one.back, one.P, one.back)
    parts = _columns(pools).T @ by_group
    spread = np.einsum("gn,gh,hn->n", parts, covariance, parts)
    total = (one.back**2).sum(axis=0)
    return np.where(spread > 0.0, 2.0 * total**2 / np.where(spread > 0.0, spread, 1.0), np.inf)


def estimated_noise(moments: Moments, noise: Noise, reading: float, pools: Pools) -> Noise:
    """Return the noise that residuals show.

    Args:
        moments: Of fits at some noise.
        noise: That noise.
        reading: Standard deviation to which that of readings is relative, [rad] or [m].
        pools: Which groups share a variance; those in none are exact.
    """
    P = _columns(pools)
    variance, _ = moments.components(P)
    least, most = moments.scale / _BY.most, moments.scale * _BY.most
    factors = np.sqrt(P @ np.clip(variance, least, most))
    return Noise(
        float(noise.position * (factors[_P] or 1.0)),
        float(noise.orientation * (factors[_O] or 1.0)),
        float(reading * factors[_R]),
    )


def _normal(one: Fit, problem: Problem, readings: float) -> Normal:
    """Return what a fit says of the variances of groups, at a problem's noise."""
    linear = problem.with_this_noise(one.last)
    rows = one.weights > 0.0
    if one.system.loss is not None:
        rows &= ~outlying(linear.squares / one.system.scale(linear) ** 2, linear.equations)
    n_readings = problem.reading_columns[-1].stop
    unit = replace(problem, sigma_readings=np.full_like(problem.sigma_readings, readings))
    by_reading = unit.with_this_noise(one.last).stack.noise[:, :, :n_readings]
    by_reading = linear.white(by_reading)
    W = linear.white.by_noise[:, :, n_readings : len(problem.quantities)]
    units = problem.observation.units if problem.latent else problem.platform.units
    lengths = np.array([name == "m" for name in units], dtype=bool)
    U = [part[rows] for part in (W[:, :, lengths], W[:, :, ~lengths], by_reading)]
    r, J = linear.value[rows], linear.jacobian[rows] @ one.unknowns.map
    _, prior = one.unknowns.prior_rows(one.unknowns.start)
    by = Orthonormal.of(J, prior)
    Q = by(J)
    left = r - Q @ np.einsum("nmi,nm->i", Q, r)
    V = [part @ part.transpose(0, 2, 1) for part in U]
    VQ = [part @ Q for part in V]
    P = [np.einsum("nmi,nmj->ij", Q, part) for part in VQ]
    F = np.array(
        [
            [
                np.einsum("nij,nij->", V[g], V[h])
                - 2.0 * np.einsum("nmi,nmi->", VQ[g], VQ[h])
                + np.einsum("ij,ij->", P[g], P[h])
                for h in range(3)
            ]
            for g in range(3)
        ]
    )
    q = np.array([float((np.einsum("nmk,nm->nk", part, left) ** 2).sum()) for part in U])
    back = by(one.unknowns.map).T
    return Normal(F, q, float((left**2).sum()), np.array(P), back)
