"""Do the measurements contradict that a parameter has one value for all legs?"""

from __future__ import annotations

import numpy as np

from pincal.calibration.confidence import confidence, exceeded
from pincal.calibration.covariance import covariances
from pincal.calibration.fits import Fits
from pincal.calibration.leg_result import TieTest
from pincal.estimation.observability.indices import RANK_TOLERANCE


def tie_tests(free: Fits) -> tuple[TieTest, ...]:
    """Return, for all ties together, the test whether they hold, by the fit without them.

    Differences that a motion of the frames makes or undoes say nothing: they are left out.
    Differences of tied parameters between legs over their covariance (Wald): χ² where the noise is
    known, an F test where its scale is estimated.
    """
    calibration = free.calibration
    mechanism = calibration.mechanism
    names = [(leg.name, name) for leg in mechanism.legs for name in leg.parameter_names]
    parameters = free.parameters(mechanism)
    values = np.concatenate([parameters[leg] for leg in mechanism.leg_names])
    covariance, _ = covariances(free)
    rows = []
    for tie in calibration.options.tied:
        places = [i for i, (_, name) in enumerate(names) if name == tie]
        rows += [np.eye(len(names))[i] - np.eye(len(names))[places[0]] for i in places[1:]]
    R = np.array(rows)
    if free.gauge is not None and free.gauge.of_legs is not None:
        directions = free.gauge.of_legs
        moved = R @ directions / np.linalg.norm(directions, axis=0)
        axes, size, _ = np.linalg.svd(moved)
        R = axes[:, int((size > RANK_TOLERANCE).sum()) :].T @ R
    if not len(R):
        return ()
    off = R @ values
    statistic = float(off @ np.linalg.solve(R @ covariance @ R.T, off)) / len(R)
    p = exceeded(statistic, len(R), confidence(free).least or np.inf)
    return (TieTest(", ".join(calibration.options.tied), len(R), statistic, p),)
