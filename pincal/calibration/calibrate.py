"""The pipeline of a calibration: read, check, start, fit, find faults, validate.

``calibrate``, ``explain``, the command and the doctor all go this way; ``run`` has the steps in
order. The doctor tries calibrations until one works: of the measurements as they are; with a fault
corrected that explains the misfit; without rows that do not fit; the same in an unknown frame, then
with an unknown target as well; and of a machine that is known only roughly.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import ndtri

from pincal.blas import one_thread
from pincal.calibration.assemble import assemble
from pincal.calibration.calibration import Calibration, with_followed_influences
from pincal.calibration.findings import MANY_ROWS, findings_of, points_left_out, values_of
from pincal.calibration.fits import Fits, fitted
from pincal.calibration.hypotheses import photos, plausibility
from pincal.calibration.hypotheses.faults import with_zeros
from pincal.calibration.options import AUTO, By, Options
from pincal.calibration.result import CONTRADICTING, CalibrationResult
from pincal.calibration.terms.candidates import extended
from pincal.calibration.terms.choice import Explanation, choose
from pincal.calibration.terms.kinds import columns_of_terms, every_pair, parse_terms
from pincal.calibration.validation import with_validation
from pincal.errors import MeasurementError, MisfitError, ObservabilityError, PincalError
from pincal.estimation.components import tie_of
from pincal.estimation.fit import Outlier
from pincal.estimation.noise import check_noise
from pincal.estimation.system import FALSE_ALARM
from pincal.estimation.unknowns import External
from pincal.files.measurements import read_measurements
from pincal.files.mechanism_folders import as_mechanism
from pincal.finding import Finding
from pincal.model import Measurements, Mechanism
from pincal.words.findings import finding, sentences


def calibrate(
    mechanism: Mechanism | str | Path,
    measurements: Measurements | str | Path | Any,
    options: Options | None = None,
    **single_options: Any,
) -> CalibrationResult:
    """Return the identified parameters of a mechanism, with uncertainties.

    By default all legs are identified at once from all measurements of all rows, which reaches the
    Cramér–Rao bound. ``method="per-leg"`` identifies each leg alone.

    Args:
        mechanism: The nominal mechanism, where the search starts; or its name or folder.
        measurements: The measurements, or a CSV file of them.
        options: How to calibrate.
        **single_options: Options by name, such as ``noise=`` or ``setup=``: see ``Options``.

    Raises:
        ObservabilityError: the poses leave parameters undetermined.
        MeasurementError: the measurements cannot be of this mechanism, or options do not suit them.
    """
    return run(prepared(mechanism, measurements, options, **single_options))[0]


def explain(
    mechanism: Mechanism | str | Path,
    measurements: Measurements | str | Path | Any,
    options: Options | None = None,
    **single_options: Any,
) -> Explanation:
    """Return which terms the residuals of a calibration follow, and which of them to add.

    The mechanism, measurements, options, single_options and errors are as in ``calibrate``; the
    option ``terms`` has the kinds to try, by default all and numeric columns (temperature, time).
    """
    asked = Options.of(options, **single_options)
    return explained(prepared(mechanism, measurements, asked, terms=asked.terms or (AUTO,)))


def prepared(
    mechanism: Mechanism | str | Path,
    measurements: Measurements | str | Path | Any,
    options: Options | None = None,
    **single_options: Any,
) -> Calibration:
    """Return a calibration to be run; arguments and errors are as in ``calibrate``."""
    asked, machine = Options.of(options, **single_options), as_mechanism(mechanism)
    data = read_measurements(
        measurements,
        machine,
        asked.setup,
        partial=asked.latent,  # all legs at once need no complete poses
        influences=columns_of_terms(asked.terms) if asked.terms else (),
    )
    priors, setup = asked.priors_of(machine.parameters), asked.setup.of_rows(data.contacts)
    completed = replace(asked, setup=setup, priors=priors)
    # a copy, since the user may change the measurements later
    return with_followed_influences(Calibration(machine, replace(data), completed))


def identified(asked: Calibration, near: Fits | None = None) -> tuple[CalibrationResult, Fits]:
    """Return the result of a calibration without findings, and its fits.

    ``near`` are earlier fits whose residuals said that the model lacks something. Errors are as in
    ``calibrate``. If nothing explains a misfit at the start, but a fit halves it, the mechanism is
    known only roughly, and the options of the result say so.
    """
    calibration = replace(near.calibration, lacks=True) if near else started(asked)
    try:
        fits = fitted(calibration, near)
    except (PincalError, np.linalg.LinAlgError) as error:
        reason = explained_error(calibration, error)
        if reason is error and isinstance(error, MisfitError):
            with suppress(PincalError):
                roughly = identified(asked.with_options(rough=True))
                if roughly[0].converged and roughly[0].halves_residuals:
                    return roughly
        raise reason from error
    return assemble(fits), fits


@one_thread()
def run(
    asked: Calibration, folds: int | None = None, by: By = "region", near: Fits | None = None
) -> tuple[CalibrationResult, Fits, list[str]]:
    """Return the result of a calibration, its fits, and notes on why no rows were held out.

    ``folds`` (0 or None for none) and ``by`` are as in ``CalibrationResult.validated``, ``near`` as
    in ``identified``, and errors as in ``calibrate``.
    """
    result, fits = identified(asked, near)
    findings = (*explain_result(result, fits.external), *findings_of(result, fits))
    findings = (*findings, *points_left_out(asked.measurements, result.measurements))
    lacks = near is None and "model-lacks" in {remark.code for remark in findings}
    if lacks and tie_of(fits.fits[0], fits.noise):
        return run(asked, folds, by, fits)
    terms = sorted(fits.calibration.mechanism.amplitudes - asked.mechanism.amplitudes)
    if AUTO in asked.options.terms and terms:
        findings = (*findings, finding("terms-chosen", parameters=terms))
    outliers = result.outliers
    if result.excess > 1.0 and not result.options.rejects:
        findings, outliers = blame_wrong_rows(result, findings)
    unsaid = _AS_SAID * asked.options.rough
    findings = tuple(remark for remark in findings if remark.code not in unsaid)
    result = replace(result, findings=findings, outliers=outliers)
    if not folds or not result.converged:
        asked_none = folds == 0 and result.converged
        return result, fits, ["no rows were held out (--folds 0)"] * asked_none
    try:
        return with_validation(result, folds, by, fits), fits, []
    except (PincalError, ArithmeticError, np.linalg.LinAlgError) as error:
        return result, fits, [f"no held-out validation: {error}"]


_AS_SAID = ("far-from-nominal", "zeros-found")  # of a mechanism that is said to be roughly known
_BLAME_STEPS = 100  # rows that fit each other take tens
_FEW = 0.25  # share of rows that do not fit, up to which these are outliers
#: Findings that follow from wrong rows.
_FOLLOW = CONTRADICTING - {"terms-chosen"} | {"bad-rows", "outliers"}


def blame_wrong_rows(
    result: CalibrationResult, findings: tuple[Finding, ...]
) -> tuple[tuple[Finding, ...], tuple[Outlier, ...]]:
    """Return findings and outliers that blame a few wrong rows, if χ² is right without them.

    The numbers of the result remain those of all rows, since the user decides what is left out.
    Findings that follow from the wrong rows are dropped.
    """
    try:
        calibration = result.calibration.with_options(loss="reject")
        fits = fitted(calibration, patience=_BLAME_STEPS)
        robust = assemble(fits)
    except (PincalError, np.linalg.LinAlgError):  # the other rows may determine too little
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
    outliers = tuple(replace(outlier, weight=1.0) for outlier in rejected)  # as in the result
    return (wrong_rows, *without_rows, *unrelated), outliers


@one_thread()
def started(calibration: Calibration) -> Calibration:
    """Return a calibration with its measurements checked, and with its terms and start."""
    options = calibration.options
    check_noise(calibration.mechanism, options.noise)
    plausibility.check_contacts(calibration.observation, calibration.measurements)
    plausibility.check_distances(calibration)
    if options.setup.pixels:
        photos.check_photos(calibration)
    calibration = _with_terms(calibration)
    if options.rejects and options.setup.pixels:
        calibration = photos.without_false_points(calibration)
    if options.setup.plain:
        faults = () if options.rough else plausibility.implausible(calibration)
        start = with_zeros(calibration, faults) if faults or options.rough else None
        if faults and start is None:
            raise MisfitError(sentences(faults)[0])
        calibration = replace(calibration, start=start)
    return calibration


@one_thread()
def explained(calibration: Calibration) -> Explanation:
    """Return the explanation of a calibration to be run, whose terms are those to try."""
    tried = calibration.options.terms
    plain = replace(calibration, options=replace(calibration.options, terms=()))
    pairs = parse_terms(tried, plain.mechanism)
    pairs += every_pair(plain.mechanism, plain.measurements) if AUTO in tried else []
    result, fits, _ = run(plain)
    return Explanation(result, *choose(fits.calibration, list(dict.fromkeys(pairs)), fits))


def _with_terms(calibration: Calibration) -> Calibration:
    """Return a calibration whose mechanism has the terms that its options ask for."""
    terms, mechanism = calibration.options.terms, calibration.mechanism
    if not terms:
        return calibration
    plain = replace(calibration, options=replace(calibration.options, terms=()))
    plain = extended(plain, parse_terms(terms, mechanism))
    if AUTO not in terms:
        return plain
    models, chosen, *_ = choose(started(plain), every_pair(mechanism, plain.measurements))
    return extended(plain, models[chosen].added)


def explained_error(calibration: Calibration, error: Exception) -> Exception:
    """Return the error to raise for a failed fit: the fault that explains it, if there is one."""
    faults = plausibility.explain_misfit(calibration)
    if not isinstance(error, (MisfitError, np.linalg.LinAlgError)):  # no strange row causes that
        faults = tuple(fault for fault in faults if fault.severity == "error")
    if faults:
        return MisfitError(sentences(faults)[0])
    if isinstance(error, np.linalg.LinAlgError):
        options = "--loss none" if calibration.options.rejects else "--loss reject"
        return ObservabilityError(
            "the search went where the parameters are not determined by the rows that count; look "
            f"for rows that are wrong ({options}), or give a better nominal mechanism"
        )
    return error


def explain_result(result: CalibrationResult, frame: External) -> tuple[Finding, ...]:
    """Return findings that would explain too large residuals, and faults of boards."""
    if not result.explained:
        return plausibility.explain_misfit(result.calibration, frame)
    if result.options.setup.pixels:
        mirrored = photos.boards_behind(result.calibration, result.poses, frame)
        return (*photos.pitch_faults(result.calibration), *mirrored)
    return ()


@dataclass(frozen=True)
class Remedy:
    """A correction of the measurements or options, and the calibration with it."""

    findings: tuple[Finding, ...]
    """The faults that are corrected."""
    calibration: Calibration
    """The calibration with corrected measurements and options."""
    result: CalibrationResult | None
    """The result; None if calibration raised an error."""
    trouble: str
    """The error of the calibration; empty without one."""
    of_most_rows: bool = False
    """Whether the error is about most rows, so that leaving some out would not help."""

    @property
    def works(self) -> bool:
        """Whether the search converged, nothing contradicts it, and every used row fits."""
        result = self.result
        if result is None or not result.converged or not result.promises:
            return False
        return all(outlier.weight == 0.0 for outlier in result.outliers)


def remedies(calibration: Calibration) -> Iterator[Remedy]:
    """Yield remedies, the simplest first, up to the end of the stage in which one works."""
    for stage in _stages(calibration):
        yield from stage
        if any(remedy.works for remedy in stage):
            return


def cures_among(tries: Sequence[Remedy]) -> list[Remedy]:
    """Return remedies that work, else the simplest that mend a fault; the model may lack a term."""
    mends = [r for r in tries if r.findings and r.result is not None and r.result.converged]
    simplest = [r for r in mends if r.calibration.options == mends[0].calibration.options]
    return [remedy for remedy in tries if remedy.works] or simplest


def _stages(calibration: Calibration) -> Iterator[list[Remedy]]:
    setup = calibration.options.setup
    framed, placed = setup.anywhere(frame=True), setup.anywhere(frame=True, target=True)
    setups = [setup] + [framed] * (framed != setup) + [placed] * (placed != framed)
    for known in setups:  # with less and less known about frame and target
        in_setup = calibration.with_options(setup=known)
        first = _attempt((), in_setup)
        yield [first]
        explained = []
        for fault, judged in plausibility.hypotheses_of(in_setup):
            data = judged.hypothesis.correct(calibration.measurements)
            judged_setup = known.anywhere(frame=judged.free)
            mended = replace(in_setup, measurements=data).with_options(setup=judged_setup)
            explained.append(_attempt((fault,), mended))
        yield explained
        if not explained and any(in_setup.short_legs()):
            return  # nothing else is wrong
        yield _with_rows_rejected([first, *explained])
    if not calibration.options.rough:
        rough = _attempt((), calibration.with_options(rough=True))
        yield [rough]
        yield _with_rows_rejected([rough])


def _with_rows_rejected(remedies: Sequence[Remedy]) -> list[Remedy]:
    """Return the remedies with rows rejected that do not fit, where these are few."""
    few = []
    for remedy in remedies:
        result = remedy.result
        lost = result is not None and not (result.converged or result.outliers)
        if remedy.of_most_rows or lost or remedy.calibration.options.rejects:
            continue
        fewer = _attempt(remedy.findings, remedy.calibration.with_options(loss="reject"))
        if fewer.result is not None:
            left_out = sum(outlier.weight == 0.0 for outlier in fewer.result.outliers)
            few += [fewer] * (left_out <= _FEW * len(fewer.result.measurements))
    return few


@one_thread()
def _attempt(findings: tuple[Finding, ...], calibration: Calibration) -> Remedy:
    try:
        result, *_ = run(calibration)
    except PincalError as error:
        return Remedy(findings, calibration, None, str(error), isinstance(error, MeasurementError))
    try:
        # an estimate may be implausible
        check_noise(calibration.mechanism, result.noise)
    except MeasurementError:
        return Remedy(findings, calibration, None, "residuals are too large for noise")
    remedy = Remedy(findings, calibration, result, "")
    with suppress(PincalError, ArithmeticError, np.linalg.LinAlgError):
        return replace(remedy, result=result.validated()) if remedy.works else remedy
    return remedy
