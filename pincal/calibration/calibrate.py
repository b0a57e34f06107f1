"""Calibrate: check, fit, report. Parameters of all legs from what was measured."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from pincal.blas import on_one_thread
from pincal.calibration.assemble import assemble, wrong_rows
from pincal.calibration.calibration import Calibration
from pincal.calibration.fits import Fits, fitted
from pincal.calibration.hypotheses.faults import zeros_found, zeros_measured
from pincal.calibration.hypotheses.plausibility import (
    check_copies,
    check_noise,
    explain_misfit,
    implausible,
    misaligned,
    said,
)
from pincal.calibration.options import AUTO, Options
from pincal.calibration.result import CalibrationResult
from pincal.calibration.terms.candidates import extended
from pincal.calibration.terms.choice import choose
from pincal.calibration.terms.kinds import columns_said, every_pair
from pincal.calibration.terms.kinds import said as said_terms
from pincal.calibration.tolerances import with_found_tolerance, with_unsure_tolerances
from pincal.errors import MisfitError, ObservabilityError, PincalError
from pincal.estimation.blocks.external import External
from pincal.files.mechanism_folders import as_mechanism
from pincal.files.read import as_measurements
from pincal.finding import Finding
from pincal.model.measurements import Measurements
from pincal.model.mechanism import Mechanism
from pincal.types import Array
from pincal.words.sentences import finding


def calibrate(
    mechanism: Mechanism | str | Path,
    measurements: Measurements | str | Path | Any,
    options: Options | None = None,
    **more: Any,
) -> CalibrationResult:
    """Return the identified parameters of a mechanism, with uncertainties.

    By default all legs are identified at once from every row, with all that was measured: this
    reaches the Cramér–Rao bound. ``method="per-leg"`` identifies each leg alone.

    Args:
        mechanism: The nominal mechanism, where the search starts; or its name or folder.
        measurements: What was measured; or a CSV file or a DataFrame of it.
        options: How to calibrate.
        **more: Single options by name, such as ``noise=`` or ``setup=``: see ``Options``.

    Raises:
        ObservabilityError: too few poses, or poses that leave parameters undetermined.
        MeasurementError: measurements that cannot be this mechanism's; noise that is given
            twice, or leaves a residual without any; the joint residual out of reach; an unknown
            parameter or option.
    """
    return wrong_rows(identify(prepared(mechanism, measurements, options, **more)))


def prepared(
    mechanism: Mechanism | str | Path,
    measurements: Measurements | str | Path | Any,
    options: Options | None = None,
    **more: Any,
) -> Calibration:
    """Return a calibration to be done; arguments and errors are those of ``calibrate``."""
    chosen = Options.of(options, **more)
    machine = as_mechanism(mechanism)
    columns = columns_said(chosen.terms)
    partly = chosen.latent  # all legs at once need no whole poses
    data = as_measurements(measurements, machine, chosen.setup, partial=partly, influences=columns)
    return Calibration(machine, replace(data), chosen)  # a copy: the user's may be changed


@on_one_thread
def started(calibration: Calibration) -> Calibration:
    """Return a calibration whose measurements were looked at: its terms, where its search starts.

    Raises:
        MeasurementError: noise, copies of rows, or faults that bar a calibration.
    """
    options = calibration.options
    if options.noise is not None:
        check_noise(calibration.mechanism, options.noise)
    check_copies(calibration.measurements, every_pose=options.every_pose)
    calibration = _with_terms(calibration)
    if options.setup.plain:
        calibration = replace(calibration, start=_start(calibration))
    return with_found_tolerance(calibration)


def _with_terms(calibration: Calibration) -> Calibration:
    """Return a calibration whose mechanism has the terms that its options ask for."""
    terms, data = calibration.options.terms, calibration.measurements
    if not terms:
        return calibration
    plain = replace(calibration, options=replace(calibration.options, terms=()))
    mechanism = plain.mechanism
    named = said_terms([one for one in terms if one != AUTO], mechanism)
    plain = extended(plain, named)
    if AUTO not in terms:
        return plain
    return extended(plain, choose(started(plain), every_pair(mechanism, data)).model.added)


def identify(calibration: Calibration) -> CalibrationResult:
    """Return what a calibration finds; errors are those of ``calibrate``."""
    return identified(calibration)[0]


@on_one_thread
def identified(calibration: Calibration) -> tuple[CalibrationResult, Fits]:
    """Return what a calibration finds, and the fits of it, for checks that go on from there.

    Errors are those of ``calibrate``.
    """
    asked, calibration = calibration, started(calibration)
    options = calibration.options
    try:
        fits = fitted(calibration)
        found = with_unsure_tolerances(fits)
    except (PincalError, np.linalg.LinAlgError) as error:
        causes = _causes(calibration, None)
        if isinstance(error, ObservabilityError):  # a few strange rows are no reason for that
            causes = tuple(one for one in causes if one.severity == "error")
        if causes:
            raise MisfitError(said(causes)) from error
        if isinstance(error, np.linalg.LinAlgError):
            raise ObservabilityError(
                "the search went where the parameters are not determined; look for rows that are "
                "wrong (--robust reject), or give a better nominal mechanism"
            ) from error
        raise
    result = assemble(found, fitted(calibration, tied=False) if options.tied else None)
    result = _explained(result, found)
    terms = sorted(calibration.mechanism.amplitudes - asked.mechanism.amplitudes)
    if AUTO in asked.options.terms and terms:
        result = result.with_only((*result.findings, finding("terms-chosen", parameters=terms)))
    return result, fits


def _start(calibration: Calibration) -> Array | None:
    """Return where the search starts if motors' zeros are far from the drawing's.

    Raises:
        MeasurementError: something else explains that the nominal mechanism does not fit.
    """
    if calibration.options.rough:
        return zeros_measured(calibration)
    found = implausible(calibration.mechanism, calibration.measurements)
    start = zeros_found(calibration, found)
    if found and start is None:
        raise MisfitError(said(found))
    return start


def _explained(result: CalibrationResult, found: Fits) -> CalibrationResult:
    """Return the result with what would explain residuals or changes that are too large, first."""
    first: tuple[Finding, ...] = ()
    if not result.explained:
        first = _causes(result.calibration, found.external)
    elif result.converged and result.options.setup.plain and not result.options.tied:
        changes = np.array([p.change for leg in result.legs for p in leg.parameters])
        changes -= result.calibration.shift
        data = result.measurements
        first = misaligned(result.nominal, changes, result.poses, data.readings)
    rest = (one for one in result.findings if one not in first)
    return result.with_only((*first, *rest))


def _causes(calibration: Calibration, frame: External | None) -> tuple[Finding, ...]:
    """Return what would explain that measurements do not fit."""
    options = calibration.options
    found = explain_misfit(calibration.mechanism, calibration.measurements, options.setup, frame)
    if calibration.start is None:
        return found
    return tuple(one for one in found if one.code != "reading-offset")  # the search started there
