"""A tree with loops becomes a mechanism: legs, platform, drives, and the parameters of its joints.

Every joint that moves, the tip and the platform's point may be displaced in all directions; of
these displacements each leg keeps those that its closure can distinguish (``independent``).
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from os.path import commonprefix

import numpy as np
from scipy.spatial.transform import Rotation

from pincal.errors import MechanismError, located
from pincal.files.tree import Step, Tree
from pincal.formats.arm import displaced, with_tip
from pincal.formats.limbs import Limb, limb_along, paths_to_platform, point_platform
from pincal.kinematics.assembly import assembled, independent, opening
from pincal.model.checks import ALIKE, EXACT, ROUNDING, listed
from pincal.model.consistency import ROUGH, identifiers
from pincal.model.leg import Closing, Joint, Leg
from pincal.model.mechanism import Mechanism
from pincal.model.placement import placement_of
from pincal.model.platform import Platform
from pincal.model.sensor import Sensor
from pincal.types import Array

_WRITTEN = (r"xyz|pos|fromto", r"rpy|axis|quat|euler|axisangle|xyaxes|zaxis")
_NUMBERS = 10  # along a leg, whose digits may be cut: two across each of five joints


def slack_of(text: str) -> float:
    """Return how far digits that an XML file does not write may have moved a leg's frames.

    Half a unit in the last digit, of its size and [rad], times the numbers along a leg; numbers of
    less than four digits are exact, but for right angles: 1.57 is cut.
    """
    cut = 0.0
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


def closing_in_words(tree: Tree, mechanism: Mechanism) -> tuple[str, bool]:
    """Return how far loops are open as drawn and joints moved, and whether beyond rounding."""
    drawn = {edge.joint.name: edge.joint.home for edge in tree.edges}
    legs = [
        leg.with_home([drawn.get(joint.name, 0.0) for joint in leg.moving])
        for leg in mechanism.legs
    ]
    gap = opening(legs, mechanism.platform)
    if gap <= max(ALIKE, tree.slack) * mechanism.size:
        return f"the loops close as drawn, within {gap:.2g} m", False
    moved: dict[str, tuple[float, str]] = {}
    for joint in (joint for leg in mechanism.legs for joint in leg.moving):
        if joint.name in drawn:
            unit, way = "rad" if joint.turns else "m", abs(joint.home - drawn[joint.name])
            moved[unit] = max(moved.get(unit, (0.0, "")), (way, joint.name))
    far = " and ".join(f"{way:.3g} {unit} ({name})" for unit, (way, name) in moved.items())
    return f"as drawn the loops are open by {gap:.3g} m: joints were moved by up to {far}", True


_FREEDOMS = {(2, 0): "point", (2, 1): "planar", (3, 0): "translational", (3, 3): "spatial"}
_SPATIAL, _PLANAR = ("x", "y", "z", "rx", "ry", "rz"), ("x", "y", "rz")


def closed_mechanism(
    tree: Tree, platform: str | None = None, base: str | None = None
) -> tuple[Mechanism, tuple[str, ...]]:
    """Return the mechanism of a tree with loops, and sentences on what was left out of it.

    Its platform is a link, that in which the legs meet if not given; its base another one, or the
    root.
    """
    with located(tree.source, MechanismError):
        if base is not None:
            tree = replace(tree, root=tree.link(base, "the base"))
        platform = platform or tree.platform
        if platform is not None:
            platform = tree.link(platform, "the platform")
        paths, platform, loose = paths_to_platform(tree, platform)
        driven = " (driven)" if set(tree.active) & set(loose) else ""
        remarks = [f"{listed(loose)}: in no loop, left out{driven}"] * bool(loose)
        normal = _normal(tree, paths)
        kind, limbs = _limbs(tree, paths, platform, normal)
        if normal is not None and abs(normal[2]) < 1.0 - EXACT:
            remarks.append("planar, but not across z: the base frame was turned to have z across")
        bare, free = [], Platform.at_origin(kind)
        for name, limb in zip(_leg_names(limbs), limbs, strict=True):
            leg = _leg(tree, name, limb, [point for _, point in limbs])
            bare.append(_without_idle(leg, remarks))
        axes = _PLANAR if kind in ("point", "planar") else _SPATIAL
        closed, placed = _closed(tree, bare, free)
        legs = []
        for leg, of_joints in zip(closed, _stems(closed), strict=True):
            for joint in leg.moving:
                if joint.limited and not joint.lower <= joint.home <= joint.upper:
                    place = f"{joint.home:.6g}, outside its limits"
                    remarks.append(f"{leg.name}: {joint.name!r} closes the loops at {place}")
            stems = (*of_joints, "tip")
            every = displaced(leg, stems, axes)
            order = sorted(every.parameter_names, key=every.units.__getitem__)  # m before rad
            distinct = independent(every, placed, tuple(order), tree.slack)
            held = set(every.parameter_names).difference(distinct)
            legs.append(displaced(leg, stems, axes, held=held))
        name = re.sub(r"\W+", "_", tree.name)[:100] or "mechanism"
        return Mechanism(name, placed, tuple(legs), f"From {tree.source}."), tuple(remarks)


def _closed(tree: Tree, legs: list[Leg], platform: Platform) -> tuple[tuple[Leg, ...], Platform]:
    """Return the legs with home positions that close them, and the platform at its home pose."""
    gap, size = opening(legs, platform), max(leg.size for leg in legs)
    if gap > ROUGH * size and not tree.homed:
        raise MechanismError(
            "the loops do not close near the joint positions that the file draws: ends that should "
            f"meet are {gap:.3g} m apart, and the longest leg is {size:.3g} m. Say positions near "
            "which they close (keyframe of MJCF, 'home' of the YAML file), or look at the frames "
            "of the loops and at units (metres, radians)"
        )
    return assembled(legs, platform, tree.slack)


def _limbs(
    tree: Tree, paths: list[list[Step]], platform: str | None, normal: Array | None
) -> tuple[str, list[Limb]]:
    """Return the kind of platform and the legs, in frames whose z is across the plane if planar."""
    driven, turn = set(tree.active), np.eye(3)
    if platform is None:
        limbs, kind = point_platform(tree, paths[0], driven, normal), "point"
    else:
        paths, kind = _with_drives(tree, paths, "spatial" if normal is None else "planar")
        link = tree.pose_at_zero(platform)[:3, :3]
        if kind in ("point", "translational"):
            turn = link.T @ (turn if normal is None else _onto(normal))
        elif normal is not None:
            turn = _onto(link.T @ normal)
        limbs = [limb_along(tree, path, platform, driven, normal) for path in paths]
    return kind, [_in_frames(limb, normal, turn, tree.slack) for limb in limbs]


def _with_drives(tree: Tree, paths: list[list[Step]], kind: str) -> tuple[list[list[Step]], str]:
    """Return the paths with a drive, and the kind of platform, which one without a drive may say.

    A path in which the platform floats, as one over the drive that carries the base, is no leg.
    """
    legs, idle, kinds = [], [], []
    for path in paths:
        undriven = [step for step in path if step[0].joint.name not in tree.active]
        freedoms = _freedoms(undriven)
        if len(undriven) < len(path) and freedoms != "spatial":
            legs.append(path)
        else:
            idle.append(path)
            kinds.append(freedoms)
    unclear = idle if len(idle) > 1 or not legs else idle[: kinds.count(None)]
    if unclear:
        names = ", ".join(edge.joint.name for edge, _ in unclear[0])
        raise MechanismError(
            f"no driven joint in the leg {names}; each leg needs one whose position is read: name "
            "it under name_mot (YAML) or give it an actuator (MJCF)"
        )
    return legs, next((of_path for of_path in kinds if of_path), kind)


def _freedoms(path: list[Step]) -> str | None:
    """Return the kind of platform that a row of slides and turns frees; None for another."""
    kinds = [edge.joint.kind for edge, forward in path if forward and edge.closes == "frame"]
    if len(kinds) != len(path) or kinds != sorted(kinds):  # slides first
        return None
    return _FREEDOMS.get((kinds.count("prismatic"), kinds.count("revolute")))


def _normal(tree: Tree, paths: list[list[Step]]) -> Array | None:
    """Return the normal of the plane in which all joints move, in the root's frame, shape (3,)."""
    axes: dict[str, list[Array]] = {"revolute": [], "prismatic": []}
    for edge in (edge for path in paths for edge, _ in path if edge.closes == "frame"):
        axes[edge.joint.kind].append(tree.pose_at_zero(edge.child)[:3, :3] @ edge.joint.axis)
    if not axes["revolute"]:
        return None
    slack = max(EXACT, tree.slack)
    normal = axes["revolute"][0]
    nearest = np.round(normal)  # along an axis of the root's frame
    if np.linalg.norm(np.cross(normal, nearest)) < slack and nearest.any():
        normal = nearest
    parallel = all(np.linalg.norm(np.cross(normal, axis)) < slack for axis in axes["revolute"])
    if not (parallel and all(abs(normal @ axis) < slack for axis in axes["prismatic"])):
        return None
    return np.asarray(normal * np.sign(normal[np.argmax(np.abs(normal))]))


def _onto(normal: Array, slack: float = 0.0) -> Array:
    """Return the smallest turn of z onto a unit vector, (3, 3), none within a slack."""
    if normal[2] > 1.0 - EXACT or np.hypot(normal[0], normal[1]) < slack:
        return np.eye(3)
    if normal[2] < EXACT - 1.0:
        return np.diag([1.0, -1.0, -1.0])
    return Rotation.align_vectors(normal, (0.0, 0.0, 1.0))[0].as_matrix()


def _in_frames(limb: Limb, normal: Array | None, C_platform: Array, slack: float) -> Limb:
    """Return a leg in the plane, z of every frame across it, in a base frame that has it so.

    In space only its platform's frame is turned; ``C_platform`` is how that is in its link.
    """
    joints, point = list(limb[0]), limb[1]
    if point is not None and not np.array_equal(C_platform, np.eye(3)):
        origin = point.placement.origin()
        origin[:3] = C_platform.T @ origin[:3]
        point = replace(point, placement=placement_of(origin))
    if normal is None:
        return tuple(joints), point
    C, R = _onto(normal), np.eye(3)
    for i, joint in enumerate(joints):
        origin = joint.placement.origin()
        R = R @ origin[:3, :3]
        last = i == len(joints) - 1 and point is None
        C_child = C_platform if last else _onto(R.T @ normal, max(EXACT, slack))
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
        joints[i] = joint
        C = C_child
    return tuple(joints), point


def _leg(tree: Tree, name: str, limb: Limb, points: Sequence[Joint | None]) -> Leg:
    """Return a leg without parameters, whose platform point has a name of its own among points."""
    joints = [replace(joint, mass=0.0, centre=Joint.centre) for joint in limb[0]]  # frames turned
    point = limb[1]
    driven = [joint.name for joint in joints if joint.name in tree.active]
    closes: Closing = "frame" if point is None else "point"
    point = point or Joint("point", "fixed")
    shared = [p.name for p in points if p is not None].count(point.name) > 1
    if shared or point.name == "point":
        point = replace(point, name=f"{name}_point")
    return Leg(name, with_tip(joints), tuple(map(Sensor, driven)), (), point, closes)


def _without_idle(leg: Leg, remarks: list[str]) -> Leg:
    """Return a leg without parameters whose idle joints are fixed at home; remarks say so."""
    joints = list(leg.joints)
    for idle in (leg.moving[place] for place in leg.idle):
        remarks.append(f"{leg.name}: {idle.name!r} moves no end of it: held")
        held = idle.placement.origin() @ idle.motion(np.array([idle.home]))[0]
        fixed = Joint(idle.name, "fixed", placement_of(held), parent=idle.parent)
        joints[leg.index(idle.name)] = fixed
    return replace(leg, joints=tuple(joints))


def _leg_names(limbs: Sequence[Limb]) -> list[str]:
    """Return what the names of each leg's joints begin with, or otherwise numbers."""
    names = []
    for joints, _ in limbs:
        moving = [joint.name for joint in joints if joint.kind != "fixed"]
        stem = commonprefix(moving)  # noqa: RUF071 (by letters, as meant)
        if any(len(name) > len(stem) and name[len(stem)] not in "_-./ " for name in moving):
            stem = re.sub(r"[^_\-./ ]*$", "", stem)
        names.append(re.sub(r"\W", "_", stem).strip("_"))
    if identifiers(names) == tuple(names) and "platform" not in names:
        return names
    return [f"leg_{index + 1}" for index in range(len(limbs))]


def _stems(legs: Sequence[Leg]) -> list[list[str]]:
    """Return for each leg its joints' names less its own, if all are alike; else joint_1, …."""
    stems = []
    for leg in legs:
        bare = [joint.name.removeprefix(leg.name) for joint in leg.moving]
        stems.append([re.sub(r"\W", "_", s).strip("_").removesuffix("_joint") for s in bare])
    first = stems[0]
    plain = all(stem.isidentifier() and stem.isascii() for stem in first)
    if all(of_leg == first for of_leg in stems) and plain and len(set(first)) == len(first):
        return stems
    return [[f"joint_{i + 1}" for i in range(len(of_leg))] for of_leg in stems]
