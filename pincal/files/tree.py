"""Trees of links and joints, with loops, as files of other programs define them.

Joints of the tree and closures of loops are edges of one graph, which are passed from parent to
child or back. A leg is a route through the graph between base and platform.
"""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from difflib import get_close_matches

import numpy as np

from pincal.errors import MechanismError
from pincal.model import Closing, Follows, Joint, Placement
from pincal.model.checks import listed
from pincal.types import Array


@dataclass(frozen=True)
class Edge:
    """A joint between two links, or the closure of a loop, where a place on each link meets."""

    joint: Joint
    """Joint placed on the parent; fixed if the edge closes a loop."""
    parent: str
    child: str
    at_child: Placement = field(default_factory=Placement)
    """Place of the closure on the child, for a loop."""
    closes: Closing = "frame"
    """Whether whole frames meet or only their origins, as in a ball joint, for a loop."""

    @property
    def moves(self) -> bool:
        """Whether the links can move relative to each other."""
        return self.closes == "point" or self.joint.kind != "fixed"


Step = tuple[Edge, bool]
"""An edge of a route, and whether it is passed from its parent to its child."""


@dataclass(frozen=True)
class Tree:
    """Links and joints with one root, closures of loops, and the names of driven joints."""

    name: str
    source: str
    """The file, for messages."""
    root: str
    """Link from which legs start: the file's root, or another link that is the base."""
    edges: tuple[Edge, ...]
    loops: tuple[Edge, ...] = ()
    active: tuple[str, ...] = ()
    """Names of the joints with a drive."""
    platform: str | None = None
    """Link of the platform, if the file names it."""
    refused: Mapping[str, str] = field(default_factory=dict)
    """Messages, by name of joint, why it cannot be part of a leg; raised only if it is."""
    remarks: Mapping[str, str] = field(default_factory=dict)
    """Messages, by name of joint, to log if it is part of a leg."""
    slack: float = 0.0
    """Displacement of frames by digits that were cut off, over a leg's size, and [rad]."""

    @property
    def fixed(self) -> list[Edge]:
        """Edges, and loops, that do not move."""
        return [edge for edge in (*self.edges, *self.loops) if not edge.moves]

    @property
    def links(self) -> tuple[str, ...]:
        """Names of the links, root first."""
        children, parents = ([getattr(e, end) for e in self.edges] for end in ("child", "parent"))
        return tuple(dict.fromkeys((self.root, *children, *parents)))

    def link(self, name: str, purpose: str) -> str:
        """Return a link's name, given the link or the joint that carries it."""
        if name in self.links:
            return name
        for edge in self.edges:
            if edge.joint.name == name:
                return edge.child
        nearest = get_close_matches(name, self.links, len(self.links), 0.0)
        raise MechanismError(
            f"{self.source}: no frame named {name!r} for {purpose}; it has {listed(nearest)}"
        )

    def check_joints(self, names: Iterable[str]) -> None:
        """Raise if joints cannot be part of a leg or an arm."""
        for name in names:
            if name in self.refused:
                raise MechanismError(self.refused[name])

    @property
    def geared(self) -> set[str]:
        """Names of joints that follow others, and of their leaders."""
        followers = [edge.joint for edge in self.edges if edge.joint.follows]
        return {name for joint in followers for name in (joint.name, joint.leader.joint)}

    def edges_to(self, links: Iterable[str]) -> list[Edge]:
        """Return the edges on the routes from the root to some links, in the file's order."""
        ways = [route(self.edges, self.root, link) for link in links]
        needed = {edge.child for way in ways for edge, _ in way}
        return [edge for edge in self.edges if edge.child in needed]

    def pose_at_zero(self, link: str) -> Array:
        """Return a link's pose with all joints of the tree at zero, ``T_root_link``, (4, 4)."""
        T_root_link = np.eye(4)
        for edge, forward in route(self.edges, self.root, link):
            origin = edge.joint.placement.origin()
            T_root_link = T_root_link @ (origin if forward else np.linalg.inv(origin))
        return T_root_link


def route(edges: Iterable[Edge], start: str, goal: str) -> list[Step]:
    """Return the shortest route from one link to another along some edges."""
    around: dict[str, list[tuple[str, Step]]] = {}
    for edge in edges:
        around.setdefault(edge.parent, []).append((edge.child, (edge, True)))
        around.setdefault(edge.child, []).append((edge.parent, (edge, False)))
    routes: dict[str, list[Step]] = {start: []}
    ahead = [start]
    while goal not in routes:
        link = ahead.pop(0)
        for neighbour, step in around.get(link, ()):
            if neighbour not in routes:
                routes[neighbour] = [*routes[link], step]
                ahead.append(neighbour)
    return routes[goal]


def hung(edges: Iterable[Edge], last: str) -> tuple[list[Joint], dict[str, str]]:
    """Return the joints of a tree's edges with their parents, and the joint that carries each link.

    Parents come before children, otherwise in the order of the edges; link ``last`` comes last.
    """
    waiting, joints, carriers = list(edges), list[Joint](), dict[str, str]()
    waiting.sort(key=lambda edge: edge.child == last)
    while waiting:
        ahead = {edge.child for edge in waiting}
        edge = next(edge for edge in waiting if edge.parent not in ahead)
        waiting.remove(edge)
        parent, before = carriers.get(edge.parent, ""), joints[-1].name if joints else ""
        joints.append(edge.joint if parent == before else replace(edge.joint, parent=parent))
        carriers[edge.child] = edge.joint.name
    return joints, carriers


def with_ranges(tree: Tree) -> Tree:
    """Return a tree whose prismatic joints all have limits, by default the length of the tree."""
    placed = [edge.joint.placement.xyz for edge in tree.edges]
    reach = max(float(np.linalg.norm(placed, axis=1).sum()) if placed else 0.0, 1.0)
    edges, remarks = list(tree.edges), dict(tree.remarks)
    for i, edge in enumerate(edges):
        joint = edge.joint
        if joint.kind == "prismatic" and not np.isfinite(joint.lower):
            edges[i] = replace(edge, joint=replace(joint, lower=-reach, upper=reach))
            remarks[joint.name] = (
                f"{joint.name!r} slides without a range in the file; ±{reach:.3g} m is assumed"
            )
    return replace(tree, edges=tuple(edges), remarks=remarks)


def coupled(tree: Tree) -> Tree:
    """Return a tree in which every follower follows an independent joint, a driven one if any.

    Joints that follow each other are one freedom, within the limits of all if these overlap. Of
    several drives the first has the reading. Followers of an absent joint follow the first of them.
    """
    joints = {edge.joint.name: edge.joint for edge in tree.edges}
    laws, led = {name: _followed(joints, name) for name in joints}, set[str]()
    for leader in {laws[name].joint for name in tree.geared & joints.keys()}:
        group = [name for name in joints if laws[name].joint == leader]
        driven = [name for name in group if name in tree.active]
        first = min(group, key=(*driven, leader, *group).index)
        law_of_first, ends, led = laws[first], list[Array](), led | {*group} - {first}
        for name in group:
            ratio = laws[name].ratio / law_of_first.ratio
            law = Follows(first, ratio, laws[name].offset - ratio * law_of_first.offset)
            limits = np.array([joints[name].lower, joints[name].upper])
            ends.append(np.sort((limits - law.offset) / ratio))
            joints[name] = replace(joints[name], follows=None if name == first else law)
        lower, upper = np.max(ends, axis=0)[0], np.min(ends, axis=0)[1]
        if lower < upper:
            joints[first] = replace(joints[first], lower=float(lower), upper=float(upper))
    edges = tuple(replace(edge, joint=joints[edge.joint.name]) for edge in tree.edges)
    active = tuple(name for name in tree.active if name not in led)
    return replace(tree, edges=edges, active=active)


def _followed(joints: Mapping[str, Joint], name: str) -> Follows:
    """Return the law by which a joint follows an independent joint (or itself) or an absent one."""
    law = Follows(name)
    for _ in joints:
        if law.joint not in joints or (ahead := joints[law.joint].follows) is None:
            return law
        offset = law.ratio * ahead.offset + law.offset
        law = Follows(ahead.joint, law.ratio * ahead.ratio, offset)
    raise MechanismError(f"joint {name!r} follows itself")


def turns(joint: Joint, parent: str, child: str, axes: str) -> tuple[Edge, ...]:
    """Return edges that turn about axes of a joint's frame in order; capitals slide along them."""
    edges: list[Edge] = []
    for letter in axes:
        axis, slides = letter.lower(), letter.isupper()
        single = Joint(
            f"{joint.name}_{'p' * slides}{axis}",
            "prismatic" if slides else "revolute",
            Placement() if edges else joint.placement,
            (float(axis == "x"), float(axis == "y"), float(axis == "z")),
            -np.inf,
            np.inf,
        )
        edges.append(Edge(single, edges[-1].child if edges else parent, f"{child}_{single.name}"))
    return (*edges[:-1], replace(edges[-1], child=child))


def at_home(edges: tuple[Edge, ...], home: Mapping[str, float]) -> tuple[Edge, ...]:
    """Return edges with new home positions of joints, by name."""
    joints = ((edge.joint, home.get(edge.joint.name, edge.joint.home)) for edge in edges)
    moved = (replace(joint, home=float(position)) for joint, position in joints)
    return tuple(replace(edge, joint=joint) for edge, joint in zip(edges, moved, strict=True))


def root_of(edges: Sequence[Edge], links: Sequence[str], source: str) -> str:
    """Return the root: the only link that no joint carries."""
    children, joints = [edge.child for edge in edges], [edge.joint.name for edge in edges]
    for twice in Counter(joints) - Counter(set(joints)):
        raise MechanismError(f"{source}: two joints are called {twice!r}")
    for twice in Counter(children) - Counter(set(children)):
        raise MechanismError(
            f"{source}: link {twice!r} is the child of two joints; the file must be a tree, whose "
            "loops are closed by constraints"
        )
    roots = [link for link in links if link not in set(children)]
    if not links:
        raise MechanismError(f"{source}: no joint connects its links; import a model with joints")
    if len(roots) != 1:
        raise MechanismError(f"{source}: {len(roots)} root links ({listed(roots)}); expected one")
    lost, reached = {link for edge in edges for link in (edge.parent, edge.child)}, {roots[0]}
    while reached:
        lost -= reached
        reached = {edge.child for edge in edges if edge.parent in reached}
    if lost:
        raise MechanismError(
            f"{source}: {listed(sorted(lost))} cannot be reached from the root {roots[0]!r}"
        )
    return roots[0]
