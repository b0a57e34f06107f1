"""Legs that are trees with ends, or that only guide, against closed forms."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import neighbours
import numpy as np
import pytest
from command_line import done, run
from machines import agile_eye, four_bar, four_bar_pose, hybrid, six_rods, tricept
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import pincal
from pincal import End, Joint, Mechanism, Placement, Platform, Sensor

Array = NDArray[np.float64]
X, Y, Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
EXACT = pincal.Noise(position=1e-5, orientation=1e-5, reading=1e-5)


def recovered(mechanism: Mechanism, readings: Array, scale: float = 1e-3) -> float:
    """Return by how much parameters are missed that noise-free data of another machine give."""
    rng = np.random.default_rng(1)
    errors = {p.id: p.nominal + scale * rng.standard_normal() for p in mechanism.parameters}
    true = mechanism.with_parameters(errors)
    moved = pincal.forward(true, readings)
    ok = moved.converged
    assert ok.mean() > 0.9
    data = pincal.Measurements(readings=readings[ok], poses=moved.poses[ok])
    result = pincal.calibrate(mechanism, data, noise=EXACT)
    assert len(result.parameters) == len(mechanism.parameters)
    return max(abs(p.identified - errors[p.id]) for p in result.parameters)


def test_a_follower_without_a_drive_is_a_leg() -> None:
    """A four-bar's coupler is where the cosine law puts it, and every length comes back."""
    mechanism, readings = four_bar(), np.linspace(-3.0, 3.0, 25)
    found = pincal.forward(mechanism, readings[:, None])
    np.testing.assert_allclose(found.poses, four_bar_pose(readings, 0.3, 0.8, 0.6, 0.9), atol=1e-9)
    assert recovered(mechanism, readings[:, None]) < 1e-8


@pytest.mark.slow
def test_a_centre_leg_without_a_drive_holds_a_tricept() -> None:
    """Struts have the lengths that were read where the centre leg's own way leads, and all return.

    The platform is Rx(a) Tx(off) Ry(b) Tz(h) Tx(-off): so its x axis has no y but by a, and its
    origin lies along its own z from where the second axis is.
    """
    mechanism = tricept()
    plan = pincal.sample_configurations(mechanism, 25)
    matrices = mechanism.platform.matrices(pincal.forward(mechanism, plan.readings).poses)
    for number, leg in enumerate(mechanism.legs[:3]):
        ends = matrices[:, :3, :3] @ leg.point.placement.xyz + matrices[:, :3, 3]
        length = np.linalg.norm(ends - leg.joints[0].placement.xyz, axis=1)
        np.testing.assert_allclose(length, plan.readings[:, number], atol=1e-9)
    R, second = matrices[:, :3, :3], 0.02 * np.array(X)
    np.testing.assert_allclose(R[:, 0, 1], 0.0, atol=1e-9)  # Rx Ry turns y about x alone
    along = np.einsum("nji,nj->ni", R, matrices[:, :3, 3] - second) + second
    np.testing.assert_allclose(along[:, :2], 0.0, atol=1e-9)
    assert recovered(mechanism, plan.readings) < 1e-8


def test_a_spin_about_a_strut_is_idle(tmp_path: Path) -> None:
    """A strut that may spin demands what it does without: the spin is held, its readings equal.

    Corrected, and loaded again, it is held still: a tip that misses the axis does not free it.
    """
    spinning, plain = tricept(), tricept(spins=False)
    assert [len(leg.moving) for leg in spinning.legs] == [3, 3, 3, 3]
    plan = pincal.sample_configurations(plain, 10)
    poses = pincal.forward(spinning, plan.readings).poses
    np.testing.assert_allclose(poses, plan.poses, atol=1e-12)
    leg = spinning.legs[0]
    tip = replace(leg.joints[-1], placement=Placement.of({"off": 0.0}, x="off"))
    values = (*leg.parameters, ("off", 0.0))
    leg = replace(leg, joints=(*leg.joints[:-1], tip), parameters=values)
    corrected = replace(spinning, legs=(leg.with_parameters({"off": 1e-3}), *spinning.legs[1:]))
    corrected.save(tmp_path / "corrected")
    assert pincal.load_mechanism(tmp_path / "corrected").legs == corrected.legs
    assert corrected.legs[0].joints[3].kind == "fixed"


def test_a_pair_of_rods_is_a_leg_with_two_ends(tmp_path: Path) -> None:
    """All six rods of a delta have their lengths at poses of readings; it is saved and comes back.

    The arm's end is by sines of the reading, the platform's points by the pose.
    """
    nominal = six_rods()
    rng = np.random.default_rng(2)
    errors = {p.id: p.nominal + 1e-3 * rng.standard_normal() for p in nominal.parameters}
    mechanism = nominal.with_parameters(errors)
    readings = np.array([[leg.home[0] for leg in nominal.legs]]) + rng.uniform(-0.3, 0.3, (25, 3))
    found = pincal.forward(mechanism, readings)
    assert found.converged.all()
    matrices = mechanism.platform.matrices(found.poses)
    for number, leg in enumerate(mechanism.legs):
        p = leg.nominal_by_name
        q = readings[:, number] + p["gamma"]
        radius = p["R"] + p["a"] * np.cos(q)
        out = np.array([np.cos(p["turn"]), np.sin(p["turn"]), 0.0])
        side = np.array([-out[1], out[0], 0.0])
        for i, half, point in ((1, 0.04, leg.points[1]), (2, -0.04, leg.points[0])):
            knee = radius[:, None] * out + half * side - np.outer(p["a"] * np.sin(q), Z)
            ends = matrices[:, :3, :3] @ point.placement.xyz + matrices[:, :3, 3]
            length = np.linalg.norm(ends - knee, axis=1)
            np.testing.assert_allclose(length, p[f"L{i}"], atol=1e-9)
    assert recovered(nominal, readings) < 1e-8
    nominal.save(tmp_path / "six")
    assert pincal.load_mechanism(tmp_path / "six").legs == nominal.legs


FOUR_BAR = {"fu": 0.15, "fv": 0.1, "a": 0.05, "b": 0.13, "c": 0.08}
"""A four-bar's ground in the plane, crank, coupler and rocker, [m]."""


def crank_of(rocker: Array) -> tuple[Array, Array]:
    """Return crank and coupler angles of FOUR_BAR by the rocker's, shapes (N,): the cosine law."""
    foot = FOUR_BAR["fu"] + 1j * FOUR_BAR["fv"]
    hook = FOUR_BAR["c"] * np.exp(1j * rocker) - foot
    a, b = FOUR_BAR["a"], FOUR_BAR["b"]
    cosine = (a**2 + np.abs(hook) ** 2 - b**2) / (2 * a * np.abs(hook))
    crank = np.angle(hook) + np.arccos(np.where(np.abs(cosine) < 1.0, cosine, np.nan))
    return crank, np.angle(hook - a * np.exp(1j * crank)) - crank


def driven_by_a_four_bar(name: str) -> Mechanism:
    """Return a mechanism whose first leg's shaft is turned by a four-bar in its plane from home.

    The plane is that across z of the 5R; across y of the 6-RUS, with u along z and v along x.
    """
    nominal = pincal.load_mechanism(name)
    leg = nominal.legs[0]
    u, v, axis, start = ("x", "y", Z, -0.5) if name == "5R" else ("z", "x", Y, 0.0)
    place = leg.index(leg.sensors[0].joint)
    shaft, before, behind = leg.joints[place], leg.joints[:place], leg.joints[place + 1 :]
    bars = {"fu": FOUR_BAR["fu"] + start, **{key: FOUR_BAR[key] for key in ("fv", "a", "b")}}
    crank, coupler = (angle.item() for angle in crank_of(np.zeros(1)))
    c, turn = FOUR_BAR["c"], -shaft.home
    foot = Placement.of(bars, **{u: "fu", v: "fv"})
    hook = Placement.of(bars, **{u: float(c * np.cos(turn)), v: float(c * np.sin(turn))})
    loop = (
        Joint("hook", "fixed", hook),
        Joint("crank", "revolute", foot, axis, home=crank, parent="base" if before else ""),
        Joint("coupler", "revolute", Placement.of(bars, **{u: "a"}), axis, home=coupler),
        Joint("coupler_tip", "fixed", Placement.of(bars, **{u: "b"})),
    )
    behind = (replace(behind[0], parent=shaft.name), *behind[1:])
    driven = replace(
        leg,
        joints=(*before, shaft, *loop, *behind),
        sensors=(replace(leg.sensors[0], joint="crank"),),
        parameters=(*leg.parameters, *bars.items()),
        ends=(End("coupler_tip", "hook", tuple(sorted((u, v)))),),
    )
    return replace(nominal, name="driven", legs=(driven, *nominal.legs[1:]))


@pytest.mark.parametrize("name", ["5R", pytest.param("6RUS", marks=pytest.mark.slow)])
def test_a_loop_within_a_leg(name: str, tmp_path: Path) -> None:
    """A shaft turned by a four-bar: the crank's reading is the cosine law's, all bars come back.

    In space the loop closes in its plane alone: across it nothing is demanded.
    """
    nominal, mechanism = pincal.load_mechanism(name), driven_by_a_four_bar(name)
    assert (mechanism.constraints, mechanism.by_readings) == (nominal.constraints, False)
    poses = pincal.sample_workspace(nominal, 30, seed=3)
    expected = pincal.inverse(nominal, poses)
    place = [joint.name for joint in nominal.legs[0].moving].index(nominal.legs[0].sensors[0].joint)
    crank = crank_of(expected.joints["leg_1"][:, place] - nominal.legs[0].home[place])[0]
    solved = pincal.inverse(mechanism, poses)
    near = np.isfinite(crank) & solved.reached.all(axis=1)
    assert near.mean() > 0.5
    turned = np.remainder(solved.readings[near, 0] - crank[near] + np.pi, 2 * np.pi) - np.pi
    np.testing.assert_allclose(turned, 0.0, atol=1e-9)
    mechanism.save(tmp_path / "driven")
    assert pincal.load_mechanism(tmp_path / "driven").legs == mechanism.legs
    assert recovered(mechanism, solved.readings[near], 1e-4) < 1e-8


def test_readings_say_how_a_loop_is_bent() -> None:
    """What is planned for a boom and a stick on cylinders, the machine as drawn reaches."""
    mechanism = hybrid()
    plan = pincal.sample_configurations(mechanism, 200)
    simulation = pincal.simulate(mechanism, mechanism, plan, pincal.Noise(0.0, 0.0, 0.0))
    assert not simulation.unreachable
    np.testing.assert_allclose(simulation.measurements.poses, plan.poses, atol=1e-9)


def without_turret_drive() -> pincal.Mechanism:
    """Return a boom and a stick on cylinders whose turret turns freely, unread."""
    (leg,) = hybrid().legs
    values = tuple(pair for pair in leg.parameters if pair[0] != "yaw")
    return replace(hybrid(), legs=(replace(leg, sensors=leg.sensors[1:], parameters=values),))


def test_poses_that_readings_leave_open_are_no_misses() -> None:
    """Held-out rows are judged by residuals alone: no pose belongs to too few readings."""
    mechanism, noise = without_turret_drive(), pincal.Noise(1e-4, 1e-4, 2e-5)
    plan = pincal.sample_configurations(mechanism, 40)
    data = pincal.simulate(mechanism, mechanism, plan, noise, seed=0).measurements
    result = pincal.calibrate(mechanism, data, noise=noise).validated()
    assert result.promises
    assert result.validation.targets == ()
    assert result.expected_error().uncovered[0] == "freedom"


@pytest.mark.parametrize(
    "drives", ["more", pytest.param("more in a leg", marks=pytest.mark.slow), "fewer"]
)
def test_drives_need_not_be_as_many_as_freedoms(drives: str) -> None:
    """Plans and data are of loops that close, every parameter comes back; too few have no pose."""
    if drives == "more":
        crank, follower = four_bar().legs
        follower = replace(follower, sensors=(pincal.Sensor("foot"),))
        mechanism = replace(four_bar(), legs=(crank, follower))
    elif drives == "more in a leg":
        (leg,) = hybrid().legs
        leg = replace(leg, sensors=(*leg.sensors, pincal.Sensor("foot_1")))
        mechanism = replace(hybrid(), legs=(leg,))
    else:
        mechanism = without_turret_drive()
    plan = pincal.sample_configurations(mechanism, 30)
    solution = pincal.forward(mechanism, plan.readings, plan.poses)
    np.testing.assert_allclose(solution.poses, plan.poses, atol=1e-4)
    assert solution.gap.max() < 1e-9
    assert pincal.forward(mechanism, plan.readings).converged.all() == (drives != "fewer")
    off = plan.readings + 0.01 * np.eye(1, plan.readings.shape[1], len(mechanism.legs) == 1)
    contradicting = pincal.forward(mechanism, off, plan.poses)
    assert ("readings contradict" in str(contradicting)) == (drives != "fewer")
    true = pincal.disturb(mechanism, 1e-3, seed=1)
    simulation = pincal.simulate(mechanism, true, plan, pincal.Noise(0.0, 0.0, 0.0))
    assert len(simulation.rows) > 25
    result = pincal.calibrate(mechanism, simulation.measurements, noise=EXACT, folds=0)
    both = zip(result.parameters, true.parameters, strict=True)
    missed = [p.identified - t.nominal for p, t in both]
    np.testing.assert_allclose(missed, 0.0, atol=1e-8)
    data = simulation.measurements.rows(slice(10))
    data = replace(data, readings=data.readings[::-1])
    if drives != "fewer":  # readings of other poses are judged, not refused for want of noise
        with pytest.raises(pincal.PincalError, match="miss the nominal mechanism"):
            pincal.calibrate(mechanism, data, noise=EXACT, folds=0)


@pytest.mark.slow
def test_a_platform_that_only_turns() -> None:
    """An Agile eye's elbow and wrist axes are at right angles at every reading, and all return.

    An elbow axis turns about the drive's from home, a wrist axis with the platform.
    """
    mechanism, rng = agile_eye(), np.random.default_rng(4)
    readings = rng.uniform(-0.4, 0.4, (25, 3))
    poses = pincal.forward(mechanism, readings).poses
    R = mechanism.platform.matrices(poses)[:, :3, :3]
    for number in range(3):
        u, w, v = np.roll(np.eye(3), number, axis=1)
        elbow = Rotation.from_rotvec(np.outer(readings[:, number], u)).apply(w)
        np.testing.assert_allclose(np.einsum("ni,nij,j->n", elbow, R, v), 0.0, atol=1e-9)
    assert recovered(mechanism, readings) < 1e-8
    noise = pincal.Noise(orientation=1e-5, reading=1e-6)
    data = pincal.simulate(mechanism, mechanism, poses, noise, seed=1).measurements
    held = {"fixed": "*", "noise": noise, "folds": 0}
    found = pincal.calibrate(mechanism, data, unknown_target=True, **held)  # no position to align
    turn = [u for u in found.external if u.unit == "rad"]
    assert all(abs(u.identified) < 5.0 * u.std < 1e-4 for u in turn)
    pincal.view(mechanism, poses[:2]).with_result(found)  # all axes meet in one point
    candidates = pincal.Plan(poses, readings=readings)
    chosen = pincal.select_configurations(mechanism, candidates, 12, goal="platform", noise=noise)
    assert len(chosen.plan) == 12
    with pytest.raises(pincal.MeasurementError, match="only turns has none"):
        pincal.calibrate(mechanism, data, unknown_frame=True, **held)


def four_bar_gaps(readings: Array, poses: Array) -> Array:
    """Return by how much poses of the imported four-bar miss the cosine law."""
    crank, knee = 0.3 * np.exp(0.7j), 0.4 + 0.65j
    rods = 0.3, abs(knee - crank), abs(knee - 0.9), 0.9
    expected = four_bar_pose(readings[:, 0] + 0.7, *rods)
    expected[:, 2] -= np.angle(knee - crank)  # frames are along x as drawn
    return poses - expected


def coupled_gaps(readings: Array, poses: Array) -> Array:
    """Return by how much rod and conducted link of the imported five-bar miss their ends."""
    x, y, phi = poses.T
    right = 0.1 + np.exp(1j * readings[:, 1]) * (0.1 + 0.2j)
    end = x + 1j * y + np.exp(1j * phi) * (-0.2 + 0.2j)
    reach, knee, conducted = end + 0.1, abs(-0.1 + 0.2j), abs(0.2 + 0.2j)
    cosine = (np.abs(reach) ** 2 + knee**2 - conducted**2) / (2 * np.abs(reach) * knee)
    shoulder = np.angle(reach) + np.arccos(cosine) - np.angle(-0.1 + 0.2j)
    horn = -0.1 + np.exp(1j * shoulder) * (0.08 + 0.03j)
    pin = -0.1 - 0.3j + np.exp(1j * readings[:, 0]) * (0.08 + 0.02j)
    return np.stack((np.abs(right - x - 1j * y), np.abs(horn - pin) - 0.31))


def geared_gaps(readings: Array, poses: Array) -> Array:
    """Return by how much the geared five-bar's distal links miss its cranks."""
    x, y, phi = poses.T
    left = -0.1 + np.exp(1j * readings[:, 0]) * (-0.1 + 0.2j)
    right = 0.1 + np.exp(1j * (0.1 - 1.5 * readings[:, 0])) * (0.1 + 0.2j)
    end = x + 1j * y + np.exp(1j * phi) * (-0.2 + 0.2j)
    return np.stack((np.abs(right - x - 1j * y), np.abs(end - left) - abs(0.2 + 0.2j)))


def delta_gaps(readings: Array, poses: Array) -> Array:
    """Return by how much the imported delta's rods miss their lengths."""
    T, gaps = pincal.Platform.at_origin("spatial").matrices(poses), []
    for i, (foot, arm, knees, points) in enumerate(zip(*neighbours.delta_rods(), strict=True)):
        axis = np.array([-foot[1], foot[0], 0.0]) / 0.2
        turns = Rotation.from_rotvec(np.outer(readings[:, i], axis))
        for knee, point in zip(knees, points, strict=True):
            drawn = np.linalg.norm(point - (0.0, 0.0, 0.4) - foot - arm - knee)
            rods = T[:, :3, :3] @ point + T[:, :3, 3] - foot - turns.apply(arm + knee)
            gaps.append(np.linalg.norm(rods, axis=1) - drawn)
    return np.stack(gaps)


def ankle_gaps(readings: Array, poses: Array) -> Array:
    """Return by how much the imported ankle's rods, and its universal joint, miss their places."""
    T, gaps = pincal.Platform.at_origin("spatial").matrices(poses), []
    for i, (motor, horn, heel) in enumerate(map(np.array, of_rod) for of_rod in neighbours.ANKLE):
        drawn = np.linalg.norm(heel - (0.0, 0.0, 0.35) - motor - horn)
        turns = Rotation.from_rotvec(np.outer(readings[:, i], Y))
        rods = T[:, :3, :3] @ heel + T[:, :3, 3] - motor - turns.apply(horn)
        gaps.append(np.linalg.norm(rods, axis=1) - drawn)
    return np.stack((*gaps, T[:, 1, 0], *(T[:, :3, 3] + (0.0, 0.0, 0.35)).T))


@pytest.mark.parametrize("encoding", ["utf-16", "utf-32", "iso-8859-1"])
def test_loops_are_read_in_the_encoding_that_their_file_declares(
    encoding: str, tmp_path: Path
) -> None:
    """A URDF in another encoding of XML gives the mechanism that it gives in UTF-8."""
    file = neighbours.five_bar(tmp_path / "cad")
    (tmp_path / "again").mkdir()
    done("import", file, "-o", tmp_path / "m")
    robot = file.read_text("utf-8").partition("?>")
    text = f"<?xml version='1.0' encoding='{encoding}'?><!-- é -->{robot[2] or robot[0]}"
    file.write_bytes(text.encode(encoding))
    done("import", file, "-o", tmp_path / "again" / "m")
    first, second = tmp_path / "m", tmp_path / "again" / "m"
    assert pincal.load_mechanism(first) == pincal.load_mechanism(second)


@pytest.mark.parametrize(
    ("write", "gaps", "reach"),
    [
        (neighbours.four_bar, four_bar_gaps, 0.5),
        (neighbours.coupled_five_bar, coupled_gaps, 0.2),
        (neighbours.geared_five_bar, geared_gaps, 0.2),
        pytest.param(neighbours.six_rod_delta, delta_gaps, 0.3, marks=pytest.mark.slow),
        pytest.param(neighbours.ankle, ankle_gaps, 0.25, marks=pytest.mark.slow),
    ],
)
def test_imported_loops(write, gaps, reach: float, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    """Limbs of a user's URDF close where the drawing's dimensions do, and are identified.

    The identified machine goes where the true one does, and so does the user's URDF with its
    origins, balls on a platform and its rods included. Not every parameter need be determined.
    """
    file = write(tmp_path / "cad")
    done("import", file, "-o", tmp_path / "mechanism")
    mechanism = pincal.load_mechanism(tmp_path / "mechanism")
    rng = np.random.default_rng(5)
    readings = rng.uniform(-reach, reach, (40, len(mechanism.reading_names)))
    nominal = pincal.forward(mechanism, readings)
    np.testing.assert_allclose(gaps(readings, nominal.poses), 0.0, atol=1e-9)
    errors = {p.id: p.nominal + 1e-4 * rng.standard_normal() for p in mechanism.parameters}
    true = mechanism.with_parameters(errors)
    poses = pincal.forward(true, readings).poses
    data = pincal.Measurements(readings=readings[:30], poses=poses[:30])
    noise = pincal.Noise(position=1e-7, orientation=1e-7, reading=1e-7)
    identified = pincal.calibrate(mechanism, data, noise=noise).identified
    matrices = mechanism.platform.matrices
    found = pincal.forward(identified, readings[30:]).poses
    np.testing.assert_allclose(matrices(found), matrices(poses[30:]), atol=1e-8)
    true.save(tmp_path / "true")
    done("export", tmp_path / "true", "--original", file, "-o", tmp_path / "robot.urdf")
    (tmp_path / "robot.yaml").write_text(file.with_suffix(".yaml").read_text())
    done("import", tmp_path / "robot.urdf", "-o", tmp_path / "again")
    moved = pincal.forward(tmp_path / "again", readings).poses
    shifts = np.linalg.inv(matrices(poses)) @ matrices(moved)  # a link of its own is the platform
    np.testing.assert_allclose(shifts, shifts[:1] + 0.0 * shifts, atol=1e-9)


def test_points_behind_fixed_links_go_into_the_users_urdf(tmp_path: Path) -> None:
    """Rods end on a foot, a sole fixed to it is the platform: the rods' frames on the foot move.

    They stayed, in silence, so that the exported ankle tilted by 9 mrad from the calibrated one.
    """
    file, name = neighbours.ankle(tmp_path / "cad"), ("--platform", "sole")
    sole = '<link name="sole"/><joint name="sole_fix" type="fixed"><parent link="foot"/>'
    sole += '<child link="sole"/><origin xyz="0.02 0 -0.05"/></joint></robot>'
    file.write_text(file.read_text().replace("</robot>", sole))
    done("import", file, *name, "-o", tmp_path / "mechanism")
    mechanism = pincal.load_mechanism(tmp_path / "mechanism")
    true = pincal.disturb(mechanism, 1e-3, 0)
    true.save(tmp_path / "true")
    done("export", tmp_path / "true", "--original", file, "-o", tmp_path / "robot.urdf")
    (tmp_path / "robot.yaml").write_text(file.with_suffix(".yaml").read_text())
    done("import", tmp_path / "robot.urdf", *name, "-o", tmp_path / "again")
    readings = np.random.default_rng(5).uniform(-0.2, 0.2, (20, 2))
    poses = [pincal.forward(m, readings).poses for m in (true, tmp_path / "again", mechanism)]
    T, exported, nominal = map(mechanism.platform.matrices, poses)
    np.testing.assert_allclose(exported, T, atol=1e-9)
    assert np.abs(nominal - T).max() > 1e-3
    text = file.read_text()
    moved = text.replace(neighbours.vector(*neighbours.ANKLE[0][2]), "-0.05 0.051 0")
    assert moved != text
    file.write_text(moved)
    refused = run("export", tmp_path / "true", "--original", file, "-o", tmp_path / "none.urdf")
    assert "has no frame at the point where" in refused.trouble


CLOSINGS = {
    "constraint": '<constraint name="c" type="{kind}"><parent link="coupler"/><child link="l3"/>'
    '<parent_origin xyz="{0}"/><child_origin xyz="{1}" rpy="1.5707963267948966 0 0"/>'
    '<parent_axis xyz="0 0 1"/><child_axis xyz="0 1 0"/></constraint>',
    "loop_joint": '<loop_joint name="c" type="{kind}"><link1 link="coupler" xyz="{0}"/>'
    '<link2 link="l3" xyz="{1}"/><axis xyz="0 0 1"/></loop_joint>',
    "drake_ball": '<drake:ball_constraint><drake:ball_constraint_body_A name="coupler"/>'
    '<drake:ball_constraint_p_AP value="{0}"/><drake:ball_constraint_body_B name="l3"/>'
    '<drake:ball_constraint_p_BQ value="{1}"/></drake:ball_constraint>',
    "drake_bushing": '<frame name="f" link="coupler" xyz="{0}"/><frame name="g" link="l3" '
    'xyz="{1}"/><drake:linear_bushing_rpy><drake:bushing_frameA name="f"/><drake:bushing_frameC '
    'name="g"/><drake:bushing_torque_stiffness value="9 9 0"/><drake:bushing_force_stiffness '
    'value="9 9 0"/></drake:linear_bushing_rpy>',
}
"""What closes the four-bar of neighbours in a URDF, by ends on the coupler and on the follower."""


MORE_CLOSINGS = [("constraint", "spherical"), ("loop_joint", "revolute")]
MORE_CLOSINGS += [("drake_ball", ""), ("drake_bushing", "")]


@pytest.mark.parametrize(
    ("form", "kind"),
    [
        ("constraint", "revolute"),
        ("loop_joint", "spherical"),
        *(pytest.param(*case, marks=pytest.mark.slow) for case in MORE_CLOSINGS),
    ],
)
def test_a_urdf_may_close_its_loops_itself(form: str, kind: str, tmp_path: Path) -> None:
    """A four-bar goes by the cosine law however its URDF closes it; <transmission> drives it."""
    crank, knee = 0.3 * np.exp(0.7j), 0.4 + 0.65j
    ends = (neighbours.vector(w.real, w.imag, 0.0) for w in (knee - crank, knee - 0.9))
    drive = '<transmission name="t"><joint name="crank"/></transmission>'
    text = neighbours.four_bar(tmp_path).read_text()
    text = text.replace("<robot", '<robot xmlns:drake="http://drake.mit.edu"')
    closing = CLOSINGS[form].format(*ends, kind=kind)
    (tmp_path / "closed.urdf").write_text(text.replace("</robot>", f"{drive}{closing}</robot>"))
    (tmp_path / "robot.yaml").unlink()
    done("import", tmp_path / "closed.urdf", "-o", tmp_path / "four_bar")
    readings = np.linspace(-0.5, 0.5, 9)[:, None]
    found = pincal.forward(tmp_path / "four_bar", readings)
    np.testing.assert_allclose(four_bar_gaps(readings, found.poses), 0.0, atol=1e-9)


@pytest.mark.parametrize(
    ("write", "platform"),
    [
        (neighbours.four_bar, "coupler"),
        pytest.param(neighbours.coupled_five_bar, "b2", marks=pytest.mark.slow),
        pytest.param(neighbours.six_rod_delta, "top", marks=pytest.mark.slow),
        pytest.param(neighbours.ankle, "foot", marks=pytest.mark.slow),
    ],
)
def test_sdf_is_the_machine_that_a_urdf_is(write, platform: str, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    """Written as SDF in frames drawn at random, a machine has equal legs, and moves as before."""
    file = write(tmp_path / "cad")
    asked = ("--platform", platform, "-o")
    sdf = neighbours.as_sdf(file, 1).rename(tmp_path / "robot.sdf")
    done("import", file, *asked, tmp_path / "urdf")
    done("import", sdf, *asked, tmp_path / "sdf")
    urdf, mechanism = (pincal.load_mechanism(tmp_path / form) for form in ("urdf", "sdf"))
    assert len(urdf.parameters) == len(mechanism.parameters)
    names = [[sensor.joint for leg in m.legs for sensor in leg.sensors] for m in (urdf, mechanism)]
    readings = np.random.default_rng(2).uniform(-0.2, 0.2, (10, len(names[0])))
    poses = pincal.forward(urdf, readings).poses
    again = pincal.forward(mechanism, readings[:, [names[0].index(name) for name in names[1]]])
    shifts = mechanism.platform.matrices(again.poses) @ np.linalg.inv(urdf.platform.matrices(poses))
    np.testing.assert_allclose(shifts, shifts[:1] + 0.0 * shifts, atol=1e-12)  # of the base


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('<pose relative_to="', '<pose degrees="true" relative_to="', "'degrees' may place links"),
        ("</model>", "<include><uri>a</uri></include></model>", "one model, without <include>"),
        ('version="1.9"', 'version="1.4"', "SDF 1.5 or newer"),
        ("<parent>base</parent>", "<parent>floor</parent>", "it is on 'floor', which is no link"),
        ('type="revolute"', 'type="screw"', "is of type 'screw'"),
        ("<axis>", "<axis><thread_pitch/>", "'thread_pitch' may place links"),
    ],
)
def test_sdf_that_is_not_read_is_refused(old: str, new: str, words: str, tmp_path: Path) -> None:
    """What may place a link is read, or refused by its name and line; no folder is written."""
    file = neighbours.as_sdf(neighbours.four_bar(tmp_path), 0)
    file.write_text(file.read_text().replace(old, new))
    outcome = run("import", file, "-o", tmp_path / "out")
    assert (outcome.code, (tmp_path / "out").exists()) == (2, False)
    assert words in outcome.trouble


def test_a_universal_joint_may_close_a_loop(tmp_path: Path) -> None:
    """An ankle whose foot hangs on a rod, and on the shin by a <constraint>, turns as drawn."""
    file = neighbours.ankle(tmp_path)
    hanging = [neighbours.joint("sole", "tip0", "foot0", kind="continuous")]
    text, yaml = file.read_text(), (tmp_path / "robot.yaml").read_text()
    for name in ("pitch", "roll"):
        start = text.index(f'<joint name="{name}"')
        text = text[:start] + text[text.index("</joint>", start) + len("</joint>") :]
    heel = np.array(neighbours.ANKLE[0][2])
    hanging.append(neighbours.joint("held", "foot0", "foot", neighbours.vector(*-heel), "fixed"))
    closing = (
        '<constraint name="cross" type="universal"><parent link="shin"/><child link="foot"/>'
        '<parent_origin xyz="0 0 -0.35"/><parent_axis xyz="0 2 0"/><child_axis xyz="1 0 0"/>'
        "</constraint>"
    )
    text = text.replace('<link name="cross"/>', '<link name="foot0"/>')
    file.write_text(text.replace("</robot>", f"{''.join(hanging)}{closing}</robot>"))
    yaml = yaml.replace("[[rod_end0, heel0], ", "[").replace("[3d, 3d]", "[3d]")
    yaml = yaml.replace("[ball0", "[sole, ball0").replace("[SPHERICAL", "[SPHERICAL, SPHERICAL")
    (tmp_path / "robot.yaml").write_text(yaml)
    done("import", file, "-o", tmp_path / "mechanism")
    readings = np.random.default_rng(5).uniform(-0.25, 0.25, (10, 2))
    poses = pincal.forward(tmp_path / "mechanism", readings).poses
    np.testing.assert_allclose(ankle_gaps(readings, poses), 0.0, atol=1e-9)


def test_gears_go_to_mujoco_and_come_back(tmp_path: Path) -> None:
    """MuJoCo closes loops and gears of an exported five-bar at home; imported, it moves alike."""
    mujoco = pytest.importorskip("mujoco")
    done("import", neighbours.geared_five_bar(tmp_path / "cad"), "-o", tmp_path / "geared")
    done("export", tmp_path / "geared", "-o", tmp_path / "geared.xml")
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "geared.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    assert (model.eq_type == mujoco.mjtEq.mjEQ_JOINT).sum() == 1
    np.testing.assert_allclose(data.efc_pos, 0.0, atol=1e-9)
    done("import", tmp_path / "geared.xml", "-o", tmp_path / "again")
    readings = np.linspace(-0.2, 0.2, 9)[:, None]
    poses = [pincal.forward(tmp_path / name, readings).poses for name in ("geared", "again")]
    np.testing.assert_allclose(*poses, atol=1e-9)


def test_an_arm_with_a_geared_elbow(tmp_path: Path) -> None:
    """A palletizer's forearm that turns back as the upper arm turns keeps its direction."""
    joint = neighbours.joint
    joints = [joint("pan", "base", "post"), joint("lift", "post", "upper", axis="0 1 0")]
    gear = '<mimic joint="lift" multiplier="-1" offset="0.5"/>'
    joints.append(joint("elbow", "upper", "fore", "0 0 0.6", axis="0 1 0", limit=gear))
    joints.append(joint("flange", "fore", "tool", "0.4 0 0", "fixed"))
    (tmp_path / "arm.urdf").write_text(neighbours.urdf("arm", joints, "base"))
    done("import", tmp_path / "arm.urdf", "--tip", "tool", "-o", tmp_path / "arm")
    readings = np.random.default_rng(0).uniform(-1.0, 1.0, (20, 2))
    T = Platform.at_origin("spatial").matrices(pincal.forward(tmp_path / "arm", readings).poses)
    turn = Rotation.from_euler("ZY", np.stack((readings[:, 0], np.full(20, 0.5)), axis=1))
    np.testing.assert_allclose(T[:, :3, :3], turn.as_matrix(), atol=1e-12)
    reach = 0.6 * np.sin(readings[:, 1]) + 0.4 * np.cos(0.5)
    along = np.stack((np.cos(readings[:, 0]), np.sin(readings[:, 0])), axis=1)
    np.testing.assert_allclose(T[:, :2, 3], reach[:, None] * along, atol=1e-12)
    mechanism = pincal.load_mechanism(tmp_path / "arm")
    assert {"elbow_x", "elbow_rx"} < set(mechanism.legs[0].parameter_names)
    rng = np.random.default_rng(1)
    errors = {p.id: 1e-3 * rng.standard_normal() for p in mechanism.parameters}
    poses = pincal.forward(mechanism.with_parameters(errors), readings).poses
    data = pincal.Measurements(readings=readings[:15], poses=poses[:15])
    identified = pincal.calibrate(mechanism, data, noise=EXACT, folds=0).identified
    np.testing.assert_allclose(pincal.forward(identified, readings).poses, poses, atol=1e-8)


def test_trees_go_to_mujoco_and_come_back(tmp_path: Path) -> None:
    """MuJoCo closes all loops of an exported six-rod delta at home; imported, it moves alike."""
    mujoco = pytest.importorskip("mujoco")
    mechanism = six_rods()
    mechanism.save(tmp_path / "six")
    done("export", tmp_path / "six", "-o", tmp_path / "six.xml")
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "six.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    assert model.neq == 6
    np.testing.assert_allclose(data.efc_pos[: 3 * model.neq], 0.0, atol=1e-9)
    done("import", tmp_path / "six.xml", "-o", tmp_path / "again")
    home = np.array([leg.home[0] for leg in mechanism.legs])
    readings = home + np.random.default_rng(1).uniform(-0.2, 0.2, (10, 3))
    poses = [pincal.forward(name, readings).poses for name in (mechanism, tmp_path / "again")]
    np.testing.assert_allclose(*map(mechanism.platform.matrices, poses), atol=1e-9)


@pytest.mark.parametrize("ends", ["[rod_end, hook]", "[hook, rod_end]"])
def test_a_loop_may_close_on_a_link_that_carries_it(ends: str, tmp_path: Path) -> None:
    """A cylinder from shin to thigh bends the knee: the foot is where the cosine law puts it."""
    knee, hook, pin, bend = 0.4 + 0.0j, 0.1 + 0.05j, 0.15 + 0.04j, 0.6
    place = lambda w: neighbours.vector(w.real, w.imag, 0.0)  # noqa: E731
    rod = hook - knee - pin * np.exp(1j * bend)  # as drawn, in the thigh's frame
    along = rod / abs(rod) * np.exp(-1j * bend)
    slide = neighbours.joint("ram", "cylinder", "rod", kind="prismatic", axis=place(along))
    joints = [
        neighbours.joint("hip", "base", "thigh", "0 0.9 0"),
        neighbours.joint("knee", "thigh", "shin", place(knee), rpy=f"0 0 {bend}"),
        neighbours.joint("pin", "shin", "cylinder", place(pin)),
        slide.replace("<limit", '<limit lower="-0.2" upper="0.2"'),
        neighbours.joint("rod_end", "rod", "rod_tip", place(abs(rod) * along), "fixed"),
        neighbours.joint("hook", "thigh", "thigh_hook", place(hook), "fixed"),
        neighbours.joint("ankle", "shin", "foot", "0.45 0 0"),
    ]
    yaml = f"closed_loop: [{ends}]\ntype: [3d]\nname_mot: [hip, ram, ankle]\nplatform: foot\n"
    file = neighbours.written(tmp_path, neighbours.urdf("leg", joints, "base"), yaml)
    done("import", file, "-o", tmp_path / "leg")
    mechanism = pincal.load_mechanism(tmp_path / "leg")
    bends, hips, ankles = np.random.default_rng(0).uniform(-0.5, 0.5, (3, 40))
    reach = np.abs(hook - knee - pin * np.exp(1j * (bend + bends)))
    columns = {"hip": hips, "ram": reach - abs(rod), "ankle": ankles}
    order = [sensor.joint for sensor in mechanism.legs[0].sensors]
    readings = np.stack([columns[name] for name in order], axis=1)
    foot = 0.9j + np.exp(1j * hips) * (knee + 0.45 * np.exp(1j * (bend + bends)))
    T = mechanism.platform.matrices(pincal.forward(mechanism, readings).poses)
    np.testing.assert_allclose(T[:, 0, 3] + 1j * T[:, 1, 3], foot, atol=1e-9)
    assert recovered(mechanism, readings, 1e-4) < 1e-8


@pytest.mark.slow
def test_samples_lead_from_home_to_the_branch_that_closes(tmp_path: Path) -> None:
    """Where arms of a delta turn all round, exact rows of a machine 2 mm off close at it."""
    done("import", neighbours.six_rod_delta(tmp_path / "delta"), "-o", tmp_path / "imported")
    mechanism, none = pincal.load_mechanism(tmp_path / "imported"), pincal.Noise(0.0, 0.0, 0.0)
    truth, plan = pincal.disturb(mechanism, 2e-3), pincal.sample_configurations(mechanism, 300)
    data = pincal.simulate(mechanism, truth, plan, none).measurements
    assert len(data) > 250
    result = pincal.calibrate(truth, data, noise=pincal.Noise(1e-6, 1e-6, 1e-6), folds=0)
    assert {finding.code for finding in result.findings} <= {"chi2-too-small"}


@pytest.mark.slow
def test_more_drives_than_freedoms_lead_to_the_branch_that_was_planned() -> None:
    """A plan's poses and readings close all loops from home, also of a machine with errors.

    A boom and a stick, whose joints are read beside their cylinders, are planned all the way round.
    """
    nominal = hybrid()
    leg = nominal.legs[0]
    read = (*leg.sensors, Sensor("foot_1"), Sensor("stick"))
    mechanism = replace(nominal, legs=(replace(leg, sensors=read),))
    assert mechanism.redundant
    plan = pincal.sample_configurations(mechanism, 60)
    exact = pincal.Noise(0.0, 0.0, 1e-9)
    truth = pincal.disturb(mechanism, 1e-4, seed=1)
    measured = pincal.simulate(mechanism, truth, plan, exact).measurements
    assert len(measured) == len(plan)
    noise = pincal.Noise(1e-8, 1e-8, 1e-8)
    result = pincal.calibrate(mechanism, measured, noise=noise, folds=0)
    errors = [p.identified - truth.parameters[p.id].nominal for p in result.parameters]
    np.testing.assert_allclose(errors, 0.0, atol=1e-6)


@pytest.mark.slow
def test_cylinders_on_the_platform_close_in_their_plane(tmp_path: Path) -> None:
    """An excavator that MuJoCo has: its second cylinder meets the link that is the platform.

    Across the plane of its loop nothing is asked of its parameters, and it calibrates.
    """
    pytest.importorskip("mujoco")
    hybrid().save(tmp_path / "hybrid")
    done("export", tmp_path / "hybrid", "-o", tmp_path / "hybrid.xml")
    done("import", tmp_path / "hybrid.xml", "-o", tmp_path / "again")
    mechanism = pincal.load_mechanism(tmp_path / "again")
    assert [end.closes for end in mechanism.legs[0].ends] == [("x", "y"), ("x", "y")]
    home = mechanism.legs[0].home[mechanism.legs[0].active]
    readings = home + np.random.default_rng(0).uniform(-0.1, 0.1, (40, 3))
    poses = pincal.forward(pincal.disturb(mechanism, 1e-4, seed=1), readings).poses
    data = pincal.Measurements(readings=readings[:30], poses=poses[:30])
    identified = pincal.calibrate(mechanism, data, noise=EXACT, folds=0).identified
    np.testing.assert_allclose(pincal.forward(identified, readings).poses, poses, atol=1e-8)
