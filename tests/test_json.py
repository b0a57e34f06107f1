"""``--json``: what a command found, on stdout alone, in SI units, as the files it wrote say."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import done, run

import pincal
from studies import catalogue
from studies.study import Study


def told(*arguments: object) -> dict[str, Any]:
    """Return what a command tells as JSON; it says nothing else on stdout."""

    def refuse(constant: str) -> None:
        raise AssertionError(f"{constant} is no JSON")

    outcome = done(*arguments, "--json")
    found: dict[str, Any] = json.loads(outcome.out, parse_constant=refuse)
    return found


@pytest.fixture(scope="module")
def poses(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Poses of the five-bar in a file, in millimetres."""
    path = tmp_path_factory.mktemp("json") / "poses.csv"
    path.write_text("x [mm],y [mm]\n0,1100\n100,1200\n-50,1000\n")
    return path


def test_inverse_and_forward(poses: Path, tmp_path: Path) -> None:
    """Readings are those of inverse kinematics, and lead back to the poses, gaps closed."""
    mechanism = pincal.load_mechanism("5R")
    expected = pincal.inverse(mechanism, [[0.0, 1.1], [0.1, 1.2], [-0.05, 1.0]]).readings
    found = told("inverse", "5R", poses, "-o", tmp_path / "readings.csv")
    assert found["mechanism"] == "5R"
    assert list(found["readings"]) == ["leg_1", "leg_2"]
    assert {one["unit"] for one in found["readings"].values()} == {"rad"}
    values = [one["values"] for one in found["readings"].values()]
    assert np.array_equal(np.array(values).T, expected)

    back = told("forward", "5R", tmp_path / "readings.csv", "-o", tmp_path / "back.csv")
    assert {name: one["unit"] for name, one in back["poses"].items()} == {"x": "m", "y": "m"}
    assert np.allclose(back["poses"]["x"]["values"], [0.0, 0.1, -0.05], atol=1e-9)
    assert np.allclose(back["poses"]["y"]["values"], [1.1, 1.2, 1.0], atol=1e-9)
    assert list(back["gaps"]) == ["leg_1", "leg_2"]
    assert np.abs([one["values"] for one in back["gaps"].values()]).max() < 1e-9


def test_unsolved_rows_are_null_with_a_reason(tmp_path: Path) -> None:
    """Out of reach: exit code 1, null in the row's place, and why."""
    (tmp_path / "far.csv").write_text("x [m],y [m]\n0,1.1\n50,0\n")
    outcome = run("inverse", "5R", tmp_path / "far.csv", "-o", tmp_path / "r.csv", "--json")
    assert outcome.code == 1
    found = json.loads(outcome.out)
    assert [one["values"][1] for one in found["readings"].values()] == [None, None]
    assert found["reasons"][0] == ""
    assert "reach" in found["reasons"][1]


def test_workspace_poses(tmp_path: Path) -> None:
    """The ranges are those of the poses written."""
    output = tmp_path / "w.csv"
    found = told("workspace", "3RRR", "--count", 40, "-o", output)
    written = pincal.Plan.from_csv(output, pincal.load_mechanism("3RRR")).poses
    assert (found["kind"], found["count"]) == ("poses", 40)
    ranges = list(found["ranges"].values())
    assert [one["unit"] for one in ranges] == ["m", "m", "rad"]
    assert np.allclose([one["low"] for one in ranges], written.min(axis=0))
    assert np.allclose([one["high"] for one in ranges], written.max(axis=0))


def test_workspace_region(tmp_path: Path) -> None:
    """Count, area and circle are those of the library, and of the rows written."""
    grid = ("x=-1:1:0.05", "y=0.2:1.6:0.05")
    output = tmp_path / "w.csv"
    axes = [word for axis in grid for word in ("--axis", axis)]
    found = told("workspace", "5R", "--kind", "reachable", *axes, "--inscribed", "-o", output)
    mechanism = pincal.load_mechanism("5R")
    region = pincal.compute_workspace(mechanism, "reachable", pincal.Grid.of(*grid))
    circle = pincal.largest_inscribed(region)
    assert found["measure"] == region.measure
    assert found["unit"] == "m²"
    assert found["count"] == region.count == len(output.read_text().splitlines()) - 1
    assert found["margins"] == {"type1": 0.23, "type2": 0.2}
    assert found["elements"] == [str(one) for one in region.elements]
    assert found["inscribed"]["radius"] == circle.radius
    assert found["inscribed"]["centre"] == circle.centre.tolist()
    free = told("workspace", "5R", "--kind", "reachable", *axes, "--no-margins", "-o", output,
                "--force")  # fmt: skip
    assert free["margins"]["type2"] is None  # none: -inf has no JSON
    assert free["inscribed"] is None


def test_articular_space(tmp_path: Path) -> None:
    """Extents of the readings over the poses written, and the check of each element."""
    output = tmp_path / "a.csv"
    found = told("workspace", "3RRR", "--kind", "articular", "--count", 60, "-o", output)
    everywhere = found["spaces"]["all"]
    assert everywhere["count"] == 60
    rows = [line.split(",") for line in output.read_text().splitlines()]
    place = rows[0].index("leg_2 [rad]")
    column = [float(row[place]) for row in rows[1:]]
    assert everywhere["ranges"]["leg_2"] == {
        "unit": "rad",
        "low": pytest.approx(min(column)),
        "high": pytest.approx(max(column)),
    }
    assert [(one["solved"], one["asked"]) for one in found["permuted_readings"]] == [(60, 60)] * 2


def test_study(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Title, folder and tables of each study, numbers as numbers."""

    def run_study(name: str, seed: int, quick: bool, progress: object) -> Study:
        study = Study(name, f"Study of {name}", "A paper", seed, quick)
        study.table("lengths", "Lengths", {"leg": ["a", "b"], "length [m]": [1.5, float("nan")]})
        study.claims(("what", "1", "2", "differs"))
        return study

    monkeypatch.setattr(catalogue, "run_study", run_study)
    (found,) = told("study", "5R", "-o", tmp_path / "study")["studies"]
    assert found["title"] == "Study of 5R"
    assert found["folder"] == str(tmp_path / "study")
    assert found["tables"]["lengths"] == {"leg": ["a", "b"], "length [m]": [1.5, None]}
    assert found["tables"]["against_the_paper"]["verdict"] == ["differs"]
