"""Noise of readings leaves no bias: conditions are those at the adjusted readings."""

from __future__ import annotations

import numpy as np
import pytest
from measured import evaluations, machine, workspace

import pincal
from pincal import Options
from pincal.calibration.calibration import Calibration
from pincal.calibration.fits import fitted
from pincal.estimation.fit import Fit
from pincal.estimation.problem import Linear
from pincal.estimation.solver import adjusted
from pincal.estimation.system import NormalEquations

NOISE = pincal.Noise(1e-4, 1e-4, 1e-3)


def distance(fit: Fit, linear: Linear) -> float:
    """Return how far conditions are from the optimum of a fit, to first order, in σ."""
    return NormalEquations.of(fit.system.triangle(linear, fit.good.astype(float))).decrement


def test_the_optimum_is_that_of_adjusted_conditions() -> None:
    """The gradient vanishes there, and does not at readings as measured; the cost is that of both.

    Readings ten times as noisy as poses, in standard errors.
    """
    mechanism, _, data = machine("6UPS", 200, NOISE)
    (one,) = fitted(Calibration(mechanism, data, Options(noise=NOISE))).fits
    fit = one
    there = adjusted(fit.last)
    assert distance(fit, there) < 1e-2
    assert distance(fit, fit.last) > 0.1
    assert there.squares.sum() == pytest.approx(fit.chi2, rel=1e-4)


@pytest.mark.parametrize("seed", [1, 101])
def test_steps_that_are_too_long_are_shortened(seed: int) -> None:
    """Readings ten times as noisy as poses, few rows: a full step would raise the cost.

    What is left is said of where the fit ended; the cost is that of full least squares by SciPy,
    62.4508 and 63.4364.
    """
    noise = pincal.Noise(1e-3, 1e-3, 1e-2)
    mechanism = pincal.load_mechanism("3RRR")
    truth = pincal.disturb(mechanism, 2e-3, seed)
    plan = pincal.Plan(pincal.sample_workspace(mechanism, 30, seed))
    data = pincal.simulate(mechanism, truth, plan, noise, seed).measurements
    options = Options(noise=noise, rough=True)
    (one,) = fitted(Calibration(mechanism, data, options)).fits
    there = adjusted(one.last)
    left = distance(one, there)
    assert one.distance == pytest.approx(left, rel=1e-6)
    assert left <= 1e-3


@pytest.mark.slow
def test_gains_are_not_too_small() -> None:
    """Of 30 legs: mean error within three of its own standard deviations, in standard errors.

    At readings as measured gains come out 0.9 standard errors too small: seen with 97 %.
    """
    noise = pincal.Noise(1e-3, 1e-3, 5e-4)
    mechanism, errors = pincal.load_mechanism("6UPS"), []
    plan = pincal.Plan(workspace("6UPS", 1200))
    for seed in range(5):
        truth = pincal.disturb(mechanism, 1e-3, seed)
        data = pincal.simulate(mechanism, truth, plan, noise, seed).measurements
        result = pincal.calibrate(mechanism, data, noise=noise)
        for leg in truth.legs:
            gain = result[f"{leg.name}.k"]
            errors.append((gain.identified - leg.nominal_by_name["k"]) / gain.std)
    assert abs(np.mean(errors)) < 3.0 / np.sqrt(len(errors))


@pytest.mark.slow
def test_many_rows_take_no_more_evaluations_than_few(monkeypatch: pytest.MonkeyPatch) -> None:
    """What rounding leaves grows with the rows; the search does not go round in it."""
    noise, taken = pincal.Noise(1e-4, 1e-4, 5e-5), []
    for count in (100, 10_000):
        evaluated = evaluations(monkeypatch)
        pincal.calibrate(*machine("6UPS", count, noise)[::2], noise=noise)
        taken.append(len(evaluated))
    assert taken[1] <= taken[0] + 3, taken
