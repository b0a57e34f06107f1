"""The order of measuring: rounds of short ways, poses to verify with between the others."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import done
from measured import leg_after_leg, workspace
from scipy.sparse.csgraph import minimum_spanning_tree
from scipy.spatial.distance import pdist, squareform

import pincal
from pincal.design.order import in_rounds, with_verification


def test_rounds_have_a_share_of_every_set() -> None:
    """Each round has as many rows of each set as the others, all rows are there once; by seeds."""
    mechanism, plan = leg_after_leg(12)
    ordered = in_rounds(mechanism, plan, 3, 0, seed=3)
    rows = [plan.poses.tolist().index(pose) for pose in ordered.poses.tolist()]
    assert sorted(rows) == list(range(36))
    assert ordered.sets is not None
    assert ordered.sets == tuple(plan.rows(rows).sets or ())
    for start in (0, 12, 24):
        assert {ordered.sets[start : start + 12].count(leg) for leg in mechanism.leg_names} == {4}
    np.testing.assert_array_equal(in_rounds(mechanism, plan, 3, 0, seed=3).poses, ordered.poses)
    assert not np.array_equal(in_rounds(mechanism, plan, 3, 0, seed=4).poses, ordered.poses)


def test_ways_are_short() -> None:
    """One round is at most 1.3 times the least tree that joins all rows, three at most 2.3 times.

    The tree is shorter than any order can be. In a random order it is four times the tree.
    """
    mechanism, plan = leg_after_leg(24)
    readings = pincal.inverse(mechanism, plan.poses).readings
    spans = readings / np.ptp(readings, axis=0)
    ways = squareform(pdist(plan.poses[:, :2]))
    ways = ways / ways.max() + squareform(pdist(spans, "chebyshev"))
    least = minimum_spanning_tree(ways).sum()

    def way(ordered: pincal.Plan) -> float:
        rows = [plan.poses.tolist().index(pose) for pose in ordered.poses.tolist()]
        return float(ways[rows[:-1], rows[1:]].sum() / least)

    assert way(in_rounds(mechanism, plan, 1)) < 1.3
    assert way(in_rounds(mechanism, plan, 3)) < 2.3
    assert way(plan) > 4.0


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
    with pytest.raises(pincal.ObservabilityError, match="40 poses remain for verification, but 50"):
        with_verification(mechanism, plan, offered, 50)


@pytest.mark.slow
def test_a_drift_does_not_hide_in_legs() -> None:
    """A tracker that drifts by 0.2 mm: limits of the platform's error hold, or are withdrawn.

    Leg after leg, each leg is calibrated by its own part of the drift, which its residuals do not
    show: errors are larger than the noise makes them. In rounds they are not.
    """
    noise = pincal.Noise(2e-5, 2e-5)
    mechanism, plan = leg_after_leg(20)
    poses = plan.poses
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
        return share, share * expected.unnoticed

    rounds = [in_rounds(mechanism, plan, every=0, seed=seed) for seed in range(6)]
    assert all(shares(seed, ordered)[0] <= 1.0 for seed, ordered in enumerate(rounds))
    assert max(shares(seed, plan)[1] for seed in range(6)) > 1.0


def test_select_writes_in_rounds_and_calibrate_verifies(tmp_path: Path) -> None:
    """From the command line to the report: rows to verify with are predicted, not followed.

    Python chooses the same plan; set points are the readings of its poses.
    """
    mechanism = pincal.load_mechanism("3RRR")
    plan, data = tmp_path / "plan.csv", tmp_path / "m.csv"
    offered = pincal.Plan(workspace("3RRR", 300))
    offered.to_csv(tmp_path / "c.csv", mechanism)
    choose = ["select", "3RRR", "--count", 10, "--starts", 1, "--candidates", tmp_path / "c.csv"]
    done(*choose, "--verify", 6, "--units", "mm,deg", "-o", plan)
    written = pincal.Plan.from_csv(plan, mechanism)
    assert written.sets is not None
    counts = [written.sets.count(name) for name in (*mechanism.leg_names, "verify", "all")]
    assert counts == [10, 10, 10, 6, 3]
    chosen = pincal.select("3RRR", candidates=offered, count=10, starts=1, verify=6)
    np.testing.assert_allclose(chosen.plan.poses, written.poses, atol=1e-9)
    assert (chosen.plan.sets, chosen.plan.places) == (written.sets, written.places)
    head, *lines = plan.read_text().splitlines()
    names = head.split(",")
    assert names[-3:] == [f"planned_{leg} [deg]" for leg in mechanism.leg_names]
    planned = np.array([line.split(",")[-3:] for line in lines], dtype=float)
    wanted = np.degrees(pincal.inverse(mechanism, written.poses).readings)
    np.testing.assert_allclose(planned, wanted, atol=1e-6)
    noise = ["--noise-position", "1e-4", "--noise-orientation", "1e-4"]
    done("simulate", "3RRR", plan, *noise, "-o", data)
    done("calibrate", "--no-report", "3RRR", data, *noise, "-o", tmp_path / "r")
    result = pincal.load_result(tmp_path / "r")
    assert result.validation is not None
    assert result.validation.rows == 6
