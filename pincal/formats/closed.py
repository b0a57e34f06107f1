"""Mechanisms of trees with loops: legs, platform, drives, and the parameters of the joints.

Every joint that moves, the tip and the platform's point may be displaced in all directions; each
leg keeps the displacements that its closure can distinguish (``independent``) as parameters.
"""

import logging
import re
from collections import ChainMap, Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from os.path import commonprefix
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from pincal.errors import MechanismError, located
from pincal.files.tree import Step, Tree, coupled
from pincal.formats.arm import displaced
from pincal.formats.limbs import (
    Limb,
    axes_of,
    leg_of,
    limbs_of,
    onto_normal,
    plane_of,
    point_platform,
    spins_of,
    turned,
)
from pincal.kinematics.assembly import assembled, independent, opening
from pincal.model import Joint, Leg, Mechanism, Platform, placement_of
from pincal.model.checks import ALIKE, EXACT, ROUNDING, listed
from pincal.model.consistency import identifiers
from pincal.model.platform import TWIST
from pincal.types import Array

_log = logging.getLogger(__name__)
_WRITTEN = (r"xyz|pos|fromto", r"rpy|axis|quat|euler|axisangle|xyaxes|zaxis")
_NUMBERS = 10  # numbers along a leg whose digits may be cut: two across each of five joints


def slack_of(data: bytes) -> float:
    """Return how far digits cut from an XML file may have moved a leg's frames, [rad] or relative.

    It is half a unit in the last digit times the numbers along a leg. Numbers of less than four
    digits count as exact, except multiples of a right angle such as 1.57.
    """
    cut, text = 0.0, data.replace(b"\0", b"").decode("latin-1")  # of UTF-16, too
    for kinds in _WRITTEN:
        values = " ".join(re.findall(rf"""\b(?:{kinds})\s*=\s*["']([^"']*)["']""", text)).split()
        plain = [re.sub(r"[eE].*|[-+.]", "", value).strip("0") for value in values]
        if long := [len(digits) for digits in plain if len(digits) > 3]:
            cut = max(cut, 5.0 * 10.0 ** -float(np.median(long)))
        if "rpy" in kinds:
            for value in values:
                if right := re.fullmatch(r"-?(1\.57|3\.14|4\.71|6\.28)(\d*)", value):
                    missed = abs(np.remainder(float(value) + np.pi / 4, np.pi / 2) - np.pi / 4)
                    cut = max(cut, missed if missed < 0.1 ** (2 + len(right[2])) else 0.0)
    return _NUMBERS * cut


def _joints_moved(drawn: Sequence[Leg], mechanism: Mechanism, slack: float) -> Iterator[str]:
    """Yield a sentence on the gap of the drawn loops and the moved joints, if beyond rounding."""
    gap = opening(drawn, mechanism.platform)
    homes = {joint.name: joint.home for leg in drawn for joint in leg.moving}
    moved: dict[str, tuple[float, str]] = {}
    for joint in (joint for leg in mechanism.legs for joint in leg.moving):
        unit, way = "rad" if joint.turns else "m", abs(joint.home - homes[joint.name])
        moved[unit] = max(moved.get(unit, (0.0, "")), (way, joint.name))
    far = " and ".join(f"{way:.3g} {unit} ({name})" for unit, (way, name) in moved.items())
    if gap > max(ALIKE, slack) * mechanism.size:
        yield f"as drawn, the loops are open by {gap:.3g} m: joints were moved by up to {far}"


_FREEDOMS = {(2, 0): "point", (2, 1): "planar", (3, 0): "translational", (3, 3): "spatial"}


def closed_mechanism(
    tree: Tree, platform: str | None = None, base: str | None = None
) -> tuple[Mechanism, tuple[str, ...]]:
    """Return the mechanism of a tree with loops, and sentences on differences from the drawing.

    Platform and base are names of links; by default the link in which the legs meet, and the root.
    """
    with located(tree.source, MechanismError):
        drawing = drawing_of(tree, platform, base)
        tree, normal, loose = drawing.tree, drawing.normal, drawing.loose
        if drawing.platform and not (platform or tree.platform):
            named = drawing.platform
            _log.info("the link %r is the platform; name another by --platform or --tip", named)
        driven = " (driven)" if set(tree.active) & set(loose) else ""
        remarks = [f"{listed(loose)}: in no loop with the platform, left out{driven}"] * bool(loose)
        if normal is not None and abs(normal[2]) < 1.0 - EXACT:
            remarks.append("planar, but not across z: the base frame was turned to have z across")
        free, bare = Platform.at_origin(drawing.kind), drawing.legs
        axes = ("x", "y", "rz") if drawing.kind in ("point", "planar") else TWIST
        closed, placed = assembled(bare, free, tree.slack)
        remarks += _joint_remarks(tree, closed)
        legs = []
        for leg, of_joints in zip(closed, _stems(closed), strict=True):
            stems = (*of_joints, "tip")
            every = displaced(leg, stems, axes)
            free_names = (k for k in every.parameter_names if k not in _within_balls(every))
            order = tuple(sorted(free_names, key=every.units.__getitem__))  # m first
            distinct = independent(every, placed, order, tree.slack)
            held = set(every.parameter_names).difference(distinct)
            legs.append(displaced(leg, stems, axes, held=held))
        name = re.sub(r"\W+", "_", tree.name)[:100] or "mechanism"
        mechanism = Mechanism(name, placed, tuple(legs), f"From {tree.source}.")
        if (idle := placed.dof - mechanism.constraints) > 0:
            free_ways = f"{idle} of the platform's {placed.dof} freedoms"
            remarks.append(f"the drives leave {free_ways} open: no pose follows from readings")
        return mechanism, (*_joints_moved(bare, mechanism, tree.slack), *remarks)


def _within_balls(leg: Leg) -> set[str]:
    """Return the displacements between the axes of balls, which meet by definition."""
    moving, within = {joint.name: joint for joint in leg.articulated}, set[str]()
    for ball in {joint.name.removesuffix("_x") for joint in leg.joints}:
        if {joint.name for joint in leg.joints}.issuperset(axes := axes_of(ball)):
            for axis in [axis for axis in axes if axis in moving][1:]:
                within |= moving[axis].placement.parameter_units.keys()
    return within


class Drawing(NamedTuple):
    """Legs of a tree between base and platform, without parameters, and their frames in it."""

    tree: Tree
    """The tree, whose root is the base."""
    platform: str | None
    """Link of the platform; None if it is the point of a joint."""
    kind: str
    legs: list[Leg]
    normal: Array | None
    """Normal of a planar mechanism in the root's frame, shape (3,); z of all legs' frames."""
    turn: Array
    """Rotation of the platform's frame in its link, shape (3, 3)."""
    backward: frozenset[str]
    """Names of the joints that the legs pass from child to parent."""
    loose: list[str]
    """Names of the joints that are in no leg."""


def drawing_of(tree: Tree, platform: str | None = None, base: str | None = None) -> Drawing:
    """Return the legs of a tree between two links; by default see ``closed_mechanism``."""
    if base is not None:
        tree = replace(tree, root=tree.link(base, "the base"))
    tree, turn = coupled(tree), np.eye(3)
    platform = platform or tree.platform
    limbs, platform, loose = limbs_of(tree, platform and tree.link(platform, "the platform"))
    steps = [step for limb in limbs for step in limb.steps]
    normal = plane_of(tree, steps)
    if platform is None:
        legs, kind = point_platform(tree, limbs[0].ends[0], normal), "point"
        steps = [*steps[:3], *((edge, not forward) for edge, forward in steps[3:])]
    else:
        limbs, kind = _guiding(tree, limbs, "spatial" if normal is None else "planar")
        legs = [leg_of(tree, limb, platform, normal) for limb in limbs]
        if spins := ChainMap(*map(partial(spins_of, tree), legs)):
            return drawing_of(turned(tree, spins), platform)
        turn = _platform_turn(tree.pose_at_zero(platform)[:3, :3], kind, normal)
    legs = _all_named([_in_frames(leg, normal, turn, tree.slack) for leg in legs])
    backward = frozenset(edge.joint.name for edge, forward in steps if not forward)
    return Drawing(tree, platform, kind, legs, normal, turn, backward, loose)


def _platform_turn(link: Array, kind: str, normal: Array | None) -> Array:
    """Return the rotation of the platform's frame in its link, which is turned so, (3, 3)."""
    if kind in ("point", "translational"):
        return link.T @ (np.eye(3) if normal is None else onto_normal(normal))
    return np.eye(3) if normal is None else onto_normal(link.T @ normal)


def _guiding(tree: Tree, limbs: list[Limb], kind: str) -> tuple[list[Limb], str]:
    """Return the limbs that are legs, and the kind of platform.

    A limb without drives that gives the kind by its joints is no leg, nor is one on which the
    platform moves freely in space.
    """
    legs = []
    for limb in limbs:
        undriven = [step for step in limb.steps if step[0].joint.name not in tree.active]
        freedoms = None if len(limb.ends) > 1 or limb.loops else _freedoms(undriven)
        guides = len(undriven) == len(limb.steps) and freedoms
        if guides or freedoms == "spatial":
            kind = kind if freedoms == "spatial" else freedoms or kind
        else:
            legs.append(limb)
    if not {bond.joint.name for limb in legs for bond, _ in limb.steps} & set(tree.active):
        raise MechanismError(
            "no driven joint between base and platform: name one under name_mot (YAML) or give it "
            "a <transmission> (URDF) or an actuator (MJCF). Or is another link the base or the "
            "platform (--base, --platform)?"
        )
    return legs, kind


def _freedoms(path: list[Step]) -> str | None:
    """Return the kind of platform that a chain of slides and then revolutes allows, or None."""
    kinds = [edge.joint.kind for edge, forward in path if forward and edge.closes == "frame"]
    if len(kinds) != len(path) or kinds != sorted(kinds):  # slides first
        return None
    return _FREEDOMS.get((kinds.count("prismatic"), kinds.count("revolute")))


def _in_frames(leg: Leg, normal: Array | None, C_platform: Array, slack: float) -> Leg:
    """Return a leg in frames whose z is the normal of the plane.

    In space only the platform's frame is turned; ``C_platform`` is its rotation in its link.
    """

    def in_platform(point: Joint) -> Joint:
        origin = point.placement.origin()
        origin[:3] = C_platform.T @ origin[:3]
        return replace(point, placement=placement_of(origin))

    if not np.array_equal(C_platform, np.eye(3)):
        ends = tuple(end if end.closes == "frame" else end.moved(in_platform) for end in leg.ends)
        point = leg.point if leg.closes == "frame" else in_platform(leg.point)
        leg = replace(leg, point=point, ends=ends)
    if normal is None:
        return leg
    joints: list[Joint] = []
    turns = {-1: (onto_normal(normal), np.eye(3))}  # turn of each link's frame; its orientation
    tips = [end.tip for end in leg.every_end if end.point and end.closes == "frame"]
    for i, (joint, carrier) in enumerate(zip(leg.joints, leg.carriers, strict=True)):
        C, R = turns[carrier]
        R = R @ joint.placement.origin()[:3, :3]
        C_child = onto_normal(R.T @ normal, max(EXACT, slack))
        if joint.name in tips:
            C_child = C_platform
        joints.append(_upright(joint, C, C_child))
        turns[i] = C_child, R
    return replace(leg, joints=tuple(joints))


def _upright(joint: Joint, C: Array, C_child: Array) -> Joint:
    """Return a joint between links whose frames were turned, made exactly planar."""
    origin = joint.placement.origin()
    if not (np.array_equal(C, np.eye(3)) and np.array_equal(C_child, np.eye(3))):
        origin[:3] = C.T @ origin[:3]
        origin[:3, :3] = origin[:3, :3] @ C_child
        x, y, z = (float(v) for v in np.round(C_child.T @ joint.axis, 12))
        joint = replace(joint, placement=placement_of(origin), axis=(x, y, z))
    x, y, z = joint.axis
    axis = (0.0, 0.0, float(np.sign(z)))
    if joint.kind == "prismatic":
        axis = (x / float(np.hypot(x, y)), y / float(np.hypot(x, y)), 0.0) if z else joint.axis
    if np.abs(origin[:2, 2]).max() > ROUNDING or joint.axis != axis:
        upright = Rotation.align_vectors((0.0, 0.0, np.sign(origin[2, 2])), origin[:3, 2])[0]
        origin[:3, :3] = upright.as_matrix() @ origin[:3, :3]
        joint = replace(joint, placement=placement_of(origin), axis=axis)
    return joint


def _all_named(legs: Sequence[Leg]) -> list[Leg]:
    """Return legs with names of their own, and with unique names of platform points."""
    shared = Counter(point.name for leg in legs for point in leg.points)
    return [_named(*pair, shared) for pair in zip(_leg_names(legs), legs, strict=True)]


def _named(name: str, leg: Leg, shared: Counter[str]) -> Leg:
    """Return a leg with a name, and with unique names of its platform points."""

    def renamed(point: Joint, place: int = 1) -> Joint:
        if shared[point.name] > 1 or point.name == "point":
            return replace(point, name=f"{name}_point" + f"_{place}" * (place > 1))
        return point

    joints = [replace(joint, mass=0.0, centre=Joint.centre) for joint in leg.joints]  # frames moved
    ends = (end.moved(partial(renamed, place=i)) for i, end in enumerate(leg.ends, 2))
    changed = replace(leg, name=name, joints=tuple(joints), ends=tuple(ends))
    return replace(changed, point=renamed(leg.point), settled=False)


def _joint_remarks(tree: Tree, legs: Sequence[Leg]) -> Iterator[str]:
    """Yield a sentence for each joint that is fixed, as it moves no end, or is beyond limits."""
    moving = {edge.joint.name for edge in tree.edges if edge.joint.kind != "fixed"}
    moving |= {f"{edge.joint.name}_{axis}" for edge in tree.loops for axis in "xyz"}
    for leg in legs:
        tips = {end.tip for end in leg.every_end}
        for joint in leg.joints:
            named = f"{leg.name}: {joint.name!r}"
            if joint.kind == "fixed" and joint.name in moving - tips:
                yield f"{named} moves no end of it: held"
            if joint.limited and not joint.lower <= joint.home <= joint.upper:
                yield f"{named} closes the loops at {joint.home:.6g}, outside its limits"


def _leg_names(legs: Sequence[Leg]) -> list[str]:
    """Return the common prefixes of the legs' joint names as names of legs, or else leg_1, …."""
    names = []
    for leg in legs:
        moving = [joint.name for joint in leg.moving]
        stem = commonprefix(moving)  # noqa: RUF071 (by letters, as meant)
        if any(len(name) > len(stem) and name[len(stem)] not in "_-./ " for name in moving):
            stem = re.sub(r"[^_\-./ ]*$", "", stem)
        names.append(re.sub(r"\W", "_", stem).strip("_"))
    if identifiers(names) == tuple(names) and "platform" not in names:
        return names
    return [f"leg_{index + 1}" for index in range(len(legs))]


def _stems(legs: Sequence[Leg]) -> list[list[str]]:
    """Return the joints' names without their leg's, if equal for all legs; else joint_1, …."""
    stems = []
    for leg in legs:
        bare = [joint.name.removeprefix(leg.name) for joint in leg.articulated]
        stems.append([re.sub(r"\W", "_", s).strip("_").removesuffix("_joint") for s in bare])
    first = stems[0]
    plain = all(stem.isidentifier() and stem.isascii() for stem in first)
    if all(of_leg == first for of_leg in stems) and plain and len(set(first)) == len(first):
        return stems
    return [[f"joint_{i + 1}" for i in range(len(of_leg))] for of_leg in stems]
