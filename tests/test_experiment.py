"""Observability, certificates, selection of poses, simulation."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

import pincal
from pincal import indices
from pincal.design.forecast import leg_rows
from pincal.design.optimal import continuous_design, exchange
from pincal.estimation.observability.identifiable import identifiability, r_diagonal
from pincal.kinematics.configurations import leg_demands
from pincal.workspace.criteria import in_workspace


def test_indices_equal_their_definitions() -> None:
    """O1 and O2 of a matrix with known singular values."""
    s = np.array([4.0, 2.0, 0.5])
    rng = np.random.default_rng(0)
    U, _ = np.linalg.qr(rng.standard_normal((9, 3)))
    V, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    found = indices(U @ np.diag(s) @ V.T)
    mean = 4.0 ** (1 / 3)
    values = [found.O1, found.O1_per_parameter, found.O2]
    np.testing.assert_allclose(values, [mean / 3, mean / 3, 0.125], rtol=1e-12)
    assert indices(np.ones((5, 2))).O2 < 1e-15
    assert indices(np.ones((1, 2))).O1 == 0.0


def test_r_diagonal_is_that_of_gram_schmidt() -> None:
    """|R_ii| is the length of a column less its part along those before it."""
    C = np.random.default_rng(1).standard_normal((12, 4))
    expected = []
    for i in range(4):
        rest = C[:, i] - C[:, :i] @ np.linalg.lstsq(C[:, :i], C[:, i], rcond=None)[0]
        expected.append(np.linalg.norm(rest))
    np.testing.assert_allclose(r_diagonal(C), expected, rtol=1e-12)


def test_what_is_not_identifiable_is_named() -> None:
    """Two proportional columns move together, a zero column has no effect, the rest is found."""
    C = np.random.default_rng(2).standard_normal((20, 5)) * [1.0, 1e-4, 1e3, 1.0, 1.0]
    names = [f"leg_2.{name}" for name in "abcde"]
    assert identifiability(C, names).complete
    C[:, 3] = -2.0 * C[:, 1]
    C[:, 4] = 0.0
    found = identifiability(C, names)
    assert found.rank == 3
    assert "leg_2.b and leg_2.d move together" in found.describe()
    assert "leg_2.e has no effect" in found.describe()
    assert "leg_2.a" not in [name for group in found.groups for name in group]


def at_one_orientation(poses: np.ndarray) -> np.ndarray:
    """Return 3-RRR poses turned to phi = 0, those that stay in the workspace."""
    poses = np.column_stack((poses[:, :2], np.zeros(len(poses))))
    return poses[in_workspace(pincal.load_mechanism("3RRR"), poses)]


def test_constant_orientation_leaves_named_parameters(candidates: dict[str, np.ndarray]) -> None:
    """3-RRR poses all at phi = 0 do not separate base point and platform point."""
    mechanism = pincal.load_mechanism("3RRR")
    poses = at_one_orientation(candidates["3RRR"][:200])
    C = pincal.identification_jacobian(mechanism, "leg_1", poses)
    found = identifiability(C, mechanism.legs[0].parameter_names)
    assert found.rank == 6
    named = {name for group in found.groups for name in group}
    assert named == {"OA", "beta", "ob", "beta_b"}


def _blocks(seed: int, count: int, rows: int, n: int) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal((count, rows, n))


@pytest.mark.parametrize("rows", [1, 2])
def test_the_bound_holds_and_is_tight(rows: int) -> None:
    """No weights on the candidates have more information than the bound; the design nearly does."""
    blocks = _blocks(3, 200, rows, 4)
    design = continuous_design((blocks,))
    assert design.weights.sum() == pytest.approx(1.0)
    assert design.bound - design.value <= 4 * 1e-4
    M = np.einsum("j,jri,jrk->ik", design.weights, blocks, blocks)
    assert np.linalg.slogdet(M)[1] == pytest.approx(design.value, abs=1e-9)
    rng = np.random.default_rng(4)
    for _ in range(200):  # near the optimum, within 1e-4 of the bound
        weights = design.weights * np.exp(0.02 * rng.standard_normal(200))
        weights /= weights.sum()
        M = np.einsum("j,jri,jrk->ik", weights, blocks, blocks)
        assert np.linalg.slogdet(M)[1] <= design.bound


def test_the_bound_of_a_known_optimum() -> None:
    """Points of the segment: weights 1/2 on both ends; of the circle: det M = 1/4."""
    x = np.linspace(-1, 1, 101)
    design = continuous_design((np.stack([np.ones(101), x], axis=1)[:, None, :],))
    np.testing.assert_allclose(design.weights[[0, -1]], 0.5, atol=1e-3)
    assert design.bound == pytest.approx(0.0, abs=3e-3)
    a = np.linspace(0, 2 * np.pi, 40, endpoint=False)
    circle = continuous_design((np.stack([np.cos(a), np.sin(a)], axis=1)[:, None, :],))
    assert circle.bound == pytest.approx(np.log(0.25), abs=3e-3)


def test_candidates_that_lack_rank_are_refused() -> None:
    """The continuous design of candidates in a plane of parameter space does not exist."""
    blocks = _blocks(5, 50, 1, 3)
    blocks[:, :, 2] = blocks[:, :, 0]
    with pytest.raises(pincal.ObservabilityError, match="undetermined"):
        continuous_design((blocks,))


@pytest.mark.parametrize("rows", [1, 2])
def test_exchange_finds_the_best_of_all_sets(rows: int) -> None:
    """On 14 candidates, 5 to be chosen, the exchange finds what trying all 2002 sets finds."""
    for seed in range(5):
        blocks = _blocks(seed, 14, rows, 3)
        design = continuous_design((blocks,))
        rng = np.random.default_rng(0)
        chosen, log_det = exchange((blocks,), 5, design.weights, rng, starts=20)

        def value(index: tuple[int, ...], blocks: np.ndarray = blocks) -> float:
            stacked = blocks[list(index)].reshape(-1, 3)
            return float(np.linalg.slogdet(stacked.T @ stacked)[1])

        best = max(value(index) for index in combinations(range(14), 5))
        assert log_det == pytest.approx(value(tuple(chosen)), abs=1e-9)
        assert log_det == pytest.approx(best, abs=1e-9)
        assert len(set(chosen.tolist())) == 5
        assert design.efficiency(log_det, 5) <= 1.0


@pytest.mark.parametrize("rows", [1, 2])
def test_a_set_stands_against_candidates_that_the_search_began_without(rows: int) -> None:
    """Of 3000, weighted at random: the best to add and then the worst to drop gain nothing."""
    rng = np.random.default_rng(4)
    blocks = rng.normal(size=(3000, rows, 4))
    chosen, log_det = exchange((blocks,), 9, rng.random(3000), rng, starts=1)

    def value(*sets: np.ndarray) -> np.ndarray:
        total = sum(np.einsum("...ij,...ik->...jk", one, one) for one in sets)
        return np.linalg.slogdet(total)[1]

    own = blocks[chosen].reshape(-1, 4)
    assert value(own) == pytest.approx(log_det, abs=1e-9)
    others = np.delete(blocks, chosen, axis=0)
    kept = np.concatenate((blocks[chosen], others[None, np.argmax(value(own, others))]))
    dropped = [value(np.delete(kept, i, axis=0).reshape(-1, 4)) for i in range(10)]
    assert max(dropped) <= log_det + 1e-8


def test_selection_reaches_the_wanted_efficiency(
    selections: dict[str, pincal.Selection],
) -> None:
    """24 of 30,000 poses of the 3-RRR have 0.955 of the bound's (det)^(1/8); so do the 5R's."""
    assert selections["3RRR"].efficiency >= 0.955
    assert selections["5R"].efficiency >= 0.955


def test_the_reported_efficiency_is_that_of_the_plan(
    candidates: dict[str, np.ndarray], selections: dict[str, pincal.Selection]
) -> None:
    """Efficiency recomputed from the written poses and a bound by another algorithm agrees."""
    mechanism = pincal.load_mechanism("3RRR")
    plan = selections["3RRR"].plan

    def rows(poses: np.ndarray) -> np.ndarray:
        demand = leg_demands(mechanism, pincal.Plan(poses))[0]
        return leg_rows(demand, mechanism, pincal.Noise())[:, 0]

    A, own = rows(candidates["3RRR"]), rows(plan.poses[plan.serves("leg_1")])
    A, own = A / np.linalg.norm(A, axis=0), own / np.linalg.norm(A, axis=0)
    weights = np.full(len(A), 1 / len(A))
    for _ in range(400):  # the multiplicative algorithm, slow but sure
        inverse = np.linalg.inv((A * weights[:, None]).T @ A)
        weights = weights * ((A @ inverse) * A).sum(axis=1) / 8
    inverse = np.linalg.inv((A * weights[:, None]).T @ A)
    bound = -np.linalg.slogdet(inverse)[1] + 8 * np.log(((A @ inverse) * A).sum(axis=1).max() / 8)
    efficiency = np.exp((np.linalg.slogdet(own.T @ own)[1] - bound) / 8) / len(own)
    assert efficiency <= selections["3RRR"].efficiency + 1e-6  # a looser bound
    assert efficiency == pytest.approx(selections["3RRR"].efficiency, abs=0.02)


def test_selected_poses_are_reachable_candidates_without_repetition(
    kind: str, candidates: dict[str, np.ndarray]
) -> None:
    """Every protocol returns distinct poses within the workspace, as many as asked."""
    mechanism = pincal.load_mechanism(kind)
    n_legs = len(mechanism.legs)
    sizes = {"independent": n_legs, "symmetric": n_legs, "orbits": n_legs, "common": 1}
    for protocol, times in sizes.items():
        selection = pincal.select_poses(mechanism, candidates[kind][:3000], 12, protocol, starts=3)
        plan = selection.plan
        assert len(plan.poses) == 12 * times
        slack = pincal.Margins(0.23 - 1e-9, 0.2 - 1e-9)
        assert in_workspace(mechanism, plan.poses, slack).all()
        for leg in mechanism.leg_names:
            own = plan.poses[plan.serves(leg)]
            assert len(np.unique(own.round(12), axis=0)) == len(own)
            assert len(own) == (12 if protocol != "orbits" else 12 * n_legs)
        assert 0.5 < selection.efficiency <= 1.0


def test_mapped_poses_are_symmetrically_observable(
    kind: str, selections: dict[str, pincal.Selection]
) -> None:
    """|R_ii| of every leg at its mapped poses equals leg 1's to 1e-9 (3-RRR paper, Eq. 10)."""
    mechanism, plan = pincal.load_mechanism(kind), selections[kind].plan
    diagonals = [
        r_diagonal(pincal.identification_jacobian(mechanism, leg, plan.poses[plan.serves(leg)]))
        for leg in mechanism.leg_names
    ]
    for diagonal, design in zip(diagonals, selections[kind].legs, strict=True):
        np.testing.assert_allclose(diagonal, diagonals[0], rtol=1e-9)
        np.testing.assert_allclose(design.r_diagonal, diagonal, rtol=1e-9)


def _information(mechanism: pincal.Mechanism, poses: np.ndarray) -> float:
    """Return det^(1/2n) of leg 1's information: one over the mean width of its ellipsoid."""
    demand = leg_demands(mechanism, pincal.Plan(poses))[0]
    rows = leg_rows(demand, mechanism, pincal.Noise())[:, 0]
    return float(np.exp(np.linalg.slogdet(rows.T @ rows)[1] / (2 * rows.shape[1])))


@pytest.mark.slow
def test_orbits_gain_over_mapped_poses(
    candidates: dict[str, np.ndarray], selections: dict[str, pincal.Selection]
) -> None:
    """With 72 measured poses, every pose for every leg gains; choosing orbits gains more.

    The Cramér-Rao ellipsoid (mean of its principal axes) narrows by at least 1.48 and 1.6; with 8
    orbits, 24 poses in all, they come within 11 % of those of 72 mapped poses.
    """
    mechanism = pincal.load_mechanism("3RRR")
    plan = selections["3RRR"].plan
    own = _information(mechanism, plan.poses[plan.serves("leg_1")])
    chosen = {
        count: pincal.select_poses(mechanism, candidates["3RRR"], count, "orbits").plan.poses
        for count in (8, 24)
    }
    assert (len(plan.poses), len(chosen[8]), len(chosen[24])) == (72, 24, 72)
    shared = _information(mechanism, plan.poses)
    assert shared / own >= 1.48
    assert _information(mechanism, chosen[24]) / own >= 1.6
    assert _information(mechanism, chosen[24]) > shared
    assert own / _information(mechanism, chosen[8]) <= 1.11


def test_selection_is_determined_by_its_seed(
    mechanism: pincal.Mechanism, candidates: dict[str, np.ndarray]
) -> None:
    """Same seed, same poses; and no worse than its start, the rounded continuous design."""
    poses = candidates[mechanism.name][:2000]
    one = pincal.select_poses(mechanism, poses, 12, seed=5, starts=4)
    two = pincal.select_poses(mechanism, poses, 12, seed=5, starts=4)
    np.testing.assert_array_equal(one.plan.poses, two.plan.poses)
    start = pincal.select_poses(mechanism, poses, 12, seed=5, starts=1)
    assert one.efficiency >= start.efficiency


def test_too_few_poses_are_refused(
    mechanism: pincal.Mechanism, candidates: dict[str, np.ndarray]
) -> None:
    """Fewer poses than parameters, or fewer candidates than poses, raise and say how many."""
    poses = candidates[mechanism.name][:30]
    n = len(mechanism.legs[0].parameters)
    with pytest.raises(pincal.ObservabilityError, match=f"at least {n}"):
        pincal.select_poses(mechanism, poses, n - 1)
    with pytest.raises(pincal.ObservabilityError, match="reaches 30 of 30"):
        pincal.select_poses(mechanism, poses, 31)


def test_unobservable_candidates_are_refused_by_name(candidates: dict[str, np.ndarray]) -> None:
    """3-RRR candidates at one orientation raise, naming what moves together."""
    mechanism = pincal.load_mechanism("3RRR")
    poses = at_one_orientation(candidates["3RRR"][:300])
    with pytest.raises(pincal.ObservabilityError, match=r"leg_1\.\w+ move together"):
        pincal.select_poses(mechanism, poses, 12)


def test_unreachable_candidates_are_left_out_and_counted(
    mechanism: pincal.Mechanism, candidates: dict[str, np.ndarray]
) -> None:
    """Candidates out of reach are never chosen, and the selection says how many there were."""
    poses = candidates[mechanism.name][:100]
    far = poses[:7] + 50.0
    selection = pincal.select_poses(mechanism, np.concatenate((far, poses)), 12)
    assert selection.unreachable == 7
    assert np.abs(selection.plan.poses).max() < 10


def test_symmetric_selection_needs_the_symmetry(
    mechanism: pincal.Mechanism, candidates: dict[str, np.ndarray]
) -> None:
    """A mechanism without the symmetry raises and names what breaks it."""
    broken = mechanism.with_parameters({"leg_2": {"l": mechanism.legs[1].nominal[0] * 1.01}})
    poses = candidates[mechanism.name][:100]
    with pytest.raises(pincal.SymmetryError, match=r"leg_.* carried there in position of 'elbow'"):
        pincal.select_poses(broken, poses, 12, "symmetric")
    assert len(pincal.select_poses(broken, poses, 12, "independent").plan.poses)


def test_simulated_measurements_have_the_noise_asked_for(
    mechanism: pincal.Mechanism, candidates: dict[str, np.ndarray]
) -> None:
    """Noise on pose and readings has the standard deviations given; without it, none."""
    poses = candidates[mechanism.name][:4000]
    plan = pincal.Plan(poses)
    truth = pincal.disturb(mechanism, 1e-3, seed=1)
    clean = pincal.simulate(mechanism, truth, plan, pincal.Noise(0, 0, 0)).measurements
    np.testing.assert_allclose(
        clean.readings, pincal.inverse(mechanism, poses).readings, atol=1e-12
    )
    np.testing.assert_allclose(
        pincal.inverse(truth, clean.poses).readings, clean.readings, atol=1e-10
    )
    noisy = pincal.simulate(mechanism, truth, plan, pincal.Noise(1e-4, 3e-4, 2e-5), seed=2)
    spread = (noisy.measurements.poses - clean.poses).std(axis=0)
    np.testing.assert_allclose(spread, [1e-4, 1e-4, 3e-4][: len(spread)], rtol=0.05)
    np.testing.assert_allclose(
        (noisy.measurements.readings - clean.readings).std(axis=0), 2e-5, rtol=0.05
    )


def test_poses_the_true_mechanism_misses_are_reported() -> None:
    """A pose at the edge of reach is missed by shorter links, and listed with its row."""
    mechanism = pincal.load_mechanism("5R")
    truth = mechanism.with_parameters({"leg_1": {"L": 1.0}, "leg_2": {"L": 1.0}})
    plan = pincal.Plan(np.array([[0.0, 1.1], [0.0, 1.76], [0.0, 5.0]]))
    simulation = pincal.simulate(mechanism, truth, plan, pincal.Noise(0, 0, 0))
    assert simulation.rows.tolist() == [0, 1]
    ((row, reason),) = simulation.unreachable
    assert row == 2
    assert "nominal" in reason
    short = mechanism.with_parameters({"leg_1": {"L": 0.6}, "leg_2": {"L": 0.6}})
    lost = pincal.simulate(mechanism, short, plan, pincal.Noise(0, 0, 0)).unreachable
    assert (0, "true mechanism: no pose found that closes all legs") in lost


def test_disturbance_is_alike_for_all_parameters() -> None:
    """Over many draws every parameter is disturbed with the standard deviation given."""
    mechanism = pincal.load_mechanism("5R")
    draws = np.array(
        [
            np.concatenate(
                [
                    a.nominal - b.nominal
                    for a, b in zip(
                        pincal.disturb(mechanism, 2e-3, seed).legs, mechanism.legs, strict=True
                    )
                ]
            )
            for seed in range(400)
        ]
    )
    np.testing.assert_allclose(draws.std(axis=0), 2e-3, rtol=0.15)
    with pytest.raises(pincal.MeasurementError, match="disturbance"):
        pincal.disturb(mechanism, -1.0)


def test_accuracy_of_the_truth_is_exact(
    mechanism: pincal.Mechanism, candidates: dict[str, np.ndarray]
) -> None:
    """A model that is the truth makes no error; one millimetre on A_x or OA makes about one."""
    poses = candidates[mechanism.name][:500]
    exact = pincal.accuracy(mechanism, mechanism, poses)
    assert exact.position < 1e-12
    assert exact.orientation < 1e-12
    assert exact.unreachable == 0
    shifted = pincal.disturb(mechanism, 1e-3, seed=3)
    wrong = pincal.accuracy(mechanism, shifted, poses)
    assert 3e-4 < wrong.position < 2e-2
    assert wrong.worst_position >= wrong.position


def test_what_people_see_of_a_selection(selections: dict[str, pincal.Selection]) -> None:
    """A line, and a page with a row for each leg."""
    found = selections["3RRR"]
    assert repr(found).startswith("Selection(symmetric, 72 poses of ")
    assert "\n" not in repr(found)
    rows = [line.split() for line in str(found).splitlines()]
    assert [row[0] for row in rows if row[1:2] == ["24"]] == ["leg_1", "leg_2", "leg_3"]


def test_wrong_options_of_a_selection_are_refused(mechanism: pincal.Mechanism) -> None:
    """An option that does not exist, and measurements without noise."""
    poses = pincal.sample_workspace(mechanism, 30, seed=0)
    with pytest.raises(TypeError, match="sead"):
        pincal.select_poses(mechanism, poses, 12, sead=1)
    with pytest.raises(pincal.MeasurementError, match="no noise at all"):
        pincal.select_poses(mechanism, poses, 12, noise=pincal.Noise(0.0, 0.0, 0.0))


def test_orbits_of_which_one_has_most_of_the_weight() -> None:
    """Three rows of one orbit for four parameters: others stay in the search, which ends."""
    mechanism = pincal.load_mechanism("linear_delta")
    poses = pincal.sample_workspace(mechanism, 1500, seed=0)
    found = pincal.select_poses(mechanism, poses, 24, "orbits", starts=1)
    assert len(found.plan.poses) == 72
    assert 0.85 < found.efficiency <= 1.0


@pytest.mark.parametrize("kind", ["3RRR", "8cable", "linear_delta"])
def test_default_errors_go_with_the_machines_size(kind: str) -> None:
    """Without a number lengths are disturbed by 0.001 of the longest leg, all else by 0.001."""
    mechanism = pincal.load_mechanism(kind)
    size = max(leg.size for leg in mechanism.legs)
    usual, alike = pincal.disturb(mechanism, seed=3), pincal.disturb(mechanism, 1e-3, 3)
    for nominal, first, second in zip(mechanism.legs, usual.legs, alike.legs, strict=True):
        for name, unit in nominal.units.items():
            own, other = (leg.nominal_by_name[name] for leg in (first, second))
            drawn = other - nominal.nominal_by_name[name]
            factor = size if unit == "m" else 1.0
            assert np.isclose(own, nominal.nominal_by_name[name] + factor * drawn, atol=1e-12)
