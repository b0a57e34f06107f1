"""A user's URDF: loops closed by a YAML file, and calibrated origins written into the same file.

The YAML file beside it follows the convention of example-parallel-robots: ``closed_loop`` lists
pairs of frames that meet, ``type`` whether their origins meet ('3d') or the whole frames ('6d', the
default), ``name_mot`` the motors, by name or part of it; ``joint_name`` and ``joint_type`` replace
joints by others (SPHERICAL, FIXED, CARDAN, UJOINT_XY and the like), and ``rotule_name`` replaces
joints with this text in their names by balls. Two keys are pincal's own: ``platform``, a link, and
``home``, joint positions in the drawn configuration.
Source: github.com/Gepetto/example-parallel-robots, ``loader_tools.py``.

A joint of the mechanism and the URDF's joint of the same name are on the same link if the joints
before them are the same; the calibrated placement is then the new origin. A displacement between
the last joint and the platform's frame, which a URDF cannot hold if no joint is fixed there, is
applied to the frames that are fixed to the platform's link.
"""

import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import permutations
from pathlib import Path
from typing import Any

import numpy as np
from lxml import etree
from scipy.spatial.transform import Rotation

from pincal.errors import MechanismError
from pincal.files.text import read_xml
from pincal.files.tree import Edge, Tree, at_home, route
from pincal.files.urdf import numbers_text, read_urdf
from pincal.files.yaml import Entry, read_yaml
from pincal.formats.arm import undisplaced
from pincal.formats.closings import read_closed
from pincal.formats.sdf import read_sdf
from pincal.model import Closing, Joint, Leg, Mechanism, Placement, placement_of
from pincal.model.checks import EXACT, ROUNDING, listed
from pincal.types import Array

_MARKUP = re.compile(  # start tags, whose attributes may hold '>', and all that is none
    rb"<!--.*?-->|<!\[CDATA\[.*?\]\]>|<\?.*?\?>|<[!/][^>]*>"
    rb"|(?P<start><(?:[^>\"']|\"[^\"]*\"|'[^']*')*>)",
    re.DOTALL,
)
Edges = Mapping[str, Edge]
_TURNED = {"SPHERICAL": "xyz", "FIXED": "", "CARDAN": "xy"} | {
    f"UJOINT_{axes.upper()}": axes for axes in map("".join, permutations("xyz", 2))
}
#: Keys of the YAML file that are read; others (rotor inertias and the like) are ignored.
_LOOP_KEYS = ("closed_loop", "type", "joint_name", "joint_type", "rotule_name", "platform", "home")


def loops_beside(file: Path) -> Path | None:
    """Return the YAML file that belongs to a URDF, if there is one."""
    places = (file.with_suffix(".yaml"), file.parent / "robot.yaml")
    return next(filter(Path.is_file, places), None)


def read_loops(urdf: Path, loops: Path | None, form: str = "urdf") -> Tree:
    """Return the tree of a URDF or SDF, by its form, with its loops and those of a YAML file."""
    read, root = {"urdf": (read_closed, "robot"), "sdf": (read_sdf, "sdf")}[form]
    if loops is None:
        return read(urdf)
    keys = read_yaml(loops, MechanismError).keys(("name_mot",), _LOOP_KEYS, others=True)
    lists = {key: keys[key].items() if key in keys else [] for key in _LOOP_KEYS[:4]}
    drawn = [str(joint.get("name")) for joint in read_xml(urdf, root).iterfind(".//joint")]
    ball = keys["rotule_name"].text() if "rotule_name" in keys else None
    replaced = {name: "xyz" for name in drawn if ball and ball in name} | {
        entry.text(): _TURNED[kind.choice(*_TURNED)]
        for entry, kind in _pairs(lists, "joint_name", "joint_type", loops)
    }
    tree = read(urdf, replaced)
    home = keys["home"].mapped(Entry.number) if "home" in keys else {}
    joints, remarks = [edge.joint.name for edge in tree.edges], dict(tree.remarks)
    for name in home.keys() - set(joints):
        keys["home"].fail(f"'home' has {name!r}, no joint of {urdf}; it has {listed(joints)}")
    for name in replaced.keys() - set(drawn):
        remarks[name] = f"{loops}: 'joint_name' has {name!r}, no joint of {urdf}: ignored"
    return replace(
        tree,
        edges=at_home(tree.edges, home),
        loops=(*tree.loops, *_closings(tree, lists, loops)),
        active=_motors(keys["name_mot"], tree.edges, urdf),
        platform=keys["platform"].text() if "platform" in keys else None,
        remarks=remarks,
    )


def _pairs(
    lists: Mapping[str, list[Entry]], first: str, second: str, loops: Path
) -> list[tuple[Entry, Entry]]:
    """Return pairs of entries of two lists, which must be equally long."""
    counts = len(lists[first]), len(lists[second])
    if counts[0] != counts[1]:
        raise MechanismError(
            f"{loops}: {counts[0]} entries of {first!r}, but {counts[1]} of {second!r}; expected "
            "one for each"
        )
    return list(zip(lists[first], lists[second], strict=True))


def _closings(tree: Tree, lists: Mapping[str, list[Entry]], loops: Path) -> Iterator[Edge]:
    """Yield the edges that close loops: pairs of links whose frames, or origins, meet."""
    kinds = ["6d"] * len(lists["closed_loop"])
    if lists["type"]:
        pairs = _pairs(lists, "closed_loop", "type", loops)
        kinds = [kind.choice("3d", "3D", "6d", "6D").lower() for _, kind in pairs]
    for pair, kind in zip(lists["closed_loop"], kinds, strict=True):
        ends = [end.text() for end in pair.items(2, 2)]
        parent, child = (tree.link(end, f"'closed_loop' of {loops}") for end in ends)
        closes: Closing = "point" if kind == "3d" else "frame"
        yield Edge(Joint("_".join(ends), "fixed"), parent, child, closes=closes)


def _motors(named: Entry, edges: Sequence[Edge], urdf: Path) -> tuple[str, ...]:
    """Return the joints of ``name_mot``: the one with a name, or else all that contain it."""
    moving = [edge.joint.name for edge in edges if edge.joint.kind != "fixed"]
    motors: list[str] = []
    for entry in [named] if isinstance(named.value, str) else named.items():
        name = entry.text()
        matching = [name] if name in moving else [joint for joint in moving if name in joint]
        if not matching:
            entry.fail(
                f"'name_mot' has {name!r}, but no moving joint of {urdf} has that in its name; it "
                f"has {listed(moving)}"
            )
        motors += matching
    return tuple(dict.fromkeys(motors))


def calibrated_urdf(original: str | Path, mechanism: Mechanism) -> bytes:
    """Return the bytes of a URDF with the origins of a calibrated mechanism's joints.

    The URDF may be of an arm, a tree with loops, a leg (by the file's name), or the platform.
    """
    path, tree = Path(original), read_urdf(Path(original))
    urdf = {edge.joint.name: edge for edge in tree.edges}
    placements: dict[str, Array] = {}
    shifts: list[tuple[str, Array]] = []
    legs = _legs_of(path, urdf, mechanism)
    for leg in legs:
        for point in (end.point for end in leg.every_end if end.closes == "point"):
            if point is not None and (name := point.name.removesuffix("_back")) in urdf:
                T = point.placement.origin()  # or, as _back, the platform's place in its link
                placements[name] = T if name == point.name else np.asarray(np.linalg.inv(T))
        if _joints_of(urdf, leg):
            chain = _of_chain(path, urdf, leg)
            placements |= chain
            shifts.append((urdf[list(chain)[-1]].child, _shift(urdf, leg)))
            if leg.closes == "frame":  # else the platform is in another file
                placements |= _points_fixed(tree, placements, leg, shifts[-1][0], legs)
    for last, T_link_platform in shifts:
        if np.abs(T_link_platform - np.eye(4)).max() > ROUNDING:
            placements |= _moved(path, urdf, placements, last, T_link_platform)
    changed = {
        name: placement_of(origin)
        for name, origin in placements.items()
        if np.abs(origin - urdf[name].joint.placement.origin()).max() > ROUNDING
    }
    return _rewritten(path, changed)


def _points_fixed(
    tree: Tree, placements: Mapping[str, Array], carrier: Leg, link: str, legs: Sequence[Leg]
) -> dict[str, Array]:
    """Return the origins of frames that hold displaced points of legs on a platform.

    The platform is fixed to the link at the end of its carrier.
    """
    urdf, origins = {edge.joint.name: edge for edge in tree.edges}, dict[str, Array]()
    moved = urdf | {
        name: replace(urdf[name], joint=replace(urdf[name].joint, placement=placement_of(T)))
        for name, T in placements.items()
    }
    calibrated = replace(tree, edges=tuple(moved.values()))
    T_drawn = tree.pose_at_zero(link) @ _shift(urdf, undisplaced(carrier))
    T_calibrated = calibrated.pose_at_zero(link) @ _shift(urdf, carrier)
    fixed = [edge for edge in tree.edges if _is_fixed(tree, link, edge.child)]
    for leg in (leg for leg in legs if _has_displaced_point(urdf, leg)):
        drawn = (T_drawn @ undisplaced(leg).point.placement.origin())[:3, 3]
        misses = [np.abs(tree.pose_at_zero(edge.child)[:3, 3] - drawn).max() for edge in fixed]
        frames = [e for e, miss in zip(fixed, misses, strict=True) if miss <= EXACT * leg.size]
        if not frames:
            raise MechanismError(
                f"{tree.source} has no frame at the point where {leg.name!r} meets the platform, "
                "which was calibrated; give it a link of its own, fixed to the platform, or hold "
                f"the point (--fixed '{leg.name}.point_*')"
            )
        for edge in frames:
            pose = calibrated.pose_at_zero(edge.child)
            pose[:3, 3] = (T_calibrated @ leg.point.placement.origin())[:3, 3]
            origins[edge.joint.name] = np.linalg.inv(calibrated.pose_at_zero(edge.parent)) @ pose
    return origins


def _is_fixed(tree: Tree, link: str, child: str) -> bool:
    """Return whether another link is fixed to a link."""
    return child != link and not any(edge.moves for edge, _ in route(tree.edges, link, child))


def _has_displaced_point(urdf: Edges, leg: Leg) -> bool:
    """Return whether a leg's platform point was displaced, and no joint of the URDF is at it."""
    unnamed = leg.closes == "point" and leg.point.name not in urdf
    return unnamed and leg.point != undisplaced(leg).point


def _moved(
    path: Path, urdf: Edges, placements: Mapping[str, Array], link: str, T_link_platform: Array
) -> dict[str, Array]:
    """Return the origins of a link's frames, all fixed, after the platform's frame has moved."""
    on = [edge for edge in urdf.values() if edge.parent == link]
    if not on or any(edge.moves for edge in on):
        shift = ", ".join(f"{1e3 * v:.4g}" for v in T_link_platform[:3, 3])
        turn = ", ".join(f"{1e3 * v:.4g}" for v in placement_of(T_link_platform).rpy)
        raise MechanismError(
            f"{path}: the calibrated platform frame is ({shift}) mm and ({turn}) mrad off link "
            f"{link!r}, and no fixed joint of the URDF can hold that. Import with a --tip or "
            "--platform that is fixed to that link, or hold the displacement at zero (--fixed)"
        )
    return {
        joint.name: T_link_platform @ placements.get(joint.name, joint.placement.origin())
        for joint in (edge.joint for edge in on)
    }


def _named(urdf: Edges, name: str) -> str | None:
    """Return the URDF's joint that a joint of the mechanism represents, alone or as one axis."""
    stem = re.sub(r"_([xyz]|at)$", "", name)
    return name if name in urdf else stem if stem in urdf else None


def _joints_of(urdf: Edges, leg: Leg) -> set[str]:
    """Return the URDF's joints that joints of a leg represent."""
    return {name for joint in leg.moving if (name := _named(urdf, joint.name))}


def _legs_of(path: Path, urdf: Edges, mechanism: Mechanism) -> list[Leg]:
    """Return the legs whose joints, or whose platform points, are in a URDF."""
    legs = [leg for leg in mechanism.legs if _joints_of(urdf, leg)]
    legs = legs or [leg for leg in mechanism.legs if leg.point.name in urdf]
    if not legs:
        joints = listed(joint.name for joint in mechanism.legs[0].moving)
        raise MechanismError(
            f"{path} has none of the joints {joints}, …; give the URDF from which "
            f"{mechanism.name!r} was made"
        )
    joints_of_legs = Counter(name for leg in legs for name in _joints_of(urdf, leg))
    if max(joints_of_legs.values(), default=1) == 1:
        return legs
    if not (meant := [leg for leg in legs if leg.name == path.stem]):
        raise MechanismError(
            f"{path}: {', '.join(leg.name for leg in legs)} have joints of the same names; give "
            f"the file the name of its leg, such as {legs[0].name}.urdf"
        )
    return meant


def _of_chain(path: Path, urdf: Edges, leg: Leg) -> dict[str, Array]:
    """Return the origins of a leg's joints by name, (4, 4), base first."""
    carriers = {edge.child: _named(urdf, name) for name, edge in urdf.items()}
    origins: dict[str, Array] = {}
    turns, names = dict[int, Array](), [joint.name for joint in leg.joints]
    on: dict[int, str | None] = {-1: None}  # the URDF's joint that carries each link
    for index, joint in enumerate(leg.joints):
        name, previous = _named(urdf, joint.name), on[leg.carriers[index]]
        if name is None or name in origins:
            _check_held(path, urdf, leg, index)
            on[index] = previous if name in origins else joint.name
            continue
        drawn, carrier = urdf[name].joint, carriers.get(urdf[name].parent)
        if previous and carrier != previous:
            raise MechanismError(
                f"{path}: joint {name!r} cannot be placed: it hangs on {carrier!r} in the URDF, "
                f"but on {previous!r} in the mechanism"
            )
        if joint.kind != "fixed" and name == joint.name:
            _check_axis(path, joint, drawn)
        origins[name] = turns.get(leg.carriers[index], np.eye(4)) @ _origin(urdf, leg, index)
        if ball := [leg.index(axis) for axis in names if axis in (f"{name}_y", f"{name}_z")][1:]:
            turn = turns[ball[0]] = np.eye(4)  # of its frame, along a spin
            turn[:3, :3] = drawn.placement.origin()[:3, :3].T @ origins[name][:3, :3]
            origins[name] = origins[name] @ turn.T
        on[index] = name
    return origins


def _after_held(urdf: Edges, leg: Leg, index: int) -> bool:
    """Return whether a joint is an axis of a ball whose axis before is held."""
    before, joint = leg.joints[leg.carriers[index]], leg.joints[index]
    return before.kind == "fixed" and _named(urdf, before.name) == (_named(urdf, joint.name) or "")


def _origin(urdf: Edges, leg: Leg, index: int) -> Array:
    """Return a joint's origin, (4, 4); a ball is displaced at its first axis that is not held."""
    origin = leg.joints[index].placement.origin()
    further = index + 1 < len(leg.joints) and _after_held(urdf, leg, index + 1)
    return origin @ _origin(urdf, leg, index + 1) if further else origin


def _check_held(path: Path, urdf: Edges, leg: Leg, index: int) -> None:
    """Raise if a joint that is not in a URDF was displaced."""
    joint, nominal = leg.joints[index], undisplaced(leg).joints[index].placement.origin()
    at_tip = joint is leg.joints[-1] and leg.closes == "frame"  # see ``_shift``
    moved = np.abs(nominal - joint.placement.origin()).max() > ROUNDING
    if moved and not at_tip and not _after_held(urdf, leg, index):
        names = ", ".join(joint.placement.parameter_units)
        raise MechanismError(
            f"{path} has no joint {joint.name!r}, whose placement was calibrated; give the URDF "
            f"from which the mechanism was made, or hold {names} (--fixed)"
        )


def _check_axis(path: Path, joint: Joint, drawn: Joint) -> None:
    """Raise if a joint is of another kind, or about another axis, than in a URDF."""
    turned = np.abs(np.subtract(drawn.axis, joint.axis)).max() > ROUNDING
    if drawn.kind != joint.kind or turned:
        raise MechanismError(
            f"{path}: joint {joint.name!r} cannot be placed: its axis in the URDF differs from "
            "that in the mechanism, whose frames were turned on import"
        )


def _shift(urdf: Edges, leg: Leg) -> Array:
    """Return the pose of the platform's frame in the URDF's link at a leg's end, shape (4, 4).

    It is what no joint of the URDF holds: a tip's placement, or a platform point's correction.
    """
    last, shift = leg.joints[-1], np.eye(4)
    if leg.closes == "frame":
        return shift if last.name in urdf else last.placement.origin()
    if leg.point.name.removesuffix("_back") in urdf:
        return shift
    tip, nominal = _named(urdf, last.name), undisplaced(leg).point.placement.xyz
    if tip is not None and urdf[tip].moves:  # otherwise the platform is in another file
        shift[:3, 3] = np.subtract(nominal, leg.point.placement.xyz)
    return shift


def plain_bytes(path: Path) -> bytes:
    """Return a file's bytes, in which tags are found as they are."""
    text = path.read_bytes()
    if text[:2] in (b"\xff\xfe", b"\xfe\xff") or b"\x00" in text[:100]:
        raise MechanismError(f"{path}: UTF-16 or UTF-32; save it as UTF-8")
    return text


def with_tags(
    path: Path, root: etree._Element, changed: Callable[[etree._Element, bytes], bytes]
) -> bytes:
    """Return a file's bytes after a change of its elements' start tags."""
    elements = root.iter("*")
    return _MARKUP.sub(
        lambda found: changed(next(elements), found[0]) if found["start"] else found[0],
        plain_bytes(path),
    )


def _rewritten(path: Path, origins: Mapping[str, Placement]) -> bytes:
    """Return a file's bytes with new origins of joints, by name."""
    root = read_xml(path, "robot")
    joints: dict[Any, Placement | None] = {
        joint: origins.get(str(joint.get("name"))) for joint in root.iterfind("joint")
    }

    def changed(element: etree._Element, tag: bytes) -> bytes:
        if element.tag == "origin" and (placement := joints.get(element.getparent())):
            return _with_origin(tag, placement)
        if (placement := joints.get(element)) and element.find("origin") is None:
            return tag + _with_origin(b"<origin/>", placement)
        return tag

    return with_tags(path, root, changed)


def _with_origin(tag: bytes, placement: Placement) -> bytes:
    """Return the start tag of an <origin> with a new placement; its other bytes are kept."""
    turn: tuple[str, Iterable[float]] = ("rpy", placement.rpy)
    if re.search(rb"\squat_xyzw\s*=", tag):
        turn = ("quat_xyzw", Rotation.from_matrix(placement.origin()[:3, :3]).as_quat())
    for key, values in (("xyz", placement.xyz), turn):
        tag = with_numbers(tag, key, values)
    return tag


def with_numbers(tag: bytes, key: str, values: Iterable[float]) -> bytes:
    """Return a start tag with the numbers of an attribute, which is added if absent."""
    numbers = numbers_text(values).encode()
    pattern = rb"(\s" + key.encode() + rb"\s*=\s*([\"'])).*?(?=\2)"
    if re.search(pattern, tag, re.DOTALL):
        return re.sub(pattern, rb"\g<1>" + numbers, tag, count=1, flags=re.DOTALL)
    return re.sub(rb"\s*(/?>)$", b" " + key.encode() + b'="' + numbers + rb'"\g<1>', tag)
