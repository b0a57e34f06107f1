"""Units of tables: readings in encoder counts, and numbers in the units that were asked for."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import done, run
from frames import frame_of
from measured import machine

import pincal
from pincal.files.measurements import read_measurements, read_readings
from pincal.files.table import read_table
from pincal.words.numbers import Units

NOISE = pincal.Noise(1e-4, 1e-4, 1e-5)
COUNTS = 4096 / (2 * np.pi)
LEGS = ("leg_1", "leg_2", "leg_3")
GIVEN = ("--noise-position", "0.1mm", "--noise-orientation", "0.1mrad", "--noise-reading", "1e-5")


def counting(mechanism: pincal.Mechanism, counts: dict[str, float]) -> pincal.Mechanism:
    """Return a mechanism whose sensors say how many counts one rad is, by leg."""
    legs = (
        replace(leg, sensors=(replace(leg.sensors[0], counts_per_unit=counts.get(leg.name)),))
        for leg in mechanism.legs
    )
    return replace(mechanism, legs=tuple(legs))


@pytest.fixture(scope="module")
def encoders(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A mechanism's folder whose encoders count 4096 a turn."""
    mechanism = counting(pincal.load_mechanism("3RRR"), dict.fromkeys(LEGS, COUNTS))
    return mechanism.save(tmp_path_factory.mktemp("encoders") / "m")


@pytest.fixture(scope="module")
def counted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A CSV whose first two readings are counts of an encoder of 4096 a turn."""
    mechanism, _, data = machine("3RRR", 24, NOISE)
    frame = frame_of(data, mechanism)
    for leg in ("leg_1", "leg_2"):
        frame[f"{leg} [counts]"] = frame.pop(f"{leg} [rad]") * COUNTS
    path = tmp_path_factory.mktemp("counts") / "m.csv"
    frame.to_csv(path, index=False)
    return path


def test_readings_in_counts_are_read_by_the_scale_that_was_said(counted: Path) -> None:
    """The same numbers as in radians, whoever said the scale: Python, or mechanism.yaml."""
    mechanism, _, data = machine("3RRR", 24, NOISE)
    scaled = counting(mechanism, {"leg_1": COUNTS, "leg_2": COUNTS})
    np.testing.assert_allclose(read_readings(counted, scaled)[0], data.readings, rtol=1e-12)
    folder = scaled.save(counted.parent / "machine")
    assert "counts_per_unit: 651.89" in (folder / "mechanism.yaml").read_text()
    assert pincal.load_mechanism(folder).counts == scaled.counts
    np.testing.assert_allclose(read_readings(counted, folder)[0], data.readings, rtol=1e-12)


def test_standard_deviations_are_in_counts_too(tmp_path: Path) -> None:
    """A column sigma_leg_1 [counts] has the scale of leg_1, headers however they are written."""
    mechanism = counting(pincal.load_mechanism("5R"), {"leg_1": 100.0})
    rows = "x [m],y [m],leg_1 (counts),leg_2 [rad],sigma_leg_1 [counts],sigma_leg_2 [rad]\n"
    (tmp_path / "m.csv").write_text(rows + "0,0.1,50,1,2,0.1\n")
    data = read_measurements(tmp_path / "m.csv", mechanism)
    assert data.readings[0, 0] == 0.5
    assert data.sigma_readings is not None
    assert data.sigma_readings[0, 0] == 0.02


def test_counts_without_a_scale_are_refused_with_what_to_say(counted: Path, tmp_path: Path) -> None:
    """The message names the key of mechanism.yaml."""
    outcome = run("calibrate", "--no-report", "3RRR", counted, "-o", tmp_path / "r")
    assert outcome.code == 2
    assert "column 'leg_1' is in counts, of unknown number per rad" in outcome.trouble
    assert "counts_per_unit" in outcome.trouble


def test_scales_are_checked_where_they_are_said(tmp_path: Path) -> None:
    """No number above 0: in Python and in mechanism.yaml."""
    mechanism = pincal.load_mechanism("5R")
    with pytest.raises(pincal.MechanismError, match="expected a number above 0"):
        counting(mechanism, {"leg_1": -1.0})
    yaml = counting(mechanism, {"leg_1": 2.5}).save(tmp_path / "bar") / "mechanism.yaml"
    yaml.write_text(yaml.read_text().replace("counts_per_unit: 2.5", "counts_per_unit: 0"))
    with pytest.raises(pincal.MechanismError, match="counts_per_unit"):
        pincal.load_mechanism(yaml.parent)


def test_positions_have_no_counts(tmp_path: Path) -> None:
    """Only readings do: elsewhere counts are a unit like any that is not understood."""
    (tmp_path / "m.csv").write_text("x [counts],y [m],leg_1 [rad],leg_2 [rad]\n0,0.1,1,1\n")
    with pytest.raises(pincal.MeasurementError, match=r"unit \[counts\]; expected \[m\]"):
        read_measurements(tmp_path / "m.csv", "5R")


def test_from_counts_to_a_commanded_pose_in_counts(
    counted: Path, encoders: Path, tmp_path: Path
) -> None:
    """Calibrated from counts, the result knows its encoders: poses to counts, and back in mm."""
    two = counting(pincal.load_mechanism("3RRR"), {"leg_1": COUNTS, "leg_2": COUNTS})
    asked = (counted, "--units", "counts", "-o", tmp_path / "i.csv")
    outcome = run("inverse", two.save(tmp_path / "two"), *asked)
    assert outcome.code == 2
    assert "the encoder counts per rad or m of leg_3 are not known" in outcome.trouble
    result, poses = tmp_path / "result", tmp_path / "poses.csv"
    done("calibrate", "--no-report", encoders, counted, *GIVEN, "--folds", 0, "-o", result)
    done("inverse", result, *asked)
    written = read_table(tmp_path / "i.csv")
    assert list(written.units.values()) == ["counts"] * 3
    done("forward", result, tmp_path / "i.csv", "--units", "mm,deg", "-o", poses)
    assert read_table(poses).units == {"x": "mm", "y": "mm", "phi": "deg"}
    there = pincal.Plan.from_csv(poses, "3RRR").poses
    asked = pincal.Plan.from_csv(counted, "3RRR").poses
    np.testing.assert_allclose(there, asked, atol=1e-9)


@pytest.mark.parametrize("units", ["mm,deg", "in,turn", "um,mrad", "cm"])
def test_what_is_written_in_other_units_is_read_again(units: str, tmp_path: Path) -> None:
    """Headers say the unit, so that numbers come back to a picometre or picoradian."""
    plan = pincal.Plan(np.array([[0.1, -0.2, 0.3], [0.0, 0.1, -0.1]]))
    plan.to_csv(tmp_path / "p.csv", "3RRR")
    done("inverse", "3RRR", tmp_path / "p.csv", "--units", units, "-o", tmp_path / "r.csv")
    done("simulate", "3RRR", tmp_path / "p.csv", "--units", units, "-o", tmp_path / "m.csv")
    readings = pincal.inverse("3RRR", plan.poses).readings
    again = read_readings(tmp_path / "r.csv", "3RRR")[0]
    np.testing.assert_allclose(again, readings, rtol=0.0, atol=1e-12)
    named = read_table(tmp_path / "m.csv").units
    assert named["x"] in units.split(",")
    assert len(read_measurements(tmp_path / "m.csv", "3RRR")) == 2


@pytest.mark.parametrize(
    ("units", "why"),
    [
        ("parsec", "'parsec' is not a known unit; give"),
        ("mm,cm", "'cm' is a second unit of length"),
    ],
)
def test_units_that_are_none_are_refused(units: str, why: str, tmp_path: Path) -> None:
    """An unknown unit, or two of lengths: nothing is written."""
    pincal.Plan(np.array([[0.1, -0.2, 0.3]])).to_csv(tmp_path / "p.csv", "3RRR")
    outcome = run("inverse", "3RRR", tmp_path / "p.csv", "--units", units, "-o", tmp_path / "r.csv")
    assert outcome.code == 2
    assert why in outcome.trouble
    assert not (tmp_path / "r.csv").exists()


@pytest.mark.parametrize(("units", "places"), [("", 12), ("mm,deg", 10), ("um,mrad", 9)])
def test_what_commands_write_has_no_noise_of_digits(
    units: str, places: int, tmp_path: Path
) -> None:
    """0.3, not 0.30000000000000004; no digits below a picometre; results are to the last bit."""
    plan = pincal.Plan(np.array([[0.1 + 0.2, -0.2, 0.3], [1 / 3, 0.1, -0.1]]))
    plan.to_csv(tmp_path / "p.csv", "3RRR")
    assert "0.30000000000000004,-0.2" in (tmp_path / "p.csv").read_text()
    said = ("--units", units) if units else ()
    done("inverse", "3RRR", tmp_path / "p.csv", "-o", tmp_path / "r.csv")
    done("forward", "3RRR", tmp_path / "r.csv", *said, "-o", tmp_path / "there.csv")
    text = (tmp_path / "there.csv").read_text()
    assert max(len(cell.partition(".")[2]) for cell in re.findall(r"[0-9.]+", text)) <= places + 1
    there = pincal.Plan.from_csv(tmp_path / "there.csv", "3RRR").poses
    np.testing.assert_allclose(there, plan.poses, rtol=0.0, atol=1e-11)
    assert Units(last=1e-12).written({"x [m]": [0.1 + 0.2, -1e-14], "sigma_x [m]": [1e-13, 1.0]})[
        "sigma_x [m]"
    ] == pytest.approx([1e-13, 1.0], rel=1e-15)
