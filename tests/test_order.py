"""The order of measuring: sets take turns, and poses to verify with lie between them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import done
from measured import workspace

import pincal
from pincal.design.order import in_turns, with_verification


def test_sets_take_turns() -> None:
    """No set is earlier than another on average, each of its poses is there once, in any order."""
    sets = ("leg_1",) * 12 + ("leg_2",) * 12 + ("leg_3",) * 6
    plan = pincal.Plan(np.arange(90.0).reshape(30, 3), sets)
    ordered = in_turns(plan, 3)
    assert sorted(ordered.poses[:, 0]) == sorted(plan.poses[:, 0])
    named = dict(zip(plan.poses[:, 0], sets, strict=True))
    assert tuple(named[one] for one in ordered.poses[:, 0]) == ordered.sets
    when = {name: np.flatnonzero(np.array(ordered.sets) == name).mean() for name in set(sets)}
    assert max(when.values()) - min(when.values()) < 1.5
    own = [one for one in ordered.poses[:, 0] if named[one] == "leg_1"]
    assert own != sorted(own)
    np.testing.assert_array_equal(in_turns(plan, 3).poses, ordered.poses)
    assert not np.array_equal(in_turns(plan, 4).poses, ordered.poses)


def test_mapped_poses_follow_one_another() -> None:
    """The k-th poses of sets of one size are neighbours still."""
    sets = ("leg_1",) * 5 + ("leg_2",) * 5
    plan = pincal.Plan(np.tile(np.arange(5.0)[:, None], (2, 3)), sets)
    first = in_turns(plan).poses[:, 0].reshape(5, 2)
    np.testing.assert_array_equal(first[:, 0], first[:, 1])


def test_poses_to_verify_with_are_others() -> None:
    """As many as asked for, none of the plan, all in reach; a forecast counts none of them."""
    mechanism = pincal.load_mechanism("3RRR")
    offered = pincal.Plan(workspace("3RRR", 60))
    plan = offered.rows(np.arange(20))
    more = with_verification(mechanism, plan, offered, 8)
    assert more.verifying.sum() == 8
    chosen = {one.tobytes() for one in more.poses[more.verifying]}
    assert len(chosen) == 8
    assert not chosen & {one.tobytes() for one in plan.poses}
    assert pincal.inverse(mechanism, more.poses).reached.all()
    np.testing.assert_array_equal(
        pincal.forecast(mechanism, more).std, pincal.forecast(mechanism, plan).std
    )
    with pytest.raises(pincal.ObservabilityError, match="40 poses are left to verify with, of 50"):
        with_verification(mechanism, plan, offered, 50)


@pytest.mark.slow
def test_a_drift_does_not_hide_in_legs() -> None:
    """A tracker that drifts by 0.2 mm: limits of the platform's error hold, or are withdrawn.

    Leg after leg, each leg is calibrated by its own part of the drift, which its residuals do not
    show: errors are larger than the noise makes them. In turns they are not.
    """
    mechanism, noise = pincal.load_mechanism("3RRR"), pincal.Noise(2e-5, 2e-5)
    poses = workspace("3RRR", 60)
    plan = pincal.Plan(poses, tuple(leg for leg in mechanism.leg_names for _ in range(20)))
    drift = np.linspace(-1e-4, 1e-4, 60)[:, None] * [1.0, 0.0, 0.0]

    def shares(seed: int, planned: pincal.Plan) -> tuple[float, float]:
        truth = pincal.disturb(mechanism, 2e-3, seed)
        data = pincal.simulate(mechanism, truth, planned, noise, seed).measurements
        data = replace(data, poses=data.poses + drift)
        result = pincal.calibrate(mechanism, data, method="per-leg")
        expected, error = (
            result.expected_error(poses),
            pincal.accuracy(result.identified, truth, poses),
        )
        share = error.position / expected.limit[0]
        return share, share * expected.unseen

    assert all(shares(seed, in_turns(plan, seed))[0] <= 1.0 for seed in range(6))
    assert max(shares(seed, plan)[1] for seed in range(6)) > 1.0


def test_select_writes_in_turns_and_calibrate_verifies(tmp_path: Path) -> None:
    """From the command line to the report: rows to verify with are predicted, not followed."""
    mechanism = pincal.load_mechanism("3RRR")
    plan, data = tmp_path / "plan.csv", tmp_path / "m.csv"
    pincal.Plan(workspace("3RRR", 300)).to_csv(tmp_path / "c.csv", mechanism)
    choose = ["select", "3RRR", "--count", 10, "--starts", 1, "--candidates", tmp_path / "c.csv"]
    done(*choose, "--verify", 6, "-o", plan)
    sets = pincal.Plan.from_csv(plan, mechanism).sets
    assert sets is not None
    assert [sets.count(name) for name in (*mechanism.leg_names, "verify")] == [10, 10, 10, 6]
    assert len(set(sets[:4])) > 2
    noise = ["--noise-position", "1e-4", "--noise-orientation", "1e-4"]
    done("simulate", "3RRR", plan, *noise, "-o", data)
    done("calibrate", "--no-report", "3RRR", data, *noise, "-o", tmp_path / "r")
    found = pincal.load_result(tmp_path / "r")
    assert found.validation is not None
    assert found.validation.rows == 6
