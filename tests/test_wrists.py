"""Legs that end in a frame through a wrist are those that end in a ball: closures of six rows."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import pincal
from pincal.kinematics.batches import left_null


def wristed(leg: pincal.Leg) -> pincal.Leg:
    """Return a leg of the hexapod whose ball is three hinges, which end in a frame."""
    *joints, tip = leg.joints
    up = Rotation.identity()
    for joint in joints[:2]:
        up *= Rotation.from_euler("xyz", joint.placement.rpy)
        up *= Rotation.from_rotvec(joint.home * np.array(joint.axis))
    home = up.inv().as_euler("XYZ")
    wrist = (
        pincal.Joint(f"wrist_{axis}", "revolute", axis=tuple(unit), home=float(angle))
        for axis, unit, angle in zip("xyz", np.eye(3), home, strict=True)
    )
    return replace(leg, joints=(*joints, *wrist, tip), closes="frame")


@pytest.fixture(scope="module")
def balls() -> pincal.Mechanism:
    return pincal.load_mechanism("6UPS")


@pytest.fixture(scope="module")
def wrists(balls: pincal.Mechanism) -> pincal.Mechanism:
    return replace(balls, name="wrists", legs=tuple(map(wristed, balls.legs)))


@pytest.fixture(scope="module")
def poses(balls: pincal.Mechanism) -> np.ndarray:
    drawn = np.random.default_rng(0).uniform(-1.0, 1.0, (100, 6)) * [0.2, 0.2, 0.1, 3.0, 0.2, 0.3]
    drawn[:, 4] = np.abs(drawn[:, 4])
    return drawn + balls.platform.home


@pytest.mark.parametrize(("m", "p"), [(2, 0), (2, 1), (3, 1), (3, 2), (6, 3), (6, 4), (6, 5)])
def test_null_space_follows_without_a_jump(m: int, p: int) -> None:
    """N is orthonormal, Nᵀ A = 0 and det [A N] > 0, which only a singular A can change."""
    A = np.random.default_rng(m + p).normal(size=(200, m, p))
    N = left_null(A)
    np.testing.assert_allclose(N.transpose(0, 2, 1) @ A, np.zeros((200, m - p, p)), atol=1e-12)
    unit = np.broadcast_to(np.eye(m - p), (200, m - p, m - p))
    np.testing.assert_allclose(N.transpose(0, 2, 1) @ N, unit, atol=1e-12)
    assert (np.linalg.det(np.concatenate((A, N), axis=2)) > 0.0).all()


@pytest.mark.slow
def test_readings_poses_and_margins_are_those_of_balls(
    balls: pincal.Mechanism, wrists: pincal.Mechanism, poses: np.ndarray
) -> None:
    """Kinematics both ways, and the distances from singularities with their signs."""
    wanted, found = pincal.inverse(balls, poses), pincal.inverse(wrists, poses)
    assert found.reached.all()
    np.testing.assert_allclose(found.readings, wanted.readings, atol=1e-12)
    back = pincal.forward(wrists, wanted.readings)
    assert back.converged.all()
    np.testing.assert_allclose(wrists.platform.twists_between(back.poses, poses), 0.0, atol=1e-9)
    wide = poses + np.random.default_rng(0).normal(size=poses.shape) * 0.3
    wide[:, 4] = np.abs(wide[:, 4])
    for some, share in ((poses, 1.0), (wide[:20], 0.3)):
        here, there = pincal.margins(balls, some), pincal.margins(wrists, some)
        both = ~np.isnan(here.type2) & ~np.isnan(there.type2)
        assert both.mean() >= share
        np.testing.assert_allclose(there.type1[both], here.type1[both], atol=1e-9)
        np.testing.assert_allclose(there.type2[both], here.type2[both], atol=1e-9)


@pytest.mark.parametrize("method", ["all-legs", "per-leg"])
@pytest.mark.slow
def test_parameters_come_back(
    wrists: pincal.Mechanism, poses: np.ndarray, method: str, tmp_path: Path
) -> None:
    """From clean measurements, in every way of calibrating; files hold the legs."""
    assert pincal.load_mechanism(wrists.save(tmp_path / "wrists")) == wrists
    truth = pincal.disturb(wrists, 1e-3, 1)
    data = pincal.simulate(wrists, truth, pincal.Plan(poses[:30]), pincal.Noise(0.0, 0.0, 0.0))
    noise = pincal.Noise(1e-4, 1e-4, 1e-5)
    result = pincal.calibrate(wrists, data.measurements, noise=noise, method=method)
    for leg in result.legs:
        np.testing.assert_allclose(leg.identified, truth.leg(leg.name).nominal, atol=1e-9)


@pytest.mark.slow
def test_a_wrist_turned_at_home_is_refused(wrists: pincal.Mechanism, tmp_path: Path) -> None:
    """The message tells the angle, not a length."""
    *joints, tip = wrists.legs[0].joints
    turned = replace(joints[-1], home=joints[-1].home + 0.5)
    leg = replace(wrists.legs[0], joints=(*joints[:-1], turned, tip))
    folder = replace(wrists, legs=(leg, *wrists.legs[1:])).save(tmp_path / "turned")
    with pytest.raises(pincal.MechanismError, match=r"turned by 0\.5 rad .* 'b_1'; expected 0\.1"):
        pincal.load_mechanism(folder)
