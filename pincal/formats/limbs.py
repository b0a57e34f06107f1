"""Paths through a tree with loops as the joints of legs, from the base to the platform.

A joint that is passed from its child to its parent moves the other way; a loop that closes a point
is a ball joint. A leg whose last joints, all passive, meet in a point of the platform (three
revolute axes; in the plane, one) closes that point; any other closes a frame.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate

import numpy as np

from pincal.errors import MechanismError
from pincal.formats.tree import Loop, Tree, listed, turns
from pincal.model.checks import EXACT
from pincal.model.leg import Joint
from pincal.model.placement import Placement, placement_of
from pincal.types import Array


@dataclass(frozen=True)
class Bond:
    """What lets two links move against each other: a joint, or a loop that closes a point."""

    name: str
    near: str
    """Link at which a path comes to it."""
    far: str
    """Link at which a path goes on."""
    joint: Joint | None = None
    loop: Loop | None = None
    forward: bool = True
    """Whether it is passed from its parent, or its loop's first link, to the other."""

    def reversed(self) -> Bond:
        """Return the bond as it is passed the other way."""
        return replace(self, near=self.far, far=self.near, forward=not self.forward)


LegPath = tuple[Bond, ...]


@dataclass(frozen=True)
class Limb:
    """Joints of a leg, and the point of the platform that it closes, if it is no frame."""

    joints: tuple[Joint, ...]
    point: Joint | None = None

    @property
    def moving_names(self) -> list[str]:
        """Names of the joints that move."""
        return [joint.name for joint in self.joints if joint.kind != "fixed"]


def paths_to_platform(
    tree: Tree, platform: str | None = None
) -> tuple[tuple[LegPath, ...], str | None, tuple[str, ...]]:
    """Return the paths from the base to the platform, a link of it, and the joints in no loop.

    The link is None if there is but one loop, and then its one path goes round, back to the base.

    Args:
        tree: Links, joints and loops.
        platform: A link of the platform; searched for if not given.

    Raises:
        MechanismError: no loop, or bodies that lie on no path from the base to one platform.
    """
    body = _bodies(tree)
    bonds, loose = _bonds_in_loops(tree, body, platform)
    if not bonds:
        raise MechanismError(
            f"{tree.source}: its joints form no loop; list what closes the loops (closed_loop of a "
            "YAML file, <equality> of MJCF), or import a serial arm with --tip LINK"
        )
    base = body[tree.root]
    goal = _meeting_body(tree, bonds, body, platform) or base
    paths = _paths(tree, bonds, body, goal)
    passed = {bond.name for path in paths for bond in path}
    tree.check_joints(sorted(passed))
    if lost := [bond.name for bond in bonds if bond.name not in passed]:
        raise MechanismError(
            f"{tree.source}: {listed(lost)} lie on no way from the base {tree.root!r} to the "
            f"platform {_links(tree, body, goal)}; expected serial legs between these two. Is "
            "another link the base or the platform (--base, --platform)?"
        )
    return paths, platform or (None if goal == base else goal), loose


def _bodies(tree: Tree) -> dict[str, str]:
    """Return for each link the link that represents its body: the first one of the tree."""
    body = {link: link for link in tree.links}
    rigid = [(edge.parent, edge.child) for edge in tree.edges if edge.joint.kind == "fixed"]
    rigid += [(loop.first.link, loop.second.link) for loop in tree.loops if loop.closes == "frame"]
    for first, second in rigid:
        representative, merged = sorted((body[first], body[second]), key=tree.links.index)
        body = {link: representative if name == merged else name for link, name in body.items()}
    return body


def _degrees(bonds: Iterable[Bond], body: dict[str, str]) -> Counter[str]:
    """Return how many bonds each body has."""
    return Counter(body[link] for bond in bonds for link in (bond.near, bond.far))


def _bonds(tree: Tree) -> list[Bond]:
    """Return the joints that move, and the loops that close a point."""
    joints = [
        Bond(edge.joint.name, edge.parent, edge.child, joint=edge.joint)
        for edge in tree.edges
        if edge.joint.kind != "fixed"
    ]
    points = [
        Bond(loop.name, loop.first.link, loop.second.link, loop=loop)
        for loop in tree.loops
        if loop.closes == "point"
    ]
    return joints + points


def _bonds_in_loops(
    tree: Tree, body: dict[str, str], platform: str | None
) -> tuple[list[Bond], tuple[str, ...]]:
    """Return the bonds that lie in loops, and the names of the others.

    Raises:
        MechanismError: a loop that closes on its own body.
    """
    bonds = _bonds(tree)
    for bond in bonds:
        if body[bond.near] == body[bond.far]:
            raise MechanismError(
                f"{tree.source}: {bond.name!r} joins {bond.near!r} and {bond.far!r}, which are "
                "fixed to each other; look at the loops that close whole frames"
            )
    ends = {body[link] for link in (tree.root, platform) if link is not None}
    loose: list[str] = []
    while True:
        degrees = _degrees(bonds, body)
        leaves = {name for name, count in degrees.items() if count == 1} - ends
        hanging = [bond for bond in bonds if {body[bond.near], body[bond.far]} & leaves]
        if not hanging:
            return bonds, tuple(loose)
        loose += [bond.name for bond in hanging]
        bonds = [bond for bond in bonds if bond not in hanging]


def _meeting_body(
    tree: Tree, bonds: list[Bond], body: dict[str, str], platform: str | None
) -> str | None:
    """Return the platform's body: the only one besides the base where paths meet; None if none is.

    Raises:
        MechanismError: several of them, or a platform that no loop moves.
    """
    degrees, base = _degrees(bonds, body), body[tree.root]
    if platform is not None:
        if body[platform] == base or not degrees[body[platform]]:
            fault = "it is fixed to the base" if body[platform] == base else "no loop moves it"
            raise MechanismError(f"{tree.source}: {platform!r} cannot be the platform: {fault}")
        return body[platform]
    meeting = [name for name, count in degrees.items() if count > 2 and name != base]
    if len(meeting) > 1:
        places = listed(_links(tree, body, name) for name in meeting)
        raise MechanismError(
            f"{tree.source}: ways meet in {len(meeting)} bodies ({places}); "
            "expected one, the platform, and legs that are serial chains from the base to it. "
            "Mechanisms with loops within a leg, or two platforms, cannot be calibrated"
        )
    return meeting[0] if meeting else None


def _paths(tree: Tree, bonds: list[Bond], body: dict[str, str], goal: str) -> tuple[LegPath, ...]:
    """Return the paths from base to goal, in the order of the bonds; each bond is passed once.

    Raises:
        MechanismError: a path that does not lead to the goal.
    """
    unused = {bond.name: bond for bond in bonds}

    def from_body(name: str) -> list[Bond]:
        forward = [bond for bond in unused.values() if body[bond.near] == name]
        return forward + [b.reversed() for b in unused.values() if body[b.far] == name]

    paths: list[LegPath] = []
    for bond in bonds:
        if bond.name not in unused or body[tree.root] not in (body[bond.near], body[bond.far]):
            continue
        path = [bond if body[bond.near] == body[tree.root] else bond.reversed()]
        del unused[bond.name]
        while (end := body[path[-1].far]) != goal:
            onward = from_body(end)
            if len(onward) != 1:
                names = ", ".join(passed.name for passed in path)
                raise MechanismError(
                    f"{tree.source}: the way {names} from the base leads to "
                    f"{_links(tree, body, end)}, where {len(onward)} ways go on; expected a serial "
                    f"chain to the platform {_links(tree, body, goal)}"
                )
            path += onward
            del unused[onward[0].name]
        paths.append(tuple(path))
    return tuple(paths)


def _links(tree: Tree, body: dict[str, str], name: str) -> str:
    """Return the links of a body for a message."""
    return "/".join(repr(link) for link in tree.links if body[link] == name)


def _chain(tree: Tree, path: Sequence[Bond], normal: Array | None) -> list[Joint]:
    """Return the joints along a path, from the root to the link at its end.

    Args:
        tree: Links, joints and loops.
        path: From the root.
        normal: Of a planar mechanism, in the root's frame, shape (3,).
    """
    link = tree.root
    joints: list[Joint] = []
    for bond in path:
        joints += _rigid(tree, link, bond.near)
        link = bond.far
        if bond.joint is not None and bond.forward:
            joints.append(bond.joint)
        elif bond.joint is not None:
            x, y, z = bond.joint.axis
            joints.append(replace(bond.joint, placement=Placement(), axis=(-x, -y, -z)))
            joints += _offset(f"{bond.name}_back", _inverse(bond.joint.placement))
        elif bond.loop is not None:
            spots = [bond.loop.first, bond.loop.second]
            near, far = (spot.placement for spot in (spots if bond.forward else spots[::-1]))
            joints += _offset(f"{bond.name}_at", near.origin())
            joints += _ball(tree, bond, near, normal)
            joints += _offset(f"{bond.name}_back", _inverse(far))
    return joints


def _ball(tree: Tree, bond: Bond, placement: Placement, normal: Array | None) -> list[Joint]:
    """Return the joints of a point that is shared, at zero: three turns, or one in the plane."""
    if normal is None:
        return [edge.joint for edge in turns(Joint(bond.name, "fixed"), "", "", "xyz")]
    link = poses_at_zero(tree)[bond.near]
    x, y, z = map(float, (link @ placement.origin())[:3, :3].T @ normal)
    return [Joint(f"{bond.name}_z", "revolute", Placement(), (x, y, z), -np.inf, np.inf)]


def _rigid(tree: Tree, start: str, goal: str) -> list[Joint]:
    """Return fixed joints from one link to another of the same body."""
    routes: dict[str, list[Joint]] = {start: []}
    ahead = [start]
    while ahead and goal not in routes:
        link = ahead.pop(0)
        for neighbour, joints in _fixed_to(tree, link):
            if neighbour not in routes:
                routes[neighbour] = [*routes[link], *joints]
                ahead.append(neighbour)
    return routes[goal]


def _fixed_to(tree: Tree, link: str) -> list[tuple[str, list[Joint]]]:
    """Return the links that are fixed to a link directly, and by what."""
    neighbours: list[tuple[str, list[Joint]]] = []
    for edge in tree.edges:
        if edge.joint.kind != "fixed":
            continue
        if edge.parent == link:
            neighbours.append((edge.child, [edge.joint]))
        elif edge.child == link:
            inverse = _offset(f"{edge.joint.name}_back", _inverse(edge.joint.placement))
            neighbours.append((edge.parent, inverse))
    for loop in tree.loops:
        if loop.closes != "frame" or link not in (loop.first.link, loop.second.link):
            continue
        near, far = loop.first, loop.second
        if near.link != link:
            near, far = far, near
        offset = near.placement.origin() @ _inverse(far.placement)
        neighbours.append((far.link, _offset(loop.name, offset)))
    return neighbours


def _inverse(placement: Placement) -> Array:
    """Return the inverse of a placement, shape (4, 4)."""
    return np.asarray(np.linalg.inv(placement.origin()))


def _offset(name: str, matrix: Array) -> list[Joint]:
    """Return a fixed joint, or none for nothing."""
    if np.array_equal(matrix, np.eye(4)):
        return []
    return [Joint(name, "fixed", placement_of(matrix))]


def limb_along(
    tree: Tree, path: Sequence[Bond], platform: str, driven: set[str], normal: Array | None
) -> Limb:
    """Return the leg along a path to the platform.

    Args:
        tree: Links, joints and loops.
        path: From the root to a link of the platform's body.
        platform: Link whose frame is the platform's.
        driven: Names of active joints.
        normal: Of a planar mechanism, in the root's frame.
    """
    end = path[-1].far if path else tree.root
    joints = tuple(_chain(tree, path, normal) + _rigid(tree, end, platform))
    last = _last_turns(joints, driven, 3 if normal is None else 1)
    if not last:
        return Limb(joints)
    frames = list(accumulate((j.placement.origin() for j in joints[last[0] :]), np.matmul))
    turned = [frames[i - last[0]] for i in last]
    origins = np.stack([frame[:3, 3] for frame in turned])
    axes = np.stack([frame[:3, :3] @ joints[i].axis for frame, i in zip(turned, last, strict=True)])
    centre = _meeting_point(origins, axes, tree.slack) if normal is None else origins[0]
    if centre is None:
        return Limb(joints)
    on_platform = (np.linalg.inv(frames[-1]) @ np.append(centre, 1.0))[:3]
    first = joints[last[0]]
    stem = first.name.removesuffix("_x")
    if [joints[i].name for i in last] == [f"{stem}_{axis}" for axis in "xyz"]:
        first = replace(first, name=stem)
    point = _point(tree, end, platform, on_platform)
    return Limb(_to_point(joints[: last[0]], first, centre), point)


def _last_turns(joints: Sequence[Joint], driven: set[str], count: int) -> list[int]:
    """Return where the last joints that move are, if they are passive turns, and others precede."""
    moving = [i for i, joint in enumerate(joints) if joint.kind != "fixed"]
    last = moving[-count:]
    passive = [joints[i].kind == "revolute" and joints[i].name not in driven for i in last]
    return last if len(moving) > count and all(passive) else []


def _meeting_point(origins: Array, axes: Array, slack: float) -> Array | None:
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


def _to_point(joints: Sequence[Joint], dropped: Joint, centre: Array) -> tuple[Joint, ...]:
    """Return a leg's joints up to a point, in the frame that carries the dropped joint."""
    if joints and joints[-1].kind == "fixed" and not centre.any():
        return tuple(joints)  # the point is where this one already is
    x, y, z = map(float, centre)
    return (*joints, Joint(dropped.name, "fixed", Placement((), (x, y, z), dropped.placement.rpy)))


def _point(tree: Tree, link: str, platform: str, place: Array) -> Joint:
    """Return the platform's point: by the file's own frame if it has one there."""
    frames = _rigid(tree, platform, link)
    if len(frames) == 1 and np.abs(np.array(frames[0].placement.xyz) - place).max() <= 1e-12:
        return frames[0]
    x, y, z = (float(v) + 0.0 for v in place)
    return Joint("point", "fixed", Placement((), (x, y, z)))


def point_platform(tree: Tree, path: LegPath, driven: set[str], normal: Array) -> tuple[Limb, Limb]:
    """Return the two legs of a planar loop whose platform is a point of it, as of a five-bar.

    It is where the loop parts into two legs of two joints, one of them driven.

    Raises:
        MechanismError: there is no such point.
    """
    names = [bond.name for bond in path]
    sides = (set(names[:2]), set(names[3:]))
    if len(path) != 5 or names[2] in driven or any(len(side & driven) != 1 for side in sides):
        raise MechanismError(
            f"{tree.source}: one loop of {len(path)} joints ({', '.join(names)}; driven: "
            f"{', '.join(n for n in names if n in driven) or 'none'}) has no platform that can be "
            "recognised; name it with --platform LINK (of a five-bar with a drive in either leg it "
            "is the point of the middle joint)"
        )
    limbs = []
    for side in (path, tuple(bond.reversed() for bond in reversed(path))):
        joints = _chain(tree, side[:3], normal)
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
