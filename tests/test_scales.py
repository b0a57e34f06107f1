"""Noise that is not given: variance components by group, found within their own spread."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import product

import cramer_rao
import numpy as np
import pytest
from marks import some_slow
from measured import machine

import pincal
from pincal import Options
from pincal.calibration.calibration import Calibration
from pincal.calibration.fits import fitted
from pincal.estimation.components import Assumptions, Moments
from pincal.estimation.fit import Fit

DRAWS = 12
NOISES = {
    "positions and orientations": pincal.Noise(2e-5, 5e-5, 0.0),
    "orientations better": pincal.Noise(3e-4, 2e-5, 0.0),
    "readings too": pincal.Noise(1e-4, 2e-5, 1e-4),
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
    return one


@pytest.mark.parametrize(
    "case", some_slow(NOISES, "readings too", "positions and orientations", "orientations better")
)
def test_noise_is_found_within_its_spread(case: str) -> None:
    """Medians over the draws within 15 % of what the measurements were made with, χ² at 1.

    Where readings are noisy too, theirs is found; the others share what little is left.
    Exact ones are found exact in half of the draws, as chance has it: in 2 of 12 at least (0.3 %).
    """
    noise, results = NOISES[case], found(case)
    for name in ("position", "orientation", "reading"):
        value = getattr(noise, name)
        values = np.array([getattr(one.noise, name) for one in results])
        if noise.reading == value == 0.0:
            assert (values == 0.0).sum() >= 2
        elif name == "reading" or not noise.reading:
            assert np.median(values) == pytest.approx(value, rel=0.15)
    assert all(one.noise_source == "estimated" for one in results)
    assert all(one.reduced_chi2 == pytest.approx(1.0, abs=0.02) for one in results)
    assert all("noise-estimated" in {one.code for one in r.findings} for r in results)


def test_what_is_assumed_counts_where_residuals_say_little() -> None:
    """Of no information the assumed proportion is left, of much the unconstrained solution."""
    noise = NOISES["readings too"]
    one = fit_at(noise)
    moments = Moments.of([one], noise.reading)
    sizes, units = pincal.Noise(1.0, 2.0, 3.0, pixel=0.0), pincal.Noise(1.0, 1.0, 1.0)
    before = Assumptions(units, exact=True).information(sizes, moments.scale)
    little = replace(moments, F=1e-9 * moments.F, q=1e-9 * moments.q).variances(before)
    assert little[0] == pytest.approx(4.0 * little[1], rel=1e-6)
    assert little[2] == pytest.approx(0.0, abs=1e-6)
    alike = Assumptions(units, exact=False).information(sizes, moments.scale)
    little = replace(moments, F=1e-9 * moments.F, q=1e-9 * moments.q).variances(alike)
    assert little[0] == pytest.approx(9.0 * little[2], rel=1e-6)
    own = np.array([1.0, 2.0, 3.0])
    much = replace(moments, F=1e9 * moments.F, q=1e9 * moments.F @ own).variances(before)
    np.testing.assert_allclose(much, own, rtol=1e-6)


def test_no_variance_is_below_zero() -> None:
    """Moments that would have one negative leave it at zero, and the others to the rest of them."""
    noise = NOISES["readings too"]
    one = fit_at(noise)
    moments = Moments.of([one], noise.reading)
    units = pincal.Noise(1.0, 1.0, 1.0, pixel=0.0)
    before = Assumptions(units, exact=True).information(units, moments.scale)
    for negative in range(3):
        own = np.where(np.arange(3) == negative, -1.0, 1.0)
        great = replace(moments, F=1e9 * moments.F, q=1e9 * moments.F @ own)
        found = great.variances(before)
        assert (found >= 0.0).all()
        assert (found == 0.0).any()


def test_covariances_lack_what_kenward_and_roger_say() -> None:
    """2 J⁺ (Σ_gh cov(s)_gh V_g M V_h) J⁺ᵀ, M = I − J J⁺, built in full."""
    noise = NOISES["readings too"]
    one = fit_at(noise)
    moments = Moments.of([one], noise.reading)
    J = (one.last.jacobian @ one.unknowns.map).reshape(-1, one.unknowns.map.shape[1])
    back, V, C = np.linalg.pinv(J), whole_parts(one), np.diag([1.0, 2.0, 3.0]) + 0.5
    M, T = np.eye(len(J)) - J @ back, one.unknowns.map
    part = sum(C[g, h] * V[g] @ M @ V[h] for g, h in product(range(3), range(3)))
    wanted = 2.0 * T @ back @ part @ back.T @ T.T
    (found,) = moments.widenings(C)
    np.testing.assert_allclose(found, wanted, atol=1e-8 * np.abs(wanted).max())
    assert (np.linalg.eigvalsh(found) > -1e-9 * np.abs(found).max()).all()


@pytest.mark.slow
def test_intervals_hold_where_noise_is_estimated() -> None:
    """60 sets of a 3-RRR at 30 poses: coverage within three of its standard errors of 95 %."""
    one, within = cramer_rao.machine("3RRR", 30), []
    for seed in range(60):
        result = pincal.calibrate(one.nominal, cramer_rao.drawn(one, cramer_rao.NOISE, seed))
        _, _, low, high = cramer_rao.values_of(result)
        within.append(((low <= one.parameters) & (one.parameters <= high)).mean())
    error = np.std(within) / np.sqrt(len(within))
    assert np.mean(within) == pytest.approx(0.95, abs=3 * error + 0.005)


def whole_parts(one: Fit) -> list[np.ndarray]:
    """Return V_g of all rows of a 3-RRR, built in full, each of shape (n_rows, n_rows)."""
    W, units = one.last.white.by_noise, ["m", "m", "rad"]
    groups = [
        W[:, :, 3:][:, :, [unit == "m" for unit in units]],
        W[:, :, 3:][:, :, [unit == "rad" for unit in units]],
        W[:, :, :3],
    ]
    count, m = one.last.residuals.shape
    V = []
    for part in groups:
        whole = np.zeros((count * m, count * m))
        for pose, U in enumerate(part):
            whole[m * pose : m * pose + m, m * pose : m * pose + m] = U @ U.T
        V.append(whole)
    return V


@pytest.mark.parametrize("case", NOISES)
def test_redundancies_sum_to_the_degrees_of_freedom(case: str) -> None:
    """Σ_h F_gh s_h = tr(M V_g): at the noise given, over all groups, the degrees of freedom."""
    noise = NOISES[case]
    one = fit_at(noise)
    moments = Moments.of([one], noise.reading or 1e-4)
    present = np.array([True, True, noise.reading > 0.0])
    share = moments.F[np.ix_(present, present)]
    assert share.sum() == pytest.approx(one.degrees_of_freedom, rel=1e-9)
    assert moments.q[present].sum() == pytest.approx(one.chi2, rel=1e-3)


def test_moments_are_those_of_the_whole_projection() -> None:
    """F and q from M = I − J (JᵀJ)⁻¹ Jᵀ and V_g, built in full."""
    noise = NOISES["readings too"]
    one = fit_at(noise)
    moments = Moments.of([one], noise.reading)
    white, T = one.last, one.unknowns.map
    J = (white.jacobian @ T).reshape(-1, T.shape[1])
    M, V = np.eye(len(J)) - J @ np.linalg.pinv(J), whole_parts(one)
    r = white.residuals.ravel()
    F = [[np.trace(M @ a @ M @ b) for b in V] for a in V]
    np.testing.assert_allclose(moments.F, F, rtol=1e-8)
    np.testing.assert_allclose(moments.q, [r @ M @ a @ M @ r for a in V], rtol=1e-8)
    np.testing.assert_allclose(sum(V), np.eye(len(J)), atol=1e-10)
