"""What pages and tables ask of a calibration's result: the one place that knows how it is kept."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pincal.calibration.leg_result import IdentifiedParameter, LegResult, Observed
from pincal.calibration.result import CalibrationResult
from pincal.estimation.observability.indices import RANK_TOLERANCE
from pincal.model.measuring.measurements import Noise
from pincal.words.results import noise
from pincal.words.sentences import WORDINGS, sentence

Array = NDArray[np.float64]
#: Redundancy up to which a residual is what the fit made of it, and says nothing of the noise.
CONTROLLED = 1e-3


@dataclass(frozen=True)
class Series:
    """Residuals of a leg, or of a measured quantity of the platform."""

    name: str
    unit: str
    rows: NDArray[np.intp]
    before: Array
    """With nominal parameters, at the poses that suit these best where poses are unknowns."""
    after: Array
    sigma: Array
    """Of the noise."""
    of_leg: bool
    redundancy: Array | None = None
    """Variance after the fit over that of the noise, 1 − h; None of results saved before that was
    kept."""

    @property
    def spread(self) -> Array:
        """Standard deviation after the fit, σ√(1−h); that of the noise if h is not known."""
        return self.sigma if self.redundancy is None else self.sigma * np.sqrt(self.redundancy)

    @property
    def standardised(self) -> Array:
        """Residuals after the fit over their standard deviations; NaN where nothing checks one."""
        least = np.sqrt(CONTROLLED) * self.sigma
        checked = (self.spread > least) & (self.sigma > 0.0)
        return np.where(checked, self.after, np.nan) / np.where(checked, self.spread, 1.0)

    @property
    def rms(self) -> tuple[float, float, float]:
        """Root mean squares before, after, and of the standard deviations; NaN of no rows."""
        if not len(self.rows):
            return np.nan, np.nan, np.nan
        three = np.array([self.before, self.after, self.sigma])
        before, after, sigma = np.sqrt(np.mean(three**2, axis=1)).tolist()
        return before, after, sigma


def legs_series(result: CalibrationResult) -> list[Series]:
    """Return the residuals of the legs."""
    scale = np.sqrt(result.reduced_chi2) if result.noise_source == "estimated" else 1.0
    return [_series(leg, leg.sigma * scale) for leg in result.legs]


def observed_series(result: CalibrationResult) -> list[Series]:
    """Return the residuals of what was measured of the platform, where poses are unknowns."""
    return [_series(one, one.sigmas) for one in result.observed]


def _series(one: LegResult | Observed, sigma: Array) -> Series:
    own = one.rows, one.residuals_before, one.residuals, sigma
    return Series(one.name, one.unit, *own, isinstance(one, LegResult), one.redundancy)


def noisy_series(result: CalibrationResult) -> list[Series]:
    """Return residuals that carry noise: of legs, of the platform if legs cannot miss, or both.

    Both where readings have noise: they share with the platform what is missed.
    """
    if readings_exact(result):
        return observed_series(result)
    both = any(leg.quantity == "reading" for leg in result.legs)
    return legs_series(result) + (observed_series(result) if both else [])


def whose(series: Sequence[Series]) -> str:
    """Return what residuals are of: leg, measured quantity, or both."""
    names = {True: "leg", False: "measured quantity"}
    return " and ".join(dict.fromkeys(names[one.of_leg] for one in series))


def readings_exact(result: CalibrationResult) -> bool:
    """Return whether legs close by construction, so that only the platform can miss something."""
    return bool(result.observed) and not any((leg.sigma > 0.0).any() for leg in result.legs)


def noise_said(result: CalibrationResult, sizes: Noise) -> str:
    """Return standard deviations of what was measured, each in its unit."""
    observed = result.calibration.observation
    columns = zip(observed.units, observed.measured.T, strict=True)
    seen = {unit for unit, own in columns if own.any()}
    return noise(
        {
            "position": sizes.position if "m" in seen else None,
            "orientation": sizes.orientation if "rad" in seen else None,
            "reading": sizes.reading,
            "units": sorted(set(result.nominal.reading_units)),
        }
    )


def turns(result: CalibrationResult) -> bool:
    """Return whether the platform has an orientation."""
    return "rad" in result.nominal.platform.units


def parameters(result: CalibrationResult) -> Iterator[tuple[LegResult, IdentifiedParameter]]:
    """Yield every parameter of the legs with its leg."""
    for leg in result.legs:
        for p in leg.parameters:
            yield leg, p


class Directions(NamedTuple):
    """Directions of parameters, by how well they were identified."""

    ids: list[str]
    """Of what was identified, length n."""
    values: Array
    """Singular values of the Jacobian with columns of unit length, the largest first, shape (r,):
    about 1 where parameters are independent, near 0 where errors of several go together."""
    vectors: Array
    """Columns, in the units below, shape (n, r)."""
    units: Array
    """Standard errors of the parameters if all others were known, shape (n,)."""


def directions(result: CalibrationResult) -> Directions:
    """Return the directions of what was identified; those fixed by choice are left out."""
    ids = [p.id for _, p in parameters(result)]
    std = np.sqrt(np.diagonal(result.covariance))
    free = np.flatnonzero(np.isfinite(std) & (std > 0.0))
    scale = np.outer(std[free], std[free])
    values, axes = np.linalg.eigh(result.covariance[np.ix_(free, free)] / scale)
    kept = values > RANK_TOLERANCE * values.max(initial=0.0)
    information = (axes[:, kept] / values[kept]) @ axes[:, kept].T
    lengths = np.sqrt(np.diagonal(information))
    squares, vectors = np.linalg.eigh(information / np.outer(lengths, lengths))
    squares, vectors = squares[::-1][: kept.sum()], vectors[:, ::-1][:, : kept.sum()]
    singular = np.sqrt(np.maximum(squares, 0.0))
    return Directions([ids[i] for i in free], singular, vectors, std[free] / lengths)


def warnings(result: CalibrationResult) -> list[str]:
    """Return the warnings; one that several legs share is said once, with their names."""
    legs: dict[str, list[str]] = {}
    for text in result.warnings:
        name, colon, rest = text.partition(": ")
        own = bool(colon) and name in result.nominal.leg_names
        legs.setdefault(rest if own else text, []).extend([name] if own else [])
    return [f"{', '.join(names)}: {text}" if names else text for text, names in legs.items()]


def gauge(result: CalibrationResult) -> list[str]:
    """Return what was fixed by choice, lists cut where they are long (result.json has all)."""
    return [sentence(one) for one in result.gauge]


def unpromised(result: CalibrationResult) -> str:
    """Return why no limit is promised, in titles of findings; empty if one is."""
    titles = dict.fromkeys(WORDINGS[one.code].title for one in result.contradictions)
    return ", ".join(title[:1].lower() + title[1:] for title in titles)
