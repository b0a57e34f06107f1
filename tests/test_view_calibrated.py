"""What a calibration adds to a view: arrows of misses, and where instruments stand."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

import pincal
from pincal.show.view.scene import Scene, calibrated, misses_of, scene, stations

NOISE = pincal.Noise(1e-5, 1e-5)
OFF = np.array([2e-3, -1e-3])


def measured_about_home(
    kind: str, error: float, noise: pincal.Noise, count: int
) -> tuple[pincal.Mechanism, pincal.Measurements]:
    """Return a mechanism, and measurements near home of a machine whose parameters are off."""
    mechanism = pincal.load_mechanism(kind)
    truth, home = pincal.disturb(mechanism, error, seed=1), mechanism.platform.home
    far = 0.1 if kind == "6UPS" else 0.3
    shift = np.random.default_rng(2).uniform(-far, far, (count, len(home)))
    plan = pincal.Plan(home + shift)
    return mechanism, pincal.simulate(mechanism, truth, plan, noise, 3).measurements


def calibration() -> pincal.CalibrationResult:
    """Return the calibration of a 5R of which row 4 was measured off by OFF."""
    mechanism, data = measured_about_home("5R", 2e-3, NOISE, 300)
    poses = data.poses.copy()
    poses[4] += OFF
    return pincal.calibrate(mechanism, replace(data, poses=poses), noise=NOISE)


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
    assert outlying.tolist() == [row == 4 for row in range(300)]
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


def test_tracker_stands_where_the_frame_says() -> None:
    """A tracker at a place of its own frame is drawn where that is in the base frame."""
    mechanism, data = measured_about_home("6UPS", 1e-4, pincal.Noise(1e-6, 1e-6), 30)
    T = RigidTransform.from_components([1.5, 0.4, -0.2], Rotation.from_rotvec([0.02, 0.01, 0.7]))
    seen = T * RigidTransform.from_matrix(mechanism.platform.matrices(data.poses))
    moved = replace(data, poses=mechanism.platform.coordinates_of(seen))
    tracker = pincal.Tracker(at=(0.1, 0.2, 0.3), range=1e-6, azimuth=1e-6, elevation=1e-6)
    setup = pincal.Setup(unknown_frame=True, tracker=tracker)
    noise = pincal.Noise(orientation=1e-6)
    result = pincal.calibrate(mechanism, moved, noise=noise, setup=setup)
    ((_name, T_base_station),) = stations(result)
    expected = T.inv().apply([0.1, 0.2, 0.3])
    np.testing.assert_allclose(T_base_station[:3, 3], expected, atol=2e-2)
    page = pincal.view(mechanism, result.poses[:2]).with_result(result).html()
    assert page.count("tracker, ") == 1


def test_page_says_what_is_drawn(result: pincal.CalibrationResult) -> None:
    """The page names the factor of the arrows and the outliers."""
    view = pincal.view(result.nominal, result.poses, identified=result.identified)
    page = view.with_result(result).html()
    for text in ("measured → predicted, errors × ", "outliers, errors × "):
        assert text in page


@pytest.mark.slow
def test_positions_alone_have_arrows_too() -> None:
    """Where no orientation was measured, arrows are the residuals of x, y and z, in base axes."""
    mechanism, data = measured_about_home("6UPS", 5e-4, pincal.Noise(5e-5, 5e-5), 60)
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


class Camera:
    """Sees the platform's origin as two tangents, from a place that is to be found."""

    name, columns = "camera", {"u": "m", "v": "m"}

    def __init__(self, at: np.ndarray) -> None:
        self.parameters = tuple(
            pincal.Parameter("camera", axis, "m", value)
            for axis, value in zip("xyz", at.tolist(), strict=True)
        )

    def evaluate(
        self, poses: np.ndarray, values: np.ndarray, measured: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the tangents of the ray less those seen; it looks up along z."""
        x, y, z = (poses[:, :3, 3] - values).T
        zero = np.zeros_like(z)
        by_point = np.stack(
            [np.stack([1 / z, zero, -x / z**2], -1), np.stack([zero, 1 / z, -y / z**2], -1)], axis=1
        )
        by_twist = np.concatenate((by_point, np.zeros_like(by_point)), axis=2)
        return np.column_stack((x / z, y / z)) - measured, by_twist, -by_point

    def stand(self, values: np.ndarray) -> np.ndarray:
        """Return T_frame_camera."""
        T = np.eye(4)
        T[:3, 3] = values
        return T


def seen_by_a_camera() -> tuple[pincal.CalibrationResult, np.ndarray]:
    """Return the calibration of a hexapod that a camera below it saw too, and where that stood."""
    mechanism, data = measured_about_home("6UPS", 1e-4, pincal.Noise(1e-5, 1e-5), 30)
    at = np.array([0.2, -0.1, -1.0])
    poses = mechanism.platform.matrices(data.poses)
    read = Camera(at).evaluate(poses, at, np.zeros((30, 2)))[0]
    noise = {"u": np.full(30, 1e-6), "v": np.full(30, 1e-6)}
    both = replace(
        data,
        sigma_poses=np.full((30, 6), 1e-5),
        extra={"u": read[:, 0], "v": read[:, 1]},
        sigma_extra=noise,
    )
    setup = pincal.Setup(instruments=(Camera(at + 0.05),))
    return pincal.calibrate(mechanism, both, setup=setup), at


@pytest.mark.slow
def test_a_camera_stands_where_it_was_found() -> None:
    """An instrument that says where it stands is drawn there."""
    result, at = seen_by_a_camera()
    ((_name, T_base_station),) = stations(result)
    np.testing.assert_allclose(T_base_station[:3, 3], at, atol=1e-3)
    view = pincal.view(result.nominal, result.poses[:2]).with_result(result)
    assert "camera, 1.02 m from the base frame" in view.html()


@pytest.mark.slow
def test_frame_of_the_measurements_is_where_it_was_found() -> None:
    """Where it was unknown, as of a camera's poses, it is drawn; an odd place is refused."""
    mechanism, data = measured_about_home("5R", 1e-3, NOISE, 30)
    moved = replace(data, poses=data.poses + np.array([0.3, -0.2]))
    result = pincal.calibrate(mechanism, moved, noise=NOISE, setup=pincal.Setup(unknown_frame=True))
    ((name, T_base_station),) = stations(result)
    np.testing.assert_allclose(T_base_station[:3, 3], [-0.3, 0.2, 0.0], atol=0.1)
    assert name == "frame of the measurements"
    assert not stations(calibration())
    found, _ = seen_by_a_camera()
    camera = found.options.setup.instruments[0]
    camera.stand = lambda _: None  # type: ignore[attr-defined]  # the platform holds it
    assert not stations(found)
    for standing in (np.ones((4, 4)), np.ones(3)):
        camera.stand = lambda _, T=standing: T  # type: ignore[attr-defined,misc]
        with pytest.raises(pincal.MeasurementError, match="instrument 'camera' stands at"):
            stations(found)
