"""The platform error to expect: one function, its numbers from calibrations and forecasts."""

from __future__ import annotations

import numpy as np
import pytest

import pincal
from pincal.calibration.promise import unnoticed
from pincal.design.platform_error import (
    PlatformError,
    Unidentified,
    platform_error,
    root_mean_squares,
    sizes,
)
from pincal.kinematics import configurations
from pincal.kinematics.configurations import legs_at
from pincal.show.misses import errors_at

NOISE = pincal.Noise(1e-4, 2e-4, 3e-5)


@pytest.fixture(scope="module")
def hexapod() -> tuple[pincal.Mechanism, np.ndarray, np.ndarray]:
    """A 6-UPS, poses of its workspace, and a covariance of its parameters."""
    mechanism = pincal.load_mechanism("6UPS")
    poses = pincal.sample_workspace(mechanism, 60, seed=0)
    return mechanism, poses, pincal.forecast(mechanism, poses[:30], NOISE).covariance


def test_errors_are_those_of_drawn_parameters(
    hexapod: tuple[pincal.Mechanism, np.ndarray, np.ndarray],
) -> None:
    """10,000 mechanisms drawn: standard errors by pose, root mean squares, and 95 of 100 below."""
    mechanism, poses, covariance = hexapod
    found = platform_error(mechanism, covariance, poses)
    gain = legs_at(mechanism, poses).gain
    rng = np.random.default_rng(1)
    drawn = rng.multivariate_normal(np.zeros(len(covariance)), covariance, 10_000, method="eigh")
    twists = np.einsum("nip,mp->nim", gain, drawn)
    np.testing.assert_allclose(found.std, twists.std(axis=2), rtol=0.04)
    square = (twists**2).mean(axis=0)
    position, orientation = square[:3].sum(axis=0), square[3:].sum(axis=0)
    assert found.position == pytest.approx(np.sqrt(position.mean()), rel=0.02)
    assert found.orientation == pytest.approx(np.sqrt(orientation.mean()), rel=0.02)
    for limit, drawn_squares in zip(found.limit, (position, orientation), strict=True):
        assert (drawn_squares <= limit**2).mean() == pytest.approx(0.95, abs=0.01)
    assert (found.position, found.orientation) == pytest.approx(root_mean_squares(found.sizes))
    np.testing.assert_allclose(found.sizes, sizes(mechanism.platform.units, found.std))


def test_noise_that_was_estimated_widens_the_limit(
    hexapod: tuple[pincal.Mechanism, np.ndarray, np.ndarray],
) -> None:
    """With five degrees of freedom by the F law, as its quantile for one direction shows."""
    mechanism, poses, covariance = hexapod
    line = covariance[:, :1]  # one direction: the mean square follows F(1, 5)
    known = platform_error(mechanism, line @ line.T, poses)
    estimated = platform_error(mechanism, line @ line.T, poses, degrees_of_freedom=5)
    assert known.position == pytest.approx(estimated.position)
    assert known.limit[0] / known.position == pytest.approx(1.960, rel=0.02)
    assert estimated.limit[0] / known.position == pytest.approx(2.571, rel=0.03)


def test_poses_out_of_reach_do_not_count() -> None:
    """Their standard errors are NaN, the means those of the others; none reached: NaN."""
    mechanism = pincal.load_mechanism("3RRR")
    poses = pincal.sample_workspace(mechanism, 30, seed=0)
    covariance = pincal.forecast(mechanism, poses, NOISE).covariance
    far = poses[:2] + np.array([50.0, 0.0, 0.0])
    found = platform_error(mechanism, covariance, np.concatenate((far, poses)))
    alone = platform_error(mechanism, covariance, poses)
    assert np.isnan(found.std[:2]).all()
    np.testing.assert_allclose(found.std[2:], alone.std, rtol=1e-9)
    assert (found.position, found.poses) == (pytest.approx(alone.position), len(poses))
    assert found.limit == pytest.approx(alone.limit)
    assert np.isnan(platform_error(mechanism, covariance, far).position)


def test_legs_are_closed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Poses are not commanded before; if none is in reach, that is refused with the reason."""
    mechanism = pincal.load_mechanism("3RRR")
    poses = pincal.sample_workspace(mechanism, 30, seed=0)
    forecast, data = pincal.forecast(mechanism, poses, NOISE), pincal.Plan(poses)
    measurements = pincal.simulate(mechanism, mechanism, data, NOISE, seed=0).measurements
    result = pincal.calibrate(mechanism, measurements, noise=NOISE)
    calls = list[int]()
    asked = configurations.command
    monkeypatch.setattr(configurations, "command", lambda *a: calls.append(1) or asked(*a))
    for error_over in (forecast.platform_error, result.expected_error):
        assert error_over(poses).poses == len(poses)
        assert not calls
        with pytest.raises(pincal.MeasurementError, match="row 1 is out of reach of leg_1"):
            error_over(poses + np.array([50.0, 0.0, 0.0]))
        calls.clear()


def test_what_is_held_counts_where_it_moves_the_platform(
    hexapod: tuple[pincal.Mechanism, np.ndarray, np.ndarray],
) -> None:
    """A direction not identified is infinite; one held within less than the errors is not."""
    mechanism, poses, covariance = hexapod
    lost = np.zeros((len(covariance), 1))
    lost[0] = 1.0
    found = platform_error(mechanism, covariance, poses, lost)
    assert found.position == np.inf
    assert not found.determined.any()
    assert np.isnan(root_mean_squares(found.sizes)[0])
    assert np.isnan(found.limit[0])
    for size, infinite in ((1e-9, False), (1.0, True)):
        held = Unidentified(size * lost, mechanism)
        found = platform_error(mechanism, covariance, poses, held)
        assert (found.position == np.inf) is infinite


@pytest.mark.parametrize(
    ("name", "setup"),
    [("3RRR", None), ("6UPS", None), ("4cable", None), ("6UPS", pincal.Setup(unknown_frame=True))],
)
def test_one_error_gives_the_numbers_of_all(name: str, setup: pincal.Setup | None) -> None:
    """Expected error and limits of a calibration: from this function alone."""
    mechanism = pincal.load_mechanism(name)
    truth = pincal.disturb(mechanism, 1e-3, seed=1)
    poses = pincal.sample_workspace(mechanism, 90, seed=0)
    data = pincal.simulate(mechanism, truth, pincal.Plan(poses[:50]), NOISE, seed=2).measurements
    result = pincal.calibrate(mechanism, data, noise=NOISE, setup=setup)
    dof = result.degrees_of_freedom if result.noise_source == "estimated" else None
    found = platform_error(
        result.identified,
        result.covariance,
        poses,
        frames=result.frames_moved,
        degrees_of_freedom=dof,
    )
    expected = result.expected_error(poses)
    within = expected.within
    assert within.any()
    inside = platform_error(
        result.identified,
        result.covariance,
        poses[within],
        frames=result.frames_moved,
        degrees_of_freedom=dof,
    )
    assert found.position == pytest.approx(expected.position, rel=1e-9)
    assert found.orientation == pytest.approx(expected.orientation, rel=1e-9)
    errors = errors_at(result, poses)
    # of angles against lengths, with frames: the radius there is that of the nominal legs
    same = 1e-9 if setup is None else 1e-4
    np.testing.assert_allclose(found.sizes, errors.expected.sizes, rtol=same)
    assert root_mean_squares(inside.sizes) == pytest.approx(errors.mean_after(), rel=same)
    wider = unnoticed(result.reduced_chi2, result.chi2_freedoms)
    limit = tuple(np.hypot(wider * np.array(inside.limit), errors.inside.hidden))
    assert limit == pytest.approx(errors.inside.limit, rel=same, abs=1e-15)


def test_held_directions_give_the_numbers_of_all() -> None:
    """Poses that never turn, the rest held: the same configurations count, with the same means."""
    mechanism = pincal.load_mechanism("3RRR")
    poses = pincal.sample_workspace(mechanism, 80, seed=0)
    noise = pincal.Noise(1e-6, 1e-6, 0.0)  # so small that nothing is curved: limits are promised
    turned_alike = poses[:12] * [1.0, 1.0, 0.0] + [0.0, 0.0, poses[0, 2]]
    data = pincal.simulate(mechanism, mechanism, pincal.Plan(turned_alike), noise).measurements
    result = pincal.calibrate(mechanism, data, noise=noise)
    assert result.undetermined_directions is not None
    held = Unidentified(result.undetermined_directions, result.nominal)
    found = platform_error(result.identified, result.covariance, poses, held, result.frames_moved)
    errors = errors_at(result, poses)
    np.testing.assert_array_equal(found.determined, errors.expected.determined)
    known = found.determined
    np.testing.assert_allclose(found.sizes[known], errors.expected.sizes[known], rtol=1e-9)
    region = poses[errors.expected.within]
    inside = platform_error(result.identified, result.covariance, region, held, result.frames_moved)
    assert root_mean_squares(inside.sizes) == pytest.approx(errors.mean_after(), rel=1e-9)
    limit = tuple(
        np.hypot(errors.expected.unnoticed * np.array(inside.limit), errors.inside.hidden)
    )
    assert limit == pytest.approx(errors.inside.limit, rel=1e-9)
    assert result.expected_error(poses).position == found.position


def test_what_is_printed(hexapod: tuple[pincal.Mechanism, np.ndarray, np.ndarray]) -> None:
    """A line, and a page with what 95 % stay below."""
    mechanism, poses, covariance = hexapod
    found = platform_error(mechanism, covariance, poses)
    assert isinstance(found, PlatformError)
    assert repr(found).startswith("PlatformError(")
    assert "\n" not in repr(found)
    assert "95 %: below" in str(found)


def test_a_limit_takes_in_what_residuals_cannot_show() -> None:
    """By χ² tables: 5 % of χ² of 100 freedoms lie below 77.93; never less than the noise given."""
    assert unnoticed(1.0, 100.0) == pytest.approx(np.sqrt(100.0 / 77.93), rel=1e-4)
    assert unnoticed(0.5, 100.0) == 1.0
    assert unnoticed(1.0, 1e6) == pytest.approx(1.0, abs=2e-3)
    assert unnoticed(np.nan, 0.0) == 1.0


def test_errors_that_look_like_noise_move_the_platform() -> None:
    """As errors of the readings that leave χ² what it may have beyond the noise: by forward alone.

    Measured poses less those of the readings have covariance P + R, R by the noise of the readings.
    """
    mechanism = pincal.load_mechanism("3RRR")
    poses = pincal.sample_workspace(mechanism, 60, seed=0)
    data = pincal.simulate(mechanism, mechanism, pincal.Plan(poses), NOISE, seed=2).measurements
    result = pincal.calibrate(mechanism, data, noise=NOISE)

    def by_readings(where: np.ndarray) -> np.ndarray:
        readings = pincal.inverse(result.identified, where).readings
        moves = [
            pincal.forward(result.identified, readings + step, where).poses - where
            for step in 1e-6 * np.eye(3)
        ]
        M = np.stack(moves, axis=2) * (NOISE.reading / 1e-6)
        return M @ M.transpose(0, 2, 1)

    R, P = by_readings(poses), np.diag(NOISE.of_poses(mechanism) ** 2)
    share = np.trace(np.linalg.solve(P + R, R), axis1=1, axis2=2).mean() / 3.0
    inside = poses[result.expected_error(poses).within]
    variances = np.diagonal(by_readings(inside), axis1=1, axis2=2).mean(axis=0) / share
    c = unnoticed(result.reduced_chi2, result.chi2_freedoms)
    expected = np.sqrt((c**2 - 1.0) * np.array([variances[:2].sum(), variances[2]]))
    error = result.expected_error(inside)
    assert c > 1.05
    assert error.hidden == pytest.approx(expected, rel=1e-3)
    assert error.limit[0] > error.hidden[0] > 0.0
