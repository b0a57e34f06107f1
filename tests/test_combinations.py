"""select, simulate, calibrate, as typed: every combination of plan, method, frame and target."""

from __future__ import annotations

import csv
import json
from itertools import product
from pathlib import Path

import pytest
from command_line import done, run

import pincal

#: Options of ``select`` by what the plan is.
PLANS = {
    "default": (),
    "independent": (
        "--protocol",
        "independent",
    ),
    "symmetric": (
        "--protocol",
        "symmetric",
    ),
    "orbits": (
        "--protocol",
        "orbits",
    ),
    "common": (
        "--protocol",
        "common",
    ),
    "for a tracker": ("--unknown-frame", "--protocol", "common"),
    "for positions": ("--measure", "x,y"),
}
#: Poses of the plan: for each leg, of all, or orbits of twelve poses.
COUNTS = {"orbits": 3, "common": 36, "for a tracker": 36, "for positions": 48}
METHODS = {
    "default": (),
    "per leg": (
        "--method",
        "per-leg",
    ),
    "per leg, all poses": ("--method", "per-leg", "--poses", "all"),
}
FRAMES = {"base": (), "tracker": ("--unknown-frame",)}
TARGETS = {"origin": (), "target": ("--unknown-target",)}
#: What is tried in every run, the rest in the slow one.
QUICK = {
    ("3RRR", "default", "default", "tracker", "origin"),  # the three commands of the first page
}


@pytest.fixture(scope="session")
def measured(tmp_path_factory: pytest.TempPathFactory) -> dict[tuple[str, str], Path]:
    """Measurements by mechanism and plan, made when they are asked for."""
    folder = tmp_path_factory.mktemp("combinations")

    class Made(dict[tuple[str, str], Path]):
        def __missing__(self, key: tuple[str, str]) -> Path:
            self[key] = rows = measurements(folder, *key)
            return rows

    return Made()


def measurements(folder: Path, mechanism: str, plan: str) -> Path:
    """Return the file of measurements that a plan gives."""
    name = f"{mechanism}_{plan.replace(' ', '_')}"
    poses, rows = folder / f"{name}_plan.csv", folder / f"{name}.csv"
    count = COUNTS.get(plan, 12)
    done("select", mechanism, "--count", count, "--starts", 1, *PLANS[plan], "-o", poses)
    done("simulate", mechanism, poses, "-o", rows)
    if plan == "for positions":  # what was not measured has no column
        with rows.open(encoding="utf-8", newline="") as file:
            table = list(csv.reader(file))
        kept = [i for i, title in enumerate(table[0]) if not title.startswith("phi")]
        with rows.open("w", encoding="utf-8", newline="") as file:
            csv.writer(file).writerows([[row[i] for i in kept] for row in table])
    return rows


def combinations() -> list[object]:
    """Return what is tried: of the first plan all, of the other ones and machines the corners."""
    every = [("3RRR", "default", "default", *one) for one in product(FRAMES, TARGETS)]
    every += [("3RRR", "default", method, "base", "origin") for method in METHODS]
    ends = (("base", "origin"), ("tracker", "target"))
    others = [plan for plan in PLANS if plan != "default"]
    every += [("3RRR", plan, "default", *ends[i % 2]) for i, plan in enumerate(others)]
    every += [("3RRR", plan, "per leg", "base", "origin") for plan in others]
    every += [("5R", "default", method, "base", "origin") for method in METHODS]
    every += [("6UPS", "default", "default", "tracker", "target")]
    found = []
    for one in every:
        _, plan, method, _, _ = one
        if plan == "for positions" and method.startswith("per leg"):
            continue  # legs alone need whole poses
        marks = () if one in QUICK else pytest.mark.slow
        found.append(pytest.param(*one, marks=marks, id=" - ".join(one)))
    return found


@pytest.mark.parametrize(("mechanism", "plan", "method", "frame", "target"), combinations())
def test_what_was_planned_is_calibrated(
    measured: dict[tuple[str, str], Path],
    tmp_path: Path,
    mechanism: str,
    plan: str,
    method: str,
    frame: str,
    target: str,
) -> None:
    """Exit code 0, a result that converged, and the calibrated mechanism, which loads."""
    rows, result = measured[mechanism, plan], tmp_path / "result"
    options = (*METHODS[method], *FRAMES[frame], *TARGETS[target], "--folds", 0)
    outcome = run("calibrate", "--no-report", mechanism, rows, *options, "-o", result)
    assert outcome.code == 0, outcome.err
    assert json.loads((result / "result.json").read_text(encoding="utf-8"))["converged"]
    assert pincal.load_mechanism(result).leg_names == pincal.load_mechanism(mechanism).leg_names
