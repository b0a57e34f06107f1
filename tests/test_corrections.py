"""Corrections for controllers that know no terms: tables over poses."""

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
from pincal import (
    Corrections,
    MeasurementError,
    MechanismError,
    sample_configurations,
)
from pincal.kinematics.closing import sensor_law
from pincal.kinematics.closure import nominal_legs


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


@pytest.mark.parametrize(
    "case", some_slow(CASES, "grown 6UPS", "grown ur5", "bent 3RRR", "delta", "4cable", "3RPS")
)
def test_corrected_readings_take_the_machine_to_the_pose(case: str) -> None:
    """Forward kinematics of readings without terms, and what the table adds, gives the pose."""
    machine, plan = CASES[case]()
    found = pincal.corrections(machine, plan)
    plain, poses = machine.without_terms, found.plan.poses
    assert not any(found.reasons)
    assert np.abs(found.readings).max() > 1e-4
    readings = found.plan.readings
    if machine.by_readings:
        there = pincal.forward(plain, readings, poses).poses
        np.testing.assert_allclose(there, poses, atol=1e-12)
    else:
        np.testing.assert_array_equal(poses, plan.poses)
        readings = pincal.inverse(plain, poses).readings
        whole = pincal.inverse(machine, poses, plan.influences).readings
        np.testing.assert_allclose(readings + found.readings, whole, atol=1e-12)
    there = pincal.forward(machine, readings + found.readings, poses, plan.influences).poses
    np.testing.assert_allclose(there, poses, atol=1e-11)
    assert (found.commands is None) == machine.redundant
    if found.commands is not None and not machine.by_readings:  # the plain machine reads the same
        sent = pincal.inverse(plain, found.commands).readings
        np.testing.assert_allclose(sent, readings + found.readings, atol=1e-12)


@pytest.mark.parametrize("name", ["5R", "3RRR"])
def test_corrections_of_grown_links_are_those_of_the_machine_grown_by_hand(name: str) -> None:
    _, machine = machine_of(name)
    plan = plan_of(machine, 4)
    found = pincal.corrections(machine, plan).readings
    for row, warm in enumerate(plan.influences["temperature"].tolist()):
        at = plan.poses[row : row + 1]
        grown = pincal.inverse(at_row(machine, warm), at).readings[0]
        plain = pincal.inverse(machine.without_terms, at).readings[0]
        np.testing.assert_allclose(found[row], grown - plain, atol=1e-12)


def test_corrections_of_a_sensor_are_roots_of_its_law() -> None:
    """With geometry as it is, the joint is where it was: its law is solved by SciPy there."""
    machine = with_forms(pincal.load_mechanism("5R"), "sine", "power")
    poses = workspace("5R", 4)
    plain = pincal.inverse(machine.without_terms, poses)
    found = plain.readings + pincal.corrections(machine, poses).readings
    for column, leg in enumerate(nominal_legs(machine)):
        law = sensor_law(leg)
        for row, joints in enumerate(plain.joints[leg.leg.name]):

            def apart(psi: float, law: Any = law, q: float = joints[leg.leg.active[0]]) -> float:
                return float(law.position(np.array([[psi]]))[0, 0]) - q

            root = brentq(apart, found[row, column] - 0.1, found[row, column] + 0.1, xtol=1e-15)
            assert found[row, column] == pytest.approx(root, abs=1e-13)


def test_an_arm_keeps_its_branch_and_its_turns() -> None:
    """Joints are where they were: beyond limits, a turn from home, with one joint to spare."""
    machine = with_forms(loaded("panda"), "sine", "power")
    draw = np.random.default_rng(0)
    readings = draw.uniform(-8.0, 8.0, (30, 7))
    poses = np.tile(machine.platform.home, (30, 1))
    found = pincal.corrections(machine, pincal.Plan(poses, readings=readings))
    assert not any(found.reasons)
    np.testing.assert_array_equal(found.plan.readings, readings)
    (whole,), (plain,) = nominal_legs(machine), nominal_legs(machine.without_terms)
    joints = sensor_law(whole).position(readings + found.readings)
    np.testing.assert_allclose(joints, sensor_law(plain).position(readings), atol=1e-12)


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


def test_what_has_no_correction_has_a_reason() -> None:
    machine = with_forms(pincal.load_mechanism("5R"), "power")
    found = pincal.corrections(machine, np.array([[0.0, 1.1], [9.0, 0.0]]))
    assert repr(found) == "Corrections: 1 of 2 poses"
    assert found.reasons == ("", "out of reach of leg_1, leg_2 in its working mode")
    assert isinstance(found, Corrections)
    assert found.commands is not None
    for values in (found.readings, found.commands):
        np.testing.assert_array_equal(np.isfinite(values).all(axis=1), [True, False])


def test_a_side_of_approach_that_is_not_given_is_the_middle() -> None:
    """Play corrects by the side that a column says, by nothing without one."""
    machine = with_forms(pincal.load_mechanism("5R"), "backlash")
    poses = np.tile([0.0, 1.1], (3, 1))
    sides = {"approach_leg_1": np.array([1.0, -1.0, np.nan])}
    found = pincal.corrections(machine, pincal.Plan(poses, influences=sides)).readings
    play, gain = (machine.parameters[f"leg_1.{name}"].nominal for name in ("a_0_0", "k"))
    np.testing.assert_allclose(found[:, 0], [-gain * play, gain * play, 0.0], atol=1e-15)
    np.testing.assert_allclose(found[:, 1], 0.0, atol=1e-15)


def columns(path: Path) -> dict[str, list[str]]:
    """Return the columns of a CSV file as text."""
    rows = [line.split(",") for line in path.read_text().splitlines()]
    return {name: [row[place] for row in rows[1:]] for place, name in enumerate(rows[0])}


def test_what_an_export_leaves_out_is_offered_and_the_command_works(tmp_path: Path) -> None:
    """MJCF and firmware say which commands write corrections; these run as they are."""
    with_forms(pincal.load_mechanism("linear_delta"), "power").save(tmp_path / "a printer")
    for file in ("m.xml", "m.cfg", "m.g"):
        outcome = done("export", tmp_path / "a printer", "-o", tmp_path / file)
        offered = [line for line in outcome.err.splitlines() if ": pincal export " in line]
        assert len(offered) == 1
    for line in offered:
        typed = shlex.split(line.partition(": pincal ")[2].partition(" (")[0])
        place = typed.index("-o") + 1
        typed[place] = str(tmp_path / typed[place])
        done(*typed)
    table = columns(tmp_path / "corrections.csv")
    names = ("leg_1", "leg_2", "leg_3")
    assert list(table) == [
        *("x [mm]", "y [mm]", "z [mm]"),
        *(f"correction_{name} [mm]" for name in names),
        *("command_x [mm]", "command_y [mm]", "command_z [mm]"),
    ]
    machine = pincal.load_mechanism(tmp_path / "a printer")
    poses = np.array([table[f"{name} [mm]"] for name in "xyz"], dtype=float).T / 1e3
    found = np.array([table[f"correction_{one} [mm]"] for one in names], dtype=float).T / 1e3
    ends = [pincal.inverse(one, poses).readings for one in (machine, machine.without_terms)]
    np.testing.assert_allclose(found, ends[0] - ends[1], atol=2e-12)


def test_without_terms_no_table_is_offered(tmp_path: Path) -> None:
    for name, file in (("5R", "m.xml"), ("linear_delta", "m.cfg")):
        assert "corrections" not in done("export", name, "-o", tmp_path / file).err


def test_poses_with_columns_give_corrections_at_these(tmp_path: Path) -> None:
    """Temperature and side of approach are read from the poses; a row out of reach has a reason."""
    machine = with_forms(pincal.load_mechanism("5R"), "temperature", "backlash")
    per_unit = 65536 / (2 * np.pi)
    legs = (
        replace(leg, sensors=(replace(leg.sensors[0], counts_per_unit=per_unit),))
        for leg in machine.legs
    )
    machine = replace(machine, legs=tuple(legs))
    machine.save(tmp_path / "m")
    poses = tmp_path / "poses.csv"
    poses.write_text(
        "x [mm],y [mm],temperature,approach_leg_2,note\n"
        "0,1100,30,-1,a\n0,1100,20,,b\n9000,0,20,1,c\n"
    )
    counts = ("--units", "mm,counts")
    out = tmp_path / "c.csv"
    outcome = run("export", tmp_path / "m", "--poses", poses, *counts, "-o", out)
    assert outcome.code == 1
    assert "line 4: out of reach of leg_1, leg_2" in outcome.err
    assert "approach_leg_1 not given: the machine is taken at their reference" in outcome.err
    assert "2 poses: at most" in outcome.out
    table = columns(out)
    assert table["correction_leg_2 [counts]"][2] == ""
    given = pincal.Plan(
        np.tile([0.0, 1.1], (2, 1)),
        influences={"temperature": [30.0, 20.0], "approach_leg_2": [-1.0, np.nan]},
    )
    wanted = pincal.corrections(machine, given)
    for place, name in enumerate(machine.reading_names):
        found = np.array(table[f"correction_{name} [counts]"][:2], dtype=float)
        exact = wanted.readings[:, place] * 65536 / (2 * np.pi)
        np.testing.assert_allclose(found, exact, atol=1e-7)
    found = np.array([table[f"command_{one} [mm]"][:2] for one in "xy"], dtype=float).T
    np.testing.assert_allclose(found, 1e3 * wanted.commands, atol=1e-8)


def test_orientations_are_commanded_as_they_were_given(tmp_path: Path) -> None:
    """Of a hexapod poses are given, in any way of writing orientations, which the table keeps."""
    machine_of("6UPS")[1].save(tmp_path / "m")
    poses, out = tmp_path / "poses.csv", tmp_path / "c.csv"
    home = pincal.load_mechanism("6UPS").platform.home
    poses.write_text(
        f"x [m],y [m],z [m],roll [deg],pitch [deg],yaw [deg],temperature\n0,0,{home[2]},2,1,0,30\n"
    )
    done("export", tmp_path / "m", "--poses", poses, "-o", out, "--units", "deg")
    table = columns(out)
    assert {"roll [deg]", "command_roll [deg]", "command_yaw [deg]"} <= set(table)
    assert abs(float(table["command_roll [deg]"][0]) - 2.0) < 0.2


def test_wrong_uses_are_refused_and_nothing_is_written(tmp_path: Path) -> None:
    with_forms(pincal.load_mechanism("5R"), "sine").save(tmp_path / "m")
    with_forms(pincal.load_mechanism("5R"), "temperature").save(tmp_path / "warm")
    poses = tmp_path / "poses.csv"
    poses.write_text("x [m],y [m]\n0,\n")
    filled = tmp_path / "filled.csv"
    filled.write_text("x [m],y [m]\n0,1.1\n")
    before = contents(tmp_path)
    m, out = tmp_path / "m", ("-o", tmp_path / "c.csv")
    for words, message in [
        (("5R", *out), "'5R' has no terms: a controller with its geometry"),
        ((tmp_path / "warm", *out), "all terms of '5R' follow temperature"),
        ((m, *out, "--poses", poses), "line 2: empty cell in column 'y'"),
        ((m, *out, "--poses", tmp_path / "none.csv"), "none.csv"),
        ((m, *out, "--units", "mm,counts"), "how many counts"),
        ((m, *out, "--original", poses), "leave out --original: not for the format table"),
        (
            (m, "-o", tmp_path / "c.urdf", "--poses", poses),
            "leave out --poses: not for the format urdf",
        ),
        (
            (m, "-o", tmp_path / "c.urdf", "--units", "mm"),
            "leave out --units: not for the format urdf",
        ),
        ((m, "-o", filled, "--poses", filled, "--force"), "would replace"),
        ((m, "-o", poses), "exists"),
        ((m, "-o", tmp_path / "c.txt"), "does not say what to write"),
    ]:
        outcome = run("export", *words)
        assert outcome.code == 2
        assert message in " ".join(outcome.trouble.split())
    assert contents(tmp_path) == before


def test_python_refuses_alike() -> None:
    """Functions of one's own have corrections; shapes and numbers are checked."""
    own = pincal.Term("a", np.sin, slope=np.cos)
    machine = truth_of(extended(pincal.load_mechanism("5R"), own))
    assert np.abs(pincal.corrections(machine, [[0.0, 1.1]]).readings).max() > 1e-5
    with pytest.raises(MechanismError):
        pincal.corrections(machine, [[0.0, np.nan]])
    with pytest.raises((MechanismError, MeasurementError)):
        pincal.corrections(machine, [[0.0, 1.1, 2.0]])


def test_columns_of_terms_that_a_machine_lacks_do_not_matter(tmp_path: Path) -> None:
    """``pincal inverse`` and ``forward`` take a file that says sides of approach nobody needs."""
    poses, readings = tmp_path / "poses.csv", tmp_path / "readings.csv"
    poses.write_text("x [m],y [m],approach_leg_1\n0,1.1,1\n")
    done("inverse", "5R", poses, "-o", readings)
    header, row = readings.read_text().splitlines()
    readings.write_text(f"{header},load_leg_1\n{row},5\n")
    done("forward", "5R", readings, "-o", tmp_path / "back.csv")
