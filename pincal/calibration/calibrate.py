"""The pipeline of a calibration: read, check, start, fit, verify, decide what to say of it.

``calibrate``, ``explain``, the command and the doctor go this way; ``run`` has its steps in order.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import ndtri

from pincal.blas import one_thread
from pincal.calibration.assemble import assemble, with_unsure_tolerances
from pincal.calibration.calibration import Calibration, with_followed_influences
from pincal.calibration.findings import (
    MANY_ROWS,
    findings_of,
    misaligned,
    points_left_out,
    values_of,
)
from pincal.calibration.fits import Fits, fitted, with_found_tolerance, without_false_points
from pincal.calibration.hypotheses.faults import zeros_found, zeros_measured
from pincal.calibration.hypotheses.photos import check_photos, pitch_faults
from pincal.calibration.hypotheses.plausibility import (
    check_contacts,
    check_copies,
    check_distances,
    check_noise,
    explain_misfit,
    implausible,
)
from pincal.calibration.options import AUTO, FOLDS, By, Options
from pincal.calibration.result import CONTRADICTING, CalibrationResult
from pincal.calibration.terms.candidates import extended
from pincal.calibration.terms.choice import Explanation, choose
from pincal.calibration.terms.kinds import columns_of_terms, every_pair, parse_terms
from pincal.calibration.validation import held_out
from pincal.errors import MisfitError, ObservabilityError, PincalError
from pincal.estimation.components import tie_of
from pincal.estimation.fit import Outlier
from pincal.estimation.system import FALSE_ALARM
from pincal.estimation.unknowns import External
from pincal.files.measurements import read_measurements
from pincal.files.mechanism_folders import as_mechanism
from pincal.finding import Finding
from pincal.model.measurements import Measurements
from pincal.model.mechanism import Mechanism
from pincal.types import Array
from pincal.words.findings import finding, sentences


def calibrate(
    mechanism: Mechanism | str | Path,
    measurements: Measurements | str | Path | Any,
    options: Options | None = None,
    **single_options: Any,
) -> CalibrationResult:
    """Return the identified parameters of a mechanism, with uncertainties.

    By default all legs are identified at once from every row, with all that was measured: this
    reaches the Cramér–Rao bound. ``method="per-leg"`` identifies each leg alone.

    Args:
        mechanism: The nominal mechanism, where the search starts; or its name or folder.
        measurements: What was measured; or a CSV file or a DataFrame of it.
        options: How to calibrate.
        **single_options: Options by name, such as ``noise=`` or ``setup=``: see ``Options``.

    Raises:
        ObservabilityError: poses that leave parameters undetermined.
        MeasurementError: measurements that cannot be this mechanism's, or options that do not suit.
    """
    return run(prepared(mechanism, measurements, options, **single_options))[0]


def explain(
    mechanism: Mechanism | str | Path,
    measurements: Measurements | str | Path | Any,
    options: Options | None = None,
    **single_options: Any,
) -> Explanation:
    """Return what a calibration's residuals follow, and which terms pay.

    Args:
        mechanism: The nominal mechanism; or its name or folder.
        measurements: What was measured; or a CSV file or a DataFrame of it, whose other columns
            of numbers (temperature, time, …) are tried too.
        options: How to calibrate; ``terms`` are the kinds to try, all if none are given.
        **single_options: Single options by name, such as ``folds=``: see ``Options``.

    Raises:
        MeasurementError: measurements that cannot be this mechanism's, or an unknown kind of term.
        ObservabilityError: too few poses, or poses that leave parameters undetermined.
    """
    asked = Options.of(options, **single_options)
    return explained(prepared(mechanism, measurements, asked, terms=asked.terms or (AUTO,)))


def prepared(
    mechanism: Mechanism | str | Path,
    measurements: Measurements | str | Path | Any,
    options: Options | None = None,
    **single_options: Any,
) -> Calibration:
    """Return a calibration to be done; arguments and errors are those of ``calibrate``."""
    asked = Options.of(options, **single_options)
    machine = as_mechanism(mechanism)
    data = read_measurements(
        measurements,
        machine,
        asked.setup,
        partial=asked.latent,  # all legs at once need no complete poses
        influences=columns_of_terms(asked.terms),
    )
    completed = replace(asked, setup=asked.setup.of_rows(data.contacts))
    # a copy of the measurements: the user's may be changed
    return with_followed_influences(Calibration(machine, replace(data), completed))


@one_thread()
def run(
    asked: Calibration, folds: int | None = None, by: By = "region"
) -> tuple[CalibrationResult, Fits, list[str]]:
    """Return the result of a calibration, its fits, and why no rows were held out if some were to.

    Args:
        asked: The calibration as it was read.
        folds: How many times a share of the rows is held out, 0 or None for not at all.
        by: What is held out together: see ``CalibrationResult.validated``.

    Raises:
        PincalError: those of ``calibrate``.
    """
    calibration = started(asked)
    try:
        fits = fitted(calibration)
        sure_fits = with_unsure_tolerances(fits)
    except (PincalError, np.linalg.LinAlgError) as error:
        raise explained_error(calibration, error) from error
    result = assemble(sure_fits)
    findings = (*explain_result(result, fits.external), *findings_of(result, sure_fits))
    findings = (*findings, *points_left_out(asked.measurements, calibration.measurements))
    lacks = "model-lacks" in {remark.code for remark in findings} and not asked.lacks
    estimated = lacks and not fits.calibration.noise.known
    if estimated and tie_of(fits.fits[0], fits.noise, lacks=True):
        return run(replace(asked, lacks=True), folds, by)
    terms = sorted(calibration.mechanism.amplitudes - asked.mechanism.amplitudes)
    if AUTO in asked.options.terms and terms:
        findings = (*findings, finding("terms-chosen", parameters=terms))
    outliers = result.outliers
    if result.excess > 1.0 and result.loss == "none":
        findings, outliers = blame_wrong_rows(result, findings)
    result = replace(result, findings=findings, outliers=outliers)
    if not folds or not result.converged:
        asked_none = folds == 0 and result.converged
        return result, fits, ["no rows were held out (--folds 0)"] * asked_none
    try:
        return with_validation(result, folds, by, fits), fits, []
    except (PincalError, ArithmeticError) as error:
        return result, fits, [f"no held-out validation: {error}"]


#: Findings that follow from wrong rows.
_FOLLOW = CONTRADICTING - {"terms-chosen"} | {"bad-rows", "outliers"}


def blame_wrong_rows(
    result: CalibrationResult, findings: tuple[Finding, ...]
) -> tuple[tuple[Finding, ...], tuple[Outlier, ...]]:
    """Return findings and outliers that name the few rows that alone spoil a result, if any do.

    They do if χ² without them is as it should be. Parameters, residuals and standard errors stay
    those of all rows: the user says what is left out. What only follows from these rows is no
    longer said, what is found without them is.
    """
    try:
        fits = fitted(result.calibration.with_options(loss="reject"))
        robust = assemble(fits)
    except PincalError:
        return findings, result.outliers
    total = len(result.measurements)
    least = -ndtri(FALSE_ALARM / (2.0 * total))  # Bonferroni: one sound set in a hundred has any
    rejected = [row for row in robust.outliers if row.weight == 0.0 and row.sigma > least]
    are_few = 0 < len(rejected) <= MANY_ROWS * total
    if not (are_few and robust.converged and robust.excess == 1.0):
        return findings, result.outliers
    rows, values = [outlier.row for outlier in rejected], values_of(rejected[0])
    values |= {"chi2": result.reduced_chi2, "without": robust.reduced_chi2}
    wrong_rows = finding("wrong-rows", rows, total=total, **values)
    without_rows = [remark for remark in findings_of(robust, fits) if remark.code in _FOLLOW]
    unrelated = [remark for remark in findings if remark.code not in _FOLLOW]
    outliers = tuple(replace(outlier, weight=1.0) for outlier in rejected)  # they took part
    return (wrong_rows, *without_rows, *unrelated), outliers


@one_thread()
def started(calibration: Calibration) -> Calibration:
    """Return a calibration whose measurements were looked at: its terms, where a search starts."""
    options = calibration.options
    check_noise(calibration.mechanism, options.noise)
    check_copies(calibration.measurements, every_pose=options.every_pose)
    check_contacts(calibration.observation, calibration.measurements)
    check_distances(calibration)
    check_photos(calibration)
    calibration = _with_terms(calibration)
    if options.loss != "none" and options.setup.pixels:
        calibration = without_false_points(calibration)
    if options.setup.plain:
        calibration = replace(calibration, start=_start(calibration))
    return with_found_tolerance(calibration)


@one_thread()
def explained(calibration: Calibration) -> Explanation:
    """Return what ``explain`` does, of a calibration to be done; its terms are those to try."""
    tried = calibration.options.terms
    plain = replace(calibration, options=replace(calibration.options, terms=()))
    named = parse_terms([term for term in tried if term != AUTO], plain.mechanism)
    every = every_pair(plain.mechanism, plain.measurements) if AUTO in tried else []
    pairs = list(dict.fromkeys((*named, *every)))
    result, fits, _ = run(plain)
    return Explanation(result, *choose(fits.calibration, pairs, fits))


def _with_terms(calibration: Calibration) -> Calibration:
    """Return a calibration whose mechanism has the terms that its options ask for."""
    terms, mechanism = calibration.options.terms, calibration.mechanism
    if not terms:
        return calibration
    plain = replace(calibration, options=replace(calibration.options, terms=()))
    plain = extended(plain, parse_terms([term for term in terms if term != AUTO], mechanism))
    if AUTO not in terms:
        return plain
    models, chosen, *_ = choose(started(plain), every_pair(mechanism, plain.measurements))
    return extended(plain, models[chosen].added)


def _start(calibration: Calibration) -> Array | None:
    """Return where the search starts if motors' zeros are far from the drawing's."""
    if calibration.options.rough:
        return zeros_measured(calibration)
    faults = implausible(calibration)
    start = zeros_found(calibration, faults)
    if faults and start is None:
        raise MisfitError(sentences(faults)[0])
    return start


def explained_error(calibration: Calibration, error: Exception) -> Exception:
    """Return what to raise of a fit that failed: the fault that explains it, if there is one."""
    faults = explain_misfit(calibration)
    if isinstance(error, ObservabilityError):  # a few strange rows are no reason for that
        faults = tuple(fault for fault in faults if fault.severity == "error")
    if faults:
        return MisfitError(sentences(faults)[0])
    if isinstance(error, np.linalg.LinAlgError):
        return ObservabilityError(
            "the search went where the parameters are not determined; look for rows that are "
            "wrong (--loss reject), or give a better nominal mechanism"
        )
    return error


def explain_result(result: CalibrationResult, frame: External) -> tuple[Finding, ...]:
    """Return what would explain residuals or changes of parameters that are too large."""
    if not result.explained:
        return explain_misfit(result.calibration, frame)
    if result.options.setup.pixels:
        return pitch_faults(result.calibration)
    if not result.converged or not result.options.setup.plain or result.options.tied:
        return ()
    identified = np.concatenate([leg.identified for leg in result.legs])
    changes = identified - result.nominal.parameters.values - result.calibration.shift
    return misaligned(result.nominal, changes, result.poses, result.measurements.readings)


def with_validation(
    result: CalibrationResult, folds: int = FOLDS, by: By = "region", fits: Fits | None = None
) -> CalibrationResult:
    """Return what ``CalibrationResult.validated`` does; by the fits of all rows if at hand."""
    validation, wrong_rows = held_out(result.calibration, folds, by, fits)
    codes = {remark.code for remark in result.findings}
    news = tuple(remark for remark in validation.findings if remark.code not in codes)
    outliers = sorted((*result.outliers, *wrong_rows), key=lambda outlier: -outlier.sigma)
    findings = (*result.findings, *news)
    return replace(result, validation=validation, findings=findings, outliers=tuple(outliers))
