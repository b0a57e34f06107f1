"""Tolerances found with the parameters: sizes of deviations from the drawing, by unit."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from arms import loaded
from command_line import run
from numpy.typing import NDArray
from scipy.linalg import null_space
from scipy.stats import multivariate_normal

import pincal
from pincal.calibration.calibrate import prepared, started
from pincal.calibration.fits import fitted
from pincal.estimation.components import Evidence, likeliest

Array = NDArray[np.float64]
NOISE = pincal.Noise(1e-4, 1e-4, 2e-5)
SIZES = {"m": 5e-4, "rad": 2e-3, "1": 1e-3}


def drawn(
    kind: str, count: int, seed: int, sizes: dict[str, float] = SIZES
) -> tuple[pincal.Mechanism, pincal.Measurements]:
    """Return a machine that differs from its drawing by so much, and measurements of it."""
    drawing = pincal.load_mechanism(kind)
    truth = pincal.disturb(drawing, {p.id: sizes[p.unit] for p in drawing.parameters}, seed)
    poses = pincal.sample_workspace(drawing, count, seed=seed)
    return truth, pincal.simulate(kind, truth, pincal.Plan(poses), NOISE, seed=seed).measurements


def test_the_deviance_is_that_of_the_residuals_without_free_unknowns() -> None:
    """Differences of the deviance are those of dense normal densities, free unknowns projected."""
    draw = np.random.default_rng(0)
    n, k, rows = 5, 4, 30
    J, T = draw.standard_normal((rows, n)), draw.standard_normal((k, n))
    T[:, -1] = 0.0  # one unknown has no prior
    T[-1] = T[0] + T[1]  # and deviations may be dependent, as where some are tied
    T = T[:3]
    r, d = draw.standard_normal(rows), draw.standard_normal(3)
    triangle = np.linalg.qr(np.column_stack((J, r)), mode="r")
    groups = np.array([0, 1, 1])
    found = Evidence(triangle, T, d, groups)
    # z = T⁺ (deviation − d) + free part; rows − J z are noise: y = J T⁺ (u − d) + J F f + e
    back, free = np.linalg.pinv(T), null_space(T)
    contrasts = null_space((J @ free).T)
    y = contrasts.T @ (r - J @ back @ d)
    A = contrasts.T @ J @ back

    def dense(sizes: Array) -> float:
        cov = np.eye(len(y)) + (A * sizes[groups] ** 2) @ A.T
        return -2.0 * float(multivariate_normal(np.zeros(len(y)), cov).logpdf(y))

    a, b = np.array([0.3, 2.0]), np.array([1.5, 0.4])
    assert found.deviance(a) - found.deviance(b) == pytest.approx(dense(a) - dense(b), abs=1e-9)


def test_ends_are_where_the_profile_has_risen() -> None:
    """Of one group: the deviance at both ends is that at its least value plus the rise."""
    _, data = drawn("3RRR", 24, seed=1)
    calibration = started(prepared("3RRR", data, noise=NOISE, tolerance=SIZES))
    groups = {p.id: 0 for p in calibration.mechanism.parameters if p.unit == "m"}
    parts = [Evidence.of(one, groups) for one in fitted(calibration).fits]
    sizes, ends = likeliest(parts, np.array([1e-3]), (np.array([1e-9]), np.array([1.0])), 3.84)
    at = [sum(p.deviance(np.array([size])) for p in parts) for size in ends[0]]
    every = np.geomspace(*ends[0], 200)
    least = min(sum(p.deviance(np.array([size])) for p in parts) for size in every)
    np.testing.assert_allclose(at, least + 3.84 * (1.0 + 1.0 / (3 * len(groups))), atol=2e-3)
    assert ends[0, 0] < sizes[0] < ends[0, 1]


@pytest.mark.slow
def test_sizes_are_found_and_said() -> None:
    """Intervals hold the sizes drawn; the result says them, and keeps them as its options."""
    _, data = drawn("3RRR", 24, seed=2)
    result = pincal.calibrate("3RRR", data, noise=NOISE, tolerance="auto")
    said = [one for one in result.findings if one.code == "tolerance-found"]
    assert {one.values["unit"] for one in said} == {"m", "rad", "1"}
    for one in said:
        assert one.values["low"] < SIZES[one.values["unit"]] < one.values["high"]
        assert result.options.tolerance[one.values["unit"]] == one.values["size"]
    assert [one.severity for one in said] == ["info"] * 3
    again = pincal.calibrate("3RRR", data, noise=NOISE, tolerance=result.options.tolerance)
    values = [[p.identified for leg in one.legs for p in leg.parameters] for one in (result, again)]
    np.testing.assert_allclose(values[0], values[1], atol=1e-10)
    assert (np.diagonal(result.covariance) >= np.diagonal(again.covariance)).all()


@pytest.mark.slow
def test_few_poses_are_predicted_better() -> None:
    """Twelve poses at a millimetre: found tolerances predict better than free parameters."""
    poor = pincal.Noise(1e-3, 1e-3, 0.0)
    errors = []
    for seed in range(3):
        truth, data = drawn("3RRR", 12, seed)
        poses = np.random.default_rng(seed).standard_normal(data.poses.shape) * 1e-3
        data = replace(data, poses=data.poses + poses)
        goals = pincal.sample_workspace(truth, 50, seed=9)
        for tolerance in ({}, "auto"):
            result = pincal.calibrate("3RRR", data, noise=poor, tolerance=tolerance)
            wanted = pincal.inverse(result.identified, goals).readings
            reached = pincal.forward(truth, wanted).poses
            errors.append(np.nanmean(np.linalg.norm((reached - goals)[:, :2], axis=1)))
    free, found = np.reshape(errors, (3, 2)).mean(axis=0)
    assert found < 0.7 * free


@pytest.mark.slow
def test_sizes_are_found_where_noise_is_larger_than_assumed() -> None:
    """An arm of 4 mm and 4 mrad, seen within 3 mm: sizes settle, each in its interval."""
    arm = loaded("ur5")
    plan, truth = pincal.sample_configurations(arm, 30, seed=0), pincal.disturb(arm, 4e-3, seed=0)
    data = pincal.simulate(arm, truth, plan, pincal.Noise(3e-3, 3e-3, 1e-5), seed=0).measurements
    poses = np.where(np.arange(6) < 3, data.poses, np.nan)
    setup = pincal.Setup(True, {"platform": pincal.Target(unknown=True)})
    result = pincal.calibrate(arm, replace(data, poses=poses), setup=setup, tolerance="auto")
    for tolerance in result.calibration.tolerances:
        assert tolerance.values["low"] < 4e-3 < tolerance.values["high"]


def test_units_of_too_few_parameters_are_free() -> None:
    """Two gains do not say how far gains are from the drawing: no prior, and the result says so."""
    _, data = drawn("5R", 24, seed=1)
    result = pincal.calibrate("5R", data, noise=NOISE, tolerance="auto")
    assert set(result.options.tolerance) == {"m"}
    text = str(result)
    assert "from 2 gains no tolerance can be estimated" in text


@pytest.mark.slow
def test_a_machine_as_drawn_is_found_as_drawn() -> None:
    """Without deviations the lower end of their size is zero, the upper one what poses see."""
    _, data = drawn("3RRR", 24, 3, dict.fromkeys(SIZES, 0.0))
    result = pincal.calibrate("3RRR", data, noise=NOISE, tolerance="auto")
    free = pincal.calibrate("3RRR", data, noise=NOISE)
    assert [one.values["low"] for one in result.calibration.tolerances] == [0.0] * 3
    assert np.trace(result.covariance) < 0.5 * np.trace(free.covariance)


@pytest.mark.slow
def test_sizes_of_a_single_pose_lie_in_their_intervals() -> None:
    """Three equations say little of 24 parameters: no more than that."""
    _, data = drawn("3RRR", 24, seed=2)
    result = pincal.calibrate("3RRR", data.rows(np.arange(1)), noise=NOISE, tolerance="auto")
    for one in result.calibration.tolerances:
        assert one.values["low"] <= one.values["size"] <= one.values["high"]


def test_a_single_pose_is_said_to_be_few() -> None:
    """With tolerances in numbers, of which a pose corrects little; with neither, it is refused."""
    _, data = drawn("3RRR", 24, seed=2)
    pose = data.rows(np.arange(1))
    result = pincal.calibrate("3RRR", pose, noise=NOISE, tolerance={"m": 1e-3, "rad": 1e-3})
    assert "few-poses" in {one.code for one in result.findings}
    with pytest.raises(pincal.ObservabilityError, match="do not tell noise from"):
        pincal.calibrate("3RRR", pose, tolerance="auto")


def test_what_cannot_be_is_refused() -> None:
    """Another word is none."""
    _, data = drawn("5R", 24, seed=1)
    with pytest.raises(pincal.MeasurementError, match="or 'auto'"):
        pincal.calibrate("5R", data, tolerance="all")


@pytest.mark.slow
def test_the_command_finds_them(tmp_path: Path) -> None:
    """``--tolerance auto`` says sizes; the saved result has them as options."""
    _, data = drawn("3RRR", 24, seed=2)
    data.to_csv(tmp_path / "m.csv", pincal.load_mechanism("3RRR"))
    noise = ("--noise-position", 1e-4, "--noise-orientation", 1e-4, "--noise-reading", 2e-5)
    asked = ("--tolerance", "auto", *noise, "--no-report", "--folds", 0)
    outcome = run("calibrate", "3RRR", tmp_path / "m.csv", *asked, "-o", tmp_path / "r")
    assert outcome.code == 0
    assert "lengths differ from the drawing by 0." in outcome.out
    assert set(pincal.load_result(tmp_path / "r").options.tolerance) == {"m", "rad", "1"}
