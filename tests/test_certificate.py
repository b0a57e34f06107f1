"""The continuous design, its bound, and sets that no swap improves."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from measured import workspace

import pincal
from pincal.design.forecast import leg_rows as leg_rows_of
from pincal.design.optimal import Criterion, continuous_design, derivatives, exchange
from pincal.kinematics.configurations import leg_demands


@pytest.mark.slow
def test_the_bound_is_that_of_an_optimiser_of_all_candidates() -> None:
    """The multiplicative algorithm on all candidates, 30,000 steps, ends at the same design."""
    rng = np.random.default_rng(0)
    blocks = rng.standard_normal((300, 2, 4))
    weights = np.full(300, 1 / 300)
    rows = blocks.reshape(-1, 4)
    for _ in range(30_000):
        M = rows.T @ (rows * np.repeat(weights, 2)[:, None])
        weights = weights * ((rows @ np.linalg.inv(M)) * rows).reshape(300, -1).sum(axis=1) / 4
    design = continuous_design((blocks,))
    log_det = np.linalg.slogdet(M)[1]
    assert design.value - 1e-9 <= log_det <= design.bound + 1e-9
    assert design.bound - design.value <= 4 * 1e-4


@pytest.mark.parametrize("r", [1, 3])
@pytest.mark.parametrize("criterion", ["determinant", "mean variance"])
def test_derivatives_by_weights_are_those_of_values(criterion: str, r: int) -> None:
    """Gradient and Hessian by weights, against central differences of values and gradients."""
    rng = np.random.default_rng(r)
    rows, C = rng.standard_normal((12, r, 4)), rng.standard_normal((4, 3))
    maximised = Criterion() if criterion == "determinant" else Criterion(C)
    weights, step = rng.dirichlet(np.ones(12)), 1e-6

    def value(weights: np.ndarray) -> float:
        return maximised.value((np.sqrt(weights)[:, None, None] * rows,))

    hessian, slopes, _ = derivatives((rows,), weights, maximised)
    for j, change in enumerate(step * np.eye(12)):
        ends = weights + change, weights - change
        more, less = (derivatives((rows,), end, maximised)[1] for end in ends)
        np.testing.assert_allclose(-(more - less) / (2 * step), hessian[j], rtol=1e-5, atol=1e-5)
        risen = (value(ends[0]) - value(ends[1])) / (2 * step)
        assert risen == pytest.approx(slopes[j], rel=1e-5, abs=1e-6)


@pytest.mark.parametrize("kind", ["3RRR", "3RPS"])
def test_rows_of_a_leg_are_whitened(kind: str) -> None:
    """One row of a 3-RRR's leg, two of a 3-RPS's: as by the root of the noise that they carry."""
    mechanism, noise = pincal.load_mechanism(kind), pincal.Noise(1e-4, 2e-4, 5e-5)
    plan = pincal.Plan(pincal.sample_workspace(kind, 40, seed=0))
    demand = leg_demands(mechanism, plan)[0]
    found = leg_rows_of(demand, mechanism, noise)
    by = np.concatenate(
        (demand.pose * noise.of_poses(mechanism), demand.reading * noise.reading), axis=2
    )
    inverse = np.linalg.inv(by @ by.transpose(0, 2, 1))
    expected = demand.parameter.transpose(0, 2, 1) @ inverse @ demand.parameter
    np.testing.assert_allclose(found.transpose(0, 2, 1) @ found, expected, rtol=1e-9, atol=1e-3)


def test_no_swap_of_two_improves_a_set() -> None:
    """Of 60 candidates of two rows, 9 chosen: each of the 459 swaps loses."""
    rng = np.random.default_rng(3)
    blocks = rng.standard_normal((60, 2, 4))
    chosen, log_det = exchange((blocks,), 9, rng.random(60), rng, starts=1)

    def value(places: list[int]) -> float:
        flat = blocks[places].reshape(-1, 4)
        return float(np.linalg.slogdet(flat.T @ flat)[1])

    assert value(list(chosen)) == pytest.approx(log_det, abs=1e-9)
    for kept in combinations(chosen.tolist(), 8):
        for other in set(range(60)) - set(chosen.tolist()):
            assert value([*kept, other]) <= log_det + 1e-9


def test_candidates_out_of_reach_carry_no_weight_and_are_not_chosen() -> None:
    """Half of the candidates are far away: the choice and its bound are those of the others."""
    mechanism, poses = pincal.load_mechanism("3RRR"), workspace("3RRR", 1500)
    far = poses + np.array([5.0, 0.0, 0.0])
    mixed = np.stack((poses, far), axis=1).reshape(-1, 3)
    for protocol in ("symmetric", "common"):
        alone = pincal.select_poses(mechanism, poses, 12, protocol)  # type: ignore[arg-type]
        among = pincal.select_poses(mechanism, mixed, 12, protocol)  # type: ignore[arg-type]
        assert (among.candidates, among.unreachable) == (1500, 1500)
        assert among.efficiency == pytest.approx(alone.efficiency, abs=5e-3)
        assert pincal.inverse(mechanism, among.plan.poses).reached.all()


def test_a_leg_that_reaches_less_than_the_one_that_is_designed() -> None:
    """Leg 1 reaches candidates that leg 3 does not: they are left out of choice and bound."""
    mechanism = pincal.load_mechanism("3RRR")
    rng = np.random.default_rng(0)
    wide = np.column_stack((rng.uniform(-1, 1, (6000, 2)), rng.uniform(-1, 1, 6000)))
    reached = pincal.inverse(mechanism, wide).reached
    assert (reached[:, 0] & ~reached.all(axis=1)).sum() > 100
    chosen = pincal.select_poses(mechanism, wide, 12, "independent")
    assert chosen.candidates == reached.all(axis=1).sum()
    assert pincal.inverse(mechanism, chosen.plan.poses).reached.all()
    within = pincal.select_poses(mechanism, wide[reached.all(axis=1)], 12, "independent")
    assert chosen.efficiency == pytest.approx(within.efficiency, abs=1e-2)


def test_strong_candidates_off_the_sample_keep_the_design_whole() -> None:
    """One candidate far stronger than those looked at first: a bound, and no lost rank."""
    rows = np.random.default_rng(0).standard_normal((3000, 1, 4))
    rows[1] *= 30
    design = continuous_design((rows,))
    chosen, value = exchange((rows,), 9, design.priority, np.random.default_rng(0), 3)
    assert 1 in chosen
    assert 0.8 < design.efficiency(value, 9) <= 1.0


def test_copies_of_few_candidates_have_all_of_the_rank() -> None:
    """Many copies of few candidates have the bound of these."""
    rng = np.random.default_rng(2)
    few = rng.standard_normal((20, 1, 6))
    copies = few[rng.integers(0, 20, 4000)]
    bounds = [continuous_design((one,)).bound for one in (few, copies)]
    assert bounds[0] == pytest.approx(bounds[1], abs=1e-3)
