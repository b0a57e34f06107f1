"""SDF in: a tree through its links and frames, and loops where other joints close them.

Links stand where the model is drawn, with all joints at zero. What might place a link is read, or
refused by name. Drives are joints that plugins control, or that a YAML file names.
Source: sdformat.org, "Pose Frame Semantics", and the specification from version 1.5 on.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from lxml import etree

from pincal.errors import MechanismError
from pincal.files.text import plain_number, read_xml
from pincal.files.tree import Edge, Tree, root_of, turns, with_ranges
from pincal.files.urdf import edges_of, joint_of, number_of, numbers_text
from pincal.formats.closings import about
from pincal.model import Joint, Placement, placement_of
from pincal.model.checks import ROUNDING
from pincal.types import Array

_AXIS = "xyz limit dynamics mimic use_parent_model_frame"
#: Elements and attributes that are read, or place nothing, by where they stand in a model.
_KNOWN = {
    ".": "name canonical_link placement_frame link joint frame pose static self_collide plugin",
    "frame": "name attached_to pose",
    "joint": "name type parent child pose axis axis2 physics sensor gearbox_ratio "
    "gearbox_reference_body",
    "*/pose": "relative_to frame",
    "joint/axis": _AXIS,
    "joint/axis2": _AXIS,
    "joint/*/xyz": "expressed_in",
    "joint/*/mimic": "joint multiplier offset reference",
}
_MODEL, _WORLD = "__model__", "world"


def read_sdf(path: Path, replaced: Mapping[str, str] | None = None) -> Tree:
    """Return the tree of an SDF file's model, with its loops and drives.

    No types of joints can be ``replaced``: SDF has balls and universal joints.
    """
    model = _Model(path)
    if replaced:
        raise MechanismError(f"{path}: write types of joints into the SDF, not into 'joint_name'")
    joints = {part: model.ends(part) for part in model.parts.values() if part.tag != "link"}
    gearboxes = [joint for joint in joints if joint.get("type") == "gearbox"]
    rotors = [joints.pop(joint)[0] for joint in gearboxes]
    root, edges, loops = _grown(model, joints)
    refused = {
        edge.joint.name: f"{path}: a gearbox couples {edge.joint.name!r} to others; write <mimic>"
        for edge in edges
        if edge.child in rotors
    }
    tree = Tree(
        name=str(model.element.get("name")),
        source=str(path),
        root=root_of(edges, root, str(path)),
        edges=tuple(edges),
        loops=tuple(loops),
        active=tuple(
            driven.findtext(".", "").strip()
            for plugin in model.element.iterfind("plugin")
            if "ontroller" in plugin.get("filename", "") + plugin.get("name", "")
            for driven in plugin.iterfind("joint_name")
        ),
        refused=refused,
    )
    return with_ranges(tree)


def _grown(
    model: _Model, joints: dict[etree._Element, tuple[str, str]]
) -> tuple[list[str], list[Edge], list[Edge]]:
    """Return the root of a tree, its edges, and loops, from joints with what each of them joins.

    It grows from the world, or else from the first link that no joint carries, along joints in the
    file's order, balls last: these close loops. A joint that is passed from its child has the
    opposite axis. The root is missing if there are no joints.
    """
    parents, children = ([pair[i] for pair in joints.values()] for i in (0, 1))
    root = [*({_WORLD} & {*parents}), *(p for p in parents if p not in children), *parents][:1]
    reached, edges, loops = set(root), list[Edge](), list[Edge]()
    while ahead := [joint for joint in joints if len(reached.intersection(joints[joint])) == 1]:
        joint = min(ahead, key=lambda j: (j.get("type") == "ball", joints[j][0] not in reached))
        parent, child = joints.pop(joint)
        edges += model.edges(joint, parent, child, upwards=parent not in reached)
        reached |= {parent, child}
    for joint, (parent, child) in joints.items():
        *before, loop = model.edges(joint, parent, child, closes=True)
        edges += before
        loops.append(loop)
    return root, edges, loops


class _Model:
    """Links, joints and frames of an SDF model, by name, and where they are drawn."""

    def __init__(self, path: Path) -> None:
        sdf = read_xml(path, "sdf")
        models, self.path = sdf.findall(".//model"), path
        newer = plain_number(sdf.get("version", "")) >= 1.5
        if len(models) != 1 or sdf.find(".//include") is not None or not newer:
            raise MechanismError(
                f"{path}: expected one model, without <include>, of SDF 1.5 or newer; gz sdf -p "
                "FILE > NEW.sdf expands and converts"
            )
        self.element = models[0]
        for place, known in _KNOWN.items():
            for element in self.element.iterfind(place):
                words = {*element.attrib, *(part.tag for part in element.iterfind("*"))}
                for word in sorted(words.difference(known.split())):
                    raise self.fault(element, f"{word!r} may place links, and is not read")
        self.parts = {
            str(part.get("name")): part
            for tag in ("link", "joint", "frame")
            for part in self.element.iterfind(tag)
        }
        edges = [Edge(Joint(_MODEL, "fixed", self._pose(self.element)), _WORLD, _MODEL)]
        for name, part in self.parts.items():
            on = part.findtext("child", "").strip() or part.get("attached_to", _MODEL)
            for pose in part.iterfind("pose"):
                on = pose.get("relative_to") or pose.get("frame") or on
            edges.append(Edge(Joint(name, "fixed", self._pose(part)), on, name))
        root = root_of(edges, [_WORLD, *self.parts], str(path))
        self.drawn = Tree("", str(path), root, tuple(edges))

    def fault(self, element: etree._Element, cause: str) -> MechanismError:
        """Return what is wrong with an element, and in which line."""
        return MechanismError(f"{self.path}, line {element.sourceline}: {cause}")

    def _numbers(self, element: etree._Element, count: int) -> list[float]:
        """Return the numbers of an element; zeros of an empty one."""
        words = (element.text or "0 " * count).split()
        if len(words) != count:
            raise self.fault(element, f"<{element.tag}> should hold {count} numbers")
        return [number_of(word, f"{self.path}, line {element.sourceline}") for word in words]

    def _pose(self, part: etree._Element) -> Placement:
        """Return the placement of a part on what it is placed by."""
        pose = part.find("pose")
        x, y, z, roll, pitch, yaw = [0.0] * 6 if pose is None else self._numbers(pose, 6)
        return Placement((), (x, y, z), (roll, pitch, yaw))

    def ends(self, part: etree._Element) -> tuple[str, str]:
        """Return what a joint joins, or a frame and what it is fixed to: links, frames, world."""
        first = next(name for name, other in self.parts.items() if other.tag == "link")
        attached = part.get("attached_to") or self.element.get("canonical_link") or first
        parent = part.findtext("parent", attached).strip()
        child = part.findtext("child", part.get("name", "")).strip()
        for end in (parent, child):
            if end != _WORLD and (end not in self.parts or self.parts[end].tag == "joint"):
                raise self.fault(part, f"it is on {end!r}, which is no link and no frame")
        return parent, child

    def between(self, first: str, second: str) -> Array:
        """Return the pose of a link, joint or frame in another one, shape (4, 4)."""
        T_first, T_second = map(self.drawn.pose_at_zero, (first, second))
        T_first_second: Array = np.linalg.inv(T_first) @ T_second
        return T_first_second

    def edges(
        self,
        part: etree._Element,
        parent: str,
        child: str,
        *,
        upwards: bool = False,
        closes: bool = False,
    ) -> list[Edge]:
        """Return the edges of a joint or frame, of which the last one leads to its child."""
        name, (first, *further) = str(part.get("name")), self._joints(part)
        if upwards:
            parent, child = child, parent
            first, *further = (about(j, np.negative(j.axis)) for j in (*further[::-1], first))
        near, far = self.between(parent, name), self.between(name, child)
        if closes and part.get("type") == "ball":
            met = placement_of(self.between(child, name))
            return [Edge(Joint(name, "fixed", placement_of(near)), parent, child, met, "point")]
        joints = [replace(first, placement=placement_of(near)), *further]
        if closes or np.abs(far - np.eye(4)).max() > ROUNDING:
            joints.append(Joint(f"{name}_to_{child}", "fixed", placement_of(far)))
        links = [parent, *(f"{joint.name}_end" for joint in joints[:-1]), child]
        pairs = zip(joints, pairwise(links), strict=True)
        return [edge for joint, pair in pairs for edge in edges_of(joint, *pair)]

    def _joints(self, part: etree._Element) -> list[Joint]:
        """Return a joint's axes as joints in its frame, in order."""
        name, kind = str(part.get("name")), part.get("type", "fixed")
        if kind == "fixed":
            return [Joint(name, "fixed")]
        if kind == "ball":
            return [edge.joint for edge in turns(Joint(name, "fixed"), "", "", "xyz")]
        elements = [element for tag in ("axis", "axis2") for element in part.iterfind(tag)]
        if kind == "universal" and len(elements) == 2:
            pairs = zip("xy", elements, strict=True)
            return [self._joint(part, axis, f"{name}_{end}", "revolute") for end, axis in pairs]
        if len(elements) != 1:
            raise self.fault(part, f"{len(elements)} axes of a joint of type {kind!r}")
        return [self._joint(part, elements[0], name, kind)]

    def _joint(self, part: etree._Element, axis: etree._Element, name: str, kind: str) -> Joint:
        """Return the joint of an axis, in the frame of the joint that has it."""
        urdf, xyz = etree.Element("joint", name=name), axis.find("xyz")
        if xyz is None:
            raise self.fault(axis, "an axis without <xyz>")
        in_model = axis.findtext("use_parent_model_frame", "").strip() in ("1", "true")
        frame = xyz.get("expressed_in") or (_MODEL if in_model else str(part.get("name")))
        turn = self.between(str(part.get("name")), frame)[:3, :3]
        etree.SubElement(urdf, "axis", xyz=numbers_text(turn @ self._numbers(xyz, 3)))
        limits = {end: axis.findtext(f"limit/{end}", "inf") for end in ("lower", "upper")}
        etree.SubElement(urdf, "limit", limits)
        for mimic in axis.iterfind("mimic"):
            ratio, offset, start = (
                self._numbers(number, 1)[0] if (number := mimic.find(tag)) is not None else default
                for tag, default in (("multiplier", 1.0), ("offset", 0.0), ("reference", 0.0))
            )
            law = {"multiplier": repr(ratio), "offset": repr(offset - ratio * start)}
            etree.SubElement(urdf, "mimic", {"joint": str(mimic.get("joint")), **law})
        return joint_of(urdf, f"{self.path}, line {axis.sourceline}", kind)
