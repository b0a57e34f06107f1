"""Whether few rows alone make residuals too large for the noise: a fit that leaves them out."""

from __future__ import annotations

from dataclasses import replace

from scipy.special import ndtri

from pincal.blas import on_one_thread
from pincal.calibration.assemble import assemble
from pincal.calibration.findings import QUESTIONS
from pincal.calibration.fits import fitted
from pincal.calibration.result import CalibrationResult
from pincal.errors import PincalError
from pincal.estimation.residuals.losses import FALSE_ALARM
from pincal.words.sentences import finding

#: Findings that follow from wrong rows.
_FOLLOW = frozenset(
    {
        "chi2-too-large",
        "outliers",
        "many-outliers",
        "model-lacks",
        "step",
        "reference-moved",
        "noise-in-other-proportion",
        "bad-rows",
        "curved",
    }
)


@on_one_thread
def wrong_rows(result: CalibrationResult) -> CalibrationResult:
    """Return a result that says which few rows spoil it, if without them χ² is as it should be.

    Parameters, residuals and standard errors stay those of all rows: what is left out is said by
    the user. What only follows from these rows is no longer said, what is found without them is.
    """
    if result.loss != "none" or result.excess == 1.0:
        return result
    try:
        robust = assemble(fitted(result.calibration.with_options(loss="reject")), None)
    except PincalError:
        return result
    total = len(result.measurements)
    least = -ndtri(FALSE_ALARM / (2.0 * total))  # Bonferroni: one sound set in a hundred has any
    left = [one for one in robust.outliers if one.weight == 0.0 and one.sigma > least]
    few = 0 < len(left) <= QUESTIONS.much * total
    if not (few and robust.converged and robust.excess == 1.0):
        return result
    worst = left[0]
    said = finding(
        "wrong-rows",
        [one.row for one in left],
        total=total,
        chi2=result.reduced_chi2,
        without=robust.reduced_chi2,
        sigma=worst.sigma,
        quantity=worst.quantity,
        off=worst.off,
    )
    others = [one for one in result.findings if one.code not in _FOLLOW]
    stay = [one for one in robust.findings if one.code in _FOLLOW]  # without these rows, too
    outliers = tuple(replace(one, weight=1.0) for one in left)  # they took part
    return replace(result, outliers=outliers, findings=(said, *stay, *others))
