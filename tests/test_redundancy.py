"""What a fit leaves of residuals: leverages of the dense hat matrix, variances of many draws."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.linalg import block_diag

import pincal
from pincal.calibration.fits import fitted
from pincal.estimation.fit import Fit
from pincal.estimation.observability.residuals import leg_residuals, remaining_variances
from pincal.show.misses import noisy_residuals

EXACT, NOISY = pincal.Noise(1e-4, 1e-4), pincal.Noise(1e-4, 1e-4, 1e-4)
#: Noise, and how it is calibrated.
CASES: dict[str, tuple[pincal.Noise, dict[str, Any]]] = {
    "exact readings": (EXACT, {}),
    "noisy readings": (NOISY, {}),
    "per-leg": (NOISY, {"method": "per-leg"}),
    "priors": (NOISY, {"tolerance": {"m": 1e-4, "rad": 1e-3}}),
}


def measured(noise: pincal.Noise, seed: int) -> tuple[pincal.Mechanism, pincal.Measurements]:
    """Return a five-bar and measurements of it at fourteen poses, always the same ones."""
    mechanism = pincal.load_mechanism("5R")
    truth = pincal.disturb(mechanism, 1e-3, seed=1)
    shift = np.random.default_rng(2).uniform(-0.3, 0.3, (14, 2))
    plan = pincal.Plan(mechanism.platform.home + shift)
    return mechanism, pincal.simulate(mechanism, truth, plan, noise, seed).measurements


def dense_covariance(fit: Fit, follows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the covariance of residuals c e, pose by pose, from all conditions as one problem.

    Σ − M (Mᵀ Σ⁻¹ M)⁻¹ Mᵀ of M = [A T, B], every pose an unknown; exact readings nearly so.
    """
    linear, T = fit.last, fit.unknowns.map
    A = np.concatenate(list(linear.by_parameter)) @ T
    M = np.column_stack((A, block_diag(*linear.by_pose))) if fit.problem.latent else A
    most = np.abs(linear.noise_root).max()
    noise = [S @ S.T + (1e-4 * most) ** 2 * np.eye(len(S)) for S in linear.noise_root]
    sigma = block_diag(*noise)
    weight = np.linalg.inv(sigma)
    _, prior = fit.unknowns.prior_rows(fit.unknowns.start)
    normal = M.T @ weight @ M
    n = T.shape[1]
    normal[:n, :n] += prior.T @ prior
    P = np.eye(len(M)) - M @ np.linalg.solve(normal, M.T @ weight)
    covariance = P @ sigma @ P.T
    if len(prior):
        gain = M @ np.linalg.solve(normal, np.eye(M.shape[1])[:, :n] @ prior.T)
        covariance += gain @ gain.T
    C = block_diag(*follows)
    return C @ covariance @ C.T


@pytest.mark.parametrize("case", CASES)
def test_what_is_left_is_that_of_the_dense_hat_matrix(case: str) -> None:
    """Variances of residuals of legs and of the platform, poses unknown or as measured."""
    noise, options = CASES[case]
    mechanism, data = measured(noise, 3)
    result = pincal.calibrate(mechanism, data, noise=noise, **options)
    for one in fitted(result.calibration).fits:
        fit = one
        rows = fit.last.conditions.shape[1]
        every = [leg_residuals(fit.problem, fit.last, i) for i in range(len(fit.problem.legs))]
        legs = np.concatenate([leg.follows for leg in every], axis=1)
        identity = np.broadcast_to(np.eye(rows), (len(data), rows, rows))
        follows = np.concatenate((legs, identity), axis=1)
        left, dense = remaining_variances(fit, follows), dense_covariance(fit, follows)
        own = np.diagonal(dense).reshape(left.shape)
        np.testing.assert_allclose(left, own, rtol=1e-3, atol=1e-6 * own.max())


@pytest.mark.slow
@pytest.mark.parametrize("case", ["exact readings", "noisy readings", "per-leg"])
def test_standardised_residuals_have_unit_variance(case: str) -> None:
    """Over 30 data sets mean squares are 1; over the noise far below."""
    noise, options = CASES[case]
    standard, over_noise = [], []
    for seed in range(30):
        mechanism, data = measured(noise, seed)
        result = pincal.calibrate(mechanism, data, noise=noise, **options)
        series = noisy_residuals(result)
        standard.append(np.concatenate([one.standardised for one in series]))
        over_noise.append(np.concatenate([one.residuals / one.sigma for one in series]))
    known = np.isfinite(standard[0])
    assert known.mean() > 0.9
    squares = np.square(standard)[:, known].mean(axis=1)
    assert squares.mean() == pytest.approx(1.0, abs=4.0 * squares.std() / np.sqrt(30))
    assert np.square(over_noise).mean() < 0.75


def test_redundancy_is_the_share_that_shows() -> None:
    """The share of an error of a reading that its own residual shows is its redundancy."""
    noise, options = CASES["noisy readings"]
    mechanism, data = measured(noise, 3)
    before = pincal.calibrate(mechanism, data, noise=noise, **options)
    readings = data.readings.copy()
    row, error = 4, 3e-4
    readings[row, 0] += error
    after = pincal.calibrate(mechanism, replace(data, readings=readings), noise=noise, **options)
    moved = after.legs[0].residuals[row] - before.legs[0].residuals[row]
    share = before.legs[0].redundancy
    assert share is not None
    assert moved == pytest.approx(-share[row] * error, rel=0.05)


def test_two_readings_of_one_equation_share_what_it_misses() -> None:
    """A leg whose motor slides on a rail, both read: residuals of each, standardised alike."""
    plain = pincal.load_mechanism("3RRR")

    def railed(leg: pincal.Leg) -> pincal.Leg:
        first, *others = leg.joints
        rail = pincal.Joint(
            f"rail_{leg.name}", "prismatic", axis=(1.0, 0.0, 0.0), lower=-0.5, upper=0.5
        )
        drive = replace(first, name=f"drive_{leg.name}")
        own = replace(leg.sensors[0], joint=drive.name), pincal.Sensor(rail.name)
        return replace(leg, joints=(rail, drive, *others), sensors=own)

    mechanism = replace(plain, legs=tuple(map(railed, plain.legs)))
    rng = np.random.default_rng(0)
    poses = plain.platform.home + rng.uniform(-0.2, 0.2, (20, 3))
    straight = pincal.simulate(plain, plain, pincal.Plan(poses), pincal.Noise(), 0).measurements
    readings = np.zeros((20, 6))
    readings[:, ::2] = straight.readings
    noise = pincal.Noise(1e-4, 1e-4, 1e-4)
    readings += 1e-4 * rng.standard_normal(readings.shape)
    data = pincal.Measurements(straight.poses, readings=readings)
    result = pincal.calibrate(mechanism, data, noise=noise)
    for leg in result.legs:
        assert leg.redundancy is not None
        assert leg.redundancy.shape == leg.residuals.shape == (40,)
        assert 0.0 < leg.redundancy.min() < leg.redundancy.max() < 1.0
        # both follow one equation: they are the same number but for how it follows each reading
        np.testing.assert_allclose(
            (leg.residuals**2 / leg.redundancy)[::2], (leg.residuals**2 / leg.redundancy)[1::2]
        )
