"""A mechanism of a data sheet's dimensions moves as these say, and can be calibrated."""

from __future__ import annotations

import csv
import re
import shlex
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import Outcome, contents, done, run
from data_sheets import FORMS, wrapped
from marks import quick, some_slow

import pincal
from pincal.architectures.catalogue import ARCHITECTURES, architecture_of, dh_joints

PAGE = Path(__file__).parents[1] / "docs" / "your_mechanism.md"
KINDS = list(FORMS)
NOISE = ["--noise-position", "1e-9", "--noise-orientation", "1e-9", "--noise-reading", "1e-9"]
DH = """a [mm],alpha [deg],d [mm],theta [deg],lower [deg],upper [deg]
30,90,400,0,-170,170
350,0,20,10,-110,120
60,-90,0,0,-120,150
0,90,380,0,-180,180
0,-90,5,0,-115,115
0,0,80,20,-300,300
"""


def sizes(kind: str, seed: int) -> dict[str, Any]:
    """Return dimensions of some size, each a little other than its share."""
    rng = np.random.default_rng(seed)
    found: dict[str, Any] = {}
    for one in ARCHITECTURES[kind].dimensions:
        value = float(one.default) * found[one.multiple_of] if one.multiple_of else one.default
        if one.unit:
            fixed = one.multiple_of or one.unit == "rad"
            value *= rng.uniform(0.97, 1.03) * (1.0 if fixed else 2.0)
        found[one.name] = value
    if kind == "hexapod":
        found["zero_length"] = 0.2
    return found


@pytest.mark.parametrize("seed", quick(1, range(2)))
@pytest.mark.parametrize("kind", some_slow(KINDS, "cable-4", "linear-delta", "hexapod", "delta"))
def test_readings_are_those_of_the_dimensions(kind: str, seed: int) -> None:
    """Inverse kinematics is the closed form of the dimensions, over the workspace."""
    own = sizes(kind, seed)
    mechanism = pincal.new_mechanism(kind, **own)
    poses = pincal.sample_workspace(mechanism, 50, seed=seed)
    found = pincal.inverse(mechanism, poses)
    assert found.reached.all()
    off = found.readings - FORMS[kind](own, poses)
    turns = np.array(mechanism.reading_units) == "rad"
    np.testing.assert_allclose(np.where(turns, wrapped(off), off), 0.0, atol=1e-9)


@pytest.mark.parametrize("kind", quick(1, ["cable-8", "cable-4"]))
@pytest.mark.parametrize("way", quick(1, ["crossed", "straight", "turned"]))
def test_cables_go_the_way_that_is_asked_for(kind: str, way: str) -> None:
    own = sizes(kind, 5) | {"cables": way}
    if (kind, way) == ("cable-4", "turned"):
        with pytest.raises(pincal.MechanismError, match="expected crossed or straight"):
            pincal.new_mechanism(kind, **own)
        return
    if kind == "cable-8":
        own |= {"platform_length": 0.5, "platform_width": 1.1, "platform_height": 0.6}
    mechanism = pincal.new_mechanism(kind, **own)
    poses = pincal.sample_workspace(mechanism, 20, seed=1)
    np.testing.assert_allclose(
        pincal.inverse(mechanism, poses).readings, FORMS[kind](own, poses), atol=1e-9
    )


BUNDLED = {
    "6UPS": ("hexapod", {"base_radius": 0.4, "platform_radius": 0.3, "base_half_angle": 0.3,
                         "platform_half_angle": 0.3, "height": 1.8, "shortest": 1.6,
                         "longest": 2.6}),
    "delta": ("delta", {"base_radius": 0.2, "platform_radius": 0.06, "arm": 0.25, "rod": 0.55,
                        "height": 0.5, "arm_up": -0.6, "arm_down": 1.4}),
    "linear_delta": ("linear-delta", {"delta_radius": 0.17475, "rod": 0.333,
                                      "endstop_height": 0.29705, "print_radius": 0.12}),
    "5R": ("five-bar", {"motor_distance": 1.0, "driving_link": 0.75, "conducted_link": 1.1,
                        "height": 1.1, "motor_least": np.pi / 4, "motor_most": 5 * np.pi / 4}),
    "3RRR": ("3-RRR", {"base_radius": 6 / 3**0.5, "platform_radius": 1.5 / 3**0.5,
                       "proximal": 1.5, "distal": 1.5}),
}  # fmt: skip


@pytest.mark.parametrize("name", BUNDLED)
def test_a_bundled_mechanism_is_that_of_its_dimensions(name: str) -> None:
    """Parameters, labels, homes and limits."""
    kind, own = BUNDLED[name]
    made, bundled = pincal.new_mechanism(kind, **own), pincal.load_mechanism(name)
    assert made.parameters.ids == bundled.parameters.ids
    assert made.labels == bundled.labels
    np.testing.assert_allclose(made.parameters.values, bundled.parameters.values, atol=1e-12)
    for one, other in zip(made.legs, bundled.legs, strict=True):
        np.testing.assert_allclose(one.home, other.home, atol=1e-9)
        limits = [[(j.lower, j.upper) for j in leg.moving] for leg in (one, other)]
        np.testing.assert_allclose(*limits, atol=1e-12)


def made(kind: str, folder: Path, *more: object) -> Outcome:
    """Run ``pincal new``, then the command that it prints, for a few poses of all legs."""
    outcome = done("new", kind, *more, "-o", folder)
    line = outcome.out.splitlines()[-1].removeprefix("next: pincal ")
    files = {"sheet.xlsx": folder / "sheet.csv", "plan.csv": folder / "plan.csv"}
    words = [files.get(word, word) for word in shlex.split(line)]
    done(*words, "--measure", "pose", "--count", 16, "--starts", 1)
    return outcome


@pytest.mark.parametrize("kind", some_slow(KINDS, *(set(KINDS) - {"five-bar", "linear-delta"})))
def test_the_machine_that_was_measured_is_identified(kind: str, tmp_path: Path) -> None:
    """From the folder, with noise of a nanometre: each parameter, within 5 standard errors."""
    folder = pincal.new_mechanism(kind).save(tmp_path / "own")
    nominal = pincal.load_mechanism(folder)
    truth, fine = pincal.disturb(nominal, 1e-4, seed=0), pincal.Noise(1e-9, 1e-9, 1e-9)
    poses = pincal.sample_workspace(nominal, 16, seed=0)
    data = pincal.simulate(nominal, truth, poses, fine, seed=0).measurements
    result = pincal.calibrate(nominal, data, noise=fine)
    true = truth.parameters.values
    assert np.abs(true - nominal.parameters.values).max() > 1e-5
    std = np.array([one.std for one in result.parameters])
    assert std.max() < 1e-6
    assert np.abs((result.identified.parameters.values - true) / std).max() < 5.0


@pytest.mark.parametrize(
    "kind",
    [
        "five-bar",
        *(pytest.param(one, marks=pytest.mark.slow) for one in KINDS if one != "five-bar"),
    ],
)
def test_what_is_written_can_be_checked_planned_measured_and_calibrated(
    kind: str, tmp_path: Path
) -> None:
    """By commands; the identified parameters are those of the machine that was measured."""
    folder, truth = tmp_path / "own", tmp_path / "truth"
    made(kind, folder)
    assert {"mechanism.yaml", "platform.urdf", "plan.csv", "sheet.csv"} < set(contents(folder))
    mechanism = pincal.load_mechanism(folder)
    assert mechanism.name == "own"
    assert all(one.label for one in mechanism.parameters)
    assert "closes at home within" in done("check", folder).out
    some = (
        "--candidates",
        folder / "plan.csv",
        *["--measure", "pose", "--count", "8", "--starts", "1"],
    )
    done("select", folder, *some, *NOISE, "-o", tmp_path / "plan.csv")
    data, result = tmp_path / "measured.csv", tmp_path / "result"
    error = ("--disturb", 1e-4, "--truth", truth)
    done("simulate", folder, folder / "plan.csv", "-o", data, *error, *NOISE)
    done("calibrate", "--no-report", folder, data, *NOISE, "--folds", 0, "-o", result)
    true = pincal.load_mechanism(truth).parameters.values
    identified = pincal.load_mechanism(result).parameters.values
    assert np.abs(true - mechanism.parameters.values).max() > 1e-5
    np.testing.assert_allclose(identified, true, atol=2e-7)


@pytest.mark.slow
@pytest.mark.parametrize("stroke", [0.003, 0.02])
def test_strokes_that_are_small_against_the_machine_are_sampled_in_full(stroke: float) -> None:
    """All legs go from end to end of a stroke of a hundredth of their length."""
    hexapod = pincal.new_mechanism("hexapod", shortest=0.399, longest=0.399 + stroke)
    poses = pincal.sample_workspace(hexapod, 1000, seed=0)
    assert len(np.unique(poses, axis=0)) == 1000
    gone = np.ptp(pincal.inverse(hexapod, poses).readings, axis=0)
    assert (gone > 0.98 * stroke).all()
    assert (gone <= stroke + 1e-12).all()


def dh_pose(q: np.ndarray, modified: bool) -> np.ndarray:
    """Return the tool of the table's arm at angles, by products of its four displacements."""
    rows = np.array([[float(cell) for cell in line.split(",")[:4]] for line in DH.splitlines()[1:]])
    T = np.eye(4)
    for (a, alpha, d, theta), turn in zip(
        rows * (1e-3, np.pi / 180, 1e-3, np.pi / 180), q, strict=True
    ):
        c, s, ca, sa = np.cos(theta + turn), np.sin(theta + turn), np.cos(alpha), np.sin(alpha)
        if modified:
            T = T @ [
                [c, -s, 0, a],
                [s * ca, c * ca, -sa, -sa * d],
                [s * sa, c * sa, ca, ca * d],
                [0, 0, 0, 1],
            ]
        else:
            T = T @ [
                [c, -s * ca, s * sa, a * c],
                [s, c * ca, -c * sa, a * s],
                [0, sa, ca, d],
                [0, 0, 0, 1],
            ]
    return T


@pytest.mark.parametrize("convention", ["standard", "modified"])
def test_an_arm_of_a_table_moves_as_the_table_says(convention: str, tmp_path: Path) -> None:
    table = tmp_path / "dh.csv"
    table.write_text(DH)
    arm = pincal.new_mechanism("arm", dh=str(table), convention=convention)
    with pytest.raises(pincal.PincalError, match=r"the convention of the table .* is 'x'"):
        pincal.new_mechanism("arm", dh=str(table), convention="x")
    q = np.random.default_rng(0).uniform(-1.0, 1.0, (20, 6))
    found = arm.platform.matrices(pincal.forward(arm, q).poses)
    expected = np.stack([dh_pose(one, convention == "modified") for one in q])
    np.testing.assert_allclose(found, expected, atol=1e-9)
    joints = dh_joints(table)
    np.testing.assert_allclose(np.degrees([joints[1].lower, joints[1].upper]), [-110, 120])


@pytest.mark.slow
def test_an_arm_of_a_table_is_calibrated(tmp_path: Path) -> None:
    """By commands, as far as can be: the calibrated arm goes where the true one goes."""
    (tmp_path / "dh.csv").write_text(DH)
    folder, data = tmp_path / "own", tmp_path / "measured.csv"
    made("arm", folder, "--dh", tmp_path / "dh.csv")
    done("check", folder)
    truth, result = tmp_path / "truth", tmp_path / "result"
    error = ("--disturb", 1e-4, "--truth", truth)
    done("simulate", folder, folder / "plan.csv", "-o", data, *error, *NOISE)
    done("calibrate", "--no-report", folder, data, *NOISE, "--folds", 0, "-o", result)
    q = np.random.default_rng(1).uniform(-1.0, 1.0, (10, 6))
    models = [pincal.load_mechanism(one) for one in (folder, truth, result)]
    nominal, true, found = (m.platform.matrices(pincal.forward(m, q).poses) for m in models)
    assert np.abs(nominal - true).max() > 1e-4
    np.testing.assert_allclose(found, true, atol=1e-6)


def filled(folder: Path, rows: int | None = None) -> Path:
    """Fill a sheet in with what the nominal machine reads at the planned poses."""
    with (folder / "sheet.csv").open(newline="") as file:
        table = list(csv.DictReader(file))
    for row in table[:rows]:
        row |= {head: row[f"planned_{head}"] for head in row if f"planned_{head}" in row}
    with (folder / "filled.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, list(table[0]))
        writer.writeheader()
        writer.writerows(table)
    return folder / "filled.csv"


@pytest.fixture(scope="module")
def bar(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a new five-bar."""
    folder = tmp_path_factory.mktemp("bar") / "bar"
    made("five-bar", folder, "--motor-distance", "300mm", "--height", "0.3m")
    return folder


def test_the_sheet_that_is_filled_in_is_calibrated_as_it_is(bar: Path, tmp_path: Path) -> None:
    outcome = done("calibrate", "--no-report", bar, filled(bar), "-o", tmp_path / "result")
    result = pincal.load_result(tmp_path / "result")
    np.testing.assert_allclose(
        result.parameters.values, [p.identified for p in result.parameters], atol=1e-5
    )
    assert result.validation is not None, outcome.out
    assert result.validation.rows == 6


def test_the_sheet_says_what_is_planned_and_leaves_room_for_what_is_measured(bar: Path) -> None:
    """Each planned column has an empty one of the same name and unit; numbers are the plan's."""
    with (bar / "sheet.csv").open(newline="") as file:
        table = list(csv.DictReader(file))
    planned_columns = [column for column in table[0] if column.startswith("planned_")]
    measured_columns = [column for column in table[0] if all(row[column] == "" for row in table)]
    assert [f"planned_{column}" for column in measured_columns] == planned_columns
    assert {"x [mm]", "y [mm]", "leg_1 [deg]", "leg_2 [deg]"} == set(measured_columns)
    plan = pincal.Plan.from_csv(bar / "plan.csv", bar)
    assert len(table) == len(plan)
    planned = [[float(row["planned_x [mm]"]), float(row["planned_y [mm]"])] for row in table]
    np.testing.assert_allclose(1e3 * plan.poses, planned, atol=1e-4)


def test_rows_of_a_sheet_that_are_not_filled_in_are_skipped_and_said(bar: Path) -> None:
    """A half-filled sheet is calibrated by its filled rows, and how many were skipped is said."""
    outcome = run("calibrate", bar, filled(bar, 10), "-o", bar / "half", "--no-report")
    assert outcome.code in (0, 1), outcome.err
    skipped = len(pincal.Plan.from_csv(bar / "plan.csv", bar)) - 10
    assert f"{skipped} rows without anything measured or read are skipped" in outcome.err


IMPOSSIBLE = {
    "hexapod --height -400mm": "more than zero",
    "hexapod --height 300mm --shortest 500mm": "at 331.735 mm, outside its limits 500 mm to 750 mm",
    "hexapod --longest 100mm": "expected more than shortest",
    "hexapod --base-half-angle 30deg --platform-half-angle 30deg": "singular",
    "hexapod --base-half-angle 70deg": "expected 0 deg to 60 deg",
    "hexapod --rod 300mm": "rod is no dimension of a hexapod",
    "delta --rod 100mm --height 500mm": "too short or too long for the home pose",
    "delta --arm-up 1rad": "outside its limits",
    "linear-delta --rod 200mm": "does not reach from a tower",
    "five-bar --height 1m": "too short or too long for the home pose",
    "3-RRR --distal 10mm": "too short or too long for the home pose",
    "cable-4 --platform-width 3m": "expected less than frame_width",
    "cable-8 --cables straight": "singular",
    "arm": "an arm needs a Denavit-Hartenberg table",
    "arm --dh none.csv": "none.csv",
    "hexpod": "did you mean 'hexapod'?",
}


@pytest.mark.parametrize("typed", IMPOSSIBLE)
def test_what_cannot_be_is_refused_and_nothing_is_written(typed: str, tmp_path: Path) -> None:
    outcome = run("new", *shlex.split(typed), "-o", tmp_path / "own")
    assert outcome.code == 2
    assert IMPOSSIBLE[typed] in outcome.trouble
    assert contents(tmp_path) == {}


def test_a_number_without_a_unit_is_refused(tmp_path: Path) -> None:
    """250 may be meant in mm, and would be metres elsewhere."""
    outcome = run("new", "hexapod", "--base-radius", "250", "-o", tmp_path / "own")
    assert outcome.code == 2
    assert "'250': expected a number, with one of m, cm, mm" in outcome.err


def test_dimensions_that_are_not_given_are_said(tmp_path: Path) -> None:
    """They are in proportion, and all that are printed make the same mechanism."""
    given = ("--motor-distance", "300mm", "--height", "250mm", "--driving-link", "0.2m")
    first = made("five-bar", tmp_path / "one", *given)
    bar = pincal.load_mechanism(tmp_path / "one")
    assert bar.parameters["leg_2.A_x"].nominal == pytest.approx(0.15)
    assert bar.parameters["leg_1.l"].nominal == pytest.approx(0.2)
    printed = re.findall(r"(\w+) ([\d.]+) (mm|deg)\b", " ".join(first.out.split()))
    again = {name: float(value) * {"mm": 1e-3, "deg": np.pi / 180}[u] for name, value, u in printed}
    two = pincal.new_mechanism("five-bar", **again)
    np.testing.assert_allclose(two.parameters.values, bar.parameters.values, atol=1e-12)


@pytest.mark.parametrize("name", ["3RRR", "3_rrr", "LinearDelta", "linear_delta", "Hexapod"])
def test_architectures_are_found_however_they_are_written(name: str) -> None:
    plain = name.lower().replace("_", "")
    assert architecture_of(name).name.lower().replace("-", "") == plain


def test_python_on_the_page_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Each block as it stands; the legs that differ close at home and are calibrated."""
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"```python\n(.*?)```", PAGE.read_text("utf-8"), re.DOTALL)
    for block in blocks:
        exec(compile(block, str(PAGE), "exec"), {})
    assert "right.L: conducted link, new" in capsys.readouterr().out
    assert pincal.load_mechanism("my_hexapod").parameters["leg_3.OA"].nominal == 0.402
    bar = pincal.load_mechanism("my_bar")
    poses = pincal.sample_workspace(bar, 12, seed=0)
    truth = pincal.disturb(bar, 1e-4, seed=1)
    data = pincal.simulate(bar, truth, poses, pincal.Noise(1e-9), seed=2).measurements
    found = pincal.calibrate(bar, data, noise=pincal.Noise(1e-9)).identified
    np.testing.assert_allclose(found.parameters.values, truth.parameters.values, atol=1e-6)


def test_the_page_names_each_dimension() -> None:
    page = PAGE.read_text("utf-8")
    for one in ARCHITECTURES.values():
        assert f"`{one.name}`" in page
        for each in one.dimensions:
            assert f"`{each.name}`" in page, (one.name, each.name)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("architecture", "low", "high"),
    [
        ("cable-4", (-1.0, -0.75, -0.5), (1.0, 0.75, 0.5)),
        ("cable-8", (-2.0, -2.0, 0.3), (2.0, 2.0, 3.0)),
        ("linear-delta", (-0.12, -0.12, 0.0), (0.12, 0.12, 0.3)),
    ],
)
def test_planned_poses_are_where_the_machine_works(
    tmp_path: Path, architecture: str, low: tuple[float, ...], high: tuple[float, ...]
) -> None:
    """In the frame of the cables, above the bed."""
    made(architecture, tmp_path / "own")
    mechanism = pincal.load_mechanism(tmp_path / "own")
    poses = pincal.Plan.from_csv(tmp_path / "own" / "plan.csv", mechanism).poses[:, :3]
    assert (poses >= low).all()
    assert (poses <= high).all()
