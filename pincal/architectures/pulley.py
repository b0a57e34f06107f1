"""A cable over a pulley: its anchor swivels about an axis, and part of the cable is wrapped.

The cable comes along the axis of the swivel and meets the pulley there, at the anchor A. Wrapped
by an angle θ it leaves the pulley of radius r where it is tangent, so that its length is r θ and
what is free (A. Pott, Cable-Driven Parallel Robots, Springer 2018, section 7.2). As joints: the
swivel; the turn by θ about the pulley's middle; the slide of the arc, which follows θ by r and
takes back what is wrapped; the line, whose position is the whole length.
"""

from __future__ import annotations

from dataclasses import replace
from math import atan2, hypot, pi, sqrt

import numpy as np

from pincal.errors import MechanismError
from pincal.model.checks import EXACT
from pincal.model.joint import Follows, Joint
from pincal.model.leg import Leg
from pincal.model.placement import Placement
from pincal.types import Array

UP = (0.0, 0.0, 1.0)


def over_pulley(
    leg: Leg, radius: float, name: str = "r", axis: tuple[float, float, float] = UP
) -> Leg:
    """Return a cable over a pulley; a leg that is a universal joint at its anchor and a line.

    Args:
        leg: The cable, closed at home.
        radius: Of the pulley, [m]; a parameter of the leg, its last.
        name: The parameter's.
        axis: Unit vector along the swivel, in which the cable comes to the pulley; base frame.

    Raises:
        MechanismError: the leg is no such cable, or its tip at home is within the pulley.

    Example:
        >>> import pincal
        >>> robot = pincal.load_mechanism("8cable")
        >>> pincal.over_pulley(robot.legs[0], 0.03).parameter_names[-1]
        'r'
    """
    if not is_cable(leg):
        raise MechanismError(
            f"{leg.name} runs over no pulley: expected a universal joint at the anchor, and a line "
            "through it that counts from there"
        )
    places = leg.link_placements(leg.home[None])[0, :, :3, 3]
    along = places[-1] - places[0]
    height = float(along @ axis)
    level = along - height * np.array(axis)
    radial = float(np.linalg.norm(level)) - radius
    if hypot(radial, height) <= radius or radial <= -radius:
        raise MechanismError(f"{leg.name}: its tip at home is within a pulley of {radius:g} m")
    free = sqrt(radial**2 + height**2 - radius**2)
    wrap = atan2(free * radial + radius * height, free * height - radius * radial)
    first, second, line, tip = leg.joints
    values = leg.nominal_by_name | {name: radius}
    constant = first.placement.rest(leg.nominal_by_name, leg.name).copy()
    drawn = first.placement.origin()[:3, :3] @ constant[:3, :3].T  # by coordinates that turn
    constant[:3, :3] = drawn.T @ _frame(level, np.array(axis))
    to_middle = Placement.of(values, x=name)
    middle = to_middle.at(values, np.diag((-1.0, -1.0, 1.0, 1.0)))  # from there x is back
    arc = Joint("arc", "prismatic", to_middle, (0.0, 0.0, -1.0))
    joints = (
        replace(first, placement=first.placement.at(values, constant), axis=UP, home=0.0),
        replace(second, placement=middle, axis=(0.0, -1.0, 0.0), lower=0.0, upper=pi, home=wrap),
        replace(arc, follows=Follows(second.name, radius), ratio=name),
        replace(line, placement=Placement(), axis=UP, home=free + radius * wrap),
    )
    parameters = (*leg.parameters, (name, radius))
    return replace(leg, joints=(*joints, tip), parameters=parameters)


def is_cable(leg: Leg) -> bool:
    """Return whether a leg is a universal joint and a driven line that counts from its centre."""
    kinds = [joint.kind for joint in leg.joints[:4]]
    if kinds != ["revolute", "revolute", "prismatic", "fixed"] or len(leg.joints) > 4:
        return False
    places = leg.link_placements(leg.home[None])[0, :, :3, 3]
    to_second, length = np.linalg.norm(places[[1, 3]] - places[0], axis=1).tolist()
    driven = leg.active == [2] and not leg.ends and leg.closes == "point"
    return driven and max(to_second, abs(length - leg.home[2])) <= EXACT * leg.size


def _frame(level: Array, axis: Array) -> Array:
    """Return the frame of a swivel, z its axis and x level towards home, shape (3, 3)."""
    length = float(np.linalg.norm(level))
    x = level / length if length else np.linalg.svd(axis[None])[2][1]
    return np.stack((x, np.cross(axis, x), axis), axis=1)
