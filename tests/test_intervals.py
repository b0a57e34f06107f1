"""Intervals of parameters: of curved problems, and of what no residual shows."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from cramer_rao import drawn, machine
from numpy.typing import NDArray
from scipy.special import ndtri

import pincal

Array = NDArray[np.float64]
QUANTILE = float(ndtri(0.975))
#: As large as in "24 poses at 1 mm" of docs/accuracy.md: the problem is curved.
CURVED = pincal.Noise(1e-3, 1e-3, 1e-3)
SMALL = pincal.Noise(1e-5, 1e-5, 1e-5)


def of_legs(result: pincal.CalibrationResult) -> list[Any]:
    """Return the parameters of all legs."""
    return [p for leg in result.legs for p in leg.parameters]


@pytest.mark.slow
def test_intervals_of_a_curved_problem_cover() -> None:
    """24 poses of a 3-RRR at 1 mm: of single parameters 95 % hold the true value, within chance.

    Errors of one data set go together: by the spread from set to set.
    """
    one, noise, shares = machine("3RRR", 24), pincal.Noise(1e-3, 1e-3, 0.0), []
    for seed in range(16):
        data = drawn(one, noise, seed)
        result = pincal.calibrate(one.nominal, data, noise=noise, rough=True, strict=True)
        ends = [(p.low, p.high) for p in of_legs(result)]
        inside = [a <= true <= b for (a, b), true in zip(ends, one.parameters, strict=True)]
        shares.append(np.mean(inside))
    spread = np.std(shares, ddof=1) / np.sqrt(len(shares))
    assert abs(np.mean(shares) - 0.95) < 3.0 * spread


def test_what_no_residual_shows_is_added_to_intervals() -> None:
    """1 mm of noise and a scale off by 1 %: roots of sums of squares on both sides, to 1e-9."""
    one, most = machine("3RRR", 16), pincal.Systematic(scale=1e-2)
    data = drawn(one, CURVED, 0)
    free = {"leg_1.l", "leg_1.beta"}
    held = [p.id for p in one.nominal.parameters if p.id not in free]
    plain, said = (
        pincal.calibrate(one.nominal, data, noise=CURVED, setup=setup, fixed=held)
        for setup in (pincal.Setup(), pincal.Setup(systematic=most))
    )
    assert said.systematic is not None
    more = QUANTILE * np.sqrt(np.diagonal(said.systematic))
    assert (more > [p.half for p in of_legs(plain)]).any()
    for p, q, off in zip(of_legs(plain), of_legs(said), more, strict=True):
        assert q.identified - q.low == pytest.approx(np.hypot(p.identified - p.low, off), rel=1e-9)
        assert q.high - q.identified == pytest.approx(
            np.hypot(p.high - p.identified, off), rel=1e-9
        )
