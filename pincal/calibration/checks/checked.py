"""A result is checked by all that its rows allow: rows held out, and runs compared."""

from __future__ import annotations

from pincal.calibration.checks.folds import FOLDS, By
from pincal.calibration.checks.validation import with_held_out
from pincal.calibration.fits import Fits
from pincal.calibration.result import CalibrationResult
from pincal.errors import PincalError


def checked(
    result: CalibrationResult,
    folds: int = FOLDS,
    by: By = "region",
    whole: Fits | None = None,
) -> tuple[CalibrationResult, list[str]]:
    """Return the result with validation and runs where the rows allow, and why not elsewhere.

    Args:
        result: A calibration; one that did not converge is returned as it is.
        folds: How many times a share of the rows is held out; 0 for not at all.
        by: What is held out together: see ``validate``.
        whole: The fits of all rows, if they are at hand; else they are made again.
    """
    if not result.converged:
        return result, []
    said = [] if folds else ["no rows were held out (--folds 0)"]
    try:
        if folds:
            result = with_held_out(result, folds, by, whole)
    except (PincalError, ArithmeticError) as error:
        said.append(f"no held-out validation: {error}")
    try:
        if result.measurements.runs is not None:
            result.options.report("comparing the runs")
            result = result.compared()
    except PincalError as error:
        said.append(f"runs not compared: {error}")
    return result, said
