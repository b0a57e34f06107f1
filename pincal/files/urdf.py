"""URDF: a tree of links and joints; every element is read, refused, or named as unread.

A joint that no leg can have is refused only where a leg needs it. A leg is the chain from the root
to its tip; a platform's points are fixed to its root. Legs and platforms are written as joints.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from lxml import etree
from scipy.spatial.transform import RigidTransform, Rotation

from pincal.errors import MechanismError
from pincal.files.text import plain_number, read_xml, why_no_number
from pincal.files.tree import Edge, Tree, hung, root_of, turns, with_ranges
from pincal.model import Follows, Joint, Leg, Placement, placement_of
from pincal.model.checks import LARGEST
from pincal.model.joint import End, JointKind

Triple = tuple[float, float, float]
XACRO = "python -m pip install xacro; xacro FILE.urdf.xacro > FILE.urdf"
#: Elements of a <robot> that are read, or have no influence on placements.
_KNOWN = ("link", "joint", "material", "transmission", "gazebo", "sensor", "ros2_control", "frame")
CLOSING = ("constraint", "loop_joint", "drake:ball_constraint", "drake:linear_bushing_rpy")
"""Elements of a <robot> that close loops."""
#: Elements of a joint, and their attributes that are read; others are refused.
_PLACING = {
    "joint": {"name", "type", "dont_collapse"},
    "origin": {"xyz", "rpy", "quat_xyzw"},
    "axis": {"xyz"},
    "parent": {"link"},
    "child": {"link"},
    "mimic": {"joint", "multiplier", "offset"},
}
#: Elements of a joint that do not place it; of these only limits are read.
_PLACING_NOTHING = {"limit", "dynamics", "safety_controller", "calibration", "joint_properties"}
KINDS: dict[str, JointKind] = {
    "revolute": "revolute",
    "continuous": "revolute",
    "prismatic": "prismatic",
    "fixed": "fixed",
}


def read_urdf(path: Path, replaced: Mapping[str, str] | None = None) -> Tree:
    """Return the tree of a URDF; joints that no leg can have are in ``Tree.refused``.

    ``replaced`` has other axes of joints, by name (see ``turns``); no axis fixes a joint.
    """
    robot = read_xml(path, "robot")
    remarks = _unknown_elements(robot, path)
    links = {str(link.get("name")): link for link in robot.findall("link")}
    refused: dict[str, str] = {}
    edges: list[Edge] = []
    for element in robot.findall("joint"):
        name, place = str(element.get("name")), f"{path}, line {element.sourceline}"
        parent, child = (str(element.xpath(f"string({e}/@link)")) for e in ("parent", "child"))
        if not (parent and child):
            lacking = "child" if parent else "parent"
            raise MechanismError(f"{place}: joint {element.get('name')!r} has no {lacking} link")
        floating = "XYZxyz" if element.get("type") == "floating" else None
        axes = (replaced or {}).get(name, floating)
        try:
            joint = joint_of(element, place, element.get("type") if axes is None else "fixed")
            joint = _weighed(joint, links.get(child), path)
        except MechanismError as error:
            refused[name] = str(error)
            edges.append(Edge(Joint(name, "revolute"), parent, child))
            continue
        edges += turns(joint, parent, child, axes) if axes else edges_of(joint, parent, child)
        if remark := _remarks(element, edges[-1].joint, place):
            remarks[name] = remark
    tree = Tree(
        name=str(robot.get("name") or path.stem),
        source=str(path),
        root=root_of(edges, list(links), str(path)),
        edges=tuple(edges),
        refused=refused,
        remarks=remarks,
    )
    return with_ranges(tree)


def _unknown_elements(robot: etree._Element, path: Path) -> dict[str, str]:
    """Return remarks on elements and attributes of a <robot> that are not URDF."""
    remarks: dict[str, str] = {}
    for name in sorted({*map(str, robot.attrib)} - {"name", "version"}):
        remarks[name] = f"{path}, line {robot.sourceline}: {name!r} of the <robot> is not read"
    for origin in robot.findall("link/origin"):
        remarks["origin"] = f"{path}, line {origin.sourceline}: <origin> of a <link> is not read"
    for element in robot:
        tag = tag_of(element)
        if not tag or tag in (*_KNOWN, *CLOSING):
            continue
        named = f"{path}, line {element.sourceline}: <{tag}>"
        if tag.startswith("xacro:"):
            raise MechanismError(f"{named} is a macro, which xacro expands: {XACRO}")
        if "include" in tag or "joint" in tag:
            raise MechanismError(f"{named} may place links, and is not URDF; write URDF without it")
        remarks[tag] = f"{named} is not read"
    return remarks


def tag_of(element: etree._Element) -> str:
    """Return an element's tag with its prefix; empty for a comment."""
    names = element.prefix, str(element.tag).rpartition("}")[2]
    return ":".join(filter(None, names)) if isinstance(element.tag, str) else ""


def edges_of(joint: Joint, parent: str, child: str) -> tuple[Edge, ...]:
    """Return the edges of a joint; a joint with equal limits is fixed there."""
    if joint.kind == "fixed" or joint.lower < joint.upper:
        return (Edge(joint, parent, child),)
    held, middle = placement_of(joint.motion(np.array([joint.lower]))[0]), f"{child}_before"
    place = Joint(joint.name, "fixed", joint.placement)
    moved = Joint(f"{joint.name}_at", "fixed", held, mass=joint.mass, centre=joint.centre)
    return Edge(place, parent, middle), Edge(moved, middle, child)


def _remarks(element: etree._Element, joint: Joint, place: str) -> str:
    """Return remarks on a joint of a leg; empty if there are none."""
    name, remarks = element.get("name"), []
    if joint.kind == "fixed" and element.get("type") in ("revolute", "prismatic"):
        remarks.append(f"joint {name!r} has equal limits: it is fixed there")
    if element.find("calibration") is not None:
        remarks.append(
            f"<calibration> of joint {name!r} places switches, and is not read: readings count "
            "from the zero of the URDF"
        )
    rpy = element.find("origin[@rpy]")
    if rpy is not None and np.abs(joint.placement.rpy).max() > 2 * np.pi:
        remarks.append(
            f"rpy={rpy.get('rpy')!r} is more than a turn: radians are expected; is this degrees?"
        )
    return f"{place}: {'; '.join(remarks)}" if remarks else ""


def read_leg(
    path: Path, tip: str, ends: Sequence[End] = ()
) -> tuple[tuple[Joint, ...], tuple[End, ...]]:
    """Return the joints of a URDF from its root link to its tip and further ends, and these ends.

    The given ends name links; the returned ends name the joints that carry these links. Parents
    come before their children, and the joint of the tip comes last.
    """
    tree, names = read_urdf(path), [name for end in ends for name in end.frames]
    last, *end_links = [tree.link(name, "an end of a leg") for name in (tip, *names)]
    edges = tree.edges_to((last, *end_links))
    leaders = {edge.joint.leader.joint for edge in edges}
    led = [edge.child for edge in tree.edges if edge.joint.name in leaders]
    edges = tree.edges_to((last, *end_links, *led))
    joints, carriers = hung(edges, last)
    tree.check_joints(joint.name for joint in joints)
    if all(joint.kind == "fixed" for joint in joints):
        raise MechanismError(f"{path}: no joint moves between the root link and {tip!r}")
    if any(edge.parent == last for edge in edges) or not set(end_links) <= set(carriers):
        raise MechanismError(
            f"{path}: an end is the root link, or on the way to another; fix a link to it"
        )
    of_link = dict(zip(names, (carriers[link] for link in end_links), strict=True))
    return tuple(joints), tuple(end.renamed(of_link) for end in ends)


def read_points(path: Path) -> dict[str, Joint]:
    """Return the fixed joints of a platform URDF, both by their names and their child links'."""
    tree = read_urdf(path)
    tree.check_joints(tree.refused)
    points: dict[str, Joint] = {}
    for edge in (edge for edge in tree.edges if not edge.moves):
        if edge.parent != tree.root:
            raise MechanismError(
                f"{path}: joint {edge.joint.name!r} sits on another frame; fix each platform "
                "point to the platform's root link"
            )
        for name in dict.fromkeys((edge.joint.name, edge.child)):
            if name in points:
                raise MechanismError(
                    f"{path}: {name!r} names two points; give each joint and link a name of its own"
                )
            points[name] = edge.joint
    if not points:
        raise MechanismError(f"{path}: no frame is fixed to the platform's root link")
    return points


def _weighed(joint: Joint, link: etree._Element | None, path: Path) -> Joint:
    """Return a joint with the mass and centre of its child link, if the URDF gives one."""
    element = None if link is None else link.find("inertial/mass")
    if link is None or element is None:
        return joint
    place = f"{path}, line {element.sourceline}"
    mass = number_of(element.get("value", "0"), place)
    if mass < 0.0:
        name = link.get("name")
        raise MechanismError(f"{place}: link {name!r} has the mass {mass:g}; expected 0 or more")
    centre = triple_of(link.find("inertial/origin"), "xyz", place, (0.0, 0.0, 0.0))
    return replace(joint, mass=mass, centre=centre if mass else (0.0, 0.0, 0.0))


def joint_of(element: etree._Element, place: str, kind: str | None) -> Joint:
    """Return a <joint> of a URDF, read as type ``kind``; its limits may be equal."""
    name = element.get("name")
    if not name:
        raise MechanismError(f"{place}: a joint without a name")
    _check_parts(element, f"{place}: joint {name!r}")
    if kind not in KINDS:
        raise MechanismError(
            f"{place}: joint {name!r} is of type {kind!r}; a leg may have {', '.join(KINDS)}"
        )
    placement = Placement(
        xyz=triple_of(element.find("origin"), "xyz", place, (0.0, 0.0, 0.0)),
        rpy=_turn(element, place),
    )
    if kind == "fixed":
        return Joint(name, "fixed", placement)
    axis = np.array(triple_of(element.find("axis"), "xyz", place, (1.0, 0.0, 0.0)))
    norm = float(np.linalg.norm(axis))
    if norm < 1e-9:
        raise MechanismError(f"{place}: joint {name!r} has an axis of length zero")
    x, y, z = (axis if abs(norm - 1.0) <= 1e-12 else axis / norm).tolist()
    lower, upper = (-np.inf, np.inf) if kind == "continuous" else _limits(element, name, place)
    joint = Joint(name, KINDS[kind], placement, (x, y, z), lower, upper)
    if (mimic := element.find("mimic")) is None:
        return joint
    ratio = number_of(mimic.get("multiplier", "1"), place)
    offset = number_of(mimic.get("offset", "0"), place)
    if ratio == 0.0:
        return replace(joint, lower=offset, upper=offset)
    return replace(joint, follows=Follows(mimic.get("joint", ""), ratio, offset))


def _check_parts(element: etree._Element, place: str) -> None:
    """Raise if a <joint> has an unknown element or attribute, which might place it."""
    parts = [element, *(part for part in element if isinstance(part.tag, str))]
    for part in parts:
        tag = str(part.tag)
        if tag in _PLACING_NOTHING and part is not element:
            continue
        if tag not in _PLACING or [part.tag for part in parts].count(tag) > 1:
            raise MechanismError(
                f"{place} has {'two' if tag in _PLACING else 'a'} <{tag}>; expected one each of "
                f"{', '.join(sorted((_PLACING.keys() | _PLACING_NOTHING) - {'joint'}))}"
            )
        if odd := sorted(set(map(str, part.attrib)) - _PLACING[tag]):
            raise MechanismError(
                f"{place}: {odd[0]!r} of its <{tag}> is no attribute of URDF, and might place it; "
                f"expected only {', '.join(sorted(_PLACING[tag]))}"
            )


def _turn(element: etree._Element, place: str) -> Triple:
    """Return roll, pitch and yaw of a joint's origin, from ``rpy`` or ``quat_xyzw``."""
    origin = element.find("origin")
    text = None if origin is None else origin.get("quat_xyzw")
    if origin is None or text is None:
        return triple_of(origin, "rpy", place, (0.0, 0.0, 0.0))
    version = element.getroottree().getroot().get("version", "1.0")
    if origin.get("rpy") is not None or version in ("1", "1.0"):
        raise MechanismError(
            f'{place}: quat_xyzw needs <robot version="1.1"> or later, without rpy beside it; '
            "programs read this file differently"
        )
    numbers = [number_of(word, place) for word in text.split()]
    if len(numbers) != 4 or not any(numbers):
        raise MechanismError(f"{place}: quat_xyzw={text!r} should hold four numbers, not all zero")
    turn = RigidTransform.from_rotation(Rotation.from_quat(numbers))
    return placement_of(turn.as_matrix()).rpy


def _limits(element: etree._Element, name: str, place: str) -> tuple[float, float]:
    """Return the limits of a joint; infinite if the file has none, or huge ones."""
    limit = element.find("limit")
    limits = {} if limit is None else {str(k): plain_number(str(v)) for k, v in limit.items()}
    if limit is None or {"lower", "upper"}.isdisjoint(limits) or not any(limits.values()):
        return -np.inf, np.inf  # zeros alone are what exporters of CAD programs leave blank
    ends = [limit.get(key, "0") for key in ("lower", "upper")]
    lower, upper = map(plain_number, ends)
    if max(abs(lower), abs(upper)) > LARGEST:
        return -np.inf, np.inf
    for text, value in zip(ends, (lower, upper), strict=True):
        if np.isnan(value):
            raise MechanismError(f"{place}: {why_no_number(text)}")
    if lower > upper:
        raise MechanismError(
            f"{place}: joint {name!r} has limits {lower:g} to {upper:g}; lower must be below upper"
        )
    return lower, upper


def triple_of(element: etree._Element | None, key: str, place: str, default: Triple) -> Triple:
    """Return the three numbers of an element's attribute, or a default if it is missing."""
    text = None if element is None else element.get(key)
    if text is None:
        return default
    numbers = [number_of(word, place) for word in text.split()]
    if len(numbers) != 3:
        raise MechanismError(f"{place}: {key}={text!r} should hold three numbers")
    x, y, z = numbers
    return x, y, z


def number_of(text: str, place: str) -> float:
    """Return the number that a text is; raise if it is none, or too large."""
    value = plain_number(text)
    if not abs(value) <= LARGEST:
        raise MechanismError(f"{place}: {why_no_number(text)}")
    return value


def leg_urdf(leg: Leg) -> str:
    """Return a leg's URDF: its joints, and the masses of their links."""
    robot, links = etree.Element("robot", name=leg.name), leg_links(leg)
    etree.SubElement(robot, "link", name=links[0])
    for index, joint in enumerate(leg.joints):
        link = etree.SubElement(robot, "link", name=links[index + 1])
        if joint.mass:
            inertial = etree.SubElement(link, "inertial")
            etree.SubElement(inertial, "origin", xyz=numbers_text(joint.centre), rpy="0 0 0")
            etree.SubElement(inertial, "mass", value=numbers_text([joint.mass]))
            moments = dict.fromkeys(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), "0")
            etree.SubElement(inertial, "inertia", moments)  # only weight matters
        joint_element(robot, joint, links[leg.carriers[index] + 1], links[index + 1])
    return xml_text(robot)


def leg_links(leg: Leg) -> list[str]:
    """Return the names of a leg's links, base first, tip last, different from those of joints."""
    ends = [*(f"{joint.name}_link" for joint in leg.joints[:-1]), "tip"]
    joints = {joint.name for joint in leg.joints}
    names = [f"{leg.name}_{end}" for end in ("base", *ends)]
    return [f"{name}_" if name in joints else name for name in names]


def platform_urdf(name: str, legs: tuple[Leg, ...]) -> str:
    """Return a platform's URDF: one fixed frame for each platform point."""
    robot = etree.Element("robot", name=f"{name}_platform")
    points, root = {point.name: point for leg in legs for point in leg.points}, "platform"
    links = {name: f"{name}_link" for name in points}
    while root in (*points, *links.values()):
        root += "_"
    etree.SubElement(robot, "link", name=root)
    for point in points.values():
        etree.SubElement(robot, "link", name=links[point.name])
        joint_element(robot, point, root, links[point.name])
    return xml_text(robot)


def joint_element(robot: etree._Element, joint: Joint, parent: str, child: str) -> None:
    """Add a joint with all digits of its origin, axis and limits."""
    continuous = joint.kind == "revolute" and not np.isfinite(joint.lower)
    kind = "continuous" if continuous else joint.kind
    element = etree.SubElement(robot, "joint", name=joint.name, type=kind)
    etree.SubElement(element, "parent", link=parent)
    etree.SubElement(element, "child", link=child)
    origin = {"xyz": numbers_text(joint.placement.xyz), "rpy": numbers_text(joint.placement.rpy)}
    etree.SubElement(element, "origin", origin)
    if joint.kind == "fixed":
        return
    etree.SubElement(element, "axis", xyz=numbers_text(joint.axis))
    if not continuous:
        limits = {"lower": numbers_text([joint.lower]), "upper": numbers_text([joint.upper])}
        etree.SubElement(element, "limit", {"effort": "0", "velocity": "0", **limits})
    if joint.follows:
        name, ratio, offset = joint.follows
        law = {"multiplier": numbers_text([ratio]), "offset": numbers_text([offset])}
        etree.SubElement(element, "mimic", {"joint": name, **law})


def numbers_text(values: Iterable[float]) -> str:
    """Return numbers with all their digits, without negative zeros."""
    return " ".join(repr(float(value) + 0.0) for value in values)


def xml_text(root: etree._Element) -> str:
    """Return an XML file's text, indented."""
    etree.indent(root, space="  ")
    return str(etree.tostring(root, encoding="unicode")) + "\n"
