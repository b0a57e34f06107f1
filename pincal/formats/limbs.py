"""Limbs: pieces of the graph of bodies, cut at base and platform; each becomes a leg with ends.

The spanning tree of a piece, from the base, gives the leg's joints. Each bond with the platform is
an end, and so is each bond that closes a loop within. An end whose last joints are passive and meet
in a point (three revolute axes; in the plane, one) closes a point; any other closes a frame.
"""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate

import numpy as np
from scipy.sparse.csgraph import connected_components
from scipy.spatial.transform import Rotation

from pincal.errors import MechanismError
from pincal.files.tree import Edge, Step, Tree, route
from pincal.formats.arm import TURNED, joints_along
from pincal.model import Closing, Joint, Leg, Placement, Sensor, placement_of
from pincal.model.checks import ALIKE, EXACT, listed
from pincal.model.joint import End
from pincal.model.platform import turns_in_series
from pincal.types import Array

_SPINS = 1e-7  # singular value, of motions over the size, below which a motion moves no end
_IN_EACH_LEG = ([0, 3], [0, 4], [1, 3], [1, 4])  # drives among five joints of a loop


@dataclass(frozen=True)
class Limb:
    """One piece between base and platform, as routes from the base."""

    ends: list[list[Step]]
    """Routes to the platform, one or more."""
    loops: list[tuple[list[Step], list[Step]]]
    """Two routes to a body of the limb: over the bond that closes the loop, and along the tree."""

    @property
    def steps(self) -> list[Step]:
        """Steps over all bonds of the limb, each once."""
        ways = [*self.ends, *(way for loop in self.loops for way in loop)]
        return list(dict.fromkeys(step for way in ways for step in way))


def limbs_of(tree: Tree, platform: str | None) -> tuple[list[Limb], str | None, list[str]]:
    """Return the limbs between base and platform, the platform's link, and joints left out.

    With a single loop and no platform, the link is None, and one route leads back to the base.
    """
    graph, named = _Graph(tree), platform is not None
    base = graph.body[tree.root]
    platform = platform or graph.outermost(base)
    loose = graph.prune({base} | ({graph.body[platform]} if platform else set()))
    platform = platform or graph.outermost(base)
    if not graph.bonds:
        raise MechanismError(
            "its joints form no loop; list the closures (closed_loop of a YAML file, see --loops; "
            "<equality> of MJCF), or import a serial arm with --tip LINK"
        )
    goal = graph.platform(base, platform)
    limbs = [Limb([graph.round()], [])] if goal == base else graph.limbs(base, goal)
    bonds = [bond for limb in limbs for bond, _ in limb.steps]
    lost = [bond.joint.name for bond in graph.bonds if bond not in bonds]
    if lost and not named:
        raise MechanismError(
            f"{listed(lost)} lie on no route from the base {tree.root!r} to the platform "
            f"{graph.named(goal)}; is another link the base or the platform (--base, --platform)?"
        )
    tree.check_joints(sorted(bond.joint.name for bond in bonds))
    return limbs, platform or (None if goal == base else goal), [*loose, *lost]


class _Graph:
    """Graph of bodies, which are links fixed to each other, and bonds, the edges that move."""

    def __init__(self, tree: Tree) -> None:
        self.tree = tree
        #: For each link, the link that represents its body: the first one in the tree.
        self.body = {link: link for link in tree.links}
        edges = (*tree.edges, *tree.loops)
        for edge in tree.fixed:
            first, merged = sorted(self.ends(edge), key=tree.links.index)
            self.body = {k: first if name == merged else name for k, name in self.body.items()}
        self.bonds = [edge for edge in edges if edge.moves]
        for bond in self.bonds:
            if self.body[bond.parent] == self.body[bond.child]:
                raise MechanismError(
                    f"{bond.joint.name!r} joins {bond.parent!r} and {bond.child!r}, which are "
                    "fixed to each other; check the loops that close whole frames"
                )

    def ends(self, bond: Edge) -> tuple[str, str]:
        """Return the two bodies that a bond joins."""
        return self.body[bond.parent], self.body[bond.child]

    def degrees(self) -> Counter[str]:
        """Return the number of bonds of each body."""
        return Counter(body for bond in self.bonds for body in self.ends(bond))

    def named(self, body: str) -> str:
        """Return the names of a body's links, for a message."""
        return "/".join(repr(link) for link in self.tree.links if self.body[link] == body)

    def outermost(self, base: str) -> str | None:
        """Return the link ``platform``, or the only outermost link, such as a foot or a tool.

        Its body has bonds, but the link carries nothing and closes no loop; None if not unique.
        """
        used = {edge.parent for edge in self.tree.edges}
        used |= {name for edge in self.tree.loops for name in (edge.parent, edge.child)}
        moved = self.degrees().keys() - {base}
        ends = [link for link in self.tree.links if link not in used and self.body[link] in moved]
        if self.body.get("platform", base) != base:
            return "platform"
        return ends[0] if len({self.body[link] for link in ends}) == 1 else None

    def prune(self, keep: set[str]) -> list[str]:
        """Remove the bonds that lie in no loop, and return their joints' names."""
        loose: list[str] = []
        while leaves := {name for name, count in self.degrees().items() if count == 1} - keep:
            hanging = [bond for bond in self.bonds if leaves.intersection(self.ends(bond))]
            loose += [bond.joint.name for bond in hanging]
            self.bonds = [bond for bond in self.bonds if bond not in hanging]
        return loose

    def platform(self, base: str, link: str | None) -> str:
        """Return the platform's body: where routes meet, a four-bar's coupler, or else the base.

        By default it is the only body, beside the base, with more than two bonds.
        """
        degrees = self.degrees()
        if link is not None:
            body = self.body[link]
            if body == base or not degrees[body]:
                fault = "it is fixed to the base" if body == base else "no loop moves it"
                raise MechanismError(f"{link!r} cannot be the platform: {fault}")
            return body
        meeting = [name for name, count in degrees.items() if count > 2 and name != base]
        if len(meeting) > 1:
            places = listed(self.named(name) for name in meeting)
            raise MechanismError(
                f"routes meet in {len(meeting)} bodies ({places}), each of which may be the "
                "platform: name it with --platform LINK, or name another base (--base)"
            )
        return meeting[0] if meeting else self.coupler(base)

    def coupler(self, base: str) -> str:
        """Return the body of a four-bar that no joint connects to the base, or else the base."""
        on_base = [bond for bond in self.bonds if base in self.ends(bond)]
        slides = any(bond.joint.kind == "prismatic" for bond in self.bonds)
        if slides or len(self.bonds) != 4 or not on_base:
            return base
        tied = {body for bond in on_base for body in self.ends(bond)}
        return next(body for body in self.degrees() if body not in tied)

    def round(self) -> list[Step]:
        """Return the only loop, as a route from the base back to it."""
        root = self.tree.root
        first = next((b for b in self.bonds if self.body[root] in self.ends(b)), None)
        if first is None:
            raise MechanismError(
                f"the base {root!r} lies in no loop; is another link the base (--base)?"
            )
        forward = self.body[first.parent] == self.body[root]
        passable = [*self.tree.fixed, *(bond for bond in self.bonds if bond is not first)]
        steps = route(passable, first.child if forward else first.parent, root)
        return [(first, forward), *(step for step in steps if step[0].moves)]

    def limbs(self, base: str, goal: str) -> list[Limb]:
        """Return the limbs between two bodies: the pieces of the graph after cuts there.

        A joint that follows another joint is in the same piece.
        """
        touching = [
            [
                not {base, goal}.issuperset({*self.ends(first)}.intersection(self.ends(second)))
                or first.joint.leader.joint == second.joint.leader.joint
                for second in self.bonds
            ]
            for first in self.bonds
        ]
        count, piece_of = connected_components(np.array(touching), directed=False)
        pieces = [
            [bond for bond, place in zip(self.bonds, piece_of, strict=True) if place == piece]
            for piece in range(count)
        ]
        limbs = [self.limb(bonds, base, goal) for bonds in pieces]
        return [limb for limb in limbs if limb.ends]

    def limb(self, bonds: Sequence[Edge], base: str, goal: str) -> Limb:
        """Return the limb of a piece's bonds; it has no ends if it is not between base and goal.

        The tree grows along joints first, and along loop closures only where it must.
        """
        ways: dict[str, list[Step]] = {base: []}
        limb, unused = Limb([], []), sorted(bonds, key=self.tree.loops.__contains__)
        while True:
            joined = [(bond, *self.ends(bond)) for bond in unused]
            grows = [(b, p in ways) for b, p, c in joined if (p in ways) != (c in ways)]
            grows = [(b, f) for b, f in grows if goal not in self.ends(b)] or grows
            if not grows:
                break
            bond, forward = grows[0]
            start, end = self.ends(bond)[:: 1 if forward else -1]
            unused.remove(bond)
            if end == goal:
                limb.ends.append([*ways[start], (bond, forward)])
            else:
                ways[end] = [*ways[start], (bond, forward)]
        for bond in unused if limb.ends else ():
            parent, child = self.ends(bond)
            limb.loops.append(([*ways[parent], (bond, True)], ways[child]))
        return limb


def leg_of(tree: Tree, limb: Limb, platform: str, normal: Array | None) -> Leg:
    """Return the leg of a limb, without parameters.

    ``normal`` is that of its plane in the root's frame, or None. If a route closes the platform's
    frame, the platform is a link of the leg, on which further routes close loops within.
    """
    closed = [_platform_end(tree, steps, platform, normal) for steps in limb.ends]
    loops, frames = list(limb.loops), [end[2] == "frame" for end in closed]
    if any(frames):
        first = frames.index(True)
        loops += [(steps, limb.ends[first]) for steps in limb.ends if steps is not limb.ends[first]]
        closed = [closed[first]]
    (way, met, closes), *further = closed
    joints: list[Joint] = []
    ends = [End(_hang(joints, branch), point, closing) for branch, point, closing in further]
    for near, far in loops:
        ends.append(_loop_end(tree, near, far, joints, normal))
    if way[-1].kind != "fixed" or way[-1].name in (joint.name for joint in joints):
        way = [*way, Joint("tip", "fixed")]
    _hang(joints, way)
    sensors = _sensors(tree, joints)
    return Leg("limb", tuple(joints), sensors, (), met, closes, ends=tuple(ends), settled=True)


def spins_of(tree: Tree, leg: Leg) -> dict[str, Array]:
    """Return rotations, (4, 4), by name of ball, after which links spin idly about z of its frame.

    Held is then the spin alone: the other two axes turn the link into any direction.
    """
    children = {edge.joint.name: edge.child for edge in tree.edges}
    places, motions = leg.motions()
    names = [leg.moving[i].name for i in leg.passive]
    vectors, sizes, _ = np.linalg.svd(motions[:, leg.passive])
    null = vectors[:, :, int((sizes[0] > _SPINS).sum()) :]
    R, spins = leg.link_placements(places)[..., :3, :3], dict[str, Array]()
    for ball in {name.removesuffix("_x") for name in names}:
        x, y, z = series = axes_of(ball)
        drawn = x not in children or children[x] == f"{children.get(z)}_{x}"  # see ``turns``
        if not drawn or [name for name in names if name in series] != series:
            continue
        turns, share, _ = np.linalg.svd(null[:, [names.index(name) for name in series]])
        axes = np.stack([R[:, leg.index(name), :, k] for k, name in enumerate((x, y, z))], axis=2)
        along = R[:, leg.index(z)].mT @ axes @ turns[:, :, :1]  # in the frame after the ball
        along *= np.sign(along[:, 2:]) / np.linalg.norm(along, axis=1, keepdims=True)
        turn = np.eye(4)
        turn[:3, :3] = onto_normal(along[0, :, 0])
        steady = share.min(initial=1.0) * null.size > _SPINS and np.ptp(along, axis=0).max() < ALIKE
        if steady and not np.array_equal(turn, np.eye(4)):
            spins[ball] = turn
    return spins


def axes_of(ball: str) -> list[str]:
    """Return the names of the joints in series that a ball is."""
    return [f"{ball}_{axis}" for axis in "xyz"]


def turned(tree: Tree, spins: Mapping[str, Array]) -> Tree:
    """Return a tree in which the frames of some balls are turned by rotations, (4, 4), by name."""
    edges = list[Edge]()
    homes = {edge.joint.name: edge.joint for edge in tree.edges}
    for edge in tree.edges:
        ball, k = edge.joint.name[:-2], "_x_y_z".find(edge.joint.name[-2:]) // 2
        if ball not in spins or k < 0:
            edges.append(edge)
            continue
        turn, joint = spins[ball], edge.joint
        moves = [homes[name].motion(np.array([homes[name].home]))[0] for name in axes_of(ball)]
        home = turn.T @ moves[0] @ moves[1] @ moves[2] @ turn
        joint = replace(joint, home=float(turns_in_series(home[None, :3, :3])[0, k]))
        edges.append(replace(edge, joint=_turned(joint, turn) if k == 0 else joint))
        if k == 2:
            link = f"{edge.child}_{ball}"
            edges[-1] = replace(edges[-1], child=link)
            back = Joint(f"{ball}{TURNED}", "fixed", placement_of(turn.T))
            edges.append(Edge(back, link, edge.child))
    loops = list(tree.loops)
    for i, loop in enumerate(loops):
        if (turning := spins.get(loop.joint.name)) is not None:
            second = placement_of(loop.at_child.origin() @ turning)
            loops[i] = replace(loop, joint=_turned(loop.joint, turning), at_child=second)
    return replace(tree, edges=tuple(edges), loops=tuple(loops))


def _turned(joint: Joint, turn: Array) -> Joint:
    return replace(joint, placement=placement_of(joint.placement.origin() @ turn))


def _sensors(tree: Tree, joints: Iterable[Joint]) -> tuple[Sensor, ...]:
    return tuple(Sensor(joint.name) for joint in joints if joint.name in tree.active)


def _hang(joints: list[Joint], way: Iterable[Joint]) -> str:
    """Add the joints of a route that are not yet in ``joints``; return its last joint's name."""
    parent = ""
    for joint in way:
        if all(joint.name != hung.name for hung in joints):
            before = joints[-1].name if joints else ""
            joints.append(joint if parent == before else replace(joint, parent=parent))
        parent = joint.name
    return parent


def _loop_end(
    tree: Tree, near: list[Step], far: list[Step], joints: list[Joint], normal: Array | None
) -> End:
    """Return the end that closes a loop within a leg; both routes are added to its joints.

    A planar loop closes x and y of a frame whose z is the normal of its plane.
    """
    stem = sum(1 for a, b in zip(near, far, strict=False) if a == b)
    plane = plane_of(tree, [*near[stem:], *far[stem:]])
    bond, forward = near[-1]
    link = bond.child if forward else bond.parent
    way, place = _to_point(tree, _joints_to(tree, near, link, plane), plane)
    onto = _joints_to(tree, far, link, plane)
    hook = np.eye(4)
    if place is not None:
        hook[:3, 3] = place
    closes: Closing | tuple[str, ...] = "frame" if place is None else "point"
    if plane is not None and normal is None:
        hook[:3, :3] = onto_normal(tree.pose_at_zero(link)[:3, :3].T @ plane)
        closes = ("x", "y") if place is not None else ("x", "y", "rz")
    if not np.array_equal(hook, np.eye(4)) or not onto or onto[-1].kind != "fixed":
        if place is None:
            way = [*way, Joint(f"{bond.joint.name}_end", "fixed", placement_of(hook))]
        onto = [*onto, Joint(f"{bond.joint.name}_hook", "fixed", placement_of(hook))]
    tip = _hang(joints, way)
    return End(tip, _hang(joints, onto), closes)


def _platform_end(
    tree: Tree, path: Sequence[Step], platform: str, normal: Array | None
) -> tuple[list[Joint], Joint, Closing]:
    """Return the joints along a route to the platform, the platform point, and the closure."""
    joints, place = _to_point(tree, _joints_to(tree, path, platform, normal), normal)
    if place is None:
        return joints, Joint("point", "fixed"), "frame"
    return joints, _point(tree, platform, path[-1], place), "point"


def _joints_to(
    tree: Tree, path: Sequence[Step], link: str | None, normal: Array | None
) -> list[Joint]:
    """Return the joints along a path from the root to a link, by default where the path ends."""
    steps, reached = list[Step](), tree.root
    for edge, forward in path:
        start, end = (edge.parent, edge.child)[:: 1 if forward else -1]
        steps += [*route(tree.fixed, reached, start), (edge, forward)]
        reached = end
    steps += route(tree.fixed, reached, link or reached)
    return joints_along(tree, steps, normal)


def _to_point(
    tree: Tree, joints: list[Joint], normal: Array | None
) -> tuple[list[Joint], Array | None]:
    """Return a route's joints without the last passive ones, if these meet in a point, and it.

    The point is in the last frame, shape (3,), [m]; None if the route closes a frame.
    """
    count = 3 if normal is None else 1
    moving = [i for i, joint in enumerate(joints) if joint.kind != "fixed"]
    last, moved = moving[-count:], tree.geared.union(tree.active)
    passive = all(joints[i].kind == "revolute" and joints[i].name not in moved for i in last)
    if len(moving) <= count or not passive:
        return joints, None
    frames = np.array([*accumulate((j.placement.origin() for j in joints[last[0] :]), np.matmul)])
    turned = frames[np.subtract(last, last[0])]
    origins = turned[:, :3, 3]
    axes = np.einsum("kij,kj->ki", turned[:, :3, :3], [joints[i].axis for i in last])
    centre = _meeting_point(origins, axes, tree.slack) if normal is None else origins[0]
    if centre is None:
        return joints, None
    place = (np.linalg.inv(frames[-1]) @ np.append(centre, 1.0))[:3] + 0.0
    first = joints[last[0]]
    stem = first.name.removesuffix("_x")
    if [joints[i].name for i in last] == axes_of(stem):
        first = replace(first, name=stem)
    return _up_to(joints[: last[0]], first, centre), place


def _point(tree: Tree, platform: str, last: Step, place: Array) -> Joint:
    """Return the platform point at a place; if the file has a frame there, it is that frame."""
    edge, forward = last
    last_link = edge.child if forward else edge.parent
    frames = joints_along(tree, route(tree.fixed, platform, last_link))
    if len(frames) == 1 and np.abs(frames[0].placement.xyz - place).max() <= 1e-12:
        return frames[0]
    x, y, z = place.tolist()
    return Joint("point", "fixed", Placement((), (x, y, z)))


def _meeting_point(origins: Array, axes: Array, slack: float) -> Array | None:
    """Return the point, shape (3,), in which three skew axes meet; None if they do not."""
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


def _up_to(joints: Sequence[Joint], dropped: Joint, centre: Array) -> list[Joint]:
    """Return a leg's joints up to a point, in the frame that carries the dropped joint."""
    if joints and joints[-1].kind == "fixed" and not centre.any():
        return list(joints)  # the last joint is already at the point
    x, y, z = map(float, centre)
    placement = Placement((), (x, y, z), dropped.placement.rpy)
    return [*joints, Joint(dropped.name, "fixed", placement)]


def point_platform(tree: Tree, path: Sequence[Step], normal: Array | None) -> list[Leg]:
    """Return two legs of two joints, one driven, that meet in a point of a planar loop."""
    if normal is None:
        raise MechanismError(
            "one loop, in which any link may be the platform; name it with --platform LINK"
        )
    legs: list[Leg] = []
    names, middle = [edge.joint.name for edge, _ in path], path[len(path) // 2][0]
    drives = [name for name in names if name in tree.active]
    places = list(map(names.index, drives))
    geared = tree.geared.intersection(names)
    if geared or len(path) != 5 or middle.joint.kind == "prismatic" or places not in _IN_EACH_LEG:
        raise MechanismError(
            f"one loop of {len(path)} joints ({', '.join(names)}; driven: "
            f"{', '.join(drives) or 'none'}) has no platform that can be recognised; name it with "
            "--platform LINK (of a five-bar with a drive in either leg it is the point of the "
            "middle joint)"
        )
    for side in (path, [(edge, not forward) for edge, forward in reversed(path)]):
        joints = _joints_to(tree, side[:3], None, normal)
        last = max(i for i, joint in enumerate(joints) if joint.kind != "fixed")
        centre = np.array(joints[last].placement.xyz)
        to_point = _up_to(joints[:last], joints[last], centre)
        point, sensors = Joint("point", "fixed"), _sensors(tree, to_point)
        legs.append(Leg("limb", tuple(to_point), sensors, (), point))
    return legs


def plane_of(tree: Tree, steps: Iterable[Step]) -> Array | None:
    """Return the normal of the plane in which all joints move, in the root's frame, shape (3,)."""
    axes: dict[str, list[Array]] = {"revolute": [], "prismatic": []}
    for edge in (edge for edge, _ in steps if edge.closes == "frame"):
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


def onto_normal(normal: Array, slack: float = 0.0) -> Array:
    """Return the smallest rotation of z onto a unit vector, (3, 3); the identity within a slack."""
    if normal[2] > 1.0 - EXACT or np.hypot(normal[0], normal[1]) < slack:
        return np.eye(3)
    if normal[2] < EXACT - 1.0:
        return np.diag([1.0, -1.0, -1.0])
    return Rotation.align_vectors(normal, (0.0, 0.0, 1.0))[0].as_matrix()
