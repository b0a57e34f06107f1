"""Corrections of commanded poses on a grid, for controllers with the nominal geometry."""

from __future__ import annotations

import ctypes
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from arms import loaded
from command_line import done, run
from measured import workspace

import pincal
from pincal.formats.corrections import CorrectionGrid
from pincal.formats.deployed import Deployed, c_header, python_file


@pytest.mark.parametrize(("name", "count"), [("6UPS", 2), ("3RRR", 4), ("delta", 3)])
def test_files_correct_as_the_grid_does(name: str, count: int, tmp_path: Path) -> None:
    """Python and C, inside of the grid and beyond it, to 1e-9; the grid is exact at its nodes."""
    robot, rng = pincal.load_mechanism(name), np.random.default_rng(1)
    platform = robot.platform
    twists = 0.01 * rng.standard_normal((count**platform.dof, platform.dof)).round(6)
    reach = np.full(platform.dof, 0.2)
    grid = CorrectionGrid(platform, -reach, 1.5 * reach, twists)
    moved = platform.matrices(platform.moved(grid.nodes, twists))
    np.testing.assert_allclose(platform.matrices(grid.commands(grid.nodes)), moved, atol=1e-12)
    offsets = rng.uniform(-0.3, 0.4, (40, platform.dof))
    poses = platform.moved(np.tile(platform.home, (40, 1)), offsets)
    wanted = platform.matrices(grid.commands(poses))[:, :3].reshape(40, 12)
    deployed = Deployed(robot, grid=grid)
    names: dict[str, Any] = {}
    exec(python_file(deployed), names)
    placed = platform.matrices(poses)[:, :3].reshape(40, 12).tolist()
    np.testing.assert_allclose([names["corrected"](T) for T in placed], wanted, atol=1e-9)
    if not shutil.which("cc"):
        return
    (tmp_path / "m.h").write_text(c_header(deployed, "m"))
    glue = '#include "m.h"\nvoid corrected(const double *T, double *c) { m_corrected(T, c); }\n'
    (tmp_path / "m.c").write_text(glue)
    strict = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-shared", "-fPIC"]
    subprocess.run(["cc", *strict, "-o", tmp_path / "m.so", tmp_path / "m.c", "-lm"], check=True)
    library, commanded = ctypes.CDLL(str(tmp_path / "m.so")), (ctypes.c_double * 12)()
    for T, row in zip(placed, wanted, strict=True):
        library.corrected((ctypes.c_double * 12)(*T), commanded)
        np.testing.assert_allclose(list(commanded), row, atol=1e-9)


def test_a_nominal_controller_reaches_what_it_is_sent_to(tmp_path: Path) -> None:
    """A five-bar measured, then driven by its nominal kinematics: what the page says, and less.

    Commands are those of the deployed file, the controller is the nominal mechanism, the machine
    the identified one. Also at poses that the grid has not seen the error falls to a hundredth.
    """
    robot, noise = pincal.load_mechanism("5R"), pincal.Noise(1e-5)
    truth, plan = pincal.disturb(robot, 1e-3, seed=1), pincal.Plan(workspace("5R", 30))
    data = pincal.simulate(robot, truth, plan, noise, seed=1).measurements
    result = pincal.calibrate(robot, data, noise=noise)
    result.save(tmp_path / "result")
    box = ["--box", "x=-0.15..0.15, y=0.9..1.2"]
    said = done("deploy", tmp_path / "result", "-o", tmp_path / "c", "--grid", 400, *box)
    names: dict[str, Any] = {}
    exec((tmp_path / "c" / "kinematics.py").read_text(), names)
    aims = np.random.default_rng(4).uniform([-0.15, 0.9], [0.15, 1.2], (200, 2))
    commands = [names["coordinates"](names["corrected"](names["pose"](*aim))) for aim in aims]

    def missed(sent: Any) -> np.ndarray:
        readings = pincal.inverse(robot, np.array(sent)).readings
        arrived = pincal.forward(result.identified, readings).poses
        return np.linalg.norm(arrived - aims, axis=1)

    assert missed(commands).max() < 0.01 * np.median(missed(aims))
    (worst,) = re.findall(r"95 %\), (\S+) mm at most; without", said.err)
    assert missed(commands).max() < 2e-3 * float(worst)
    table = (tmp_path / "c" / "corrections.csv").read_text().splitlines()
    assert table[0].split(",")[:4] == ["x [m]", "y [m]", "command_x [m]", "command_y [m]"]
    assert len(table) == 1 + 400
    assert worst in (tmp_path / "c" / "commanding.md").read_text()


def test_what_has_no_grid_is_refused(tmp_path: Path) -> None:
    """More legs than freedoms; poses that do not determine readings; nothing is written."""
    for name, *typed, words in (
        ("4cable", "--grid", 8, "more legs than freedoms"),
        ("3RPS", "--grid", 8, "pincal inverse"),
        ("5R", "--grid", 8, "--controller", "3RRR", "3RRR moves x, y, phi, 5R moves x, y"),
        ("5R", "--box", "x=0..1", "are for --grid"),
    ):
        refused = run("deploy", name, "-o", tmp_path / "c", *typed)
        assert refused.code == 2
        assert words in " ".join(refused.trouble.split())
        assert not (tmp_path / "c").exists()
    with pytest.raises(pincal.MeasurementError, match="0 to 5,000"):
        pincal.deploy("5R", tmp_path / "c", grid=-5)


def test_poses_of_a_program_are_commanded_otherwise_of_an_arm(tmp_path: Path) -> None:
    """``inverse`` near the program's readings, then ``forward`` of the arm that the controller has.

    Those readings take the true arm to the program's poses, and are the nominal arm's at what is
    commanded.
    """
    arm = loaded("ur5")
    truth = pincal.disturb(arm, 1e-4, seed=1)
    plan = pincal.sample_configurations(arm, 20, seed=2)
    plan.to_csv(tmp_path / "program.csv", arm)
    arm.save(tmp_path / "nominal")
    truth.save(tmp_path / "true")
    readings, sent = tmp_path / "readings.csv", tmp_path / "sent.csv"
    assert run("inverse", tmp_path / "true", tmp_path / "program.csv", "-o", readings).code in (
        0,
        1,
    )
    assert run("forward", tmp_path / "nominal", readings, "-o", sent).code in (0, 1)
    driven, commands = (
        np.array([row.split(",")[:6] for row in path.read_text().splitlines()[1:]])
        for path in (readings, sent)
    )
    rows = (driven != "").all(axis=1)
    assert rows.sum() > 15
    driven, commands = driven[rows].astype(float), commands[rows].astype(float)
    assert np.abs(driven - plan.readings[rows]).max() < 0.1  # the same branch
    matrices = arm.platform.matrices
    arrived = pincal.forward(truth, driven, plan.poses[rows]).poses
    np.testing.assert_allclose(matrices(arrived), matrices(plan.poses[rows]), atol=1e-9)
    drawn = pincal.forward(arm, driven, plan.poses[rows]).poses
    np.testing.assert_allclose(matrices(commands), matrices(drawn), atol=1e-9)
