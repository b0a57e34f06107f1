"""Selection by orbits of legs and of poses: of any size, each pose once, any offset and gain."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from marks import quick
from measured import workspace
from moved import moved, random_motion

import pincal
from pincal import indices
from pincal.design.forecast import leg_rows
from pincal.design.orbits import (
    carried_legs,
    distinct,
    maps,
    merged,
    orbit_of,
    representatives,
    selection_group,
    smallest,
)
from pincal.design.select import Search
from pincal.kinematics.configurations import leg_demands


def three_and_three() -> pincal.Mechanism:
    """Return a hexapod of two kinds of legs: three near the centre, three far from it."""
    leg = pincal.load_mechanism("6UPS").legs[0]
    platform = pincal.Platform("spatial", (0.0, 0.0, 1.8, 0.0, 0.0, 0.0))
    halves = []
    for number, values in enumerate(
        (
            {"OA": 0.4, "beta": 0.2, "beta_b": 0.9},
            {"OA": 0.6, "ob": 0.35, "beta": -0.4, "beta_b": -1.1},
        )
    ):
        own = leg.with_parameters(values)
        halves.append(pincal.generate(f"half_{number}", own, pincal.cyclic(3), platform).legs)
    legs = tuple(
        replace(one, name=f"leg_{i}", point=replace(one.point, name=f"b_{i}"))
        for i, one in enumerate((*halves[0], *halves[1]), 1)
    )
    return pincal.Mechanism("3+3UPS", platform, legs)


@pytest.fixture(scope="module")
def mixed() -> pincal.Mechanism:
    return three_and_three()


@pytest.fixture(scope="module")
def mixed_poses(mixed: pincal.Mechanism) -> np.ndarray:
    return pincal.sample_workspace(mixed, 1500, least=pincal.Margins.none())


def log_det(mechanism: pincal.Mechanism, leg: str, poses: np.ndarray) -> float:
    """Return log det of a leg's information at poses."""
    demand = leg_demands(mechanism, pincal.Plan(poses))[mechanism.leg_names.index(leg)]
    rows = leg_rows(demand, mechanism, pincal.Noise())
    flat = rows.reshape(-1, rows.shape[2])
    return float(np.linalg.slogdet(flat.T @ flat)[1])


def no_pose_twice(mechanism: pincal.Mechanism, plan: pincal.Plan) -> bool:
    """Return whether all poses of a plan are distinct."""
    matrices = mechanism.platform.matrices(plan.poses).round(9)
    return len(np.unique(matrices.reshape(len(plan.poses), -1), axis=0)) == len(plan.poses)


def diagonals_differ(found: pincal.Selection) -> float:
    """Return the largest part by which |R_ii| of a leg differ from those of its reference leg."""
    diagonals = {leg.leg: leg.r_diagonal for leg in found.legs}
    return max(np.abs(leg.r_diagonal / diagonals[leg.reference] - 1).max() for leg in found.legs)


def distinct_orbits(
    mechanism: pincal.Mechanism, elements: tuple[pincal.Element, ...], poses: np.ndarray
) -> np.ndarray:
    """Return the poses that are no image of an earlier one, as indices."""
    images = representatives(orbit_of(elements, mechanism.platform.matrices(poses))[0])
    return distinct(mechanism.platform, mechanism.platform.from_matrices(images))


@pytest.mark.parametrize("protocol", ["symmetric", "orbits"])
def test_two_orbits_of_legs(
    mixed: pincal.Mechanism, mixed_poses: np.ndarray, protocol: pincal.design.select.Protocol
) -> None:
    """A reference leg each: every leg has as much information as its reference, near the bound."""
    group = selection_group(mixed)
    assert group.leg_orbits == (("leg_1", "leg_2", "leg_3"), ("leg_4", "leg_5", "leg_6"))
    found = pincal.select_poses(mixed, mixed_poses, 12, protocol, starts=2)
    assert 0.75 < found.efficiency <= 1.0
    assert no_pose_twice(mixed, found.plan)
    assert [leg.reference for leg in found.legs] == ["leg_1"] * 3 + ["leg_4"] * 3
    own = {
        leg.leg: log_det(mixed, leg.leg, found.plan.poses[found.plan.serves(leg.leg)])
        for leg in found.legs
    }
    for leg in found.legs:
        assert own[leg.leg] == pytest.approx(own[leg.reference], abs=1e-8)
        assert leg.poses == (12 if protocol == "symmetric" else len(found.plan.poses))


@pytest.mark.parametrize("protocol", ["symmetric", "orbits"])
def test_a_leg_on_the_axis_is_an_orbit(protocol: pincal.design.select.Protocol) -> None:
    """4cable: three low lines and one from above; O₁ is the same in an orbit."""
    mechanism = pincal.load_mechanism("4cable")
    found = pincal.select_poses(mechanism, workspace("4cable", 1000), 10, protocol, starts=2)
    assert found.efficiency > 0.85
    assert no_pose_twice(mechanism, found.plan)
    O1 = [leg.indices.O1 for leg in found.legs]
    np.testing.assert_allclose(O1[:3], O1[0], rtol=1e-9)
    assert [leg.reference for leg in found.legs] == ["line_A"] * 3 + ["line_D"]
    if protocol == "symmetric":
        assert [leg.poses for leg in found.legs] == [10] * 4
        assert diagonals_differ(found) > 1e-3  # Cartesian parameters turn into each other


def test_candidates_on_a_mirror() -> None:
    """Their orbits are smaller, and no pose of them is measured twice."""
    mechanism = pincal.load_mechanism("6UPS")
    rng = np.random.default_rng(0)
    poses = np.zeros((300, 6))
    poses[:, 0] = rng.uniform(-0.3, 0.3, 300)
    poses[:, 2] = rng.uniform(1.7, 2.2, 300)
    poses[:, 4] = rng.uniform(0.0, 0.3, 300)  # tilted about y: in the mirror plane y = 0
    elements = smallest(selection_group(mechanism))
    found, own = orbit_of(elements, mechanism.platform.matrices(poses))
    assert found.shape == (6, 300, 4, 4)
    assert (own.sum(axis=0) == 3).all()
    assert len(distinct_orbits(mechanism, elements, poses)) == 300
    chosen = pincal.select_poses(mechanism, poses, 12, "orbits", starts=2)
    assert len(chosen.plan.poses) == 36
    assert chosen.candidates == 300
    assert no_pose_twice(mechanism, chosen.plan)
    half = mechanism.platform.from_matrices(found[:3].reshape(-1, 4, 4))
    mapped = pincal.select_poses(mechanism, half, 12, "symmetric", starts=2)
    assert no_pose_twice(mechanism, mapped.plan)
    assert [leg.poses for leg in mapped.legs] == [12] * 6
    assert len(mapped.plan.poses) <= 36  # each serves two legs or more
    assert all("+" in one or one == "all" for one in mapped.plan.sets or ())


def test_images_of_candidates_are_not_chosen_again() -> None:
    """Candidates that are images of others are left out; the whole orbit is there already."""
    mechanism = pincal.load_mechanism("3RRR")
    poses = workspace("3RRR", 50)
    turned = pincal.Element(2 * np.pi / 3).poses(mechanism.platform, poses[:20])
    elements = smallest(selection_group(mechanism))
    every = np.concatenate((poses, turned))
    _, own = orbit_of(elements, mechanism.platform.matrices(every))
    assert own.all()
    np.testing.assert_array_equal(distinct_orbits(mechanism, elements, every), np.arange(50))


def test_a_plan_serves_several_legs(tmp_path: pytest.TempPathFactory) -> None:
    """Poses that two legs want are held once, and read back so."""
    mechanism = pincal.load_mechanism("3RRR")
    poses = workspace("3RRR", 3)
    plan = merged(
        mechanism, poses[[0, 1, 0, 2, 0, 1]], ["leg_1", "leg_1", "leg_2", "leg_2", "leg_3", "leg_3"]
    )
    assert plan.sets == ("all", "leg_1+leg_3", "leg_2")
    path = tmp_path / "plan.csv"  # type: ignore[operator]
    plan.to_csv(path, mechanism)
    again = pincal.Plan.from_csv(path, mechanism)
    assert again.sets == plan.sets
    assert [again.serves(leg).tolist() for leg in mechanism.leg_names] == [
        [True, True, False],
        [True, False, True],
        [True, True, False],
    ]


def test_offsets_and_gains_do_not_matter() -> None:
    """γ adds multiples of its column to k's: O₁ is the same to 1e-9; gains are no bar either."""
    mechanism, poses = pincal.load_mechanism("3RRR"), workspace("3RRR", 400)
    other = mechanism.with_parameters({"leg_2": {"gamma": 1.3}, "leg_3": {"gamma": -0.4}})
    assert len(pincal.symmetry_group(other).elements) == 3
    one, two = (
        pincal.select_poses(m, poses, 12, "symmetric", starts=2) for m in (mechanism, other)
    )
    np.testing.assert_allclose(
        [leg.indices.O1 for leg in two.legs], one.legs[0].indices.O1, rtol=1e-9
    )
    assert diagonals_differ(one) < 1e-9 < diagonals_differ(two)
    assert two.efficiency == pytest.approx(one.efficiency, rel=1e-9)
    geared = mechanism.with_parameters({"leg_2": {"k": 1.5}})
    noise = pincal.Noise(1e-4, 1e-4, 1e-4)
    found = pincal.select_poses(geared, poses, 12, "symmetric", noise=noise, starts=2)
    assert 0.5 < found.legs[1].efficiency <= 1.0
    assert found.legs[1].efficiency != pytest.approx(found.legs[0].efficiency, rel=1e-6)
    assert pincal.inverse(geared, poses).reached.all()


@pytest.mark.parametrize("name", quick(1, ["3RRR", "6UPS"]))
def test_moved_machines_are_chosen_for_alike(name: str) -> None:
    """Frames that stand elsewhere: as good a choice, O₁ equal in all legs."""
    mechanism, poses = pincal.load_mechanism(name), workspace(name, 400)
    base, platform = random_motion(mechanism.platform, np.random.default_rng(5), 0.3)
    away = moved(mechanism, base, platform)
    matrices = mechanism.platform.transforms(poses).as_matrix()
    there = away.platform.from_matrices(base @ matrices @ np.linalg.inv(platform))
    found = pincal.select_poses(away, there, 16, "symmetric", starts=2)
    O1 = [leg.indices.O1 for leg in found.legs]
    np.testing.assert_allclose(O1, O1[0], rtol=1e-9)
    assert found.efficiency > 0.8
    orbits = pincal.select_poses(away, there, 4, "orbits", starts=2)
    assert no_pose_twice(away, orbits.plan)


def test_rows_of_readings_that_lack_rank_are_refused() -> None:
    """A 3-RPS leg makes two equations and has one reading: no index of its readings' rows."""
    mechanism = pincal.load_mechanism("3RPS")
    poses = pincal.sample_workspace(mechanism, 50)
    for protocol in ("symmetric", "independent", "common", "orbits"):
        with pytest.raises(pincal.ObservabilityError, match=r"2 equations .* 1 reading: rows of"):
            pincal.select_poses(mechanism, poses, 12, protocol)  # type: ignore[arg-type]


def test_parameters_that_do_not_map_are_refused() -> None:
    """Two legs alike, one without an offset to identify: their rows span other spaces."""
    mechanism = pincal.load_mechanism("3RRR")
    legs = list(mechanism.legs)
    gamma = legs[1].nominal_by_name["gamma"]
    sensor = replace(legs[1].sensors[0], offset=gamma)
    kept = tuple(p for p in legs[1].parameters if p[0] != "gamma")
    legs[1] = replace(legs[1], sensors=(sensor,), parameters=kept)
    other = replace(mechanism, legs=tuple(legs))
    group = selection_group(other)
    assert len(group.elements) == 3
    with pytest.raises(pincal.SymmetryError, match="not the parameters of one"):
        carried_legs(group, workspace("3RRR", 30))
    plan = pincal.select(other, candidates=workspace("3RRR", 200), count=8, starts=1)
    assert plan.protocol == "independent"  # unless asked for, symmetry is no must


def test_rows_map_by_one_matrix() -> None:
    """Rows times a matrix are found to be so; with noise in them they are not."""
    rng = np.random.default_rng(0)
    rows, M = rng.normal(size=(40, 6)), rng.normal(size=(6, 6))
    assert maps(rows, rows @ M)
    assert not maps(rows, rows @ M + 1e-3 * rng.normal(size=(40, 6)))
    assert not maps(rows, rows[:, :5])


def test_too_few_legs_are_said() -> None:
    """Two planar legs give two equations for three freedoms: no type-2 singularity to move from."""
    leg = pincal.load_mechanism("3RRR").legs[0]
    platform = pincal.Platform("planar", (0.0, 0.0, 0.0))
    mechanism = pincal.generate("2RRR", leg, pincal.cyclic(2), platform)
    with pytest.raises(pincal.WorkspaceError, match="2 equations, too few for the 3 freedoms"):
        pincal.sample_workspace(mechanism, 10)
    assert len(pincal.sample_workspace(mechanism, 10, least=pincal.Margins.none())) == 10


def test_orbits_are_as_good_as_all_legs_together() -> None:
    """The bound of orbits is that of common poses: averaging a design over the group loses nothing.

    log det is concave, and the group turns each leg's information into another's.
    """
    from pincal.design.optimal import continuous_design
    from pincal.kinematics.batches import block_diagonal

    mechanism = pincal.load_mechanism("3RRR")
    elements = smallest(selection_group(mechanism))
    poses = workspace("3RRR", 150)
    found, _ = orbit_of(elements, mechanism.platform.matrices(poses))
    names = mechanism.leg_names
    search = Search(mechanism, poses, 1)
    every = block_diagonal(list(search.rows(found.reshape(1, -1, 4, 4), names)))
    (orbits,) = search.rows(found, ("leg_1",))
    common = continuous_design((every,)).bound / len(mechanism.legs)
    own = continuous_design((orbits,)).bound - orbits.shape[2] * np.log(len(elements))
    assert own == pytest.approx(common, abs=2e-2)
    assert indices(orbits.reshape(-1, 8)).O1 > 0.0


def test_shuffled_copies_are_chosen_once() -> None:
    """Forty poses, four hundred times each in any order: a plan without repetition."""
    mechanism = pincal.load_mechanism("3RRR")
    poses = np.tile(workspace("3RRR", 40), (400, 1))
    offered = poses[np.random.default_rng(0).permutation(len(poses))]
    for protocol in ("independent", "orbits"):
        plan = pincal.select_poses(mechanism, offered, 10, protocol).plan
        sets = np.array(plan.sets)
        for name in set(plan.sets):
            own = plan.poses[sets == name]
            assert len(np.unique(own.round(9), axis=0)) == len(own)


def test_copies_count_once_however_many() -> None:
    """20,000 copies of a pose that differ by rounding, between others, are one pose."""
    mechanism = pincal.load_mechanism("3RRR")
    poses = pincal.sample_workspace(mechanism, 20, seed=0)
    noise = 1e-14 * np.random.default_rng(0).standard_normal((20_000, 3))
    every = np.concatenate((poses[:10], poses[5] + noise, poses[10:]))
    expected = [*range(10), *range(20_010, 20_020)]
    np.testing.assert_array_equal(distinct(mechanism.platform, every), expected)


def test_a_pose_that_legs_share_is_driven_to_once() -> None:
    """Three legs of twelve poses each: one row of the plan for all legs that need the pose."""
    poses = workspace("3RRR", 60)
    selection = pincal.select(
        "3RRR", candidates=poses, protocol="independent", count=12, reference=0
    )
    plan = selection.plan
    assert len(np.unique(plan.poses.round(9), axis=0)) == len(plan) == selection.count < 36
    assert [plan.serves(leg).sum() for leg in ("leg_1", "leg_2", "leg_3")] == [12, 12, 12]


def test_no_candidates_are_refused() -> None:
    """By every protocol, with how many are reached."""
    for protocol in ("symmetric", "independent", "orbits", "common"):
        with pytest.raises(pincal.ObservabilityError, match="reaches 0 of 0"):
            pincal.select_poses("3RRR", np.zeros((0, 3)), 10, protocol)
