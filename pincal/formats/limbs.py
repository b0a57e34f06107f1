"""A way through a tree with loops as the joints of a leg, from the base to the platform.

A joint that is passed from its child to its parent moves the other way; a loop that closes a point
is a ball joint. A leg whose last joints, all passive, meet in a point of the platform (three
revolute axes; in the plane, one) closes that point; any other closes a frame.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pincal.errors import MechanismError
from pincal.formats.tree import Edge, Loop, Tree, listed, turns
from pincal.model.checks import EXACT
from pincal.model.leg import Joint
from pincal.model.placement import Placement, placement_of
from pincal.types import Array


@dataclass(frozen=True)
class Bond:
    """What lets two bodies move against each other: a joint, or a loop that closes a point."""

    name: str
    first: str
    second: str
    """Links on either side."""
    edge: Edge | None
    loop: Loop | None


@dataclass(frozen=True)
class Pass:
    """A bond as a way goes through it."""

    bond: Bond
    forth: bool
    """From its first link to its second one."""

    @property
    def ahead(self) -> str:
        """Link on the far side."""
        return self.bond.second if self.forth else self.bond.first


Way = tuple[Pass, ...]


@dataclass(frozen=True)
class Ways:
    """How a graph falls into legs."""

    ways: tuple[Way, ...]
    """From the base, each to the platform; a single one goes round, back to the base."""
    platform: str | None
    """A link of the platform; None if there is but one way, round."""
    left: tuple[str, ...]
    """Names of joints that lie in no loop."""


def ways_of(tree: Tree, platform: str | None = None) -> Ways:
    """Return the ways from the base to the platform.

    Args:
        tree: Links, joints and loops.
        platform: A link of the platform; found if not given.

    Raises:
        MechanismError: no loop, or bodies that lie on no way from the base to one platform.
    """
    body = _bodies(tree)
    bonds, left = _pruned(tree, _bonds(tree), body, platform)
    if not bonds:
        raise MechanismError(
            f"{tree.source}: its joints form no loop; list what closes the loops (closed_loop of a "
            "YAML file, <equality> of MJCF), or import a serial arm with --tip LINK"
        )
    base = body[tree.root]
    degree: Counter[str] = Counter()
    for bond in bonds:
        degree.update((body[bond.first], body[bond.second]))
    if platform is not None:
        meeting = [body[platform]]
        if meeting[0] == base or not degree[meeting[0]]:
            raise MechanismError(
                f"{tree.source}: {platform!r} cannot be the platform: "
                + ("it is fixed to the base" if meeting[0] == base else "no loop moves it")
            )
    else:
        meeting = [one for one in dict.fromkeys(degree) if degree[one] > 2 and one != base]
    if len(meeting) > 1:
        places = listed(_names(tree, body, one) for one in meeting)
        raise MechanismError(
            f"{tree.source}: ways meet in {len(meeting)} bodies ({places}); "
            "expected one, the platform, and legs that are serial chains from the base to it. "
            "Mechanisms with loops within a leg, or two platforms, cannot be calibrated"
        )
    goal = meeting[0] if meeting else base
    ways = _walked(tree, bonds, body, base, goal)
    used = {one.bond.name for way in ways for one in way}
    tree.check_joints(sorted(used))
    if lost := [bond.name for bond in bonds if bond.name not in used]:
        raise MechanismError(
            f"{tree.source}: {listed(lost)} lie on no way from the base {tree.root!r} to the "
            f"platform {_names(tree, body, goal)}; expected serial legs between these two. Is "
            "another link the base or the platform (--base, --platform)?"
        )
    found = platform or (None if goal == base else goal)
    return Ways(ways, found, left)


def _bodies(tree: Tree) -> dict[str, str]:
    """Return for each link the link that represents its body: the first one of the tree."""
    body = {link: link for link in tree.links}
    rigid = [(edge.parent, edge.child) for edge in tree.edges if edge.joint.kind == "fixed"]
    rigid += [(one.first.link, one.second.link) for one in tree.loops if one.closes == "frame"]
    for first, second in rigid:
        a, b = sorted((body[first], body[second]), key=tree.links.index)
        body = {link: a if own == b else own for link, own in body.items()}
    return body


def _bonds(tree: Tree) -> list[Bond]:
    joints = [
        Bond(edge.joint.name, edge.parent, edge.child, edge, None)
        for edge in tree.edges
        if edge.joint.kind != "fixed"
    ]
    points = [
        Bond(loop.name, loop.first.link, loop.second.link, None, loop)
        for loop in tree.loops
        if loop.closes == "point"
    ]
    return joints + points


def _pruned(
    tree: Tree, bonds: list[Bond], body: dict[str, str], platform: str | None
) -> tuple[list[Bond], tuple[str, ...]]:
    """Return the bonds that lie in loops, and the names of the others.

    Raises:
        MechanismError: a loop that closes on its own body.
    """
    for bond in bonds:
        if body[bond.first] == body[bond.second]:
            raise MechanismError(
                f"{tree.source}: {bond.name!r} joins {bond.first!r} and {bond.second!r}, which are "
                "fixed to each other; look at the loops that close whole frames"
            )
    keep = {body[tree.root]} | ({body[platform]} if platform is not None else set())
    left: list[str] = []
    while True:
        degree = Counter(body[link] for bond in bonds for link in (bond.first, bond.second))
        ends = {one for one, count in degree.items() if count == 1 and one not in keep}
        loose = [b for b in bonds if body[b.first] in ends or body[b.second] in ends]
        if not loose:
            return bonds, tuple(left)
        left += [bond.name for bond in loose]
        bonds = [bond for bond in bonds if bond not in loose]


def _walked(
    tree: Tree, bonds: list[Bond], body: dict[str, str], base: str, goal: str
) -> tuple[Way, ...]:
    """Return the ways from base to goal, in the order of the bonds; each bond is passed once.

    Raises:
        MechanismError: a way that does not lead there.
    """
    ways: list[Way] = []
    used: set[str] = set()
    for begin in bonds:
        if begin.name in used or base not in (body[begin.first], body[begin.second]):
            continue
        way = [Pass(begin, body[begin.first] == base)]
        used.add(begin.name)
        while body[way[-1].ahead] != goal:
            here = body[way[-1].ahead]
            on = [
                b for b in bonds if b.name not in used and here in (body[b.first], body[b.second])
            ]
            if len(on) != 1:
                names = ", ".join(one.bond.name for one in way)
                raise MechanismError(
                    f"{tree.source}: the way {names} from the base leads to "
                    f"{_names(tree, body, here)}, where {len(on)} ways go on; expected a serial "
                    f"chain to the platform {_names(tree, body, goal)}"
                )
            way.append(Pass(on[0], body[on[0].first] == here))
            used.add(on[0].name)
        ways.append(tuple(way))
    return tuple(ways)


def _names(tree: Tree, body: dict[str, str], one: str) -> str:
    """Return the links of a body for a message."""
    return "/".join(repr(link) for link in tree.links if body[link] == one)


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
