"""From fits to a result: parameters with intervals, residuals leg by leg, what to know first."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammainc, ndtri, stdtrit
from scipy.stats import chi2 as chi2_law
from scipy.stats import f as f_law

from pincal.identification.covariance import all_legs, nearest_to_nominal
from pincal.identification.estimate import Estimate
from pincal.identification.fit import Fit
from pincal.identification.latent import LatentPoses
from pincal.identification.result import (
    CalibrationResult,
    IdentifiedParameter,
    LegResult,
    Observed,
    TieTest,
)
from pincal.identification.robust import Outlier, Robust
from pincal.identification.task import Task
from pincal.kinematics.closure import largest_size
from pincal.model.measurements import Noise

Array = NDArray[np.float64]
_CONFIDENCE = 0.95
_UNLIKELY = 1e-4  # probability of a χ² at which the noise as given is doubted
_MOVED = 1e-9  # by which a unit motion of frames moves a difference of tied parameters
_FAR = 0.05  # of a leg's size, [rad] and [1]: changes of parameters that are doubted
_MUCH = 0.1  # share of rows that do not fit, from which the noise or the model is doubted


def assemble(task: Task, estimate: Estimate, without_ties: Estimate | None) -> CalibrationResult:
    """Return the result of all legs from one fit of all, or one fit each.

    Args:
        task: What was to be identified.
        estimate: The fits.
        without_ties: The fits without ties, if there were any.
    """
    mechanism, source = task.mechanism, task.noise.source
    fits = [one.fit for one in estimate.fits]
    covariance, outer = _covariances(task, estimate)
    variances = np.split(np.diagonal(covariance), np.cumsum(_sizes(task))[:-1])
    std = dict(zip(mechanism.leg_names, map(np.sqrt, variances), strict=True))
    by_name = {leg.name: leg for one in estimate.fits for leg in _leg_results(task, one, std)}
    legs = tuple(by_name[name] for name in mechanism.leg_names)
    dof = sum(one.degrees_of_freedom for one in fits)
    chi2 = sum(one.chi2 for one in fits) / dof if dof else np.nan
    noise = None if source == "rows" else task.noise.noise
    if source == "assumed":
        noise = Noise(*(float(np.sqrt(chi2)) * value for value in vars(task.noise.noise).values()))
    held = estimate.held
    lost = (held.words,) if held is not None and held.words else ()
    failed = [one.message for one in fits if not one.converged]
    evaluations = sum(one.evaluations for one in fits)
    latent = estimate.latent
    ties = () if without_ties is None else _tie_tests(task, without_ties)
    outliers = _merged([outlier for one in estimate.fits for outlier in one.outliers])
    return CalibrationResult(
        nominal=mechanism,
        identified=mechanism.with_parameters({leg.name: leg.identified for leg in legs}),
        legs=legs,
        method=task.method,
        residual="reading" if task.method == "latent" else task.kind,
        poses="all" if task.every_pose else "own",
        noise=noise,
        noise_source="estimated" if source == "assumed" else source,
        covariance=covariance,
        degrees_of_freedom=dof,
        reduced_chi2=float(chi2),
        iterations=evaluations,
        converged=not failed,
        message="; ".join(failed) or f"converged after {evaluations} evaluations",
        warnings=(
            *(
                f"these measurements do not tell everything: {words}; held as near to nominal as "
                "can be, so that the machine is calibrated where it was measured only"
                for words in lost
            ),
            *_warnings(task, legs, outliers, ties, dof, float(chi2)),
        ),
        loss=task.loss,
        outliers=outliers,
        shift=_shift(estimate.fits),
        external=_external(task, estimate, outer),
        gauge=() if estimate.gauge is None else estimate.gauge.words,
        gauge_directions=None if estimate.gauge is None else estimate.gauge.of_legs,
        undetermined=lost,
        undetermined_directions=held.of_legs if held is not None and lost else None,
        ties=ties,
        observed=() if latent is None else _observed(latent, fits[0], task.noise.known),
        estimated_poses=None
        if latent is None
        else mechanism.platform.from_matrices(fits[0].last.state.matrices),
    )


def _leg_results(task: Task, one: Robust, std: dict[str, Array]) -> list[LegResult]:
    """Return the results of the legs of a fit."""
    found, problem = one.fit, one.fit.problem
    results = []
    for index, (leg, columns) in enumerate(zip(problem.legs, problem.columns, strict=True)):
        own = problem.used[:, index] & (found.weights > 0.0)
        before = problem.leg_residual(found.first, index)
        after = problem.leg_residual(found.last, index)
        rank, condition = found.ranks[index]
        values = after.value[own]
        results.append(
            LegResult(
                name=leg.name,
                parameters=tuple(
                    _parameters(
                        task,
                        found,
                        leg.parameter_names,
                        [leg.units[name] for name in leg.parameter_names],
                        leg.nominal,
                        found.parameters[columns],
                        std[leg.name],
                    )
                ),
                rank=rank,
                condition=condition,
                rms_before=_rms(before.value[own]),
                rms_after=_rms(values),
                unit=after.unit,
                n_residuals=values.size,
                sigma=after.sigma[own].ravel(),
                rows=np.repeat(one.rows[own], values.shape[1]),
                residuals_before=before.value[own].ravel(),
                residuals=values.ravel(),
            )
        )
    return results


def _parameters(
    task: Task,
    found: Fit,
    names: Sequence[str],
    units: Sequence[str],
    nominal: Array,
    values: Array,
    std: Array,
) -> list[IdentifiedParameter]:
    """Return parameters with their 95 % intervals."""
    half = (1 + _CONFIDENCE) / 2
    known = task.noise.known
    quantile = float(ndtri(half) if known else stdtrit(found.degrees_of_freedom, half))
    return [
        IdentifiedParameter(
            name=name,
            unit=unit,
            nominal=float(start),
            identified=float(value),
            std=float(error),
            low=float(value - quantile * error),
            high=float(value + quantile * error),
        )
        for name, unit, start, value, error in zip(names, units, nominal, values, std, strict=True)
    ]


def _rms(values: Array) -> float:
    return float(np.sqrt((values**2).mean())) if len(values) else np.nan


def _external(
    task: Task, estimate: Estimate, outer: Array | None
) -> tuple[IdentifiedParameter, ...]:
    """Return frame and targets with their intervals."""
    outside, external = estimate.outside, estimate.external
    if outside is None or external is None or outer is None or not len(outside):
        return ()
    start, values = (outside.coordinates(one) for one in (outside.start, external))
    D = outside.coordinates_by_step(external)
    std = np.sqrt(np.diagonal(D @ outer @ D.T))
    found = estimate.fits[0].fit
    return tuple(_parameters(task, found, outside.names, outside.units, start, values, std))


def _sizes(task: Task) -> list[int]:
    return [len(leg.parameters) for leg in task.mechanism.legs]


def _covariances(task: Task, estimate: Estimate) -> tuple[Array, Array | None]:
    """Return the covariance of all legs' parameters, and of the external unknowns' steps."""
    n = sum(_sizes(task))
    if estimate.latent is not None:
        full = estimate.fits[0].fit.covariance
        return full[:n, :n], full[n:, n:]
    covariance = all_legs(task.mechanism, estimate.fits)
    if estimate.gauge is None or estimate.unknowns is None:
        return covariance, None
    return nearest_to_nominal(covariance, estimate.gauge, estimate.unknowns)


def _observed(latent: LatentPoses, found: Fit, known: bool) -> tuple[Observed, ...]:
    """Return how the measured quantities of the platform fit."""
    scale = 1.0 if known else float(np.sqrt(found.chi2 / max(found.degrees_of_freedom, 1)))
    seen = latent.observation
    before, values = (
        seen.evaluate(one.state.matrices, one.state.external).value
        for one in (found.first, found.last)
    )
    results = []
    for column, (name, unit) in enumerate(zip(seen.names, seen.units, strict=True)):
        own = seen.measured[:, column] & (found.weights > 0.0)
        if own.any():
            sigmas, after = scale * latent.sigma_observed[own, column], values[own, column]
            results.append(
                Observed(
                    name=name,
                    unit=unit,
                    count=int(own.sum()),
                    rms=_rms(after),
                    sigma=_rms(sigmas),
                    rows=np.flatnonzero(own),
                    sigmas=sigmas,
                    residuals_before=before[own, column],
                    residuals=after,
                )
            )
    return tuple(results)


def _merged(outliers: Sequence[Outlier]) -> tuple[Outlier, ...]:
    """Return outliers of all fits, one for each row, the worst first."""
    rows: dict[int, Outlier] = {}
    for one in sorted(outliers, key=lambda o: -o.sigma):
        worst = rows.setdefault(one.row, one)
        if worst is not one:
            legs = (*worst.legs, *one.legs)
            rows[one.row] = replace(worst, legs=legs, weight=min(worst.weight, one.weight))
    return tuple(rows.values())


def _shift(fits: Sequence[Robust]) -> float | None:
    """Return by how many standard errors parameters would move without the loss, at most."""
    shifts = []
    for one in fits:
        if one.plain is None:
            return None
        n = len(one.fit.parameters)
        std = np.sqrt(np.diagonal(one.fit.covariance))[:n]
        moved = np.abs(one.plain.parameters - one.fit.parameters)
        shifts.append((moved[std > 0.0] / std[std > 0.0]).max(initial=0.0))
    return float(max(shifts))


def _tie_tests(task: Task, free: Estimate) -> tuple[TieTest, ...]:
    """Return, for all ties together, the test whether they hold, by the fit without them.

    Differences that a motion of the frames makes or undoes say nothing: they are left out.
    Differences of tied parameters between legs over their covariance (Wald): χ² where the noise is
    known, an F test where its scale is estimated.
    """
    names = [(leg.name, name) for leg in task.mechanism.legs for name in leg.parameter_names]
    parameters = free.parameters(task.mechanism)
    values = np.concatenate([parameters[leg] for leg in task.mechanism.leg_names])
    covariance, _ = _covariances(task, free)
    rows = []
    for tie in task.tied:
        places = [i for i, (_, name) in enumerate(names) if name == tie]
        rows += [np.eye(len(names))[i] - np.eye(len(names))[places[0]] for i in places[1:]]
    R = np.array(rows)
    if free.gauge is not None and free.gauge.of_legs is not None:
        directions = free.gauge.of_legs
        moved = R @ directions / np.linalg.norm(directions, axis=0)
        axes, size, _ = np.linalg.svd(moved)
        R = axes[:, int((size > _MOVED).sum()) :].T @ R
    if not len(R):
        return ()
    off = R @ values
    statistic = float(off @ np.linalg.solve(R @ covariance @ R.T, off)) / len(R)
    dof = sum(one.fit.degrees_of_freedom for one in free.fits)
    known = task.noise.known
    p = chi2_law.sf(statistic * len(R), len(R)) if known else f_law.sf(statistic, len(R), dof)
    return (TieTest(", ".join(task.tied), len(R), statistic, float(p)),)


def _far(task: Task, legs: Sequence[LegResult]) -> list[str]:
    """Return a warning if parameters moved farther than those of one machine differ."""
    platform = task.mechanism.platform
    size = largest_size(task.mechanism.legs, platform)
    moved = [
        (abs(p.identified - p.nominal) / (_FAR * (size if p.unit == "m" else 1.0)), leg, p)
        for leg in legs
        for p in leg.parameters
    ]
    share, leg, p = max(moved, key=lambda one: one[0])
    if task.rough or not share > 1.0:
        return []
    return [
        f"{p.name} of {leg.name} moved by {p.identified - p.nominal:+.3g} {p.unit}, farther than a "
        "machine differs from its drawing: check the frame and target of the measurements "
        "(--unknown-frame, --unknown-target), units, and the order of the readings"
    ]


def _warnings(
    task: Task,
    legs: Sequence[LegResult],
    outliers: Sequence[Outlier],
    ties: Sequence[TieTest],
    dof: int,
    chi2: float,
) -> list[str]:
    """Return what the reader of a result should know first."""
    found = []
    source, mechanism = task.noise.source, task.mechanism
    if source == "assumed":
        turns = "rad" in mechanism.platform.units
        what = "position [m]" + (" and orientation [rad]" if turns else "")
        if task.noise.noise.reading:
            what += " and readings"
        exact = "" if task.noise.noise.reading else ", exact readings"
        found.append(
            f"the noise was not given: equal standard deviations of {what}{exact} were assumed, "
            "and the scale estimated from the residuals"
        )
    elif dof and not _UNLIKELY <= gammainc(dof / 2, dof * chi2 / 2) <= 1.0 - _UNLIKELY:
        given = "repeated rows show" if source == "repeats" else "given"
        found.append(
            f"reduced χ² is {chi2:.3g} where 1 is expected: the noise is "
            f"{'larger' if chi2 > 1 else 'smaller'} than {given}"
            f"{', or the model lacks something' if chi2 > 1 else ''}; the uncertainties assume "
            "that noise"
        )
    found += _far(task, legs)
    listed = len(outliers)
    if listed and task.loss == "none":
        worst = outliers[0]
        found.append(
            f"{listed} of {len(task.data)} rows do not fit the others, the worst data row "
            f"{worst.row + 1} by {worst.sigma:.1f} standard deviations ({worst.why}); look at "
            "them, or use a robust loss (--robust reject)"
        )
    if listed > _MUCH * len(task.data):
        found.append(
            f"{100 * listed / len(task.data):.0f} % of the rows do not fit: rather the noise is "
            "larger than assumed, or the model lacks something, than that so many are wrong"
        )
    found += [
        f"{one.name} is tied over the legs, and the measurements contradict that "
        f"(p = {one.p_value:.2g})"
        for one in ties
        if not one.holds
    ]
    found += [
        f"{leg.name}: {leg.n_residuals} poses for {len(leg.parameters)} parameters; two or three "
        "times as many poses as parameters are advised"
        for leg in legs
        if leg.n_residuals < 1.5 * len(leg.parameters)
    ]
    return found
