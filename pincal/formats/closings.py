"""Elements of URDF dialects that close loops, as edges of a tree.

``<constraint>`` is proposed for urdfdom (parent and child, ``parent_origin``, ``child_origin``, an
axis on either); ``<loop_joint>`` is Isaac Sim's (``link1``, ``link2`` with their poses); Drake's
are ``drake:ball_constraint`` and ``drake:linear_bushing_rpy`` between frames. A ball closes a
point. Any other joint leads from the parent to an added link, whose whole frame is closed.
Source: github.com/ros/urdfdom/pull/264; Drake's multibody parsing, list of custom elements.
"""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from lxml import etree
from scipy.spatial.transform import Rotation

from pincal.errors import MechanismError
from pincal.files.text import read_xml
from pincal.files.tree import Edge, Tree, turns
from pincal.files.urdf import CLOSING, KINDS, read_urdf, tag_of, triple_of
from pincal.model import Joint, Placement, placement_of
from pincal.types import Array

Parts = Mapping[str, etree._Element]
_ENDS = ("parent", "child")
_DRIVEN = "transmission/joint/@name | ros2_control/joint[command_interface]/@name"


def read_closed(path: Path, replaced: Mapping[str, str] | None = None) -> Tree:
    """Return the tree of a URDF with the loops that the file closes and the joints it drives."""
    tree, robot = read_urdf(path, replaced), read_xml(path, "robot")
    edges, loops = list(tree.edges), list[Edge]()
    for number, element in enumerate(part for part in robot if tag_of(part) in CLOSING):
        place = f"{path}, line {element.sourceline}"
        name = str(element.get("name") or f"loop_{number + 1}")
        try:
            *joined, loop = _closing(name, element, robot, place)
        except KeyError as error:
            raise MechanismError(f"{place}: <{tag_of(element)}> has no {error}") from error
        for link in {(joined or [loop])[0].parent, loop.child}.difference(tree.links):
            raise MechanismError(f"{place}: {name!r} joins {link!r}, but there is no such link")
        edges += joined
        loops.append(loop)
    driven: Any = robot.xpath(_DRIVEN)
    active = tuple(dict.fromkeys(map(str, driven)))
    return replace(tree, edges=tuple(edges), loops=tuple(loops), active=active)


def _closing(name: str, element: etree._Element, robot: etree._Element, place: str) -> list[Edge]:
    """Return the edges of the joint that closes a loop, then the edge that is closed."""
    parts = {tag_of(part).removeprefix("drake:"): part for part in element}
    kind, axes = str(element.get("type", "spherical")), _axes(parts, place)
    if "bushing_frameA" in parts:
        kind, axes = _stiff(parts, place)
    (parent, first), (child, second) = (
        (str(link), _placed(frame, place)) for link, frame in _ends(parts, robot)
    )
    joint, link = Joint(name, "fixed", first), f"{name}_closing"
    if kind in ("spherical", "ball"):
        return [Edge(joint, parent, child, second, "point")]
    if kind == "fixed":
        return [Edge(joint, parent, child, second)]
    if kind == "universal":
        pairs = zip(turns(joint, parent, link, "xy"), axes, strict=True)
        joined = [replace(edge, joint=about(edge.joint, axis)) for edge, axis in pairs]
    elif kind in KINDS:
        moving = about(replace(joint, kind=KINDS[kind], lower=-np.inf, upper=np.inf), axes[0])
        joined = [Edge(moving, parent, link)]
        turn = np.eye(4)
        if not np.array_equal(axes[0], axes[1]):  # turn the child's frame to the parent's axis
            turn[:3, :3] = Rotation.align_vectors(axes[1], axes[0])[0].as_matrix()
            second = placement_of(second.origin() @ turn)
    else:
        raise MechanismError(
            f"{place}: {name!r} closes a loop by a joint of type {kind!r}; expected spherical, "
            f"universal, {', '.join(KINDS)}"
        )
    return [*joined, Edge(Joint(f"{name}_loop", "fixed"), link, child, second)]


def about(joint: Joint, axis: Array) -> Joint:
    """Return a joint with another axis."""
    x, y, z = (axis / np.linalg.norm(axis)).tolist()
    return replace(joint, axis=(x, y, z))


def _axes(parts: Parts, place: str) -> list[Array]:
    """Return the axes on parent and child, by default x."""
    axes = [parts.get(f"{end}_axis", parts.get("axis")) for end in _ENDS]
    return [np.array(triple_of(axis, "xyz", place, (1.0, 0.0, 0.0))) for axis in axes]


def _ends(parts: Parts, robot: etree._Element) -> list[tuple[str | None, etree._Element | None]]:
    """Return the links that meet, and the elements that place their frames on them."""
    if "ball_constraint_body_A" in parts:
        pairs = (("A", "AP"), ("B", "BQ"))
        return [
            (parts[f"ball_constraint_body_{end}"].get("name"), parts[f"ball_constraint_p_{point}"])
            for end, point in pairs
        ]
    if "bushing_frameA" in parts:
        named = [parts[f"bushing_frame{end}"].get("name") for end in "AC"]
        frames = {frame.get("name"): frame for frame in robot.findall("frame")}
        return [(frames[name].get("link"), frames[name]) for name in named]
    if "link1" in parts:
        return [(parts[end].get("link"), parts[end]) for end in ("link1", "link2")]
    return [(parts[end].get("link"), parts.get(f"{end}_origin")) for end in _ENDS]


def _stiff(parts: Parts, place: str) -> tuple[str, list[Array]]:
    """Return the kind and axes of the joint whose fixed directions are a bushing's stiff ones."""
    torque, force = (
        np.array(triple_of(parts[f"bushing_{kind}_stiffness"], "value", place, (0.0,) * 3))
        for kind in ("torque", "force")
    )
    free, slides = np.flatnonzero(torque == 0.0), np.flatnonzero(force == 0.0)
    if len(free) == 3 and not len(slides):
        return "spherical", []
    if len(free) == 1 and set(slides) <= set(free):  # the plane of the loop stops the slide
        return "revolute", [np.eye(3)[free[0]]] * 2
    raise MechanismError(
        f"{place}: a bushing must be a ball, without torque stiffness about any axis, or a hinge, "
        "without it about a single axis; this one is neither"
    )


def _placed(element: etree._Element | None, place: str) -> Placement:
    """Return the placement of an element with xyz and rpy, or with a value."""
    key = "xyz" if element is None or element.get("value") is None else "value"
    xyz, rpy = (triple_of(element, name, place, (0.0, 0.0, 0.0)) for name in (key, "rpy"))
    return Placement((), xyz, rpy)
