"""Errors that go together within a row, and those that are the same in all rows."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cramer_rao
import numpy as np
import pytest
from correlated import (
    TRACKER,
    bound,
    correlated,
    error,
    estimate,
    polar_covariance,
    scaled,
    slopes,
)
from marks import quick
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

import pincal

Array = NDArray[np.float64]


SETUP = pincal.Setup(tracker=TRACKER)


def planar(count: int = 24) -> tuple[cramer_rao.Machine, Array]:
    """Return a 3-RRR, and covariances of x, y and phi where a tracker measures its position."""
    one = cramer_rao.machine("3RRR", count)
    points = np.column_stack((one.positions, np.zeros(len(one.positions))))
    covariance = np.zeros((len(points), 3, 3))
    covariance[:, :2, :2] = polar_covariance(points, TRACKER)[:, :2, :2]
    covariance[:, 2, 2] = 1e-8
    return one, covariance


def tracked(data: pincal.Measurements) -> pincal.Measurements:
    """Return measurements that say σ of phi alone: that of x and y is the tracker's."""
    sigma = data.sigma_poses.copy()
    sigma[:, :2] = np.nan
    return replace(data, sigma_poses=sigma)


def by_scipy(one: cramer_rao.Machine, data: pincal.Measurements, covariance: Array) -> Array:
    """Return the parameters of least squares over all parameters and poses, closed forms."""
    n, dof, sigma = len(one.parameters), one.dof, data.sigma_readings
    whitener = np.linalg.inv(np.linalg.cholesky(covariance))
    start = one.nominal.platform.matrices(data.poses)
    seen = replace(
        one,
        positions=start[:, : one.positions.shape[1], 3],
        rotations=Rotation.from_matrix(start[:, :3, :3]),
    )

    def residuals(z: Array) -> Array:
        twists = z[n:].reshape(-1, dof)
        off = (seen.readings(z[:n], twists) - data.readings) / sigma
        return np.concatenate((off.ravel(), (whitener @ twists[:, :, None]).ravel()))

    first = np.concatenate((one.parameters, np.zeros(dof * len(data))))
    found = least_squares(residuals, first, x_scale="jac", xtol=1e-15, ftol=1e-15, gtol=1e-15)
    return found.x[:n]


@pytest.mark.parametrize("method", ["all-legs", "per-leg"])
def test_a_tracker_s_range_and_angles_weigh_as_covariances_do(method: str) -> None:
    """Parameters of a 3-RRR: SciPy's over all parameters and poses, by covariances of differences.

    Not those of the same standard deviations without correlations.
    """
    one, covariance = planar()
    data = correlated(one, covariance, 5e-5, 1)
    plain = pincal.calibrate(one.nominal, data, method=method)
    result = pincal.calibrate(one.nominal, tracked(data), setup=SETUP, method=method)
    values, std, *_ = cramer_rao.values_of(result)
    assert np.abs((cramer_rao.values_of(plain)[0] - values) / std).max() > 0.1
    if method == "all-legs":
        wanted = by_scipy(one, data, covariance)
        assert np.abs((values - wanted) / std).max() < 1e-2


def test_the_standard_errors_are_those_of_the_bound() -> None:
    """Covariance of the estimate: the inverse of the dense information, by differences."""
    one, covariance = planar()
    data = correlated(one, covariance, 5e-5, 0)
    truth = one.nominal.with_parameters(
        {
            leg.name: values
            for leg, values in zip(one.nominal.legs, np.split(one.parameters, 3), strict=True)
        }
    )
    exact = replace(
        tracked(data),
        poses=one.coordinates(np.zeros((len(data), 3))),
        readings=one.readings(one.parameters, np.zeros((len(data), 3))),
    )
    result = pincal.calibrate(truth, exact, setup=SETUP, loss="none")
    std = np.sqrt(np.diagonal(result.covariance))
    assert std == pytest.approx(bound(one, covariance, 5e-5), rel=1e-4)


def test_positions_of_a_stewart_platform_by_a_tracker() -> None:
    """Standard errors at the bound: range and angles are taken for what they are."""
    one = cramer_rao.machine("6UPS", 40)
    covariance = np.zeros((len(one.positions), 6, 6))
    covariance[:, :3, :3] = polar_covariance(one.positions, TRACKER)
    covariance[:, 3:, 3:] = 1e-10 * np.eye(3)
    data = correlated(one, covariance, 1e-5, 0)
    turns = np.column_stack((np.full((len(data), 3), np.nan), np.full((len(data), 3), 1e-5)))
    data = replace(data, sigma_poses=turns)
    result = pincal.calibrate(one.nominal, data, setup=pincal.Setup(tracker=TRACKER))
    values, std, *_ = cramer_rao.values_of(result)
    least = bound(one, covariance, 1e-5)
    assert std == pytest.approx(least, rel=0.02)
    off = (values - one.parameters) / least
    assert np.sqrt((off**2).mean()) < 1.5


@pytest.mark.parametrize("unknown", quick(1, [True, False]))
def test_a_scale_moves_parameters_as_far_as_is_said(unknown: bool) -> None:
    """One standard uncertainty more of the scale: so far go the parameters; weights stay."""
    one = cramer_rao.machine("3RRR", 24)
    data = cramer_rao.drawn(one, cramer_rao.NOISE, 0)
    plain = pincal.Setup(unknown_frame=unknown)
    setup = replace(plain, systematic=pincal.Systematic(scale=1e-5))

    def values(data: pincal.Measurements, setup: pincal.Setup) -> pincal.CalibrationResult:
        return pincal.calibrate(one.nominal, data, noise=cramer_rao.NOISE, setup=setup)

    before, said = values(data, plain), values(data, setup)
    ends = [
        cramer_rao.values_of(values(scaled(data, s * 1e-4), plain))[0] / (2 * s) for s in (1, -1)
    ]
    shift = sum(ends) / 10
    assert said.systematic is not None
    by = np.sqrt(np.diagonal(said.systematic))
    assert by == pytest.approx(np.abs(shift), rel=1e-2, abs=3e-3 * np.abs(shift).max())
    assert cramer_rao.values_of(said)[0] == pytest.approx(cramer_rao.values_of(before)[0])
    assert said.covariance == pytest.approx(before.covariance + np.outer(shift, shift), rel=0.02)
    assert said.reduced_chi2 == before.reduced_chi2


def test_temperature_is_a_scale_and_more_rows_do_not_help() -> None:
    """2 K of steel are 23 µm/m; with four times the rows the promise stays above that."""
    warm = pincal.Systematic(temperature=2.0)
    assert warm.relative == pytest.approx(2.3e-5)
    one = cramer_rao.machine("3RRR", 160)
    setup = pincal.Setup(systematic=warm)
    errors = []
    for rows in (slice(0, 40), slice(None)):
        data = cramer_rao.drawn(one, pincal.Noise(1e-6, 1e-6, 1e-6), 0)
        part = data.rows(np.arange(len(data))[rows])
        result = pincal.calibrate(
            one.nominal, part, noise=pincal.Noise(1e-6, 1e-6, 1e-6), setup=setup
        )
        errors.append(result.expected_error(data.poses[:40]).position)
    assert errors[1] == pytest.approx(errors[0], rel=0.05)
    assert errors[1] > 1e-6


@pytest.mark.slow
def test_the_offset_of_a_target_that_is_known_with_an_uncertainty() -> None:
    """Parameters move as when the offset is off; unknown offsets have none."""
    one = cramer_rao.machine("6UPS", 30)
    data = cramer_rao.drawn(one, cramer_rao.NOISE, 0)
    target = pincal.Systematic(target=1e-5)
    known = pincal.Setup(systematic=target)
    result = pincal.calibrate(one.nominal, data, noise=cramer_rao.NOISE, setup=known)
    shifts = []
    for axis in np.eye(3):
        ends = [
            cramer_rao.values_of(
                pincal.calibrate(
                    one.nominal,
                    data,
                    noise=cramer_rao.NOISE,
                    setup=pincal.Setup(targets={"platform": pincal.Target(tuple(s * 1e-4 * axis))}),
                )
            )[0]
            for s in (1, -1)
        ]
        shifts.append((ends[0] - ends[1]) / 20)
    wanted = np.einsum("ki,ki->i", shifts, shifts)
    assert result.systematic is not None
    assert np.diagonal(result.systematic) == pytest.approx(wanted, rel=1e-2)
    free = replace(known, targets={"platform": pincal.Target(unknown=True)})
    found = pincal.calibrate(one.nominal, data, noise=cramer_rao.NOISE, setup=free)
    assert found.systematic is None


def test_a_forecast_knows_what_more_rows_cannot_mend() -> None:
    """It equals the systematic part of a calibration at the same poses."""
    one = cramer_rao.machine("3RRR", 24)
    still = np.zeros((len(one.positions), 3))
    data = pincal.Measurements(
        poses=one.coordinates(still), readings=one.readings(one.parameters, still)
    )
    truth = one.nominal.with_parameters(
        {
            leg.name: values
            for leg, values in zip(one.nominal.legs, np.split(one.parameters, 3), strict=True)
        }
    )
    setup = pincal.Setup(systematic=pincal.Systematic(scale=1e-4, target=1e-4))
    planned = pincal.forecast(truth, data.poses, cramer_rao.NOISE, setup=setup)
    result = pincal.calibrate(truth, data, noise=cramer_rao.NOISE, setup=setup)
    least = np.sqrt(np.diagonal(result.covariance))
    assert np.sqrt(np.diagonal(planned.covariance)) == pytest.approx(least, rel=1e-5)


def test_a_setup_says_where_a_tracker_stands(tmp_path: Path) -> None:
    path = tmp_path / "setup.yaml"
    path.write_text(
        "pincal_setup: 1\n"
        "tracker: {at: [3, -2, 0.5], range: 2e-6, azimuth: 2e-5, elevation: 2e-5}\n"
        "systematic: {scale: 1e-5, temperature: 1, target: 2e-5}\n"
    )
    setup = pincal.Setup.from_yaml(path)
    assert setup.tracker == TRACKER
    assert setup.systematic == pincal.Systematic(1e-5, 1.0, target=2e-5)


def test_what_contradicts_itself_is_refused() -> None:
    """Noise said twice; range without angles."""
    one, covariance = planar(12)
    data = correlated(one, covariance, 5e-5, 0)
    cases = [
        (data, SETUP, "leave out one of them"),
        (
            tracked(data),
            pincal.Setup(tracker=pincal.Tracker(range=1e-5)),
            "how well the tracker measures the azimuth",
        ),
    ]
    for given, setup, words in cases:
        with pytest.raises(pincal.MeasurementError, match=words):
            pincal.calibrate(one.nominal, given, setup=setup)
    with pytest.raises(pincal.MeasurementError, match="expected 0 or more"):
        pincal.Systematic(scale=-1.0)


def test_a_result_keeps_them(tmp_path: Path) -> None:
    """Saved and loaded, bit for bit."""
    one, covariance = planar(12)
    data = correlated(one, covariance, 5e-5, 0)
    setup = pincal.Setup(systematic=pincal.Systematic(scale=1e-5))
    result = pincal.calibrate(one.nominal, data, setup=setup)
    result.save(tmp_path / "r")
    again = pincal.load_result(tmp_path / "r")
    assert (again.systematic == result.systematic).all()
    assert again.options.setup == setup


@pytest.mark.slow
def test_a_tracker_s_covariances_reach_the_bound() -> None:
    """Errors of a hexapod are the efficient estimate's with the same noise, to 3 % of the bound.

    Standard errors are the bound. So intervals cover, and errors 0.1 % above the bound are seen.
    """
    one = cramer_rao.machine("6UPS", 40)
    covariance = np.zeros((len(one.positions), 6, 6))
    covariance[:, :3, :3] = polar_covariance(one.positions, TRACKER)
    covariance[:, 3:, 3:] = 1e-8 * np.eye(3)
    least = bound(one, covariance, 1e-6)
    for seed in range(4):
        data = correlated(one, covariance, 1e-6, seed)
        sigma = data.sigma_poses.copy()
        sigma[:, :3] = np.nan
        result = pincal.calibrate(one.nominal, replace(data, sigma_poses=sigma), setup=SETUP)
        values, std, low, high = cramer_rao.values_of(result)
        off = values - one.parameters - error(one, data, covariance, 1e-6)
        assert (np.abs(off) < 0.03 * least).all()
        np.testing.assert_allclose(std, least, rtol=0.02)
        np.testing.assert_allclose(high - low, 2.0 * 1.96 * least, rtol=0.02)


@pytest.mark.slow
def test_limits_are_kept_when_each_instrument_has_its_own_scale() -> None:
    """Of 20,000 platforms 95 % stay below the limit; where nothing is said of the scale, few.

    They are drawn by the efficient estimate's maps of noise and scale, which the fits follow.
    Limits go with χ², which is independent of the estimate: means over six sets of each case.
    """
    one, noise = cramer_rao.machine("3RRR", 40), cramer_rao.NOISE
    poses = one.coordinates(np.zeros((len(one.positions), 3)))
    A, B = slopes(one)
    gain, sigma = np.linalg.solve(B, A), noise.of_poses(one.nominal)
    covariance = np.tile(np.diag(sigma**2), (len(poses), 1, 1))
    maps = estimate(one, covariance, noise.reading)
    n = len(one.parameters)
    root = np.column_stack(
        ((noise.reading * maps[0]).reshape(n, -1), (sigma * maps[1]).reshape(n, -1))
    )
    shift = np.einsum("pnd,nd->p", maps[1][:, :, :2], 5e-4 * poses[:, :2])
    rng = np.random.default_rng(0)
    errors = rng.standard_normal((20_000, n)) @ np.linalg.cholesky(root @ root.T).T
    errors += rng.standard_normal((20_000, 1)) * shift
    kept: dict[float, list[float]] = {0.0: [], 5e-4: []}
    for seed in range(6):
        by = 5e-4 * np.random.default_rng([seed, 1]).standard_normal()
        data = scaled(cramer_rao.drawn(one, noise, seed), by)
        for scale, shares in kept.items():
            setup = pincal.Setup(systematic=pincal.Systematic(scale=scale))
            result = pincal.calibrate(one.nominal, data, noise=noise, setup=setup)
            values, std, *_ = cramer_rao.values_of(result)
            off = values - one.parameters - error(one, data, covariance, noise.reading)
            assert (np.abs(off) < 0.05 * std).all()
            inside = result.expected_error(poses).within  # the measured region, where a limit is
            missed = np.einsum("nmp,sp->snm", gain[inside, :2], errors)
            limit = result.expected_error(poses[inside]).limit[0]
            shares.append((np.sqrt((missed**2).sum(axis=2).mean(axis=1)) <= limit).mean())
    assert 0.94 <= np.mean(kept[5e-4]) < 0.985
    assert np.mean(kept[0.0]) < 0.6


def test_a_tracker_says_nothing_of_other_noise() -> None:
    """Noise of orientations and readings is asked for, not invented."""
    one, covariance = planar(12)
    data = replace(correlated(one, covariance, 5e-5, 0), sigma_poses=None, sigma_readings=None)
    setup = pincal.Setup(tracker=TRACKER)
    with pytest.raises(pincal.MeasurementError, match="give the noise of all else"):
        pincal.calibrate(one.nominal, data, setup=setup)
    given = pincal.calibrate(
        one.nominal, data, setup=setup, noise=pincal.Noise(0.0, 1e-4, 5e-5), loss="none"
    )
    assert given.noise_source == "given"
