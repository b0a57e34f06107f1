"""From fits to a result: covariances, intervals, residuals leg by leg.

Legs that are identified alone share the noise of the poses. Each estimate depends on it by its
influence K, and two legs have the cross covariance Σ K_i K_jᵀ over the noise of common poses.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.special import ndtri, stdtrit

from pincal.calibration.calibration import Calibration
from pincal.calibration.fits import Fits
from pincal.calibration.promise import by_target, exceeded, excess_of
from pincal.calibration.result import CalibrationResult
from pincal.calibration.result_parts import CONTROLLED, HELD, IdentifiedParameter, ResidualGroup
from pincal.design.platform_error import CONFIDENCE
from pincal.estimation.fit import Fit, Outlier
from pincal.estimation.observability.gauge import Gauge
from pincal.estimation.observability.identifiable import identifiability
from pincal.estimation.observability.residuals import leg_residuals, redundancy
from pincal.estimation.unknowns import State
from pincal.instruments.camera import Camera
from pincal.kinematics.batches import over_rows
from pincal.model import ROW, Noise, Parameter, means
from pincal.model.setup import Systematic
from pincal.types import Array, Mask

_UNMOVED = 0.1  # motion over the standard error by held directions, up to which it is negligible


def assemble(fits: Fits) -> CalibrationResult:
    """Return the result of all legs from one fit of all legs, or from one fit each."""
    calibration, gauge, dof = fits.calibration, fits.gauge, fits.degrees_of_freedom
    mechanism = calibration.mechanism
    freedoms, of_chi2 = noise_freedoms(fits)
    chi2 = fits.chi2 / dof if dof > 0 else np.nan
    chi2_dof = chi2_freedoms(fits.fits)
    p_value = exceeded(chi2, chi2_dof, of_chi2) if calibration.noise.known else 1.0
    by_noise = excess_of(chi2, p_value) ** 2 * covariance_by_noise(fits)
    by_systematic = systematic(fits)
    held = fits.held.directions if fits.held else np.zeros((len(by_noise), 0))
    n = len(mechanism.parameters)
    systematic_part = by_systematic[:n] @ by_systematic[:n].T
    std = _standard_errors(by_noise[:n, :n], by_systematic[:n], held[:n])
    if len(outside := calibration.observation.external):
        D, least = outside.coordinates_by_step(fits.external), freedoms.min(initial=np.inf)
        parts = D @ by_noise[n:, n:] @ D.T, D @ by_systematic[n:], D @ held[n:]
        std = np.append(std, _standard_errors(*parts))
        freedoms = np.append(freedoms[:n], np.full(len(D), least))
    identified = _identified_parameters(fits, std, quantiles(freedoms) * std)
    legs, observed = _residual_groups(fits, identified[:n])
    least = float(freedoms.min(initial=np.inf))
    poses = mechanism.platform.from_matrices(fits.fits[0].last.state.matrices)
    return CalibrationResult(
        calibration=calibration,
        legs=legs,
        observed=observed,
        external=identified[n:],
        covariance=by_noise[:n, :n] + systematic_part,
        systematic=systematic_part if by_systematic.size else None,
        noise=_final_noise(calibration, chi2),
        noise_source=calibration.noise.source,
        degrees_of_freedom=dof,
        reduced_chi2=float(chi2),
        chi2_p_value=p_value,
        chi2_freedoms=chi2_dof,
        noise_freedoms=least if np.isfinite(least) else None,
        left=max(fit.distance for fit in fits.fits),
        converged=fits.converged,
        outliers=_merged_outliers(fits.fits),
        misses=_errors_without_row(fits),
        gauge=gauge.found if gauge else (),
        gauge_directions=gauge.of_legs if gauge else None,
        frames_moved=_frames_moved(calibration, gauge),
        undetermined_directions=held[:n] if held.shape[1] else None,
        outside=fits.external if len(outside) else None,
        estimated_poses=poses if fits.latent else None,
    )


def _frames_moved(calibration: Calibration, gauge: Gauge | None) -> Array | None:
    """Return motions of frames that no measurement fixes, shape (k, n_moved); None without any.

    Where only cameras measure, and neither cameras nor markers are at known places, these are
    motions of both frames, and of the scale if no length is known, whatever priors say.
    """
    observation = calibration.observation
    cameras = [d for d in observation.setup.instruments if isinstance(d, Camera)]
    pixels = np.array([unit == "px" for unit in observation.units])
    alone = cameras and not observation.measured[:, ~pixels].any()
    if gauge is None or not (alone and all(camera.unplaced for camera in cameras)):
        return gauge and gauge.frames
    every = np.eye(len(gauge.frames))  # the scale is the last
    return every[:, :-1] if any(c.markers.lengths_known for c in cameras) else every


def chi2_freedoms(fits: Sequence[Fit]) -> float:
    """Return the degrees of freedom of a χ² with the mean and variance of the fits' sum.

    Residuals M W ν of two fits that share poses are correlated by the poses' noise, A = W Wᵀ; the
    covariance of their χ² is 2 tr(M₁ A M₂ Aᵀ). Without shared poses the sum has all of them.
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


def _errors_without_row(fits: Fits) -> tuple[float, float]:
    """Return root mean square errors at rows by fits without them, [m] and [rad]; NaN if unknown.

    To first order such a fit leaves r₋ = (1 − H)⁻¹ r of a row, H = Q Qᵀ there (D. M. Allen 1974);
    the platform goes where legs close. Verification rows are in no fit; rejected rows do not count.
    The instrument's noise is subtracted where it is known.
    """
    calibration, mechanism = fits.calibration, fits.calibration.mechanism
    observation, data = calibration.observation, calibration.measurements
    problem = calibration.every_leg()
    block, linear, n = problem.leg_block, fits.fits[0].last, problem.leg_block.n_rows
    if not fits.latent:
        state = State(fits.parameters, mechanism.platform.matrices(data.poses))
        linear = problem.evaluate(state)
    e, B = linear.conditions.copy(), linear.by_pose
    counts: Mask = np.asarray(np.isfinite(data.readings).all(axis=1))
    for fit in fits.fits:
        names = [leg.name for leg in fit.problem.legs]
        columns = np.r_[*(block.leg_rows[mechanism.leg_names.index(name)] for name in names)]
        if fits.latent:
            columns = np.arange(e.shape[1])
        shares, axes = np.linalg.eigh(fit.Q @ fit.Q.transpose(0, 2, 1))
        along = fit.last.residuals[fit.good][:, None] @ axes
        along *= (shares / np.maximum(1.0 - shares, CONTROLLED))[:, None]  # of r₋ − r
        back = fit.last.white.back[fit.good] @ (axes @ along.transpose(0, 2, 1))
        e[np.ix_(fit.rows[fit.good], columns)] += back[:, :, 0]
        counts[[outlier.row for outlier in fit.outliers if outlier.weight == 0.0]] = False
    counts &= np.isfinite(e).all(axis=1) & np.isfinite(B).all(axis=(1, 2))
    e, B, measured = e[counts], B[counts], observation.measured[counts]
    missed = e[:, n:] - (B[:, n:] @ np.linalg.pinv(B[:, :n]) @ e[:, :n, None])[:, :, 0]
    noise = np.zeros_like(missed)
    if calibration.noise.known:
        noise = observation.row_noise(data, calibration.noise.noise).sigma[counts]
    noises = by_target(observation, np.where(measured, noise, np.nan))
    squares: dict[str, list[Array]] = {"m": [], "rad": []}
    for target, sizes in by_target(observation, np.where(measured, missed, np.nan)).items():
        if target[1] in squares:
            squares[target[1]].append(sizes**2 - noises[target] ** 2)
    position, orientation = (
        float(np.sqrt(np.maximum(np.nanmean(parts), 0.0))) if parts else np.nan
        for parts in squares.values()
    )
    return position, orientation


def systematic(fits: Fits) -> Array:
    """Return changes of all unknowns, (n, q), by one standard uncertainty of each common error."""
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
    """Return the covariance (n, n) of all legs' parameters and of steps of external unknowns."""
    if fits.latent:
        return fits.fits[0].covariance
    mechanism, count = fits.calibration.mechanism, len(fits.calibration.measurements)
    by_pose = np.zeros((count, len(mechanism.parameters), mechanism.platform.dof))
    for fit, places in zip(fits.fits, fits.places, strict=True):
        last = fit.problem.leg_block.n_readings
        by_pose[np.ix_(fit.rows, places)] = fit.influence[:, :, last : last + by_pose.shape[2]]
    covariance = np.einsum("npd,nqd->pq", by_pose, by_pose, optimize=True)
    for fit, places in zip(fits.fits, fits.places, strict=True):
        covariance[np.ix_(places, places)] = fit.covariance
    return covariance


def noise_freedoms(fits: Fits) -> tuple[Array, float]:
    """Return degrees of freedom of the noise: in the variance of each unknown, (n,), and in χ².

    They are infinite for known noise, those of the repeats for noise of repeated rows, and by the
    covariance of the variance components for estimated noise; a fit with its own scale has its own.
    """
    model, of_chi2 = fits.calibration.noise, np.inf
    if not model.known and not (fits.latent and fits.variances is not None):
        of_fits = [np.full(len(fit.covariance), fit.degrees_of_freedom) for fit in fits.fits]
    elif model.known and model.source != "repeats":
        of_fits = [np.full(len(fit.covariance), np.inf) for fit in fits.fits]
    else:
        moments, spread = fits.moments, fits.variances
        if spread is None:
            freedom = np.array(model.freedoms)
            spread = np.diag(2.0 / freedom)
            finite = np.isfinite(freedom)
            shares = np.where(finite, moments.F[:, finite].sum(axis=1), 0.0)
            of_chi2 = float(shares.sum() ** 2 / (shares**2 / freedom).sum())
        of_fits = list(moments.freedoms(spread))
    of_unknowns = np.empty(sum(map(len, of_fits)))
    of_unknowns[np.concatenate(fits.places)] = np.concatenate(of_fits)
    return of_unknowns, of_chi2


def quantiles(degrees_of_freedom: Array) -> Array:
    """Return half the width of a 95 % interval in standard errors, of the same shape."""
    half = (1 + CONFIDENCE) / 2
    known = ~np.isfinite(degrees_of_freedom)
    return np.where(known, ndtri(half), stdtrit(np.where(known, 1.0, degrees_of_freedom), half))


def _standard_errors(covariance: Array, by_systematic: Array, held: Array) -> Array:
    """Return standard errors of n values, infinite where held directions (n, k) may move them."""
    std = np.hypot(np.sqrt(np.diagonal(covariance)), np.linalg.norm(by_systematic, axis=1))
    moved = np.linalg.norm(held, axis=1)
    return np.asarray(np.where(moved > _UNMOVED * std, np.inf, std))


def _final_noise(calibration: Calibration, chi2: float) -> Noise | None:
    """Return the noise of all rows; estimated noise is scaled to a reduced χ² of 1."""
    model = calibration.noise
    if model.source == "rows" or model.known or not np.isfinite(chi2):
        return None if model.source == "rows" else model.noise
    return Noise(*(float(np.sqrt(chi2)) * value for value in vars(model.noise).values()))


def _identified_parameters(fits: Fits, std: Array, half: Array) -> tuple[IdentifiedParameter, ...]:
    """Return parameters of the legs, then of frames and targets, with half intervals, (n,)."""
    calibration, options = fits.calibration, fits.calibration.options
    outside, began = calibration.observation.external, fits.fits[0].first.state.external
    # of an instrument its nominal parameters, unless it finds the start of the search itself
    if not all(hasattr(device, "begin") for device in outside.setup.instruments):
        began = replace(began, instruments=outside.start.instruments)
    parameters, values = list(calibration.mechanism.parameters), fits.parameters.tolist()
    priors = options.priors_by_name(calibration.mechanism)
    names_by_kind = {"fixed": options.fixed, "tied": options.tied, "prior": priors}
    if len(outside):
        start, estimates = map(outside.coordinates, (began, fits.external))
        for id_, unit, nominal in zip(outside.names, outside.units, start.tolist(), strict=True):
            owner, _, name = id_.partition(".")
            parameters.append(Parameter(owner, name, unit, nominal))
        values += estimates.tolist()
    identified = []
    for p, value, error, off in zip(parameters, values, std.tolist(), half.tolist(), strict=True):
        names = names_by_kind if p.owner in calibration.mechanism.leg_names else {}
        given = [kind for kind in names if any(means(n, p.owner, p.name) for n in names[kind])]
        given += [] if np.isfinite(error) else [HELD]
        fields: dict[str, Any] = {**vars(p), "identified": value, "std": error}
        fields |= {"low": value - off, "high": value + off}
        beforehand = "fixed" if "fixed" in given else ", ".join(given)
        identified.append(IdentifiedParameter(**fields, given=beforehand))
    return tuple(identified)


def _residual_groups(
    fits: Fits, parameters: Sequence[IdentifiedParameter]
) -> tuple[tuple[ResidualGroup, ...], tuple[ResidualGroup, ...]]:
    """Return the residuals of the legs and, if poses were unknowns, of the platform."""
    legs, observed = {}, list[ResidualGroup]()
    for fit in fits.fits:
        residuals, shares = redundancy(fit)
        for index, (leg, after) in enumerate(zip(fit.problem.legs, residuals, strict=True)):
            before = leg_residuals(fit.problem, fit.first, index).value
            counted = fit.problem.leg_block.used[:, index] & fit.good
            of_leg = fit.problem.leg_block.columns[index]
            names = fit.problem.legs[index].parameter_names
            determined = identifiability(fit.last.triangle[:, of_leg], names)
            legs[leg.name] = ResidualGroup(
                name=leg.name,
                quantity=after.quantity,
                unit=after.unit,
                parameters=tuple(p for p in parameters if p.owner == leg.name),
                rank=determined.rank,
                condition=determined.condition,
                **_group_fields(fit, counted, before, after.value, after.sigma, shares[index]),
            )
        if fits.latent:
            observed = _platform_residuals(fit, shares[-1])
    return tuple(legs[name] for name in fits.calibration.mechanism.leg_names), tuple(observed)


def _platform_residuals(fit: Fit, shares: Array) -> list[ResidualGroup]:
    """Return the residuals of the platform's measured quantities; redundancies are (N, r)."""
    observation, n_legs = fit.problem.observation, fit.problem.leg_block.n_rows
    before, after = (linear.conditions[:, n_legs:] for linear in (fit.first, fit.last))
    groups, columns_of = list[ResidualGroup](), enumerate(observation.names)
    measured = {name: (i, observation.measured[:, i]) for i, name in columns_of}
    between = observation.setup.between_rows
    for point, columns, rows in observation.touches():  # point by point, in place of all together
        for column in columns.tolist():
            measured.pop(observation.names[column], None)
            axis = observation.names[column].rpartition("_")[2]
            if not point.startswith(f"{ROW}_"):  # the point of another row
                measured[f"{point}_{axis}"] = column, rows
    for name, (column, rows) in measured.items():
        counted = rows & fit.good
        if counted.any():
            quantity, unit = observation.names[column], observation.units[column]
            parts = (part[:, column] for part in (before, after, observation.sigma, shares))
            fields = _group_fields(fit, counted, *parts)
            if name in between:  # all of a kind together
                name = quantity = name.partition("_")[0]
                if groups and groups[-1].name == name:
                    former = vars(groups.pop())
                    fields = {key: np.append(former[key], part) for key, part in fields.items()}
            groups.append(ResidualGroup(name, quantity, unit, **fields))
    return groups


def _group_fields(
    fit: Fit, counted: Mask, before: Array, after: Array, sigma: Array, shares: Array
) -> dict[str, Any]:
    """Return fields of ``ResidualGroup`` for counted rows, from arrays of shape (N[, k])."""
    return {
        "rows": np.repeat(fit.rows[counted], before.size // len(before)),
        "sigma": fit.noise_scale * sigma[counted].ravel(),
        "residuals_before": before[counted].ravel(),
        "residuals": after[counted].ravel(),
        "redundancy": shares[counted].ravel(),
    }


def _merged_outliers(fits: Sequence[Fit]) -> tuple[Outlier, ...]:
    """Return outliers of all fits, one for each row, the worst first."""
    outliers, rows = [outlier for fit in fits for outlier in fit.outliers], dict[int, Outlier]()
    for outlier in sorted(outliers, key=lambda outlier: -outlier.sigma):
        worst = rows.setdefault(outlier.row, outlier)
        rows[outlier.row] = replace(worst, weight=min(worst.weight, outlier.weight))
    return tuple(rows.values())
