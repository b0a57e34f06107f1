"""Covariance of all parameters from several fits: legs identified alone share the poses' noise.

Each fit's estimate follows the noise by its influence K; two legs that use the same pose have the
cross covariance Σ K_i K_iᵀ over the columns of its noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtrc, chdtri, fdtrc, ndtri, stdtrit

from pincal.calibration.fits import Fits
from pincal.design.platform_error import CONFIDENCE
from pincal.estimation.fit import Fit
from pincal.kinematics.batches import over_rows
from pincal.model.leg import Leg
from pincal.model.mechanism import Mechanism
from pincal.model.setup import Systematic
from pincal.types import Array, Index


def parameter_places(mechanism: Mechanism, legs: Sequence[Leg]) -> Index:
    """Return the places of some legs' parameters among those of all."""
    sizes = [len(leg.parameters) for leg in mechanism.legs]
    ends = dict(zip(mechanism.leg_names, np.cumsum(sizes).tolist(), strict=True))
    return np.concatenate(
        [np.arange(ends[leg.name] - len(leg.parameters), ends[leg.name]) for leg in legs]
    )


def chi2_freedoms(fits: Sequence[Fit]) -> float:
    """Return the degrees of freedom of a χ² with the mean and variance of the fits' sum.

    Residuals M W ν of two fits that share poses are correlated by the poses' noise, A = W Wᵀ: of
    their χ², 2 tr(M₁ A M₂ Aᵀ) is the covariance. Of fits that share nothing, that of them all.
    """
    parts, total = [], 0
    for fit in fits:
        used = np.flatnonzero(fit.good)
        last = fit.problem.leg_block.n_readings
        W = fit.last.white.by_noise[used, :, last : last + fit.problem.platform.dof]
        parts.append((fit.rows[used], fit.Q, W))
        total += fit.degrees_of_freedom
    shared = 0.0
    for index, (rows, Q, W) in enumerate(parts):
        for their_rows, P, V in parts[:index]:
            _, mine, theirs = np.intersect1d(rows, their_rows, return_indices=True)
            A = W[mine] @ V[theirs].transpose(0, 2, 1)
            AP = A @ P[theirs]
            QA = A.transpose(0, 2, 1) @ Q[mine]
            product = over_rows(Q[mine], AP)
            shared += (A**2).sum() - (AP**2).sum() - (QA**2).sum() + (product**2).sum()
    return total**2 / (total + 2.0 * shared) if total else 0.0


def systematic(fits: Fits) -> Array:
    """Return how all parameters, then frames, follow what is off in all rows, shape (n, q).

    Columns are for one standard uncertainty each (see ``Observation.systematic``); none where
    nothing is uncertain so.
    """
    calibration = fits.calibration
    observation, n = calibration.observation, len(calibration.mechanism.parameters)
    if calibration.options.setup.systematic == Systematic():
        return np.zeros((n + len(observation.external), 0))
    fit = fits.fits[0]  # of all legs at once
    measured = observation.systematic(fit.last.state.matrices, fit.last.state.external)
    errors = np.zeros((*fit.last.conditions.shape, measured.shape[2]))
    errors[:, errors.shape[1] - measured.shape[1] :] = measured
    return fit.response(errors)


def covariance_by_noise(fits: Fits) -> Array:
    """Return the covariance of all legs' parameters, then of the external unknowns' steps, (n, n).

    Legs identified alone at the same poses follow the noise of these, K, together: Σ K Kᵀ.
    """
    if fits.latent:
        return fits.fits[0].covariance
    mechanism, count = fits.calibration.mechanism, len(fits.calibration.measurements)
    n = len(mechanism.parameters)
    by_pose = np.zeros((count, n, mechanism.platform.dof + 1))
    alone = np.zeros((n, n), dtype=bool)
    covariance = np.zeros((n, n))
    for fit in fits.fits:
        places = parameter_places(mechanism, fit.problem.legs)
        last = fit.problem.leg_block.n_readings
        columns = [*range(last, last + mechanism.platform.dof), -1]  # the pose's noise, an outlier
        by_pose[np.ix_(fit.rows, places)] = fit.influence[:, :, columns]
        covariance[np.ix_(places, places)] = fit.covariance
        alone[np.ix_(places, places)] = True
    together = np.einsum("npd,nqd->pq", by_pose, by_pose, optimize=True)
    return np.where(alone, covariance, together)


def with_unsure_tolerances(fits_of_all: Fits) -> Fits:
    """Return fits with what uncertain tolerances add to their covariances.

    By how far the estimate follows the logarithm of each, to first order: ∂φ/∂ log τ² =
    C (φ − φ₀) / τ² of the parameters of that unit (R. E. Kass and D. Steffey 1989). What the
    measurements determine of k of them is worth k − tr C / τ² (D. J. C. MacKay 1992), and log τ²
    is known as if so many were seen.
    """
    mechanism, fits = fits_of_all.calibration.mechanism, []
    units = {parameter.id: parameter.unit for parameter in mechanism.parameters}
    for fit in fits_of_all.fits:
        unknowns, widening = fit.unknowns, fit.widening
        values = np.zeros_like(unknowns.nominal)
        values[: len(fit.parameters)] = fit.parameters - unknowns.nominal[: len(fit.parameters)]
        for tolerance in fits_of_all.calibration.tolerances:
            of_unit = np.array([units.get(id_) == tolerance.unit for id_ in unknowns.labels])
            # others have one of their own
            tolerated = of_unit & (unknowns.priors == tolerance.size)
            pull = np.where(tolerated, values / tolerance.size**2, 0.0)
            determined = (
                tolerated.sum() - np.diagonal(fit.covariance)[tolerated].sum() / tolerance.size**2
            )
            unsure = np.sqrt(2.0 / max(determined, 0.5))  # of the logarithm; at most a factor of e²
            follows = unsure / fit.noise_scale**2 * (fit.covariance @ pull)
            widening = widening + np.outer(follows, follows)
        fits.append(replace(fit, widening=widening))
    return replace(fits_of_all, fits=fits)


@dataclass(frozen=True)
class Confidence:
    """Degrees of freedom of the noise's variance; infinite where the noise is known."""

    of_unknowns: tuple[Array, ...]
    """Of the variance of each unknown, a vector for each fit."""
    of_chi2: float
    """Of the noise with which χ² is compared."""

    @property
    def least(self) -> float | None:
        """The fewest of all; None if the noise is known."""
        fewest = min(
            (float(freedoms.min(initial=np.inf)) for freedoms in self.of_unknowns), default=np.inf
        )
        return fewest if np.isfinite(fewest) else None


def confidence(fits: Fits) -> Confidence:
    """Return how well the noise of fits is known.

    Noise of repeated rows: as many degrees of freedom as these have. Estimated noise: by the
    covariance of the variance components; of a fit with its own scale, its own.
    """
    model = fits.calibration.noise
    if not model.known and not (fits.latent and fits.variances is not None):
        by_fit = [np.full(len(f.covariance), float(f.degrees_of_freedom)) for f in fits.fits]
        return Confidence(tuple(by_fit), np.inf)
    if model.source != "repeats" and model.known:
        return Confidence(tuple(np.full(len(f.covariance), np.inf) for f in fits.fits), np.inf)
    moments = fits.moments
    spread, of_chi2 = fits.variances, np.inf
    if spread is None:
        freedom = np.array(model.freedoms)
        spread = np.diag(2.0 / freedom)
        finite = np.isfinite(freedom)
        shares = np.where(finite, moments.F[:, finite].sum(axis=1), 0.0)
        of_chi2 = float(shares.sum() ** 2 / (shares**2 / freedom).sum())
    return Confidence(moments.freedoms(spread), of_chi2)


def quantiles(degrees_of_freedom: Array) -> Array:
    """Return how many standard errors half a 95 % interval is, of the same shape."""
    half = (1 + CONFIDENCE) / 2
    known = ~np.isfinite(degrees_of_freedom)
    return np.where(known, ndtri(half), stdtrit(np.where(known, 1.0, degrees_of_freedom), half))


def unseen(chi2: float, degrees_of_freedom: float) -> float:
    """Return how many times larger than the noise residuals may be by their χ², at 95 %; 1 or more.

    Errors of the model of that size cannot be distinguished from noise.

    Args:
        chi2: Over its degrees of freedom.
        degrees_of_freedom: Of it.
    """
    if not degrees_of_freedom:
        return 1.0
    return float(np.sqrt(max(1.0, chi2 * degrees_of_freedom / chdtri(degrees_of_freedom, 0.95))))


def exceeded(chi2: float, degrees_of_freedom: float, of_noise: float = np.inf) -> float:
    """Return the probability of a reduced χ², or a larger one.

    Args:
        chi2: Over its degrees of freedom.
        degrees_of_freedom: Of it.
        of_noise: Degrees of freedom of the noise with which it was compared.
    """
    if not degrees_of_freedom:
        return 1.0
    if np.isfinite(of_noise):
        return float(fdtrc(degrees_of_freedom, of_noise, chi2))
    return float(chdtrc(degrees_of_freedom, degrees_of_freedom * chi2))
