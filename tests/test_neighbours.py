"""Trees with loops: URDF with robot.yaml, MJCF, out, in, and back into the user's own URDF."""

from __future__ import annotations

import re
from dataclasses import replace
from io import BytesIO
from pathlib import Path

import lazy_loader
import numpy as np
import pinocchio as pin
import pytest
import yourdfpy
from command_line import done, run
from neighbours import (
    ARM,
    FIVE_BAR,
    FIVE_BAR_YAML,
    LIMIT,
    MJCF,
    ankle,
    five_bar,
    five_bar_angles,
    hexapod,
    hexapod_points,
    joint,
    urdf,
    written,
)
from scipy.spatial.transform import Rotation

import pincal
from pincal import Leg
from pincal.formats.arm import serial_arm
from pincal.formats.closed import closed_mechanism
from pincal.formats.mjcf import mjcf, read_mjcf, unwritten
from pincal.formats.users_urdf import calibrated_urdf, read_loops
from pincal.kinematics.assembly import assembled, independent
from pincal.kinematics.batches import cross
from pincal.kinematics.closed_forms import closed_form
from pincal.kinematics.closure import LegClosure
from pincal.kinematics.derivatives import nearest_closure
from pincal.model.placement import Coordinate

FAMILIES = ("5R", "3RRR", "6UPS", "3RPS", "linear_delta", "4cable")


def read(file: Path, platform: str | None = None) -> pincal.Mechanism:
    """Return the mechanism of a URDF with robot.yaml beside it, or of an MJCF file."""
    beside = file.with_name("robot.yaml")
    tree = read_mjcf(file) if file.suffix == ".xml" else read_loops(file, beside)
    return closed_mechanism(tree, platform)[0]


def exported(mechanism: pincal.Mechanism, folder: Path) -> Path:
    """Write a mechanism as MJCF."""
    (folder / "robot.xml").write_text(mjcf(mechanism))
    return folder / "robot.xml"


def some_joints(mechanism: pincal.Mechanism, count: int) -> tuple[np.ndarray, list[np.ndarray]]:
    """Return poses that all legs reach, as matrices, and the joints of each leg there."""
    if not mechanism.by_readings:
        rng = np.random.default_rng(0)
        home = np.tile(mechanism.platform.home, (count, 1))
        poses = mechanism.platform.moved(home, rng.normal(0, 0.05, home.shape))
        solution = pincal.inverse(mechanism, poses)
        assert solution.reached.all()
        joints = [solution.joints[leg.name] for leg in mechanism.legs]
        return mechanism.platform.transforms(poses).as_matrix(), joints
    rng = np.random.default_rng(0)
    home = pincal.inverse(mechanism, np.array([mechanism.platform.home])).readings
    found = pincal.forward(mechanism, home + rng.uniform(-0.08, 0.08, (count, home.shape[1])))
    assert found.converged.all()
    solution = pincal.inverse(mechanism, found.poses)
    joints = [solution.joints[leg.name] for leg in mechanism.legs]
    return mechanism.platform.transforms(found.poses).as_matrix(), joints


@pytest.mark.parametrize("name", FAMILIES)
def test_what_is_written_is_read(name: str, tmp_path: Path) -> None:
    """A mechanism, out and in again, has the same platform, legs, home and joint positions."""
    mechanism = pincal.load_mechanism(name)
    again = read(exported(mechanism, tmp_path))
    assert again.platform.kind == mechanism.platform.kind
    assert again.leg_names == mechanism.leg_names
    np.testing.assert_allclose(again.platform.home, mechanism.platform.home, atol=1e-11)
    poses, joints = some_joints(mechanism, 40)
    for one, other, expected in zip(again.legs, mechanism.legs, joints, strict=True):
        assert one.closes == other.closes
        assert one.active == other.active
        closure = LegClosure(one, again.platform).evaluate(expected, poses)
        assert np.abs(closure.gap).max() < 1e-11
    if not mechanism.by_readings:
        solution = pincal.inverse(again, again.platform.from_matrices(poses))
        for leg, expected in zip(again.legs, joints, strict=True):
            np.testing.assert_allclose(solution.joints[leg.name], expected, atol=1e-11)


def configured(
    model: pin.Model, mechanism: pincal.Mechanism, pose: np.ndarray, joints: list[np.ndarray]
) -> np.ndarray:
    """Return Pinocchio's configuration of a mechanism that was written as MJCF."""
    values: dict[str, np.ndarray] = {}
    for leg, q in zip(mechanism.legs, joints, strict=True):
        values |= {f"{leg.name}_{one.name}": v for one, v in zip(leg.moving, q, strict=True)}
    values |= {f"platform_p{axis}": pose[i, 3] for i, axis in enumerate("xyz")}
    turns = Rotation.from_matrix(pose[:3, :3]).as_euler("XYZ")
    values |= {f"platform_{axis}": turn for axis, turn in zip("xyz", turns, strict=True)}
    q = pin.neutral(model)
    for name in list(model.names)[1:]:
        entry = model.joints[model.getJointId(name)]
        value = np.atleast_1d(values[name])
        if entry.nq == 2:
            value = np.array([np.cos(value[0]), np.sin(value[0])])
        q[entry.idx_q : entry.idx_q + entry.nq] = value
    return q


@pytest.mark.parametrize("name", FAMILIES)
def test_pinocchio_closes_the_loops_where_pincal_does(name: str, tmp_path: Path) -> None:
    """At poses of pincal's the constraints of Pinocchio's own MJCF parser hold to 1e-9 m.

    Off by 1 mm or mrad in one joint they do not.
    """
    mechanism = pincal.load_mechanism(name)
    file = exported(mechanism, tmp_path)
    model, points, frames = pin.buildModelAndConstraintsFromMJCF(str(file))
    assert (len(points), len(frames)) == (len(mechanism.legs), 0)
    data = model.createData()
    poses, joints = some_joints(mechanism, 8)

    def widest(q: np.ndarray) -> float:
        pin.forwardKinematics(model, data, q)
        return max(
            float(
                np.linalg.norm(
                    data.oMi[one.joint1_id].act(one.joint1_placement).translation
                    - data.oMi[one.joint2_id].act(one.joint2_placement).translation
                )
            )
            for one in points
        )

    for row, pose in enumerate(poses):
        assert widest(configured(model, mechanism, pose, [q[row] for q in joints])) < 1e-9
        off = [q[row] + 1e-3 * (leg == 0) for leg, q in enumerate(joints)]
        assert widest(configured(model, mechanism, pose, off)) > 1e-5


@pytest.mark.parametrize("name", FAMILIES)
def test_mujoco_loads_what_is_written(name: str, tmp_path: Path) -> None:
    """In MuJoCo the keyframe closes the loops, and each drive has an actuator."""
    mujoco = pytest.importorskip("mujoco")
    mechanism = pincal.load_mechanism(name)
    model = mujoco.MjModel.from_xml_path(str(exported(mechanism, tmp_path)))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    assert model.nu == len(mechanism.reading_names)
    assert model.neq == len(mechanism.legs)
    assert np.abs(data.efc_pos[: data.ne]).max() < 1e-9


def sites_at(file: Path, q: np.ndarray) -> np.ndarray:
    """Return the site 'end' of the chain in an MJCF file, shape (N, 4, 4), by pincal.

    Args:
        file: The file.
        q: Joint positions from where the file draws them, shape (N, n_joints).
    """
    tree = read_mjcf(file)
    carrying = {edge.child: edge for edge in tree.edges}
    link, joints = "c", []
    while link in carrying:
        joints.insert(0, carrying[link].joint)
        link = carrying[link].parent
    moving = [one.name for one in joints if one.kind != "fixed"]
    leg = Leg("leg", tuple(joints), (pincal.Sensor(moving[0]),), (), pincal.Joint("b", "fixed"))
    site = np.eye(4)
    site[:3, 3] = (0.1, 0.2, 0.3)
    site[:3, :3] = Rotation.from_quat([2, 3, 4, 1]).as_matrix()
    return leg.link_placements(q)[:, -1] @ site


def bounded(text: str) -> str:
    """Return the model with limits for its last joints, which a leg needs of slides only."""
    return text.replace('name="c1"', 'name="c1" range="-170 170"')


def test_mjcf_is_understood_as_mujoco_does(tmp_path: Path) -> None:
    """Poses, classes, frames, units, several joints a body and references: as in MuJoCo."""
    mujoco = pytest.importorskip("mujoco")
    file = tmp_path / "robot.xml"
    file.write_text(bounded(MJCF))
    model = mujoco.MjModel.from_xml_path(str(file))
    data = mujoco.MjData(model)
    q = np.random.default_rng(0).uniform(-0.4, 0.4, (20, model.nq))
    own = sites_at(file, q - model.qpos0)
    for row, expected in zip(q, own, strict=True):
        data.qpos[:] = row
        mujoco.mj_forward(model, data)
        np.testing.assert_allclose(data.site_xpos[0], expected[:3, 3], atol=1e-12)
        np.testing.assert_allclose(data.site_xmat[0].reshape(3, 3), expected[:3, :3], atol=1e-12)
    limits = {e.joint.name: (e.joint.lower, e.joint.upper) for e in read_mjcf(file).edges}
    assert limits["a1"] == pytest.approx((-np.pi / 2, np.pi / 2))
    assert limits["b1"] == pytest.approx((-0.5, 0.3))  # counted from where it is drawn


LOOPED = """\
<mujoco model="looped">
  <compiler angle="radian"/>
  <worldbody>
    <body name="base">
      <body name="a1" pos="-0.1 0 0"><joint name="m1"/>
        <body name="a2" pos="-0.1 0.2 0"><joint name="f1"/><site name="sa" pos="0.2 0.2 0"/></body>
      </body>
      <body name="b1" pos="0.1 0 0"><joint name="m2"/>
        <body name="b2" pos="0.1 0.2 0"><joint name="f2"/><site name="sb" pos="-0.2 0.2 0"/></body>
      </body>
    </body>
  </worldbody>
  <equality>EQUALITY</equality>
  <actuator><motor joint="m1"/><position joint="m2"/></actuator>
</mujoco>
"""


@pytest.mark.parametrize(
    "equality",
    [
        '<connect site1="sa" site2="sb"/>',
        '<connect body1="a2" body2="b2" anchor="0.2 0.2 0"/>',
        '<connect body1="b2" body2="a2" anchor="-0.2 0.2 0" solref="0.01 1"/>',
    ],
)
def test_mjcf_loops_by_sites_and_bodies(equality: str, tmp_path: Path) -> None:
    """A five-bar in MJCF is that of the closed form; anchors are where MuJoCo has them."""
    file = tmp_path / "robot.xml"
    file.write_text(LOOPED.replace("EQUALITY", equality))
    mechanism = read(file)
    points = np.random.default_rng(0).uniform((-0.1, 0.3), (0.1, 0.45), (30, 2))
    readings = pincal.inverse(mechanism, points).readings
    np.testing.assert_allclose(readings, five_bar_angles(points), atol=1e-12)


def test_readings_of_loops_count_from_where_the_file_draws_them(tmp_path: Path) -> None:
    """A reference of a joint is what MuJoCo reads where it is drawn: pincal's readings are zero."""
    file = tmp_path / "robot.xml"
    text = LOOPED.replace("EQUALITY", CONNECT).replace('name="m1"', 'name="m1" ref="0.7"')
    file.write_text(text.replace('name="f2"', 'name="f2" ref="-0.2"'))
    mechanism = read(file)
    points = np.random.default_rng(0).uniform((-0.1, 0.3), (0.1, 0.45), (30, 2))
    readings = pincal.inverse(mechanism, points).readings
    np.testing.assert_allclose(readings, five_bar_angles(points), atol=1e-12)


def test_mjcf_without_mujoco_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where the extra is absent, the message is the command that installs it."""
    (tmp_path / "robot.xml").write_text(LOOPED.replace("EQUALITY", CONNECT))
    monkeypatch.setattr("pincal.formats.mjcf.mujoco", lazy_loader.load("no_such_package"))
    outcome = run("import", tmp_path / "robot.xml", "-o", tmp_path / "out")
    assert "python -m pip install 'pincal[mujoco]'" in outcome.trouble


def test_welds_are_where_pinocchio_has_them(tmp_path: Path) -> None:
    """Relpose of a weld is the pose of the second body in the first."""
    text = LOOPED.replace("EQUALITY", '<weld body1="a2" body2="b2" relpose="1 2 3 1 2 3 4"/>')
    file = tmp_path / "robot.xml"
    file.write_text(
        text.replace("<joint", '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/><joint')
    )
    (weld,) = pin.buildModelAndConstraintsFromMJCF(str(file))[2]
    (loop,) = read_mjcf(file).loops
    first, second = loop.joint.placement.origin(), loop.at_child.origin()
    own = np.linalg.inv(second) @ np.linalg.inv(first)
    theirs = weld.joint2_placement.homogeneous @ np.linalg.inv(weld.joint1_placement.homogeneous)
    np.testing.assert_allclose(np.linalg.inv(own), first, atol=1e-12)
    np.testing.assert_allclose(np.linalg.inv(theirs), first, atol=1e-12)


def test_a_five_bar_is_the_closed_form(tmp_path: Path) -> None:
    """Two drives, a loop closed by a point: the platform is that point, and the angles right."""
    mechanism = read(five_bar(tmp_path))
    assert mechanism.platform.kind == "point"
    np.testing.assert_allclose(mechanism.platform.home, (0.0, 0.4), atol=1e-12)
    points = np.random.default_rng(0).uniform((-0.1, 0.3), (0.1, 0.45), (50, 2))
    readings = pincal.inverse(mechanism, points).readings
    np.testing.assert_allclose(readings, five_bar_angles(points), atol=1e-12)
    assert [len(leg.parameters) for leg in mechanism.legs] == [5, 5]


def test_limbs_beside_the_platform_are_left_out(tmp_path: Path) -> None:
    """A second five-bar on the same base, as a second leg of a humanoid, changes nothing."""
    twin = [re.sub(r'(name|link)="(?!base")', r'\1="right_', one) for one in FIVE_BAR]
    right = "['right_closedloop1_A', 'right_closedloop1_B']"
    yaml = FIVE_BAR_YAML.replace("']]", f"'], {right}]").replace("['3d']", "['3d', '3d']")
    yaml = yaml.replace("'mot1', 'mot2'", "'mot1', 'mot2', 'right_mot1', 'right_mot2'")
    file = written(tmp_path, urdf("both", [*FIVE_BAR, *twin], "base"), yaml)
    assert "--platform" in run("import", file, "-o", tmp_path / "both").trouble
    outcome = done("import", file, "--platform", "b2", "-o", tmp_path / "both")
    assert "right_mot1" in outcome.err
    assert "in no loop with the platform, left out (driven)" in outcome.err
    (tmp_path / "left").mkdir()
    left = written(tmp_path / "left", urdf("left", FIVE_BAR, "base"), FIVE_BAR_YAML)
    alone, both = read(left, "b2"), pincal.load_mechanism(tmp_path / "both")
    readings = np.random.default_rng(0).uniform(-0.1, 0.1, (20, 2))
    poses = [pincal.forward(mechanism, readings).poses for mechanism in (alone, both)]
    np.testing.assert_allclose(*poses, atol=1e-12)


def test_a_base_may_stand_on_a_joint(tmp_path: Path) -> None:
    """On a turntable the five-bar is the same, from the link that is named as its base."""
    joints = [joint("yaw", "world", "base", "0.3 0 0.1", rpy="0 0 1"), *FIVE_BAR]
    file = written(tmp_path, urdf("fivebar", joints, "world"), FIVE_BAR_YAML)
    assert "--base" in run("import", file, "-o", tmp_path / "bar").trouble
    outcome = done("import", file, "--base", "base", "-o", tmp_path / "bar")
    assert "yaw: in no loop with the platform, left out" in outcome.err
    points = np.random.default_rng(0).uniform((-0.1, 0.3), (0.1, 0.45), (20, 2))
    readings = pincal.inverse(pincal.load_mechanism(tmp_path / "bar"), points).readings
    np.testing.assert_allclose(readings, five_bar_angles(points), atol=1e-12)


def test_frames_that_meet_are_one_body(tmp_path: Path) -> None:
    """Closed as a whole frame ('6d') behind one more joint, the five-bar is the same."""
    joints = [*FIVE_BAR[:5], joint("free3", "b2", "cb", "-0.2 0.2 0")]
    yaml = FIVE_BAR_YAML.replace("3d", "6d").replace("closedloop1_B", "cb")
    mechanism = read(written(tmp_path, urdf("fivebar", joints, "base"), yaml))
    points = np.random.default_rng(0).uniform((-0.1, 0.3), (0.1, 0.45), (50, 2))
    readings = pincal.inverse(mechanism, points).readings
    np.testing.assert_allclose(readings, five_bar_angles(points), atol=1e-12)


def test_a_plane_may_lie_anywhere(tmp_path: Path) -> None:
    """Drawn in the x-z plane, axes along y, links turned: readings are the same, which is said."""
    lie = "1.5707963267948966 0 0"
    first = [one.replace('rpy="0 0 0"', f'rpy="{lie}"', 1) for one in FIVE_BAR]
    joints = [first[0], FIVE_BAR[1], first[2], *FIVE_BAR[3:]]
    file = written(tmp_path, urdf("fivebar", joints, "base"), FIVE_BAR_YAML)
    mechanism, remarks = closed_mechanism(read_loops(file, file.with_name("robot.yaml")))
    assert any("turned" in one for one in remarks)
    points = np.random.default_rng(0).uniform((-0.1, 0.3), (0.1, 0.45), (20, 2))
    home = np.array(mechanism.platform.home)
    np.testing.assert_allclose(home, (0.0, -0.4), atol=1e-12)  # across +y: y is drawn -z
    readings = pincal.inverse(mechanism, points * (1, -1)).readings
    np.testing.assert_allclose(readings, five_bar_angles(points), atol=1e-12)


def test_a_hexapod_carried_by_its_first_leg(tmp_path: Path) -> None:
    """Readings are the legs' lengths less 0.8 m, and the platform's frame is its link's.

    U and S are joints by joint_type, five points are closed, motors meant by part of their names.
    """
    mechanism = read(hexapod(tmp_path))
    assert [leg.closes for leg in mechanism.legs] == ["point"] * 6
    assert [leg.sensors[0].joint for leg in mechanism.legs] == [f"leg{i}_mot" for i in range(6)]
    base, top = hexapod_points()
    poses = np.column_stack(
        (
            np.random.default_rng(1).normal(mechanism.platform.home[:3], 0.05, (30, 3)),
            np.random.default_rng(2).uniform((-3, 0, -0.2), (3, 0.2, 0.2), (30, 3)),
        )
    )
    matrices = mechanism.platform.transforms(poses).as_matrix()
    points = matrices[:, None, :3, 3] + np.einsum("nij,kj->nki", matrices[:, :3, :3], top)
    lengths = np.linalg.norm(points - base, axis=2)
    solution = pincal.inverse(mechanism, poses)
    np.testing.assert_allclose(solution.readings, lengths - 0.8, atol=1e-11)
    for leg, length in zip(mechanism.legs, lengths.T, strict=True):  # slides count from 0.8 m
        closure = LegClosure(leg, mechanism.platform)
        form = closed_form(closure)
        assert form is not None
        assert form.frame is None
        reach = form.reach()
        np.testing.assert_array_equal(reach.holds(matrices), (length > 0.5) & (length < 1.6))
    none = closure.evaluate(np.empty((0, 3)), np.empty((0, 4, 4)))
    assert none.gap.shape == (0, 3)


def test_readings_beside_a_gimbal_lock_close_legs_in_their_mode(tmp_path: Path) -> None:
    """Exact readings of a hexapod with errors close all legs at their poses, without a start.

    A way from home flipped universal joints where legs pass over their axes: the other mode closes
    a nominal leg as well, but one with errors up to 2 mm off (32 of 2,400).
    """
    mechanism = read(hexapod(tmp_path))
    truth = pincal.disturb(mechanism, 1e-3, 0)
    poses = pincal.sample_workspace(mechanism, 400, 3)
    solution = pincal.inverse(truth, poses)
    assert solution.reached.all()
    matrices = truth.platform.transforms(poses).as_matrix()
    for leg, readings in zip(truth.legs, solution.readings.T, strict=True):
        closure = LegClosure(leg, truth.platform)
        nearest, _ = nearest_closure((closure,), matrices, readings[:, None])
        np.testing.assert_allclose(nearest.gap, 0.0, atol=1e-12)


def test_a_way_from_home_may_end_in_another_mode(tmp_path: Path) -> None:
    """A hexapod with universal joints of 1 mm goes wherever the one with crossing axes goes.

    Upside down its legs have passed over the axes, where a straight way from home flips them.
    """
    plain = read(hexapod(tmp_path))
    offset = plain.with_parameters({name: {"u_y_z": 1e-3} for name in plain.leg_names})
    rng = np.random.default_rng(3)
    poses = np.column_stack(
        (rng.normal(plain.platform.home[:3], 0.2, (200, 3)), rng.uniform(-np.pi, np.pi, (200, 3)))
    )
    solution = pincal.inverse(plain, poses)
    inside = [np.cos(solution.joints[leg.name][:, 1]) > 0.4 for leg in plain.legs]
    reached = solution.reached & np.stack(inside, axis=1)
    assert reached.sum() > 500
    assert pincal.inverse(offset, poses).reached[reached].all()


def struts(folder: Path) -> Path:
    """Write a hexapod as MuJoCo's users draw it: struts with a ball at either end, one slide."""
    pairs = list(zip(*hexapod_points(), strict=True))
    text = lambda v: " ".join(map(repr, map(float, v)))  # noqa: E731
    geom, top, legs, loops, drives = '<geom size="0.01"/>', "", "", "", ""
    for i, (A, B) in enumerate(pairs):
        rod = B + np.array([0.0, 0.0, 1.0]) - A
        top += f'<site name="p{i}" pos="{text(B)}"/>'
        legs += (
            f'<body pos="{text(A)}" zaxis="{text(rod)}"><joint name="ball{i}" type="ball"/>{geom}'
            f'<body pos="0 0 {float(np.linalg.norm(rod))!r}"><joint name="slide{i}" type="slide" '
            f'range="-0.4 0.4"/>{geom}<site name="e{i}"/></body></body>'
        )
        loops += f'<connect site1="e{i}" site2="p{i}"/>'
        drives += f'<motor joint="slide{i}"/>'
    platform = f'<body name="top" pos="0 0 1"><freejoint/>{geom}{top}</body>'
    (folder / "robot.xml").write_text(
        f'<mujoco><compiler autolimits="true"/><worldbody>{platform}{legs}</worldbody>'
        f"<equality>{loops}</equality><actuator>{drives}</actuator></mujoco>"
    )
    return folder / "robot.xml"


def test_a_strut_may_spin_about_itself(tmp_path: Path) -> None:
    """A ball at either end of a strut: its spin demands nothing, is held and said; lengths do."""
    pytest.importorskip("mujoco")
    outcome = done("import", struts(tmp_path), "-o", tmp_path / "hexapod")
    assert outcome.err.count("moves no end of it: held") == 6
    mechanism = pincal.load_mechanism(tmp_path / "hexapod")
    base, top = hexapod_points()
    home = np.tile(mechanism.platform.home, (20, 1))
    twists = np.random.default_rng(0).normal(0.0, 0.05, home.shape)
    poses = mechanism.platform.moved(home, twists)
    T = mechanism.platform.transforms(poses).as_matrix()
    points = T[:, None, :3, 3] + np.einsum("nij,kj->nki", T[:, :3, :3], top)
    drawn = np.linalg.norm(top + np.array([0.0, 0.0, 1.0]) - base, axis=1)
    readings = np.linalg.norm(points - base, axis=2) - drawn
    np.testing.assert_allclose(pincal.inverse(mechanism, poses).readings, readings, atol=1e-11)


def test_the_base_of_the_legs_may_be_carried_by_a_drive(tmp_path: Path) -> None:
    """On a turntable that is driven, seen from it: legs and readings as of one that stands still.

    The way back over the turntable's joint and the platform's own freedom is no leg.
    """
    pytest.importorskip("mujoco")
    file = struts(tmp_path)
    still = file.read_text()
    done("import", file, "-o", tmp_path / "still")
    turned = '</body><body name="table"><joint name="yaw"/><geom size="0.01"/><body pos', 1
    turned = still.replace("</body><body pos", *turned).replace(
        "</worldbody>", "</body></worldbody>"
    )
    file.write_text(turned.replace("<actuator>", '<actuator><motor joint="yaw"/>'))
    done("import", file, "--base", "table", "-o", tmp_path / "carried")
    pair = [pincal.load_mechanism(tmp_path / name) for name in ("still", "carried")]
    assert pair[0].leg_names == pair[1].leg_names
    poses = np.tile(pair[0].platform.home, (5, 1))
    poses = pair[0].platform.moved(poses, np.random.default_rng(0).normal(0.0, 0.05, poses.shape))
    readings = [pincal.inverse(mechanism, poses).readings for mechanism in pair]
    np.testing.assert_allclose(*readings, atol=1e-11)


def test_a_leg_may_be_cut_anywhere(tmp_path: Path) -> None:
    """A planar 3-RRR cut at platform, elbow, and whole: the same readings as each leg's dyad."""
    feet = np.array([[-0.5, -0.3], [0.5, -0.3], [0.0, 0.6]])
    ends = np.array([[0.0, 0.0], [0.1, 0.0], [0.05, 0.08]])
    knees = np.array([[-0.5, 0.2], [0.6, 0.2], [0.5, 0.6]])
    text = lambda v: f"{float(v[0])!r} {float(v[1])!r} 0"  # noqa: E731
    joints = [
        joint("mot_a", "base", "a1", text(feet[0])),
        joint("elbow_a", "a1", "a2", text(knees[0] - feet[0])),
        joint("wrist_a", "a2", "top", text(ends[0] - knees[0])),
        joint("mot_b", "base", "b1", text(feet[1])),
        joint("knee_b", "b1", "b1_end", text(knees[1] - feet[1]), "fixed"),
        joint("wrist_b", "top", "b2", text(ends[1])),  # hangs on the platform
        joint("half_b", "b2", "b2_end", text(knees[1] - ends[1]), "fixed"),
        joint("mot_c", "base", "c1", text(feet[2])),
        joint("elbow_c", "c1", "c2", text(knees[2] - feet[2])),
        joint("end_c", "c2", "c2_end", text(ends[2] - knees[2]), "fixed"),
        joint("point_c", "top", "c_point", text(ends[2]), "fixed"),
    ]
    yaml = "closed_loop: [[knee_b, half_b], [point_c, end_c]]\ntype: [3d, 3d]\nname_mot: [mot]\n"
    mechanism = read(written(tmp_path, urdf("rrr", joints, "base"), yaml))
    assert mechanism.platform.kind == "planar"
    rng = np.random.default_rng(0)
    poses = rng.normal(0, 0.05, (30, 3))
    turned = np.exp(1j * poses[:, 2, None]) * (ends @ (1, 1j))
    points = (poses[:, 0] + 1j * poses[:, 1])[:, None] + turned
    solution = pincal.inverse(mechanism, poses)
    assert solution.reached.all()
    for leg, (foot, knee, end) in enumerate(zip(feet, knees, ends, strict=True)):
        first, second = (knee - foot) @ (1, 1j), (end - knee) @ (1, 1j)
        reach = points[:, leg] - foot @ (1, 1j)
        a, b = abs(first), abs(second)
        bend = np.arccos((np.abs(reach) ** 2 - a**2 - b**2) / (2 * a * b))
        side = np.sign((np.conj(first) * second).imag)
        link = np.angle(reach) - np.angle(a + b * np.exp(1j * side * bend)) - np.angle(first)
        np.testing.assert_allclose(solution.readings[:, leg], link, atol=1e-12)


def test_parameters_are_all_that_closures_tell(tmp_path: Path) -> None:
    """As many as the rank of all displacements of the leg, at other configurations; complete.

    Of a U-P-S leg eight: base and platform point, the slide's zero, and the offset of the two axes.
    """
    mechanism = read(hexapod(tmp_path))
    leg = mechanism.legs[2]
    assert len(leg.parameters) == 8
    every = replace_all_displacements(leg)
    closure = LegClosure(every, mechanism.platform)
    rng = np.random.default_rng(5)
    joints = rng.uniform(-0.3, 0.6, (200, 3))
    R = Rotation.random(200, rng=rng).as_matrix()
    matrices = np.tile(np.eye(4), (200, 1, 1))
    matrices[:, :3, :3] = R
    matrices[:, :3, 3] = closure.tips(joints) - closure.targets(matrices)
    part = closure.evaluate(joints, matrices)
    across = cross(part.passive[:, :, 0], part.passive[:, :, 1])
    rows = np.einsum("ni,nip->np", across, part.parameter)
    assert rows.shape[1] == 3 * 6 + 6 + 3
    assert np.linalg.matrix_rank(rows, tol=1e-9 * np.linalg.norm(rows)) == 8


def test_loops_drawn_open_close_where_joints_still_move_them() -> None:
    """A strut is not taken at length zero, though that is nearest to how it is drawn."""
    along, ends = (1.0, 0.0, 0.0), {"lower": -1.0, "upper": 1.0}
    slide = pincal.Joint("x", "prismatic", axis=along, home=0.1, **ends)
    turn = pincal.Joint("turn", "revolute")
    length = pincal.Joint("length", "prismatic", axis=along, home=-0.1, **ends)
    driven = pincal.Leg("driven", (slide,), (pincal.Sensor("x"),), (), pincal.Joint("a", "fixed"))
    strut = pincal.Leg("strut", (turn, length), (), (), pincal.Joint("b", "fixed"))
    closed, placed = assembled((driven, strut), pincal.Platform.at_origin("point"))
    x, (angle, reach) = closed[0].home[0], closed[1].home
    np.testing.assert_allclose(placed.home, (x, 0.0), atol=1e-9)
    np.testing.assert_allclose(reach * np.array([np.cos(angle), np.sin(angle)]), (x, 0), atol=1e-9)
    assert abs(reach) > 0.01


@pytest.mark.parametrize(("name", "count"), [("5R", 4), ("3RRR", 6), ("6UPS", 6), ("delta", 7)])
def test_sensors_apart_the_parameters_of_our_legs_are_independent(name: str, count: int) -> None:
    """Base point, links and platform point, if the platform turns as it does; in any order."""
    mechanism = pincal.load_mechanism(name)
    leg = mechanism.legs[0]
    names = leg.parameter_names
    assert independent(leg, mechanism.platform, names) == names[:count]
    backwards = independent(leg, mechanism.platform, names[::-1])
    assert sorted(backwards) == sorted(names[:count])


def replace_all_displacements(leg: Leg) -> Leg:
    """Return a leg with six displacements at each joint and the tip, three at the point."""
    parameters: list[tuple[str, float]] = []

    def displaced(one: pincal.Joint, axes: tuple[str, ...]) -> pincal.Joint:
        names = [f"{one.name}_{axis}" for axis in axes]
        parameters.extend((name, 0.0) for name in names)
        steps = [Coordinate(axis, (name,)) for axis, name in zip(axes, names, strict=True)]
        steps += [Coordinate(a, (v,)) for a, v in zip("xyz", one.placement.xyz, strict=True) if v]
        placement = pincal.Placement(tuple(steps), one.placement.xyz, one.placement.rpy)
        return replace(one, placement=placement)

    six = ("x", "y", "z", "rx", "ry", "rz")
    joints = tuple(
        displaced(one, six) if one.kind != "fixed" or one is leg.joints[-1] else one
        for one in leg.joints
    )
    point = displaced(leg.point, six[:3])
    return replace(leg, joints=joints, point=point, parameters=tuple(parameters))


def test_a_file_says_where_home_is(tmp_path: Path) -> None:
    """From stretched legs nothing closes; joint positions under 'home' do, on their side."""
    straight = [
        joint("mot1", "base", "a1", "-0.1 0 0"),
        joint("free1", "a1", "a2", "0.25 0 0"),
        joint("mot2", "base", "b1", "0.1 0 0"),
        joint("free2", "b1", "b2", "0.25 0 0"),
        joint("closedloop1_A", "a2", "ca", "0.25 0 0", "fixed"),
        joint("closedloop1_B", "b2", "cb", "0.25 0 0", "fixed"),
    ]
    yaml = FIVE_BAR_YAML + "home: {mot1: 2.3, free1: -1.6, mot2: 0.8, free2: 1.6}\n"
    mechanism = read(written(tmp_path, urdf("fivebar", straight, "base"), yaml))
    assert [np.sign(leg.home[1]) for leg in mechanism.legs] == [-1, 1]
    points = np.random.default_rng(0).uniform((-0.1, 0.3), (0.1, 0.4), (20, 2))
    solution = pincal.inverse(mechanism, points)
    assert solution.reached.all()
    for leg, foot in zip(mechanism.legs, (-0.1, 0.1), strict=True):
        q = solution.joints[leg.name]
        z = foot + 0.25 * np.exp(1j * q[:, 0]) * (1 + np.exp(1j * q[:, 1]))
        np.testing.assert_allclose(np.stack((z.real, z.imag), axis=1), points, atol=1e-12)


def test_an_arm_out_and_in(tmp_path: Path) -> None:
    """An arm from URDF, written as MJCF and URDF and read again, has the same tip."""
    (tmp_path / "arm.urdf").write_text(urdf("arm", ARM, "base_link"))
    arm = pincal.Mechanism.from_urdf(tmp_path / "arm.urdf", "tool0")
    q = np.random.default_rng(0).uniform(-1.5, 1.5, (20, 6))
    expected = pincal.forward(arm, q).poses
    assert unwritten(arm) == ()
    (tmp_path / "out.xml").write_text(mjcf(arm))
    done("export", arm.save(tmp_path / "arm"), "-o", tmp_path / "out.urdf")
    for again in (
        serial_arm(read_mjcf(tmp_path / "out.xml"), "platform"),
        pincal.Mechanism.from_urdf(tmp_path / "out.urdf", "arm_tip"),
    ):
        np.testing.assert_allclose(pincal.forward(again, q).poses, expected, atol=1e-11)


COMMENTED = """<?xml version='1.0' encoding="UTF-8"?>\r
<!-- made by hand: é -->\r
<robot  name='arm' >\r
"""


def messy(joints: list[str], root: str) -> bytes:
    """Return a URDF as people write it: quotes, comments, lines ends, joints without origin."""
    text = urdf("arm", joints, root).split("\n", 2)[2]
    text = COMMENTED + text.replace("\n", "\r\n").replace("<origin xyz", "<origin\n  xyz")
    text = text.replace("<axis", "<!-- <origin xyz='9 9 9'/> --><axis")
    return text.replace('rpy="0 0 0"/>', "rpy = '0 0 0' />").encode()


def test_calibrated_origins_go_into_the_users_urdf(tmp_path: Path) -> None:
    """A calibrated arm's URDF moves as it does; nothing but the origins' numbers is other."""
    file = tmp_path / "arm.urdf"
    data = messy(ARM, "base_link").replace(b"<origin\n  xyz=\"0 0 0.128\" rpy = '0 0 0' />", b"", 1)
    file.write_bytes(data)
    arm = pincal.Mechanism.from_urdf(file, "tool0")
    true = pincal.disturb(arm, 1e-2, seed=0)
    (tmp_path / "out.urdf").write_bytes(calibrated_urdf(file, true))
    q = np.random.default_rng(0).uniform(-1.5, 1.5, (20, 6))
    again = pincal.Mechanism.from_urdf(tmp_path / "out.urdf", "tool0")
    np.testing.assert_allclose(
        pincal.forward(again, q).poses, pincal.forward(true, q).poses, atol=1e-12
    )
    origin = rb"<origin\s+xyz=\"[^\"]*\" rpy\s?=\s?(['\"])[^'\"]*\1\s?/>"
    made = (tmp_path / "out.urdf").read_bytes()
    assert re.sub(origin, b"", made) == re.sub(origin, b"", data)
    assert calibrated_urdf(file, arm) == data


@pytest.mark.parametrize("write", [five_bar, hexapod])
def test_calibrated_loops_go_into_the_users_urdf(write, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    """A tree with calibrated origins, read with the same loops, is the calibrated mechanism."""
    file = write(tmp_path)
    mechanism = read(file)
    true = pincal.disturb(mechanism, 1e-3, seed=0)
    if write is hexapod:
        with pytest.raises(pincal.MechanismError, match=r"no joint 'leg0_u_y', .*u_y_z"):
            calibrated_urdf(file, true)  # a universal joint has no place for its axes' distance
        true = true.with_parameters({name: {"u_y_z": 0.0} for name in true.leg_names})
    file.write_bytes(calibrated_urdf(file, true))
    again = read(file)
    rng = np.random.default_rng(0)
    spread = [0.03 if unit == "m" else 0.0 for unit in true.platform.units]
    poses = rng.normal(true.platform.home, spread, (20, true.platform.dof))
    expected, found = pincal.inverse(true, poses), pincal.inverse(again, poses)
    assert expected.reached.all()
    carried = "leg0" in again.leg_names
    if carried:  # the platform's frame is the link's: its first point stays in its origin
        shift = true.legs[0].point.placement.origin()[:3, 3]
        assert np.linalg.norm(shift) > 1e-4
        turned = true.platform.transforms(poses).as_matrix()
        turned[:, :3, 3] += turned[:, :3, :3] @ shift
        found = pincal.inverse(again, again.platform.from_matrices(turned))
    np.testing.assert_allclose(found.readings, expected.readings, atol=1e-11)
    np.testing.assert_allclose(
        pincal.inverse(mechanism, poses).readings, expected.readings, atol=2e-2
    )
    assert np.abs(pincal.inverse(mechanism, poses).readings - expected.readings).max() > 1e-4


def replaced(text: str, *pairs: tuple[str, str]) -> str:
    for old, new in pairs:
        assert old in text
        text = text.replace(old, new)
    return text


LOOP, OWN = "[['closedloop1_A', 'closedloop1_B']]", "rotor_inertia: [0.1, 0.1]"
CUBIC = "joint_name: [mot1]\njoint_type: [CUBIC]"


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ((("name_mot: ['mot1', 'mot2']", "name_mot: ['mot1']"),), "no platform that can be"),
        ((("'mot2'", "'motor'"),), "'name_mot' has 'motor'"),
        ((("closedloop1_B", "loop_B"),), "no frame named 'loop_B'"),
        ((("'3d'", "'4d'"),), "type.0"),
        ((("['3d']", "['3d', '3d']"),), "1 entries of 'closed_loop', but 2"),
        (((LOOP, "[[a2, b2, ca]]"),), "at most 2"),
        (((LOOP, "[]"), ("['3d']", "[]")), "form no loop"),
        (((OWN, "platform: nowhere"),), "no frame named 'nowhere'"),
        (((OWN, "home: {mot9: 1.0}"),), "'home' has 'mot9'"),
        (((OWN, "platform: base"),), "fixed to the base"),
        (((OWN, CUBIC),), "joint_type.0"),
        ((("closedloop1_B'", "a1'"),), "closedloop1_A_a1 lie on no route"),
    ],
)
def test_yaml_that_does_not_fit(
    changes: tuple[tuple[str, str], ...], message: str, tmp_path: Path
) -> None:
    """What is wrong in a YAML file is said in one message that names it; nothing is written."""
    file = written(
        tmp_path / "in", urdf("fivebar", FIVE_BAR, "base"), replaced(FIVE_BAR_YAML, *changes)
    )
    outcome = run("import", file, "-o", tmp_path / "out")
    assert outcome.code == 2
    assert message in outcome.trouble
    assert not (tmp_path / "out").exists()


def test_legs_and_platform_must_be_told_apart(tmp_path: Path) -> None:
    """Two bodies that may be the platform, loops that do not close: refused with the place."""
    coupled = [*FIVE_BAR, joint("x", "a1", "x1", "0 0.1 0"), joint("xe", "x1", "x2", kind="fixed")]
    coupled.append(joint("xb", "b1", "x3", "0 0.1 0", "fixed"))
    yaml = FIVE_BAR_YAML.replace("']]", "'], [xe, xb]]").replace("['3d']", "['3d', '3d']")
    with pytest.raises(pincal.MechanismError, match="routes meet in 2 bodies"):
        read(written(tmp_path, urdf("r", coupled, "base"), yaml))
    apart = [one.replace('xyz="0.1 0 0"', 'xyz="9 0 0"') for one in FIVE_BAR]
    with pytest.raises(pincal.MechanismError, match="do not close"):
        read(written(tmp_path, urdf("r", apart, "base"), FIVE_BAR_YAML))
    double = [*FIVE_BAR, joint("again", "base", "b2")]
    with pytest.raises(pincal.MechanismError, match="is the child of two joints"):
        read(written(tmp_path, urdf("r", double, "base"), FIVE_BAR_YAML))


TENDON = '<tendon><fixed name="t"><joint joint="m2" coef="1"/></fixed></tendon>'
CONNECT = '<connect site1="sa" site2="sb"/>'


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ((('<motor joint="m1"/>', ""), ('<position joint="m2"/>', "")), "platform"),
        ((('joint="m2"', 'joint="m3"'),), "unknown transmission target 'm3'"),
        ((("EQUALITY", '<joint joint1="f1" joint2="f2"/>'),), "form no loop"),
        (
            (("EQUALITY", f'{CONNECT}<joint joint1="f1" joint2="f2"/>'),),
            "name it with --platform LINK",
        ),
        (
            (
                ("EQUALITY", f'{CONNECT}<tendon tendon1="t"/>'),
                ("<actuator>", f"{TENDON}<actuator>"),
            ),
            "an <equality> couples joint 'm2'",
        ),
        ((("EQUALITY", '<connect site1="sa" site2="sc"/>'),), "unknown element 'sc'"),
        ((("EQUALITY", '<connect body1="a2" body2="z" anchor="0 0 0"/>'),), "'z' in equality"),
        ((("EQUALITY", '<connect body1="a2" body2="b2"/>'),), "'anchor') must be specified"),
        ((("EQUALITY", ""),), "form no loop"),
        ((('<joint name="f1"/>', '<joint name="f1" type="screw"/>'),), "keyword: 'screw'"),
        ((('<joint name="m1"/>', '<joint name="m1" type="ball"/>'),), "may be the platform"),
        ((('<joint name="f1"/>', '<joint name="m1"/>'),), "repeated name 'm1'"),
        ((('pos="-0.1 0 0"', 'pos="-0.1 0"'),), "'pos' does not have enough data"),
        ((('pos="-0.1 0 0"', 'pos="nan 0 0"'),), "not finite"),
        ((("<worldbody>", '<include file="/etc/passwd"/><worldbody>'),), "line 3"),
        ((('<joint name="f1"/>', '<joint name="f1" class="k"/>'),), "unknown default class"),
        ((("mujoco", "muyoco"),), "expected a <mujoco>"),
    ],
)
def test_mjcf_that_does_not_fit(
    changes: tuple[tuple[str, str], ...], message: str, tmp_path: Path
) -> None:
    """What is wrong in MJCF is said in one message that names it; nothing is written."""
    file = tmp_path / "robot.xml"
    text = replaced(LOOPED, *changes)
    file.write_text(text.replace("EQUALITY", CONNECT))
    outcome = run("import", file, "-o", tmp_path / "out")
    assert outcome.code == 2
    assert message in outcome.trouble
    assert not (tmp_path / "out").exists()


BOMB = """<?xml version="1.0"?>
<!DOCTYPE x [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;&a;&a;">
<!ENTITY f SYSTEM "file:///etc/passwd">]>
"""


@pytest.mark.parametrize("suffix", ["urdf", "xml"])
def test_hostile_xml_is_refused(suffix: str, tmp_path: Path) -> None:
    """Entities, files of many MiB and nesting without end are refused, not resolved."""
    (tmp_path / "robot.yaml").write_text(FIVE_BAR_YAML)
    file = tmp_path / f"robot.{suffix}"
    plain = urdf("r", FIVE_BAR, "base").split("\n", 1)[1] if suffix == "urdf" else LOOPED
    file.write_text(BOMB + plain.replace("-0.1 0 0", "&b; 0 0", 1))
    assert "entities" in run("import", file, "-o", tmp_path / "out").trouble
    file.write_text(plain + "<!--" + "x" * (17 * 2**20) + "-->")
    assert "larger than 16 MiB" in run("import", file, "-o", tmp_path / "out").trouble
    file.write_text("<robot>" + "<link>" * 100_000)
    assert "does not parse" in run("import", file, "-o", tmp_path / "out").trouble


def test_what_a_urdf_has_no_place_for(tmp_path: Path) -> None:
    """Another robot's URDF, a joint moved elsewhere, a tool on no frame: said, nothing written."""
    file = five_bar(tmp_path)
    mechanism = pincal.disturb(read(file), 1e-3, seed=0)
    other = tmp_path / "arm.urdf"
    other.write_text(urdf("arm", ARM, "base_link"))
    with pytest.raises(pincal.MechanismError, match="has none of the joints"):
        calibrated_urdf(other, mechanism)
    elsewhere = [one.replace('parent link="b1"', 'parent link="a1"') for one in FIVE_BAR]
    other.write_text(urdf("fivebar", elsewhere, "base"))
    with pytest.raises(pincal.MechanismError, match="'free2' cannot be placed: it hangs on"):
        calibrated_urdf(other, mechanism)
    other.write_text(urdf("fivebar", FIVE_BAR[:-1], "base"))
    with pytest.raises(pincal.MechanismError, match="has no joint 'closedloop1_B'"):
        calibrated_urdf(other, mechanism)
    other.write_text(urdf("arm", ARM[:-1], "base_link"))
    arm = pincal.disturb(pincal.Mechanism.from_urdf(other, "wrist_3"), 1e-3, seed=0)
    with pytest.raises(pincal.MechanismError, match="no fixed joint of the URDF can hold"):
        calibrated_urdf(other, arm)


def test_legs_of_a_folder_are_their_own_urdfs(tmp_path: Path) -> None:
    """A leg's URDF is found by its name; the platform's points are in its own."""
    folder = pincal.load_mechanism("3RRR").save(tmp_path / "rrr")
    true = pincal.disturb(pincal.load_mechanism(folder), 1e-3, seed=0)
    true.save(tmp_path / "true")
    for name in ("leg_1", "leg_3", "platform"):
        made = calibrated_urdf(folder / f"{name}.urdf", true)
        joints = origins_of(made)
        for key, expected in origins_of((tmp_path / "true" / f"{name}.urdf").read_bytes()).items():
            np.testing.assert_allclose(joints[key], expected, atol=1e-11)
    (folder / "leg_2.urdf").rename(tmp_path / "mine.urdf")
    with pytest.raises(pincal.MechanismError, match=r"give the file the name of its leg"):
        calibrated_urdf(tmp_path / "mine.urdf", true)


def origins_of(text: bytes) -> dict[str, np.ndarray]:
    """Return the joints' origins of a URDF by yourdfpy, (4, 4)."""
    robot = yourdfpy.URDF.load(BytesIO(text), load_meshes=False)
    return {name: one.origin for name, one in robot.joint_map.items()}


@pytest.mark.slow
def test_from_cad_urdf_to_calibrated_urdf(tmp_path: Path) -> None:
    """On the command line: import, plan, measure, calibrate, export, and the error is gone."""
    file = five_bar(tmp_path / "robot")
    folder, plan, truth = tmp_path / "bar", tmp_path / "plan.csv", tmp_path / "truth"
    assert "mot1*, free1; closes a point" in done("import", file, "-o", folder).out
    done("select", folder, "--count", 8, "--protocol", "independent", "-o", plan)
    rows = tmp_path / "rows.csv"
    noise = ("--noise-position", "0", "--disturb", "1e-3")
    done("simulate", folder, plan, *noise, "--truth", truth, "-o", rows)
    noise = ("--noise-position", "1e-6", "--no-report")
    done("calibrate", folder, rows, *noise, "-o", tmp_path / "result")
    out = tmp_path / "out.urdf"
    done("export", tmp_path / "result", "--original", file, "-o", out)
    again, _ = closed_mechanism(read_loops(out, file.with_name("robot.yaml")))
    points = np.random.default_rng(0).uniform((-0.05, 0.35), (0.05, 0.42), (20, 2))
    exact = pincal.inverse(pincal.load_mechanism(truth), points).readings
    found = pincal.inverse(again, points).readings
    np.testing.assert_allclose(found, exact, atol=1e-9)
    assert np.abs(five_bar_angles(points) - exact).max() > 1e-4


def test_options_that_do_not_go_together(tmp_path: Path) -> None:
    """What a command cannot do with a file is said, and which option does."""
    file = five_bar(tmp_path)
    out = tmp_path / "out"
    (tmp_path / "robot.yaml").rename(tmp_path / "loops.yml")
    assert "--loops" in run("import", file, "-o", out).trouble
    done("import", file, "--loops", tmp_path / "loops.yml", "-o", out)
    again = ("-o", tmp_path / "other")
    both = ("--tip", "a2", "--platform", "a2")
    assert (
        "leave out --platform: not for a serial arm" in run("import", file, *both, *again).trouble
    )
    (tmp_path / "printer.cfg").write_text("")
    told = run("import", tmp_path / "printer.cfg", "--tip", "a", *again).trouble
    assert "leave out --tip: not for" in told
    done("import", file, "--tip", "a2", *again)
    assert len(pincal.load_mechanism(tmp_path / "other").reading_names) == 2
    assert "has loops" in run("export", out, "-o", tmp_path / "new.urdf").trouble
    done("export", out, "-o", tmp_path / "new.xml")
    assert "exists" in run("export", out, "-o", tmp_path / "new.xml").trouble
    assert (
        "is not known; give it the ending" in run("export", out, "-o", tmp_path / "new.txt").trouble
    )
    original = ("--original", file)
    told = run("export", out, *original, "-o", tmp_path / "new.xml").trouble
    assert "expected a <mujoco> element, found <robot>" in told
    told = run("export", out, *original, "-o", tmp_path / "new.cfg").trouble
    assert "leave out --original: not for the format" in told


def opened(folder: Path, by: float) -> Path:
    """Write the five-bar with one end that misses the other, as drawn."""
    joints = [one.replace('xyz="-0.2 0.2 0"', f'xyz="{by - 0.2} 0.2 0"') for one in FIVE_BAR]
    return written(folder, urdf("fivebar", joints, "base"), FIVE_BAR_YAML)


def test_an_open_loop_is_said(tmp_path: Path) -> None:
    """By how much loops are open as drawn, and how far joints moved, is a warning; else not."""
    outcome = done("import", opened(tmp_path / "open", 0.03), "-o", tmp_path / "bar")
    mechanism = pincal.load_mechanism(tmp_path / "bar")
    moved = max(abs(joint.home) for leg in mechanism.legs for joint in leg.moving)
    text = " ".join(outcome.err.split())
    assert "warning: as drawn, the loops are open by 0.03 m" in text
    assert f"moved by up to {moved:.3g} rad" in text
    assert f"loops closed by {tmp_path / 'open' / 'robot.yaml'}" in outcome.out
    closed = done("import", five_bar(tmp_path / "closed"), "-o", tmp_path / "bar2")
    assert "warning" not in closed.err


def test_loops_close_within_limits(tmp_path: Path) -> None:
    """A loop that is drawn beyond a joint's limits is closed within them."""
    limited = LIMIT.replace("<limit", '<limit lower="0.5" upper="1.5"')
    joints = [one.replace(LIMIT, limited) if '"free1"' in one else one for one in FIVE_BAR]
    file = written(tmp_path, urdf("fivebar", joints, "base"), FIVE_BAR_YAML)
    outcome = done("import", file, "-o", tmp_path / "bar")
    mechanism = pincal.load_mechanism(tmp_path / "bar")
    homes = {joint.name: joint.home for leg in mechanism.legs for joint in leg.moving}
    assert 0.5 <= homes["free1"] <= 1.5
    assert "outside its limits" not in outcome.err


def test_freedoms_without_a_drive_are_said(tmp_path: Path) -> None:
    """A five-bar of one motor imports, and it is said that readings give no pose."""
    yaml = FIVE_BAR_YAML.replace("'mot1', 'mot2'", "'mot1'") + "platform: b2\n"
    file = written(tmp_path, urdf("fivebar", FIVE_BAR, "base"), yaml)
    said = " ".join(done("import", file, "-o", tmp_path / "bar").err.split())
    assert "drives leave 1 of the platform's 3 freedoms open" in said


def test_balls_and_drives_by_parts_of_names(tmp_path: Path) -> None:
    """YAML of other years says the same machine; joints that a URDF has not are left out, said."""
    file = ankle(tmp_path)
    beside = file.with_name("robot.yaml")
    plain, text = read(file), beside.read_text()
    balls = text[text.index("joint_name") : text.index("platform:")]
    beside.write_text(text.replace(balls, "rotule_name: ball\n").replace("[mot]", "mot"))
    assert read(file).legs == plain.legs
    beside.write_text(text.replace("[ball0", "[ball7, ball0").replace("[SPH", "[CARDAN, SPH"))
    assert read(file).legs == plain.legs
    outcome = done("import", file, "-o", tmp_path / "ankle")
    assert "'joint_name' has 'ball7', no joint of" in outcome.err


def test_a_loop_that_cannot_close_is_refused(tmp_path: Path) -> None:
    """Open by half a leg it is closed, and said; motors farther apart than legs reach are not."""
    outcome = done("import", opened(tmp_path / "open", 0.25), "-o", tmp_path / "bar")
    assert "open by 0.25 m" in " ".join(outcome.err.split())
    leg, other = pincal.load_mechanism(tmp_path / "bar").legs
    points = pincal.forward(tmp_path / "bar", [[leg.home[0], other.home[0]]]).poses
    np.testing.assert_allclose(points[0], pincal.load_mechanism(tmp_path / "bar").platform.home)
    outcome = run("import", opened(tmp_path / "far", 3.0), "-o", tmp_path / "none")
    assert outcome.code == 2
    assert "stay open" in outcome.trouble
    assert not (tmp_path / "none").exists()


def test_a_weld_that_asks_too_much_is_named(tmp_path: Path) -> None:
    """A loop whose joints cannot meet all conditions says how many; so does a name given twice."""
    tilted = [one.replace('"0 0 1"', '"0 1 0"') if '"free2"' in one else one for one in FIVE_BAR]
    tilted[4] = tilted[4].replace("0.2 0.2 0", "0.2 0.2 0.1")
    yaml = FIVE_BAR_YAML.replace("3d", "6d") + "platform: a2\n"
    file = written(tmp_path / "weld", urdf("weld", tilted, "base"), yaml)
    trouble = run("import", file, "-o", tmp_path / "none").trouble
    assert "joints can meet 10 of all 12 conditions" in trouble
    twice = urdf("twice", [*FIVE_BAR, joint("free1", "b2", "tool")], "base")
    file = written(tmp_path / "twice", twice, FIVE_BAR_YAML)
    assert "two joints are called 'free1'" in run("import", file, "-o", tmp_path / "none").trouble


def test_what_carries_nothing_is_the_platform(tmp_path: Path) -> None:
    """A leg whose knee a motor bends over a parallelogram: its foot's frame, beyond all loops.

    Hip and foot are two sides of 0.4 m apart by the cosine law of the knee, which turns as the
    motor does. The rod is drawn open, and friction, which onshape-to-robot writes, places nothing.
    """
    y = "0 1 0"
    joints = [
        joint("hip", "pelvis", "thigh", axis=y),
        joint("knee", "thigh", "shin", "0 0 -0.4", axis=y),
        joint("foot_frame", "shin", "foot", "0 0 -0.4", "fixed"),
        joint("motor", "thigh", "crank", "0 0 -0.1", axis=y),
        joint("rod", "crank", "bar", "0.05 0 0", axis=y, rpy="0 0.2 0"),
        joint("closed_A", "bar", "bar_end", "0 0 -0.3", "fixed"),
        joint("closed_B", "shin", "shin_end", "0.05 0 0", "fixed"),
    ]
    joints = [
        one.replace("</joint>", '<joint_properties friction="0.0"/></joint>') for one in joints
    ]
    yaml = "closed_loop: [[bar_end, shin_end]]\ntype: ['3d']\nname_mot: [hip, motor]\n"
    mechanism = read(written(tmp_path, urdf("leg", joints, "pelvis"), yaml))
    readings = np.random.default_rng(0).uniform((-0.5, 0.2), (0.5, 1.2), (20, 2))
    poses = pincal.forward(mechanism, readings).poses
    far = np.linalg.norm(poses[:, :2], axis=1)
    np.testing.assert_allclose(far, 0.8 * np.cos(readings[:, 1] / 2.0), atol=1e-9)


def test_degrees_and_millimetres_are_asked_about(tmp_path: Path) -> None:
    """Origins turned by more than a turn, and legs of hundreds of metres, are warned of."""
    joints = [one.replace('rpy="0 0 0"', 'rpy="0 0 90"', 1) for one in ARM[:1]] + ARM[1:]
    (tmp_path / "arm.urdf").write_text(urdf("arm", joints, "base_link"))
    outcome = done("import", tmp_path / "arm.urdf", "--tip", "tool0", "-o", tmp_path / "arm")
    assert "rpy='0 0 90' is more than a turn: radians are expected" in " ".join(outcome.err.split())
    large = re.sub(r"0\.(\d\d\d)", r"\1", urdf("arm", ARM, "base_link"))
    (tmp_path / "large.urdf").write_text(large)
    outcome = done("import", tmp_path / "large.urdf", "--tip", "tool0", "-o", tmp_path / "large")
    assert "is this millimetres?" in outcome.err


def test_misspelt_key_of_loops_is_named(tmp_path: Path) -> None:
    """A key like one that is absent is asked about; keys of other tools stay ignored."""
    file = written(
        tmp_path,
        urdf("fivebar", FIVE_BAR, "base"),
        FIVE_BAR_YAML.replace("closed_loop:", "closed_loops:"),
    )
    with pytest.raises(pincal.MechanismError, match="'closed_loops'; did you mean 'closed_loop'"):
        read(file)
