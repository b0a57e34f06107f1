"""Legs carried by symmetry elements, and mechanisms generated from one leg.

Carried joints keep their variables: under a reflection Q every joint frame becomes
Q R D with the local mirror D = diag(1, −1, 1), a revolute axis a becomes −D a and a
prismatic one D a. In canonical form axes have a positive largest component, and a constant turn
about a joint's own axis is part of its zero (which gives the γ of the 3-RRR paper's Eq. 19).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation

from pincal.errors import MechanismError, SymmetryError
from pincal.kinematics.closing import close
from pincal.kinematics.closure import LegClosure
from pincal.model import LOAD, Joint, Leg, Mechanism, Placement, Platform, Sensor
from pincal.model.checks import ROUNDING, check_kinds
from pincal.model.placement import Coordinate, Value, floats, placement_of
from pincal.symmetry.elements import Element, isometry, wrapped
from pincal.types import Array
from pincal.words.numbers import listed

LOCAL_MIRROR = np.diag([1.0, -1.0, 1.0])
#: Components of a point that each kind of coordinate sets.
_GIVES = {"x": "x", "y": "y", "z": "z", "polar": "xy", "spherical": "xyz"}
_SIX = ("x", "y", "z", "rz", "ry", "rx")  # coordinates of any place, in order


class _Carrier:
    """An element that carries the parts of a leg; ``new`` collects the values of parameters."""

    def __init__(self, leg: Leg, element: Element) -> None:
        self.leg, self.element = leg, element
        self.old, self.new = leg.nominal_by_name, leg.nominal_by_name
        self.local = LOCAL_MIRROR if element.reflection else np.eye(3)
        self.on_base = {leg.joints[i].name for i in np.flatnonzero(np.less(leg.carriers, 0))}

    def joint(self, joint: Joint, closes: object = None) -> Joint:
        """Return a carried joint of the leg, or, if ``closes`` is given, a platform point."""
        placement, mirror = joint.placement, isometry(self.local)
        if closes or joint.name in self.on_base:
            G = self.element.bodies[1 if closes else 0]
            carried = Placement(self.moved(placement.coordinates, G))
        else:
            G, carried = mirror, Placement(self.within(placement.coordinates))
        constant = placement.rest(self.old, self.leg.name)
        image = G @ placement.displacement(self.old) @ constant @ mirror
        residual = np.linalg.inv(carried.displacement(self.new)) @ image
        if not carried.turns:  # exact
            residual[:3, :3] = image[:3, :3]
        if placement.coordinates and not (constant[:3, 3].any() or carried.corrects(self.new)):
            residual[:3, 3] = 0.0
        if closes == "point":  # the orientation of a point has no meaning
            residual[:3, :3] = constant[:3, :3]
        axis = self.local @ np.array(joint.axis)
        if joint.kind == "revolute":
            axis = np.linalg.det(self.local) * axis
        return replace(joint, placement=carried.at(self.new, residual), axis=floats(axis))

    def moved(self, coordinates: tuple[Coordinate, ...], G: Array) -> tuple[Coordinate, ...]:
        """Return the coordinates of a place on base or platform after the body's isometry G.

        An isometry that they cannot express becomes constants in front of them.
        """
        point = sum((c.displacement(self.old)[:3, 3] for c in coordinates), np.zeros(3))
        size = float(np.abs(point).max())
        image = G[:3, :3] @ point + (G[:3, 3] if size else 0.0)  # corrections stay zero
        image[np.abs(image) <= ROUNDING * (size + np.abs(G[:3, 3]).max())] = 0.0
        if not _express(coordinates, image, G):
            frame = placement_of(G @ isometry(self.local))
            values = zip(_SIX, (*frame.xyz, *frame.rpy[::-1]), strict=True)
            constants = (Coordinate(kind, (value,)) for kind, value in values if value)
            return (*constants, *self.within(coordinates))
        result = []
        for c in coordinates:
            pairs = zip(c.values, self.values(c, image, G), strict=True)
            result.append(Coordinate(c.kind, tuple(_set(v, to, self.new) for v, to in pairs)))
        return tuple(result)

    def values(self, c: Coordinate, image: Array, G: Array) -> list[float]:
        """Return a coordinate's values after G took its point to ``image``."""
        if c.kind in ("x", "y", "z"):
            return [float(image["xyz".index(c.kind)])]
        values = [_number(value, self.old) for value in c.values]
        # azimuths follow exactly, also of points on the axis
        turn, side = float(np.arctan2(G[1, 0], G[0, 0])), float(np.sign(np.linalg.det(G[:2, :2])))
        values[-1] = wrapped(turn + side * values[-1])
        if c.kind == "spherical" and G[2, 2] < 0.0:
            values[1] = np.pi - values[1]
        return values

    def within(self, coordinates: tuple[Coordinate, ...]) -> tuple[Coordinate, ...]:
        """Return coordinates within the leg, which a reflection mirrors."""
        if not self.element.reflection:
            return coordinates
        # the azimuth of polar and spherical coordinates changes sign
        return tuple(
            c
            if c.kind in ("x", "z", "ry")
            else Coordinate(c.kind, (*c.values[:-1], _negative(c.values[-1], self.old, self.new)))
            for c in coordinates
        )


def _express(coordinates: Sequence[Coordinate], image: Array, G: Array) -> bool:
    """Return whether coordinates express a place after an isometry G took its point to an image.

    Points in x, y, z go anywhere; azimuths, and a last turn about z, follow isometries that keep
    the line z.
    """
    kinds = {c.kind for c in coordinates}
    if any(c.turns for c in coordinates[:-1]) or {"rx", "ry"} & kinds:
        return False
    needed = {letter for letter, component in zip("xyz", image, strict=True) if component}
    keeps_z = not (G[:2, 2].any() or G[2, :2].any() or G[:3, 3].any())
    enough = needed.issubset("".join(_GIVES.get(kind, "") for kind in kinds))
    return enough and (keeps_z or kinds <= {"x", "y", "z"})


def _number(value: Value, parameters: dict[str, float]) -> float:
    return parameters[value] if isinstance(value, str) else value


def _set(value: Value, target: float, new: dict[str, float]) -> Value:
    """Return the target for a constant; for a parameter set it in ``new`` and return the name."""
    target += 0.0  # no negative zero
    if isinstance(value, str):
        new[value] = target
        return value
    return target


def _negative(value: Value, old: dict[str, float], new: dict[str, float]) -> Value:
    """Return minus a constant; for a parameter set minus its value and return the name."""
    return _set(value, -_number(value, old), new)


def carry(leg: Leg, element: Element) -> Leg:
    """Return a leg carried by an element, in canonical form.

    Joints on the base follow the base's isometry and platform points the platform's; within the leg
    a reflection mirrors the geometry.

    Raises:
        SymmetryError: parameters have terms.
    """
    if varying := [parameter for parameter, term in leg.terms if term.of != LOAD]:
        raise SymmetryError(
            f"{leg.name}: {listed(varying)} have terms, which the {element} may change; carry the "
            "leg without terms, and give them to the carried legs"
        )
    carrier = _Carrier(leg, element)
    return canonical(
        replace(
            leg,
            joints=tuple(carrier.joint(joint) for joint in leg.joints),
            point=carrier.joint(leg.point, leg.closes),
            ends=tuple(end.moved(partial(carrier.joint, closes=end.closes)) for end in leg.ends),
            parameters=tuple(carrier.new.items()),
        )
    )


def canonical(leg: Leg) -> Leg:
    """Return an equal leg with positive axes and no constant turns about joints' own axes."""
    parameters, joints = leg.nominal_by_name, []
    sensors = {sensor.joint: sensor for sensor in leg.sensors}
    followed = {joint.follows.joint for joint in leg.articulated if joint.follows}
    for joint in leg.joints:
        if joint in leg.moving and joint.name not in followed:
            joint, sensor = _recounted(joint, sensors.get(joint.name), parameters, leg.name)
            if sensor is not None:
                sensors[joint.name] = sensor
        joints.append(joint)
    return replace(
        leg,
        joints=tuple(joints),
        sensors=tuple(sensors.values()),
        parameters=tuple(parameters.items()),
    )


def _recounted(
    joint: Joint, sensor: Sensor | None, parameters: dict[str, float], name: str
) -> tuple[Joint, Sensor | None]:
    """Return a joint whose positions q count as ± q + turn, and its sensor.

    The largest component of its axis is then positive, and its placement has no constant turn about
    the axis.
    """
    axis = np.array(joint.axis)
    side = 1 if axis[np.argmax(np.abs(axis))] > 0 else -1
    axis, turn = side * axis, 0.0
    constant = joint.placement.rest(parameters, name).copy()
    if joint.turns and np.allclose(constant[:3, :3] @ axis, axis, atol=ROUNDING):
        turn = float(Rotation.from_matrix(constant[:3, :3]).as_rotvec() @ axis)
    if abs(turn) < 1e-15:
        turn = 0.0
    else:
        constant[:3, :3] = np.eye(3)
        joint = replace(joint, placement=joint.placement.at(parameters, constant))
        start = side * _start(joint, sensor, parameters)
        turn = wrapped(start + turn) - start
    lower, upper = sorted((side * joint.lower, side * joint.upper))
    shift, home = turn if upper - lower < 2 * np.pi else 0.0, side * joint.home + turn
    joint = replace(joint, axis=floats(axis), lower=lower + shift, upper=upper + shift, home=home)
    if sensor is not None:
        offset, zero = sensor.offset, sensor.zero
        if sensor.form == "joint":
            moved = side * _number(offset, parameters) + (0.0 if sensor.homed else turn)
            offset, turn = _set(offset, moved, parameters), 0.0
        for amplitude in {term.parameter for term in sensor.terms if term.of != LOAD}:
            parameters[amplitude] = side * parameters[amplitude] + 0.0  # loads change by themselves
        zero = zero if isinstance(zero, str) else side * zero + turn
        sensor = replace(sensor, direction=side * sensor.direction, zero=zero, offset=offset)
    return joint, sensor


def _start(joint: Joint, sensor: Sensor | None, parameters: dict[str, float]) -> float:
    """Return what counts a joint's positions, and stays within half a turn."""
    if sensor is None or isinstance(sensor.zero, str):
        return joint.home  # from which readings count, too
    return _number(sensor.offset, parameters) if sensor.form == "joint" else sensor.zero


def generate(
    name: str,
    leg: Leg,
    elements: Sequence[Element],
    platform: Platform,
    description: str = "",
    labels: Mapping[str, str] | None = None,
) -> Mechanism:
    """Return the mechanism whose legs are the images of one leg under the elements.

    Legs are named ``leg_1``, ``leg_2``, …; platform points whose names end in ``_1`` are numbered
    likewise. The leg's home may be rough: legs are closed at the platform's home, on its side.

    Args:
        name: Name of the mechanism.
        leg: The leg that is carried, in the base frame.
        elements: Elements of the symmetry group, the identity first.
        platform: The platform, with its home pose.
        description: Description of the mechanism in a sentence.
        labels: Descriptions of parameters for people, by name.

    Raises:
        MechanismError: a leg does not close at the home pose.
        SymmetryError: parameters of the leg have terms.
    """
    check_kinds(locals(), generate, MechanismError)
    closed = at_home(leg, platform)

    def numbered(number: int, joint: Joint) -> Joint:
        """Return a platform point whose name has the number of its leg."""
        name = joint.name
        return replace(joint, name=f"{name[:-2]}_{number}") if name.endswith("_1") else joint

    legs = []
    for number, element in enumerate(elements, start=1):
        made, rename = carry(closed, element), partial(numbered, number)
        ends = tuple(end.moved(rename) for end in made.ends)
        made = replace(made, name=f"leg_{number}", point=rename(made.point), ends=ends)
        legs.append(at_home(made, platform))
    return Mechanism(name, platform, tuple(legs), description, tuple((labels or {}).items()))


def at_home(leg: Leg, platform: Platform) -> Leg:
    """Return the leg with its home closed at the platform's home pose.

    Raises:
        MechanismError: the leg does not close there in the working mode of its rough home.
    """
    closed = close((LegClosure(leg, platform),), platform.home_pose.as_matrix())
    if not closed.reached[0]:
        raise MechanismError(
            f"{leg.name} does not reach the home pose {platform.home}; correct the home pose, the "
            "leg's lengths, or its home (which says on which side the leg bends)"
        )
    return leg.with_home(np.round(closed.joints[0], 12) + 0.0)
