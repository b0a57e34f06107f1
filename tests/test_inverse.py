"""Inverse kinematics and identification Jacobian against closed forms."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from closed_forms import angles, bends, jacobian, near, poses_near_home, random_mechanism, reading

import pincal
from pincal.files.mechanism_folders import bundled
from pincal.kinematics import closing
from pincal.kinematics.closed_forms import closed_form
from pincal.kinematics.closing import close
from pincal.kinematics.closure import LegClosure, nominal_legs

GEOMETRIES = [10, pytest.param(60, marks=pytest.mark.slow)]
MARGIN = 0.1  # elbow sine


@pytest.mark.parametrize("geometries", GEOMETRIES)
@pytest.mark.parametrize("mode", [1, -1])
def test_inverse_kinematics_equals_closed_form(kind: str, mode: int, geometries: int) -> None:
    """Joint angles are within 1e-12 rad of the closed form, out of reach is NaN in both."""
    rng = np.random.default_rng(mode + 1)
    for _ in range(geometries):
        mechanism = random_mechanism(kind, rng, mode)
        poses = poses_near_home(mechanism, rng, 40)
        solution = pincal.inverse(mechanism, poses)
        for index, (leg, bend) in enumerate(zip(mechanism.legs, bends(kind, mode), strict=True)):
            shoulder, elbow = angles(kind, leg.nominal_by_name, poses, bend)
            clear = np.abs(np.sin(elbow)) >= MARGIN
            assert not solution.reached[np.isnan(elbow), index].any()
            assert solution.reached[clear, index].all()
            joints = solution.joints[leg.name]
            assert np.isnan(joints[~solution.reached[:, index]]).all()
            assert np.abs(near(joints[clear, 0], shoulder[clear])).max() < 1e-12
            assert np.abs(near(joints[clear, 1], elbow[clear])).max() < 1e-12
            expected = reading(kind, index, leg.nominal_by_name, joints[:, 0])
            np.testing.assert_allclose(solution.readings[:, index], expected, atol=1e-12)


@pytest.mark.parametrize("geometries", GEOMETRIES)
@pytest.mark.parametrize("mode", [1, -1])
def test_identification_jacobian_equals_central_differences(
    kind: str, mode: int, geometries: int
) -> None:
    """The Jacobian is within 1e-7 of central differences of the closed form, relative."""
    rng = np.random.default_rng(mode + 11)
    for _ in range(geometries):
        mechanism = random_mechanism(kind, rng, mode)
        poses = poses_near_home(mechanism, rng, 40)
        for index, (leg, bend) in enumerate(zip(mechanism.legs, bends(kind, mode), strict=True)):
            p = leg.nominal_by_name
            clear = np.abs(np.sin(angles(kind, p, poses, bend)[1])) >= MARGIN
            C = pincal.identification_jacobian(mechanism, leg.name, poses[clear])
            turn = pincal.inverse(mechanism, poses[clear]).joints[leg.name][:, 0]
            reference = jacobian(kind, index, p, poses[clear], bend, turn)
            assert np.abs(C - reference).max() < 1e-7 * np.abs(reference).max()


def test_working_mode_is_kept(mechanism: pincal.Mechanism) -> None:
    """Wherever a leg reaches, it bends to the side of its home."""
    rng = np.random.default_rng(3)
    poses = poses_near_home(mechanism, rng, 2000)
    solution = pincal.inverse(mechanism, poses)
    for index, leg in enumerate(mechanism.legs):
        elbow = solution.joints[leg.name][solution.reached[:, index], 1]
        assert len(elbow) > 100
        assert (np.sign(np.sin(elbow)) == np.sign(np.sin(leg.home[1]))).all()


def test_sampled_starts_find_what_the_closed_form_finds(
    mechanism: pincal.Mechanism, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Newton's method from sampled tips gives the same joints and the same reach."""
    rng = np.random.default_rng(4)
    poses = mechanism.platform.transforms(poses_near_home(mechanism, rng, 3000)).as_matrix()
    for leg in mechanism.legs:
        closure = LegClosure(leg, mechanism.platform)
        closed = close((closure,), poses)
        with monkeypatch.context() as patch:
            patch.setattr(closing, "closed_form", lambda _: None)
            sampled = close((closure,), poses)
        elbow = np.abs(np.sin(np.nan_to_num(closed.joints[:, 1])))
        clear = elbow > 0.02  # at the edge of reach Newton may stop a hair outside
        assert (closed.reached == sampled.reached)[clear].all()
        off = near(closed.joints, sampled.joints)[clear & closed.reached]
        assert np.abs(off).max() < 1e-12


def test_unreachable_pose_is_nan_with_a_reason(mechanism: pincal.Mechanism) -> None:
    """A pose beyond all legs gives NaN readings, and the reason names each leg."""
    far = np.array(mechanism.platform.home) + 100.0
    solution = pincal.inverse(mechanism, far[None])
    assert np.isnan(solution.readings).all()
    for leg in mechanism.leg_names:
        assert leg in solution.reason(0)
    assert pincal.inverse(mechanism, np.array([mechanism.platform.home])).reason(0) == ""


def test_chunks_do_not_change_the_answer(mechanism: pincal.Mechanism) -> None:
    """20,000 poses at once equal the same poses in pieces, bit for bit."""
    rng = np.random.default_rng(5)
    poses = poses_near_home(mechanism, rng, 20_000)
    whole = pincal.inverse(mechanism, poses).readings
    parts = [pincal.inverse(mechanism, part).readings for part in np.array_split(poses, 7)]
    np.testing.assert_array_equal(whole, np.concatenate(parts))


def test_poses_do_not_hang_on_poses_beside_them(mechanism: pincal.Mechanism) -> None:
    """Beside a pose out of reach an answer keeps its bits."""
    rng = np.random.default_rng(9)
    poses = poses_near_home(mechanism, rng, 4000)
    poses = poses[pincal.inverse(mechanism, poses).reached.all(axis=1)]
    far = poses[:1] + 10.0 * mechanism.size
    alone = pincal.inverse(mechanism, poses)
    beside = pincal.inverse(mechanism, np.concatenate((far, poses)))
    np.testing.assert_array_equal(beside.readings[len(far) :], alone.readings)
    for leg in mechanism.leg_names:
        np.testing.assert_array_equal(beside.joints[leg][len(far) :], alone.joints[leg])


@pytest.mark.parametrize("name", ["5R", "3RRR", "delta", "6RUS"])
def test_targets_on_the_axis_of_a_drive_are_out_of_reach(name: str) -> None:
    """The rod is as far from all its circle: too long or too short, as a search finds too."""
    mechanism = pincal.load_mechanism(name)
    if name == "3RRR":  # both are as long as drawn: there the drive turns as it likes
        mechanism = mechanism.with_parameters({"leg_1.L": 1.2})
    closure, home = nominal_legs(mechanism)[0], mechanism.platform.home_pose.as_matrix()
    pose = home.copy()
    pose[:, :3, 3] += closed_form(closure).centre - closure.targets(home)
    poses = mechanism.platform.from_matrices(np.concatenate((home, pose)))
    targets = closure.targets(mechanism.platform.matrices(poses))
    assert closed_form(closure).joints(targets)[1].tolist() == [True, False]
    assert pincal.inverse(mechanism, poses).reached[:, 0].tolist() == [True, False]


@pytest.mark.parametrize("name", ["3RRR", "6UPS"])
def test_a_single_transform_is_refused(name: str) -> None:
    """Poses are N of them: one without a length says so."""
    mechanism = pincal.load_mechanism(name)
    with pytest.raises(pincal.MechanismError, match="single"):
        pincal.inverse(mechanism, mechanism.platform.home_pose[0])


def test_transforms_and_coordinates_are_the_same_poses(mechanism: pincal.Mechanism) -> None:
    """Poses may be given as coordinates or as rigid transforms, and convert to and fro."""
    rng = np.random.default_rng(6)
    poses = poses_near_home(mechanism, rng, 50)
    transforms = mechanism.platform.transforms(poses)
    np.testing.assert_allclose(mechanism.platform.coordinates_of(transforms), poses, atol=1e-15)
    np.testing.assert_array_equal(
        pincal.inverse(mechanism, poses).readings, pincal.inverse(mechanism, transforms).readings
    )


@pytest.mark.parametrize("poses", [np.zeros(3), np.zeros((4, 5)), np.full((2, 3), np.nan)])
def test_wrong_poses_are_refused(poses: np.ndarray) -> None:
    """Poses of a wrong shape or not finite raise, saying what was expected."""
    with pytest.raises(pincal.MechanismError, match=r"shape|finite"):
        pincal.inverse(pincal.load_mechanism("3RRR"), poses)


def test_memory_does_not_grow_with_the_number_of_poses(mechanism: pincal.Mechanism) -> None:
    """Beyond poses and result 80,000 need no more memory than 20,000: work runs in chunks."""
    home = np.array([mechanism.platform.home])
    beyond = []
    for count in (20_000, 80_000):
        transforms = mechanism.platform.transforms(np.repeat(home, count, axis=0))
        tracemalloc.start()
        C = pincal.identification_jacobian(mechanism, "leg_1", transforms)
        matrices = 16 * C.itemsize * count
        beyond.append(tracemalloc.get_traced_memory()[1] - C.nbytes - matrices)
        tracemalloc.stop()
        del C
    assert beyond[1] < 1.1 * beyond[0]


@pytest.mark.parametrize("name", sorted(bundled()))
def test_what_is_out_of_reach_is_said(name: str) -> None:
    """Struts reach everything, a 3-RPS and six rods a surface, other legs a part."""
    mechanism = pincal.load_mechanism(name)
    size = 0.5 * max(leg.reach for leg in mechanism.legs)
    spread = [size if unit == "m" else 1.0 for unit in mechanism.platform.units]
    poses = mechanism.platform.home + np.random.default_rng(0).normal(size=(60, 6))[
        :, : len(spread)
    ] * np.array(spread)
    found = pincal.inverse(mechanism, poses).reached
    if name in ("3RPR", "6UPS", "4cable", "8cable"):  # struts reach everything
        assert found.all()
    elif name in ("3RPS", "six_rod_delta"):  # poses with fewer freedoms than coordinates
        assert not found.any()
    else:
        assert 0.02 < found.mean() < 0.98
