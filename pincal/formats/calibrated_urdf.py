"""A user's own URDF with calibrated joint origins, every other byte as it was.

A joint of the mechanism and the joint of the URDF with its name sit on the same link if the joints
before them are the same: then the calibrated placement is the new origin. What the calibration
found between the last joint and the platform's frame, for which a URDF has no place if nothing is
fixed there, moves the frames that are fixed to the platform's link instead.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path
from xml.parsers import expat

import numpy as np
from scipy.spatial.transform import Rotation

from pincal.errors import MechanismError
from pincal.files.text import read_xml
from pincal.files.urdf import link_of
from pincal.formats.tree import listed
from pincal.formats.urdf_tree import read_urdf
from pincal.model.checks import ROUNDING
from pincal.model.leg import Joint, Leg
from pincal.model.mechanism import Mechanism
from pincal.model.placement import Placement, placement_of
from pincal.types import Array


def calibrated_urdf(original: str | Path, mechanism: Mechanism, leg: str | None = None) -> bytes:
    """Return the bytes of a URDF with the origins of a calibrated mechanism's joints.

    Args:
        original: The URDF whose joints the mechanism has: of an arm, of a tree with loops, of one
            leg of a mechanism folder, or of its platform.
        mechanism: At its calibrated parameters.
        leg: Whose URDF it is, if its joints are named as those of other legs; else it is the leg
            of the file's name.

    Raises:
        FileError: the file is missing or cannot be read.
        MechanismError: not well-formed, or a joint that it has no place for.
    """
    path = Path(original)
    urdf = _Urdf(path)
    origins: dict[str, Placement] = {}
    moved: list[tuple[str, Array]] = []
    for calibrated_leg in _legs_of(urdf, mechanism, leg):
        if urdf.joints_of(calibrated_leg):
            origins |= _of_chain(urdf, calibrated_leg)
        points, shift = _of_point(urdf, calibrated_leg)
        origins |= points
        moved += [(urdf.last_link(calibrated_leg), shift)] if shift is not None else []
    for link, T_link_platform in moved:
        on = [name for name, parent in urdf.parents.items() if parent == link]
        ends = [name for name in on if urdf.joints[name].kind == "fixed"]
        if not ends or len(ends) != len(on):
            raise MechanismError(
                f"{path}: the platform's frame was found {_words(T_link_platform)} off link "
                f"{link!r}, and no fixed joint of the URDF is there to hold it. Import with a "
                "--tip or --platform that is fixed to that link, or hold it (--fixed)"
            )
        for name in ends:
            origin = origins.get(name, urdf.joints[name].placement).origin()
            origins[name] = placement_of(T_link_platform @ origin)
    return _rewritten(path, {n: p for n, p in origins.items() if urdf.differs(n, p)})


class _Urdf:
    """Joints of a URDF by name, and how they hang together."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.joints: dict[str, Joint] = {}
        self.parents: dict[str, str] = {}
        self._children: dict[str, str] = {}
        joints = {edge.joint.name: edge.joint for edge in read_urdf(path).edges}
        for element in read_xml(path, "robot").findall("joint"):
            name = str(element.get("name"))
            if name in joints:  # those of links that float are not: nothing to calibrate
                self.joints[name] = joints[name]
                self.parents[name] = link_of(element, "parent", path)
                self._children[name] = link_of(element, "child", path)

    def named(self, name: str) -> str | None:
        """Return the joint that a joint of the mechanism is, or is an axis of; None if none."""
        if name in self.joints:
            return name
        stem = re.sub(r"_([xyz]|at)$", "", name)
        return stem if stem in self.joints else None

    def joints_of(self, leg: Leg) -> set[str]:
        """Return the joints that a leg's moving joints are, or are axes of."""
        return {name for joint in leg.moving if (name := self.named(joint.name))}

    def before(self, name: str) -> str | None:
        """Return the joint that carries a joint's parent link; None at the root."""
        return next(
            (
                joint_name
                for joint_name, link in self._children.items()
                if link == self.parents[name]
            ),
            None,
        )

    def last_link(self, leg: Leg) -> str:
        """Return the link after the last of a leg's joints that the URDF has."""
        return self._children[[n for n in map(self.named, (j.name for j in leg.joints)) if n][-1]]

    def differs(self, name: str, placement: Placement) -> bool:
        """Return whether a joint's origin is another one in the URDF."""
        change = placement.origin() - self.joints[name].placement.origin()
        return bool(np.abs(change).max() > ROUNDING)


def _legs_of(urdf: _Urdf, mechanism: Mechanism, name: str | None) -> list[Leg]:
    """Return the legs whose joints, or whose platform points, are in a URDF.

    Raises:
        MechanismError: none, or several with the same joints.
    """
    if name is not None:
        return [mechanism.leg(name)]
    joints = {leg.name: urdf.joints_of(leg) for leg in mechanism.legs}
    legs = [leg for leg in mechanism.legs if joints[leg.name]]
    legs = legs or [leg for leg in mechanism.legs if leg.point.name in urdf.joints]
    if not legs:
        every = [joint.name for leg in mechanism.legs for joint in leg.moving]
        raise MechanismError(
            f"{urdf.path} has none of the joints {listed(every)}; give the URDF that "
            f"{mechanism.name!r} was made from"
        )
    names = [name for leg in legs for name in joints[leg.name]]
    if len(set(names)) == len(names):
        return legs
    meant = [leg for leg in legs if leg.name == urdf.path.stem]
    if not meant:
        raise MechanismError(
            f"{urdf.path}: {', '.join(leg.name for leg in legs)} have joints of these names; say "
            "whose URDF it is (--leg)"
        )
    return meant


def _of_chain(urdf: _Urdf, leg: Leg) -> dict[str, Placement]:
    """Return the origins of a leg's joints by name.

    Raises:
        MechanismError: a joint with parameters that the URDF lacks, or has elsewhere.
    """
    origins: dict[str, Placement] = {}
    previous: str | None = None
    for joint in leg.joints:
        name = urdf.named(joint.name)
        if name is None or name in origins:
            held = joint is leg.joints[-1] and leg.closes == "frame"  # see ``_of_point``
            if not held and _displaced(leg, joint):
                raise MechanismError(
                    f"{urdf.path} has no joint {joint.name!r}, whose place was calibrated; give "
                    "the URDF that the mechanism was made from, or hold "
                    f"{', '.join(joint.placement.parameter_units)} (--fixed)"
                )
            previous = previous if name in origins else joint.name
            continue
        drawn, carrier = urdf.joints[name], urdf.before(name)
        if origins and carrier != previous:
            raise MechanismError(
                f"{urdf.path}: joint {name!r} cannot be placed: it hangs on {carrier!r} there, on "
                f"{previous!r} in the mechanism"
            )
        one_axis = joint.kind != "fixed" and name == joint.name
        if one_axis and (
            drawn.kind != joint.kind or np.abs(np.subtract(drawn.axis, joint.axis)).max() > ROUNDING
        ):
            raise MechanismError(
                f"{urdf.path}: joint {name!r} cannot be placed: its axis there is another one than "
                "in the mechanism, whose frames were turned on import"
            )
        origins[name] = Placement((), joint.placement.xyz, joint.placement.rpy)
        previous = name
    return origins


def _displaced(leg: Leg, joint: Joint) -> bool:
    """Return whether a joint's parameters have moved it from where they are all zero."""
    zeros = dict.fromkeys(joint.placement.parameter_units, 0.0)
    if not zeros:
        return False
    nominal = next(j for j in leg.with_parameters(zeros).joints if j.name == joint.name)
    return not _is_nothing(np.linalg.inv(nominal.placement.origin()) @ joint.placement.origin())


def _of_point(urdf: _Urdf, leg: Leg) -> tuple[dict[str, Placement], Array | None]:
    """Return the origin of a leg's platform point, or else how the platform's link moves.

    The latter is ``T_link_platform`` of the link that the leg ends with in the URDF.
    """
    last = leg.joints[-1]
    tip = urdf.named(last.name)
    if leg.closes == "frame":
        if last.name in urdf.joints:
            return {}, None
        shift = last.placement.origin()
        return {}, None if _is_nothing(shift) else shift
    if leg.point.name in urdf.joints:
        placement = leg.point.placement
        return {leg.point.name: Placement((), placement.xyz, placement.rpy)}, None
    names = list(leg.point.placement.parameter_units)
    carries = tip is not None and urdf.joints[tip].kind != "fixed"
    if not names or not carries:  # the platform is in another file
        return {}, None
    nominal = leg.with_parameters(dict.fromkeys(names, 0.0)).point.placement.origin()
    shift = np.eye(4)
    shift[:3, 3] = nominal[:3, 3] - leg.point.placement.origin()[:3, 3]
    return {}, None if _is_nothing(shift) else shift


def _is_nothing(matrix: Array) -> bool:
    return bool(np.abs(matrix - np.eye(4)).max() <= ROUNDING)


def _words(matrix: Array) -> str:
    shift = ", ".join(f"{1e3 * v:.4g}" for v in matrix[:3, 3])
    turn = ", ".join(f"{1e3 * v:.4g}" for v in placement_of(matrix).rpy)
    return f"({shift}) mm and ({turn}) mrad"


def _rewritten(path: Path, origins: dict[str, Placement]) -> bytes:
    """Return a file's bytes with other origins of joints.

    Raises:
        MechanismError: an encoding in which a tag is no ASCII.
    """
    text = path.read_bytes()
    if text[:2] in (b"\xff\xfe", b"\xfe\xff") or b"\x00" in text[:100]:
        raise MechanismError(f"{path}: UTF-16 or UTF-32; save it as UTF-8")
    changes = sorted(_places(text, origins), reverse=True)
    for begin, end, new in changes:
        text = text[:begin] + new + text[end:]
    return text


def _places(text: bytes, origins: dict[str, Placement]) -> Iterable[tuple[int, int, bytes]]:
    """Return where the origins' start tags are, first and last byte, and what to write there."""
    changes: list[tuple[int, int, bytes]] = []
    stack: list[tuple[str, str | None]] = []
    missing: dict[str, int] = {}
    parser = expat.ParserCreate()

    def start(tag: str, attributes: dict[str, str]) -> None:
        begin = parser.CurrentByteIndex
        end = begin + _tag_length(text[begin:])
        if stack and stack[-1][0] == "joint" and tag == "origin":
            name = stack[-1][1]
            if name in missing:
                del missing[name]
                changes.append((begin, end, _with_origin(text[begin:end], origins[name])))
        stack.append((tag, attributes.get("name")))
        if tag == "joint" and len(stack) == 2 and attributes.get("name") in origins:
            missing[attributes["name"]] = end

    def close(_: str) -> None:
        stack.pop()

    parser.StartElementHandler = start
    parser.EndElementHandler = close
    parser.Parse(text, True)
    for name, end in missing.items():
        changes.append((end, end, _with_origin(b"<origin/>", origins[name])))
    return changes


def _tag_length(text: bytes) -> int:
    """Return the length of a start tag, whose attributes may hold '>'."""
    match = re.match(rb"<(?:[^>\"']|\"[^\"]*\"|'[^']*')*>", text)
    return match.end() if match else 0


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
