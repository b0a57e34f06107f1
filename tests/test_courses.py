"""What residuals follow: many tests as one, causes in common."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from cramer_rao import Machine, drawn, machine
from measured import workspace
from numpy.typing import NDArray

import pincal
from pincal.calibration.calibrate import prepared, started
from pincal.calibration.fits import fitted
from pincal.calibration.terms.kinds import every_pair
from pincal.calibration.terms.screen import Candidate, screen
from pincal.estimation.observability.courses import scores, slips
from pincal.estimation.observability.residuals import Residuals, together

Array = NDArray[np.float64]
NOISE = pincal.Noise(2e-5, 5e-5, 2e-5)


def test_what_parameters_take_up_is_not_seen() -> None:
    """Nothing is read in rounding errors: the probability is one."""
    draw = np.random.default_rng(0)
    Q = np.linalg.qr(draw.standard_normal((40, 3)))[0].reshape(20, 2, 3)
    error = draw.standard_normal((20, 2, 1))
    left = error[:, :, 0] - np.einsum("nmk,jlk,jl->nm", Q, Q, error[:, :, 0])
    residuals = Residuals(np.arange(20), left, Q, float((left**2).sum()) + 30.0, 37)
    assert residuals.amplitudes(Q @ draw.standard_normal((3, 2))).p_value == 1.0
    assert residuals.amplitudes(error).p_value < 0.1


def test_tests_together_find_nothing_once_in_a_hundred_times() -> None:
    """Independent, and all alike: 1 % of 20,000, to three errors; agreeing tests are stronger."""
    rng, weights = np.random.default_rng(0), np.full(30, 1.0 / 30.0)
    independent = rng.uniform(size=(20_000, 30))
    alike = np.repeat(rng.uniform(size=(20_000, 1)), 30, axis=1)
    for p_values in (independent, alike):
        share = np.mean([together(one, weights) < 0.01 for one in p_values])
        assert share == pytest.approx(0.01, abs=3 * np.sqrt(0.01 / 20_000))
    few = np.ones(30)
    few[:3] = 1e-3
    single = np.ones(30)
    single[0] = 1e-3
    assert together(few, weights) < 0.5 * together(single, weights)


def test_what_is_known_beforehand_is_measured_too() -> None:
    """With priors: χ² is the fit's, and terms are found as least squares of all rows find them."""
    mechanism, tolerance = pincal.load_mechanism("5R"), {"m": 2e-4, "rad": 2e-4, "1": 2e-4}
    truth = pincal.disturb(mechanism, 2e-4, seed=1)
    plan = pincal.Plan(
        mechanism.platform.home + np.random.default_rng(2).uniform(-0.3, 0.3, (9, 2))
    )
    noise = pincal.Noise(1e-4, 1e-4, 1e-4)
    data = pincal.simulate(mechanism, truth, plan, noise, 3).measurements
    result = pincal.calibrate(mechanism, data, noise=noise, tolerance=tolerance)
    (one,) = fitted(result.calibration).fits
    left, r = Residuals.of(one), one.last.residuals
    assert left.chi2 == pytest.approx(one.chi2, rel=1e-6)  # it ends near the optimum
    W = np.random.default_rng(4).standard_normal((*r.shape, 2))
    held, prior = one.unknowns.prior_rows(one.parameters)
    J = (one.last.jacobian @ one.unknowns.map).reshape(r.size, -1)
    every = np.block([[J, W.reshape(r.size, 2)], [prior, np.zeros((len(prior), 2))]])
    white = np.append(r.ravel(), held)
    step, (rest,), *_ = np.linalg.lstsq(every, -white)
    found = left.amplitudes(W)
    np.testing.assert_allclose(found.values, step[-2:], rtol=1e-6)
    assert left.chi2 - found.inside == pytest.approx(rest, rel=1e-9)
    assert left.without(W).chi2 == pytest.approx(rest, rel=1e-9)


@pytest.mark.slow
def test_few_rows_with_priors_lack_nothing() -> None:
    """Three rows of machines as exact as their tolerances say: no course is less than likely."""
    tolerance = {"m": 1e-3, "rad": 1e-3, "1": 1e-3}
    noise = pincal.Noise(1e-4, 1e-4, 5e-5)
    for name in ("5R", "3RRR", "4cable"):
        mechanism = pincal.load_mechanism(name)
        truth, plan = pincal.disturb(mechanism, 1e-3, seed=1), pincal.Plan(workspace(name, 3, 2))
        data = pincal.simulate(mechanism, truth, plan, noise, 1).measurements
        result = pincal.calibrate(mechanism, data, noise=noise, tolerance=tolerance)
        (one,) = fitted(result.calibration).fits
        tests = scores(one)
        assert min(test.p_value for test in tests) > 0.1 / len(tests)


def waves(one: Machine) -> Array:
    """Return errors of motors of two periods in a turn, each motor with its phase."""
    psi = one.readings(one.parameters, np.zeros((len(one.positions), one.dof)))
    return np.asarray(5e-4 * np.sin(2.0 * psi + np.array([0.0, 2.0, 4.0])))


def growth(one: Machine) -> Array:
    """Return readings of a machine whose links grow by 60 µm from the first row to the last."""
    still = np.zeros((len(one.positions), one.dof))
    longer = np.array([p.name in ("l", "L") for p in one.nominal.parameters]) * 6e-5
    more = one.readings(one.parameters + longer, still) - one.readings(one.parameters, still)
    return np.asarray(np.linspace(0.0, 1.0, len(still))[:, None] * more)


def screened(one: Machine, data: pincal.Measurements) -> tuple[Candidate, bool]:
    """Return the first candidate, and whether something seems to have slipped."""
    found = fitted(started(prepared(one.nominal, data, noise=NOISE)))
    first = screen(found, every_pair(one.nominal, data))[0]
    return first, bool(slips(found.fits[0]))


def test_what_all_motors_have_is_one_candidate() -> None:
    """Motors alike in kind are named together, with fewer parameters than their sines would need.

    Over a radian a sine of two periods and a curve are one; one term of all readings mends it.
    """
    one = machine("3RRR", 60)
    data = drawn(one, NOISE, 3, waves(one))
    first, _ = screened(one, data)
    assert (first.reading, first.kind.name) == ("readings", "polynomial")
    assert len(first.names) == 6
    result = pincal.calibrate(one.nominal, data, noise=NOISE)
    assert any(one.code == "model-lacks" for one in result.contradictions)
    assert pincal.calibrate(one.nominal, data, noise=NOISE, terms="polynomial").promises


def test_a_single_motor_is_named_alone() -> None:
    """One of three that is off is told from all three."""
    one = machine("3RRR", 60)
    first, _ = screened(one, drawn(one, NOISE, 3, 3.0 * waves(one) * [0.0, 1.0, 0.0]))
    assert first.reading == "leg_2"


@pytest.mark.slow
def test_a_drift_that_a_column_explains_is_none() -> None:
    """Lengths that follow a temperature look like encoders that drift; the clearer one is named."""
    one = machine("3RRR", 60)
    data = drawn(one, NOISE, 0, growth(one))
    warm = {"temperature": np.linspace(20.0, 26.0, len(data))}
    data = replace(data, influences=warm)
    first, seems = screened(one, data)
    assert first.kind.name == "temperature"
    assert first.unit == "m"
    assert seems
    found = pincal.explain(one.nominal, data, noise=NOISE, terms="L=temperature")
    assert not found.slips
    assert found.terms == ("L=temperature",)
