"""Serial arms: kinematics and derivatives against Pinocchio alone, and what can be identified."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from arms import ARMS, loaded, reference, robot
from differences import assert_derivative, differentiated
from marks import quick
from measured import put
from random_mechanisms import reached

import pincal
from pincal.kinematics.closure import LegClosure
from pincal.words.findings import sentence

Array = np.ndarray
NOISE = pincal.Noise(1e-4, 1e-4, 0.0)


@pytest.mark.parametrize("name", ARMS)
def test_forward_kinematics_are_pinocchios(name: str) -> None:
    """Poses of readings equal Pinocchio's frame placements, nominal and displaced, to 1e-12."""
    mechanism, rng = loaded(name), np.random.default_rng(1)
    readings = pincal.sample_configurations(mechanism, 6, 1).readings
    leg = mechanism.legs[0]
    truth = mechanism.with_parameters({"arm": 0.02 * rng.standard_normal(len(leg.parameters))})
    for one in (mechanism, truth):
        found = pincal.forward(one, readings)
        assert found.converged.all()
        matrices = one.platform.transforms(found.poses).as_matrix()
        wanted = reference(name).poses(one.legs[0].nominal, readings)
        np.testing.assert_allclose(matrices, wanted, atol=1e-12)


def test_axes_may_be_oblique(tmp_path: Path) -> None:
    """Joints about no coordinate axis, set off and turned: poses by products of matrices."""
    text = "a|revolute|.6 0 .8|.3 .2 .1\nb|prismatic|0 .6 -.8|.35 0 .1\nc|revolute|0 .8 .6|0 .2 .4"
    file = tmp_path / "three.urdf"
    file.write_text(robot(text).replace("<origin ", '<origin rpy=".3 -.2 .5" '))
    mechanism = pincal.Mechanism.from_urdf(file, "l3")
    readings = np.random.default_rng(0).uniform(-0.5, 0.5, (5, 3))
    found = pincal.forward(mechanism, readings)
    matrices = mechanism.platform.transforms(found.poses).as_matrix()
    joints, moving = mechanism.legs[0].joints, mechanism.legs[0].moving
    for T, q in zip(matrices, readings, strict=True):
        at = dict(zip((joint.name for joint in moving), q, strict=True))
        wanted = reached(tuple(replace(j, home=at.get(j.name, 0.0)) for j in joints))
        np.testing.assert_allclose(T, wanted, atol=1e-13)


@pytest.mark.parametrize("name", quick(8, ARMS))
def test_derivatives_are_pinocchios(name: str) -> None:
    """Closure by parameters, joints and pose equals central differences through Pinocchio alone.

    c is the tip less the platform, and the rotation vector between them times the arm's size.
    """
    mechanism, rng = loaded(name), np.random.default_rng(2)
    leg, arm = mechanism.legs[0], reference(name)
    phi = 0.02 * rng.standard_normal(len(leg.parameters))
    closure = LegClosure(leg, mechanism.platform, phi)
    joints = pincal.sample_configurations(mechanism, 3, 2).readings
    platform = mechanism.platform.displaced(arm.poses(phi, joints), np.zeros((3, 6)))
    found = closure.evaluate(joints, platform)
    np.testing.assert_allclose(found.gap, 0.0, atol=1e-12 * max(1.0, closure.size))

    def gap(tips: Array, frames: Array) -> Array:
        turns = tips[:, :3, :3] @ frames[:, :3, :3].transpose(0, 2, 1)
        turned = closure.size * np.array([pin.log3(turn) for turn in turns])
        return np.concatenate((tips[:, :3, 3] - frames[:, :3, 3], turned), axis=1)

    def shifted(twist: Array) -> Array:
        moved = platform.copy()
        moved[:, :3, 3] += twist[:3]
        moved[:, :3, :3] = pin.exp3(twist[3:]) @ moved[:, :3, :3]
        return moved

    assert_derivative(found.parameter, lambda v: gap(arm.poses(phi + v, joints), platform))
    assert_derivative(found.active, lambda v: gap(arm.poses(phi, joints + v), platform))
    tips = arm.poses(phi, joints)
    assert_derivative(found.pose, lambda v: gap(tips, shifted(v)))


@pytest.mark.parametrize("name", quick(8, ARMS))
def test_rank_from_full_poses(name: str) -> None:
    """Full poses tell 4 parameters a revolute joint, 2 a prismatic one, 6 of the frames."""
    mechanism = loaded(name)
    moving = mechanism.legs[0].moving
    turns = sum(joint.kind == "revolute" for joint in moving)
    told = 4 * turns + 2 * (len(moving) - turns) + 6
    found = pincal.forecast(mechanism, pincal.sample_configurations(mechanism, 30, 0), NOISE)
    assert (found.rank.rank, found.rank.n_params) == (told, 6 * len(moving) + 6)
    assert found.gauge.shape[1] == found.rank.n_params - told
    assert not found.lost.shape[1]


XYZ = ("x", "y", "z")
THREE = {"platform": (0.02, -0.07, 0.15), "a": (0.1, 0.02, 0.03), "b": (-0.05, 0.1, 0.08)}


@pytest.mark.parametrize(
    ("targets", "unknown", "frame", "told", "of"),
    [
        (THREE, False, False, 30, 42),
        (THREE, False, True, 30, 48),  # the frame's six are those of the base
        (THREE, True, True, 33, 57),  # nine coordinates of targets for the tool's six
        ({"platform": (0.05, 0.1, 0.02)}, False, True, 27, 48),  # nothing of the tool's turns
        ({"platform": (0.2, 0.0, 0.0)}, False, False, 25, 42),  # on the last axis
        ({"platform": (0.0, 0.0, 0.0)}, False, True, 25, 48),
    ],
)
def test_rank_from_positions(
    targets: dict[str, tuple[float, float, float]], unknown: bool, frame: bool, told: int, of: int
) -> None:
    """Positions of three targets tell a UR10 as much as full poses do; one target tells less.

    Base and tool are unknown in any case: six parameters of the frame of the measurements add
    columns, but no rank. One target tells of the tool where it is, no turn: three less. If it lies
    on the last axis, an arm of five joints carries it, 4·5 + 3, and of the sixth axis is told only
    by how much it misses the target, 2.
    """
    mechanism = loaded("ur10")
    setup = pincal.Setup(
        unknown_frame=frame,
        targets={name: pincal.Target(offset, unknown) for name, offset in targets.items()},
    )
    measured = [*XYZ, *(f"{name}_{axis}" for name in list(targets)[1:] for axis in XYZ)]
    plan = pincal.sample_configurations(mechanism, 50, 0)
    found = pincal.forecast(mechanism, plan, NOISE, measured, setup=setup)
    assert (found.rank.rank, found.rank.n_params) == (told, of)


def jacobian(name: str, joints: Array, at: Array | None = None) -> Array:
    """Return ∂(pose)/∂(parameters) by central differences through Pinocchio, shape (6 N, n)."""
    arm, n = reference(name), len(loaded(name).legs[0].parameters)
    at = np.zeros(n) if at is None else at
    here = arm.poses(at, joints)

    def twists(move: Array) -> Array:
        there = arm.poses(at + move, joints)
        turns = there[:, :3, :3] @ here[:, :3, :3].transpose(0, 2, 1)
        turned = np.array([pin.log3(turn) for turn in turns])
        return np.concatenate((there[:, :3, 3] - here[:, :3, 3], turned), axis=1)

    return differentiated(twists, n).reshape(-1, n)


@pytest.mark.parametrize(("name", "redundant"), [("ur10", 12), ("panda", 14), ("tiago", 18)])
def test_what_moves_together_is_named(name: str, redundant: int) -> None:
    """Each group named is dependent, and none of it without the others; groups make up the loss.

    Judged by Jacobians of Pinocchio alone, at configurations that were not measured.
    """
    mechanism = loaded(name)
    plan = pincal.sample_configurations(mechanism, 60, 0)
    data = pincal.simulate(mechanism, mechanism, plan, NOISE, 1).measurements
    result = pincal.calibrate(mechanism, data, noise=NOISE)
    (words,) = map(sentence, result.gauge)
    assert words.startswith(f"{redundant} parameters are redundant whatever is measured: ")
    J = jacobian(name, pincal.sample_configurations(mechanism, 30, 7).readings)
    names = list(mechanism.legs[0].parameter_names)
    null = []
    for group in result.gauge[0].values["groups"]:
        own = [names.index(one.partition(".")[2]) for one in group]
        _, s, axes = np.linalg.svd(J[:, own], full_matrices=False)
        assert s[-1] < 1e-8 * s[0] < 1e-3 * s[-2]
        assert np.abs(axes[-1]).min() > 1e-6
        null.append(np.zeros(len(names)))
        null[-1][own] = axes[-1]
    assert np.linalg.matrix_rank(np.array(null)) == redundant
    assert "arm.shoulder_pan_z and arm.shoulder_lift_z move together" in words or name != "ur10"


def measured_by(name: str, phi: Array, count: int, seed: int) -> pincal.Measurements:
    """Return exact poses of a displaced arm, by Pinocchio alone."""
    mechanism = loaded(name)
    readings = pincal.sample_configurations(mechanism, count, seed).readings
    poses = mechanism.platform.from_matrices(reference(name).poses(phi, readings))
    return pincal.Measurements(poses=poses, readings=readings)


@pytest.mark.parametrize("name", quick(1, ["panda", "ur10", "tiago", "kinova"]))
def test_clean_poses_identify_the_arm(name: str) -> None:
    """Without noise, poses at held-out configurations are the truth's to 1e-9 m and rad.

    Of all parameters that fit, those found are nearest to nominal, each weighed by what it alone
    does to the pose: no step along a redundant direction brings them nearer.
    """
    mechanism, rng = loaded(name), np.random.default_rng(3)
    phi = 2e-3 * rng.standard_normal(len(mechanism.legs[0].parameters))
    data = measured_by(name, phi, 40, 0)
    result = pincal.calibrate(mechanism, data, noise=NOISE)
    assert result.converged
    held_out = measured_by(name, phi, 100, 9)
    found = pincal.forward(result.identified, held_out.readings).poses
    assert np.abs(mechanism.platform.twists_between(found, held_out.poses)).max() < 1e-9

    change = result.legs[0].identified
    J = jacobian(name, pincal.sample_configurations(mechanism, 200, 11).readings)
    J[np.arange(len(J)) % 6 > 2] *= LegClosure(mechanism.legs[0], mechanism.platform).size
    weights = np.linalg.norm(J, axis=0)
    _, s, axes = np.linalg.svd(J / weights)
    free = axes[int((s > 1e-7 * s[0]).sum()) :]
    left = weights * change
    assert np.linalg.norm(left) <= 1.02 * np.linalg.norm(left - free.T @ (free @ left))
    assert np.linalg.norm(left) < np.linalg.norm(weights * phi)


def test_order_of_rows_does_not_matter() -> None:
    """Rows in another order give the same parameters, of which redundant ones are a choice."""
    mechanism = loaded("ur10")
    phi = 2e-3 * np.random.default_rng(3).standard_normal(42)
    data = measured_by("ur10", phi, 40, 0)
    other = data.rows(np.random.default_rng(0).permutation(40))
    one, two = (
        pincal.calibrate(mechanism, d, noise=NOISE).legs[0].identified for d in (data, other)
    )
    np.testing.assert_allclose(one, two, atol=1e-12)


@pytest.mark.parametrize("frame", [False, True])
def test_clean_positions_identify_the_arm(frame: bool) -> None:
    """From one target's positions, in the base frame or a tracker's: its positions to 1e-9 m."""
    mechanism, platform = loaded("ur10"), loaded("ur10").platform
    phi = 2e-3 * np.random.default_rng(4).standard_normal(42)
    offset = (0.05, 0.1, 0.02)
    setup = pincal.Setup(unknown_frame=frame, targets={"platform": pincal.Target(offset)})
    tracker = np.eye(4)
    if frame:
        tracker[:3, :3], tracker[:3, 3] = pin.exp3(np.array([0.3, -0.5, 1.0])), [1.0, 2.0, 3.0]

    def seen(matrices: Array, place: Array) -> Array:
        points = matrices[:, :3, 3] + matrices[:, :3, :3] @ np.array(offset)
        return points @ place[:3, :3].T + place[:3, 3]

    data, held_out = (measured_by("ur10", phi, count, seed) for count, seed in ((40, 0), (100, 9)))
    data = put(
        data, "poses", np.s_[:, :3], seen(platform.transforms(data.poses).as_matrix(), tracker)
    )
    data = put(data, "poses", np.s_[:, 3:], np.nan)
    result = pincal.calibrate(mechanism, data, noise=NOISE, setup=setup)
    assert result.converged
    place = np.eye(4)
    if frame:
        values = np.array([one.identified for one in result.external])
        place[:3, :3], place[:3, 3] = pin.exp3(values[3:]), values[:3]
    found = pincal.forward(result.identified, held_out.readings).poses
    wanted = seen(platform.transforms(held_out.poses).as_matrix(), tracker)
    points = seen(platform.transforms(found).as_matrix(), place)
    np.testing.assert_allclose(points, wanted, atol=1e-9)
    texts = list(map(sentence, result.gauge))
    assert "redundant" in texts[-1]
    assert any("platform frame (3 freedoms)" in text for text in texts)


def test_a_target_on_the_last_axis() -> None:
    """It tells nothing of the last joint's zero: held and named, or refused if strict.

    Of 42 parameters only those are without an interval that move together, two groups of three.
    """
    mechanism = loaded("ur10")
    setup = pincal.Setup(targets={"platform": pincal.Target((0.2, 0.0, 0.0))})
    data = measured_by("ur10", 1e-3 * np.random.default_rng(5).standard_normal(42), 40, 0)
    matrices = mechanism.platform.transforms(data.poses).as_matrix()
    errors = NOISE.position * np.random.default_rng(0).standard_normal((40, 3))
    seen_there = data.poses[:, :3] + matrices[:, :3, 0] * 0.2 + errors
    data = put(data, "poses", np.s_[:, :3], seen_there)
    data = put(data, "poses", np.s_[:, 3:], np.nan)
    with pytest.raises(pincal.ObservabilityError, match="wrist_3"):
        pincal.calibrate(mechanism, data, noise=NOISE, setup=setup, strict=True)
    result = pincal.calibrate(mechanism, data, noise=NOISE, setup=setup)
    (held,) = (remark for remark in result.findings if remark.code == "undetermined-held")
    assert any("wrist_3" in name for group in held.values["groups"] for name in group)
    assert [len(group) for group in held.values["groups"]] == [3, 3]
    assert sum(np.isinf(parameter.std) for parameter in result.parameters) <= 10
    assert result.converged
