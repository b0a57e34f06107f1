"""A way through a tree with loops as the joints of a leg, from the base to the platform.

A joint that is passed from its child to its parent moves the other way; a loop that closes a point
is a ball joint. A leg whose last joints, all passive, meet in a point of the platform (three
revolute axes; in the plane, one) closes that point; any other closes a frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pincal.errors import MechanismError
from pincal.formats.trees.graph import Pass
from pincal.formats.trees.tree import Tree, turns
from pincal.model.checks import EXACT
from pincal.model.joint import Joint
from pincal.model.placement import Placement, placement_of

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Limb:
    """Joints of a leg, and the point of the platform that it closes, if it is no frame."""

    joints: tuple[Joint, ...]
    point: Joint | None


def chain(tree: Tree, way: Sequence[Pass], normal: Array | None) -> tuple[tuple[Joint, ...], str]:
    """Return the joints along a way from the root, and the link at which it ends.

    Args:
        tree: Links, joints and loops.
        way: From the root.
        normal: Of a planar mechanism, in the root's frame, shape (3,).
    """
    link = tree.root
    joints: list[Joint] = []
    for one in way:
        bond, loop = one.bond, one.bond.loop
        near = bond.first if one.forth else bond.second
        joints += rigid(tree, link, near)
        link = one.ahead
        if bond.edge is not None:
            joint = bond.edge.joint
            if one.forth:
                joints.append(joint)
                continue
            x, y, z = joint.axis
            joints.append(replace(joint, placement=Placement(), axis=(-x, -y, -z)))
            joints += _offset(f"{joint.name}_back", _inverse(joint.placement))
        elif loop is not None:
            spots = (loop.first, loop.second) if one.forth else (loop.second, loop.first)
            joints += _offset(f"{loop.name}_at", spots[0].placement.origin())
            joints += _ball(tree, loop.name, spots[0].link, spots[0].placement, normal)
            joints += _offset(f"{loop.name}_back", _inverse(spots[1].placement))
    return tuple(joints), link


def _ball(
    tree: Tree, name: str, link: str, placement: Placement, normal: Array | None
) -> list[Joint]:
    """Return the joints of a point that is shared, at zero: three turns, or one in the plane."""
    if normal is None:
        return [edge.joint for edge in turns(Joint(name, "fixed"), "", "", "xyz")]
    own = (poses_at_zero(tree)[link] @ placement.origin())[:3, :3].T @ normal
    x, y, z = (float(v) for v in own)
    return [Joint(f"{name}_z", "revolute", Placement(), (x, y, z), -np.inf, np.inf)]


def rigid(tree: Tree, start: str, goal: str) -> list[Joint]:
    """Return fixed joints from one link to another of the same body."""
    ways: dict[str, list[Joint]] = {start: []}
    ahead = [start]
    while ahead and goal not in ways:
        here = ahead.pop(0)
        for there, joints in _fixed_to(tree, here):
            if there not in ways:
                ways[there] = [*ways[here], *joints]
                ahead.append(there)
    return ways[goal]


def _fixed_to(tree: Tree, link: str) -> list[tuple[str, list[Joint]]]:
    """Return the links that are fixed to a link directly, and by what."""
    found: list[tuple[str, list[Joint]]] = []
    for edge in tree.edges:
        if edge.joint.kind != "fixed":
            continue
        if edge.parent == link:
            found.append((edge.child, [edge.joint]))
        elif edge.child == link:
            back = _offset(f"{edge.joint.name}_back", _inverse(edge.joint.placement))
            found.append((edge.parent, back))
    for loop in tree.loops:
        if loop.closes != "frame":
            continue
        first, second = loop.first.placement.origin(), loop.second.placement.origin()
        if loop.first.link == link:
            found.append((loop.second.link, _offset(loop.name, first @ np.linalg.inv(second))))
        elif loop.second.link == link:
            found.append((loop.first.link, _offset(loop.name, second @ np.linalg.inv(first))))
    return found


def _inverse(placement: Placement) -> Array:
    """Return the inverse of a placement, shape (4, 4)."""
    return np.asarray(np.linalg.inv(placement.origin()))


def _offset(name: str, matrix: Array) -> list[Joint]:
    """Return a fixed joint, or none for nothing."""
    if np.array_equal(matrix, np.eye(4)):
        return []
    return [Joint(name, "fixed", placement_of(matrix))]


def limb(
    tree: Tree, way: Sequence[Pass], platform: str, driven: set[str], normal: Array | None
) -> Limb:
    """Return the leg along a way to the platform.

    Args:
        tree: Links, joints and loops.
        way: From the root to a link of the platform's body.
        platform: Link whose frame is the platform's.
        driven: Names of active joints.
        normal: Of a planar mechanism, in the root's frame.
    """
    joints, end = chain(tree, way, normal)
    joints += tuple(rigid(tree, end, platform))
    last = [i for i, joint in enumerate(joints) if joint.kind != "fixed"]
    count = 3 if normal is None else 1
    place = last[-count] if len(last) > count else None
    if place is None or any(
        joints[i].kind != "revolute" or joints[i].name in driven for i in last[-count:]
    ):
        return Limb(joints, None)
    frames = placements_at_zero(joints[place:])
    turned = [i - place for i in last[-count:]]
    origins = np.stack([frames[i][:3, 3] for i in turned])
    axes = np.stack([frames[i][:3, :3] @ joints[i + place].axis for i in turned])
    centre = _meeting(origins, axes, tree.slack) if normal is None else origins[0]
    if centre is None:
        return Limb(joints, None)
    there = (np.linalg.inv(frames[-1]) @ np.append(centre, 1.0))[:3]
    names = [joints[i].name for i in last[-count:]]
    stem = names[0].removesuffix("_x")
    ball = names == [f"{stem}_{axis}" for axis in "xyz"]
    first = replace(joints[place], name=stem) if ball else joints[place]
    point = _point(tree, end, platform, there)
    return Limb(_to_point(joints[:place], first, centre), point)


def _meeting(origins: Array, axes: Array, slack: float) -> Array | None:
    """Return where three axes meet that turn in all directions, shape (3,); None if nowhere."""
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    turning = np.linalg.norm(np.cross(axes[:-1], axes[1:]), axis=1)
    if (turning < 1e-6).any():
        return None
    centre = np.linalg.solve(across.sum(axis=0), np.einsum("kij,kj->i", across, origins))
    missed = np.abs(np.einsum("kij,kj->ki", across, origins - centre)).max()
    size = float(np.abs(origins).max()) or 1.0
    if missed > max(EXACT, slack) * size:
        return None
    near = np.abs(origins[0] - centre).max() <= 1e-15 * size
    return np.asarray(origins[0] if near else centre)


def _to_point(joints: tuple[Joint, ...], dropped: Joint, centre: Array) -> tuple[Joint, ...]:
    """Return a leg's joints up to a point, in the frame that carries the dropped joint."""
    if joints and joints[-1].kind == "fixed" and not centre.any():
        return joints  # the point is where this one already is
    x, y, z = (float(v) for v in centre)
    rpy = dropped.placement.rpy
    return (*joints, Joint(dropped.name, "fixed", Placement((), (x, y, z), rpy)))


def _point(tree: Tree, link: str, platform: str, there: Array) -> Joint:
    """Return the platform's point: by the file's own frame if it has one there."""
    own = rigid(tree, platform, link)
    if len(own) == 1 and np.abs(np.array(own[0].placement.xyz) - there).max() <= 1e-12:
        return own[0]
    x, y, z = (float(v) + 0.0 for v in there)
    return Joint("point", "fixed", Placement((), (x, y, z)))


def point_platform(
    tree: Tree, way: Sequence[Pass], driven: set[str], normal: Array
) -> tuple[Limb, Limb]:
    """Return the two legs of a planar loop whose platform is a point of it, as of a five-bar.

    It is where the loop parts into two legs of two joints, one of them driven.

    Raises:
        MechanismError: there is no such point.
    """
    names = [one.bond.name for one in way]
    middle = way[2] if len(way) == 5 else None
    sides = (set(names[:2]), set(names[3:]))
    if middle is None or middle.bond.name in driven or any(len(s & driven) != 1 for s in sides):
        raise MechanismError(
            f"{tree.source}: one loop of {len(way)} joints ({', '.join(names)}; driven: "
            f"{', '.join(n for n in names if n in driven) or 'none'}) has no platform that can be "
            "recognised; name it with --platform LINK (of a five-bar with a drive in either leg it "
            "is the point of the middle joint)"
        )
    back = tuple(Pass(one.bond, not one.forth) for one in reversed(way))
    limbs = []
    for side, through in ((way[:2], way[2]), (back[:2], back[2])):
        joints, _ = chain(tree, (*side, through), normal)
        last = max(i for i, joint in enumerate(joints) if joint.kind != "fixed")
        if joints[last].kind != "revolute":
            raise MechanismError(
                f"{tree.source}: the two legs meet in {joints[last].name!r}, which slides; name "
                "the platform with --platform LINK"
            )
        centre = np.array(joints[last].placement.xyz)
        limbs.append(Limb(_to_point(joints[:last], joints[last], centre), Joint("point", "fixed")))
    return limbs[0], limbs[1]


def poses_at_zero(tree: Tree) -> dict[str, Array]:
    """Return where the links are with all joints at zero, ``T_root_link`` by name, (4, 4)."""
    poses = {tree.root: np.eye(4)}
    ahead = list(tree.edges)
    while ahead:
        for edge in [edge for edge in ahead if edge.parent in poses]:
            poses[edge.child] = poses[edge.parent] @ edge.joint.placement.origin()
            ahead.remove(edge)
    return poses


def placements_at_zero(joints: Sequence[Joint]) -> list[Array]:
    """Return the frames of joints in a row, each (4, 4), with all of them at zero."""
    frames, here = [], np.eye(4)
    for joint in joints:
        here = here @ joint.placement.origin()
        frames.append(here)
    return frames
