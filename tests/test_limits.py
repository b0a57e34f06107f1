"""Where poses may lie: boxes, floors, bodies kept out, ways between; tensions of cables."""

from __future__ import annotations

import re
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import trimesh
from arms import loaded, urdf
from command_line import done, run
from measured import workspace

import pincal

BOX = "x=0.1..0.4, y=-2..0.5, z=..0.5"


def links(plan: pincal.Plan, names: tuple[str, ...]) -> np.ndarray:
    """Return the joints and the tool of a ur5, by Pinocchio alone, shape (N, P, 3)."""
    model = pin.buildModelFromUrdf(str(urdf("ur5_robot.urdf")))
    data, tool, rows = model.createData(), model.getFrameId("tool0"), []
    assert plan.readings is not None
    for row in plan.readings:
        q = pin.neutral(model)
        for name, value in zip(names, row, strict=True):
            q[model.joints[model.getJointId(name)].idx_q] = value
        pin.framesForwardKinematics(model, data, q)
        joints = [data.oMi[model.getJointId(name)].translation for name in names[1:]]
        rows.append(np.array([*joints, data.oMf[tool].translation]))
    return np.array(rows)


@pytest.mark.slow
def test_an_arm_stays_above_its_table_and_out_of_a_box(caplog: pytest.LogCaptureFixture) -> None:
    """Joints and tool of every pose, by Pinocchio; on straight ways too, but those named."""
    arm = loaded("ur5")
    caplog.set_level("INFO")
    limits = {"floor": 0.05, "keep_out": (BOX,), "clearance": 0.02}
    options = {"candidates": pincal.sample_configurations(arm, 600), "count": 20, "starts": 1}
    plan = pincal.select(arm, **options, **limits).plan
    points = links(plan, arm.reading_names)
    assert points[..., 2].min() > 0.07 - 1e-6
    share = np.linspace(0.0, 1.0, 500)[:, None, None]
    low, high = np.array([0.08, -2.02, -9.0]) + 1e-6, np.array([0.42, 0.52, 0.52]) - 1e-6
    assert not ((points > low) & (points < high)).all(axis=2).any()
    through = []
    for row, (begin, end) in enumerate(pairwise(points), 1):
        way = begin + share * (end - begin)
        if ((way > low) & (way < high)).all(axis=2).any():
            through.append(f"{row} to {row + 1}")
    named = [text for text in caplog.messages if text.startswith("ways through")]
    assert len(through) < 4
    assert named == [f"ways pass through --keep-out: from row {', '.join(through)}"] * any(through)
    free = links(pincal.select(arm, **options).plan, arm.reading_names)
    assert free[..., 2].min() < 0.0  # without limits it goes through the table
    assert ((free > low) & (free < high)).all(axis=2).any()


def test_a_mesh_is_kept_out_as_the_box_that_it_is(tmp_path: Path) -> None:
    """A box drawn as triangles leaves the same plan as its ranges; --box is where poses lie."""
    candidates = tmp_path / "c.csv"
    pincal.Plan(workspace("3RRR", 300)).to_csv(candidates, "3RRR")
    box = trimesh.creation.box(bounds=[[0.1, 0.2, -1.0], [0.4, 9.0, 1.0]])
    box.export(tmp_path / "post.stl")
    common = ["select", "3RRR", "--candidates", candidates, "--count", 8, "--starts", 1]
    common += ["--box", "x=-300mm..0.3, phi=-10deg.."]
    plans = []
    for body in (tmp_path / "post.stl", "x=0.1..0.4,y=0.2..9"):
        plan = tmp_path / f"{len(plans)}.csv"
        done(*common, "--keep-out", body, "-o", plan)
        plans.append(plan.read_bytes())
    assert plans[0] == plans[1]
    poses = pincal.Plan.from_csv(tmp_path / "0.csv", "3RRR").poses
    assert (np.abs(poses[:, 0]) <= 0.3).all()
    assert (poses[:, 2] >= np.radians(-10.0)).all()
    assert not ((poses[:, 0] > 0.1) & (poses[:, 0] < 0.4) & (poses[:, 1] > 0.2)).any()


@pytest.mark.parametrize(
    ("option", "value", "words"),
    [
        ("--box", "q=0..1", "no range"),
        ("--box", "x=1..0", "lower end"),
        ("--box", "x=0,2..0,3", "a decimal point, no comma"),
        ("--keep-out", "post.stl", "No such file"),
        ("--floor", "9", "are left out by --floor 9 m, most often because of the platform"),
        ("--floor", "nan", "finite height"),
        ("--clearance", "-1mm", "0 or more"),
        ("--margin-tension", "9", "no 'cables'"),
    ],
)
def test_limits_that_cannot_be(option: str, value: str, words: str, tmp_path: Path) -> None:
    """One message that says which; nothing is written."""
    refused = run("select", "5R", "--count", 6, option, value, "-o", tmp_path / "plan.csv")
    assert refused.code == 2
    assert words in refused.trouble
    assert not (tmp_path / "plan.csv").exists()


def test_limits_that_limit_nothing_or_everything_are_named(tmp_path: Path) -> None:
    """Millimetres typed without a unit: what the candidates span; only given options are named."""
    pincal.Plan(workspace("5R", 300)).to_csv(tmp_path / "c.csv", "5R")
    plan = ("select", "5R", "--candidates", tmp_path / "c.csv", "--starts", 1)
    plan += ("--count", 8, "-o", tmp_path / "plan.csv")
    note = run(*plan, "--box", "x=-200..200, y=1..").err
    assert "nothing is left out by --box x=-200..200 m, where candidates span x=-" in note
    assert note.count("nothing is left out") == 1
    refused = run(*plan, "--force", "--box", "x=200..", "--clearance", "40mm").trouble
    assert re.search(r"none of (\d+) candidates.* \1 are left out by --box x=200\.\. m", refused)
    assert "--floor" not in refused
    assert "--keep-out" not in refused


@pytest.mark.parametrize("command", [("select", "-o", "plan.csv"), ("identifiability",)])
def test_noise_in_another_unit_is_refused(command: tuple[str, ...], tmp_path: Path) -> None:
    """20 for 20 µm, 5 for 5 mrad: as calibrate does, before anything is planned."""
    for option, value in (("--noise-position", 20), ("--noise-orientation", 5)):
        refused = run(command[0], "3RRR", option, value, *command[1:])
        assert refused.code == 2
        assert "the noise given for the" in refused.trouble


@pytest.mark.slow
def test_cables_stay_under_tension() -> None:
    """Every pose can be held with 45 N in all cables at least; without, some cannot."""
    robot = pincal.load_mechanism("8cable")
    tense = replace(robot, cables=pincal.Cables(45.0, 1000.0))
    options = {"candidates": workspace("8cable", 60), "count": 8, "starts": 1}
    held = [
        np.isfinite(
            pincal.tensions(tense, pincal.select(robot, margins=least, **options).plan.poses)
        )
        for least in (None, pincal.Margins(tension=45.0))
    ]
    assert not held[0].all()
    assert held[1].all()
