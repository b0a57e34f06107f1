"""A calibration's result is written whatever fails behind it, and a damaged one is refused."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from arms import loaded
from command_line import done, run
from marks import quick

import pincal
import pincal.show.report
from pincal.kinematics.configurations import home_of, joints_at


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A plan of the five-bar with rows to verify with, and measurements of it."""
    folder = tmp_path_factory.mktemp("kept")
    plan = ("--count", 12, "--verify", 4, "-o", folder / "plan.csv")
    done("select", "5R", *plan)
    noise = ("--noise-position", "20um", "--disturb", 1e-3)
    done("simulate", "5R", folder / "plan.csv", *noise, "-o", folder / "measured.csv")
    return folder


def with_verifying(folder: Path, count: int) -> Path:
    """Return measurements of which so many rows are to verify with."""
    lines = (folder / "measured.csv").read_text("utf-8").splitlines()
    rows = [one.replace("verify", "all") for one in lines[1:]]
    rows[:count] = [f"verify,{one.partition(',')[2]}" for one in rows[:count]]
    path = folder / f"verify_{count}.csv"
    path.write_text("\n".join([lines[0], *rows]) + "\n", "utf-8")
    return path


@pytest.mark.parametrize(
    ("verifying", "options"),
    quick(
        1,
        [
            (1, ("--method", "per-leg")),
            (1, ()),
            (4, ("--method", "per-leg")),
        ],
    ),
)
def test_what_is_infinite_is_written_and_loaded(
    folder: Path, tmp_path: Path, verifying: int, options: tuple[str, ...]
) -> None:
    """Intervals of one row: null in JSON, infinite when loaded."""
    data = with_verifying(folder, verifying)
    done("calibrate", "5R", data, *options, "-o", tmp_path / "r", "--no-report")

    def refuse(constant: str) -> None:
        raise AssertionError(f"{constant} is no JSON")

    text = (tmp_path / "r" / "result.json").read_text("utf-8")
    json.loads(text, parse_constant=refuse)
    result = pincal.load_result(tmp_path / "r")
    result.save(tmp_path / "again")
    assert (tmp_path / "again" / "result.json").read_text("utf-8") == text
    assert result.validation is not None
    assert result.validation.rows == verifying


def test_rows_to_verify_with_are_in_no_leg_s_fit(folder: Path) -> None:
    """Each leg alone finds the same parameters to the last bit, with those rows or without."""
    data = pincal.Measurements.from_csv(folder / "measured.csv", "5R")
    every, part = (
        pincal.calibrate("5R", one, method="per-leg", noise=pincal.Noise(position=2e-5))
        for one in (data, data.rows(~data.verifying))
    )
    for one, other in zip(every.parameters, part.parameters, strict=True):
        assert one.identified == pytest.approx(other.identified, abs=1e-12)
        assert one.std == pytest.approx(other.std, rel=1e-9)
    assert every.validated().validation.rows == 4  # type: ignore[union-attr]


def test_a_report_that_cannot_be_drawn_loses_nothing(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The result is written as without a report; a warning says why, and so does the exit code."""

    def fail(*_: Any, **__: Any) -> None:
        raise ZeroDivisionError("no such figure")

    measured = folder / "measured.csv"
    done("calibrate", "5R", measured, "-o", tmp_path / "plain", "--no-report")
    monkeypatch.setattr(pincal.show.report.Report, "html", fail)
    outcome = run("calibrate", "5R", measured, "-o", tmp_path / "r")
    assert outcome.code == 3
    assert "ZeroDivisionError: no such figure" in outcome.err
    texts = [(tmp_path / name / "result.json").read_bytes() for name in ("r", "plain")]
    assert texts[0] == texts[1]
    assert not (tmp_path / "r" / "report.html").exists()
    pincal.load_mechanism(tmp_path / "r")


def test_an_arm_whose_length_gives_way_has_a_report() -> None:
    """Its legs are drawn at joint positions, deformations of the chain apart."""
    term = pincal.Term("bends", pincal.Share(per=10.0), of="temperature")
    arm = loaded("panda")
    (leg,) = arm.legs
    name = next(name for name, unit in leg.placed.items() if unit == "m")
    bending = replace(leg, terms=((name, term),), parameters=(*leg.parameters, ("bends", 1e-3)))
    machine = replace(arm, legs=(bending,))
    joints = joints_at(machine, home_of(machine)).joints
    assert joints[leg.name].shape == (1, len(leg.moving))


@pytest.mark.slow
@pytest.mark.parametrize("count", [20, 100])
def test_damage_is_one_message(count: int, folder: Path, tmp_path: Path) -> None:
    """Any leaf of the data replaced by what it is not: loaded and said, or refused in one line."""
    done("calibrate", "5R", folder / "measured.csv", "-o", tmp_path / "r", "--no-report")
    path = tmp_path / "r" / "result.json"
    whole = json.loads(path.read_text("utf-8"))
    random, refused = np.random.default_rng(0), list[str]()
    for _ in range(count):
        damaged = json.loads(json.dumps(whole))
        at, key = damaged, "data"
        while isinstance(at[key], dict | list) and len(at[key]) and random.random() < 0.9:
            at = at[key]
            keys = list(at) if isinstance(at, dict) else range(len(at))
            key = keys[int(random.integers(len(keys)))]
        at[key] = (None, "x", [], {}, -1.5)[int(random.integers(5))]
        path.write_text(json.dumps(damaged), "utf-8")
        try:
            str(pincal.load_result(path.parent))
        except pincal.MeasurementError as error:
            refused.append(str(error))
    assert len(refused) > count / 2
    assert max(map(len, refused)) < 600


def test_what_is_not_determined_is_not_off(tmp_path: Path) -> None:
    """Two poses determine nothing: no drift or scale is said to matter, or not to."""
    (tmp_path / "few.csv").write_text("x [m],y [m]\n0,1.1\n0.1,1.2\n", "utf-8")
    outcome = done("identifiability", "5R", tmp_path / "few.csv")
    assert "not determined" in outcome.out
    assert "inf" not in outcome.out
    assert "matter" not in outcome.out


def test_frames_that_move_no_parameter_are_no_trouble(folder: Path) -> None:
    """With frame and target unknown and one coordinate measured, some freedoms are outside."""
    unknown = ("--unknown-frame", "--unknown-target", "--measure", "x")
    outcome = done("identifiability", "5R", folder / "measured.csv", *unknown)
    assert "freedoms of frames" in " ".join(outcome.out.split())


def test_gravity_on_a_vertical_joint_is_no_term(tmp_path: Path) -> None:
    """Forward kinematics of the saved arm misses its own rows by no more than the fit says.

    Where its base stands on the floor, gravity loads the first joint by rounding and alignment.
    """
    arm = replace(loaded("ur10"), load=pincal.Load(mass=5.0, centre=(0.02, 0.0, 0.05)))
    random = np.random.default_rng(1)
    readings = random.uniform(-1.5, 1.5, (40, 6))
    turned = readings.copy()
    turned[:, 0] += 2e-3 * np.sin(3.0 * readings[:, 0])  # as a term of that joint might
    poses = pincal.forward(arm, turned).poses
    data = pincal.Measurements(poses, readings=readings)
    noise = pincal.Noise(position=5e-4, orientation=5e-4)
    terms = ("gravity",)
    result = pincal.calibrate(arm, data, noise=noise, terms=terms)
    assert "arm.shoulder_pan_joint_gravity" not in result.parameters.ids
    assert "arm.shoulder_lift_joint_gravity" in result.parameters.ids
    result.save(tmp_path / "r")
    machine = pincal.load_mechanism(tmp_path / "r")
    reached = pincal.forward(machine, readings, poses).poses
    (position,) = (one for one in result.observed if one.name == "x")
    assert np.abs(reached[:, 0] - poses[:, 0] - position.residuals).max() < 1e-9
