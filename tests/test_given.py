"""The public door: a mechanism, its name or its folder; what is something else is refused."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from frames import frame_of

import pincal
from pincal.files.mechanism_folders import bundled
from pincal.workspace.criteria import in_workspace
from pincal.workspace.grid import default_grid

FIVE = pincal.load_mechanism("5R")
POSES = FIVE.platform.home + np.random.default_rng(0).uniform(-0.2, 0.2, (12, 2))
PLAN = pincal.Plan(POSES)
GRID = pincal.Grid.of("x=-1:1:0.5", "y=0.5:1.5:0.5")
DATA = pincal.simulate(FIVE, pincal.disturb(FIVE, 1e-3, seed=1), PLAN).measurements
RESULT = pincal.calibrate(FIVE, DATA)

#: What takes a mechanism, called with one.
TAKE: dict[str, Callable[[Any], object]] = {
    "accuracy": lambda m: pincal.accuracy(m, m, POSES),
    "default_grid": lambda m: default_grid(m).size,
    "disturb": lambda m: pincal.disturb(m, 1e-3),
    "forecast": lambda m: pincal.forecast(m, POSES).std,
    "forward": lambda m: pincal.forward(m, pincal.inverse(m, POSES).readings).poses,
    "identification_jacobian": lambda m: pincal.identification_jacobian(m, "leg_1", POSES),
    "in_workspace": lambda m: in_workspace(m, POSES),
    "inverse": lambda m: pincal.inverse(m, POSES).readings,
    "margins": lambda m: pincal.margins(m, POSES).type1,
    "picture": lambda m: pincal.picture(m).scene.mechanism,
    "sample_configurations": lambda m: pincal.sample_configurations(m, 3).poses,
    "sample_workspace": lambda m: pincal.sample_workspace(m, 3),
    "select_configurations": lambda m: pincal.select_configurations(m, POSES, 8).plan.poses,
    "select_poses": lambda m: pincal.select_poses(m, POSES, 8, "common").plan.poses,
    "simulate": lambda m: pincal.simulate(m, m, PLAN).measurements.poses,
    "symmetry_group": lambda m: pincal.symmetry_group(m).name,
    "view": lambda m: pincal.view(m, POSES).scene.mechanism,
}

#: What else is refused where it is of another type.
REFUSE: dict[str, Callable[[Any], object]] = {
    "angle": lambda bad: pincal.Element(bad),
    "axes of a grid": lambda bad: pincal.Grid(bad),
    "axis of a grid": lambda bad: pincal.Grid.of(bad, "y=0:1:0.5"),
    "azimuth": lambda bad: pincal.dihedral(3, bad),
    "candidates": lambda bad: pincal.select_poses(FIVE, bad, 3),
    "choice's measured": lambda bad: pincal.select_configurations(FIVE, POSES, 8, measured=bad),
    "count": lambda bad: pincal.select_poses(FIVE, POSES, bad),
    "count of poses": lambda bad: pincal.sample_workspace(FIVE, bad),
    "folds": lambda bad: RESULT.validated(bad),
    "folds by": lambda bad: RESULT.validated(3, bad),
    "forecast's measured": lambda bad: pincal.forecast(FIVE, POSES, None, bad),
    "forecast's noise": lambda bad: pincal.forecast(FIVE, POSES, bad),
    "forecast's poses": lambda bad: pincal.forecast(FIVE, bad),
    "forecast's setup": lambda bad: pincal.forecast(FIVE, POSES, setup=bad),
    "goal": lambda bad: pincal.select_configurations(FIVE, POSES, 8, goal=bad),
    "image": lambda bad: pincal.Lens(bad),
    "influences": lambda bad: pincal.inverse(FIVE, POSES, bad),
    "instruments": lambda bad: pincal.Setup(instruments=bad),
    "isometry": lambda bad: pincal.Element.of(np.eye(4), bad),
    "Jacobian": lambda bad: pincal.indices([bad]),
    "kind of workspace": lambda bad: pincal.compute_workspace(FIVE, bad, GRID),
    "leg": lambda bad: pincal.identification_jacobian(FIVE, bad, POSES),
    "loss": lambda bad: pincal.Options(loss=bad),
    "magnify": lambda bad: pincal.view(FIVE, POSES, identified=FIVE, magnify=bad),
    "margin": lambda bad: pincal.Margins(bad),
    "margins": lambda bad: in_workspace(FIVE, POSES, bad),
    "mark": lambda bad: pincal.Setup(mark=bad),
    "near": lambda bad: pincal.inverse(FIVE, POSES, near=bad),
    "options": lambda bad: pincal.calibrate(FIVE, DATA, bad),
    "orientations": lambda bad: pincal.compute_workspace(FIVE, "reachable", GRID, bad),
    "parameters": lambda bad: pincal.identification_jacobian(FIVE, "leg_1", POSES, bad),
    "picture's poses": lambda bad: pincal.picture(FIVE, bad),
    "plan": lambda bad: pincal.simulate(FIVE, FIVE, bad),
    "poses": lambda bad: pincal.inverse(FIVE, bad),
    "positions": lambda bad: pincal.compute_workspace(FIVE, "reachable", bad),
    "progress": lambda bad: pincal.calibrate(FIVE, DATA, progress=bad),
    "progress of a choice": lambda bad: pincal.select(FIVE, count=8, progress=bad),
    "progress of samples": lambda bad: pincal.sample_workspace(FIVE, 3, progress=bad),
    "progress of a workspace": lambda bad: pincal.compute_workspace(
        FIVE, "reachable", GRID, progress=bad
    ),
    "protocol": lambda bad: pincal.select_poses(FIVE, POSES, 3, bad),
    "readings": lambda bad: pincal.forward(FIVE, bad),
    "priors": lambda bad: pincal.Options(priors=[[bad]]),
    "result's poses": lambda bad: RESULT.expected_error(bad),
    "seed": lambda bad: pincal.sample_workspace(FIVE, 3, bad),
    "seed of a choice": lambda bad: pincal.select_poses(FIVE, POSES, 3, "common", seed=bad),
    "sigma": lambda bad: pincal.disturb(FIVE, bad),
    "tension": lambda bad: pincal.Cables(bad),
    "tolerance": lambda bad: pincal.symmetry_group(FIVE, bad),
    "tolerances": lambda bad: pincal.Options(tolerance=bad),
    "truth": lambda bad: pincal.simulate(FIVE, bad, PLAN),
    "twist": lambda bad: pincal.Platform("mine", (0.0, 0.0), bad),
    "view's poses": lambda bad: pincal.view(FIVE, bad),
}
WRONG = ["nonsense", {"a": 1}, object(), np.full((3, 3), 1e300)]


@pytest.mark.parametrize("name", TAKE)
def test_a_mechanism_its_name_or_its_folder(name: str) -> None:
    """All three give the same."""
    call = TAKE[name]
    expected = call(FIVE)
    for given in ("5R", bundled()["5R"], str(bundled()["5R"])):
        found = call(given)
        if isinstance(expected, np.ndarray):
            np.testing.assert_array_equal(found, expected)
        else:
            assert found == expected


@pytest.mark.parametrize(
    "wrong", [*WRONG, None, 3.0], ids=["text", "mapping", "object", "array", "none", "number"]
)
@pytest.mark.parametrize("name", TAKE)
def test_what_is_no_mechanism_is_refused(name: str, wrong: object) -> None:
    """Whatever is given instead of a mechanism, the error is one of pincal's."""
    with pytest.raises(pincal.PincalError):
        TAKE[name](wrong)


@pytest.mark.parametrize("wrong", WRONG, ids=["text", "mapping", "object", "array"])
@pytest.mark.parametrize("name", REFUSE)
def test_another_type_is_refused(name: str, wrong: object) -> None:
    """What is of a wrong type is refused by pincal, not by what it calls."""
    with pytest.raises(pincal.PincalError):
        REFUSE[name](wrong)


def test_tables_of_poses_measured_in_part_are_read_as_the_command_reads_them(tmp_path) -> None:
    """A column of the pose that is missing, or an empty cell: all legs at once need neither."""
    three = pincal.load_mechanism("3RRR")
    poses = pincal.sample_workspace(three, 30, seed=1)
    noise = pincal.Noise(2e-5, 2e-5, 2e-5)
    data = pincal.simulate(three, pincal.disturb(three, 1e-3, seed=1), poses, noise).measurements
    frame = frame_of(data, three).drop(columns="phi [rad]")
    frame.loc[3, "x [m]"] = np.nan
    frame.to_csv(tmp_path / "part.csv", index=False)
    result = pincal.calibrate(three, tmp_path / "part.csv", noise=noise)
    left = 30 * 2 - 1 - 23  # how the platform frame is turned is a choice
    assert result.degrees_of_freedom == left
    with pytest.raises(pincal.MeasurementError, match="all legs at once"):
        pincal.calibrate(three, tmp_path / "part.csv", noise=noise, method="per-leg")


@pytest.mark.parametrize(
    "call",
    [
        RESULT.expected_error,
        pincal.forecast(FIVE, POSES).platform_error,
        lambda poses: pincal.accuracy(FIVE, FIVE, poses),
    ],
    ids=["result", "forecast", "accuracy"],
)
def test_there_is_no_mean_of_no_poses(call: Callable[[Any], object]) -> None:
    """Means over no poses, or over none in reach, are refused; they were NaN."""
    for poses in (POSES[:0], [[10.0, 10.0]]):
        with pytest.raises(pincal.MeasurementError, match="in reach"):
            call(poses)
