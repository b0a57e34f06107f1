"""Tensions of cables against a linear program for each pose, made of anchors and corners alone."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import done
from numpy.typing import NDArray
from scipy.optimize import linprog

import pincal
from pincal.workspace.criteria import in_workspace

Array = NDArray[np.float64]
LOAD = pincal.Load(20.0, (0.1, 0.02, 0.0))


def programmed(mechanism: pincal.Mechanism, poses: Array, load: pincal.Load) -> Array:
    """Return the least tensions by SciPy, shape (N, n_legs), NaN where there are none."""
    least, most = mechanism.cables.least, mechanism.cables.most
    force, rows, answers = load.mass * np.array(load.gravity), mechanism.platform.twist_rows, []
    for T in mechanism.platform.matrices(poses):
        pulls = []
        for leg in mechanism.legs:
            values = leg.nominal_by_name
            A, b = (np.array([values.get(f"{p}_{i}", 0.0) for i in "xyz"]) for p in "Ab")
            arm = T[:3, :3] @ b
            along = (A - T[:3, 3] - arm) / np.linalg.norm(A - T[:3, 3] - arm)
            pulls.append(np.r_[along, np.cross(arm, along)])
        weight = np.r_[force, np.cross(T[:3, :3] @ load.centre, force)]
        answer = linprog(
            np.ones(len(pulls)),
            A_eq=np.transpose(pulls)[list(rows)],
            b_eq=-weight[list(rows)],
            bounds=(least, most),
        )
        answers.append(answer.x if answer.status == 0 else np.full(len(pulls), np.nan))
    return np.array(answers)


@pytest.mark.parametrize("kind", ["8cable", "4cable", "cable-4", "cable-8"])
def test_least_tensions_are_those_of_a_linear_program(kind: str) -> None:
    """Held where the program is feasible, and of the same sum within 1e-9 of it."""
    robot = pincal.new_mechanism(kind) if kind.startswith("c") else pincal.load_mechanism(kind)
    robot = replace(robot, load=LOAD, cables=pincal.Cables(2.0, 150.0))
    poses = np.tile(robot.platform.home, (40, 1))
    poses += np.random.default_rng(0).uniform(-0.3, 0.3, poses.shape)
    if robot.platform.dof == 6:
        poses[:, 4] = np.abs(poses[:, 4])
    found, expected = pincal.tensions(robot, poses), programmed(robot, poses, LOAD)
    held = np.isfinite(expected).all(axis=1)
    np.testing.assert_array_equal(np.isfinite(found).all(axis=1), held)
    np.testing.assert_allclose(found[held].sum(axis=1), expected[held].sum(axis=1), rtol=1e-9)
    assert (found[held] > 2.0 - 1e-6).all()
    np.testing.assert_array_equal(
        in_workspace(robot, poses), held & in_workspace(replace(robot, cables=None), poses)
    )


@pytest.mark.slow
def test_selected_poses_need_no_cable_to_push(tmp_path: Path) -> None:
    """Every pose selected for the bundled box is held, as the program says; the view shows it."""
    robot = pincal.load_mechanism("8cable")
    plan = pincal.select_poses(robot, pincal.sample_workspace(robot, 300, seed=0), 12).plan
    assert np.isfinite(programmed(robot, plan.poses, robot.load)).all()
    plan.to_csv(tmp_path / "plan.csv", robot)
    done("view", "8cable", tmp_path / "plan.csv", "-o", tmp_path / "view.html")
    assert "least tension of cables [N]" in (tmp_path / "view.html").read_text("utf-8")


def test_tensions_need_cables(tmp_path: Path) -> None:
    """None without limits; a rotary leg is no cable; limits are saved; margins ask for more."""
    plain = replace(pincal.load_mechanism("8cable"), cables=None)
    with pytest.raises(pincal.MechanismError, match="has no tensions"):
        pincal.tensions(plain, [plain.platform.home])
    with pytest.raises(pincal.MechanismError, match="leg_1 is none"):
        replace(pincal.load_mechanism("delta"), cables=pincal.Cables(1.0, 2.0))
    with pytest.raises(pincal.MechanismError, match="expected 'least'"):
        pincal.Cables(2.0, 1.0)
    robot = replace(plain, cables=pincal.Cables(1.0, 200.0))
    assert pincal.load_mechanism(robot.save(tmp_path / "box")).cables == robot.cables
    home = [robot.platform.home]
    assert in_workspace(robot, home).all()
    assert not in_workspace(robot, home, pincal.Margins(tension=150.0)).any()
