"""Orientations between files and matrices: no angle's pole lies on the way."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from arms import loaded
from command_line import done
from marks import quick
from scipy.spatial.transform import RigidTransform, Rotation

import pincal
from pincal.model.placement import placement_of
from pincal.model.platform import WAYS, columns_of, rotation_of, turns_in_series

Array = np.ndarray
AXIS_ALIGNED = Rotation.create_group("O")
#: Tool straight down, as arms are drawn that screw or pick: the last joint turns about -z.
DOWN = """<robot name="down"><link name="foot"/><link name="arm"/><link name="quill"/>
<link name="flange"/><link name="tool"/>
<joint name="a" type="revolute"><parent link="foot"/><child link="arm"/><origin xyz="0 0 .4"/>
<axis xyz="0 0 1"/><limit lower="-2" upper="2" effort="1" velocity="1"/></joint>
<joint name="b" type="revolute"><parent link="arm"/><child link="quill"/><origin xyz=".3 0 0"/>
<axis xyz="0 0 1"/><limit lower="-2" upper="2" effort="1" velocity="1"/></joint>
<joint name="c" type="prismatic"><parent link="quill"/><child link="flange"/>
<origin xyz=".2 0 0" rpy="0 {pi} 0"/><axis xyz="0 0 1"/>
<limit lower="0" upper=".2" effort="1" velocity="1"/></joint>
<joint name="d" type="revolute"><parent link="flange"/><child link="tool"/><origin xyz="0 0 .1"/>
<axis xyz="0 0 1"/><limit lower="-3" upper="3" effort="1" velocity="1"/></joint></robot>"""


def rotations(count: int) -> Rotation:
    """Return axis-aligned and random rotations, and random ones from 1e-3 to 1e-16 off a pole."""
    rng, parts = np.random.default_rng(3), [AXIS_ALIGNED, Rotation.random(count, rng=4)]
    for order in ("ZYZ", "ZYX", "XYZ"):
        angles = rng.uniform(-np.pi, np.pi, (count, 3))
        off = 10.0 ** rng.uniform(-16.0, -3.0, count)
        angles[:, 1] = rng.choice([0.0, 0.5, -0.5, 1.0], count) * np.pi + off
        turned = Rotation.from_euler(order, angles)
        parts += [turned, turned * AXIS_ALIGNED[rng.integers(0, 24, count)]]
    return Rotation.concatenate(parts)


@pytest.mark.parametrize("way", WAYS)
def test_columns_give_every_orientation_back(way: str) -> None:
    """Axis-aligned, random and at poles: the columns' matrices are those written, to 1e-12."""
    given = rotations(3000)
    again = rotation_of(way, columns_of(way, given))
    np.testing.assert_allclose(again.as_matrix(), given.as_matrix(), rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("way", WAYS)
def test_tables_give_every_pose_back(way: str, tmp_path: Path) -> None:
    """Transforms written to a CSV file and read are the same transforms, to 1e-12."""
    hexapod, path = pincal.load_mechanism("6UPS"), tmp_path / "poses.csv"
    given = rotations(300)
    poses = RigidTransform.from_components(np.ones((len(given), 3)), given)
    plan = pincal.Plan(hexapod.platform.coordinates_of(poses))
    plan.to_csv(path, hexapod, orientation=way)
    read = hexapod.platform.matrices(pincal.Plan.from_csv(path, hexapod).poses)
    np.testing.assert_allclose(read, poses.as_matrix(), rtol=0.0, atol=1e-12)


def test_origins_and_series_of_joints_give_every_orientation_back() -> None:
    """Roll, pitch, yaw of a URDF, and three joints about x, y, z, by SciPy's Euler angles."""
    given = rotations(1000).as_matrix()
    placed = np.tile(np.eye(4), (len(given), 1, 1))
    placed[:, :3, :3] = given
    rpy = np.array([placement_of(matrix).rpy for matrix in placed])
    for angles, order in ((rpy, "xyz"), (turns_in_series(given), "XYZ")):
        again = Rotation.from_euler(order, angles).as_matrix()
        np.testing.assert_allclose(again, given, rtol=0.0, atol=1e-12)


def test_what_has_no_meaning_at_a_pole_is_zero() -> None:
    """Azimuth at tilt 0, torsion at tilt π, roll at pitch ±π/2, though rounding says otherwise."""
    turn = Rotation.from_euler("Z", 0.4)
    assert columns_of("tilt-torsion", Rotation.concatenate([turn]))[0] == pytest.approx([0, 0, 0.4])
    down = turn * Rotation.from_euler("Y", np.pi) * Rotation.from_euler("Z", -0.1)
    azimuth, tilt, torsion = columns_of("tilt-torsion", Rotation.concatenate([down]))[0]
    assert (azimuth, tilt, torsion) == pytest.approx((0.25, np.pi, 0.0), abs=1e-15)
    for pitch in (-np.pi / 2, np.pi / 2):
        steep = turn * Rotation.from_euler("Y", pitch)
        zyx = columns_of("zyx", Rotation.concatenate([steep]))[0]
        assert zyx == pytest.approx([0.4, pitch, 0.0], abs=1e-15)


@pytest.mark.parametrize("index", quick(8, range(24)))
@pytest.mark.parametrize("form", ["urdf", "mjcf"])
def test_files_of_arms_hold_every_axis_aligned_tool(form: str, index: int, tmp_path: Path) -> None:
    """An arm whose last frame is turned by any of the 24: imported, saved and read, home is that.

    The turn is written by the test, as roll, pitch, yaw or as a quaternion.
    """
    R, file = AXIS_ALIGNED[index], tmp_path / f"one.{'xml' if form == 'mjcf' else 'urdf'}"
    w, x, y, z = R.as_quat(scalar_first=True)
    yaw, pitch, roll = columns_of("zyx", AXIS_ALIGNED)[index]
    file.write_text(
        f"""<robot name="one"><link name="foot"/><link name="rod"/><link name="tool"/>
        <joint name="a" type="revolute"><parent link="foot"/><child link="rod"/>
        <axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
        <joint name="t" type="fixed"><parent link="rod"/><child link="tool"/>
        <origin xyz=".3 .1 .2" rpy="{roll} {pitch} {yaw}"/></joint></robot>"""
        if form == "urdf"
        else f"""<mujoco model="one"><worldbody><body name="rod"><joint name="a" type="hinge"
        axis="0 0 1" range="-57 57"/><body name="tool" pos=".3 .1 .2" quat="{w} {x} {y} {z}"/>
        </body></worldbody></mujoco>"""
    )
    done("import", file, "--tip", "tool", "-o", tmp_path / "m")
    mechanism = pincal.load_mechanism(tmp_path / "m")
    home = mechanism.platform.home_pose.as_matrix()[0]
    np.testing.assert_allclose(home[:3, :3], R.as_matrix(), rtol=0.0, atol=1e-12)
    reached = pincal.forward(mechanism, np.zeros((1, 1))).poses
    there = mechanism.platform.matrices(reached)[0]
    np.testing.assert_allclose(there, home, rtol=0.0, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("arm", ["down", "ur5"])
def test_an_arm_whose_tool_points_down_is_used_by_every_command(arm: str, tmp_path: Path) -> None:
    """Imported, it is checked, planned, measured, calibrated; poses and readings say the same."""
    folder, plan, data = tmp_path / "m", tmp_path / "plan.csv", tmp_path / "data.csv"
    if arm == "down":
        (tmp_path / "down.urdf").write_text(DOWN.format(pi=np.pi))
        done("import", tmp_path / "down.urdf", "--tip", "tool", "-o", folder)
    else:
        loaded(arm).save(folder)
    done("check", folder)
    done("select", folder, "--count", 20, "--starts", 1, "-o", plan)
    done("inverse", folder, plan, "-o", tmp_path / "readings.csv")
    done("forward", folder, tmp_path / "readings.csv", "-o", tmp_path / "poses.csv")
    mechanism = pincal.load_mechanism(folder)
    wanted, found = (
        mechanism.platform.matrices(pincal.Plan.from_csv(tmp_path / name, mechanism).poses)
        for name in ("plan.csv", "poses.csv")
    )
    np.testing.assert_allclose(found, wanted, rtol=0.0, atol=1e-9)
    done("simulate", folder, plan, "-o", data, "--truth", tmp_path / "truth")
    noise = ("--noise-position", 1e-4, "--noise-orientation", 1e-4)
    known = (*noise, "--folds", 0, "--no-report")
    done("calibrate", folder, data, *known, "-o", tmp_path / "result")


def test_quaternions_of_a_tool_that_points_down_calibrate(tmp_path: Path) -> None:
    """With qw = qz = 0 exactly, reduced χ² is that of the same poses turned by 1e-9 rad.

    Poses are products of cosines; positions have the noise that is given, orientations none.
    Columns of quaternions need no unit.
    """
    file, rng = tmp_path / "down.urdf", np.random.default_rng(3)
    file.write_text(DOWN.format(pi="3.14159265359"))
    mechanism = pincal.Mechanism.from_urdf(file, "tool")
    a, b, d = rng.uniform(-1.9, 1.9, (3, 30))
    c, zero = rng.uniform(0.0, 0.2, 30), np.zeros(30)
    half, (ex, ey, ez) = (a + b - d) / 2, rng.normal(0.0, 2e-5, (3, 30))
    x, y = 0.3 * np.cos(a) + 0.2 * np.cos(a + b) + ex, 0.3 * np.sin(a) + 0.2 * np.sin(a + b) + ey
    header = "x [m],y [m],z [m],qw{},qx{},qy{},qz{},a [rad],b [rad],c [m],d [rad]"
    chi2 = []
    for turned, unit in ((0.0, " [1]"), (1e-9, "")):
        table = tmp_path / f"turned_by_{turned}.csv"
        quaternions = (zero + 0.5 * turned, -np.sin(half), np.cos(half), zero)
        rows = np.column_stack((x, y, 0.3 - c + ez, *quaternions, a, b, c, d))
        head = header.format(*4 * [unit])
        np.savetxt(table, rows, "%.17g", ",", header=head, comments="")
        noise = pincal.Noise(2e-5, 1e-4, 0.0)
        result = pincal.calibrate(mechanism, table, noise=noise)
        assert result.converged
        chi2.append(result.reduced_chi2)
    assert chi2[0] == pytest.approx(chi2[1], rel=1e-3)
    assert 0.35 < chi2[0] < 0.65  # half of what is measured has no noise
