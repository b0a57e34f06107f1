"""Errors at rows held out of a fit: of all measured quantities, and of targets in m and rad.

Held-out rows are predicted like rows of the fit and whitened by their noise; with the parameters'
uncertainty their residuals r have the covariance 1 + J C Jᵀ. An excess over the fit's own χ² says
that the model follows its rows more closely than the machine. Errors of targets are those of the
calibrated machine at its readings against the measurements, noise included.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.special import bdtrc, chdtrc, chdtri, ndtr

from pincal.blas import one_thread
from pincal.calibration.assemble import chi2_freedoms, noise_freedoms
from pincal.calibration.calibration import Calibration
from pincal.calibration.findings import MANY_ROWS, rounding, values_of
from pincal.calibration.fits import Fits, fitted
from pincal.calibration.options import FOLDS, By, clusters, folds_of
from pincal.calibration.promise import UNEXPLAINED, Misses, by_target, exceeded, misses_of
from pincal.calibration.result import CalibrationResult
from pincal.calibration.result_parts import KINDS, Missed, Validation
from pincal.design.platform_error import CONFIDENCE
from pincal.errors import MeasurementError
from pincal.estimation.components import GROUPS, Moments, predicted_squares
from pincal.estimation.fit import Fit, Outlier, as_one, most_off
from pincal.estimation.problem import Linear
from pincal.estimation.solver import solve_poses
from pincal.estimation.start import placed, poses_at_rest
from pincal.estimation.system import UNLIKELY, suspected
from pincal.estimation.unknowns import State
from pincal.kinematics.forward import forward
from pincal.model import ROW, TO
from pincal.types import Array, Index, Mask
from pincal.words.findings import finding

MISSES = 10.0
"""Root mean square residual of a fit, in σ, above which it is no fit, and is not validated."""
Predicted = list[tuple[Fit, Index, Linear]]
"""Fits, rows held out of them, and residuals and derivatives at these rows."""
_DRAWN = 1000  # draws of errors in each fold


@one_thread()
def with_validation(
    result: CalibrationResult, folds: int = FOLDS, by: By = "region", fits: Fits | None = None
) -> CalibrationResult:
    """Return a validated result: see ``CalibrationResult.validated``; ``fits`` are of all rows."""
    fits = fits or converged(result.calibration, "the fit of all rows")
    validation, wrong = _held_out(fits, folds, by)
    codes = {remark.code for remark in result.findings}
    news = tuple(remark for remark in validation.findings if remark.code not in codes)
    outliers = sorted((*result.outliers, *wrong), key=lambda outlier: -outlier.sigma)
    findings = (*result.findings, *news)
    return replace(result, validation=validation, findings=findings, outliers=tuple(outliers))


def _held_out(fits: Fits, folds: int, by: By) -> tuple[Validation, list[Outlier]]:
    """Return the errors at rows held out of fits, and wrong verification rows.

    Errors are without wrong and rejected rows. Folds are used if no verification row remains.
    """
    robust = fits.calibration.options.rejects
    calibration = fits.calibration.with_options(loss="none")
    fitting, wrong = np.ones(len(calibration.measurements), dtype=bool), list[Outlier]()
    if robust:
        fitting[[outlier.row for fit in fits.fits for outlier in fit.outliers]] = False
    while True:
        if robust or wrong:
            fits = converged(calibration.rows(fitting), "the fit of the rows that fit")
        validation, strays = _validated(fits, folds, by)
        if not strays:
            break
        wrong += [replace(row, row=int(np.flatnonzero(fitting)[row.row])) for row in strays]
        fitting[[row.row for row in wrong]] = False
    if wrong and not robust and not validation.findings:
        rows, total = [row.row for row in wrong], int(calibration.measurements.verifying.sum())
        remark = finding("wrong-verification", rows, total=total, **values_of(wrong[0]))
        validation = replace(validation, findings=(remark,))
    sigma = np.full(len(fitting), np.nan)
    sigma[fitting] = validation.sigma
    return replace(validation, sigma=sigma), wrong


def _validated(fits_of_all: Fits, folds: int, by: By) -> tuple[Validation, list[Outlier]]:
    """Return errors at held-out rows, and the few verification rows that alone contradict."""
    calibration = fits_of_all.calibration
    groups = folds_of(calibration.measurements, folds, by)
    _check_touched(calibration, groups)
    count, chances, drawn, of_folds = int(groups.max()) + 1, [], [], []
    sigma = np.full(len(groups), np.nan)
    counted = calibration.rows(calibration.counts)
    at_fit = misses_of(counted, fits_of_all.parameters, fits_of_all.external)
    misses = {target: np.full(len(groups), np.nan) for target in at_fit}
    dof, chi2 = fits_of_all.degrees_of_freedom, fits_of_all.chi2
    # verification rows, and distances between rows of two folds, are in no fit
    open_ends = [(groups < 0).any(), calibration.observation.setup.between_rows]
    total = None if any(open_ends) else chi2
    unit = 1.0 if calibration.noise.known else max(chi2 / max(dof, 1), 1e-300)
    variances = _variances_drawn(fits_of_all)
    for fold in range(count):
        calibration.options.report(f"held-out rows, fold {fold + 1} of {count}")
        fitted_rows, held = groups != fold, held_rows(calibration, groups == fold)
        fold_calibration = calibration.rows(fitted_rows).at_this_noise()
        fits = converged(fold_calibration, f"fold {fold + 1} of {count}", fits_of_all, fitted_rows)
        predicted = predictions(fits, held)
        sums = _row_sums(predicted, len(held.measurements))
        if total is None:
            chances.append(_p_of_rows(fits, predicted, variances, np.ones(len(sums), bool)))
        else:
            inside = max(total - fits.chi2, 0.0)
            chances.append(_p_value(fits, inside, float(sums[:, 3].sum())))
        sigma[groups == fold] = as_one(sums[:, 0] / unit, sums[:, 3])
        for target, values in misses_of(held, fits.parameters, fits.external).items():
            misses.setdefault(target, np.full(len(groups), np.nan))[groups == fold] = values
        of_folds.append([*sums.sum(axis=0)[1:], fits.chi2 / max(fits.degrees_of_freedom, 1)])
        drawn.append(_drawn_errors(fits, held, predicted[0][2], unit, fold))
    fit, p_value = float(np.sqrt(chi2 / max(dof, 1) / unit)), least_of_folds(chances)
    of_all = [*np.sum(of_folds, axis=0)[:3], chi2 / max(dof, 1)]
    is_worse = p_value < UNLIKELY and fit <= MISSES and not rounding(fits_of_all)
    rows, may_be_wrong = np.flatnonzero(groups == 0), is_worse and open_ends[0]
    strays = _stray_rows(fits, predicted, sums, unit, rows, variances) if may_be_wrong else []
    worst = int(np.argmin(chances))
    of_worst = _held_out_and_expected(of_folds[worst], unit) | {"fold": worst + 1, "folds": count}
    worse = finding("held-out-worse", kind=KINDS[count > 1], p_value=p_value, **of_worst)
    places = np.array(clusters(calibration.measurements))
    validation = Validation(
        folds=count,
        rows=int((groups >= 0).sum()),
        fit=fit,
        **_held_out_and_expected(of_all, unit),
        p_value=p_value,
        findings=(worse,) if is_worse else (),
        sigma=sigma,
        targets=tuple(
            _missed(target, values, misses[target], places, _limit(drawn, target, variances))
            for target, values in at_fit.items()
            if np.isfinite(misses[target]).any()
        ),
    )
    return validation, strays


def _held_out_and_expected(sums: Sequence[float], unit: float) -> dict[str, Any]:
    """Return the root mean square residual of held-out rows, and what is expected, in σ.

    The sums are those of ``_row_sums`` from the second on, then the mean square of the fit.
    """
    squares, unknown, equations, of_fit = sums
    means = {"held_out": squares / equations, "expected": of_fit * (1.0 + unknown / equations)}
    return {name: float(np.sqrt(value / unit)) for name, value in means.items()}


def held_rows(calibration: Calibration, rows: Mask) -> Calibration:
    """Return the calibration on held-out rows, distances measured to rows of the fit only."""
    held, every = calibration.rows(rows), calibration.measurements.contacts
    if ROW not in every:
        return held
    part, index = held.measurements, np.flatnonzero(rows)
    contacts, theirs = dict(part.contacts), {every[ROW][row] for row in index}
    for column in (name for name in every if name.endswith(TO)):
        names = (every[column][row] for row in index)
        contacts[column] = tuple("" if name in theirs else name for name in names)
    contacts[ROW] = ("",) * len(index)
    return replace(held, measurements=replace(part, contacts=contacts))


def _check_touched(calibration: Calibration, groups: Index) -> None:
    """Raise if a point at an unknown place is touched by rows of one fold only; groups are (N,)."""
    for column, point, contact in calibration.options.setup.touched.values():
        folds = np.unique(groups[np.array(calibration.measurements.contacts[column]) == point])
        held = len(folds) == 1 and folds[0] >= 0  # rows in every fit have fold -1
        if held and column != ROW and contact.points[point] is None:
            raise MeasurementError(
                f"{column} {point!r} is touched by rows alone that are held out together, and the "
                "others do not say where it is"
            )


def converged(
    calibration: Calibration, subject: str, near: Fits | None = None, rows: Mask | None = None
) -> Fits:
    """Return converged fits, or raise; the search begins near fits of which these are some rows."""
    fits = fitted(calibration, near, rows)
    if not fits.converged:
        raise MeasurementError(
            f"{subject} does not converge; measure more poses, or give a better nominal mechanism"
        )
    return fits


def predictions(fits_of_all: Fits, held: Calibration) -> Predicted:
    """Return fits, rows held out of them, and residuals and derivatives at these rows."""
    if fits_of_all.latent:
        (fit,) = fits_of_all.fits
        problem, external, near = held.latent_problem, fit.last.state.external, None
        if problem.observation.setup.between_rows:  # poses are not measured, and may be anywhere
            readings, machine = held.measurements.readings, held.identified(fit.parameters)
            solution = forward(machine, readings, influences=held.influences)
            near = np.where(solution.converged[:, None], solution.poses, machine.platform.home)
        matrices = placed(problem.observation, held.measurements, external, near)
        state = State(fit.parameters, matrices, external=external)
        linear = solve_poses(poses_at_rest(problem.evaluate(state)))
        return [(fit, np.arange(len(held.measurements)), linear)]
    parts: Predicted = []
    for fit in fits_of_all.fits:
        problem, rows = held.measured_problem([leg.name for leg in fit.problem.legs])
        parts.append((fit, rows, problem.evaluate(problem.start(fit.parameters))))
    return parts


def _row_sums(predicted: Predicted, count: int) -> Array:
    """Return sums over all fits at each held-out row, shape (count, 4).

    They are rᵀ (1 + J C Jᵀ)⁻¹ r; rᵀ r; tr(J C Jᵀ), the growth of rᵀ r by the parameters'
    uncertainty; and the number of equations. Noise has unit variance.
    """
    sums = np.zeros((count, 4))
    for fit, rows, linear in predicted:
        J, r = linear.jacobian, linear.residuals
        spread = J @ (fit.covariance / fit.noise_scale**2) @ J.transpose(0, 2, 1)
        weighed = np.linalg.solve(np.eye(J.shape[1]) + spread, r[:, :, None])[:, :, 0]
        unknown = np.einsum("nkk->n", spread)
        squares = (r**2).sum(axis=1)
        sums[rows] += np.stack(((r * weighed).sum(axis=1), squares, unknown, linear.equations), 1)
    return sums


def _drawn_errors(fits: Fits, held: Calibration, linear: Linear, unit: float, seed: int) -> Misses:
    """Return draws of errors of targets at held-out rows, (N, draws); see ``misses_of``.

    Readings place the platform there. The readings' noise, scaled by ``unit``, and the errors of
    parameters and frames move it through the legs' rows, and the targets with it.
    """
    if not fits.latent:  # at a row for one leg all legs place the platform
        problem, external = held.every_leg(), fits.external
        matrices = placed(problem.observation, held.measurements, external)
        linear = problem.evaluate(State(fits.parameters, matrices, external=external))
    A, B, S, state = linear.by_parameter, linear.by_pose, linear.noise_root, linear.state
    n, observation = linear.problem.leg_block.n_rows, linear.problem.observation
    random, unknown = np.random.default_rng(seed), np.zeros((A.shape[2], _DRAWN))
    for fit, places in zip(fits.fits, fits.places, strict=True):
        centre = np.zeros(len(places))
        unknown[places] = random.multivariate_normal(centre, fit.covariance, _DRAWN, "ignore").T
    moved = np.sqrt(unit) * S @ random.standard_normal((len(S), S.shape[2], _DRAWN)) + A @ unknown
    sound = np.isfinite(B).all(axis=(1, 2)) & np.isfinite(moved).all(axis=(1, 2))
    B = np.where(sound[:, None, None], B, 0.0)
    missed = moved[:, n:] - B[:, n:] @ (np.linalg.pinv(B[:, :n]) @ moved[:, :n])
    missed[~(observation.measured & sound[:, None])] = np.nan
    errors = missed.transpose(0, 2, 1).reshape(-1, missed.shape[1])
    metres = observation.metres_per_pixel(state.matrices, state.external).repeat(_DRAWN, axis=0)
    sizes = by_target(observation, errors, metres)
    return {target: values.reshape(-1, _DRAWN) for target, values in sizes.items()}


def _limit(drawn: Sequence[Misses], target: tuple[str, str], variances: Array | None) -> float:
    """Return the 95 % limit of a target's root mean square error over all folds.

    ``variances``, (draws, g), are draws of the groups' variances; None if these are known.
    """
    folds = [fold[target] for fold in drawn if target in fold]
    squares = np.concatenate([np.zeros((0, _DRAWN)), *folds]) ** 2
    if variances is not None:
        squares *= variances[:, GROUPS[target[1]]]
    squares = squares[np.isfinite(squares).all(axis=1)]
    return float(np.sqrt(np.quantile(squares.mean(axis=0), CONFIDENCE))) if len(squares) else np.inf


def _stray_rows(
    fits: Fits, predicted: Predicted, sums: Array, unit: float, rows: Index, variances: Array | None
) -> list[Outlier]:
    """Return the few held-out rows that alone contradict, the worst first, if others do not."""
    wrong, strays = suspected(sums[:, 0] / unit, sums[:, 3].astype(np.intp)), []
    few = 0 < wrong.sum() <= max(1.0, MANY_ROWS * len(wrong))
    if not few or _p_of_rows(fits, predicted, variances, ~wrong) < UNLIKELY:
        return []
    sigmas = as_one(sums[:, 0] / unit, sums[:, 3])
    for place in np.flatnonzero(wrong).tolist():
        off, quantity = max(
            most_off(linear, row)
            for _, served, linear in predicted
            for row in np.flatnonzero(served == place).tolist()
        )
        sigma = float(sigmas[place])
        strays.append(Outlier(int(rows[place]), sigma, 0.0, quantity, off / unit**0.5))
    return sorted(strays, key=lambda stray: -stray.sigma)


def _p_value(fits: Fits, inside: float, equations: float) -> float:
    """Return the p-value of the residuals of held-out rows if the model is right.

    χ² of all rows exceeds that of the fitted rows by an independent χ²; it is an F test where the
    scale of the noise was estimated (G. C. Chow 1960).
    """
    dof, chi2 = fits.degrees_of_freedom, fits.chi2
    ratio, own_ratio = inside / max(equations, 1.0), chi2 / max(dof, 1)
    share = 1.0 if fits.latent else chi2_freedoms(fits.fits) / max(dof, 1)
    if fits.calibration.noise.known:
        _, known = noise_freedoms(fits)
        if exceeded(own_ratio, share * dof, known) >= UNEXPLAINED:  # else the given noise is wrong
            return exceeded(ratio, share * equations, known)
    if not own_ratio > 0.0:
        return 1.0
    return exceeded(ratio / own_ratio, share * equations, share * dof)


def _p_of_rows(fits: Fits, predicted: Predicted, variances: Array | None, rows: Mask) -> float:
    """Return the p-value of some held-out rows to first order, in contrast to ``_p_value``.

    Where variances of groups were estimated without these rows, it is averaged over their draws;
    the sum of squares is like a χ² of the same mean and variance (Satterthwaite 1946).
    """
    inside, equations, traces = 0.0, 0.0, np.zeros(1)
    parts = Moments.of(fits.fits, fits.noise.reading).parts
    for (_, served, held), part in zip(predicted, parts, strict=True):
        chosen = rows[served]
        more = predicted_squares(part, held, chosen, fits.noise.reading)
        inside, traces = inside + more[0], traces + more[1]
        equations += float(held.equations[chosen].sum())
    if variances is None or not equations:
        return _p_value(fits, inside, equations)
    means = equations + (variances - 1.0) @ traces
    freedoms = means**2 / (equations + (variances**2 - 1.0) @ traces)
    return float(chdtrc(freedoms, freedoms * inside / means).mean())


def _variances_drawn(fits: Fits) -> Array | None:
    """Return draws of the groups' variances over the estimated ones, (draws, g); None if known.

    They are scaled inverse χ² of 1 + 2 / v degrees of freedom, where v is the relative variance of
    an estimate and 1 is for the assumptions, with the correlation of the estimates.
    """
    if fits.variances is None:
        return None
    spread, draws = np.diagonal(fits.variances), np.random.default_rng(0)
    values, axes = np.linalg.eigh(fits.variances / np.sqrt(np.outer(spread, spread)))
    normal = draws.standard_normal((_DRAWN, len(spread)))
    chances = ndtr(normal @ (axes * np.sqrt(values.clip(0.0))).T)
    freedoms = 1.0 + 2.0 / spread
    return np.asarray(freedoms / chdtri(freedoms, chances))


def least_of_folds(chances: Sequence[float]) -> float:
    """Return the p-value of the least p-value of all folds (Šidák 1967)."""
    return float(bdtrc(0, len(chances), min(chances)))


def _missed(
    target: tuple[str, str], fitted: Array, held: Array, places: Array, limit: float
) -> Missed:
    """Return the errors of a target by its errors (N,) at rows of the fit and at held-out rows."""
    known = np.isfinite(held)
    values = held[known]
    return Missed(
        *target,
        poses=len(np.unique(places[known])),
        fit=float(np.sqrt(np.nanmean(fitted**2))),
        mean=float(values.mean()),
        rms=float(np.sqrt((values**2).mean())),
        largest=float(values.max()),
        limit=limit,
    )
