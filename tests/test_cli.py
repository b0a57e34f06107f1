"""The command line, in process: the whole chain on files, and bad input that harms nothing."""

from __future__ import annotations

import json
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from command_line import contents, done, run, unnamed
from marks import quick, some_slow

import pincal
from pincal.cli.app import app, working
from pincal.files.measurements import read_readings
from pincal.files.mechanism_folders import bundled

KINDS = quick(1, ["3RRR", "5R", "4cable"])
NOISE = ["--noise-position", "1e-5", "--noise-orientation", "1e-5"]
#: Readings that are too many for the freedoms cannot be exact.
READ = {"4cable": ["--noise-reading", "1e-5"]}
DISTURB = ["--disturb", "0.001"]
COMMANDS = {str(command.name): command for command in app.registered_commands}


def chain(kind: str, folder: Path, seed: int = 1) -> Path:
    """Run workspace, select, simulate and calibrate in a new folder, and return it."""
    folder.mkdir()
    plan, measured, seeded = folder / "plan.csv", folder / "measured.csv", ["--seed", seed]
    candidates = folder / "candidates.csv"
    done("workspace", kind, "--count", 400, *seeded, "-o", candidates)
    chosen = ["--count", 12, "--candidates", candidates, "--reference", 0]
    done("select", kind, *chosen, *seeded, "-o", plan)
    disturbed = [*DISTURB, *seeded, "--truth", folder / "truth"]
    noise = [*NOISE, *READ.get(kind, [])]
    done("simulate", kind, plan, *noise, *disturbed, "-o", measured)
    report = () if kind == "4cable" else ("--no-report",)
    done("calibrate", kind, measured, *noise, *report, "-o", folder / "result")
    return folder


class Chains(dict[str, Path]):
    """Folder with all files of the chain, for each mechanism, made when it is asked for."""

    def __init__(self, root: Path) -> None:
        self._root = root

    def __missing__(self, kind: str) -> Path:
        self[kind] = chain(kind, self._root / kind)
        return self[kind]


@pytest.fixture(scope="module")
def chains(tmp_path_factory: pytest.TempPathFactory) -> Chains:
    """Folders of the chains; not to be written to."""
    return Chains(tmp_path_factory.mktemp("chains"))


@pytest.fixture
def work(chains: Chains, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Current folder, with the files of the 3-RRR's chain, its mechanism, and the 5R's in 5R."""
    folder = tmp_path / "work"
    shutil.copytree(chains["3RRR"], folder)
    shutil.copytree(chains["5R"], folder / "5R-files")
    shutil.copytree(bundled()["3RRR"], folder / "robot")
    monkeypatch.chdir(folder)
    return folder


# The chain


@pytest.mark.parametrize("kind", KINDS)
def test_result_says_everything(kind: str, chains: Chains) -> None:
    """result.json holds, for every leg and parameter, what was found and how sure that is."""
    result = json.loads((chains[kind] / "result" / "result.json").read_text(encoding="utf-8"))
    mechanism = pincal.load_mechanism(kind)
    data = pincal.Measurements.from_csv(chains[kind] / "measured.csv", mechanism)
    assert result["converged"] is True
    assert result["method"] == "all-legs"
    assert [leg["name"] for leg in result["legs"]] == list(mechanism.leg_names)
    for found, leg in zip(result["legs"], mechanism.legs, strict=True):
        parameters = found["parameters"]
        assert [p["name"] for p in parameters] == list(leg.parameter_names)
        assert {p["name"]: p["unit"] for p in parameters} == leg.units
        assert [p["nominal"] for p in parameters] == leg.nominal.tolist()
        assert all(0.0 < p["std"] < 0.01 for p in parameters)
        assert all(p["interval_95"][0] < p["identified"] < p["interval_95"][1] for p in parameters)
        assert found["rank"] == len(parameters)
        assert found["n_residuals"] == len(data) > 9
        assert 1.0 < found["condition"] < 1e4
        assert found["rms_after"] < 0.1 * found["rms_before"]


@pytest.mark.parametrize("kind", KINDS)
def test_identified_parameters_are_near_the_truth(kind: str, chains: Chains) -> None:
    """Each is within 5 standard errors of the true one, the worst error halved at least."""
    result = json.loads((chains[kind] / "result" / "result.json").read_text(encoding="utf-8"))
    truth, nominal = pincal.load_mechanism(chains[kind] / "truth"), pincal.load_mechanism(kind)
    for found in result["legs"]:
        identified = np.array([p["identified"] for p in found["parameters"]])
        std = np.array([p["std"] for p in found["parameters"]])
        true = truth.leg(found["name"]).nominal
        error, before = np.abs(identified - true), np.abs(nominal.leg(found["name"]).nominal - true)
        assert (error < 5.0 * std).all()
        assert error.max() < 0.5 * before.max()


@pytest.mark.parametrize("kind", KINDS)
def test_calibrated_mechanism_serves_as_mech(kind: str, chains: Chains, tmp_path: Path) -> None:
    """The calibrated folder works as MECH, with the identified values and better readings."""
    folder = chains[kind] / "result"
    result = json.loads((folder / "result.json").read_text(encoding="utf-8"))
    calibrated = folder / result["calibrated_mechanism"]
    mechanism = pincal.load_mechanism(calibrated)
    for leg in result["legs"]:
        identified = [p["identified"] for p in leg["parameters"]]
        assert mechanism.leg(leg["name"]).nominal.tolist() == identified
    readings = {}
    for name, mech in {"true": chains[kind] / "truth", "before": kind, "after": calibrated}.items():
        done("inverse", mech, chains[kind] / "plan.csv", "-o", tmp_path / name)
        readings[name] = read_readings(tmp_path / name, mechanism)[0]
    before, after = (np.abs(readings[n] - readings["true"]).max() for n in ("before", "after"))
    assert after < 0.1 * before


def test_poses_outside_the_limits_of_joints_are_said(tmp_path: Path) -> None:
    """Their readings are written all the same; which joints, of which rows."""
    poses = tmp_path / "p.csv"
    poses.write_text("x [m],y [m],z [m]\n0,0,0.02\n0,0,0.5\n")
    outcome = run("inverse", "linear_delta", poses, "-o", tmp_path / "r.csv")
    assert outcome.code == 0
    assert f"{poses}: 1 of 2 poses are outside the limits of joints" in outcome.err
    assert "line 3: leg_1 carriage" in outcome.err


@pytest.mark.parametrize(
    ("command", "header", "good", "bad", "why"),
    [
        ("inverse", "x [m],y [m]", "0,1.1", "50,0", "line 3: out of reach of leg_1"),
        ("inverse", "x [m],y [m]", "0,1.1", "1e11,0", "line 3: out of reach of leg_1"),
        ("forward", "leg_1 [rad],leg_2 [rad]", "2.2,2.2", "3.14,3.14", "row 2: "),
    ],
)
def test_rows_without_a_solution_are_empty_and_say_why(
    command: str, header: str, good: str, bad: str, why: str, tmp_path: Path
) -> None:
    """The other rows are as without them; the reason is in the file and said; exit code 1."""
    alone, mixed = tmp_path / "alone.csv", tmp_path / "mixed.csv"
    alone.write_text(f"{header}\n{good}\n")
    mixed.write_text(f"{header}\n{good}\n{bad}\n{good}\n")
    done(command, "5R", alone, "-o", tmp_path / "a.csv")
    outcome = run(command, "5R", mixed, "-o", tmp_path / "m.csv")
    assert outcome.code == 1
    assert f"{mixed}: 1 of 3" in outcome.err
    assert why in outcome.err
    head, row = (tmp_path / "a.csv").read_text().splitlines()
    found = (tmp_path / "m.csv").read_text().splitlines()
    assert found[0] == f"{head},reason"
    assert found[1] == found[3] == f"{row},"
    assert found[2].startswith(",,")
    assert found[2][2:].strip('"') in outcome.err


def test_rows_that_are_not_simulated_share_a_line_by_reason(tmp_path: Path) -> None:
    """Of 300 poses out of reach lines are named on one line, as many as are read."""
    plan = tmp_path / "plan.csv"
    plan.write_text("\n".join(["x [m],y [m]", "0,1.1", *["50,0"] * 300, ""]))
    outcome = done("simulate", "5R", plan, "-o", tmp_path / "m.csv")
    (line,) = (text for text in outcome.err.splitlines() if "out of reach" in text)
    assert "line 3, line 4" in line
    assert "line 302 of the plan" in line
    assert len(line) < 300
    assert "1 poses measured, 300 not reached" in outcome.err


@pytest.mark.parametrize("kind", KINDS)
def test_inverse_then_forward_gives_the_poses(kind: str, chains: Chains, tmp_path: Path) -> None:
    """Poses to readings and back are the same poses within 1e-9."""
    done("inverse", kind, chains[kind] / "candidates.csv", "-o", tmp_path / "readings.csv")
    done("forward", kind, tmp_path / "readings.csv", "-o", tmp_path / "back.csv")
    mechanism = pincal.load_mechanism(kind)
    poses, back = (
        pincal.Plan.from_csv(path, mechanism).poses
        for path in (chains[kind] / "candidates.csv", tmp_path / "back.csv")
    )
    assert poses.shape == (400, mechanism.platform.dof)
    np.testing.assert_allclose(back, poses, rtol=0.0, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_same_seed_gives_the_same_bytes(kind: str, chains: Chains, tmp_path: Path) -> None:
    """The chain run again with the same seed writes the same bytes to every file."""
    again, first = contents(chain(kind, tmp_path / "again")), contents(chains[kind])
    assert {name for name in first if again.get(name) != first[name]} == set()
    assert set(again) == set(first)
    assert "result/result.json" in first


@pytest.mark.slow
def test_other_seed_gives_other_files(chains: Chains, tmp_path: Path) -> None:
    """Another seed writes other poses, another truth and other measurements."""
    other, first = contents(chain("5R", tmp_path / "other", seed=2)), contents(chains["5R"])
    for name in ("candidates.csv", "plan.csv", "measured.csv", "truth/mechanism.yaml"):
        assert other[name] != first[name]


@pytest.mark.slow
def test_existing_truth_is_measured_again(work: Path) -> None:
    """Without --disturb an existing truth is measured as it is, and not written again."""
    before = contents(work / "truth")
    done("simulate", "3RRR", "plan.csv", "--truth", "truth", *NOISE, "--seed", 7, "-o", "more.csv")
    assert contents(work / "truth") == before
    done("calibrate", "--no-report", "truth", "more.csv", *NOISE, "-o", "check")
    result = json.loads((work / "check" / "result.json").read_text(encoding="utf-8"))
    for leg in result["legs"]:
        for p in leg["parameters"]:
            assert abs(p["identified"] - p["nominal"]) < 5.0 * p["std"]


@pytest.mark.slow
def test_tables_in_other_units_give_the_same_result(work: Path) -> None:
    """Measurements in mm and degrees calibrate to the same parameters as in m and rad."""
    three = pincal.load_mechanism("3RRR")
    data = pincal.Measurements.from_csv("measured.csv", three)
    changed = replace(data, poses=data.poses * [1e3, 1e3, 1.0], readings=np.degrees(data.readings))
    changed.to_csv("units.csv", three)
    text = Path("units.csv").read_text().replace("x [m]", "x [mm]").replace("y [m]", "y [mm]")
    for i in (1, 2, 3):
        text = text.replace(f"leg_{i} [rad]", f"leg_{i} [deg]")
    Path("units.csv").write_text(text)
    done("calibrate", "--no-report", "3RRR", "units.csv", *NOISE, "-o", "units")
    for leg, other in zip(
        pincal.load_mechanism("result/mechanism").legs,
        pincal.load_mechanism("units/mechanism").legs,
        strict=True,
    ):
        np.testing.assert_allclose(other.nominal, leg.nominal, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("kind", ["5R", "3RRR", "4cable"])
@pytest.mark.slow
def test_tables_on_stdout_name_what_was_found(kind: str, chains: Chains, tmp_path: Path) -> None:
    """With --verbose each leg and parameter is printed on stdout, and the file on stderr."""
    output = tmp_path / "result"
    noise = [*NOISE, *READ.get(kind, [])]
    line = ["calibrate", "--no-report", kind, chains[kind] / "measured.csv", *noise, "--verbose"]
    outcome = done(*line, "-o", output)
    for leg in pincal.load_mechanism(kind).legs:
        assert leg.name in outcome.out
        assert all(name in outcome.out for name in leg.parameter_names)
    assert f"wrote {output}" in outcome.err
    assert "wrote" not in outcome.out


# Help


@pytest.mark.parametrize("command", COMMANDS)
def test_help_of_each_command(command: str) -> None:
    """--help of a command exits 0, with its usage and the first line of its docstring."""
    outcome = run(command, "--help")
    assert outcome.code == 0
    assert outcome.out.startswith(f"Usage: pincal {command} ")
    assert str(COMMANDS[command].callback.__doc__).splitlines()[0] in outcome.out
    assert not re.search(r"list\[|\[\[|^  [A-Z.|]+ <", outcome.out, re.MULTILINE)
    assert outcome.err == ""


def test_help_lists_the_commands() -> None:
    """--help exits 0 and names every command."""
    outcome = run("--help")
    assert outcome.code == 0
    assert len(COMMANDS) >= 9
    assert all(f"\n  {command} " in outcome.out for command in COMMANDS)
    assert "..." not in outcome.out.partition("Commands:")[2]  # 80 columns, nothing cut


def test_mechanisms_lists_the_bundled_ones() -> None:
    """'mechanisms' exits 0 and names each bundled mechanism."""
    outcome = done("mechanisms")
    assert all(name in outcome.out for name in bundled())


@pytest.mark.parametrize("kind", KINDS)
def test_check_finds_bundled_mechanisms_sound(kind: str) -> None:
    """'check' of a bundled mechanism exits 0 and finds all parameters of each leg observable."""
    outcome = done("check", kind)
    for leg in pincal.load_mechanism(kind).legs:
        n = len(leg.parameters)
        assert f"{leg.name}: {n} of {n} parameters observable" in outcome.out


# Bad input

Change = Callable[[pincal.Measurements], pincal.Measurements]


def edited(path: str, old: str, new: str) -> Callable[[], object]:
    """Return what replaces a text wherever it is in a file; it must be there."""

    def change() -> None:
        text = Path(path).read_text()
        assert old in text, f"{old!r} is not in {path}: the test is out of date"
        Path(path).write_text(text.replace(old, new))

    return change


def table(*lines: str) -> Callable[[], object]:
    """Return what writes lines to ``t.csv``."""
    return lambda: Path("t.csv").write_text("\n".join((*lines, "")))


def measured(change: Change, kind: str = "3RRR") -> Callable[[], object]:
    """Return what writes changed measurements of a mechanism to ``t.csv``."""
    mechanism = pincal.load_mechanism(kind)
    path = "measured.csv" if kind == "3RRR" else "5R-files/measured.csv"
    return lambda: change(pincal.Measurements.from_csv(path, mechanism)).to_csv("t.csv", mechanism)


def only(rows: list[int]) -> Change:
    """Return what keeps some rows of measurements, for every leg."""
    return lambda data: pincal.Measurements(poses=data.poses[rows], readings=data.readings[rows])


def in_degrees(data: pincal.Measurements) -> pincal.Measurements:
    """Return measurements whose readings are degrees under a radian header."""
    return replace(data, readings=np.degrees(data.readings))


def in_millimetres(data: pincal.Measurements) -> pincal.Measurements:
    """Return measurements whose positions are millimetres under a metre header."""
    return replace(data, poses=data.poses * np.array([1e3, 1e3, 1.0])[: data.poses.shape[1]])


def legs_swapped(data: pincal.Measurements) -> pincal.Measurements:
    """Return measurements whose columns of the first two legs are exchanged."""
    return replace(data, readings=data.readings[:, [1, 0, 2]])


def one_pose(data: pincal.Measurements) -> pincal.Measurements:
    """Return measurements of the first pose only, 20 times and never quite the same."""
    poses = data.poses[[0] * 20] + 1e-12 * np.arange(20)[:, None]
    return pincal.Measurements(poses, readings=data.readings[[0] * 20])


def one_orientation(noise: float = 0.0) -> None:
    """Write measurements of the truth at 30 poses with the same phi to ``t.csv``."""
    truth, rng = pincal.load_mechanism("truth"), np.random.default_rng(0)
    poses = np.column_stack((rng.uniform(-0.2, 0.2, (30, 2)), np.full(30, 0.2)))
    readings = pincal.inverse(truth, poses).readings
    poses = poses + noise * rng.standard_normal(poses.shape)
    data = pincal.Measurements(poses=poses, readings=readings)
    data.to_csv("t.csv", truth)


@dataclass(frozen=True)
class Case:
    """Bad input: arguments in the folder ``work``, what must be named, and what makes it bad."""

    arguments: str
    named: list[str]
    prepare: Callable[[], object] = lambda: None


CALIBRATE, SELECT = "calibrate 3RRR t.csv", "select 3RRR --candidates candidates.csv"
POSES, READINGS = "x [m],y [m],phi [rad]", "leg_1 [rad],leg_2 [rad]"
ROBOT = "inverse robot plan.csv"
PHI = ["leg_1", "OA", "beta", "ob", "beta_b"]
PARTIAL = ["--noise-position", "--noise-orientation"]

BAD = {
    # mechanisms
    "mechanism-unknown": Case("inverse 6R plan.csv", ["'6R'", "3RRR", "5R"]),
    "mechanism-folder-empty": Case(
        "inverse .. plan.csv", ["'..' is no mechanism folder", "mechanism.yaml"]
    ),
    "mechanism-without-leg": Case(
        ROBOT, ["robot/leg_2.urdf", "No such file"], lambda: Path("robot/leg_2.urdf").unlink()
    ),
    "urdf-unparsable": Case(
        ROBOT, ["robot/leg_1.urdf", "parse", "line"], edited("robot/leg_1.urdf", "</robot>", "")
    ),
    "joint-unknown": Case(
        ROBOT,
        ["robot/mechanism.yaml", "leg_1", "'knee'", "elbow"],
        edited("robot/mechanism.yaml", "    elbow:", "    knee:"),
    ),
    "yaml-key-unknown": Case(
        ROBOT,
        ["robot/mechanism.yaml", "'remark'"],
        edited("robot/mechanism.yaml", "description:", "remark:"),
    ),
    "yaml-unparsable": Case(
        ROBOT,
        ["robot/mechanism.yaml", "parse", "line"],
        edited("robot/mechanism.yaml", "legs:", "legs: ["),
    ),
    # tables
    "file-missing": Case("calibrate 3RRR absent.csv", ["absent.csv", "No such file"]),
    "file-is-folder": Case("calibrate 3RRR truth", ["truth", "directory"]),
    "column-missing": Case(
        "calibrate 3RRR measured.csv --method per-leg",
        ["measured.csv", "'phi'", "'phi [rad]'"],
        edited("measured.csv", "phi [rad]", "angle [rad]"),
    ),
    "column-without-unit": Case(
        "calibrate 3RRR measured.csv",
        ["measured.csv", "'x'", "unit", "'x [m]'"],
        edited("measured.csv", "x [m]", "x"),
    ),
    "column-of-other-dimension": Case(
        "calibrate 3RRR measured.csv",
        ["measured.csv", "'phi'", "[mm]"],
        edited("measured.csv", "phi [rad]", "phi [mm]"),
    ),
    "text-in-number": Case(
        "calibrate 3RRR measured.csv",
        ["measured.csv", "line 2", "'x'"],
        edited("measured.csv", "leg_3 [rad]\nleg_3,", "leg_3 [rad]\nleg_3,?"),
    ),
    "other-mechanisms-table": Case(
        "calibrate 3RRR 5R-files/measured.csv", ["5R-files/measured.csv", "'leg_3'"]
    ),
    "other-mechanisms-sets": Case("simulate 5R plan.csv", ["plan.csv", "line 2", "'leg_3'", "5R"]),
    "header-only": Case("inverse 3RRR t.csv", ["t.csv", "rows"], table(POSES)),
    # measurements that do not do
    "rows-too-few": Case(
        f"{CALIBRATE} --strict {' '.join(NOISE)}",
        ["leg_1", "6", "8"],
        measured(only([0, 1, 2, 3, 4, 5])),
    ),
    "rows-too-few-without-noise": Case(
        f"{CALIBRATE} --method per-leg",
        ["leg_1", "8", "9", "noise"],
        measured(only([0, 1, 2, 3, 4, 5, 6, 7])),
    ),
    "readings-in-degrees": Case(
        CALIBRATE, ["57.3", "degrees", "radian", "header"], measured(in_degrees)
    ),
    "readings-in-degrees-5R": Case(
        "calibrate 5R t.csv", ["57.3", "degrees", "radian"], measured(in_degrees, "5R")
    ),
    "positions-in-millimetres": Case(
        CALIBRATE, ["1000", "mm", "metre", "header"], measured(in_millimetres)
    ),
    "positions-in-millimetres-5R": Case(
        "calibrate 5R t.csv", ["1000", "mm", "metre"], measured(in_millimetres, "5R")
    ),
    "readings-in-wrong-order": Case(CALIBRATE, ["leg_1", "order"], measured(legs_swapped)),
    "one-orientation": Case(f"{CALIBRATE} --strict", PHI, one_orientation),
    "one-pose": Case(
        f"{CALIBRATE} --strict", ["leg_1", "together", "--strict"], measured(one_pose)
    ),
    # options
    "noise-negative": Case(
        "calibrate 3RRR measured.csv --noise-position -1e-4 --noise-orientation 1e-4",
        ["position", "-0.0001"],
    ),
    "noise-nan": Case("simulate 3RRR plan.csv --noise-reading nan", ["reading", "nan"]),
    "noise-negative-select": Case(f"{SELECT} --noise-orientation -1", ["orientation", "-1"]),
    "noise-in-part": Case("calibrate 3RRR measured.csv --noise-position 1e-4", PARTIAL),
    "noise-of-angles": Case("simulate 3RRR plan.csv -o s.csv --noise-reading 1mm", ["are angles"]),
    "noise-in-part-reading": Case("calibrate 3RRR measured.csv --noise-reading 1e-4", PARTIAL),
    "noise-in-part-5R": Case(
        "calibrate 5R 5R-files/measured.csv --noise-orientation 1e-4", ["--noise-position"]
    ),
    "noise-all-zero": Case(
        "calibrate 3RRR measured.csv --noise-position 0 --noise-orientation 0",
        ["noise", "above zero"],
    ),
    "noise-all-zero-select": Case(f"{SELECT} --noise-position 0 --noise-orientation 0", ["noise"]),
    "disturbance-negative": Case("simulate 3RRR plan.csv --disturb -1", ["disturbance", "-1"]),
    "disturbance-too-large": Case(
        "simulate 3RRR plan.csv --disturb 5 --truth new", ["plan.csv", "no planned pose"]
    ),
    "truth-of-other-mechanism": Case(
        "simulate 3RRR plan.csv --truth 5R-files/truth", ["5R-files/truth", "3RRR"]
    ),
    "truth-exists": Case(
        "simulate 3RRR plan.csv --truth truth --disturb 0.1", ["truth exists", "--force"]
    ),
    "poses-too-few": Case(f"{SELECT} --count 5", ["5 poses", "8", "leg_1"]),
    "poses-too-many": Case(f"{SELECT} --count 500", ["500", "400"]),
    "margin-too-large": Case(
        "workspace 3RRR --count 10 --margin-type1 0.99", ["home", "--margin-type1"]
    ),
    "margin-nan": Case("workspace 3RRR --count 10 --margin-type2 nan", ["type-2", "nan"]),
    "protocol-and-goal": Case(
        "select 3RRR --protocol orbits --goal platform -o new.csv", ["--protocol orbits"]
    ),
    # what cannot be solved
    "candidates-unreachable": Case(
        "select 3RRR --candidates t.csv --unknown-frame -o new.csv",
        ["no pose of t.csv", "leg_1"],
        table(POSES, "5,0,0"),
    ),
    "target-far-off": Case(
        "select 3RRR --candidates plan.csv --setup s.yaml -o new.csv",
        ["'platform'", "50 m", "millimetres"],
        lambda: Path("s.yaml").write_text(
            "pincal_setup: 1\ntargets: {platform: {offset: [0.2, 0, 50]}}\n"
        ),
    ),
    "distance-missing": Case(
        "calibrate 3RRR measured.csv --setup s.yaml",
        ["measured.csv", "no column 'wire'", "'wire [m]'"],
        lambda: Path("s.yaml").write_text(
            "pincal_setup: 1\ndistances: {wire: {from: [2.0, 0, 0]}}\n"
        ),
    ),
    "pose-beyond-numbers": Case(
        "inverse 3RRR t.csv", ["t.csv", "line 3", "1e200"], table(POSES, "0,0,0", "1e200,0,0")
    ),
    "reading-far-beyond": Case(
        "forward 5R t.csv", ["t.csv", "line 2", "1e200"], table(READINGS, "1e200,0")
    ),
}


@pytest.mark.parametrize(
    "case", some_slow(BAD, "readings-in-degrees-5R", "positions-in-millimetres-5R")
)
def test_bad_input_is_named_and_harms_nothing(case: str, work: Path) -> None:
    """Bad input: exit code 2, one paragraph that names the trouble, and no file touched."""
    BAD[case].prepare()
    before = contents(work)
    outcome = run(*BAD[case].arguments.split(), "-o", "output")
    assert outcome.code == 2
    assert unnamed(BAD[case].named, outcome.trouble) == [], outcome.trouble
    assert outcome.out == ""
    assert contents(work) == before


@pytest.mark.slow  # in every run: test_poses_that_differ_by_their_noise_only_are_refused
def test_one_orientation_is_seen_through_noise(work: Path) -> None:
    """Poses of one orientation, measured with noise, are refused or warned of by parameter."""
    one_orientation(1e-5)
    outcome = run("calibrate", "--no-report", "3RRR", "t.csv", *NOISE, "-o", "output")
    text = outcome.trouble if outcome.code == 2 else outcome.err
    assert unnamed(PHI, text) == [], outcome.err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["select", "3RRR", "--count", "0"], "--count"),
        (["select", "3RRR", "--starts", "none"], "--starts"),
        (["workspace", "3RRR", "--seed", "-1"], "--seed"),
        (["calibrate", "3RRR", "measured.csv", "--poses", "both"], "'both'"),
        (["calibrate", "3RRR"], "MEASUREMENTS.csv"),
        (["workspace"], "MECH"),
        (["workspace", "3RRR", "--margin", "1"], "--margin"),
        (["calibrat", "3RRR"], "calibrat"),
    ],
)
def test_wrong_usage_is_named(arguments: list[str], words: str, work: Path) -> None:
    """Wrong usage: exit code 2, the error on the last line of stderr, and no file touched."""
    before = contents(work)
    outcome = run(*arguments, "-o", "output")
    last = outcome.err.strip().splitlines()[-1]
    assert outcome.code == 2
    assert last.startswith("Error: ")
    assert words in last
    assert contents(work) == before


def test_missing_output_is_named(work: Path) -> None:
    """A command without -o exits with code 2 and asks for it."""
    outcome = run("workspace", "3RRR")
    assert outcome.code == 2
    assert "'-o' / '--output'" in outcome.err


# Output that exists

WRITERS: dict[str, list[object]] = {
    "workspace": ["workspace", "5R", "--count", 10],
    "select": ["select", "3RRR", "--candidates", "candidates.csv", "--count", 8, "--starts", 1],
    "simulate": ["simulate", "3RRR", "plan.csv"],
    "calibrate": ["calibrate", "3RRR", "measured.csv", "--no-report"],
    "inverse": ["inverse", "3RRR", "plan.csv"],
    "forward": ["forward", "5R", "5R-files/readings.csv"],
}


@pytest.fixture
def readings(work: Path) -> Path:
    """Folder ``work`` with readings of the 5R's plan."""
    done("inverse", "5R", "5R-files/plan.csv", "-o", "5R-files/readings.csv")
    return work


@pytest.mark.parametrize("command", WRITERS)
def test_existing_output_is_refused(command: str, readings: Path) -> None:
    """Without --force an output that exists is refused by name and stays as it was."""
    Path("taken").write_text("keep")
    before = contents(readings)
    outcome = run(*WRITERS[command], "-o", "taken")
    assert outcome.code == 2
    assert "taken exists" in outcome.trouble
    helps = command != "calibrate"  # whose folder would not replace a file
    assert ("say --force" in outcome.trouble) == helps
    assert contents(readings) == before


@pytest.mark.parametrize("command", some_slow(WRITERS, "calibrate"))
def test_force_writes_what_a_new_name_gets(command: str, readings: Path) -> None:
    """With --force an earlier output is replaced by what a new name gets, and kept as .bak."""
    done(*WRITERS[command], "-o", "new")
    first = contents(readings)
    for one in Path("new").rglob("*") if Path("new").is_dir() else [Path("new")]:
        if one.is_file() and one.suffix != ".yaml":  # by which the old is known
            one.write_text("{}" if one.name == "result.json" else "old")
    changed = contents(Path("new")) or {"": b"old"}
    done(*WRITERS[command], "-o", "new", "--force")
    found = contents(readings)
    assert {name: found[name] for name in first} == first
    kept = {
        name.removeprefix("new.bak").lstrip("/"): found[name] for name in set(found) - set(first)
    }
    assert {name: kept[name] for name in changed} == changed


@pytest.mark.parametrize("command", ["inverse", "calibrate"])  # a table, a folder
@pytest.mark.parametrize("output", ["thesis", "."])
@pytest.mark.parametrize("force", [("--force",), ()])
def test_force_spares_folders_of_other_things(
    force: tuple[str, ...], command: str, output: str, work: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A folder that pincal did not write is refused, and --force is not offered, nor helps."""
    Path("thesis").mkdir()
    Path("thesis/chapter.tex").write_text("years of work")
    before = contents(work)
    outcome = run(*WRITERS[command], "-o", output, *force)
    assert "say --force" not in outcome.err
    monkeypatch.chdir("/")
    assert contents(work) == before
    assert outcome.code == 2
    assert Path(output).name in outcome.trouble


@pytest.mark.parametrize("command", WRITERS)
def test_output_in_a_missing_folder_is_refused(command: str, readings: Path) -> None:
    """An output below a folder that does not exist is refused, and the folder named, not made."""
    before = contents(readings)
    outcome = run(*WRITERS[command], "-o", "absent/output")
    assert outcome.code == 2
    assert "absent does not exist" in outcome.trouble
    assert contents(readings) == before


@pytest.mark.slow
def test_rows_not_held_out_by_choice_are_said(work: Path) -> None:
    """--folds 0: the report says that this was why, however quiet; and what was printed too."""
    given = [*NOISE, "--folds", 0, "-o", work / "unfolded"]
    outcome = done("calibrate", "--no-report", "3RRR", work / "measured.csv", *given)
    assert "no rows were held out (--folds 0)" in outcome.out
    done("calibrate", "3RRR", work / "measured.csv", *given, "--force", "--quiet")
    assert "no rows were held out (--folds 0)" in (work / "unfolded/report.html").read_text("utf-8")


def test_calibrate_spares_a_file_in_the_results_place(work: Path) -> None:
    """A file is not replaced by a result folder, even with --force."""
    Path("taken").write_text("keep")
    outcome = run("calibrate", "3RRR", "measured.csv", *NOISE, "-o", "taken", "--force")
    assert outcome.code == 2
    assert "taken" in outcome.trouble
    assert Path("taken").read_text() == "keep"


def test_demo_refuses_a_link_that_leads_to_itself(work: Path) -> None:
    """It is said in words, before anything is computed."""
    (work / "loop").symlink_to("loop")
    assert "is a link that leads to itself" in run("demo", "5R", "-o", work / "loop").trouble


def test_demo_spares_a_file_in_its_folders_place(work: Path) -> None:
    """Demo's folder replaces no file, even with --force, and hides no mechanism: it is refused."""
    Path("taken").write_text("keep")
    before = contents(work)
    outcome = run("demo", "5R", "-o", "taken", "--force")
    assert outcome.code == 2
    assert "taken" in outcome.trouble
    assert contents(work) == before
    outcome = run("demo", "5R", "-o", "5R")
    assert outcome.code == 2
    assert "5R would hide the mechanism of that name" in outcome.trouble
    assert contents(work) == before


def test_simulate_refuses_one_name_for_truth_and_output(work: Path) -> None:
    """One name for truth and measurements is refused before anything is written."""
    before = contents(work)
    outcome = run("simulate", "3RRR", "plan.csv", "--truth", "same", "-o", "same")
    assert outcome.code == 2
    assert "same" in outcome.trouble
    assert contents(work) == before


def test_failed_simulation_leaves_no_truth(work: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """If the measurements cannot be written, the truth is not left behind either."""
    before = contents(work)

    def fail(*_: object, **__: object) -> None:
        raise pincal.FileError("cannot write new.csv: No space left on device")

    monkeypatch.setattr("pincal.cli.design.write_table", fail)
    outcome = run("simulate", "3RRR", "plan.csv", "--truth", "new", "-o", "new.csv")
    assert outcome.code == 2
    assert "No space left" in outcome.trouble
    assert contents(work) == before


def test_check_tells_a_home_that_does_not_close(work: Path) -> None:
    """'check' says which leg misses the platform at home, by how much, and what home is for."""
    edited("robot/mechanism.yaml", "shoulder: 1.047197551197", "shoulder: 0.95")()
    outcome = run("check", "robot")
    assert outcome.code == 0
    assert "leg_1: home is rough: it closes only within 0.25 m" in " ".join(outcome.out.split())


def test_identifiability_of_more_readings_than_freedoms() -> None:
    """They cannot all be exact, so some noise is taken, and said."""
    outcome = done("identifiability", "4cable")
    assert "rank 16 of 16" in outcome.out
    assert "cannot all be exact: assumed --noise-reading 0.235mm" in outcome.err


def test_a_plan_without_a_coordinate_is_not_told_of_options_of_calibrate(work: Path) -> None:
    """The column that is missing is named, and what takes poses measured in part."""
    table("x [m],y [m]", "0,0")()
    trouble = run("inverse", "3RRR", "t.csv", "-o", "o.csv").trouble
    assert "no column 'phi'" in trouble
    assert "per-leg" not in trouble


def test_identifiability_of_a_plan_out_of_reach(work: Path) -> None:
    """A plan of which no pose is in reach is named as such, not blamed on what is measured."""
    table(POSES, "5,0,0")()
    outcome = run("identifiability", "3RRR", "t.csv")
    assert outcome.code == 2
    assert "no pose of t.csv is in reach of '3RRR': line 2 is out of reach" in outcome.trouble


def test_columns_not_used_are_remarked(work: Path) -> None:
    """The command line says which columns it leaves out, on stderr, and not if quiet."""
    table(f"{POSES},temperature [degC]", "0,0,0,21")()
    outcome = done("inverse", "3RRR", "t.csv", "-o", "readings.csv")
    assert "t.csv: columns not used: temperature" in outcome.err
    quiet = done("inverse", "3RRR", "t.csv", "-o", "again.csv", "--quiet")
    assert quiet.err == ""
    Path("t.csv").write_text("tx [m],y [m],phi [rad]\n0,0,0\n")
    assert "columns not used: tx (is it x?)" in run("inverse", "3RRR", "t.csv", "-o", "a.csv").err


INTERRUPTED = """
import os, signal, sys
class Interrupts:
    def find_spec(self, name, path=None, target=None):
        if name == {name!r}:
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Interrupts())
sys.argv[:] = ["pincal", "check", "5R"]
from pincal_command import main
main()
"""


@pytest.mark.parametrize(
    "name", some_slow(["pinocchio", "pincal.symmetry.detect"], "pincal.symmetry.detect")
)  # at the start, and in a command
def test_ctrl_c_ends_without_a_traceback(name: str) -> None:
    """Ctrl-C while modules are loaded, or later, ends the command as shells expect, silently."""
    done = subprocess.run(
        [sys.executable, "-c", INTERRUPTED.format(name=name)], capture_output=True, text=True
    )
    assert done.returncode in (-signal.SIGINT, 128 + signal.SIGINT)
    assert "Traceback" not in done.stderr


def test_a_prior_said_twice_is_refused(work: Path) -> None:
    """Which of two standard deviations of one name holds, nobody knows: neither is taken."""
    twice = ["--priors", "l=1e-3", "--priors", "l = 1e-4"]
    outcome = run("calibrate", "--no-report", "3RRR", "measured.csv", *NOISE, *twice, "-o", "other")
    assert outcome.code == 2
    assert "--priors l is said twice" in outcome.trouble
    assert not Path("other").exists()


def test_a_prior_may_have_a_unit_of_its_own_kind(work: Path) -> None:
    """In mm or m it is the same; an angle's in mm is refused, and says what the parameter is in."""
    call = ["calibrate", "--no-report", "--folds=0", "3RRR", "measured.csv", *NOISE]
    plain = run(*call, "--priors", "l=1e-3", "-o", "plain")
    typed = run(*call, "--priors", "l=1mm", "-o", "typed")
    assert plain.code == typed.code == 0
    first, second = (
        json.loads(Path(name, "result.json").read_text()) for name in ("plain", "typed")
    )
    assert first["legs"] == second["legs"]
    outcome = run(*call, "--priors", "beta=1mm", "-o", "other")
    assert outcome.code == 2
    assert "beta is in rad" in outcome.trouble
    assert not Path("other").exists()


def test_too_little_memory_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    """Memory that runs out is one message and exit code 2, no traceback."""
    monkeypatch.setattr("pincal.cli.mechanisms.bundled", lambda: np.empty(2**55))
    outcome = run("mechanisms")
    assert outcome.code == 2
    assert "not enough memory" in outcome.trouble


@pytest.mark.parametrize("name", ["\x1b[31mred", "a\x07b", "one\rtwo", "right\u202eleft"])
def test_control_characters_are_escaped(name: str, work: Path) -> None:
    """What files and names hold moves no cursor, rings no bell and turns no text around."""
    Path(f"{name}.csv").write_text(f"x [m],y [m],{name} [m]\n0,oops,1\n".replace("\r", ""))
    said = run("inverse", "5R", f"{name}.csv", "-o", "new").err
    said += run("calibrate", name, f"{name}.csv", "-o", "new").err
    assert not set(said) - {"\n"} & {chr(c) for c in [*range(32), 127, 0x202E]}
    assert ascii(name)[1:-1] in said


def test_what_takes_long_is_said_again(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A line every half minute (here: every moment) says what is done, and since when."""
    monkeypatch.setattr("pincal.cli.app._REMIND", 1e-3)
    with working("looking at photos", 9) as step:
        step(3)
        time.sleep(0.2)
    lines = capsys.readouterr().err.splitlines()
    assert (lines[0], *lines[-2:]) == (
        "looking at photos …",
        *["looking at photos: 3 of 9 … 0 s"] * 2,
    )


def test_messages_are_no_longer_than_can_be_read(work: Path) -> None:
    """A long name, a long cell: the message keeps its beginning and its end."""
    Path("long.csv").write_text("x [m],y [m]\n0," + "9x" * 5000 + "\n")
    for name in ("long.csv", "n" * 9000):
        outcome = run("inverse", "5R", name, "-o", "new")
        assert outcome.code == 2
        assert 20 < len(outcome.err) < 1500


@pytest.mark.parametrize(
    "words",
    [
        ["{}"],
        ["--{}"],
        ["inverse", "5R", "poses.csv", "--{}"],
        ["calibrate", "5R", "m.csv", "-o", "new", "--method", "{}"],
        ["select", "5R", "-o", "new", "--count", "{}"],
        ["inverse", "5R", "poses.csv", "-o", "new", "--units", "{}"],
    ],
)
def test_what_is_typed_wrong_at_length_is_said_short(words: list[str]) -> None:
    """Values, options and commands of 5,000 characters: at most 1,500 are printed."""
    outcome = run(*(word.format("9" * 5000) for word in words))
    assert outcome.code == 2
    assert 20 < len(outcome.err) <= 1500


@pytest.mark.parametrize(
    "line",
    ["measure 5R --session --terminal", "select 5R --sheet -o plan.csv", "inverse 5R a.csv -o -h"],
)
def test_an_option_is_not_the_value_of_another(line: str, work: Path) -> None:
    """Who forgets a value is told so; nothing is named after the option behind."""
    before = contents(work)
    outcome = run(*line.split())
    assert outcome.code == 2
    assert re.search(r"(--session|--sheet|-o) takes a value, and -\S+ is an option", outcome.err)
    assert contents(work) == before


def test_a_fit_that_chi2_contradicts_is_no_success(work: Path) -> None:
    """Noise given far too small: all files are written, exit code 1."""
    small = ["--noise-position", 1e-7, "--noise-orientation", 1e-7, "--folds", 0]
    line = ["calibrate", "--no-report", "3RRR", "measured.csv", *small]
    outcome = run(*line, "-o", "doubted")
    assert outcome.code == 1
    assert "exit code 1, since χ² contradicts the noise" in outcome.err
    assert Path("doubted/mechanism/mechanism.yaml").is_file()


@pytest.mark.slow
def test_a_wrong_row_of_the_set_verify_is_named(work: Path) -> None:
    """One orientation off by 20 mrad, a row to verify with: calibrate, report and doctor name it.

    The exit code is 1, and 0 without that row; the next command leaves it out, and then only that;
    held-out rows that fit are drawn hollow.
    """
    noise = ["--noise-position", 1e-4, "--noise-orientation", 1e-4]
    done("select", "3RRR", "-o", "verified.csv", "--count", 24, "--verify", 6)
    done("simulate", "3RRR", "verified.csv", *noise, "-o", "sound.csv")
    header, *rows = [line.split(",") for line in Path("sound.csv").read_text().splitlines()]
    row = [line[0] for line in rows].index("verify") + 2
    rows[row][3] = str(float(rows[row][3]) + 0.02)
    Path("slip.csv").write_text("\n".join(",".join(line) for line in [header, *rows]))
    doubted = run("calibrate", "3RRR", "slip.csv", *noise, "-o", "doubted")
    name = f"data row {row + 1}"
    assert doubted.code == 1
    assert name in doubted.err
    assert name in Path("doubted/report.html").read_text(encoding="utf-8")
    assert "--loss reject" in doubted.out.splitlines()[-1]
    assert name in done("doctor", "3RRR", "slip.csv", *noise).out
    loss = ("--loss", "reject", "--no-report")
    mended = done("calibrate", "3RRR", "slip.csv", *noise, *loss, "-o", "mended")
    assert f"left out: {name} " in mended.out
    (outlier,) = pincal.load_result("mended").outliers
    assert outlier.row == row
    assert outlier.weight == 0.0
    checked = pincal.load_result("mended")
    hollow = [line for line in checked.plot.residuals().lines if line.get_mfc() == "none"]
    (marks,) = [line.get_ydata() for line in hollow]
    held_out = [k for k, line in enumerate(rows) if line[0] == "verify" and k != row]
    assert np.flatnonzero(np.isfinite(marks)).tolist() == held_out
    assert np.nanmax(marks) < 4.0


def test_the_next_command_is_of_what_was_typed(work: Path) -> None:
    """It keeps what is known of the measurements, leaves out what it has not, and can be typed."""
    small = ["--noise-position", "1e-7", "--noise-orientation", "1e-7"]
    line = ["calibrate", "3RRR", "measured.csv", *small, "--folds", 0, "--no-report", "--verbose"]
    typed = run(*line, "-o", "doubted").out.splitlines()[-1].removeprefix("next: pincal ").split()
    assert typed == ["explain", "3RRR", "measured.csv", *small, "--folds", "0"]
    assert run(*[*typed[:-1], "2"]).code == 0


def test_the_verdict_comes_first(work: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What the platform's error is, in the first of about ten lines of 80 characters."""
    monkeypatch.setattr(pincal.cli.app.stdout, "width", 80)
    line = ["calibrate", "--no-report", "3RRR", "measured.csv", *NOISE, "--folds", 0]
    said = done(*line, "-o", "short").out.splitlines()
    assert said[0].startswith(("✓ 3RRR: ", "⚠ 3RRR: "))
    assert said[-1].startswith("next: pincal ")
    assert len(said) <= 16
    assert max(map(len, said)) <= 80


def test_nothing_is_lost_at_80_columns(work: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Names and numbers that do not fit go on in the next line: none ends in dots."""
    monkeypatch.setattr(pincal.cli.app.stdout, "width", 80)
    line = ["calibrate", "--no-report", "3RRR", "measured.csv", *NOISE, "--folds", 0, "--verbose"]
    said = done(*line, "-o", "long").out
    assert said.startswith(("✓ 3RRR: ", "⚠ 3RRR: "))
    assert "…" not in said
    for leg in ("leg_1", "leg_2", "leg_3"):
        assert f"{leg} " in said


def test_noise_may_have_a_unit(work: Path) -> None:
    """20um is 2e-5; a unit of another dimension, or none that there is, is refused."""
    for name, noise in (("a", ["2e-5", "1e-3"]), ("b", ["20um", "1 mrad"])):
        given = ["--noise-position", noise[0], "--noise-orientation", noise[1]]
        done("simulate", "3RRR", "plan.csv", *given, "-o", f"{name}.csv")
    assert Path("a.csv").read_bytes() == Path("b.csv").read_bytes()
    for wrong in ("20mrad", "20 parsec", "about 3"):
        outcome = run("simulate", "3RRR", "plan.csv", "--noise-position", wrong, "-o", "c.csv")
        assert outcome.code == 2
        assert "um" in outcome.err
