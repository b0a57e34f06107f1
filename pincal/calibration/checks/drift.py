"""Residuals that rise or fall with the order of the rows."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtrc

from pincal.calibration.fits import Fits
from pincal.estimation.residuals.leg_residuals import leg_residuals
from pincal.finding import Finding
from pincal.words.sentences import finding

Array = NDArray[np.float64]
UNLIKELY = 1e-3  # probability at which fit and held-out rows part, rows drift, runs differ
_ENOUGH = 10  # rows from which a trend is asked for


def drifts(whole: Fits) -> Sequence[Finding]:
    """Return legs whose residuals rise or fall with the order of the rows."""
    found = []
    for robust in whole.fits:
        one = robust.fit
        for index, leg in enumerate(one.problem.legs):
            own = one.problem.used[:, index] & (one.weights > 0.0)
            values = leg_residuals(one.problem, one.last, index).value[own]
            if len(values) < _ENOUGH or not np.ptp(values, axis=0).all():
                continue
            correlations, chances = trends(values)
            worst = chances.argmin()
            if chances[worst] < UNLIKELY / len(one.problem.legs) / len(chances):
                found.append(
                    finding(
                        "drift",
                        leg=leg.name,
                        correlation=float(correlations[worst]),
                        p_value=float(chances[worst]),
                    )
                )
    return found


def trends(values: Array) -> tuple[Array, Array]:
    """Return Spearman's correlation of columns with the order of rows, and the chance of it.

    Args:
        values: Rows of numbers no two of which in a column are equal, (N, k), N > 2.

    Returns:
        (k,) and, by Student's distribution and from both sides, (k,).
    """
    n = len(values)
    moved = values.argsort(axis=0) - np.arange(n)[:, None]
    correlations = 1.0 - 6.0 * (moved**2).sum(axis=0) / (n * (n**2 - 1))
    with np.errstate(divide="ignore"):
        return correlations, fdtrc(1, n - 2, (n - 2) / (1.0 / correlations**2 - 1.0))
