"""The findings of a calibration: what its reader should know before its numbers, as data."""

from typing import Any

import numpy as np
from scipy.special import chdtrc

from pincal.calibration.fits import Fits
from pincal.calibration.hypotheses.photos import moved_cameras
from pincal.calibration.promise import UNEXPLAINED
from pincal.calibration.result import CalibrationResult
from pincal.calibration.result_parts import IdentifiedParameter
from pincal.estimation.components import READINGS, Moments
from pincal.estimation.fit import Fit, Outlier
from pincal.estimation.noise import assumed_noise
from pincal.estimation.observability.courses import Score, scores
from pincal.estimation.observability.identifiable import plausible_changes
from pincal.estimation.observability.residuals import together
from pincal.estimation.system import FALSE_ALARM
from pincal.finding import Finding
from pincal.model import ORIGIN, Measurements, Noise
from pincal.model.checks import ROUNDING
from pincal.types import Index
from pincal.words.findings import finding

MANY_ROWS = 0.1  # share of rows that do not fit, above which the noise or the model is doubted
_FEW_RESIDUALS = 1.5  # residuals per parameter, below which more poses are advised
_WIDER = 1.25  # factor by which a ± that is too small matters
_SHOWN = 3.0  # standard deviations of a score, from which a test sees it
_EXPLAINS = 0.25  # share of the excess of χ², above which a course is its cause
_REPEATS = 4  # measurements of a pose, from which its motion is tested
_SPREAD = 0.5  # share of the run over which these must be spread


def findings_of(result: CalibrationResult, fits: Fits) -> tuple[Finding, ...]:
    """Return the findings of a result, by its numbers and by the residuals of its fits."""
    held, lacks, rows = fits.held, list[Finding](), list[Finding]()
    first, astray = list[Finding](), list[Finding]()
    noise, far = _noise_findings(result), _implausible_changes(result)
    if held is not None and (held.groups or held.weak):  # a misfit may be why a search went astray
        place = astray if held.fewest else first
        place.append(finding("undetermined-held", groups=held.groups, weak=held.weak))
    if copies := result.calibration.copies:
        equal = sorted({*np.ravel(copies).tolist()})
        first.append(finding("rows-copied", equal, first=copies[0], pairs=len(copies)))
    first += _zeros_found(result)
    few = _few_poses(result)
    if rounding(fits):
        noise = [finding("no-noise")] if result.noise_source == "estimated" else noise
        return (*first, *noise, *astray, *far, *few)
    if result.converged:
        noise = noise or _noise_proportion(fits)
        lacks = lacking(fits)
    lacks = moved_cameras(fits) or lacks
    outliers, total = result.outliers, len(result.measurements)
    wrong = [outlier.row for outlier in outliers]
    if len(wrong) > MANY_ROWS * total:
        rows = [finding("many-outliers", wrong, share=len(wrong) / total)]
    elif wrong and result.loss == "none":
        values = values_of(outliers[0])
        rows = [finding("outliers", wrong, total=total, lacking=bool(lacks), **values)]
    return (*first, *noise, *astray, *lacks, *far, *rows, *few)


def _few_poses(result: CalibrationResult) -> list[Finding]:
    """Return a finding for legs with few poses for their parameters, equal numbers together."""
    few: dict[tuple[int, int], list[str]] = {}
    for leg in result.legs:
        if leg.n_residuals < _FEW_RESIDUALS * len(leg.parameters):
            few.setdefault((len(np.unique(leg.rows)), len(leg.parameters)), []).append(leg.name)
    return [
        finding("few-poses", legs=tuple(legs), poses=poses, unknowns=unknowns)
        for (poses, unknowns), legs in few.items()
    ]


def points_left_out(measured: Measurements, used: Measurements) -> tuple[Finding, ...]:
    """Return a finding with the points of photos that a fit leaves out (two quantities each)."""
    gone = {n: np.isfinite(v) & ~np.isfinite(used.extra[n]) for n, v in measured.extra.items()}
    places = sorted((int(row), name) for name in gone for row in np.flatnonzero(gone[name]))[::2]
    names = tuple(name.removesuffix("_u").replace("_", " ", 1) for _, name in places)
    return (finding("points-left-out", [row for row, _ in places], names=names),) * bool(places)


def rounding(fits: Fits) -> bool:
    """Return whether residuals are rounding errors, which say nothing."""
    limit = 10.0 * ROUNDING * max(1.0, fits.calibration.mechanism.size)
    parts = [fit.last.conditions[fit.good] for fit in fits.fits]
    return all(np.abs(part).max(initial=0.0) <= limit for part in parts)


def _zeros_found(result: CalibrationResult) -> list[Finding]:
    pairs = zip(_leg_parameters(result), result.calibration.shift, strict=True)
    moved = [parameter for parameter, shift in pairs if shift]
    if not moved:
        return []
    changes = tuple((p.id, p.change, p.unit) for p in moved)
    return [finding("zeros-found", parameters=[p.id for p in moved], changes=changes)]


def _leg_parameters(result: CalibrationResult) -> list[IdentifiedParameter]:
    return [parameter for leg in result.legs for parameter in leg.parameters]


def _noise_findings(result: CalibrationResult) -> list[Finding]:
    dof, chi2 = result.degrees_of_freedom, result.reduced_chi2
    if result.noise and result.noise_source == "estimated":
        return [finding("noise-estimated", **noise_values(result, result.noise))]
    if not dof or UNEXPLAINED <= result.chi2_p_value <= 1.0 - UNEXPLAINED:
        return []
    code = "chi2-too-large" if chi2 > 1.0 else "chi2-too-small"
    return [finding(code, chi2=chi2, dof=dof, source=result.noise_source)]


def noise_values(result: CalibrationResult, noise: Noise) -> dict[str, Any]:
    """Return the sizes of a noise by name, None of what was not measured, and reading units."""
    columns = result.calibration.observation
    measured = np.array(columns.units)[columns.measured.any(axis=0)]
    kinds = (("position", "m"), ("orientation", "rad"), ("pixel", "px"))
    sizes = {k: getattr(noise, k) if unit in measured else None for k, unit in kinds}
    return {**sizes, "reading": noise.reading, "units": sorted(set(result.nominal.reading_units))}


def _noise_proportion(fits: Fits) -> list[Finding]:
    """Return a finding if some measured quantities are noisier than given, others less.

    It is a score test of variance components at the given noise s: q has the mean F s and the
    covariance 2 F, plus that of the noise where repeated rows show it; its cube roots are nearly
    normal (E. B. Wilson, M. M. Hilferty 1931). Separate legs, which share noise, are not tested.
    """
    noise, machine = fits.calibration.noise, fits.calibration.mechanism
    if not (fits.latent and noise.known):
        return []
    moments, exact = fits.moments, not any(fit.problem.leg_block.sigma.any() for fit in fits.fits)
    names = np.array(["positions", "orientations", "readings", "pixels"])[: len(moments.F)]
    groups = np.flatnonzero(np.diagonal(moments.F) > 0.0)
    F, given = moments.F[np.ix_(groups, groups)], 1.0 - exact * (groups == READINGS)
    q, expected, variances = moments.q[groups], F @ given, np.linalg.pinv(F) @ moments.q[groups]
    spread = 2.0 * F + F @ np.diag([2.0 / noise.freedoms[group] for group in groups]) @ F
    spread /= np.outer(expected, expected)
    excesses = 3.0 * (np.cbrt(q / expected) - 1.0) + np.diagonal(spread) / 3.0
    p_value = float(chdtrc(len(groups), excesses @ np.linalg.pinv(spread) @ excesses))
    larger = np.where(given > 0.0, variances, q / expected) > 1.0
    usual, unit = assumed_noise(machine, exact=False).reading, machine.reading_units[0]
    if p_value < FALSE_ALARM and len(groups) > 1 and larger.any():
        sizes = np.sqrt(variances.clip(0.0)).tolist()
        ratios = dict(zip(names[groups].tolist(), sizes, strict=True))
        reading = usual * ratios.pop("readings", 0.0) if exact else None
        values: dict[str, Any] = {"ratios": ratios, "p_value": p_value, "reading": reading}
        return [finding("noise-in-other-proportion", unit=unit, **values)]
    if not exact or (harmful := _harmful_noise(moments)) >= 1.0:
        return []
    rows = len(fits.calibration.measurements)
    return [finding("readings-exact", reading=usual * harmful, unit=unit, total=rows)]


def _harmful_noise(moments: Moments) -> float:
    """Return from where noise of readings taken as exact spoils a ±; infinite if the rows show it.

    It is relative to the noise of the moments. Its square s multiplies variances of unknowns by
    1 + s g, and moves the score of the readings by F s / √(2 F) standard deviations.
    """
    _, P, by_rows = moments.parts[0]
    W = by_rows[:, by_rows.any(axis=0)]
    growth = np.einsum("in,ij,jn->n", W, P[READINGS], W) / (W**2).sum(axis=0)
    harmful = (_WIDER**2 - 1.0) / max(growth.max(initial=0.0), 1e-300)
    shown = harmful * np.sqrt(moments.F[READINGS, READINGS].clip(0.0) / 2.0) >= _SHOWN
    return np.inf if shown else float(np.sqrt(harmful))


def lacking(fits: Fits) -> list[Finding]:
    """Return findings of errors that the model lacks, by all tests of residuals combined.

    The most significant test is named; repeated measurements of a pose are a test of their own.
    Tests of all readings together weigh as much as all tests of single readings. One in a hundred
    sound calibrations has such a finding. An error that explains little of a misfit is not named,
    since other causes look like a step, too.
    """
    data = fits.calibration.measurements
    scored = [
        (score, fit) for fit in fits.fits for score in scores(fit, _repeated_poses(data, fit.rows))
    ]
    scored.sort(key=lambda pair: (pair[0].p_value, -pair[0].share))
    if not scored:  # residuals that are not white
        return []
    common = np.array([score.common for score, _ in scored])
    weights = np.where(common, 0.5 / max(common.sum(), 1), 0.5 / max((~common).sum(), 1))
    repeated = np.array([score.term == "again" for score, _ in scored], dtype=bool)
    p_values = np.array([score.p_value for score, _ in scored])
    clear = []
    for of_kind in (~repeated, repeated):
        p_value = together(p_values[of_kind], weights[of_kind])
        if p_value < FALSE_ALARM:
            worst, fit = scored[int(np.argmax(of_kind))]
            excess = (fit.chi2 - fit.degrees_of_freedom) * fits.calibration.noise.known
            if worst.share * fit.chi2 >= _EXPLAINS * excess:
                clear.append(_named_error(p_value, worst, fit, data))
    return clear


def _named_error(p_value: float, worst: Score, fit: Fit, data: Measurements) -> Finding:
    """Return a finding for an error that residuals follow, a step, or a pose that moved."""
    values: dict[str, Any] = {"quantity": worst.name, "p_value": p_value}
    if worst.correlation:
        return finding("rows-alike", correlation=worst.correlation, **values)
    if worst.term not in ("step", "again"):
        return finding("model-lacks", term=worst.term, **values)
    size: dict[str, Any] = {"size": worst.total, "unit": worst.unit, "p_value": p_value}
    if worst.term == "step":
        return finding("step", fit.rows[[worst.row]], what=worst.what, name=worst.name, **size)
    rows = fit.rows[_repeated_poses(data, fit.rows)[worst.place]]
    return finding("reference-moved", rows, pose=worst.place, quantity=worst.name, **size)


def _repeated_poses(data: Measurements, rows: Index) -> dict[str, Index]:
    """Return the rows of a fit by names of poses that were measured repeatedly during the run."""
    names = np.array(data.places or ("",) * len(data))[rows]
    rows_by_name = {str(name): np.flatnonzero(names == name) for name in np.unique(names) if name}
    return {
        name: at_pose
        for name, at_pose in rows_by_name.items()
        if len(at_pose) >= _REPEATS and np.ptp(at_pose) >= _SPREAD * len(names)
    }


def _implausible_changes(result: CalibrationResult) -> list[Finding]:
    """Return a finding if parameters moved, or noise might move them, implausibly far."""
    options = result.options
    parameters = _leg_parameters(result)
    plausible = plausible_changes(result.nominal)
    values: dict[str, Any]
    std, half = (np.array(v) for v in zip(*((p.std, p.half) for p in parameters), strict=True))
    std = np.where(np.isfinite(std), std, 0.0)  # noise does not move held parameters
    std, half = std / result.excess, half / result.excess  # by poses and noise, not by misfit
    if (weak := np.flatnonzero(std > plausible)).size:
        worst = parameters[int(np.argmax(std / plausible))]
        values = {"parameter": worst.id, "half": worst.half, "unit": worst.unit}
        ids = [parameters[i].id for i in weak]
        option = "--strict" * options.strict if options.latent else "--method per-leg"
        return [finding("weakly-determined", parameters=ids, option=option, **values)]
    moved = np.array([p.change for p in parameters]) - result.calibration.shift
    surely = (np.abs(moved) - half) / plausible  # more than its uncertainty
    far = parameters[int(np.argmax(surely))]
    if surely.max() <= 1.0:
        return []
    values = {"parameter": far.id, "change": far.change, "unit": far.unit}
    unused = ["unknown-frame"] * (not options.setup.unknown_frame)
    known = not options.setup.targets[ORIGIN].unknown and len(options.setup.targets) == 1
    unused += ["unknown-target"] * known
    return [finding("far-from-nominal", parameters=[far.id], options=tuple(unused), **values)]


def values_of(outlier: Outlier) -> dict[str, Any]:
    """Return the values of a finding for a row that does not fit."""
    return {name: getattr(outlier, name) for name in ("sigma", "quantity", "off")}
