"""A tree with loops as a graph of rigid bodies; legs are its ways from the base to the platform.

Links that are fixed to each other, or by a loop that closes a frame, are one body. Joints and loops
that close a point are bonds between bodies. A parallel mechanism is a graph whose bodies lie on
ways from the base to one more body in which all ways meet: the platform.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

from pincal.errors import MechanismError
from pincal.formats.trees.tree import Edge, Loop, Tree, listed


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
