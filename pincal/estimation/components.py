"""Variance components of the noise, by groups of measured quantities.

White rows r = L⁻¹Nᵀe have the covariance Σ_g s_g V_g, V_g = U_g U_gᵀ by the noise of group g. With
the projection M on the complement of the Jacobian's range, rᵀ M V_g M r has the expectation
Σ_h F_gh s_h, F_gh = tr(M V_g M V_h). Solving for s, and repeating with rows whitened by it, is the
restricted maximum likelihood estimator (Patterson and Thompson 1971; Helmert, in geodesy); its
covariance is 2 F⁻¹.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, Self

import numpy as np

from pincal.estimation.fit import Fit
from pincal.estimation.problem import Linear
from pincal.kinematics.batches import over_rows
from pincal.model import Noise
from pincal.types import Array, Mask

GROUPS = {"m": 0, "rad": 1, "px": 3}
"""Groups of measured quantities by their unit; pixels are the last group, if cameras see."""
READINGS = 2  # the group of the readings
_BEFOREHAND = 1.0  # prior spread of a variance about the assumed one, over the largest variance
_TIED = 1e-6  # the same where the assumed ratio is to hold
_SENSOR = 0.25  # platform motion by noise of tied readings, over the platform's own noise
_SENSORS_ONLY = 3.0  # the same ratio above which noise of readings is rather a misfit of the model
_LARGEST_STEP = 10.0  # largest factor by which a variance changes in a round
_SMALLEST = 1e-3  # floor of the readings' noise over the largest noise, each over its assumed one
_ROUNDING = 1e-10  # standard deviation over the assumed one, below which residuals are rounding

Tie = tuple[int, float]  # a group, and the ratio of the readings' noise to the group's noise


@dataclass(frozen=True)
class Moments:
    """Moments of the residuals of fits for the variances of g groups."""

    F: Array
    """F_gh for variances relative to those at which the fits were made, shape (g, g)."""
    q: Array
    """rᵀ M V_g M r, shape (g,)."""
    scale: float
    """χ² over degrees of freedom."""
    parts: tuple[tuple[Array, Array, Array], ...]
    """For each fit, with Q R = J: V_g Q, shape (g, n_good, m, n_free); Qᵀ V_g Q, (g, n_free,
    n_free); and R⁻ᵀ Tᵀ, whose squared columns are the unknowns' variances, (n_free, n)."""

    @classmethod
    def of(cls, fits: Sequence[Fit], reading: float) -> Self:
        """Return the moments of fits, one for each group of legs, at their noise.

        The variance of readings is relative to the square of ``reading``, [rad] or [m].
        """
        F, q, parts = zip(*(_moments(fit, reading) for fit in fits), strict=True)
        dof = max(sum(fit.degrees_of_freedom for fit in fits), 1)
        return cls(sum(F), sum(q), sum(fit.normal.left for fit in fits) / dof, parts)

    @property
    def rounding(self) -> bool:
        """Whether the residuals are rounding errors."""
        return not self.scale > _ROUNDING**2

    def information(self, assumed: Array) -> Array:
        """Return the information on variances, that of the assumptions included, shape (g, g)."""
        return self.F / (2.0 * max(self.scale, 1e-300) ** 2) + assumed

    def variances(self, assumed: Array) -> Array:
        """Return the likeliest relative variances of groups, none below zero, shape (g,).

        ``assumed`` is the prior information, which decides where residuals say little.
        """
        information = self.information(assumed)
        size = 1.0 / np.sqrt(np.diagonal(information))
        scaled = information * np.outer(size, size)
        right = size * self.q / (2.0 * max(self.scale, 1e-300) ** 2)
        free = np.linalg.solve(scaled, right)
        if (free >= 0.0).all():  # as nearly always
            return np.asarray(size * free)
        from scipy.optimize import nnls  # slow to load

        R = np.linalg.cholesky(scaled).T
        return np.asarray(size * nnls(R, np.linalg.solve(R.T, right))[0])

    def off_zero(self, *, exact: bool) -> Self:
        """Return moments by which no variance is zero, except that of readings that may be exact.

        The likelihood is multiplied by each standard deviation over their mean (expanded here):
        from few rows a variance may be estimated as zero although there is noise (Y. Chung et al.,
        Psychometrika 2013).
        """
        weights = np.maximum(np.diagonal(self.F), 0.0)
        weights[READINGS] *= not exact
        noisy, shares = weights > 0.0, weights / max(weights.sum(), 1e-300)
        pulled = self.scale * (2.0 * noisy - noisy.sum() * shares)
        return replace(self, F=self.F + np.diag(noisy), q=self.q + pulled)

    def freedoms(self, covariance: Array) -> tuple[Array, ...]:
        """Return for each fit the degrees of freedom of the unknowns' variances, shape (n,).

        A variance v = Σ_g s_g v_g, v_g by group g, has 2 v² / var(v), var(v) = Σ_gh cov(s)_gh v_g
        v_h (Satterthwaite 1946). ``covariance`` is that of the relative variances, shape (g, g).
        """
        freedoms = []
        for _, P, by_rows in self.parts:
            groups = np.einsum("in,gij,jn->gn", by_rows, P, by_rows)
            spread = np.einsum("gn,gh,hn->n", groups, covariance, groups)
            known = 2.0 * (by_rows**2).sum(axis=0) ** 2 / np.where(spread > 0.0, spread, 1.0)
            freedoms.append(np.where(spread > 0.0, known, np.inf))
        return tuple(freedoms)

    def widenings(self, covariance: Array) -> list[Array]:
        """Return for each fit what estimating the noise adds to its covariance, shape (n, n).

        Weights by estimated variances spread the estimate by Λ = Σ_gh cov(s)_gh Qᵀ V_g M V_h Q, and
        the covariance at the estimate is as much too small: 2 Λ (Kenward and Roger 1997).
        """
        widenings = []
        for VQ, P, by_rows in self.parts:
            mixed, taken = (np.tensordot(covariance, part, 1) for part in (VQ, P))
            spread = sum(over_rows(*pair) for pair in zip(VQ, mixed, strict=True))
            spread = spread - (P @ taken).sum(axis=0)
            widenings.append(by_rows.T @ (2.0 * spread) @ by_rows)
        return widenings


class Assumptions(NamedTuple):
    """What is assumed of the noise where residuals say little."""

    unit: Noise
    """Assumed standard deviations, the units of the groups."""
    exact: bool
    """Whether readings may be exact."""
    tie: Tie | None = None
    """The noise to which that of readings is tied: see ``tie_of``."""

    def information(self, noise: Noise, scale: float) -> Array:
        """Return the prior information on variances relative to a noise, shape (g, g).

        Positions and orientations are assumed to have equal variances, each over its unit; readings
        to be exact, or to have an equal variance, too, where they cannot be exact, or to be tied.
        ``scale`` is χ² over degrees of freedom.
        """
        sizes, ratio = self._sizes(noise)
        largest = ratio[: 3 if noise.reading > 0.0 else 2].max() * max(scale, 1e-300)
        rows = np.zeros((len(sizes) - 1, len(sizes)))
        rows[0, :2], rows[1, READINGS], rows[1, 0] = (1.0, -1.0), 1.0, 0.0 if self.exact else -1.0
        rows[2:, 0], rows[2:, READINGS + 1 :] = -1.0, 1.0
        rows *= ratio / (_BEFOREHAND * largest)
        if self.tie is not None:
            group, factor = self.tie
            share = (factor * sizes[group] / sizes[READINGS]) ** 2
            axes = np.eye(len(sizes))
            rows[1] = (axes[READINGS] - share * axes[group]) * ratio[READINGS] / (_TIED * largest)
        return np.asarray(rows.T @ rows)

    def estimate(self, moments: Moments, noise: Noise) -> Noise:
        """Return the noise that residuals show, by moments of fits at a noise."""
        sizes, ratio = self._sizes(noise)
        least = np.full(len(ratio), moments.scale / _LARGEST_STEP)
        least[READINGS] *= noise.reading > 0.0  # else its size is not known yet
        assumed = self.information(noise, moments.scale)
        variance = moments.off_zero(exact=self.exact).variances(assumed)
        variance = np.clip(variance, least, moments.scale * _LARGEST_STEP)
        floor = _SMALLEST**2 * (ratio * variance).max() / ratio[READINGS]
        if variance[READINGS] <= floor:
            variance[READINGS] = 0.0 if self.exact else floor
        return Noise(*np.append(sizes * np.sqrt(variance), 0.0)[:4].tolist())

    def with_exact_readings(self, fits: Sequence[Fit], noise: Noise) -> list[Fit]:
        """Return fits that count no degrees of freedom for readings whose noise is at its floor."""
        _, ratio = self._sizes(noise)
        if not noise.reading > 0.0 or ratio[READINGS] > (1.0 + _TIED) * _SMALLEST**2 * ratio.max():
            return [replace(fit, exact=0) for fit in fits]
        shown = (float(_moments(fit, noise.reading)[0][READINGS].sum()) for fit in fits)
        return [replace(fit, exact=round(dof)) for fit, dof in zip(fits, shown, strict=True)]

    def _sizes(self, noise: Noise) -> tuple[Array, Array]:
        """Return standard deviations of groups, and variances over their units squared, (g,).

        The groups are positions, orientations, readings and, where cameras see, pixels.
        """
        sizes = np.array([noise.position, noise.orientation, noise.reading, noise.pixel])
        units = np.array([*vars(self.unit).values()])
        sizes[READINGS] = sizes[READINGS] or units[READINGS]
        count = 4 if noise.pixel else 3
        return sizes[:count], (sizes[:count] / units[:count]) ** 2


def tie_of(fit: Fit, noise: Noise, plausible: float = 0.0) -> Tie | None:
    """Return the group to whose noise that of readings is tied, or None if it is free.

    Errors of the model look like noise of the readings, and poses near singularities would then
    decide the fit. So they are attributed to the measurements of the platform if the readings'
    noise is more than ``plausible``, [rad] or [m], and moves the platform three times as far as the
    platform's own noise; a quarter as far where residuals say that the model lacks something
    (``plausible`` 0). With cameras alone that is motion in the image. Noise is free if it is known
    or shown by repeated rows, if poses are taken as measured, or if nothing else was measured.
    """
    problem, linear, n_legs = fit.problem, fit.last, fit.problem.leg_block.n_rows
    if fit.system.known or not problem.latent:
        return None
    units, active = np.array(problem.observation.units), problem.active[:, n_legs:]
    shown = {unit: (units == unit) & active[fit.good].any(axis=0) for unit in GROUPS}
    unit = next((unit for unit, columns in shown.items() if columns.any()), None)
    if unit is None:
        return None
    moved = np.linalg.pinv(linear.by_pose[:, :n_legs]) @ linear.by_measured  # least squares of legs
    if unit == "px":
        rows_seen = active[:, shown[unit]]
        moved = linear.by_pose[:, n_legs:][:, shown[unit]] @ moved
        squares = np.median((moved**2).sum(axis=2)[rows_seen])
    else:
        moving = np.array(problem.platform.units) == unit
        squares = np.median((moved**2).sum(axis=2), axis=0)[moving]
    lever = float(np.sqrt(np.mean(squares))) if np.size(squares) else 0.0
    group = GROUPS[unit]
    ratio = _SENSORS_ONLY if plausible else (1.0 + _TIED) * _SENSOR
    far = lever * noise.reading > ratio * (*vars(noise).values(),)[group]
    return (group, _SENSOR / lever) if far and noise.reading > plausible else None


def _moments(fit: Fit, reading: float) -> tuple[Array, Array, tuple[Array, Array, Array]]:
    """Return F, q and an element of ``parts`` of ``Moments`` for one fit."""
    rows, Q = fit.good, fit.Q
    V = _group_covariances(fit.last, reading)[:, rows]
    residuals = fit.last.residuals[rows] - Q @ fit.normal.c
    VQ = V @ Q
    P = np.stack([over_rows(Q, part) for part in VQ])
    F = np.einsum("gnij,hnij->gh", V, V) + np.einsum("gij,hij->gh", P, P)
    F -= 2.0 * np.einsum("gnmi,hnmi->gh", VQ, VQ)
    q = (residuals * (V @ residuals[:, :, None])[..., 0]).sum(axis=(1, 2))
    return F, q, (VQ, P, fit.normal.orthonormal(fit.unknowns.map).T)


def _group_covariances(linear: Linear, reading: float) -> Array:
    """Return the covariances V_g of white rows by the noise of each group, (g, N, m, m)."""
    problem, n_legs = linear.problem, linear.problem.leg_block.n_rows
    n_readings = problem.leg_block.n_readings
    W = linear.white.by_noise[:, :, n_readings : len(problem.quantities)]
    if problem.latent:  # what was not measured is not noise of its group
        W = np.where(problem.active[:, None, n_legs:], W, 0.0)
    units = np.array([*problem.quantities.values()][n_readings:], dtype=str)
    of_groups = [W[:, :, units == unit] for unit in GROUPS]
    sigma = problem.leg_block.sigma[:, None]
    size = sigma if sigma.any() else reading  # exact readings at an assumed noise
    of_groups.insert(READINGS, linear.white(size * linear.by_reading))
    groups = of_groups if "px" in units else of_groups[:3]
    return np.stack([part @ part.transpose(0, 2, 1) for part in groups])


def predicted_squares(
    part: tuple[Array, Array, Array], held: Linear, rows: Mask, reading: float
) -> tuple[float, Array]:
    """Return rᵀ V⁻¹ r of rows held out of a fit, and tr V⁻¹ V_g, shape (g,).

    Their white residuals r have the covariance V = 1 + A Aᵀ, A = J Wᵀ by the orthonormal unknowns
    of the fit, and V_g = D_g + A P_g Aᵀ by the noise of group g: see ``Moments``. The inverse is by
    the singular values of A, so that large ones do not cancel.
    """
    _, P, W = part
    r, D = held.residuals[rows], _group_covariances(held, reading)[:, rows]
    U, sizes, Vt = np.linalg.svd((held.jacobian[rows] @ W.T).reshape(r.size, len(W)), False)
    along, unknown = r.ravel() @ U, sizes**2 / (1.0 + sizes**2)
    beside = r.ravel() - U @ along
    squares = float(beside @ beside + along**2 @ (1.0 / (1.0 + sizes**2)))
    U = U.reshape(*r.shape, len(sizes))
    traces = np.einsum("gnii->g", D) - np.einsum("gnij,njk,nik->gk", D, U, U) @ unknown
    return squares, traces + np.einsum("gij,ki,kj->gk", P, Vt, Vt) @ unknown
