"""Errors at rows that a fit has not seen.

Held-out rows are predicted like those of the fit, whitened by their noise; of them more is
expected by what the fit does not know: r has the covariance 1 + J C Jᵀ. What then exceeds the
fit's own χ² says that the model follows its rows more closely than the machine.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pincal.blas import on_one_thread
from pincal.calibration.calibration import Calibration
from pincal.calibration.covariance import chi2_freedoms, confidence, exceeded
from pincal.calibration.findings import lacking, rounding
from pincal.calibration.fits import Fits, Near, fitted
from pincal.calibration.missed import (
    Missed,
    Misses,
    Predicted,
    least_of_folds,
    missed,
    misses_of,
    predictions,
)
from pincal.calibration.options import FOLDS, By, folds_of
from pincal.calibration.promise import UNEXPLAINED
from pincal.errors import MeasurementError
from pincal.estimation.residuals.losses import UNLIKELY
from pincal.finding import Finding
from pincal.words.numbers import chance
from pincal.words.sentences import finding, sentences
from pincal.words.wording import missed_line

MISSES = 10.0
"""Standard deviations by which a fit misses its own rows that is none, which held-out rows do not
make worse."""


@dataclass(frozen=True, repr=False)
class Validation:
    """Errors at rows that a fit has seen, and at held-out rows."""

    folds: int
    rows: int
    """Rows that were held out, each once."""
    fit: float
    """Root mean square residual of the fit in standard deviations of the noise."""
    held_out: float
    """The same at held-out rows."""
    expected: float
    """Of held-out rows, by the fit's own residuals and what the fits did not know."""
    p_value: float
    """Probability of such a growth, or a larger one, if the model is right."""
    position: tuple[float, float] | None
    """Root mean square by which positions of targets are missed, [m], in the fit and held out."""
    orientation: tuple[float, float] | None
    """The same of the measured orientation, [rad]."""
    findings: tuple[Finding, ...]
    """What to know first: what residuals follow, held-out rows that miss by more than expected."""
    targets: tuple[Missed, ...] = ()
    """How far each measured target is missed at held-out rows: mean, root mean square, largest,
    and intervals by a bootstrap of poses."""

    def __repr__(self) -> str:
        return (
            f"Validation({self.folds} folds of {self.rows} rows, fit {self.fit:.2f} σ, held-out "
            f"{self.held_out:.2f} σ, expected {self.expected:.2f} σ)"
        )

    def __str__(self) -> str:
        lines = [
            f"{self.rows} rows, held out in {self.folds} folds",
            f"rows of the fit miss by {self.fit:.2f} σ, held-out rows by {self.held_out:.2f} σ, "
            f"{self.expected:.2f} σ are expected ({chance(self.p_value)})",
        ]
        lines += [missed_line(**vars(target)) for target in self.targets]
        return "\n".join([*lines, *(f"warning: {text}" for text in sentences(self.findings))])


@on_one_thread
def held_out(
    calibration: Calibration, folds: int = FOLDS, by: By = "region", whole: Fits | None = None
) -> Validation:
    """Return the errors of a calibration at held-out rows; errors are those of ``validate``.

    Args:
        calibration: What was calibrated.
        folds: How many times a share of the rows is held out.
        by: What is held out together.
        whole: Its fits of all rows, if they are known; else they are made.
    """
    whole = _converged(calibration, "the fit of all rows") if whole is None else whole
    calibration = whole.calibration
    if calibration.options.loss != "none":
        outlying = [outlier.row for fit in whole.fits for outlier in fit.outliers]
        fitting_rows = ~np.isin(np.arange(len(calibration.measurements)), outlying)
        calibration = calibration.rows(fitting_rows).with_options(loss="none")
        whole = _converged(calibration, "the fit of the rows that fit")
        calibration = whole.calibration
    groups = folds_of(calibration.measurements, folds, by)
    every = bool((groups >= 0).all())  # rows to verify with are in no fit
    total = sum(fit.chi2 for fit in whole.fits) if every else None
    count = int(groups.max()) + 1
    parts: list[Predicted] = []
    misses: list[tuple[Calibration, Misses]] = []
    chances = []
    for fold in range(count):
        calibration.options.report(f"held-out rows, fold {fold + 1} of {count}")
        seen_rows = groups != fold
        seen_rows_alone = calibration.rows(seen_rows).at_this_noise()
        near = Near.of(whole, seen_rows) if whole.latent else None
        fold_fits = _converged(seen_rows_alone, f"fold {fold + 1} of {count}", near)
        unseen = calibration.rows(groups == fold)
        own = [Predicted.of(one, linear) for one, linear in predictions(fold_fits, unseen)]
        chances.append(_chance(fold_fits, own, total))
        parts += own
        misses.append((unseen, misses_of(unseen, fold_fits)))
    equations = sum(part.equations for part in parts)
    dof = sum(fit.degrees_of_freedom for fit in whole.fits)
    fit = sum(fit.chi2 for fit in whole.fits) / max(dof, 1)
    unit = 1.0 if calibration.noise.known else max(fit, 1e-300)  # noise that was estimated
    growth = sum(part.unknown for part in parts) / equations
    held = np.sqrt(sum(part.squares for part in parts) / equations / unit)
    expected = np.sqrt(fit / unit * (1.0 + growth))
    p_value = least_of_folds(min(chances), whole.fits, groups, known=calibration.noise.known)
    readable = not rounding(whole)
    remarks = lacking(whole) if readable else []
    if readable and p_value < UNLIKELY and np.sqrt(fit / unit) <= MISSES:
        remarks.append(
            finding(
                "held-out-worse", held_out=float(held), expected=float(expected), p_value=p_value
            )
        )
    targets = missed(misses_of(calibration.rows(calibration.counts), whole), misses)
    return Validation(
        folds=count,
        rows=int((groups >= 0).sum()),
        fit=float(np.sqrt(fit / unit)),
        held_out=float(held),
        expected=float(expected),
        p_value=p_value,
        position=_both(targets, "m"),
        orientation=_both(targets, "rad"),
        findings=tuple(remarks),
        targets=targets,
    )


def _converged(calibration: Calibration, what: str, near: Near | None = None) -> Fits:
    """Return the fits of a calibration, the search begun near another optimum if one is given.

    Raises:
        MeasurementError: they do not converge.
    """
    fits = fitted(calibration, near=near)
    if not all(fit.converged for fit in fits.fits):
        raise MeasurementError(
            f"{what} does not converge; measure more poses, or give a better nominal mechanism"
        )
    return fits


def _chance(fits_of_all: Fits, parts: Sequence[Predicted], total: float | None) -> float:
    """Return the probability that rows miss a fit so far, or farther, if the model is right.

    χ² of all rows is larger than that of the rows seen by a χ² of its own, independent of theirs;
    an F test where the scale of the noise was estimated (G. C. Chow 1960). To first order that is
    Σ rᵀ (1 + J C Jᵀ)⁻¹ r, which curvature spoils where a region is left out.

    Args:
        fits_of_all: The fits of the rows seen.
        parts: What they predict of the others.
        total: χ² of all rows at this noise; by the first order if not given.
    """
    equations = sum(part.equations for part in parts)
    fits = fits_of_all.fits
    dof = sum(fit.degrees_of_freedom for fit in fits)
    share = 1.0 if fits_of_all.latent else chi2_freedoms(fits_of_all.fits) / max(dof, 1)
    chi2_seen = sum(fit.chi2 for fit in fits)
    inside = sum(part.statistic for part in parts) if total is None else max(total - chi2_seen, 0.0)
    ratio, own_ratio = inside / equations, chi2_seen / max(dof, 1)
    if fits_of_all.calibration.noise.known:
        known = confidence(fits_of_all).of_chi2
        if exceeded(own_ratio, share * dof, known) >= UNEXPLAINED:  # else the noise is not as given
            return exceeded(ratio, share * equations, known)
    if not own_ratio > 0.0:
        return 1.0
    return exceeded(ratio / own_ratio, share * equations, share * dof)


def _both(targets: Sequence[Missed], unit: str) -> tuple[float, float] | None:
    """Return root mean square misses of all targets, in the fit and held out; None without any."""
    own = [target for target in targets if target.unit == unit]
    if not own:
        return None
    fit, held = np.sqrt(np.mean([(one.fit**2, one.rms**2) for one in own], axis=0)).tolist()
    return fit, held
