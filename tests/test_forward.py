"""Forward kinematics undoes inverse kinematics, and says where it cannot."""

from __future__ import annotations

import numpy as np
import pytest
from closed_forms import random_mechanism
from machines import hexapod
from marks import quick
from measured import workspace

import pincal
from pincal import Margins, sample_workspace
from pincal.kinematics.batches import CHUNK
from pincal.workspace.criteria import in_workspace


def test_forward_undoes_inverse(
    mechanism: pincal.Mechanism, candidates: dict[str, np.ndarray]
) -> None:
    """From a guess 2 cm and 0.02 rad off, poses come back within 1e-10."""
    poses = candidates[mechanism.name][: CHUNK + 500]
    readings = pincal.inverse(mechanism, poses).readings
    guess = poses + np.random.default_rng(0).uniform(-0.02, 0.02, poses.shape)
    solution = pincal.forward(mechanism, readings, guess)
    assert solution.converged.all()
    assert np.abs(solution.poses - poses).max() < 1e-10


@pytest.mark.slow
@pytest.mark.parametrize("mode", [1, -1])
def test_forward_undoes_inverse_on_random_geometries(kind: str, mode: int) -> None:
    """The same on 200 random mechanisms in both working modes, near their homes."""
    rng = np.random.default_rng(mode + 21)
    for _ in range(200):
        mechanism = random_mechanism(kind, rng, mode)
        home = np.array(mechanism.platform.home)
        poses = home + rng.uniform(-0.1, 0.1, (10, len(home)))
        good = in_workspace(mechanism, poses, pincal.Margins(0.2, 0.2))
        readings = pincal.inverse(mechanism, poses[good]).readings
        solution = pincal.forward(mechanism, readings, poses[good] + 1e-3)
        assert solution.converged.all()
        assert np.abs(solution.poses - poses[good]).max(initial=0.0) < 1e-10


def test_readings_without_a_pose_are_nan_with_a_reason() -> None:
    """Readings that no pose closes are NaN, not a wrong pose; others are not disturbed."""
    mechanism = pincal.load_mechanism("5R")
    readings = pincal.inverse(mechanism, np.array([mechanism.platform.home])).readings
    lost = readings + np.array([[1.2, 1.2]])  # elbows too far apart to meet
    solution = pincal.forward(mechanism, np.concatenate((readings, lost)))
    assert solution.converged.tolist() == [True, False]
    assert np.isnan(solution.poses[1]).all()
    assert "closes" in solution.reasons[1]
    np.testing.assert_allclose(solution.poses[0], mechanism.platform.home, atol=1e-12)


def test_other_assembly_mode_is_not_returned() -> None:
    """From a guess in the 5R's lower assembly mode the answer is a reason, not that pose."""
    mechanism = pincal.load_mechanism("5R")
    readings = pincal.inverse(mechanism, np.array([[0.0, 1.1]])).readings
    solution = pincal.forward(mechanism, readings, np.array([[0.0, 0.05]]))
    assert not solution.converged[0]
    assert "mode" in solution.reasons[0]


@pytest.mark.parametrize("readings", [np.zeros(3), np.zeros((2, 5)), np.full((1, 3), np.inf)])
def test_wrong_readings_are_refused(readings: np.ndarray) -> None:
    """Readings of a wrong shape or not finite raise."""
    with pytest.raises(pincal.MechanismError, match=r"shape|finite"):
        pincal.forward(pincal.load_mechanism("3RRR"), readings)


def test_wrong_number_of_guesses_is_refused(mechanism: pincal.Mechanism) -> None:
    """One guess for two readings raises."""
    home = np.array([mechanism.platform.home])
    readings = pincal.inverse(mechanism, home).readings
    with pytest.raises(pincal.MechanismError, match="2 readings, but 1 guesses"):
        pincal.forward(mechanism, np.repeat(readings, 2, axis=0), home)


@pytest.mark.parametrize("name", quick(1, ["3RRR", "6UPS", "8cable"]))
def test_few_poses_are_found_as_many_are(name: str) -> None:
    """Alike legs in one call, or each alone where rows are many: the same poses and reasons."""
    mechanism = pincal.load_mechanism(name)
    poses = workspace(name, 30)
    readings = pincal.inverse(mechanism, poses).readings
    readings[::7] += 0.3  # of which some have no pose
    few = pincal.forward(mechanism, readings)
    many = pincal.forward(mechanism, np.tile(readings, (100, 1)))
    assert many.reasons[: len(poses)] == few.reasons
    for own, wanted in ((many.poses, few.poses), (many.gap, few.gap)):
        np.testing.assert_allclose(own[: len(poses)], wanted, rtol=0.0, atol=1e-12)


def test_readings_of_reachable_poses_lead_back_to_them() -> None:
    """Near singularities too, many rows or one: what home is too far from is begun elsewhere."""
    mechanism = pincal.load_mechanism("5R")
    poses = sample_workspace(mechanism, 1500, least=Margins(0.05, 0.02))
    readings = pincal.inverse(mechanism, poses).readings
    again = pincal.forward(mechanism, readings)
    assert again.converged.all()
    np.testing.assert_allclose(again.poses, poses, atol=1e-9)
    home = np.tile(mechanism.platform.home, (len(poses), 1))
    hard = np.flatnonzero(~pincal.forward(mechanism, readings, home).converged)[:5]
    assert len(hard) == 5
    for row in hard:
        alone = pincal.forward(mechanism, readings[[row]])
        np.testing.assert_allclose(alone.poses[0], poses[row], atol=1e-9)


def test_struts_far_from_home_have_a_pose() -> None:
    """Of a 6-SPS that turns all round 199 of 500 poses had none; all legs close at what is found.

    Rows are found alike alone and together.
    """
    mechanism = hexapod()
    readings = pincal.inverse(mechanism, sample_workspace(mechanism, 500, 0)).readings
    solution = pincal.forward(mechanism, readings)
    assert np.count_nonzero(solution.converged) >= 495
    poses = solution.poses[solution.converged]
    again = pincal.inverse(mechanism, poses).readings
    np.testing.assert_allclose(again, readings[solution.converged], atol=1e-9)
    assert (pincal.margins(mechanism, poses).type2 > 0.0).all()
    alone = pincal.forward(mechanism, readings[7:8]).poses
    np.testing.assert_allclose(alone, solution.poses[7:8], atol=1e-9)


def test_readings_that_contradict_each_other_have_no_pose() -> None:
    """Of eight cables one that is far too long is no pose, said; by a thousandth it is one."""
    mechanism = pincal.load_mechanism("8cable")
    readings = pincal.inverse(mechanism, np.array([mechanism.platform.home])).readings
    size = np.array([[leg.size for leg in mechanism.legs]])
    wrong, rough = readings.copy(), readings.copy()
    wrong[0, 0] += 0.5 * size[0, 0]
    rough[0, 0] += 0.001 * size[0, 0]
    solution = pincal.forward(mechanism, np.concatenate((wrong, rough)))
    assert solution.converged.tolist() == [False, True]
    assert solution.reasons[0]
    assert np.isnan(solution.poses[0]).all()
