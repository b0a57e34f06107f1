"""A user's own URDF with calibrated joint origins, every other byte as it was.

A joint of the mechanism and the joint of the URDF with its name sit on the same link if the joints
before them are the same: then the calibrated placement is the new origin. What the calibration
found between the last joint and the platform's frame, for which a URDF has no place if nothing is
fixed there, moves the frames that are fixed to the platform's link instead.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from xml.parsers import expat

import numpy as np
from scipy.spatial.transform import Rotation

from pincal.errors import MechanismError
from pincal.files.tree import Edge
from pincal.files.urdf import read_urdf
from pincal.model.checks import ROUNDING, listed
from pincal.model.leg import Leg
from pincal.model.mechanism import Mechanism
from pincal.model.placement import Placement, placement_of
from pincal.types import Array

_TAG = re.compile(rb"<(?:[^>\"']|\"[^\"]*\"|'[^']*')*>")  # attributes may hold '>'
Edges = Mapping[str, Edge]


def calibrated_urdf(original: str | Path, mechanism: Mechanism) -> bytes:
    """Return the bytes of a URDF with the origins of a calibrated mechanism's joints.

    The URDF is that whose joints the mechanism has: of an arm, of a tree with loops, of one leg of
    a mechanism folder (called so where other legs have joints of these names), or of its platform.
    """
    path = Path(original)
    urdf = {edge.joint.name: edge for edge in read_urdf(path).edges}
    placements: dict[str, Array] = {}
    shifts: list[tuple[str, Array]] = []
    for calibrated in _legs_of(path, urdf, mechanism):
        if calibrated.closes == "point" and calibrated.point.name in urdf:
            placements[calibrated.point.name] = calibrated.point.placement.origin()
        if any(_named(urdf, joint.name) for joint in calibrated.moving):
            chain = _of_chain(path, urdf, calibrated)
            placements |= chain
            shifts.append((urdf[list(chain)[-1]].child, _shift(urdf, calibrated)))
    for last, T_link_platform in shifts:
        if not _is_nothing(T_link_platform):
            placements |= _moved(path, urdf, placements, last, T_link_platform)
    changed = {
        name: placement_of(origin)
        for name, origin in placements.items()
        if np.abs(origin - urdf[name].joint.placement.origin()).max() > ROUNDING
    }
    return _rewritten(path, changed)


def _moved(
    path: Path, urdf: Edges, placements: Mapping[str, Array], link: str, T_link_platform: Array
) -> dict[str, Array]:
    """Return the frames on a link, all fixed, moved with the platform's that was found off it."""
    on = [edge for edge in urdf.values() if edge.parent == link]
    if not on or any(edge.moves for edge in on):
        shift = ", ".join(f"{1e3 * v:.4g}" for v in T_link_platform[:3, 3])
        turn = ", ".join(f"{1e3 * v:.4g}" for v in placement_of(T_link_platform).rpy)
        raise MechanismError(
            f"{path}: the platform's frame was found ({shift}) mm and ({turn}) mrad off link "
            f"{link!r}, and no fixed joint of the URDF is there to hold it. Import with a "
            "--tip or --platform that is fixed to that link, or hold it (--fixed)"
        )
    joints = [edge.joint for edge in on]
    return {
        joint.name: T_link_platform @ placements.get(joint.name, joint.placement.origin())
        for joint in joints
    }


def _named(urdf: Edges, name: str) -> str | None:
    """Return the joint of a URDF that a joint of the mechanism is, or is an axis of."""
    stem = re.sub(r"_([xyz]|at)$", "", name)
    return name if name in urdf else stem if stem in urdf else None


def _legs_of(path: Path, urdf: Edges, mechanism: Mechanism) -> list[Leg]:
    """Return the legs whose joints, or whose platform points, are in a URDF."""
    legs: list[Leg] = []
    drawn: list[str | None] = []
    for leg in mechanism.legs:
        joints = {_named(urdf, joint.name) for joint in leg.moving} - {None}
        legs += [leg] * bool(joints)
        drawn += joints
    legs = legs or [leg for leg in mechanism.legs if leg.point.name in urdf]
    if not legs:
        every = [joint.name for leg in mechanism.legs for joint in leg.moving]
        raise MechanismError(
            f"{path} has none of the joints {listed(every)}; give the URDF that "
            f"{mechanism.name!r} was made from"
        )
    if len(set(drawn)) == len(drawn):
        return legs
    if not (meant := [leg for leg in legs if leg.name == path.stem]):
        raise MechanismError(
            f"{path}: {', '.join(leg.name for leg in legs)} have joints of these names; name the "
            f"file as the leg whose URDF it is, such as {legs[0].name}.urdf"
        )
    return meant


def _of_chain(path: Path, urdf: Edges, leg: Leg) -> dict[str, Array]:
    """Return the origins of a leg's joints by name, (4, 4), base first."""
    carriers = {edge.child: _named(urdf, name) for name, edge in urdf.items()}
    origins: dict[str, Array] = {}
    previous: str | None = None
    for joint in leg.joints:
        name = _named(urdf, joint.name)
        if name is None or name in origins:
            held = joint is leg.joints[-1] and leg.closes == "frame"  # see ``_shift``
            zeros = dict.fromkeys(joint.placement.parameter_units, 0.0)
            nominal = leg.with_parameters(zeros).joints[leg.joints.index(joint)].placement.origin()
            if not held and not _is_nothing(np.linalg.inv(nominal) @ joint.placement.origin()):
                raise MechanismError(
                    f"{path} has no joint {joint.name!r}, whose place was calibrated; give "
                    f"the URDF that the mechanism was made from, or hold {', '.join(zeros)} "
                    "(--fixed)"
                )
            previous = previous if name in origins else joint.name
            continue
        drawn, carrier = urdf[name].joint, carriers.get(urdf[name].parent)
        if origins and carrier != previous:
            raise MechanismError(
                f"{path}: joint {name!r} cannot be placed: it hangs on {carrier!r} there, on "
                f"{previous!r} in the mechanism"
            )
        if joint.kind != "fixed" and name == joint.name:
            turned = np.abs(np.subtract(drawn.axis, joint.axis)).max() > ROUNDING
            if drawn.kind != joint.kind or turned:
                raise MechanismError(
                    f"{path}: joint {name!r} cannot be placed: its axis there is another one than "
                    "in the mechanism, whose frames were turned on import"
                )
        origins[name] = joint.placement.origin()
        previous = name
    return origins


def _shift(urdf: Edges, leg: Leg) -> Array:
    """Return where the platform's frame is seen from the URDF's link at a leg's end, (4, 4).

    It moves the frames there if the URDF has no joint for it: that of a tip, or what a platform
    point was found to be off by.
    """
    last, shift = leg.joints[-1], np.eye(4)
    if leg.closes == "frame":
        return shift if last.name in urdf else last.placement.origin()
    if leg.point.name in urdf:
        return shift
    tip, names = _named(urdf, last.name), leg.point.placement.parameter_units
    if names and tip is not None and urdf[tip].moves:  # else the platform is in another file
        nominal = leg.with_parameters(dict.fromkeys(names, 0.0)).point.placement.xyz
        shift[:3, 3] = np.subtract(nominal, leg.point.placement.xyz)
    return shift


def _is_nothing(matrix: Array) -> bool:
    return bool(np.abs(matrix - np.eye(4)).max() <= ROUNDING)


def _rewritten(path: Path, origins: Mapping[str, Placement]) -> bytes:
    """Return a file's bytes with other origins of joints."""
    text = path.read_bytes()
    if text[:2] in (b"\xff\xfe", b"\xfe\xff") or b"\x00" in text[:100]:
        raise MechanismError(f"{path}: UTF-16 or UTF-32; save it as UTF-8")
    tags: dict[str, tuple[int, int]] = {}  # the start tags of the origins, or where they are to be
    stack: list[str] = []
    parser = expat.ParserCreate()

    def start(tag: str, attributes: dict[str, str]) -> None:
        begin, name = parser.CurrentByteIndex, attributes.get("name", "")
        match = _TAG.match(text, begin)
        end = match.end() if match else begin
        if tag == "joint" and len(stack) == 1 and name in origins:
            tags[name] = (end, end)
        elif tag == "origin" and len(stack) == 2 and stack[1] in tags:
            tags[stack[1]] = (begin, end)
        stack.append(name if tag == "joint" else "")

    parser.StartElementHandler = start
    parser.EndElementHandler = lambda _: stack.pop()
    parser.Parse(text, True)
    for name, (begin, end) in sorted(tags.items(), key=lambda item: item[1], reverse=True):
        tag = text[begin:end] or b"<origin/>"
        text = text[:begin] + _with_origin(tag, origins[name]) + text[end:]
    return text


def _with_origin(tag: bytes, placement: Placement) -> bytes:
    """Return the start tag of an <origin> with another place, its other bytes kept."""
    turn: tuple[str, Iterable[float]] = ("rpy", placement.rpy)
    if re.search(rb"\squat_xyzw\s*=", tag):
        turn = ("quat_xyzw", Rotation.from_matrix(placement.origin()[:3, :3]).as_quat())
    for key, values in (("xyz", placement.xyz), turn):
        numbers = " ".join(repr(float(v) + 0.0) for v in values).encode()
        pattern = rb"(\s" + key.encode() + rb"\s*=\s*)(\"[^\"]*\"|'[^']*')"
        if re.search(pattern, tag):
            tag = re.sub(pattern, rb'\g<1>"' + numbers + rb'"', tag, count=1)
        else:
            tag = re.sub(rb"\s*(/?>)$", b" " + key.encode() + b'="' + numbers + rb'"\g<1>', tag)
    return tag
