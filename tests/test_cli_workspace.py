"""``pincal workspace``: files and numbers of every kind, and a clean way out."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from command_line import contents, done, run

import pincal
from pincal.files.table import read_table

HEXAPOD = ["--axis", "radius=0.1:1.5:0.2", "--axis", "bearing [deg]=0:360:30", "--axis"]
TILTS = ["--axis", "tilt=0:0.2:0.1", "--no-margins"]


def positions(path: Path) -> np.ndarray:
    """Return the positions of a file, one column a coordinate."""
    table = read_table(path)
    return np.stack([table.numbers(name, "m") for name in table.units], axis=1)


def test_total_orientation_of_the_hexapod(tmp_path: Path) -> None:
    """The file holds the positions that count."""
    line = ["workspace", "6UPS", "--kind", "total-orientation", *HEXAPOD, "z=1.8:2:0.1", *TILTS]
    outcome = done(*line, "-o", tmp_path / "a.csv")
    assert "volume" in outcome.out
    assert "6 elements" in outcome.out
    mechanism = pincal.load_mechanism("6UPS")
    grid = pincal.Grid.of("radius=0.1:1.5:0.2", "bearing [deg]=0:360:30", "z=1.8:2:0.1")
    turns = pincal.Orientations.of(mechanism.platform, "tilt=0:0.2:0.1")
    found = pincal.compute_workspace(
        mechanism, "total-orientation", grid, turns, pincal.Margins.none()
    )
    np.testing.assert_array_equal(positions(tmp_path / "a.csv"), found.positions)


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("--kind largest", ["--kind largest", "total-orientation"]),
        ("--kind reachable --axis x=1:-1:0.1", ["'x'", "reversed"]),
        ("--kind reachable --axis x=0:1", ["'x'", "LOW:HIGH:STEP"]),
        ("--kind reachable --axis z=1", ["'z'", "plane"]),
        ("--kind reachable --axis q=1", ["'q'", "unknown axis"]),
        ("--kind total-orientation", ["needs the orientations"]),
        ("--kind total-orientation --axis tilt=0", ["platform takes phi"]),
        ("--kind reachable --count 10", ["--count", "not for --kind reachable"]),
        ("--kind reachable --no-margins --margin-type1 0.1", ["--no-margins"]),
        ("--kind reachable --axis x=-500:500:10 --axis y=-500:500:10", ["'x'", "[mm]"]),
        ("--kind dexterous --axis phi=0:1:0.1", ["total-orientation"]),
        ("--axis x=0:1:0.1", ["--kind"]),
    ],
)
def test_wrong_questions_leave_nothing(
    line: str, words: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One message, exit code 2, no file."""
    monkeypatch.chdir(tmp_path)
    outcome = run("workspace", "3RRR", *line.split(" "), "-o", "w.csv")
    assert outcome.code == 2, outcome.err
    for word in words:
        assert word in outcome.err
    assert "Traceback" not in outcome.err
    assert contents(tmp_path) == {}


def test_an_empty_workspace_is_a_result(tmp_path: Path) -> None:
    """Nothing counts: a header, a table that says so, exit code 0."""
    line = ["--axis", "x=5,6", "--axis", "y=5,6"]
    outcome = done("workspace", "3RRR", "--kind", "reachable", *line, "-o", tmp_path / "w.csv")
    assert "0 of 4 count" in outcome.out
    assert (tmp_path / "w.csv").read_text() == "x [m],y [m]\n"
    spatial = ["--axis", "z=9", "--axis", "x=0", "--axis", "y=0"]
    done("workspace", "6UPS", "--kind", "reachable", *spatial, "-o", tmp_path / "s.csv")


@pytest.mark.slow
def test_a_cut_workspace_says_so(tmp_path: Path) -> None:
    """A grid that ends inside the workspace is told; one drawn close around it is not."""
    line = ["workspace", "3RRR", "--kind", "constant-orientation"]
    outcome = done(*line, "--axis", "x=-0.1:0.1:0.05", "--axis", "y=-0.1:0.1:0.05",
                   "-o", tmp_path / "cut.csv")  # fmt: skip
    assert "cut off by the edge of the grid" in outcome.out
    assert "not used" in outcome.out
    outcome = done(*line, "-o", tmp_path / "whole.csv")
    assert "cut off" not in outcome.out


def test_devices_are_not_replaced() -> None:
    """--force replaces files, not what the system keeps under /dev."""
    outcome = run("workspace", "5R", "--count", 5, "--force", "-o", "/dev/null")
    assert outcome.code == 2
    assert "device" in outcome.err
    assert Path("/dev/null").is_char_device()


def test_standard_output_holds_no_files() -> None:
    """A dash is no file's name: tables of numbers are files, standard output is for people."""
    outcome = run("workspace", "5R", "--count", 5, "-o", "-")
    assert (outcome.code, outcome.out) == (2, "")
    assert "name a file" in outcome.err
    assert not Path("-").exists()
