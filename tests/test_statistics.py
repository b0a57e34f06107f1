"""The default calibration reaches the Cramér-Rao bound, and its intervals keep their word."""

from __future__ import annotations

import os
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import numpy as np
import pytest
from cramer_rao import KINDS, machine, statistics

import pincal

#: Data sets of each machine; those of hexapods take longest, and say most each.
SETS = {"6UPS": 100, "3RRR": 200, "5R": 300}


@pytest.mark.parametrize("kind", KINDS)
def test_the_simulator_agrees(kind: str) -> None:
    """Closed-form readings are those of the mechanism's inverse kinematics, within 1e-12."""
    one = machine(kind)
    begin, values = 0, {}
    for leg in one.nominal.legs:
        values[leg.name] = one.parameters[begin : begin + len(leg.parameters)]
        begin += len(leg.parameters)
    truth = one.nominal.with_parameters(values)
    rng = np.random.default_rng(0)
    twists = 0.01 * rng.standard_normal((len(one.positions), one.dof))
    found = pincal.inverse(truth, one.coordinates(twists)).readings
    ok = np.isfinite(found).all(axis=1)
    assert ok.mean() > 0.8
    np.testing.assert_allclose(one.readings(one.parameters, twists)[ok], found[ok], atol=1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_the_bound_agrees_with_the_forecast(kind: str) -> None:
    """Dense Fisher information by differences gives the forecast's standard errors, to 1e-5."""
    one = machine(kind)
    begin, values = 0, {}
    for leg in one.nominal.legs:
        values[leg.name] = one.parameters[begin : begin + len(leg.parameters)]
        begin += len(leg.parameters)
    truth = one.nominal.with_parameters(values)
    poses = one.coordinates(np.zeros((len(one.positions), one.dof)))
    from cramer_rao import NOISE

    forecast = pincal.forecast(truth, poses, NOISE)
    np.testing.assert_allclose(forecast.std, one.bound, rtol=1e-5)


@pytest.mark.slow
def test_the_bound_is_reached() -> None:
    """Poses and readings noisy: error over the bound ≤ 1.02, coverage 95 %.

    The bound of 1.02 holds for the ratio to the efficient estimate on the same noise, whose
    standard error is below 0.003; of the plain ratio it is 0.01 to 0.02 with so many sets, so three
    of these are allowed there. Coverage is within three of its standard errors of 95 %.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("OPENBLAS_NUM_THREADS", "1")
        with ProcessPoolExecutor(min(2, os.cpu_count() or 1), get_context("spawn")) as pool:
            found = dict(zip(SETS, pool.map(statistics, SETS, SETS.values()), strict=True))
    for kind, one in found.items():
        print(kind, one)
        assert one.unconverged == 0, kind
        assert one.paired_error < 0.003, kind
        assert one.paired <= 1.02, kind
        assert one.ratio <= 1.02 + 3 * one.ratio_error, kind
        assert abs(one.promised - 1.0) < 0.02, kind
        assert abs(one.coverage - 0.95) < 3 * one.coverage_error + 0.002, kind
