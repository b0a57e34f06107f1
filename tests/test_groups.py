"""What is detected is a group: closed, wherever frames stand; regions do not depend on it."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import count, product

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from marks import quick, slow_or_fuzz
from measured import computed_everywhere, workspace
from moved import box, cable_box, constants, equivariance, moved, random_motion
from scipy.spatial.transform import Rotation

import pincal
from pincal import Element, Placement, indices
from pincal.model.placement import floats, placement_of
from pincal.symmetry.carry import carry
from pincal.symmetry.elements import (
    exact,
    group_name,
    isometry,
    largest_closed,
    product_table,
    same,
    subgroups,
)

NONE = pincal.Margins.none()
#: Grids that are coarse, and hold part of the workspace.
GRIDS = {
    "5R": ("x=-1.2:1.2:0.15", "y=0.02:1.82:0.15"),  # no position at a limit to rounding
    "3RRR": ("radius=0.02:0.8:0.1", "bearing [deg]=0:330:30"),
    "3RPR": ("radius=0.02:0.8:0.1", "bearing [deg]=0:330:30"),
    "3PRR": ("radius=0.02:0.8:0.1", "bearing [deg]=0:330:30"),
    "6UPS": ("radius=0.05:1.2:0.2", "bearing [deg]=0:330:30", "z=1.5:2.3:0.2"),
    "delta": ("radius=0.02:0.5:0.05", "bearing [deg]=0:330:30", "z=-0.8:-0.1:0.1"),
    "linear_delta": ("radius=0.02:0.3:0.03", "bearing [deg]=0:330:30", "z=0:0.5:0.1"),
    "3PUU": ("radius=0.02:0.3:0.03", "bearing [deg]=0:330:30", "z=-0.2:0.3:0.1"),
    "6RUS": ("radius=0.02:0.3:0.05", "bearing [deg]=0:330:30", "z=0.35:0.65:0.05"),
    "6PUS": ("radius=0.02:0.4:0.05", "bearing [deg]=0:330:30", "z=0.6:1.3:0.1"),
    "six_rod_delta": ("radius=0.02:0.4:0.05", "bearing [deg]=0:330:30", "z=-0.8:-0.3:0.1"),
    "4cable": ("x=-2:2:0.25", "y=-2:2:0.25"),
    "8cable": ("x=-1:1:0.25", "y=-1:1:0.25", "z=1:2.6:0.2"),
    "box": ("x=-2:2:0.5", "y=-2:2:0.5", "z=-1.2:1.2:0.4"),
}


def is_group(group: pincal.symmetry.detect.SymmetryGroup) -> bool:
    """Return whether products and inverses of a group's elements, and their legs, are in it."""
    elements, permutations = group.elements, group.permutations
    inside = all(any(e.inverse().equals(g) for g in elements) for e in elements)
    for (a, first), (b, second) in product(zip(elements, permutations, strict=True), repeat=2):
        both = a.after(b)
        same = [i for i, e in enumerate(elements) if e.equals(both)]
        wanted = tuple(first[j] for j in second)
        inside &= len(same) == 1 and permutations[same[0]] == wanted
    return inside


def changed(name: str, how: str, seed: int) -> pincal.Mechanism:
    """Return a bundled mechanism disturbed, rounded, mirrored, moved, tilted, or all of it."""
    mechanism, rng = pincal.load_mechanism(name), np.random.default_rng(seed)
    if how in ("disturbed", "all"):
        mechanism = pincal.disturb(mechanism, 10.0 ** rng.uniform(-13, -2), seed=seed)
    if how in ("mirrored", "all"):
        turn = Element.mirror(rng.uniform(-3.0, 3.0))
        legs = tuple(carry(leg, turn) for leg in mechanism.legs)
        home = turn.poses(mechanism.platform, np.array([mechanism.platform.home]))[0]
        platform = pincal.Platform(mechanism.platform.kind, tuple(home.tolist()))
        mechanism = replace(mechanism, legs=legs, platform=platform)
    if how in ("rounded", "all"):
        digits = int(rng.integers(3, 13))
        values = {
            leg.name: {n: round(v, digits) for n, v in leg.nominal_by_name.items()}
            for leg in mechanism.legs
        }
        mechanism = mechanism.with_parameters(values)
    if how in ("moved", "tilted", "all"):
        scale = {"moved": 1e-3, "tilted": 0.0, "all": 0.0}[how]
        mechanism = moved(mechanism, *random_motion(mechanism.platform, rng, scale))
    return mechanism


def check(name: str, how: str, seed: int) -> None:
    """Assert that groups are closed, and a region is the same without symmetry."""
    mechanism = changed(name, how, seed)
    rng = np.random.default_rng(seed)
    for _ in range(2):
        tolerance = 10.0 ** rng.uniform(-12, -1)
        assert is_group(pincal.symmetry_group(mechanism, tolerance))
    grid = pincal.Grid.of(*GRIDS[name])
    region = pincal.compute_workspace(mechanism, "constant-orientation", grid, None, NONE)
    np.testing.assert_array_equal(region.inside, computed_everywhere(region))


CHANGED = ("5R", "3RRR", "3RPR", "3PRR", "6UPS", "delta", "linear_delta")
HOW = ("disturbed", "rounded", "mirrored", "moved", "tilted", "all")
CASES = (st.sampled_from(CHANGED), st.sampled_from(HOW), st.integers(0, 10**6))


@pytest.mark.slow
@settings(max_examples=5, deadline=None)
@given(*CASES)
@example("6UPS", "disturbed", 202)  # platform and base are turned by 1e-9 from each other
def test_groups_are_closed_and_regions_need_no_symmetry(name: str, how: str, seed: int) -> None:
    """Of machines that are nearly symmetric, the group is one, and the region is that of all."""
    check(name, how, seed)


@pytest.mark.slow
@settings(max_examples=25, deadline=None)
@given(*CASES)
def test_many_groups_are_closed(name: str, how: str, seed: int) -> None:
    """The same of 25 machines."""
    check(name, how, seed)


@pytest.mark.fuzz
@settings(max_examples=1000, deadline=None)
@given(*CASES)
def test_a_thousand_groups_are_closed(name: str, how: str, seed: int) -> None:
    """The same of 1,000 machines."""
    check(name, how, seed)


def rounded(name: str, digits: int) -> pincal.Mechanism:
    """Return a bundled mechanism whose parameters are rounded."""
    mechanism = pincal.load_mechanism(name)
    values = {
        leg.name: {n: round(v, digits) for n, v in leg.nominal_by_name.items()}
        for leg in mechanism.legs
    }
    return mechanism.with_parameters(values)


@pytest.mark.parametrize(("name", "cells"), [("3RRR", 2754), ("3RPR", 2877), ("3PRR", 2775)])
def test_rounded_parameters_lose_no_cells(name: str, cells: int) -> None:
    """Parameters rounded to 9 decimals: version 0.1 lost a third of the cells without a word."""
    grid = pincal.Grid.of("radius=0.01:0.8:0.02", "bearing=0:6.2308254:0.05235987755982989")
    found = pincal.compute_workspace(rounded(name, 9), "constant-orientation", grid)
    assert found.count == cells
    if name == "3RRR":
        assert found.measure == pytest.approx(0.681, abs=5e-4)


@pytest.mark.parametrize("digits", [10, 5])
def test_regions_of_rounded_parameters_keep_their_symmetry(digits: int) -> None:
    """A delta's six elements are used, and no cell is other than without them."""
    grid = pincal.Grid.of("radius=0.02:0.6:0.04", "bearing [deg]=-180:174:6", "z=-1.1:-0.6:0.1")
    delta = rounded("delta", digits)
    used = pincal.compute_workspace(delta, "constant-orientation", grid)
    np.testing.assert_array_equal(used.inside, computed_everywhere(used))
    assert len(used.elements) == 6
    assert used.computed < 0.4 * grid.size


@pytest.mark.slow
def test_rounded_hexapod_and_disturbed_deltas_have_groups() -> None:
    """Groups of order 1, 2, 3 or 6, never 4 or 5."""
    assert pincal.symmetry_group(rounded("6UPS", 6)).name == "D6"
    for seed in range(40):
        delta = pincal.disturb(pincal.load_mechanism("delta"), 1e-4, seed=seed)
        group = pincal.symmetry_group(delta, 5e-4)
        assert len(group.elements) in (1, 2, 3, 6)
        assert is_group(group)


@pytest.mark.parametrize("digits", quick(1, [6, 5]))
def test_parameters_written_with_few_digits_have_their_group(digits: int) -> None:
    """Of so many digits each: D6, and poses of one leg serve all; a length off by 1e-3 is told."""
    mechanism = pincal.load_mechanism("6UPS")
    written = mechanism.with_parameters(
        {
            leg.name: {n: float(f"{v:.{digits}g}") for n, v in leg.nominal_by_name.items()}
            for leg in mechanism.legs
        }
    )
    assert pincal.symmetry_group(written).name == "D6"
    poses = pincal.sample_workspace(written, 60, seed=0)
    for protocol in ("symmetric", "orbits"):
        assert len(pincal.select_poses(written, poses, 12, protocol, starts=1).plan)
    off = written.with_parameters({"leg_2": {"OA": written.legs[1].nominal_by_name["OA"] + 1e-3}})
    assert pincal.symmetry_group(off).name == "C1"


def box_poses() -> np.ndarray:
    """Return poses near the middle of the box."""
    return np.random.default_rng(0).uniform(-1.0, 1.0, (60, 6)) * [1, 1, 0.5, 3, 0.1, 0.1] + [
        0,
        0,
        0,
        0,
        0.1,
        0,
    ]


@pytest.mark.parametrize(
    "name", quick(2, ["3RRR", "linear_delta", "4cable", "6UPS", "5R", "delta", "box"])
)
def test_frames_may_stand_anywhere(name: str) -> None:
    """Base and platform frame moved at random: the same group, readings and O₁ at mapped poses."""
    mechanism = cable_box() if name == "box" else pincal.load_mechanism(name)
    own = pincal.symmetry_group(mechanism)
    poses = workspace(name, 60) if name != "box" else box_poses()
    matrices = mechanism.platform.transforms(poses).as_matrix()
    for seed in range(3):
        base, platform = random_motion(mechanism.platform, np.random.default_rng(seed))
        away = moved(mechanism, base, platform)
        group = pincal.symmetry_group(away)
        assert (group.name, len(group.elements)) == (own.name, len(own.elements))
        assert is_group(group)
        there = away.platform.from_matrices(base @ matrices @ np.linalg.inv(platform))
        assert equivariance(group, there) < 1e-11
        for element, permutation in zip(group.elements, group.permutations, strict=True):
            carried = element.poses(away.platform, there)
            for leg, index in zip(away.legs, permutation, strict=True):
                to = away.leg_names[index]
                O1 = [
                    indices(pincal.identification_jacobian(away, who, where)).O1
                    for who, where in ((leg.name, there), (to, carried))
                ]
                assert O1[1] == pytest.approx(O1[0], rel=1e-9)


def test_a_hexapod_aside_tilted_or_on_a_wall() -> None:
    """0.1 m aside, 5° tilted, on a wall: all six elements, about the axis as it stands."""
    hexapod = pincal.load_mechanism("6UPS")
    for turn, shift in (
        ([0, 0, 0], [0.1, 0, 0]),
        ([0.0873, 0, 0], [0, 0, 0]),
        ([0, 1.5708, 0], [0, 0, 1]),
    ):
        motion = np.eye(4)
        motion[:3, :3], motion[:3, 3] = Rotation.from_rotvec(turn).as_matrix(), shift
        group = pincal.symmetry_group(moved(hexapod, motion, np.eye(4)))
        assert group.name == "D6"
        assert group.leg_orbits == (hexapod.leg_names,)
    aside = pincal.symmetry_group(moved(hexapod, np.eye(4), motion)).elements[1]
    assert same(aside.base, Element(2 * np.pi / 3).base)
    assert not same(aside.platform, aside.base)


def test_a_five_bar_drawn_from_its_first_joint() -> None:
    """A frame that stands at A₁: the mirror is where it is."""
    motion = np.eye(4)
    motion[0, 3] = 0.5
    group = pincal.symmetry_group(moved(pincal.load_mechanism("5R"), motion, np.eye(4)))
    assert [str(e) for e in group.elements] == ["identity", "mirror at azimuth 90°"]
    np.testing.assert_allclose(group.elements[1].base[:3, 3], [1.0, 0.0, 0.0], atol=1e-15)


def test_a_cable_box_has_all_eight_elements() -> None:
    """Half turns about three axes, three mirrors, the inversion; each keeps a region."""
    mechanism = cable_box()
    group = pincal.symmetry_group(mechanism)
    names = {str(e) for e in group.elements}
    assert group.name == "4 rotations and 4 reflections"
    assert {"inversion", "mirror across z", "rotation by 180° about azimuth 0°"} <= names
    assert len(group.subgroups()) == 16
    grid = pincal.Grid.of("x=-2:2:0.5", "y=-2:2:0.5", "z=-1.2:1.2:0.4")
    short = pincal.compute_workspace(mechanism, "reachable", grid, None, NONE)
    np.testing.assert_array_equal(short.inside, computed_everywhere(short))
    assert 0 < short.count < grid.size
    assert len(short.elements) == 8
    assert short.computed < 0.25 * grid.size


@pytest.mark.parametrize(
    ("elements", "name", "count"),
    [
        (pincal.cyclic(5), "C5", 2),
        (pincal.dihedral(3), "D6", 6),
        (pincal.dihedral(1), "D2", 2),
        (box(), "4 rotations and 4 reflections", 16),
        (pincal.dihedral(4, 0.3), "D8", 10),
    ],
    ids=lambda value: value if isinstance(value, str) else None,
)
def test_tables_and_subgroups(elements: tuple[Element, ...], name: str, count: int) -> None:
    """Products are those of the isometries, each row a permutation; subgroups divide the order."""
    table = product_table(elements)
    assert group_name(elements) == name
    for a, b in product(range(len(elements)), repeat=2):
        assert elements[a].after(elements[b]).equals(elements[int(table[a, b])])
    assert (np.sort(table, axis=1) == np.arange(len(elements))).all()
    found = subgroups(table)
    assert len(found) == count
    assert all(len(elements) % len(one) == 0 for one in found)


def test_the_largest_closed_subset() -> None:
    """Without a rotation by 120° the others are no group; the mirror and the identity are."""
    elements = [e for i, e in enumerate(pincal.dihedral(3)) if i != 1]
    kept = [elements[i] for i in largest_closed(product_table(elements))]
    assert len(kept) == 2
    assert kept[0].is_identity
    assert kept[1].reflection


def test_averaging_makes_a_group_exact() -> None:
    """Rotations off by 1e-3, about a centre aside, become a group to 1e-14."""
    rng, centre = np.random.default_rng(0), np.array([0.3, -0.2, 1.0])
    rough = []
    for i, element in enumerate(pincal.dihedral(5)):
        off = Rotation.from_rotvec(1e-3 * (i > 0) * rng.normal(size=3)).as_matrix()
        Q = off @ element.matrix
        one = isometry(Q, centre - Q @ centre)
        rough.append(Element.of(one, one))
    found = exact(rough, (centre, centre), 1.0)
    for a, b in product(found, repeat=2):
        both = a.after(b)
        assert min(np.abs(both.base - e.base).max() for e in found) < 1e-14


def test_an_element_reflects_both_or_none() -> None:
    """A mirror of the base alone would carry poses to what is no pose."""
    mirror = Element.mirror(0.0).base
    with pytest.raises(pincal.SymmetryError, match="only one of the two isometries"):
        Element.of(mirror, np.eye(4))


def redrawn(leg: pincal.Leg, rng: np.random.Generator, plane: bool) -> pincal.Leg:
    """Return the same leg with random frames of its joints, axes, and zeros of passive joints.

    Parameters keep their meaning: constant turns and shifts stand before and after them.
    """
    joints, turns, values = list[pincal.Joint](), list[np.ndarray](), leg.nominal_by_name
    sensed, about = {sensor.joint for sensor in leg.sensors}, [0, 0, 1] if plane else [1, 1, 1]
    for joint, carrier in zip(leg.joints, leg.carriers, strict=True):
        axis, turn, zero, shift = np.array(joint.axis), np.eye(4), np.eye(4), 0.0
        if joint.kind != "fixed":
            R = Rotation.from_rotvec(rng.uniform(-3.0, 3.0, 3) * about).as_matrix()
            if not plane and rng.random() < 0.5:  # along x, y or z of its own frame
                along = rng.choice([-1.0, 1.0]) * np.eye(3)[rng.integers(3)]
                R = Rotation.align_vectors(axis[None], along[None])[0].as_matrix()
            turn[:3, :3], turned = R, R.T @ axis
            if not plane or not joint.turns:
                turn[:3, 3] = rng.uniform(-0.5, 0.5) * axis
            axis, shift = turned, rng.uniform(-1.0, 1.0) * (joint.name not in sensed)
        if joint.turns:
            zero[:3, :3] = Rotation.from_rotvec(shift * axis).as_matrix()
        else:
            zero[:3, 3] = shift * axis
        parent = np.linalg.inv(turns[carrier]) if carrier >= 0 else np.eye(4)
        rest = joint.placement.rest(values, leg.name) @ turn @ zero
        placement = Placement((*constants(parent), *joint.placement.coordinates)).at(values, rest)
        limits = {end: getattr(joint, end) - shift for end in ("lower", "upper", "home")}
        axes = {"axis": tuple((axis + 0.0).tolist()), "placement": placement}
        joints.append(replace(joint, **axes, **limits))
        turns.append(turn)
    return replace(leg, joints=tuple(joints))


def written(leg: pincal.Leg, digits: int) -> pincal.Leg:
    """Return a leg without parameters of its joints, whose frames have so many decimals."""
    values, joints, point = leg.nominal_by_name, list[pincal.Joint](), leg.point.placement
    for joint in leg.joints:
        rest = joint.placement.rest(values, leg.name)
        drawn = placement_of(joint.placement.displacement(values) @ rest)
        xyz, rpy = (floats(np.round(triple, digits)) for triple in (drawn.xyz, drawn.rpy))
        axis = np.round(joint.axis, digits)
        axes = {"axis": floats(axis / np.linalg.norm(axis)), "home": round(joint.home, digits)}
        joints.append(replace(joint, placement=Placement((), xyz, rpy), **axes))
    used = {
        *point.parameter_units,
        *(s.gain for s in leg.sensors),
        *(s.offset for s in leg.sensors),
    }
    parameters = tuple(pair for pair in leg.parameters if pair[0] in used)
    return replace(leg, joints=tuple(joints), parameters=parameters)


@pytest.mark.parametrize("digits", [12, 9])
def test_struts_drawn_with_some_digits_have_their_group(digits: int) -> None:
    """Of 12 decimals one of six struts pointed along a slide within rounding, and none was D6."""
    plain, rng = plainly("6UPS"), np.random.default_rng(0)
    legs = [written(redrawn(leg, rng, plane=False), digits) for leg in plain.legs]
    assert pincal.symmetry_group(replace(plain, legs=tuple(legs))).name == "D6"


@cache
def region_of(name: str) -> pincal.Workspace:
    """Return a region of a machine drawn plainly."""
    return pincal.compute_workspace(
        plainly(name), "constant-orientation", pincal.Grid.of(*GRIDS[name]), None, NONE
    )


@cache
def plainly(name: str) -> pincal.Mechanism:
    """Return a machine without its load and the tensions of its cables, as it is drawn plainly."""
    plain = cable_box() if name == "box" else pincal.load_mechanism(name)
    return replace(plain, load=None, cables=None)


@cache
def poses_of(name: str) -> np.ndarray:
    """Return poses that a machine reaches."""
    if plainly(name).by_readings:
        return pincal.sample_configurations(plainly(name), 60, 0).poses
    return box_poses() if name == "box" else workspace(name, 60)


DRAWN = (*GRIDS, "3RPS")


@pytest.mark.parametrize(
    ("name", "seed"),
    [("3PUU", 6), ("5R", 7), *slow_or_fuzz(zip(DRAWN, count()), product(DRAWN, range(20, 54)))],
)
def test_random_drawings_change_nothing(name: str, seed: int) -> None:
    """Random frames of base, platform and joints: the same group, derivatives, O₁ and region."""
    plain, rng = plainly(name), np.random.default_rng(seed)
    legs = tuple(redrawn(leg, rng, plain.platform.space == 2) for leg in plain.legs)
    drawn = replace(plain, legs=legs)
    base, platform = random_motion(drawn.platform, rng)
    away, expected = moved(drawn, base, platform), pincal.symmetry_group(plain)
    group = pincal.symmetry_group(away)
    assert (group.name, sorted(group.permutations)) == (
        expected.name,
        sorted(expected.permutations),
    )
    poses, matrices = poses_of(name), plain.platform.matrices(poses_of(name))
    mapped = away.platform.from_matrices(base @ matrices @ np.linalg.inv(platform))
    for leg in plain.leg_names:
        C = pincal.identification_jacobian(plain, leg, poses)
        same_C = pincal.identification_jacobian(away, leg, mapped)
        np.testing.assert_allclose(same_C, C, atol=1e-9 * np.abs(C).max())
        if np.linalg.matrix_rank(C) == C.shape[1]:  # or else O₁ is 0 to rounding
            assert np.isclose(indices(same_C).O1, indices(C).O1, rtol=1e-9, atol=0.0)
    if plain.by_readings:
        return
    assert equivariance(group, mapped) < 1e-9
    region, grid = region_of(name), pincal.Grid.of(*GRIDS[name])
    redrawn_region = pincal.compute_workspace(drawn, region.kind, grid, None, NONE)
    np.testing.assert_array_equal(redrawn_region.inside, region.inside)
    assert redrawn_region.computed == region.computed  # by as much symmetry
    homes = np.tile(plain.platform.home_pose.as_matrix(), (grid.size, 1, 1))
    homes[:, :3, 3] = grid.at(np.arange(grid.size))
    positions = (base @ homes @ np.linalg.inv(platform))[:, :3, 3]
    at_home = pincal.compute_workspace(away, region.kind, pincal.Grid.of("x=0", "y=0"), None, NONE)
    np.testing.assert_array_equal(at_home.test(positions), region.inside)
