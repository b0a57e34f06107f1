"""What neighbours' files have in common: a tree of links and joints, and what closes its loops."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from pincal.errors import MechanismError
from pincal.model.leg import Closing, Joint
from pincal.model.placement import Placement

#: Ends of the names of the six freedoms of a link that floats, in order (see ``turns``).
FREE = ("px", "py", "pz", "x", "y", "z")


@dataclass(frozen=True)
class Edge:
    """A joint of the tree, between two links."""

    joint: Joint
    parent: str
    child: str


@dataclass(frozen=True)
class Spot:
    """A frame on a link."""

    link: str
    placement: Placement = field(default_factory=Placement)


@dataclass(frozen=True)
class Loop:
    """A constraint that closes a loop: two spots meet, their origins or their whole frames."""

    name: str
    first: Spot
    second: Spot
    closes: Closing


@dataclass(frozen=True)
class Tree:
    """Links and joints with one root, loops, and which joints are driven."""

    name: str
    source: str
    """The file, for messages."""
    root: str
    edges: tuple[Edge, ...]
    loops: tuple[Loop, ...]
    active: tuple[str, ...]
    """Names of the joints with a drive."""
    platform: str | None = None
    """Link of the platform, if the file says it."""
    homed: bool = False
    """Whether the file says the joints' home positions, so that they need not be zero."""
    refused: Mapping[str, str] = field(default_factory=dict)
    """Why joints cannot be part of a leg, by name: refused where one is, and only there."""
    remarks: Mapping[str, str] = field(default_factory=dict)
    """What is to be said of joints that are part of a leg, by name."""
    slack: float = 0.0
    """What digits that were cut off may have moved frames by, of a leg's size and [rad]."""

    @property
    def links(self) -> tuple[str, ...]:
        """Names of the links, root first."""
        return (self.root, *(edge.child for edge in self.edges))

    def link(self, name: str, purpose: str) -> str:
        """Return a link's name, of a link or of the joint that carries it.

        Raises:
            MechanismError: there is none.
        """
        if name in self.links:
            return name
        for edge in self.edges:
            if edge.joint.name == name:
                return edge.child
        raise MechanismError(
            f"{self.source}: no frame named {name!r} for {purpose}; it has {listed(self.links)}"
        )

    def check_joints(self, names: Iterable[str]) -> None:
        """Raise if a leg or an arm is to have joints that cannot be part of one.

        Raises:
            MechanismError: why the first of them cannot.
        """
        for name in names:
            if name in self.refused:
                raise MechanismError(self.refused[name])


def with_ranges(tree: Tree) -> Tree:
    """Return a tree whose slides all have a range: of those without one, as the tree is long."""
    placed = [edge.joint.placement.xyz for edge in tree.edges]
    reach = max(float(np.linalg.norm(placed, axis=1).sum()) if placed else 0.0, 1.0)
    endless = [
        edge.joint.name
        for edge in tree.edges
        if edge.joint.kind == "prismatic" and not np.isfinite(edge.joint.lower)
    ]
    edges = tuple(
        replace(edge, joint=replace(edge.joint, lower=-reach, upper=reach))
        if edge.joint.name in endless
        else edge
        for edge in tree.edges
    )
    remark = f"slides without a range in the file; ±{reach:.3g} m is taken"
    remarks = {name: f"{name!r} {remark}" for name in endless}
    return replace(tree, edges=edges, remarks=dict(tree.remarks) | remarks)


def turns(joint: Joint, parent: str, child: str, axes: str) -> tuple[Edge, ...]:
    """Return a joint that turns about several axes of its frame, one after the other.

    Args:
        joint: Its name and placement.
        parent: Link that carries it.
        child: Link that it carries.
        axes: Letters of the axes, in order; in capitals, along them.
    """
    edges: list[Edge] = []
    for index, letter in enumerate(axes):
        last = index == len(axes) - 1
        slides, axis = letter.isupper(), letter.lower()
        single = Joint(
            f"{joint.name}_{letter if not slides else 'p' + letter.lower()}",
            "prismatic" if slides else "revolute",
            joint.placement if index == 0 else Placement(),
            (float(axis == "x"), float(axis == "y"), float(axis == "z")),
            -np.inf,
            np.inf,
        )
        link = child if last else f"{child}_{single.name}"
        edges.append(Edge(single, edges[-1].child if edges else parent, link))
    return tuple(edges)


def at_home(edges: tuple[Edge, ...], home: Mapping[str, float]) -> tuple[Edge, ...]:
    """Return edges with other home positions of joints, by name."""
    return tuple(
        replace(edge, joint=replace(edge.joint, home=float(home[edge.joint.name])))
        if edge.joint.name in home
        else edge
        for edge in edges
    )


def root_of(edges: tuple[Edge, ...], links: tuple[str, ...], source: str) -> str:
    """Return the one link that no joint carries.

    Raises:
        MechanismError: there are several or none, or a link hangs on two joints.
    """
    children = [edge.child for edge in edges]
    for child in children:
        if children.count(child) > 1:
            raise MechanismError(
                f"{source}: link {child!r} hangs on two joints; the file must be a tree, whose "
                "loops are closed by constraints"
            )
    roots = [link for link in links if link not in set(children)]
    if len(roots) != 1:
        raise MechanismError(f"{source}: {len(roots)} root links ({listed(roots)}); expected one")
    reached, ahead = {roots[0]}, {edge.parent for edge in edges}
    while True:
        reachable = {edge.child for edge in edges if edge.parent in reached} - reached
        if not reachable:
            break
        reached |= reachable
    if lost := (ahead | set(children)) - reached:
        raise MechanismError(
            f"{source}: {listed(sorted(lost))} cannot be reached from the root {roots[0]!r}"
        )
    return roots[0]


def listed(names: object, limit: int = 12) -> str:
    """Return names in a row, not all of many."""
    every = [str(name) for name in names]  # type: ignore[attr-defined]
    remainder = f" and {len(every) - limit} more" if len(every) > limit else ""
    return (", ".join(every[:limit]) or "none") + remainder
