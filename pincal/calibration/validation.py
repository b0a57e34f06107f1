"""Errors at rows that a fit has not seen.

Held-out rows are predicted like those of the fit, whitened by their noise; of them more is
expected by what the fit does not know: r has the covariance 1 + J C Jᵀ. What then exceeds the
fit's own χ² says that the model follows its rows more closely than the machine.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import bdtrc, betaincinv, chdtri

from pincal.blas import on_one_thread
from pincal.calibration.calibration import Calibration
from pincal.calibration.covariance import chi2_freedoms, confidence, exceeded
from pincal.calibration.findings import lacking, rounding
from pincal.calibration.fits import Fits, fitted
from pincal.calibration.missed import Missed, missed, misses_of
from pincal.calibration.options import FOLDS, By, folds_of
from pincal.calibration.promise import UNEXPLAINED
from pincal.design.platform_error import DRAWS
from pincal.errors import MeasurementError
from pincal.estimation.fit import Fit
from pincal.estimation.problem import Linear
from pincal.estimation.solver import solve_poses
from pincal.estimation.start import placed, poses_at_rest
from pincal.estimation.system import UNLIKELY, NormalEquations
from pincal.finding import Finding
from pincal.types import Array, Index, Mask
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
    calibration: Calibration, folds: int = FOLDS, by: By = "region", fits_of_all: Fits | None = None
) -> Validation:
    """Return the errors of a calibration at held-out rows; errors are those of ``validate``.

    Args:
        calibration: What was calibrated.
        folds: How many times a share of the rows is held out.
        by: What is held out together.
        fits_of_all: Its fits of all rows, if they are known; else they are made.
    """
    if fits_of_all is None:
        fits_of_all = _converged(calibration, "the fit of all rows")
    calibration = fits_of_all.calibration
    if calibration.options.loss != "none":
        outlying = [outlier.row for fit in fits_of_all.fits for outlier in fit.outliers]
        fitting_rows = ~np.isin(np.arange(len(calibration.measurements)), outlying)
        calibration = calibration.rows(fitting_rows).with_options(loss="none")
        fits_of_all = _converged(calibration, "the fit of the rows that fit")
        calibration = fits_of_all.calibration
    groups = folds_of(calibration.measurements, folds, by)
    count, of_folds, misses, chances = int(groups.max()) + 1, np.zeros(4), [], []
    dof = fits_of_all.degrees_of_freedom
    chi2 = sum(fit.chi2 for fit in fits_of_all.fits)
    total = chi2 if (groups >= 0).all() else None  # rows to verify with are in no fit
    for fold in range(count):
        calibration.options.report(f"held-out rows, fold {fold + 1} of {count}")
        seen_rows, unseen = groups != fold, calibration.rows(groups == fold)
        fold_calibration = calibration.rows(seen_rows).at_this_noise()
        fits = _converged(fold_calibration, f"fold {fold + 1} of {count}", fits_of_all, seen_rows)
        sums = _sums(predictions(fits, unseen))
        chances.append(_chance(fits, sums, total))
        misses.append((unseen, misses_of(unseen, fits)))
        of_folds += sums
    known = calibration.noise.known
    unit = 1.0 if known else max(chi2 / max(dof, 1), 1e-300)  # noise that was estimated
    _, squares, unknown, equations = of_folds
    fit = float(np.sqrt(chi2 / max(dof, 1) / unit))
    held = float(np.sqrt(squares / equations / unit))
    expected = float(fit * np.sqrt(1.0 + unknown / equations))
    p_value = least_of_folds(min(chances), fits_of_all.fits, groups, known=known)
    remarks = []
    if not rounding(fits_of_all):
        remarks = lacking(fits_of_all)
        if p_value < UNLIKELY and fit <= MISSES:
            worse = finding("held-out-worse", held_out=held, expected=expected, p_value=p_value)
            remarks.append(worse)
    targets = missed(misses_of(calibration.rows(calibration.counts), fits_of_all), misses)
    return Validation(
        folds=count,
        rows=int((groups >= 0).sum()),
        fit=fit,
        held_out=held,
        expected=expected,
        p_value=p_value,
        position=_root_mean_squares(targets, "m"),
        orientation=_root_mean_squares(targets, "rad"),
        findings=tuple(remarks),
        targets=targets,
    )


def _converged(
    calibration: Calibration, subject: str, near: Fits | None = None, rows: Mask | None = None
) -> Fits:
    """Return the fits of a calibration, the search begun near others of which these are some rows.

    Raises:
        MeasurementError: they do not converge.
    """
    fits = fitted(calibration, near, rows)
    if not fits.converged:
        raise MeasurementError(
            f"{subject} does not converge; measure more poses, or give a better nominal mechanism"
        )
    return fits


def predictions(fits_of_all: Fits, unseen: Calibration) -> list[tuple[Fit, Linear]]:
    """Return fits with their residuals and derivatives at rows that they have not seen."""
    if fits_of_all.latent:
        (fit,) = fits_of_all.fits
        problem, external = unseen.latent_problem, fit.last.state.external
        state = placed(problem, unseen.measurements, fit.parameters, external)
        linear = problem.evaluate(poses_at_rest(problem, state))
        return [(fit, solve_poses(problem, linear)[0])]
    names = list(unseen.mechanism.leg_names)
    pairs = []
    for fit in fits_of_all.fits:
        group = [names.index(leg.name) for leg in fit.problem.legs]
        problem, _ = unseen.measured_problem(group)
        pairs.append((fit, problem.evaluate(problem.start(fit.parameters))))
    return pairs


def _sums(predicted: Sequence[tuple[Fit, Linear]]) -> Array:
    """Return sums over rows that fits have not seen, noise of unit variance, shape (4,).

    Σ rᵀ (1 + J C Jᵀ)⁻¹ r; Σ rᵀ r; Σ tr(J C Jᵀ), by which the squares grow as the fits do not know
    all; and the number of equations.
    """
    sums = np.zeros(4)
    for fit, linear in predicted:
        J, r = linear.jacobian, linear.residuals
        spread = J @ (fit.covariance / fit.noise_scale**2) @ J.transpose(0, 2, 1)
        weighed = np.linalg.solve(np.eye(J.shape[1]) + spread, r[:, :, None])[:, :, 0]
        sums += (
            (r * weighed).sum(),
            (r**2).sum(),
            np.einsum("nkk->", spread),
            linear.equations.sum(),
        )
    return sums


def _chance(fits: Fits, sums: Array, total: float | None) -> float:
    """Return the probability that rows miss a fit so far, or farther, if the model is right.

    χ² of all rows is larger than that of the rows seen by a χ² of its own, independent of theirs;
    an F test where the scale of the noise was estimated (G. C. Chow 1960). To first order that is
    Σ rᵀ (1 + J C Jᵀ)⁻¹ r, which curvature spoils where a region is left out.

    Args:
        fits: The fits of the rows seen.
        sums: What they predict of the others (see ``_sums``), shape (4,).
        total: χ² of all rows at this noise; by the first order if not given.
    """
    statistic, _, _, equations = sums.tolist()
    dof = fits.degrees_of_freedom
    share = 1.0 if fits.latent else chi2_freedoms(fits.fits) / max(dof, 1)
    chi2_seen = sum(fit.chi2 for fit in fits.fits)
    inside = statistic if total is None else max(total - chi2_seen, 0.0)
    ratio, own_ratio = inside / equations, chi2_seen / max(dof, 1)
    if fits.calibration.noise.known:
        known = confidence(fits).of_chi2
        if exceeded(own_ratio, share * dof, known) >= UNEXPLAINED:  # else the noise is not as given
            return exceeded(ratio, share * equations, known)
    if not own_ratio > 0.0:
        return 1.0
    return exceeded(ratio / own_ratio, share * equations, share * dof)


def _root_mean_squares(targets: Sequence[Missed], unit: str) -> tuple[float, float] | None:
    """Return root mean square misses of all targets, in the fit and held out; None without any."""
    squares = [(target.fit**2, target.rms**2) for target in targets if target.unit == unit]
    if not squares:
        return None
    fit, held = np.sqrt(np.mean(squares, axis=0)).tolist()
    return fit, held


_RANK = 1e-10  # least share of a direction in a fold


def least_of_folds(least: float, fits: Sequence[Fit], groups: Index, *, known: bool) -> float:
    """Return the probability that the least of all folds' probabilities is so small, or smaller.

    By draws from what the model would make of noise; where none is as small, what independent folds
    would give (Šidák 1967) if that is less.

    Args:
        least: The least probability of a fold.
        fits: Of all rows.
        groups: The fold of each row of the measurements, shape (N,); below 0 in none.
        known: Whether the scale of the noise is known, else folds are compared with the others.
    """
    count = int(groups.max()) + 1
    bound = float(bdtrc(0, count, least))
    if count < 2 or (groups < 0).any():
        return bound
    random = np.random.default_rng(0)
    parts = [_drawn(fit, groups[fit.rows], count, random) for fit in fits]
    inside, squares, equations = (np.sum(part, axis=0) for part in zip(*parts, strict=True))
    dof = sum(fit.degrees_of_freedom for fit in fits)
    if known:
        unlikely = inside >= chdtri(equations, least)
    else:  # of a share x of all, or more: the chance that 1 − x follows a beta distribution
        outside = squares.sum(axis=1, keepdims=True) - inside
        share = betaincinv(0.5 * (dof - equations), 0.5 * equations, least)
        unlikely = (outside > 0.0) & (inside * share >= outside * (1.0 - share))
    below = int(unlikely.any(axis=1).sum())
    return (1 + below) / (1 + DRAWS) if below else min(bound, 1 / (1 + DRAWS))


def _drawn(
    fit: Fit, folds: Index, count: int, random: np.random.Generator
) -> tuple[Array, Array, Array]:
    """Return drawn statistics and squared residuals of folds, (draws, count), their equations."""
    used = fit.weights > 0.0
    J = np.where(used[:, None, None], fit.last.jacobian @ fit.unknowns.map, 0.0)
    _, prior = fit.unknowns.prior_rows(fit.parameters)
    normal = NormalEquations.of(fit.system.triangle(fit.last, used.astype(float), white=True))
    Q = normal.orthonormal(J).transpose(0, 2, 1)
    roots, equations = [], []  # draws need no more than single precision
    for fold in range(count):
        part = Q[folds == fold]
        share, V = np.linalg.eigh(np.einsum("nim,njm->ij", part, part))
        has = share > _RANK
        root = np.sqrt(share[has])[:, None] * V[:, has].T
        roots.append((root.astype(np.float32), (1.0 - share[has]).astype(np.float32)))
        equations.append(int(fit.last.equations[folds == fold][used[folds == fold]].sum()))
    drawn = [random.standard_normal((DRAWS, len(unfitted)), np.float32) for _, unfitted in roots]
    taken = sum(u @ root for u, (root, _) in zip(drawn, roots, strict=True))
    if len(prior):
        held = normal.orthonormal(prior).astype(np.float32)
        taken = taken + random.standard_normal((DRAWS, len(prior)), np.float32) @ held
    inside, squared = np.empty((DRAWS, count)), np.empty((DRAWS, count))
    for fold, (u, (root, unfitted)) in enumerate(zip(drawn, roots, strict=True)):
        squares = np.square(u - taken @ root.T)
        remainder = random.chisquare(max(equations[fold] - len(unfitted), 1e-9), DRAWS)
        inside[:, fold] = squares @ (1.0 / np.maximum(unfitted, _RANK)) + remainder
        squared[:, fold] = squares.sum(axis=1) + remainder
    return inside, squared, np.array(equations, dtype=float)
