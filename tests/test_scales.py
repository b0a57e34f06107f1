"""Noise that is not given: variance components by group, found within their own spread."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from marks import some_slow
from measured import EXACT, machine

import pincal
from pincal.calibration.calibration import Calibration
from pincal.calibration.fits import fitted
from pincal.calibration.options import Options
from pincal.estimation.components import Moments
from pincal.estimation.fit import Fit

DRAWS = 12
NOISES = {
    "positions and orientations": pincal.Noise(2e-5, 5e-5, 0.0),
    "orientations better": pincal.Noise(3e-4, 2e-5, 0.0),
    "readings too": pincal.Noise(2e-5, 2e-5, 3e-4),
}


@cache
def found(case: str) -> list[pincal.CalibrationResult]:
    """Return calibrations of a 3-RRR from many draws of noise that is not given."""
    results = []
    for seed in range(DRAWS):
        mechanism, _, data = machine("3RRR", 60, NOISES[case], seed)
        results.append(pincal.calibrate(mechanism, data))
    return results


def fit_at(noise: pincal.Noise, seed: int = 0) -> Fit:
    """Return the fit of a 3-RRR at the noise that its measurements were made with."""
    mechanism, _, data = machine("3RRR", 60, noise, seed)
    (one,) = fitted(Calibration(mechanism, data, Options(noise=noise))).fits
    return one.fit


@pytest.mark.parametrize(
    "case", some_slow(NOISES, "readings too", "positions and orientations", "orientations better")
)
def test_noise_is_found_within_its_spread(case: str) -> None:
    """Medians over the draws within 15 % of what the measurements were made with, χ² at 1.

    Where readings are the noisiest by far, theirs is found; the others share what little is left.
    """
    noise, results = NOISES[case], found(case)
    for name, value in vars(noise).items():
        values = np.array([getattr(one.noise, name) for one in results])
        if noise.reading == value == 0.0:
            assert (values == 0.0).all()
        elif name == "reading" or not noise.reading:
            assert np.median(values) == pytest.approx(value, rel=0.15)
    assert all(one.noise_source == "estimated" for one in results)
    assert all(one.reduced_chi2 == pytest.approx(1.0, abs=0.02) for one in results)
    assert all("noise-estimated" in {one.code for one in r.findings} for r in results)


@pytest.mark.parametrize("seed", range(6))
def test_equal_noise_is_one_component(seed: int) -> None:
    """Groups whose noise differs by chance only share a variance, per length and radian."""
    mechanism, _, data = machine("3RRR", 60, EXACT, seed)
    size = max(leg.size for leg in mechanism.legs)
    noise = pincal.Noise(1e-4 * size, 1e-4, 0.0)
    mechanism, _, data = machine("3RRR", 60, noise, seed)
    result = pincal.calibrate(mechanism, data)
    assert result.noise is not None
    assert result.noise.position == pytest.approx(size * result.noise.orientation)
    assert result.noise.orientation == pytest.approx(1e-4, rel=0.3)


@pytest.mark.parametrize("case", NOISES)
def test_redundancies_sum_to_the_degrees_of_freedom(case: str) -> None:
    """Σ_h F_gh s_h = tr(M V_g): at the noise given, over all groups, the degrees of freedom."""
    noise = NOISES[case]
    one = fit_at(noise)
    moments = Moments.of([(one, one.problem)], noise.reading or 1e-4)
    present = np.array([True, True, noise.reading > 0.0])
    share = moments.F[np.ix_(present, present)]
    assert share.sum() == pytest.approx(one.degrees_of_freedom, rel=1e-9)
    assert moments.q[present].sum() == pytest.approx(one.chi2, rel=1e-3)


def test_moments_are_those_of_the_whole_projection() -> None:
    """F and q from M = I − J (JᵀJ)⁻¹ Jᵀ and V_g, built in full."""
    noise = NOISES["readings too"]
    one = fit_at(noise)
    moments = Moments.of([(one, one.problem)], noise.reading)
    white, T = one.last, one.unknowns.map
    J = (white.jacobian @ T).reshape(-1, T.shape[1])
    M = np.eye(len(J)) - J @ np.linalg.pinv(J)
    W = white.white.by_noise
    units = ["m", "m", "rad"]
    groups = [
        W[:, :, 3:][:, :, [unit == "m" for unit in units]],
        W[:, :, 3:][:, :, [unit == "rad" for unit in units]],
        W[:, :, :3],
    ]
    m = white.value.shape[1]
    V = []
    for part in groups:
        whole = np.zeros((len(J), len(J)))
        for pose, U in enumerate(part):
            whole[m * pose : m * pose + m, m * pose : m * pose + m] = U @ U.T
        V.append(whole)
    r = white.value.ravel()
    F = [[np.trace(M @ a @ M @ b) for b in V] for a in V]
    np.testing.assert_allclose(moments.F, F, rtol=1e-8)
    np.testing.assert_allclose(moments.q, [r @ M @ a @ M @ r for a in V], rtol=1e-8)
    np.testing.assert_allclose(sum(V), np.eye(len(J)), atol=1e-10)
