"""Shape of a leg in the base frame, and the differences between a carried leg and another.

A leg closed at a pose is described by the axes of its joints and the point where it meets the
platform, independently of the frames in which it was drawn. A carried leg equals another leg if
that, closed at the carried pose in its working mode, has the same axes, if its joints may move as
far from there, and if its sensors read the same.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial import distance_matrix

from pincal.kinematics.batches import lengths
from pincal.kinematics.closed_forms import closed_form
from pincal.kinematics.closing import close, sensor_law
from pincal.kinematics.closure import LegClosure
from pincal.model import LOAD, Joint
from pincal.model.checks import wrapped
from pincal.symmetry.elements import Element, applied
from pincal.types import Array
from pincal.words.numbers import POSES, amount, listed

HOME = "home pose"
HOME_MOVES = "the home pose, from which sensors count, is carried elsewhere"
_READINGS = np.linspace(-1.0, 1.0, 7)
"""Distances from the leg's position at which sensors are compared, [rad], or over its size."""


@dataclass(frozen=True)
class Difference:
    """One quantity in which two legs differ."""

    quantity: str
    deviation: float | None
    """Size of the difference, in the unit; None where it is not a number."""
    unit: str = "1"
    """Unit of the deviation: m, rad or 1."""
    of_sensor: bool = False
    """Whether only the sensors differ: the legs move alike, their readings differ."""
    element: Element | None = None
    """The element that the difference keeps out of a group."""
    leg: str = ""
    """Name of the leg onto which the element should have carried another leg."""

    def exceeds(self, tolerance: float, size: float) -> bool:
        """Return whether it exceeds a tolerance, relative to a size [m] for lengths."""
        scale = size if self.unit == "m" else 1.0
        return self.deviation is None or not self.deviation <= tolerance * scale

    def __str__(self) -> str:
        """Return a sentence that says why the element is no symmetry."""
        return no_symmetries([self])[0]


def no_symmetries(breaks: Sequence[Difference]) -> list[str]:
    """Return sentences that say why elements are no symmetries, one for each reason."""
    by_reason: dict[str, list[Difference]] = {}
    for broken in breaks:
        reason = broken.quantity
        if broken.deviation is not None:
            reason += f", by {amount(broken.deviation, broken.unit, 4, POSES)}"
        by_reason.setdefault(reason, []).append(broken)
    sentences = []
    for reason, breaks_alike in by_reason.items():
        elements = listed(dict.fromkeys(str(broken.element) for broken in breaks_alike))
        legs = list(dict.fromkeys(broken.leg for broken in breaks_alike))
        differ = f"differ{'s' * (len(legs) == 1)} from what is carried there in {reason}"
        cause = HOME_MOVES if breaks_alike[0].quantity == HOME else f"{listed(legs)} {differ}"
        sentences.append(f"{elements}: {cause}")
    return sentences


class StandingLeg:
    """A leg closed at a pose, in the base frame; its joints are all that move, geared ones too."""

    def __init__(self, closure: LegClosure, matrix: Array, *, near_home: bool) -> None:
        """Close a leg at a pose, shape (4, 4), from its home joints if that is near home."""
        self.closure, leg = closure, closure.leg
        closed = close((closure,), matrix[None], near=leg.home[None] if near_home else None)
        self.reached = near_home or bool(closed.reached[0])
        moved = closed.joints if closed.reached[0] else leg.home[None]
        self.joints: Sequence[Joint] = leg.articulated
        names = [joint.name for joint in self.joints]
        by_name = dict(zip((joint.name for joint in leg.moving), moved[0], strict=True))
        self.positions = np.array([joint.position(by_name) for joint in self.joints])
        """Positions of the joints, shape (n_joints,), [rad] or [m]."""
        self.active = [names.index(sensor.joint) for sensor in leg.sensors]
        links, space = leg.link_placements(moved)[0], closure.platform.space
        frames = links[[leg.index(name) for name in names]]
        axes = np.array([joint.axis for joint in self.joints])
        self.directions = np.einsum("jkl,jl->jk", frames[:, :3, :3], axes)
        """Unit vectors of the joints' axes, shape (n_joints, 3)."""
        ends = [leg.index(end.tip) for end in leg.every_end if end.point]
        self.tips: Array = links[ends, :3, 3] * (np.arange(3) < space)
        """Points where the leg meets the platform, shape (n_ends, 3), [m]."""
        self.tip: Array = self.tips.mean(axis=0)
        """Mean of the tips, shape (3,), [m]."""
        self.ends = [point.name for point in leg.points]
        """Names of the platform points at the tips."""
        turns = np.array([[joint.turns] for joint in self.joints])
        along = ((self.tip - frames[:, :3, 3]) * self.directions).sum(axis=1, keepdims=True)
        nearest = (frames[:, :3, 3] + along * self.directions) * (np.arange(3) < space)
        self.points = np.where(turns, nearest, self.tip)
        """A point on each joint's axis, shape (n_joints, 3), [m]: the nearest to the tip, or, if
        there is a pointing joint, to its centre; a slide's axis is drawn through the tip."""
        if self.pointing:
            centre = self.points[self.pointing[-1]]
            along = ((centre - self.points) * self.directions).sum(axis=1, keepdims=True)
            self.points = self.points + along * self.directions
            self.points[self.pointing] = centre

    @cached_property
    def pointing(self) -> list[int]:
        """Indices of passive revolute joints that point a rod or slide; only their centre counts.

        Turned about the rod or slide they give the same leg, if limits bound half-spaces only.
        """
        leg, form = self.closure.leg, closed_form(self.closure)
        if form is None:
            return []
        joints = [index for index in range(len(leg.moving)) if index != form.driven]
        limited = any(leg.moving[index].limited for index in joints)
        return [] if set(joints) & set(leg.active) or (limited and self.barred is None) else joints

    @cached_property
    def barred(self) -> Array | None:
        """Normals of the half-spaces to which limits confine a slide, (k, 3); None for others."""
        form = closed_form(self.closure)
        reach = form.reach() if form is not None and form.frame is None else None
        return None if reach is None or not reach.exact else reach.normals

    @property
    def build(self) -> dict[str, object]:
        """Structure of the leg, by name of quantity; it must be equal for equal legs."""
        names = [joint.name for joint in self.joints]
        return {
            "sequence of joints": [joint.kind for joint in self.joints],
            "active joint": self.active,
            "gears": [names.index(joint.leader.joint) for joint in self.joints],
            "end": sorted(str(end.closes) for end in self.closure.leg.every_end),
        }

    @property
    def base(self) -> Array:
        """Base point of the leg: on its first revolute axis, or else its tip, shape (3,), [m]."""
        turning = [i for i, joint in enumerate(self.joints) if joint.turns]
        return self.points[turning[0]] if turning else self.tip

    def like(self, first: StandingLeg, element: Element) -> StandingLeg:
        """Return this leg, a tree, with joints and ends in the order of a leg that is carried here.

        Each joint of the carried leg is matched with the nearest axis of the same kind.
        """
        size, Q = self.closure.leg.size, element.matrix
        apart = np.abs((first.directions @ Q.T) @ self.directions.T)
        far = distance_matrix(applied(element.base, first.points), self.points) / size
        unlike = [[a.kind != b.kind for b in self.joints] for a in first.joints]
        order = linear_sum_assignment(far + (1.0 - apart) + 1e6 * np.array(unlike))[1]
        ends = distance_matrix(applied(element.base, first.tips), self.tips)
        ordered = copy(self)
        ordered.joints = [self.joints[index] for index in order]
        ordered.positions, ordered.directions = self.positions[order], self.directions[order]
        ordered.points, ordered.tips = self.points[order], self.tips[linear_sum_assignment(ends)[1]]
        ordered.active = [order.tolist().index(index) for index in self.active]
        return ordered


def differences(first: StandingLeg, element: Element, second: StandingLeg) -> Iterator[Difference]:
    """Yield the differences of a leg, carried by an element, from a leg at the carried pose."""
    builds = first.build, second.build
    ends_alike = builds[0]["end"] == builds[1]["end"]
    if first.closure.leg.ends and ends_alike and len(first.joints) == len(second.joints):
        second = second.like(first, element)
        builds = builds[0], second.build
    unlike = [quantity for quantity, value in builds[0].items() if builds[1][quantity] != value]
    if unlike or not second.reached:
        reach = "reach of the pose that home is carried to"
        yield Difference(next(iter(unlike), reach), None)
        return
    ratios = [[abs(j.leader.ratio) for j in shape.joints] for shape in (first, second)]
    yield Difference("ratios of gears", float(np.ptp(ratios, axis=0).max(initial=0.0)), "m")
    shifts = applied(element.base, np.vstack((first.points, first.tips)))
    shifts = shifts - np.vstack((second.points, second.tips))
    apart = lengths(shifts[:, : first.closure.platform.space])
    names = [joint.name for joint in second.joints]
    for name, shift in zip([*names, *second.ends], apart.tolist(), strict=True):
        yield Difference(f"position of joint {name!r}", shift, "m")
    yield from _turns_apart(first, element.matrix, second)


def _turns_apart(first: StandingLeg, Q: Array, second: StandingLeg) -> Iterator[Difference]:
    """Yield the differences of joints, carried by Q, in directions, limits and readings."""
    pointing = first.pointing if first.pointing == second.pointing else []
    names = [joint.name for joint in second.joints]
    axes = [index for index in range(len(names)) if index not in pointing]
    axial = [[np.linalg.det(Q) if joint.turns else 1.0] for joint in first.joints]
    directions = axial * first.directions @ Q.T
    signs = np.where((directions * second.directions).sum(axis=1) >= 0.0, 1.0, -1.0)
    chords = lengths(signs[:, None] * directions - second.directions)
    angles = 2.0 * np.arcsin(np.minimum(1.0, chords / 2.0))
    for index in axes:
        yield Difference(f"orientation of joint {names[index]!r}", float(angles[index]), "rad")
    if pointing:
        bars: float | None = 0.0  # no half-spaces to compare
        if first.barred is not None and second.barred is not None:
            shifts = np.linalg.norm((first.barred @ Q.T)[:, None] - second.barred, axis=2)
            alike = len(first.barred) == len(second.barred)
            bars = float(shifts.min(axis=1, initial=np.inf).max(initial=0.0)) if alike else None
        yield Difference(f"orientation of joint {names[pointing[0]]!r}", bars, "rad")
    for index in axes:
        if first.joints[index].limited or second.joints[index].limited:
            yield _limits_apart(first, second, index, signs[index])
    yield from _readings_apart(first, second, signs[first.active])


def _limits_apart(first: StandingLeg, second: StandingLeg, index: int, sign: float) -> Difference:
    """Return the difference of a joint's limits, relative to the legs' positions."""
    carried, ends = (
        np.array((leg.joints[index].lower, leg.joints[index].upper)) - leg.positions[index]
        for leg in (first, second)
    )
    carried, joint = carried if sign > 0.0 else -carried[::-1], second.joints[index]
    with np.errstate(invalid="ignore"):
        shifts = np.where(carried == ends, 0.0, np.abs(carried - ends))
    finite = bool(np.isfinite(shifts).all())
    if joint.turns and finite:
        shifts = np.abs(wrapped(shifts))
    deviation = float(shifts.max()) if finite else None
    return Difference(f"limits of joint {joint.name!r}", deviation, "rad" if joint.turns else "m")


def _readings_apart(first: StandingLeg, second: StandingLeg, signs: Array) -> Iterator[Difference]:
    """Yield the differences of active joints' motions at equal readings."""
    leg, image = first.closure.leg, second.closure.leg
    if [sensor.homed for sensor in leg.sensors] != [sensor.homed for sensor in image.sensors]:
        yield Difference("zero of the sensor", None, of_sensor=True)
        return
    if len(leg.influences) != len(image.influences):
        yield Difference("terms of the sensor", None, of_sensor=True)
        return
    home = sensor_law(first.closure).reading(first.positions[None, first.active])
    scales = [1.0 if unit == "rad" else leg.size for unit in leg.reading_units]
    readings, moved = home + np.outer(_READINGS, scales), []
    for shape, sides in ((first, signs), (second, np.ones(len(signs)))):
        names = shape.closure.leg.reading_names
        loads = {f"{LOAD}_{name}": side for name, side in zip(names, sides, strict=True)}
        influences = [loads.get(name, 1.0) for name in shape.closure.leg.influences]
        known = np.hstack((readings, np.tile(influences, (len(readings), 1))))
        position = sensor_law(shape.closure).position(known)
        moved.append(sides * (position - shape.positions[shape.active]))
    for unit, shifts in zip(leg.reading_units, (moved[0] - moved[1]).T, strict=True):
        if unit == "rad":
            shifts = wrapped(shifts)
        yield Difference("reading of the sensor", float(np.abs(shifts).max()), unit, of_sensor=True)
