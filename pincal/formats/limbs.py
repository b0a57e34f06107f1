"""Limbs: the graph of bodies, cut at base and platform, and the joints that lie between these.

A limb whose last joints, all passive, meet in a point of the platform (three revolute axes; in the
plane, one) closes that point; any other closes a frame.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from itertools import accumulate
from typing import TypeAlias

import numpy as np

from pincal.errors import MechanismError
from pincal.files.tree import Edge, Step, Tree, route
from pincal.formats.arm import joints_along
from pincal.model.checks import EXACT, listed
from pincal.model.leg import Joint
from pincal.model.placement import Placement
from pincal.types import Array

_IN_EACH_LEG = ([0, 3], [0, 4], [1, 3], [1, 4])  # drives among five joints of a loop
Limb: TypeAlias = tuple[tuple[Joint, ...], Joint | None]
"""Joints of a leg, and the point of the platform that it closes, if it is no frame."""


def paths_to_platform(
    tree: Tree, platform: str | None = None
) -> tuple[list[list[Step]], str | None, list[str]]:
    """Return what moves on each path from base to platform, a link of it, and joints in no loop.

    The link is None if there is but one loop, and then its one path goes round, back to the base.
    """
    graph = _Graph(tree)
    base = graph.body[tree.root]
    loose = graph.prune({base} | ({graph.body[platform]} if platform else set()))
    if not graph.bonds:
        raise MechanismError(
            "its joints form no loop; list what closes the loops (closed_loop of a YAML file, "
            "<equality> of MJCF), or import a serial arm with --tip LINK"
        )
    goal = graph.platform(base, platform)
    paths = graph.paths(base, goal)
    passed = [edge for path in paths for edge, _ in path]
    tree.check_joints(sorted(edge.joint.name for edge in passed))
    if lost := [bond.joint.name for bond in graph.bonds if bond not in passed]:
        raise MechanismError(
            f"{listed(lost)} lie on no way from the base {tree.root!r} to the platform "
            f"{graph.named(goal)}; expected serial legs between these two. Is another link the "
            "base or the platform (--base, --platform)?"
        )
    return paths, platform or (None if goal == base else goal), loose


class _Graph:
    """Bodies, links that are fixed to each other, and the bonds in which these move."""

    def __init__(self, tree: Tree) -> None:
        self.tree = tree
        #: For each link the link that represents its body: the first one of the tree.
        self.body = {link: link for link in tree.links}
        edges = (*tree.edges, *tree.loops)
        for edge in edges:
            if not edge.moves:
                ends = (self.body[edge.parent], self.body[edge.child])
                first, merged = sorted(ends, key=tree.links.index)
                self.body = {k: first if name == merged else name for k, name in self.body.items()}
        self.bonds = [edge for edge in edges if edge.moves]
        for bond in self.bonds:
            if self.body[bond.parent] == self.body[bond.child]:
                raise MechanismError(
                    f"{bond.joint.name!r} joins {bond.parent!r} and {bond.child!r}, which are "
                    "fixed to each other; look at the loops that close whole frames"
                )

    def ends(self, bond: Edge) -> tuple[str, str]:
        """Return the bodies that a bond joins."""
        return self.body[bond.parent], self.body[bond.child]

    def degrees(self) -> Counter[str]:
        """Return how many bonds each body has."""
        return Counter(body for bond in self.bonds for body in self.ends(bond))

    def named(self, body: str) -> str:
        """Return the links of a body for a message."""
        return "/".join(repr(link) for link in self.tree.links if self.body[link] == body)

    def prune(self, keep: set[str]) -> list[str]:
        """Drop the bonds that lie in no loop, and return their names."""
        loose: list[str] = []
        while leaves := {name for name, count in self.degrees().items() if count == 1} - keep:
            hanging = [bond for bond in self.bonds if leaves.intersection(self.ends(bond))]
            loose += [bond.joint.name for bond in hanging]
            self.bonds = [bond for bond in self.bonds if bond not in hanging]
        return loose

    def platform(self, base: str, link: str | None) -> str:
        """Return the platform's body: where paths meet besides the base, or else the base."""
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
                f"ways meet in {len(meeting)} bodies ({places}); expected one, the platform, and "
                "legs that are serial chains from the base to it. Is another link the base "
                "(--base)? Mechanisms with loops within a leg, or two platforms, cannot be "
                "calibrated"
            )
        return meeting[0] if meeting else base

    def paths(self, base: str, goal: str) -> list[list[Step]]:
        """Return the paths from base to goal, in the order of the bonds; each is passed once."""
        unused = list(self.bonds)
        paths = []
        for bond in self.bonds:
            if bond not in unused or base not in self.ends(bond):
                continue
            path: list[Step] = []
            body, onward = base, [bond]
            while not path or body != goal:
                if len(onward) != 1:
                    names = ", ".join(edge.joint.name for edge, _ in path)
                    raise MechanismError(
                        f"the way {names} from the base leads to {self.named(body)}, where "
                        f"{len(onward)} ways go on; expected a serial chain to the platform "
                        f"{self.named(goal)}"
                    )
                edge = onward[0]
                unused.remove(edge)
                parent, child = self.ends(edge)
                path.append((edge, parent == body))
                body = child if parent == body else parent
                onward = [bond for bond in unused if body in self.ends(bond)]
            paths.append(path)
        return paths


def _joints_to(
    tree: Tree, path: Sequence[Step], link: str | None, normal: Array | None
) -> tuple[Joint, ...]:
    """Return the joints along a path, from the root to a link, or to where the path ends."""
    edge, forward = path[-1]
    passable = [edge for edge in (*tree.edges, *tree.loops) if not edge.moves]
    passable += [edge for edge, _ in path]
    end = link or (edge.child if forward else edge.parent)
    return tuple(joints_along(tree, route(passable, tree.root, end), normal))


def limb_along(
    tree: Tree, path: Sequence[Step], platform: str, driven: set[str], normal: Array | None
) -> Limb:
    """Return the leg along a path to a link of the platform, in a plane if there is a normal."""
    joints = _joints_to(tree, path, platform, normal)
    moving = [i for i, joint in enumerate(joints) if joint.kind != "fixed"]
    count = 3 if normal is None else 1
    last = moving[-count:]
    passive = [joints[i].kind == "revolute" and joints[i].name not in driven for i in last]
    if len(moving) <= count or not all(passive):
        return joints, None
    frames = list(accumulate((j.placement.origin() for j in joints[last[0] :]), np.matmul))
    turned = [frames[i - last[0]] for i in last]
    origins = np.stack([frame[:3, 3] for frame in turned])
    axes = np.stack([frame[:3, :3] @ joints[i].axis for frame, i in zip(turned, last, strict=True)])
    centre = _meeting_point(origins, axes, tree.slack) if normal is None else origins[0]
    if centre is None:
        return joints, None
    place = (np.linalg.inv(frames[-1]) @ np.append(centre, 1.0))[:3] + 0.0
    first = joints[last[0]]
    stem = first.name.removesuffix("_x")
    if [joints[i].name for i in last] == [f"{stem}_{axis}" for axis in "xyz"]:
        first = replace(first, name=stem)
    return _to_point(joints[: last[0]], first, centre), _point(tree, platform, path[-1], place)


def _point(tree: Tree, platform: str, last: Step, place: Array) -> Joint:
    """Return the platform's point at a place: by the file's own frame if it has one there."""
    edge, forward = last
    fixed = [edge for edge in (*tree.edges, *tree.loops) if not edge.moves]
    frames = joints_along(tree, route(fixed, platform, edge.child if forward else edge.parent))
    if len(frames) == 1 and np.abs(frames[0].placement.xyz - place).max() <= 1e-12:
        return frames[0]
    x, y, z = place.tolist()
    return Joint("point", "fixed", Placement((), (x, y, z)))


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


def point_platform(
    tree: Tree, path: Sequence[Step], driven: set[str], normal: Array | None
) -> list[Limb]:
    """Return two legs of two joints, one driven, that meet in a point of a planar loop."""
    if normal is None:
        raise MechanismError(
            "one loop, which leaves open what the platform is; name it with --platform LINK"
        )
    limbs: list[Limb] = []
    names, middle = [edge.joint.name for edge, _ in path], path[len(path) // 2][0]
    drives = [name for name in names if name in driven]
    places = list(map(names.index, drives))
    if len(path) != 5 or middle.joint.kind == "prismatic" or places not in _IN_EACH_LEG:
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
        limbs.append((_to_point(joints[:last], joints[last], centre), Joint("point", "fixed")))
    return limbs
