"""Reference poses, and what of a drift over the run they show."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import done
from measured import leg_after_leg, workspace

import pincal
from pincal.design.order import REFERENCE, in_rounds

NOISE = pincal.Noise(2e-5, 2e-5, 1e-5)


def test_one_pose_is_measured_again(tmp_path: Path) -> None:
    """Every so many rows and last, by one name, for every leg; written, read and simulated so."""
    mechanism, plan = leg_after_leg(8)
    more = in_rounds(mechanism, plan, 3, 10)
    assert len(more) == 24 + 4
    assert more.places is not None
    assert more.sets is not None
    again = np.array([one == REFERENCE for one in more.places])
    assert again.sum() == 5  # with the row of the plan that it repeats
    assert len(np.unique(more.poses[again], axis=0)) == 1
    for row in (0, 11, 22, 27):
        assert (more.places[row], more.sets[row]) == (REFERENCE, "all")
    middle, mean = more.poses[again][0], plan.poses.mean(axis=0)
    assert np.linalg.norm(middle - mean) <= np.median(np.linalg.norm(plan.poses - mean, axis=1))
    more.to_csv(tmp_path / "plan.csv", mechanism)
    assert pincal.Plan.from_csv(tmp_path / "plan.csv", mechanism).places == more.places
    data = pincal.simulate(mechanism, mechanism, more, NOISE).measurements
    assert data.places == more.places
    with pytest.raises(pincal.MeasurementError, match="every"):
        in_rounds(mechanism, plan, 3, -1)


def test_reference_poses_show_a_drift() -> None:
    """A sensor that drifts by ten standard deviations: the calibration says so."""
    mechanism, plan = leg_after_leg(12)
    more = in_rounds(mechanism, plan, every=4)
    data = pincal.simulate(mechanism, mechanism, more, NOISE).measurements
    drifted = data.readings + 10.0 * NOISE.reading * np.linspace(-0.5, 0.5, len(data))[:, None]
    codes: list[set[str]] = [
        {one.code for one in pincal.calibrate(mechanism, found, noise=NOISE).findings}
        for found in (data, replace(data, readings=drifted))
    ]
    assert not codes[0] & {"model-lacks", "step"}
    assert codes[1] & {"model-lacks", "step"}


def test_the_command_line_says_it(tmp_path: Path) -> None:
    """``select --reference`` writes the rows."""
    pincal.Plan(workspace("3RRR", 100)).to_csv(tmp_path / "some.csv", "3RRR")
    given: list[Any] = ["3RRR", "-o", tmp_path / "plan.csv", "--candidates", tmp_path / "some.csv"]
    said = done("select", *given, "--count", 12, "--starts", 1, "--reference", 6)
    assert "as the pose 'reference'" in said.err
    plan = pincal.Plan.from_csv(tmp_path / "plan.csv", "3RRR")
    assert plan.places is not None
    assert plan.places.count(REFERENCE) > 2


def test_a_reference_that_moves_is_named_with_how_far() -> None:
    """A tracker that drifts 0.2 mm along y over the run; one that stands still is not blamed."""
    mechanism, plan = leg_after_leg(12)
    more = in_rounds(mechanism, plan, every=4)
    data = pincal.simulate(mechanism, mechanism, more, NOISE).measurements
    poses = data.poses + 2e-4 * np.linspace(-0.5, 0.5, len(data))[:, None] * [0.0, 1.0, 0.0]
    still, moved = (
        [
            one
            for one in pincal.calibrate(mechanism, found, noise=NOISE).findings
            if one.code == "reference-moved"
        ]
        for found in (data, replace(data, poses=poses))
    )
    assert not still
    (one,) = moved
    assert data.places is not None
    assert [data.places[row] for row in one.rows] == [REFERENCE] * data.places.count(REFERENCE)
    assert one.values["quantity"] == "positions"
    assert abs(one.values["size"] - 2e-4) < 4e-5


@pytest.mark.parametrize(("field", "column"), [("poses", 0), ("readings", 1)])
def test_a_step_has_its_sign(field: str, column: int) -> None:
    """What is 0.2 mm, or mrad, too large from a row on is said to be so."""
    mechanism, plan = leg_after_leg(12)
    data = pincal.simulate(mechanism, mechanism, plan, NOISE).measurements
    values = getattr(data, field).copy()
    values[20:, column] += 2e-4
    found = pincal.calibrate(mechanism, replace(data, **{field: values}), noise=NOISE).findings
    (one,) = (one for one in found if one.code == "step")
    assert one.rows == (20,)
    assert abs(one.values["size"] - 2e-4) < 2e-5
