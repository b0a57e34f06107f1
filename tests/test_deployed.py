"""What a controller gets: kinematics that need nothing of pincal, equal to pincal's."""

from __future__ import annotations

import re
import runpy
import shutil
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from arms import loaded
from command_line import done
from deployed import in_c, in_python
from linuxcnc import MODULES, LinuxcncKinematics
from marks import quick
from measured import seen_from_elsewhere, workspace
from neighbours import coupled_five_bar, four_bar
from scipy.spatial.transform import Rotation
from test_deformations import machine_of, plan_of

import pincal
from pincal.formats.data_sheet import deltakins, genhexkins
from pincal.formats.deployed import Deployed
from pincal.kinematics.closure import joint_range
from pincal.kinematics.configurations import joints_at

BUNDLED = ["3RRR", "8cable", "delta", "5R", "6UPS", "3RPS", "3PUU", "3PRR", "3RPR", "4cable"]


def equal_at(machine: pincal.Mechanism, plan: pincal.Plan, folder: Path) -> None:
    """Compare both files with pincal at configurations: readings and poses to 1e-9."""
    near, used = None, {k: v for k, v in plan.influences.items() if k in machine.influences}
    plan = replace(plan, influences=used)
    if machine.by_readings:  # readings do not follow from poses: near those planned
        solved = pincal.forward(machine, plan.readings, influences=plan.influences)
        poses, readings = solved.poses, plan.readings
        planned = pincal.Plan(poses, readings=readings, influences=plan.influences)
        joints = joints_at(machine, planned).joints
        near = [
            [(joints[leg][row] + 0.02).tolist() for leg in machine.leg_names]
            for row in range(len(plan))
        ]
    else:
        poses = plan.poses
        readings = pincal.inverse(machine, poses, used).readings
    matrices = machine.platform.matrices(poses)[:, :3].reshape(len(plan), 12)
    deployed = Deployed(machine)
    files = [in_python(deployed)]
    if shutil.which("cc"):
        files.append(in_c(deployed, folder))
    for inverse, forward in files:
        for row, (T, wanted) in enumerate(zip(matrices, readings, strict=True)):
            columns = [
                plan.influences.get(name, np.full(len(plan), np.nan))[row]
                for name in machine.influences
            ]
            values, _, reached = inverse(T, columns, near and near[row])
            assert reached
            np.testing.assert_allclose(values, wanted, rtol=0.0, atol=1e-9)
            values, _, reached = forward(wanted, columns)
            assert reached
            np.testing.assert_allclose(values, T, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("name", quick(1, [*BUNDLED, "6PUS", "6RUS", "linear_delta"]))
def test_files_are_pincal_over_the_workspace(name: str, tmp_path: Path) -> None:
    """A machine off by 1 mm and mrad, all over its workspace: the same readings and poses."""
    machine = pincal.disturb(pincal.load_mechanism(name), 1e-3, seed=1)
    equal_at(machine, pincal.sample_configurations(machine, 12, seed=3), tmp_path)


@pytest.mark.parametrize(
    ("name", "of"),
    quick(1, [("ur5", "load"), ("3RRR", "temperature"), ("6UPS", "temperature")]),
)
def test_files_know_what_bends_and_grows(name: str, of: str, tmp_path: Path) -> None:
    """Lengths and angles that follow temperature or gravity's loads: computed by the files too."""
    _, machine = machine_of(name, of)
    equal_at(machine, plan_of(machine, 6), tmp_path)


@pytest.mark.parametrize("write", quick(1, [four_bar, coupled_five_bar]))
def test_files_close_loops_within_legs(write: Callable[[Path], Path], tmp_path: Path) -> None:
    """A four-bar, and a five-bar with a loop within a leg: readings and poses as pincal's."""
    done("import", write(tmp_path / "drawn"), "-o", tmp_path / "mech")
    machine = pincal.load_mechanism(str(tmp_path / "mech"))
    plan = pincal.sample_configurations(machine, 6, seed=1)
    equal_at(machine, plan, tmp_path)


def test_a_folder_for_the_controller(tmp_path: Path) -> None:
    """Frames and standard errors are those of the result; nothing is overwritten unasked."""
    robot = pincal.load_mechanism("5R")
    truth, poses = pincal.disturb(robot, 1e-3, seed=1), workspace("5R", 30)
    data = pincal.simulate(
        robot, truth, pincal.Plan(poses), pincal.Noise(1e-5), seed=1
    ).measurements
    data = seen_from_elsewhere(robot, data)
    setup = pincal.Setup(unknown_frame=True)
    result = pincal.calibrate(robot, data, noise=pincal.Noise(1e-5), setup=setup)
    pincal.deploy(result, tmp_path / "controller")
    sheet = (tmp_path / "controller" / "geometry.csv").read_text().splitlines()
    rows = [line.split(",") for line in sheet]
    (length,) = [row for row in rows if row[:2] == ["leg_1", "rod length"]]
    np.testing.assert_allclose(float(length[3]), result["leg_1.L"].identified, atol=1e-9)
    np.testing.assert_allclose(float(length[4]), result["leg_1.L"].std, rtol=5e-3)
    names: dict[str, Any] = {}
    exec((tmp_path / "controller" / "kinematics.py").read_text(), names)
    seen = robot.platform.matrices(data.poses)[:, :3].reshape(len(data), 12)
    readings = np.array([names["inverse"](names["in_base"](T.tolist())).values for T in seen])
    assert np.sqrt(np.mean((readings - data.readings) ** 2)) < 3e-5
    again = names["in_frame"](names["in_base"](seen[0].tolist()))
    np.testing.assert_allclose(again, seen[0], atol=1e-12)
    result.save(tmp_path / "result")
    done("deploy", tmp_path / "result", "-o", tmp_path / "again")
    for file in ("kinematics.py", "5r.h", "geometry.csv", "commanding.md"):
        name = file.replace("5r", "machine_5r")
        texts = [(tmp_path / folder / name).read_text() for folder in ("controller", "again")]
        assert texts[0] == texts[1]
    done("deploy", tmp_path / "result", "-o", tmp_path / "mm", "--units", "mm,deg")
    lines = (tmp_path / "mm" / "geometry.csv").read_text().splitlines()
    (sheet_length,) = [line.split(",") for line in lines if line.startswith("leg_1,rod length")]
    np.testing.assert_allclose(float(sheet_length[3]), 1e3 * float(length[3]))
    assert sheet_length[5] == "mm"
    with pytest.raises(pincal.FileError):
        pincal.deploy(result, tmp_path / "controller")


@pytest.mark.parametrize("name", quick(1, ["delta", "6UPS"]))
def test_poses_as_measured_have_the_readings_that_were_read(name: str, tmp_path: Path) -> None:
    """In the tracker's frame, of a point somewhere on the platform: to the noise."""
    robot, noise = pincal.load_mechanism(name), pincal.Noise(1e-7, 1e-7)
    truth, plan = pincal.disturb(robot, 1e-3, seed=1), pincal.Plan(workspace(name, 30))
    data = pincal.simulate(robot, truth, plan, noise, seed=1).measurements
    seen = seen_from_elsewhere(robot, data, (0.02, -0.01, 0.03), 0.2 * (name == "6UPS"))
    setup = pincal.Setup(unknown_frame=True).anywhere(frame=True, target=name == "6UPS")
    result = pincal.calibrate(robot, seen, noise=noise, setup=setup)
    readings = pincal.inverse(result.identified, result.in_base(seen.poses)).readings
    np.testing.assert_allclose(readings, data.readings, atol=2e-6)
    result.save(tmp_path / "result")
    pincal.Plan(seen.poses).to_csv(tmp_path / "seen.csv", robot)
    files = tmp_path / "seen.csv", "-o", tmp_path / "r.csv"
    done("inverse", tmp_path / "result", *files, "--as-measured")
    written = np.loadtxt(tmp_path / "r.csv", delimiter=",", skiprows=1)
    np.testing.assert_allclose(written, readings, atol=1e-9)


def test_what_is_not_determined_has_no_standard_error(tmp_path: Path) -> None:
    """Three poses of a five-bar: rods have no ±, and the page says that no limit is stated."""
    robot = pincal.load_mechanism("5R")
    plan, truth = pincal.Plan(workspace("5R", 3)), pincal.disturb(robot, 1e-3, seed=1)
    data = pincal.simulate(robot, truth, plan, pincal.Noise(1e-5), seed=1).measurements
    result = pincal.calibrate(robot, data, noise=pincal.Noise(1e-5))
    assert np.isinf(result["leg_1.L"].std)
    pincal.deploy(result, tmp_path / "controller")
    sheet = (tmp_path / "controller/geometry.csv").read_text().splitlines()
    (length,) = [line for line in sheet if line.startswith("leg_1,rod length,")]
    assert length.split(",")[4] == ""
    assert "states no limit" in (tmp_path / "controller/commanding.md").read_text()


def ways(robot: pincal.Mechanism, poses: np.ndarray, folder: Path) -> tuple[int, int]:
    """Return how many poses an arm's files find without joints near by, and how many within limits.

    Both files find the same joints, within 1e-9.
    """
    deployed, (leg,) = Deployed(robot), robot.legs
    (inverse, _), (in_c99, _) = in_python(deployed), in_c(deployed, folder)
    low, high = joint_range(leg)
    reached = within = 0
    for T in robot.platform.matrices(poses)[:, :3].reshape(-1, 12):
        values, joints, solved = inverse(T, None, None)
        if solved:
            np.testing.assert_allclose(in_c99(T, None, None)[0], values, rtol=0.0, atol=1e-9)
            q = np.array(joints[0])
            reached += 1
            within += bool(((low - 1e-9 <= q) & (q <= high + 1e-9)).all())
    return reached, within


@pytest.mark.skipif(not shutil.which("cc"), reason="no C compiler")
@pytest.mark.parametrize("name", quick(1, ["ur5", "panda", "kinova"]))
def test_an_arm_is_found_all_over_its_workspace(name: str, tmp_path: Path) -> None:
    """Without joints near by: 99 of 100 poses at least, within limits too, by both files."""
    robot = pincal.disturb(loaded(name), 1e-3, seed=1)
    count = 40 if name == "ur5" else 200
    reached, within = ways(robot, pincal.sample_configurations(robot, count, 3).poses, tmp_path)
    assert reached >= 0.99 * count
    assert within >= 0.99 * count


@pytest.mark.slow
def test_an_arm_that_bends_is_found_all_over_its_workspace(tmp_path: Path) -> None:
    """With loads of gravity, which follow from the joints that are sought."""
    _, robot = machine_of("ur5", "load")
    reached, within = ways(robot, pincal.sample_configurations(robot, 200, 3).poses, tmp_path)
    assert min(reached, within) >= 0.99 * 200


@pytest.mark.parametrize("at_home", [True, False])
def test_an_arm_says_which_poses_are_found_without_near(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *, at_home: bool
) -> None:
    """So many as the file itself finds, home not counted; the example's pose is found, to 1e-9."""
    monkeypatch.setattr("pincal.show.deployment._TRIED", 25)  # of 100
    robot = loaded("ur5")
    if not at_home:
        far = [np.full((1, 6), 9.0)]
        monkeypatch.setattr("pincal.show.deployment.command", lambda *_: far)
    pincal.deploy(robot, tmp_path / "controller")
    page = (tmp_path / "controller/commanding.md").read_text()
    (numbers,) = re.findall(r"(\d+) of (\d+) poses\s+of the workspace, (\d+) within", page)
    found, tried, within = map(int, numbers)
    file = runpy.run_path(str(tmp_path / "controller/kinematics.py"))
    poses = pincal.sample_workspace(robot, tried).tolist()
    solutions = [file["inverse"](file["pose"](*pose)) for pose in poses]
    reached = [solution.joints for solution in solutions if not solution.reason]
    assert len(reached) == found >= 24
    assert tried == 25
    assert sum(not file["beyond_limits"](joints) for joints in reached) == within
    shown = re.findall(r"T = pose\((.*)\)  #", page)[0].split(", ")
    T = file["pose"](*map(float, shown))
    readings, _, reason = file["inverse"](T)
    assert not reason
    pose = pincal.forward(robot, np.array([readings])).poses
    matrix = robot.platform.matrices(pose)[0, :3].ravel()
    np.testing.assert_allclose(matrix, T, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("name", quick(1, ["5R", "ur5", "6UPS", "delta"]))
def test_arguments_without_meaning_have_a_reason(name: str, tmp_path: Path) -> None:
    """Numbers that are not finite or too large, and matrices that do not turn: by both files."""
    machine = loaded(name) if name == "ur5" else pincal.load_mechanism(name)
    bent = pincal.Term("bend", pincal.Power(power=20, range=2.0))
    leg = machine.legs[0]
    sensors = (replace(leg.sensors[0], terms=(bent,)), *leg.sensors[1:])
    leg = replace(leg, sensors=sensors, parameters=(*leg.parameters, ("bend", 1e-6)))
    machine = replace(machine, legs=(leg, *machine.legs[1:]))
    deployed = Deployed(machine)
    files = [in_python(deployed)]
    if shutil.which("cc"):
        files.append(in_c(deployed, tmp_path))
    for inverse, forward in files:
        readings = np.array(deployed.tables["home_readings"])
        T, near, found = forward(readings, None)
        assert found
        assert inverse(np.array(T), None, near)[2]
        for value in (np.nan, np.inf, -np.inf, 1e308, 1e13, 1e11, -1e6):
            solve = [(np.array(T), partial(inverse, influences=None, near=None))]
            solve += [(readings, partial(forward, influences=None))]
            for sound, kinematics in solve:
                for place in range(len(sound)):
                    arguments = sound.copy()
                    arguments[place] = value
                    values, _, found = kinematics(arguments)
                    assert not found or (np.isfinite(values).all() and abs(value) <= 1e12)
        for factors in (0.0, 2.0, np.repeat([1.0, 1.0, -1.0], 4)):
            assert not inverse(factors * np.array(T), None, None)[2]


def test_terms_that_no_file_can_hold_are_refused(tmp_path: Path) -> None:
    """A term that is a function of the user's own; the message names what makes up for it."""
    robot = pincal.load_mechanism("5R")
    term = pincal.Term("own", np.tanh, lambda value: 1.0 / np.cosh(value) ** 2)
    leg = robot.legs[0]
    sensor = replace(leg.sensors[0], terms=(term,))
    leg = replace(leg, sensors=(sensor,), parameters=(*leg.parameters, ("own", 1e-4)))
    with pytest.raises(pincal.MechanismError, match="readings of your poses"):
        pincal.deploy(replace(robot, legs=(leg, robot.legs[1])), tmp_path / "controller")
    assert not (tmp_path / "controller").exists()


def laws(text: str) -> np.ndarray:
    """Return what joints are by HAL lines: at reading 0, and by reading, shape (N, 2)."""
    lines = re.findall(r"^# joint \d \[\w+\] = (\S+) \+ (\S+) × reading", text, re.MULTILINE)
    return np.array(lines, dtype=float)


def test_joint_centres_are_those_that_genhexkins_asks_for() -> None:
    """Strut lengths by centres of the HAL lines: what the readings of poses say, to 1e-9 m."""
    robot = pincal.disturb(pincal.load_mechanism("6UPS"), 1e-3, seed=1)
    text, poses = genhexkins(robot), workspace("6UPS", 20)
    pins = dict(line.split()[1:] for line in text.splitlines() if line.startswith("setp "))
    T, readings = robot.platform.matrices(poses), pincal.inverse(robot, poses).readings

    def centre(owner: str, strut: int) -> np.ndarray:
        return np.array([float(pins[f"genhexkins.{owner}.{strut}.{axis}"]) for axis in "xyz"])

    for strut, (zero, slope) in enumerate(laws(text)):
        tips = T[:, :3, :3] @ centre("platform", strut) + 1e3 * T[:, :3, 3]
        length = np.linalg.norm(tips - centre("base", strut), axis=1)
        np.testing.assert_allclose(length, zero + slope * 1e3 * readings[:, strut], atol=1e-6)
    with pytest.raises(pincal.MechanismError, match="no hexapod"):
        genhexkins(pincal.load_mechanism("6RUS"))


@pytest.mark.slow
@pytest.mark.skipif(not MODULES.is_dir(), reason="no LinuxCNC (LINUXCNC_MODULES)")
@pytest.mark.parametrize("name", ["6UPS", "delta", "linear_delta"])
def test_linuxcnc_itself_drives_to_the_readings(name: str) -> None:
    """Its own modules give pincal's readings and poses to 1e-6 mm or deg, set up by HAL lines.

    A hexapod with errors, and deltas as drawn, which are all that these modules can hold.
    """
    robot, poses = pincal.load_mechanism(name), workspace(name, 200)
    if name == "6UPS":
        robot = pincal.disturb(robot, 1e-3, seed=1)
    T = robot.platform.matrices(poses)
    text = genhexkins(robot) if name == "6UPS" else deltakins(robot, poses)
    kind = "genhexkins" if name == "6UPS" else text.split()[1]
    commands, legs = placed(text, T), in_order(text, robot)
    kinematics = LinuxcncKinematics(kind, text)
    joints = np.array([kinematics.inverse(command, len(legs)) for command in commands])
    unit = np.radians(1.0) if kind == "rotarydeltakins" else 1e-3
    readings = pincal.inverse(robot, poses).readings[:, legs] / unit
    zeros, slopes = laws(text).T
    np.testing.assert_allclose(joints, zeros + slopes * readings, rtol=0.0, atol=1e-6)
    pairs = zip(commands, joints, strict=True)
    poses = np.array([kinematics.forward(driven, command + 0.1) for command, driven in pairs])
    missed = np.abs(poses - commands)[:, : len(legs)]
    assert np.isnan(missed).any(axis=1).mean() <= 0.01  # where its Newton iteration does not end
    assert np.nanmax(missed) < 1e-6


def placed(text: str, T: np.ndarray) -> np.ndarray:
    """Return X Y Z A B C [mm], [deg] of poses in the work offset of HAL lines, shape (N, 6)."""
    offset = re.findall(r" [XYZR](-?[\d.]+)", text.splitlines()[-1]) or [0.0] * 4
    X, Y, Z, R = map(float, offset)
    xyz = Rotation.from_euler("z", R, degrees=True).apply(1e3 * T[:, :3, 3]) + np.array([X, Y, Z])
    return np.hstack((xyz, Rotation.from_matrix(T[:, :3, :3]).as_euler("xyz", degrees=True)))


def in_order(text: str, robot: pincal.Mechanism) -> list[int]:
    """Return places of the legs that HAL lines name, in the order of joints."""
    return [robot.leg_names.index(leg) for leg in re.findall(r"reading of (\w+)", text)]


def linuxcnc(kind: str, pins: dict[str, float], xyz: np.ndarray) -> list[float]:
    """Return LinuxCNC's joints at a position [mm], as its deltas' common.h compute them."""
    joints: list[float] = []
    x, y, z = xyz
    for turn in (0.0, -2.0 * np.pi / 3.0, 2.0 * np.pi / 3.0):
        u, v = x * np.cos(turn) - y * np.sin(turn), x * np.sin(turn) + y * np.cos(turn)
        if kind == "lineardeltakins":
            joints.append(z + np.sqrt(pins["L"] ** 2 - u**2 - (pins["R"] - v) ** 2))
            continue
        hip, thigh, shin, foot = (
            pins[n] for n in ("platformradius", "thighlength", "shinlength", "footradius")
        )
        a = 0.5 * (u**2 + (v - foot) ** 2 + z**2 + thigh**2 - shin**2 - hip**2) / z
        b = (foot - hip - v) / z
        knee = (hip + a * b + np.sqrt(thigh**2 * (b**2 + 1.0) - (a - b * hip) ** 2)) / (b**2 + 1.0)
        joints.append(np.degrees(np.arctan2(b * knee - a, knee - hip)))
    return joints


def by_lines(text: str, robot: pincal.Mechanism, poses: np.ndarray) -> np.ndarray:
    """Return the readings to which LinuxCNC's formulas drive a delta by HAL lines, SI."""
    kind = text.split()[1]
    pins = {k: float(v) for k, v in re.findall(rf"setp {kind}\.(\w+) (\S+)", text)}
    commands = placed(text, robot.platform.matrices(poses))
    joints = np.array([linuxcnc(kind, pins, command[:3]) for command in commands])
    zeros, slopes = laws(text).T
    readings = np.empty_like(joints)
    unit = 1e-3 if kind == "lineardeltakins" else np.radians(1.0)
    readings[:, in_order(text, robot)] = unit * (joints - zeros) / slopes
    return readings


@pytest.mark.slow
@pytest.mark.parametrize("name", ["delta", "linear_delta"])
def test_the_error_that_linuxcnc_leaves_is_that_of_other_poses(name: str, tmp_path: Path) -> None:
    """Of 95 % of poses, to 8 %: so much two samples of thousands of poses may differ."""
    robot = pincal.disturb(pincal.load_mechanism(name), 1e-3, seed=2)
    pincal.deploy(robot, tmp_path / "controller")
    text = (tmp_path / "controller" / "linuxcnc.hal").read_text()
    poses = pincal.sample_workspace(robot, 3000, 7)
    missed = np.linalg.norm(
        pincal.forward(robot, by_lines(text, robot, poses)).poses - poses, axis=1
    )
    (said,) = re.findall(r"poses by (\S+) mm \(95", text)
    assert 1e3 * np.quantile(missed, 0.95) == pytest.approx(float(said), rel=0.08)


@pytest.mark.parametrize("name", ["delta", "linear_delta"])
def test_deltas_are_those_that_linuxcnc_has_kinematics_for(name: str, tmp_path: Path) -> None:
    """By its formulas, to 1e-6 mm or deg as drawn; of others the lines say how far they miss."""
    drawn = pincal.load_mechanism(name)
    poses = workspace(name, 60)
    for robot in (drawn, pincal.disturb(drawn, 1e-3, seed=1)):
        text = deltakins(robot, poses)
        readings = by_lines(text, robot, poses)
        if robot is drawn:
            exact = pincal.inverse(robot, poses).readings
            unit = np.pi / 180.0 if name == "delta" else 1e-3
            np.testing.assert_allclose(readings / unit, exact / unit, atol=1e-6)
        missed = np.linalg.norm(pincal.forward(robot, readings).poses - poses, axis=1)
        (most,) = re.findall(r"(\S+) mm at most", text)
        np.testing.assert_allclose(1e3 * missed.max(), float(most), rtol=5e-3, atol=1e-4)
        assert f"misses {len(poses)} poses" in text
    pincal.deploy(drawn, tmp_path / "controller")
    written = (tmp_path / "controller" / "linuxcnc.hal").read_text()
    assert written.split()[1] == text.split()[1]
    with pytest.raises(pincal.MechanismError, match="no delta"):
        deltakins(pincal.load_mechanism("3PUU"), workspace("3PUU", 20))
