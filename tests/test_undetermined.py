"""What measurements do not determine has no interval, and what has one holds the truth."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from arms import loaded
from marks import quick
from numpy.typing import NDArray

import pincal

Array = NDArray[np.float64]
NOISE = pincal.Noise(2e-5, 5e-5, 2e-5)


def few_poses(readings: Array) -> Array:
    """Return readings of three poses."""
    return readings[:3]


def one_leg_seldom_read(readings: Array) -> Array:
    """Return readings of which leg 2's are of three poses alone."""
    readings[3:, 1] = np.nan
    return readings


def simulated(seed: int, cut: Callable[[Array], Array]) -> pincal.CalibrationResult:
    """Return a 5R calibrated by data that leave parameters undetermined."""
    poses = pincal.sample_workspace("5R", 16, seed=seed)
    truth = pincal.disturb("5R", 1e-3, seed=seed)
    data = pincal.simulate("5R", truth, pincal.Plan(poses), NOISE, seed=seed).measurements
    readings = cut(data.readings.copy())
    data = pincal.Measurements(poses=data.poses[: len(readings)], readings=readings)
    return pincal.calibrate("5R", data, noise=NOISE)


@pytest.mark.parametrize(
    ("cut", "sets"), quick(1, [(few_poses, 3), (one_leg_seldom_read, 6), (one_leg_seldom_read, 16)])
)
def test_finite_intervals_hold_the_truth(cut: Callable[[Array], Array], sets: int) -> None:
    """At least 90 % of all finite 95 % intervals hold the true value, if any is finite."""
    inside, finite = [], set()
    for seed in range(sets):
        result, truth = simulated(seed, cut), pincal.disturb("5R", 1e-3, seed=seed)
        for leg in result.legs:
            values = dict(truth.leg(leg.name).parameters)
            known = [p for p in leg.parameters if np.isfinite(p.std)]
            inside += [p.low <= values[p.name] <= p.high for p in known]
            finite |= {p.owner for p in known}
    assert finite == ({"leg_1"} if cut is one_leg_seldom_read else set())
    assert not inside or np.mean(inside) >= 0.9


def test_a_promise_takes_as_many_equations_as_unknowns() -> None:
    """Seven poses of eight-parameter legs promise nothing, tolerances beside them do.

    Nor is a promise a matter of poses: each of an arm's gives six equations.
    """
    robot, poses = pincal.load_mechanism("3RRR"), pincal.sample_workspace("3RRR", 7, seed=0)
    truth, known = pincal.disturb(robot, 1e-3, seed=1), {"m": 2e-3, "rad": 2e-3}
    data = pincal.simulate(robot, truth, pincal.Plan(poses), NOISE, seed=2).measurements
    short = pincal.calibrate(robot, data, noise=NOISE)
    assert {finding.code for finding in short.contradictions} == {"few-poses"}
    assert pincal.calibrate(robot, data, noise=NOISE, tolerance=known).promises
    arm = loaded("ur10")
    plan = pincal.sample_configurations(arm, 10, seed=0)
    data = pincal.simulate(arm, pincal.disturb(arm, 1e-3, seed=1), plan, NOISE, 2).measurements
    assert pincal.calibrate(arm, data, noise=NOISE).promises


@pytest.mark.parametrize("known", [{"tolerance": "1mm,2mrad,0.001"}, {"priors": {"l": 1e-3}}, {}])
def test_what_is_known_beforehand_is_no_measurement(known: dict[str, object]) -> None:
    """Readings alone, no more than the platform's freedoms, are refused: no drawing calibrates."""
    poses = pincal.sample_workspace("delta", 12)
    readings = pincal.inverse("delta", poses).readings
    data = pincal.Measurements(poses=np.full_like(poses, np.nan), readings=readings)
    with pytest.raises(pincal.ObservabilityError, match="determines no parameter"):
        pincal.calibrate("delta", data, **known)


def test_rows_for_verification_determine_nothing() -> None:
    """Four rows to fit hold the same directions whether others verify or not; none is refused."""
    robot, poses = pincal.load_mechanism("3RRR"), pincal.sample_workspace("3RRR", 20, seed=0)
    truth = pincal.disturb(robot, 1e-3, seed=1)
    data = pincal.simulate(robot, truth, pincal.Plan(poses), NOISE, seed=2).measurements
    verified = replace(data, sets=("all",) * 4 + ("verify",) * 16)
    alone = pincal.calibrate(robot, data.rows(np.arange(4)), noise=NOISE)
    beside = pincal.calibrate(robot, verified, noise=NOISE)
    assert alone.undetermined_directions is not None
    assert beside.undetermined_directions is not None
    assert beside.undetermined_directions.shape == alone.undetermined_directions.shape
    assert beside.degrees_of_freedom == alone.degrees_of_freedom >= 0
    with pytest.raises(pincal.ObservabilityError, match="every row is for verification"):
        pincal.calibrate(robot, replace(data, sets=("verify",) * 20), noise=NOISE)


def test_what_was_held_is_marked_wherever_it_is_shown(tmp_path: Path) -> None:
    """In row, table, JSON and saved result: no ±, and that it was held nearest to nominal."""
    result = simulated(0, few_poses)
    parameter = result["leg_1.L"]
    assert np.isinf([parameter.std, parameter.high, -parameter.low]).all()
    assert parameter.given == "held nearest to nominal"
    assert "±" not in str(parameter)
    assert "held nearest to nominal" in str(parameter)
    assert "held nearest to nominal: leg_1.l, leg_1.L" in str(result.tables()[0])
    assert "held nearest to nominal" in result.report().html()
    data = json.loads((result.save(tmp_path / "r") / "result.json").read_text())
    shown = data["legs"][0]["parameters"][1]
    assert shown["id"] == "leg_1.L"
    assert shown["interval_95"] == [None, None]
    assert shown["std"] is None
    assert np.isnan(np.array(data["covariance"], dtype=float)).all()
    assert pincal.load_result(tmp_path / "r")["leg_1.L"] == parameter


def test_no_table_is_shown_without_errors() -> None:
    """Where no error of the platform is known, the verdict says so, and no empty table follows."""
    shown = str(simulated(33, few_poses))
    assert "Not determined" in shown
    assert "RMS error" not in shown
