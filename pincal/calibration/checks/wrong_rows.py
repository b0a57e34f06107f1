"""Whether few rows alone make residuals too large for the noise: a fit that leaves them out."""

from __future__ import annotations

from dataclasses import replace

from pincal.calibration.assemble import assemble
from pincal.calibration.findings import QUESTIONS
from pincal.calibration.fits import fitted
from pincal.calibration.result import CalibrationResult
from pincal.errors import PincalError
from pincal.words.sentences import finding

#: Findings that follow from wrong rows.
_FOLLOW = frozenset(
    {
        "chi2-too-large",
        "outliers",
        "many-outliers",
        "model-lacks",
        "step",
        "noise-in-other-proportion",
        "bad-rows",
        "curved",
    }
)


def wrong_rows(result: CalibrationResult) -> CalibrationResult:
    """Return a result that says which few rows spoil it, if without them χ² is as it should be.

    Parameters, residuals and standard errors stay those of all rows: what is left out is said by
    the user. What only follows from these rows is no longer said.
    """
    if result.loss != "none" or not result.converged or result.excess == 1.0:
        return result
    try:
        robust = assemble(fitted(result.calibration.with_options(loss="reject")), None)
    except PincalError:
        return result
    left = [one for one in robust.outliers if one.weight == 0.0]
    few = 0 < len(left) <= QUESTIONS.much * len(result.measurements)
    if not (few and robust.converged and robust.excess == 1.0):
        return result
    worst = left[0]
    said = finding(
        "wrong-rows",
        [one.row for one in left],
        total=len(result.measurements),
        chi2=result.reduced_chi2,
        without=robust.reduced_chi2,
        sigma=worst.sigma,
        quantity=worst.quantity,
        off=worst.off,
    )
    others = [one for one in result.findings if one.code not in _FOLLOW]
    outliers = tuple(replace(one, weight=1.0) for one in robust.outliers)  # they took part
    return replace(result, outliers=outliers, findings=(said, *others))
