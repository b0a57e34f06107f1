"""What a calibration adds to a view: arrows of misses."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

import pincal
from pincal.show.view.scene import Scene, calibrated, misses_of, scene

NOISE = pincal.Noise(1e-5, 1e-5)
OFF = np.array([2e-3, -1e-3])


def calibration() -> pincal.CalibrationResult:
    """Return the calibration of a 5R of which row 4 was measured off by OFF."""
    mechanism = pincal.load_mechanism("5R")
    truth = pincal.disturb(mechanism, 2e-3, seed=1)
    shift = np.random.default_rng(2).uniform(-0.3, 0.3, (30, 2))
    plan = pincal.Plan(mechanism.platform.home + shift)
    data = pincal.simulate(mechanism, truth, plan, NOISE, 3).measurements
    poses = data.poses.copy()
    poses[4] += OFF
    return pincal.calibrate(mechanism, replace(data, poses=poses), noise=NOISE, loss="huber")


@pytest.fixture(scope="module")
def result() -> pincal.CalibrationResult:
    """Calibration of a 5R with an outlier."""
    return calibration()


@pytest.fixture(scope="module")
def drawn(result: pincal.CalibrationResult) -> Scene:
    """Scene of its rows, with what was found."""
    return calibrated(scene(result.nominal, pincal.Plan(result.poses)), result)


def test_arrows_go_from_measured_to_predicted(result: pincal.CalibrationResult) -> None:
    """An arrow ends where forward kinematics predicts, to first order; the outlier's goes back."""
    measured, shifts, outlying = misses_of(result)
    data = result.measurements
    np.testing.assert_allclose(measured[:, :2], data.poses)
    predicted = pincal.forward(result.identified, data.readings, data.poses).poses
    np.testing.assert_allclose(shifts[:, :2], predicted - data.poses, atol=1e-5)
    assert outlying.tolist() == [row == 4 for row in range(30)]
    np.testing.assert_allclose(shifts[4, :2], -OFF, atol=1e-4)


def test_drawn_arrows_are_magnified(result: pincal.CalibrationResult, drawn: Scene) -> None:
    """A drawn arrow begins at the point and is the shift's length times the factor, or is cut."""
    measured, shifts, outlying = misses_of(result)
    layers = {layer.path: layer for layer in drawn.layers}
    rows = {"misses": np.flatnonzero(~outlying), "outlying": np.array([4])}
    for path, layer in layers.items():
        found = re.search(r"errors × ([\d,]+)", layer.name)
        assert found
        magnify = float(found[1].replace(",", ""))
        shafts = layer.points[: len(rows[path])]
        drawn_shifts = magnify * shifts[rows[path]]
        lengths = np.linalg.norm(drawn_shifts, axis=1)
        assert (lengths > 0.5 * drawn.size).any() == ("longer than drawn" in layer.name)
        cut = np.minimum(1.0, 0.5 * drawn.size / lengths)
        tips, begin = shafts[:, 0], shafts[:, 1]
        np.testing.assert_allclose(tips - begin, cut[:, None] * drawn_shifts, atol=1e-12)
        np.testing.assert_allclose(begin[:, :2], measured[rows[path], :2])
        assert np.ptp(layer.points[:, 0].reshape(3, -1, 3), axis=0).max() == 0.0  # heads at tips
    assert layers["outlying"].name.endswith("1 longer than drawn")


def test_page_says_what_is_drawn(result: pincal.CalibrationResult) -> None:
    """The page names the factor of the arrows and the outliers."""
    view = pincal.view(result.nominal, result.poses, identified=result.identified)
    page = view.with_result(result).html()
    for text in ("measured → predicted, errors × ", "outliers, errors × "):
        assert text in page


@pytest.mark.slow
def test_positions_alone_have_arrows_too() -> None:
    """Where no orientation was measured, arrows are the residuals of x, y and z, in base axes."""
    mechanism = pincal.load_mechanism("6UPS")
    truth = pincal.disturb(mechanism, 5e-4, seed=1)
    shift = np.random.default_rng(2).uniform(-0.1, 0.1, (60, 6))
    plan = pincal.Plan(mechanism.platform.home + shift)
    data = pincal.simulate(mechanism, truth, plan, pincal.Noise(5e-5, 5e-5), 3).measurements
    poses = data.poses.copy()
    poses[:, 3:] = np.nan
    target = pincal.Target((0.05, 0.0, 0.1), unknown=True)
    setup = pincal.Setup(unknown_frame=True, targets={"platform": target})
    noise = pincal.Noise(5e-5)
    data = replace(data, poses=poses)
    result = pincal.calibrate(mechanism, data, noise=noise, setup=setup)
    measured, shifts, _outlying = misses_of(result)
    lengths = np.linalg.norm(shifts, axis=1)
    seen = {one.name: one.residuals for one in result.observed}
    expected = np.linalg.norm([seen[axis] for axis in "xyz"], axis=0)
    np.testing.assert_allclose(lengths, expected, atol=1e-12)
    assert result.outside is not None
    F = result.outside.frame
    np.testing.assert_allclose(measured @ F[:3, :3].T + F[:3, 3], poses[:, :3], atol=1e-9)
