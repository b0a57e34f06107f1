"""Workspaces of every kind: the papers' figures, symmetry against brute force, bad input."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from marks import quick, some_slow
from measured import computed_everywhere, workspace
from scipy.spatial.transform import Rotation

import pincal
from pincal.kinematics.closing import close_legs
from pincal.kinematics.closure import nominal_legs
from pincal.workspace.criteria import Criteria, in_workspace
from pincal.workspace.grid import Axis, default_grid
from studies.inscribed import largest_circle

NONE = pincal.Margins.none()
BUNDLED = ["5R", "3RRR", "6UPS"]
KINDS = ["reachable", "constant-orientation", "total-orientation"]
TILTS = ["azimuth [deg]=-170:180:10", "tilt=0:0.6:0.1", "torsion=-0.6:0.6:0.1"]
POLAR = {
    "5R": ("radius=0.05:2:0.05", "bearing [deg]=0:360:5"),
    "3RRR": ("radius=0.02:0.8:0.04", "bearing [deg]=0:360:7.5"),
    "6UPS": ("radius=0.1:1.5:0.2", "bearing [deg]=0:360:10", "z=1.4:2.4:0.2"),
}
CARTESIAN = {
    "5R": ("x=-1.5:1.5:0.05", "y=0:2:0.05"),
    "3RRR": ("x=-0.8:0.8:0.05", "y=-0.8:0.8:0.05"),
    "6UPS": ("x=-1.5:1.5:0.25", "y=-1.5:1.5:0.25", "z=1.4:2.4:0.25"),
}
REACH = {
    "5R": ([-1.5, -1.5], [1.5, 2.0]),
    "3RRR": ([-0.9, -0.9, -1.0], [0.9, 0.9, 1.0]),
    "6UPS": ([-1.5, -1.5, -2.5, -3, 0, -1], [1.5, 1.5, 2.5, 3, 1, 1]),
}
TURNS = {"5R": [], "3RRR": ["phi=-0.2:0.2:0.1"], "6UPS": ["tilt=0:0.3:0.15", "torsion=-0.2,0,0.2"]}


@pytest.fixture(params=BUNDLED)
def any_mechanism(request: pytest.FixtureRequest) -> pincal.Mechanism:
    """Every bundled mechanism."""
    return pincal.load_mechanism(request.param)


@pytest.fixture(scope="module")
def hexapod() -> pincal.Mechanism:
    """The 6-UPS."""
    return pincal.load_mechanism("6UPS")


@pytest.fixture(scope="module")
def notes() -> pincal.Grid:
    """The slice at z = 1.8 on which the paper's figures were checked."""
    return pincal.Grid.of("x=-1.5:1.5:0.02", "y=-1.5:1.5:0.02", "z=1.8")


def brute_force(
    hexapod: pincal.Mechanism, positions: np.ndarray, rotations: Rotation
) -> np.ndarray:
    """Return which positions have all leg lengths in 1.6 to 2.6 m, by |r + R b − A|."""
    base = np.array([leg.joints[0].placement.xyz for leg in hexapod.legs])
    arms = rotations.as_matrix() @ np.array([leg.point.placement.xyz for leg in hexapod.legs]).T
    inside = []
    for position in positions:
        lengths = np.linalg.norm(position + arms.transpose(0, 2, 1) - base, axis=2)
        inside.append(((lengths >= 1.6) & (lengths <= 2.6)).all())
    return np.array(inside)


@pytest.mark.slow
def test_total_orientation_with_tilt_and_torsion(
    hexapod: pincal.Mechanism, notes: pincal.Grid
) -> None:
    """14,477 cells as published, every one of which stays inside under the whole group.

    By every seventh cell, which is also 61 of the 427 along the rim: were 0.25 % of the cells to
    leave, none of these 2,069 would with a chance of 0.6 %; of Euler angles 9 % leave.
    """
    turns = pincal.Orientations.of(hexapod.platform, *TILTS)
    found = pincal.compute_workspace(hexapod, "total-orientation", notes, turns, NONE)
    assert found.count == 14_477
    assert found.measure == pytest.approx(5.791, abs=5e-4)
    assert found.computed == 151 * 76  # y → −y maps the square grid onto itself
    group = pincal.symmetry_group(hexapod).elements
    assert len(group) == 6
    for element in group:
        assert found.test(found.positions[::7] @ element.matrix.T).all()


@pytest.mark.slow
def test_total_orientation_with_zyx_angles(hexapod: pincal.Mechanism, notes: pincal.Grid) -> None:
    """4.923 m² as published; y → −y survives, 9 % of the cells leave under 120°."""
    axes = [f"{name}=-0.6:0.6:0.1" for name in ("yaw", "pitch", "roll")]
    turns = pincal.Orientations.of(hexapod.platform, *axes)
    found = pincal.compute_workspace(hexapod, "total-orientation", notes, turns, NONE)
    assert found.measure == pytest.approx(4.923, abs=5e-4)
    assert [str(e) for e in found.elements] == ["identity", "mirror at azimuth 0°"]
    turned = found.positions @ pincal.Element(2 * np.pi / 3).matrix.T
    assert 1 - found.test(turned).mean() == pytest.approx(0.09, abs=0.005)


def test_total_orientation_equals_brute_force(hexapod: pincal.Mechanism) -> None:
    """The same positions as by leg lengths of every pose, at random positions."""
    positions = np.random.default_rng(0).uniform([-1.5, -1.5, 1.2], [1.5, 1.5, 2.6], (400, 3))
    turns = pincal.Orientations.of(hexapod.platform, *TILTS)
    grid = pincal.Grid.of("x=0,1", "y=0,1", "z=1.8")
    test = pincal.compute_workspace(hexapod, "total-orientation", grid, turns, NONE).test
    expected = brute_force(hexapod, positions, turns.rotations)
    assert 20 < expected.sum() < 380
    np.testing.assert_array_equal(test(positions), expected)


SLOWEST = [
    *(("6UPS", None, "reachable", grid) for grid in ("polar", "cartesian")),
    ("6UPS", None, "total-orientation", "polar"),
]


@pytest.mark.parametrize(
    ("any_mechanism", "margins", "kind", "grid"),
    some_slow(product(BUNDLED, [NONE, None], KINDS, ["polar", "cartesian"]), *SLOWEST),
    ids=lambda value: "free" if value is NONE else None,
    indirect=["any_mechanism"],
)
def test_symmetry_changes_nothing_but_the_work(
    any_mechanism: pincal.Mechanism, grid: str, kind: str, margins: pincal.Margins | None
) -> None:
    """A fundamental domain gives the very set that computing all positions gives."""
    name, platform = any_mechanism.name, any_mechanism.platform
    asked = pincal.Grid.of(*(POLAR if grid == "polar" else CARTESIAN)[name])
    turns = pincal.Orientations.of(platform, *TURNS[name]) if TURNS[name] else None
    given = None if kind == "constant-orientation" else turns
    arguments = (any_mechanism, kind, asked, given, margins)
    short = pincal.compute_workspace(*arguments)
    np.testing.assert_array_equal(short.inside, computed_everywhere(short))
    assert 0 < short.count < asked.size
    order = len(pincal.symmetry_group(any_mechanism).elements)
    if grid != "cartesian":
        assert len(short.elements) == order
    assert short.computed <= 0.6 * asked.size or (grid, name) == ("cartesian", "3RRR")


def test_group_of_the_set_not_of_the_mechanism_is_used(hexapod: pincal.Mechanism) -> None:
    """Elements that do not map grid or orientations onto themselves are left out."""
    grid = pincal.Grid.of(*POLAR["6UPS"])
    one_sided = pincal.Orientations.of(hexapod.platform, "tilt=0:0.3:0.1", "torsion=0,0.2")
    found = pincal.compute_workspace(hexapod, "total-orientation", grid, one_sided, NONE)
    assert [e.reflection for e in found.elements] == [False] * 3
    slanted = pincal.Orientations.from_rotations(Rotation.from_rotvec([0.2, 0.1, 0.0]))
    found = pincal.compute_workspace(hexapod, "constant-orientation", grid, slanted, NONE)
    assert len(found.elements) == 1
    partial = pincal.Grid.of("radius=0.1:1.5:0.2", "bearing [deg]=-40:40:10", "z=1.8")
    found = pincal.compute_workspace(hexapod, "constant-orientation", partial, None, NONE)
    assert [str(e) for e in found.elements] == ["identity", "mirror at azimuth 0°"]


def test_square_grid_follows_quarter_turns() -> None:
    """Four legs a quarter turn apart map a square grid onto itself, x and y changing places."""
    leg = pincal.load_mechanism("3RRR").legs[0]
    platform = pincal.Platform("planar", (0.0, 0.0, 0.0))
    mechanism = pincal.generate("4RRR", leg, pincal.cyclic(4), platform)
    grid = pincal.Grid.of("x=-0.6:0.6:0.05", "y=-0.6:0.6:0.05")
    short = pincal.compute_workspace(mechanism, "constant-orientation", grid)
    np.testing.assert_array_equal(short.inside, computed_everywhere(short))
    assert 0 < short.count < grid.size
    assert len(short.elements) == 4
    assert short.computed == 12 * 13 + 1


def by_closing(criteria: Criteria, matrices: np.ndarray) -> np.ndarray:
    """Return which poses count, by closing every leg at every pose."""
    return criteria._counted(close_legs(nominal_legs(criteria.mechanism), matrices))


@pytest.mark.parametrize("margin", [0.0, 0.3])
def test_closed_form_of_reach_equals_the_closed_loops(
    any_mechanism: pincal.Mechanism, margin: float
) -> None:
    """Shells and half-spaces say what closing every leg says, on disturbed geometries."""
    rng = np.random.default_rng(1)
    for seed in range(5):
        mechanism = pincal.disturb(any_mechanism, 0.05, seed=seed)
        criteria = Criteria(mechanism, pincal.Margins(margin, -np.inf))
        poses = rng.uniform(*REACH[any_mechanism.name], (4000, mechanism.platform.dof))
        matrices = mechanism.platform.transforms(poses).as_matrix()
        closed = by_closing(criteria, matrices)
        assert 20 < closed.sum() < 3980
        np.testing.assert_array_equal(criteria(matrices), closed)


@pytest.mark.parametrize(
    "limits", [(-np.pi / 2, np.pi / 2), (-0.3, 0.4), (-0.5, 3.1), (-np.inf, np.inf)]
)
@pytest.mark.parametrize("joint", quick(1, [1, 0]))
@pytest.mark.parametrize("tilt", quick(1, [0.4, 0.0]))
def test_turns_of_a_universal_joint_are_limited_alike(
    hexapod: pincal.Mechanism, joint: int, limits: tuple[float, float], tilt: float
) -> None:
    """Half-spaces, or where they do not suffice closing the legs, keep the turns' limits.

    Also where struts are mounted at an angle to the second axis' zero.
    """
    legs = []
    for leg in hexapod.legs:
        joints = list(leg.joints)
        _, second, slide = (leg.joints.index(one) for one in leg.moving)
        joints[slide] = replace(joints[slide], placement=pincal.Placement(rpy=(0.0, tilt, 0.0)))
        joints[second] = replace(joints[second], home=joints[second].home - tilt)
        place = leg.joints.index(leg.moving[joint])
        low, high = (limit - tilt * joint for limit in limits)
        joints[place] = replace(joints[place], lower=low, upper=high)
        legs.append(replace(leg, joints=tuple(joints)))
    mechanism = replace(hexapod, legs=tuple(legs))
    criteria = Criteria(mechanism, NONE)
    rng = np.random.default_rng(0)
    poses = rng.uniform([-2, -2, -2.5, -3, 0, -1], [2, 2, 2.5, 3, 1, 1], (20_000, 6))
    matrices = mechanism.platform.transforms(poses).as_matrix()
    expected = by_closing(criteria, matrices)
    assert expected.any()
    np.testing.assert_array_equal(criteria(matrices), expected)


def test_kinds_contain_each_other(hexapod: pincal.Mechanism) -> None:
    """Total orientation ⊂ constant orientation ⊂ reachable, each strictly here."""
    grid = pincal.Grid.of(*POLAR["6UPS"])
    turns = pincal.Orientations.of(hexapod.platform, "tilt=0:0.3:0.15")
    every = pincal.compute_workspace(hexapod, "total-orientation", grid, turns)
    one = pincal.compute_workspace(hexapod, "constant-orientation", grid)
    some = pincal.compute_workspace(hexapod, "reachable", grid, turns)
    assert (every.inside <= one.inside).all()
    assert (one.inside <= some.inside).all()
    assert every.count < one.count < some.count


def test_dexterous_asks_all_round() -> None:
    """Short legs around a large base turn no platform round; a point needs no turn."""
    grid = pincal.Grid.of(*POLAR["3RRR"])
    found = pincal.compute_workspace(pincal.load_mechanism("3RRR"), "dexterous", grid)
    assert len(found.test.orientations) == 72
    assert found.count == 0
    assert found.uncertainty > 0.0  # less than a cell may have been missed
    grid = pincal.Grid.of(*CARTESIAN["5R"])
    five_bar = pincal.load_mechanism("5R")
    point = pincal.compute_workspace(five_bar, "dexterous", grid)
    assert point.count == pincal.compute_workspace(five_bar, "reachable", grid).count > 0


def test_largest_circle_of_the_five_bar() -> None:
    """The papers' maximal inscribed workspace: radius 0.647 m around (0, 1.095) m."""
    mechanism = pincal.load_mechanism("5R")
    grid = pincal.Grid.of("x=-1.5:1.5:0.03", "y=-0.8:2:0.03")
    found = pincal.compute_workspace(mechanism, "reachable", grid, None, pincal.Margins(0.0, 0.0))
    circle = largest_circle(found)
    assert circle.radius == pytest.approx(0.647, abs=0.003)
    assert circle.centre[1] == pytest.approx(1.095, abs=0.005)
    assert abs(circle.centre[0]) < 1e-3
    ring = np.linspace(0, 2 * np.pi, 720)[:, None]
    ring = np.concatenate((np.cos(ring), np.sin(ring), np.zeros_like(ring)), axis=1)
    assert found.test(circle.centre + (circle.radius - 1e-4) * ring).all()
    assert not found.test(circle.centre + (circle.radius + 1e-3) * ring).all()


@pytest.mark.slow
def test_largest_circle_in_a_ring() -> None:
    """Many equally good centres: half the width of the ring, to a millimetre."""
    leg = mirrored().legs[0].with_parameters({"A_x": 0.0, "l": 0.5, "L": 1.2})
    elements = (pincal.Element(0.0), pincal.Element.mirror(np.pi / 2))
    mechanism = pincal.generate("coaxial", leg, elements, pincal.Platform("point", (0.0, 1.1)))
    grid = pincal.Grid.of("x=-2:2:0.1", "y=-2:2:0.1")
    found = pincal.compute_workspace(mechanism, "reachable", grid, None, NONE)
    assert largest_circle(found).radius == pytest.approx(0.5, abs=1e-3)


def test_grids_measure_areas_alike() -> None:
    """Square and polar grids, coarse and fine, agree within what they say."""
    mechanism = pincal.load_mechanism("3RRR")
    grids = [
        ("x=-0.8:0.8:0.05", "y=-0.8:0.8:0.05"),
        ("x=-0.8:0.8:0.01", "y=-0.8:0.8:0.01"),
        ("radius=0.02:0.8:0.04", "bearing [deg]=0:360:5"),
        ("radius=0.005:0.8:0.01", "bearing [deg]=0:360:1"),
    ]
    found = [
        pincal.compute_workspace(mechanism, "constant-orientation", pincal.Grid.of(*axes))
        for axes in grids
    ]
    for one in found:
        assert 0.0 < one.uncertainty < 0.5 * one.measure
        for other in found:
            assert abs(one.measure - other.measure) <= one.uncertainty + other.uncertainty
    assert found[1].uncertainty < 0.3 * found[0].uncertainty


def test_chunks_change_nothing(hexapod: pincal.Mechanism, monkeypatch: pytest.MonkeyPatch) -> None:
    """Positions asked in many chunks are those asked at once, and progress rises to all."""
    grid = pincal.Grid.of(*POLAR["6UPS"])
    turns = pincal.Orientations.of(hexapod.platform, *TURNS["6UPS"])
    two = pincal.compute_workspace(hexapod, "total-orientation", grid, turns)
    monkeypatch.setattr("pincal.workspace.region.BLOCK", 1 << 12)
    done: list[int] = []
    one = pincal.compute_workspace(hexapod, "total-orientation", grid, turns, progress=done.append)
    np.testing.assert_array_equal(one.inside, two.inside)
    assert len(done) > 2
    assert done == sorted(done)
    assert done[-1] == grid.size
    assert not one.inside.flags.writeable


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("x=-1:1:0.5", [-1, -0.5, 0, 0.5, 1]),
        ("x [mm]=0:100:30", [0, 0.03, 0.06, 0.09]),
        ("z=1.8", [1.8]),
        ("phi [deg]=90,-90", [-np.pi / 2, np.pi / 2]),
        ("bearing [deg]=-180:180:90", [-np.pi, -np.pi / 2, 0, np.pi / 2]),
        ("tilt=0:0.6:0.1", np.linspace(0, 0.6, 7)),
    ],
)
def test_axes_are_read(text: str, values: list[float]) -> None:
    """Both forms, units, and a full turn whose ends are one."""
    np.testing.assert_allclose(Axis.parse(text).values, values, atol=1e-15)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x=1:-1:0.1", "limits reversed, 1 to -1"),
        ("x=0:1:0", "step is 0"),
        ("x=0:1:-0.1", "step is -0.1"),
        ("x=0:1:nan", "finite"),
        ("x=0:inf:1", "finite"),
        ("x=0:1:1e-12", "more than"),
        ("x=0:1", "LOW:HIGH:STEP"),
        ("x=", "not an axis"),
        ("x=a,b", "LOW:HIGH:STEP"),
        ("w=0:1:0.1", "unknown axis 'w'"),
        ("x [deg]=0:1:0.1", r"unit \[deg\]"),
        ("radius=-1:1:0.1", "negative"),
        ("", "not an axis"),
    ],
)
def test_wrong_axes_are_refused(text: str, message: str) -> None:
    """Each says what is wrong with it."""
    with pytest.raises(pincal.WorkspaceError, match=message):
        Axis.parse(text)


@pytest.mark.parametrize(
    "axes", [(), ("x=0:1:1",), ("x=0,1", "radius=0,1"), ("x=0,1", "y=0,1", "x=0"), ("phi=0,1",)]
)
def test_grids_that_are_none_are_refused(axes: tuple[str, ...]) -> None:
    """A grid needs x, y or radius, bearing, each once."""
    with pytest.raises(pincal.WorkspaceError):
        pincal.Grid.of(*axes)


@pytest.mark.parametrize(
    ("kind", "axes", "message"),
    [
        ("biggest", [], "unknown kind of workspace: 'biggest'"),
        ("total-orientation", [], "needs the orientations"),
        ("constant-orientation", ["phi=0,0.1"], "one orientation; got 2"),
    ],
)
def test_wrong_questions_are_refused(kind: str, axes: list[str], message: str) -> None:
    """Kinds and orientations that do not fit raise."""
    mechanism = pincal.load_mechanism("3RRR")
    turns = pincal.Orientations.of(mechanism.platform, *axes) if axes else None
    with pytest.raises(pincal.WorkspaceError, match=message):
        pincal.compute_workspace(mechanism, kind, pincal.Grid.of(*POLAR["3RRR"]), turns)


def test_orientations_fit_the_platform() -> None:
    """A plane turns by phi, a point not at all, and ways are not mixed."""
    for name, axes in [("3RRR", ["tilt=0"]), ("5R", ["phi=0"]), ("6UPS", ["tilt=0", "yaw=0"])]:
        with pytest.raises(pincal.WorkspaceError, match="platform takes"):
            pincal.Orientations.of(pincal.load_mechanism(name).platform, *axes)
    platform = pincal.load_mechanism("6UPS").platform
    with pytest.raises(pincal.WorkspaceError, match="twice"):
        pincal.Orientations.of(platform, "tilt=0", "tilt=0.1")
    assert len(pincal.Orientations.of(platform, *TILTS)) == 36 * 6 * 13 + 13  # one azimuth upright


def mirrored(angle: float = np.pi / 2, **limits: float) -> pincal.Mechanism:
    """Return a five-bar of leg 1 and its image in a mirror, with other limits of all joints."""
    leg = pincal.load_mechanism("5R").legs[0]
    limits = limits or {"lower": -2 * np.pi, "upper": 2 * np.pi}
    joints = tuple(replace(j, **limits) if j.kind != "fixed" else j for j in leg.joints)
    elements = (pincal.Element(0.0), pincal.Element.mirror(angle))
    platform = pincal.Platform("point", (0.0, 1.1))
    return pincal.generate("5R", replace(leg, joints=joints), elements, platform)


def test_elements_that_turn_the_determinant_over_are_left_out() -> None:
    """Half a turn swaps two legs, and the sides of the type-2 singularity with them."""
    legs = mirrored().legs[:1]
    mechanism = pincal.generate(
        "2R", legs[0], pincal.cyclic(2), pincal.Platform("point", (0.0, 1.1))
    )
    grid = pincal.Grid.of("x=-1.5:1.5:0.1", "y=-2:2:0.1")
    for least, order in ((None, 1), (NONE, 2)):
        short = pincal.compute_workspace(mechanism, "reachable", grid, None, least)
        assert len(short.elements) == order
        np.testing.assert_array_equal(short.inside, computed_everywhere(short))


def test_angles_count_wherever_limits_count_them_from() -> None:
    """Limits of a full turn bar nothing, whether home lies in their middle or near an end."""
    grid = pincal.Grid.of("x=-1.5:1.5:0.1", "y=-2:2:0.1")
    counts = {
        pincal.compute_workspace(mirrored(**limits), "reachable", grid, None, NONE).count
        for limits in (
            {},
            {"lower": -np.pi, "upper": np.pi},
            {"lower": 2.0, "upper": 2.0 + 2 * np.pi},
        )
    }
    assert len(counts) == 1
    limited = mirrored(lower=-3.0, upper=3.0)
    found = pincal.compute_workspace(limited, "reachable", grid, None, NONE)
    assert 0 < found.count < counts.pop()
    joints = pincal.inverse(limited, found.positions[:, :2]).joints
    for leg in limited.legs:
        for joint, values in zip(leg.moving, joints[leg.name].T, strict=True):
            assert joint.lower - 1e-9 <= values.min() <= values.max() <= joint.upper + 1e-9
    slanted = mirrored(np.radians(91))
    polar = pincal.Grid.of("radius=0.05:1.8:0.05", "bearing [deg]=-89:269:2")
    short = pincal.compute_workspace(slanted, "reachable", polar, None, NONE)
    assert len(short.elements) == 2
    np.testing.assert_array_equal(short.inside, computed_everywhere(short))


def test_grip_of_a_driven_elbow() -> None:
    """The type-1 margin is that of the drive, wherever it sits."""
    leg = mirrored().legs[0]
    leg = replace(leg, sensors=(replace(leg.sensors[0], joint="elbow"),))
    elements = (pincal.Element(0.0), pincal.Element.mirror(np.pi / 2))
    mechanism = pincal.generate("e", leg, elements, pincal.Platform("point", (0.0, 1.1)))
    grid = pincal.Grid.of("x=-1.5:1.5:0.1", "y=-2:2:0.1")
    least = pincal.Margins(0.5, -np.inf)
    found = pincal.compute_workspace(mechanism, "reachable", grid, None, least)
    assert 0 < found.count < grid.size
    assert pincal.margins(mechanism, found.positions[:, :2]).type1.min() >= 0.5 - 1e-9


def test_a_singular_home_says_so() -> None:
    """Which side of a type-2 singularity is meant cannot be read off it."""
    mechanism = mirrored()
    below = replace(mechanism, platform=pincal.Platform("point", (0.0, 0.45)))
    with pytest.raises(pincal.WorkspaceError, match="type-2 singularity"):
        pincal.compute_workspace(below, "reachable", pincal.Grid.of("x=0,1", "y=0,1"))


@pytest.mark.parametrize(
    ("axes", "message"),
    [
        (("radius=0:1:0.1", "bearing [deg]=0:720:5"), "more than once"),
        (("radius=0:1:0.1", "bearing [deg]=-180:180:7"), "does not divide"),
        (("radius=0,0.1,2", "bearing=0,1"), "evenly spaced"),
        (("x=0:1:0.00001", "y=0:1:0.00001"), "at most"),
        (("x=0:4194303:1", "y=0:2097151:1", "z=0:2097151:1"), "at most"),
    ],
)
def test_grids_that_cannot_be_measured_are_refused(axes: tuple[str, ...], message: str) -> None:
    """Round more than once, uneven, too large."""
    with pytest.raises(pincal.WorkspaceError, match=message):
        pincal.Grid.of(*axes)


def test_sets_of_orientations_have_limits() -> None:
    """Too many are refused before they are made; half a turn either way is one."""
    platform = pincal.load_mechanism("6UPS").platform
    with pytest.raises(pincal.WorkspaceError, match="more than"):
        pincal.Orientations.of(platform, *(f"{n}=0:4000000:1" for n in ("rx", "ry", "rz")))
    plane = pincal.load_mechanism("3RRR").platform
    assert len(pincal.Orientations.of(plane, "phi [deg]=-180,180")) == 1
    assert len(pincal.Orientations.everywhere(platform)) == 744


def test_nearly_quarter_turns_do_not_map_square_grids() -> None:
    """A mirror 1e-5 rad aside moves positions by more than rounding errors."""
    grid = pincal.Grid.of("x=-1.5:1.5:0.1", "y=0:2:0.1")
    assert grid.carrier(pincal.Element.mirror(np.pi / 2).base) is not None
    assert grid.carrier(pincal.Element.mirror(np.pi / 2 + 1.5e-5).base) is None


def test_planar_platforms_stay_in_their_plane() -> None:
    """Heights are refused, not counted."""
    grid = pincal.Grid.of("x=0:1:0.1", "y=0:1:0.1", "z=0:1:0.1")
    with pytest.raises(pincal.WorkspaceError, match="moves in a plane"):
        pincal.compute_workspace(pincal.load_mechanism("3RRR"), "reachable", grid)


def test_a_workspace_is_saved_and_shown(tmp_path: Path) -> None:
    """A line of text, a file, and positions that make poses which count."""
    mechanism = pincal.load_mechanism("3RRR")
    turn = pincal.Orientations.of(mechanism.platform, "phi=0.3")
    grid = pincal.Grid.of(*CARTESIAN["3RRR"])
    found = pincal.compute_workspace(mechanism, "constant-orientation", grid, turn)
    assert str(found).startswith("constant-orientation workspace of 3RRR: 0.5")
    found.save(tmp_path / "w.csv")
    assert len((tmp_path / "w.csv").read_text().splitlines()) == found.count + 1
    poses = np.column_stack((found.positions[:, :2], np.full(found.count, 0.3)))
    assert in_workspace(mechanism, poses).all()
    assert in_workspace(mechanism, poses + np.array([0, 0, 1.5])).sum() == 0


@pytest.mark.parametrize("any_mechanism", some_slow(BUNDLED, "6UPS"), indirect=True)
def test_default_grids_hold_the_workspace(any_mechanism: pincal.Mechanism) -> None:
    """Nothing that counts lies beyond; rotations make the grid polar."""
    grid = default_grid(any_mechanism)
    assert grid.polar == (any_mechanism.name != "5R")
    poses = workspace(any_mechanism.name, 2000)
    reach = [np.abs(axis.values).max() + axis.step for axis in grid.axes]
    if grid.polar:
        assert np.linalg.norm(poses[:, :2], axis=1).max() <= reach[0]
    else:
        assert (np.abs(poses[:, :2]).max(axis=0) <= reach[:2]).all()
    assert default_grid(any_mechanism, ["x=0:1:0.5"]).axes[0].values.size == 3
