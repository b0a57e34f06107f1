"""MJCF: bodies and joints as a tree, loops closed by ``<equality>``, drives by ``<actuator>``.

What counts for kinematics is read: poses in any notation, defaults and classes, ``<frame>``,
hinges, slides, balls and free joints, ``connect`` and ``weld`` by bodies or sites, the first
keyframe. Read here and not by Pinocchio, whose parser (4.1) leaves out all but the first body of
the world, takes anchors from joints where MuJoCo takes them from bodies, and ends the process at a
site that it does not know; tests compare both, and MuJoCo, where they can. Source: MuJoCo's XML
reference.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from lxml import etree
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pincal.errors import MechanismError
from pincal.files.xml import read_xml
from pincal.formats.trees.limbs import poses_at_zero
from pincal.formats.trees.mjcf_values import Compiler, Defaults, attributes, numbers, pose
from pincal.formats.trees.tree import Edge, Loop, Spot, Tree, at_home, ball, listed, turns
from pincal.model.joint import Joint
from pincal.model.orientation import turns_in_series
from pincal.model.placement import Placement, placement_of

Array = NDArray[np.float64]
_WORLD = "world"
_REFUSED = ("include", "replicate", "attach", "composite", "flexcomp")
_COUNTS = {"hinge": 1, "slide": 1, "ball": 4, "free": 7}


def read_mjcf(path: Path) -> Tree:
    """Return the tree of an MJCF file, with its loops and drives.

    Raises:
        FileError: the file is missing or cannot be read.
        MechanismError: not well-formed, or something in it that has no counterpart here.
    """
    root = read_xml(path, "mujoco")
    for tag in _REFUSED:
        if (found := next(root.iter(tag), None)) is not None:
            raise MechanismError(
                f"{path}, line {found.sourceline}: <{tag}> is not read; let MuJoCo write the whole "
                "model (mujoco.mj_saveLastXML) and import that"
            )
    reader = _Reader(path, root)
    world = root.find("worldbody")
    if world is None:
        raise MechanismError(f"{path}: no <worldbody>")
    reader.children(world, _WORLD, np.eye(4), "main")
    edges = at_home(tuple(reader.edges), _home(root, reader, path))
    tree = Tree(
        name=str(root.get("model") or path.stem),
        source=str(path),
        root=_WORLD,
        edges=edges,
        loops=(),
        active=_driven(root, reader, path),
        zeros=reader.zeros,
        homed=root.find("keyframe/key") is not None,
    )
    return replace(tree, loops=tuple(_loops(root, reader, tree)))


class _Reader:
    """Bodies, joints and sites as they are found."""

    def __init__(self, path: Path, root: etree._Element) -> None:
        self.path = path
        self.compiler = Compiler.of(root, path)
        self.defaults = Defaults(root, path)
        self.edges: list[Edge] = []
        self.sites: dict[str, Spot] = {}
        self.joints: list[tuple[str, str]] = []
        """Names and types, in the order of qpos."""
        self.zeros: dict[str, float] = {}
        self._links = {_WORLD}

    def children(self, element: etree._Element, link: str, at: Array, own: str) -> None:
        """Enter what an element holds: bodies, sites, and frames that only place these.

        Args:
            element: A body, the world, or a frame.
            link: The body it belongs to.
            at: Pose of the element in that body, shape (4, 4).
            own: Class of what has none.
        """
        for child in element:
            inner = child.get("childclass", own)
            if child.tag == "frame":
                there = at @ pose(child, attributes(child), self.compiler, self.path)
                self.children(child, link, there, inner)
            elif child.tag == "site" and child.get("name"):
                values = self.defaults.of(child, own)
                there = at @ pose(child, values, self.compiler, self.path)
                self.sites[str(child.get("name"))] = Spot(link, placement_of(there))
            elif child.tag == "body":
                self._body(child, link, at, inner)

    def _body(self, element: etree._Element, parent: str, at: Array, own: str) -> None:
        """Enter a body: its joints one after the other, then what is on it."""
        name = element.get("name") or f"body_{len(self._links)}"
        if name in self._links:
            raise MechanismError(f"{self.path}, line {element.sourceline}: body {name!r} twice")
        self._links.add(name)
        here: Array = at @ pose(element, attributes(element), self.compiler, self.path)
        found = [one for one in element if one.tag in ("joint", "freejoint")]
        link, shift = parent, np.zeros(3)
        for index, one in enumerate(found):
            values = self.defaults.of(one, own)
            kind = "free" if one.tag == "freejoint" else values.get("type", "hinge")
            if kind not in _COUNTS:
                raise MechanismError(
                    f"{self.path}, line {one.sourceline}: joint of type {kind!r}; expected "
                    f"{', '.join(_COUNTS)}"
                )
            own_name = one.get("name") or f"{name}_joint" + str(index + 1) * (len(found) > 1)
            place = np.array(numbers(one, values, "pos", "0 0 0", 3, self.path))
            place *= kind != "free"
            here[:3, 3] += here[:3, :3] @ (place - shift)
            last = index == len(found) - 1
            ahead = name if last and not place.any() else f"{name}_after_{own_name}"
            joint = self._joint(one, values, own_name, kind, placement_of(here))
            self.joints.append((own_name, kind))
            self.edges += _moved(joint, kind, link, ahead)
            link, shift, here = ahead, place, np.eye(4)
        if not found or shift.any():
            here[:3, 3] -= here[:3, :3] @ shift
            self.edges.append(Edge(Joint(f"{name}_fixed", "fixed", placement_of(here)), link, name))
        self.children(element, name, np.eye(4), own)

    def _joint(
        self,
        one: etree._Element,
        values: Mapping[str, str],
        name: str,
        kind: str,
        placement: Placement,
    ) -> Joint:
        """Return a joint, counted from where the file draws it."""
        if any(name == known for known, _ in self.joints):
            raise MechanismError(f"{self.path}, line {one.sourceline}: joint {name!r} twice")
        if kind not in ("hinge", "slide"):
            return Joint(name, "fixed", placement)
        axis = np.array(numbers(one, values, "axis", "0 0 1", 3, self.path))
        length = float(np.linalg.norm(axis))
        if length < 1e-9:
            raise MechanismError(f"{self.path}, line {one.sourceline}: {name!r} has a zero axis")
        x, y, z = (float(v) for v in (axis if abs(length - 1.0) <= 1e-12 else axis / length))
        unit = self.compiler.angle if kind == "hinge" else 1.0
        zero = unit * numbers(one, values, "ref", "0", 1, self.path)[0]
        self.zeros |= {name: zero} if zero else {}
        lower, upper = -np.inf, np.inf
        limited = values.get("limited", "auto")
        if limited == "true" or (
            limited == "auto" and self.compiler.autolimits and "range" in values
        ):
            low, high = numbers(one, values, "range", "0 0", 2, self.path)
            lower, upper = unit * low - zero, unit * high - zero
        turning = kind == "hinge"
        return Joint(
            name, "revolute" if turning else "prismatic", placement, (x, y, z), lower, upper
        )


def _moved(joint: Joint, kind: str, parent: str, child: str) -> tuple[Edge, ...]:
    """Return the edges of a joint."""
    if kind == "ball":
        return ball(joint, parent, child)
    if kind == "free":
        return turns(joint, parent, child, "XYZxyz")
    return (Edge(joint, parent, child),)


def _home(root: etree._Element, reader: _Reader, path: Path) -> dict[str, float]:
    """Return the joint positions of the first keyframe, by name, from where they are drawn."""
    key = root.find("keyframe/key")
    if key is None or key.get("qpos") is None:
        return {}
    count = sum(_COUNTS[kind] for _, kind in reader.joints)
    qpos = iter(numbers(key, attributes(key), "qpos", "", count, path))
    home: dict[str, float] = {}
    for name, kind in reader.joints:
        values = [next(qpos) for _ in range(_COUNTS[kind])]
        if kind == "ball":
            w, x, y, z = values
            angles = turns_in_series(Rotation.from_quat([[x, y, z, w]]).as_matrix())[0]
            home |= {f"{name}_{axis}": float(a) for axis, a in zip("xyz", angles, strict=True)}
        elif kind != "free":  # where a free body is follows from the loops
            home[name] = values[0] - reader.zeros.get(name, 0.0)
    return home


def _driven(root: etree._Element, reader: _Reader, path: Path) -> tuple[str, ...]:
    """Return the joints that actuators drive.

    Raises:
        MechanismError: an actuator of an unknown joint, or of one that is no hinge or slide.
    """
    kinds = dict(reader.joints)
    found: list[str] = []
    for one in root.iterfind("actuator/*"):
        name = one.get("joint") or one.get("jointinparent")
        if name is None:
            continue
        if name not in kinds or _COUNTS[kinds[name]] > 1:
            raise MechanismError(
                f"{path}, line {one.sourceline}: an actuator drives {name!r}, which is no hinge or "
                f"slide; there are {listed(n for n, kind in kinds.items() if _COUNTS[kind] == 1)}"
            )
        found.append(name)
    return tuple(dict.fromkeys(found))


def _loops(root: etree._Element, reader: _Reader, tree: Tree) -> Iterator[Loop]:
    """Yield the loops that equalities close.

    Raises:
        MechanismError: an equality of another kind, or of bodies or sites that there are not.
    """
    at = poses_at_zero(tree)
    for index, one in enumerate(root.iterfind("equality/*")):
        where = f"{reader.path}, line {one.sourceline}"
        if not isinstance(one.tag, str) or one.get("active", "true") == "false":
            continue
        if one.tag not in ("connect", "weld"):
            raise MechanismError(
                f"{where}: <{one.tag}> couples joints, which legs of pincal cannot; expected "
                "connect or weld"
            )
        name = one.get("name") or f"{one.tag}_{index + 1}"
        closes = "point" if one.tag == "connect" else "frame"
        sites = [one.get(key) for key in ("site1", "site2")]
        if any(sites):
            for site in sites:
                if site not in reader.sites:
                    raise MechanismError(
                        f"{where}: no site named {site!r}; there are {listed(reader.sites)}"
                    )
            first, second = (reader.sites[str(site)] for site in sites)
            yield Loop(name, first, second, closes)  # type: ignore[arg-type]
            continue
        links = [one.get("body1"), one.get("body2", _WORLD)]
        for link in links:
            if link not in tree.links:
                raise MechanismError(
                    f"{where}: no body named {link!r}; there are {listed(tree.links)}"
                )
        body1, body2 = (str(link) for link in links)
        T_body2_body1 = np.linalg.inv(at[body2]) @ at[body1]
        there: Array = np.eye(4)
        if one.tag == "connect":
            there[:3, 3] = numbers(one, attributes(one), "anchor", None, 3, reader.path)
            second = Spot(body2, placement_of(T_body2_body1 @ there))
        else:
            relpose = numbers(one, attributes(one), "relpose", "0 1 0 0 0 0 0", 7, reader.path)
            there = np.asarray(np.linalg.inv(T_body2_body1))
            if any(relpose[3:]):
                w, x, y, z = relpose[3:]
                there[:3, :3] = Rotation.from_quat([x, y, z, w]).as_matrix()
                there[:3, 3] = relpose[:3]
            second = Spot(body2)
        yield Loop(name, Spot(body1, placement_of(there)), second, closes)  # type: ignore[arg-type]
