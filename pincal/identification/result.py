"""What a calibration found: parameters with uncertainties, and whether to trust them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2 as chi2_law

from pincal.estimation.weak import WeakPair, weakly_told
from pincal.identification.robust import Outlier
from pincal.identification.trust import RunConsistency, Validation
from pincal.model.measurements import Noise
from pincal.model.mechanism import Mechanism

if TYPE_CHECKING:
    from pincal.show.plots import Plots

Array = NDArray[np.float64]
UNEXPLAINED = 1e-4  # probability of a χ² at which the noise as given is doubted
_PROMISED = 3.0  # times the noise given, up to which residuals may be noise that is larger
_FELL = 0.5  # of the residuals: less must be left of them if anything was corrected


class Page(Protocol):
    """What can be written as a page."""

    def html(self) -> str:
        """Return the page."""


@dataclass(frozen=True)
class IdentifiedParameter:
    """One parameter: nominal and identified value, and how sure the latter is."""

    name: str
    unit: str
    nominal: float
    identified: float
    std: float
    """Standard error."""
    low: float
    """Lower end of the 95 % confidence interval."""
    high: float
    """Upper end of the 95 % confidence interval."""
    given: str = ""
    """What was said of it beforehand: ``"fixed"``, ``"tied"``, ``"prior"``, or several."""


@dataclass(frozen=True)
class LegResult:
    """Calibration of one leg."""

    name: str
    parameters: tuple[IdentifiedParameter, ...]
    rank: int
    condition: float
    """Of the leg's whitened identification Jacobian, columns scaled to unit length."""
    rms_before: float
    """Root mean square residual with nominal parameters: closure, joint, or, with latent poses,
    predicted less measured reading."""
    rms_after: float
    """Root mean square residual with identified parameters."""
    unit: str
    """Of the residuals: m of closures, that of the reading otherwise."""
    n_residuals: int
    sigma: Array
    """Modelled standard deviation of each residual used, shape (n_residuals,)."""
    rows: NDArray[np.intp]
    """Rows of the measurements used, shape (n_residuals,)."""
    residuals_before: Array
    """Residuals with nominal parameters, shape (n_residuals,)."""
    residuals: Array
    """Residuals with identified parameters, shape (n_residuals,)."""

    @property
    def n_poses(self) -> int:
        """Number of poses that served the leg."""
        return len(np.unique(self.rows))

    @property
    def identified(self) -> Array:
        """Identified values, shape (n_params,)."""
        return np.array([p.identified for p in self.parameters])

    @property
    def std(self) -> Array:
        """Standard errors, shape (n_params,)."""
        return np.array([p.std for p in self.parameters])


@dataclass(frozen=True)
class Observed:
    """How a measured quantity of the platform fits."""

    name: str
    unit: str
    count: int
    """How often it was measured."""
    rms: float
    """Root mean square of predicted less measured."""
    sigma: float
    """Root mean square standard deviation of the measurements."""
    rows: NDArray[np.intp]
    """Rows of the measurements, shape (count,)."""
    sigmas: Array
    """Standard deviations of the measurements, shape (count,)."""
    residuals_before: Array
    """Predicted less measured where the search started, shape (count,)."""
    residuals: Array
    """Predicted less measured, shape (count,)."""


@dataclass(frozen=True)
class TieTest:
    """Whether a parameter that was tied has one value for all legs."""

    name: str
    restrictions: int
    """By how many parameters there are fewer."""
    statistic: float
    """Square of the differences between legs in standard errors, over the restrictions."""
    p_value: float
    """Probability of such a growth, or a larger one, if the tie holds."""

    @property
    def holds(self) -> bool:
        """Whether the measurements do not contradict the tie, at 1 %."""
        return self.p_value >= 0.01


@dataclass(frozen=True)
class CalibrationResult:
    """Result of ``calibrate``: knows its nominal and its identified mechanism."""

    nominal: Mechanism
    identified: Mechanism
    legs: tuple[LegResult, ...]
    method: str
    residual: str
    poses: str
    noise: Noise | None
    """Standard deviations given or estimated for all rows; None if rows have their own."""
    noise_source: str
    """``"given"``, ``"rows"`` of the measurements, ``"repeats"`` of rows, or ``"estimated"`` from
    the residuals."""
    covariance: Array
    """Covariance of all parameters, legs in order, shape (n, n)."""
    degrees_of_freedom: int
    reduced_chi2: float
    """χ² over degrees of freedom, near 1 if the noise is as given; if it was estimated, of the
    assumed one (1e-4 m and rad), and no sign of a good fit."""
    iterations: int
    """Evaluations of the residuals."""
    converged: bool
    message: str
    warnings: tuple[str, ...] = ()
    loss: str = "none"
    """Robust loss."""
    outliers: tuple[Outlier, ...] = ()
    """Rows that do not fit the others, the worst first."""
    shift: float | None = None
    """With a robust loss: by how many standard errors a parameter would move, at most, without."""
    external: tuple[IdentifiedParameter, ...] = ()
    """Where the base stands in the frame of the measurements (translation, rotation vector), and
    where the targets sit on the platform."""
    gauge: tuple[str, ...] = ()
    """What was fixed by choice, since no such measurement can tell it, in words."""
    gauge_directions: Array | None = None
    """Directions of the legs' parameters along which that choice was made, shape (n, n_gauge)."""
    frames_moved: Array | None = None
    """Motions of frames that these are (see ``experiment.frames.frames_moved``)."""
    undetermined: tuple[str, ...] = ()
    """What these measurements do not tell and was held near nominal values, in words."""
    undetermined_directions: Array | None = None
    """Directions of the legs' parameters that were held so, as far as machines may differ, shape
    (n, n_lost)."""
    ties: tuple[TieTest, ...] = ()
    observed: tuple[Observed, ...] = ()
    """With latent poses: how the measured quantities of the platform fit."""
    estimated_poses: Array | None = None
    """With latent poses: the poses of all rows in the base frame, shape (N, dof)."""
    validation: Validation | None = None
    """Errors at rows that a fit has not seen, if that was asked for."""
    runs: RunConsistency | None = None
    """How well runs of the experiment agree, if that was asked for."""

    @cached_property
    def weak(self) -> tuple[WeakPair, ...]:
        """Parameters that are weakly told apart, the weakest first."""
        names = [(leg.name, p.name) for leg in self.legs for p in leg.parameters]
        return weakly_told(names, self.covariance, self.gauge_directions)

    @property
    def excess(self) -> float:
        """How many times larger residuals are than the noise given makes them.

        1 if that noise explains them, or was estimated from them.
        """
        dof, chi2 = self.degrees_of_freedom, self.reduced_chi2
        if self.noise_source == "estimated" or not dof:
            return 1.0
        return float(np.sqrt(chi2)) if chi2_law.sf(dof * chi2, dof) < UNEXPLAINED else 1.0

    @property
    def promises(self) -> bool:
        """Whether residuals are near enough to the noise that uncertainties mean anything."""
        return self.excess <= _PROMISED

    @property
    def corrects(self) -> bool:
        """Whether residuals fell by half at least, in standard deviations, or are noise."""
        parts = [(leg.residuals_before, leg.residuals, leg.sigma) for leg in self.legs]
        if not any((sigma > 0.0).any() for *_, sigma in parts):
            parts = [(one.residuals_before, one.residuals, one.sigmas) for one in self.observed]
        before, after, sigma = (np.concatenate(part) for part in zip(*parts, strict=True))
        told = sigma > 0.0
        squares = [((values[told] / sigma[told]) ** 2).sum() for values in (before, after)]
        return self.excess == 1.0 or bool(squares[1] <= _FELL**2 * squares[0])

    def leg(self, name: str) -> LegResult:
        """Return the result of one leg by name."""
        return self.legs[self.nominal.leg_names.index(self.nominal.leg(name).name)]

    @property
    def moves_frames(self) -> bool:
        """Whether a choice named in ``gauge`` moves the base or the platform frame."""
        return any("frame: " in text for text in self.gauge)

    @property
    def plot(self) -> Plots:
        """Plots of this result, such as ``plot.residuals()``: each returns matplotlib axes."""
        from pincal.show.plots import Plots

        return Plots(self)

    def _repr_html_(self) -> str:
        """Return parameters and residuals for notebooks."""
        from pincal.show.notebook import result_html

        return result_html(self)

    def __str__(self) -> str:
        """Return a table of all parameters, with what to make of it."""
        lines = [
            f"{self.nominal.name}: {self.method}, {self.residual} residual, {self.message}",
            f"  {'leg':8s} {'parameter':10s} {'nominal':>12s} {'identified':>14s} {'± 95 %':>10s}",
        ]
        for leg in self.legs:
            for p in leg.parameters:
                half = p.given if p.given == "fixed" else f"{(p.high - p.low) / 2:.2g}"
                lines.append(
                    f"  {leg.name:8s} {p.name:10s} {p.nominal:12.6f} {p.identified:14.7f} "
                    f"{half:>10s} {p.unit}"
                )
            lines.append(
                f"  {leg.name:8s} rms residual {leg.rms_before:.3g} to {leg.rms_after:.3g} "
                f"{leg.unit}, "
                f"{leg.n_residuals} residuals, rank {leg.rank}, condition {leg.condition:.3g}"
            )
        lines.append(
            f"  reduced χ² {self.reduced_chi2:.3g} on {self.degrees_of_freedom} degrees of freedom"
        )
        return "\n".join(lines + [f"  warning: {text}" for text in self.warnings])

    def save(self, folder: str | Path, *, force: bool = False, report: Page | None = None) -> Path:
        """Write ``result.json``, ``residuals.csv`` and the calibrated mechanism to a folder.

        Args:
            folder: Where to; whole or not at all.
            force: Whether to replace a result that is there.
            report: Page to write beside them as ``report.html``, by ``pincal.report``.

        Raises:
            FileError: the folder exists and ``force`` is not set, or cannot be written.
        """
        from pincal.identification.result_files import save_result

        return save_result(self, folder, force=force, report=report)
