"""How well the noise is known: degrees of freedom of χ² and of every standard error."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, chdtri, fdtrc, ndtri, stdtrit

from pincal.calibration.fits import Fits
from pincal.design.platform_error import CONFIDENCE
from pincal.estimation.variances.components import Moments, freedoms
from pincal.estimation.variances.noise import assumed_noise

Array = NDArray[np.float64]


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
        fewest = min((float(one.min(initial=np.inf)) for one in self.of_unknowns), default=np.inf)
        return fewest if np.isfinite(fewest) else None


def confidence(found: Fits) -> Confidence:
    """Return how well the noise of fits is known.

    Noise of repeated rows: as many degrees of freedom as these have. Estimated noise: by the
    covariance of the variance components; of a fit with its own scale, its own.
    """
    calibration, fits = found.calibration, [one.fit for one in found.fits]
    model = calibration.noise
    sizes = [len(one.covariance) for one in fits]
    if not model.known and not (found.latent and found.variances is not None):
        own = [
            np.full(n, float(one.degrees_of_freedom)) for n, one in zip(sizes, fits, strict=True)
        ]
        return Confidence(tuple(own), np.inf)
    if model.source != "repeats" and model.known:
        return Confidence(tuple(np.full(n, np.inf) for n in sizes), np.inf)
    unit = model.noise.reading or assumed_noise(calibration.mechanism, exact=False).reading
    moments = Moments.of([(one, one.problem) for one in fits], unit)
    spread, of_chi2 = found.variances, np.inf
    if spread is None:
        freedom = np.array(model.freedoms)
        spread = np.diag(2.0 / freedom)
        some = np.isfinite(freedom)
        shares = np.where(some, moments.F[:, some].sum(axis=1), 0.0)
        of_chi2 = float(shares.sum() ** 2 / (shares**2 / freedom).sum())
    return Confidence(tuple(freedoms(one, spread) for one in moments.parts), of_chi2)


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
