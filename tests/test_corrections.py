"""Machines with terms, driven by their readings, or by a controller that knows no terms."""

from __future__ import annotations

import shlex
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from arms import loaded
from command_line import contents, done, run
from marks import some_slow
from measured import workspace
from scipy.optimize import brentq
from test_deformations import at_row, machine_of, plan_of
from test_terms import FORMS, extended, truth_of

import pincal
from pincal import MechanismError, sample_configurations
from pincal.kinematics.closing import sensor_law
from pincal.kinematics.closure import nominal_legs
from pincal.kinematics.configurations import joints_at


def with_forms(mechanism: pincal.Mechanism, *forms: str) -> pincal.Mechanism:
    """Return a machine whose sensors have terms of some forms, of some 0.3 mm and mrad."""
    named = (replace(FORMS[one], parameter=f"a_{index}") for index, one in enumerate(forms))
    return truth_of(extended(mechanism, *named))


CASES: dict[str, Callable[[], tuple[pincal.Mechanism, pincal.Plan]]] = {
    "grown 5R": lambda: planned(machine_of("5R")[1]),
    "grown 6UPS": lambda: planned(machine_of("6UPS")[1]),
    "grown ur5": lambda: planned(machine_of("ur5")[1]),
    "bent 3RRR": lambda: planned(machine_of("3RRR", "load")[1]),
    "bent ur5": lambda: planned(machine_of("ur5", "load")[1]),
    "5R": lambda: planned(with_forms(pincal.load_mechanism("5R"), *FORMS)),
    "delta": lambda: planned(with_forms(pincal.load_mechanism("delta"), "gravity", "sine")),
    "4cable": lambda: planned(with_forms(pincal.load_mechanism("4cable"), "power")),
    "3RPS": lambda: planned(with_forms(pincal.load_mechanism("3RPS"), "cosine", "power")),
    "ur5": lambda: planned(with_forms(loaded("ur5"), "gravity", "sine", "backlash")),
}


def planned(machine: pincal.Mechanism) -> tuple[pincal.Mechanism, pincal.Plan]:
    """Return a machine and configurations of it, with whatever its terms follow."""
    draw = np.random.default_rng(0)
    by_poses = not machine.by_readings
    plan = (
        plan_of(machine, 12)
        if by_poses or machine.name == "ur5_robot"
        else sample_configurations(machine.without_terms, 12)
    )
    own = {
        name: np.sign(draw.normal(size=12)) if "approach" in name else draw.uniform(15.0, 35.0, 12)
        for name in machine.influences
        if name not in machine.loaded
    }
    return machine, replace(plan, influences=own)


def solved(machine: pincal.Mechanism, plan: pincal.Plan) -> tuple[np.ndarray, np.ndarray]:
    """Return poses of the plain machine, and readings that take the whole one there."""
    plain, poses, near = machine.without_terms, plan.poses, None
    if plan.readings is not None:
        poses = pincal.forward(plain, plan.readings, poses).poses
        near = joints_at(plain, pincal.Plan(poses, readings=plan.readings)).joints
    solution = pincal.inverse(machine, poses, plan.influences, near)
    assert solution.reached.all()
    return poses, solution.readings


@pytest.mark.parametrize(
    "case", some_slow(CASES, "grown 6UPS", "grown ur5", "bent 3RRR", "delta", "4cable", "3RPS")
)
def test_a_controller_without_terms_is_sent_elsewhere_and_arrives(case: str) -> None:
    """Forward kinematics of readings is the pose; that of the plain machine what to command."""
    machine, plan = CASES[case]()
    plain = machine.without_terms
    poses, readings = solved(machine, plan)
    own = plan.readings if machine.by_readings else pincal.inverse(plain, poses).readings
    assert np.abs(readings - own).max() > 1e-4
    there = pincal.forward(machine, readings, poses, plan.influences).poses
    np.testing.assert_allclose(there, poses, atol=1e-11)
    if not machine.redundant and not machine.by_readings:  # the plain machine reads the same
        commands = pincal.forward(plain, readings, poses).poses
        sent = pincal.inverse(plain, commands).readings
        np.testing.assert_allclose(sent, readings, atol=1e-12)


@pytest.mark.parametrize("name", ["5R", "3RRR"])
def test_readings_of_grown_links_are_those_of_the_machine_grown_by_hand(name: str) -> None:
    _, machine = machine_of(name)
    plan = plan_of(machine, 4)
    readings = pincal.inverse(machine, plan.poses, plan.influences).readings
    for row, warm in enumerate(plan.influences["temperature"].tolist()):
        grown = pincal.inverse(at_row(machine, warm), plan.poses[[row]]).readings[0]
        np.testing.assert_allclose(readings[row], grown, atol=1e-12)


def test_readings_of_a_sensor_are_roots_of_its_law() -> None:
    """With geometry as it is, the joint is where it was: its law is solved by SciPy there."""
    machine = with_forms(pincal.load_mechanism("5R"), "sine", "power")
    poses = workspace("5R", 4)
    plain = pincal.inverse(machine.without_terms, poses)
    readings = pincal.inverse(machine, poses).readings
    for column, leg in enumerate(nominal_legs(machine)):
        law = sensor_law(leg)
        for row, joints in enumerate(plain.joints[leg.leg.name]):

            def apart(psi: float, law: Any = law, q: float = joints[leg.leg.active[0]]) -> float:
                return float(law.position(np.array([[psi]]))[0, 0]) - q

            root = brentq(
                apart, readings[row, column] - 0.1, readings[row, column] + 0.1, xtol=1e-15
            )
            assert readings[row, column] == pytest.approx(root, abs=1e-13)


def test_an_arm_keeps_its_branch_and_its_turns() -> None:
    """Joints are where they were: beyond limits, a turn from home, with one joint to spare."""
    machine = with_forms(loaded("panda"), "sine", "power")
    plain = np.random.default_rng(0).uniform(-8.0, 8.0, (30, 7))
    poses = np.tile(machine.platform.home, (30, 1))
    _, readings = solved(machine, pincal.Plan(poses, readings=plain))
    (whole,), (drawn,) = nominal_legs(machine), nominal_legs(machine.without_terms)
    joints = sensor_law(whole).position(readings)
    np.testing.assert_allclose(joints, sensor_law(drawn).position(plain), atol=1e-12)


def test_inverse_near_joints_stays_there() -> None:
    """The solution that is near is returned, of an arm too; near nothing there is none."""
    arm = loaded("ur5")
    draw = np.random.default_rng(1)
    readings = draw.uniform(-6.0, 6.0, (10, 6))
    poses = pincal.forward(arm, readings).poses
    near = {arm.legs[0].name: readings + draw.uniform(-1e-3, 1e-3, readings.shape)}
    np.testing.assert_allclose(pincal.inverse(arm, poses, near=near).readings, readings, atol=1e-9)
    five, poses = pincal.load_mechanism("5R"), workspace("5R", 3)
    there = pincal.inverse(five, poses)
    there.joints["leg_1"][1] = np.nan
    again = pincal.inverse(five, poses, near=there.joints)
    np.testing.assert_array_equal(again.reached[:, 0], [True, False, True])
    np.testing.assert_allclose(again.readings[[0, 2]], there.readings[[0, 2]], atol=1e-14)
    with pytest.raises(MechanismError, match="joints of leg_2"):
        pincal.inverse(five, poses, near={"leg_1": there.joints["leg_1"]})


def test_a_side_of_approach_that_is_not_given_is_the_middle() -> None:
    """Play moves readings by the side that a column says, by nothing without one."""
    machine = with_forms(pincal.load_mechanism("5R"), "backlash")
    poses = np.tile([0.0, 1.1], (3, 1))
    sides = {"approach_leg_1": np.array([1.0, -1.0, np.nan])}
    plain = pincal.inverse(machine.without_terms, poses).readings
    moved = pincal.inverse(machine, poses, sides).readings - plain
    play, gain = (machine.parameters[f"leg_1.{name}"].nominal for name in ("a_0_0", "k"))
    np.testing.assert_allclose(moved[:, 0], [-gain * play, gain * play, 0.0], atol=1e-15)
    np.testing.assert_allclose(moved[:, 1], 0.0, atol=1e-15)


def columns(path: Path) -> dict[str, list[str]]:
    """Return the columns of a CSV file as text."""
    rows = [line.split(",") for line in path.read_text().splitlines()]
    return {name: [row[place] for row in rows[1:]] for place, name in enumerate(rows[0])}


def test_what_an_export_leaves_out_is_offered_and_the_command_works(tmp_path: Path) -> None:
    """MJCF and firmware say which command writes readings with terms; it runs as it is."""
    machine = with_forms(pincal.load_mechanism("linear_delta"), "power")
    machine.save(tmp_path / "a printer")
    for file in ("m.xml", "m.cfg", "m.g"):
        outcome = done("export", tmp_path / "a printer", "-o", tmp_path / file)
        (offered,) = [line for line in outcome.err.splitlines() if ": pincal inverse " in line]
    files = {name: tmp_path / name for name in ("POSES.csv", "READINGS.csv")}
    poses = workspace("linear_delta", 3)
    pincal.Plan(poses).to_csv(files["POSES.csv"], machine)
    done(*[files.get(word, word) for word in shlex.split(offered.partition(": pincal ")[2])])
    written = np.array(list(columns(files["READINGS.csv"]).values()), dtype=float).T
    np.testing.assert_allclose(written, pincal.inverse(machine, poses).readings, atol=1e-11)


def test_without_terms_no_readings_are_offered(tmp_path: Path) -> None:
    for name, file in (("5R", "m.xml"), ("linear_delta", "m.cfg")):
        assert "inverse" not in done("export", name, "-o", tmp_path / file).err


def test_poses_of_a_program_are_commanded_otherwise(tmp_path: Path) -> None:
    """Inverse kinematics, then those of the controller, keep rows; one out of reach has a reason.

    Temperature and side of approach are read from the poses.
    """
    machine = with_forms(pincal.load_mechanism("5R"), "temperature", "backlash")
    machine.save(tmp_path / "m")
    machine.without_terms.save(tmp_path / "controller")
    poses, readings, sent = (tmp_path / name for name in ("p.csv", "r.csv", "s.csv"))
    poses.write_text(
        "x [mm],y [mm],temperature,approach_leg_2,note\n"
        "0,1100,30,-1,a\n9000,0,20,1,c\n0,1100,20,,b\n"
    )
    outcome = run("inverse", tmp_path / "m", poses, "-o", readings)
    assert outcome.code == 1
    assert "line 3: out of reach of leg_1, leg_2" in outcome.err
    assert "approach_leg_1 not given: the machine is taken at their reference" in outcome.err
    outcome = run("forward", tmp_path / "controller", readings, "-o", sent, "--units", "mm")
    assert outcome.code == 1
    assert "row 2: no readings" in outcome.err
    table = columns(sent)
    assert table["reason"] == ["", "no readings", ""]
    commands = np.array([table[f"{axis} [mm]"] for axis in "xy"]).T[[0, 2]].astype(float)
    aims = np.tile([0.0, 1.1], (2, 1))
    own = {"temperature": np.array([30.0, 20.0]), "approach_leg_2": np.array([-1.0, np.nan])}
    wanted = pincal.inverse(machine, aims, own).readings
    plain = pincal.inverse(machine.without_terms, commands / 1e3).readings
    np.testing.assert_allclose(plain, wanted, atol=1e-11)
    assert np.linalg.norm(commands / 1e3 - aims, axis=1)[0] > 1e-5


def test_rows_of_readings_in_part_are_refused(tmp_path: Path) -> None:
    (tmp_path / "r.csv").write_text("leg_1 [rad],leg_2 [rad]\n,\n2.2,\n")
    outcome = run("forward", "5R", tmp_path / "r.csv", "-o", tmp_path / "p.csv")
    assert outcome.code == 2
    assert "empty cell in column" in outcome.err
    assert not (tmp_path / "p.csv").exists()


def test_wrong_exports_are_refused_and_nothing_is_written(tmp_path: Path) -> None:
    with_forms(pincal.load_mechanism("5R"), "sine").save(tmp_path / "m")
    poses = tmp_path / "poses.csv"
    poses.write_text("x [m],y [m]\n0,1.1\n")
    before = contents(tmp_path)
    for words, message in [
        (("-o", tmp_path / "c.cfg", "--original", poses), "leave out --original"),
        (("-o", tmp_path / "c.xml", "--original", tmp_path / "c.sdf"), "not for the format sdf"),
        (("-o", poses), "is not known; give it the ending"),
        (("-o", tmp_path / "c.txt"), "is not known; give it the ending"),
    ]:
        outcome = run("export", tmp_path / "m", *words)
        assert outcome.code == 2
        assert message in " ".join(outcome.trouble.split())
    assert contents(tmp_path) == before


def test_columns_of_terms_that_a_machine_lacks_do_not_matter(tmp_path: Path) -> None:
    """``pincal inverse`` and ``forward`` take a file that says sides of approach nobody needs."""
    poses, readings = tmp_path / "poses.csv", tmp_path / "readings.csv"
    poses.write_text("x [m],y [m],approach_leg_1\n0,1.1,1\n")
    done("inverse", "5R", poses, "-o", readings)
    header, row = readings.read_text().splitlines()
    readings.write_text(f"{header},load_leg_1\n{row},5\n")
    done("forward", "5R", readings, "-o", tmp_path / "back.csv")
