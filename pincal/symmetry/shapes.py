"""Shape of a leg in the base frame, and how far a carried leg deviates from another.

A leg closed at a pose is described by the axes of its joints and the point where it meets the
platform, independently of the frames in which it was drawn. A carried leg equals another leg if
that, closed at the carried pose in its working mode, has the same axes, and if its joints may move
as far from there. Gains and offsets of sensors do not count.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from copy import copy
from typing import TypeAlias

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial import distance_matrix

from pincal.kinematics.batches import lengths
from pincal.kinematics.closed_forms import closed_form
from pincal.kinematics.closing import close
from pincal.kinematics.closure import LegClosure
from pincal.model import Joint
from pincal.model.checks import wrapped
from pincal.symmetry.elements import Element, applied
from pincal.types import Array

Deviation: TypeAlias = tuple[str, float, str]
"""What differs, by how much (infinite if it cannot be compared), and the unit: m, rad or 1."""


def pointing_joints(legs: Sequence[LegClosure]) -> list[list[int]]:
    """Return indices of passive revolute joints that point rods or slides; their centre counts.

    Turned about the rod or slide they give the same leg, if limits bound half-spaces only. Legs
    whose joints are of the same kinds have all or none, whatever digits were cut.
    """
    kinds = [[joint.kind for joint in leg.leg.articulated] for leg in legs]
    by_leg = [*zip(kinds, map(_pointing, legs), strict=True)]
    return [min(joints for like, joints in by_leg if like == kind) for kind in kinds]


def _pointing(closure: LegClosure) -> list[int]:
    leg, form = closure.leg, closed_form(closure)
    joints = [index for index in range(len(leg.moving)) if form and index != form.driven]
    limited = any(leg.moving[index].limited for index in joints)
    free = not limited or (form and form.frame is None and form.reach().exact)
    return joints if free and not set(joints) & set(leg.active) else []


class StandingLeg:
    """A leg closed at a pose, in the base frame; its joints are all that move, geared ones too."""

    def __init__(self, closure: LegClosure, T: Array, pointing: list[int], *, near: bool) -> None:
        """Close a leg at a pose T, shape (4, 4), from its home joints if that is near home."""
        self.closure, leg, self.pointing = closure, closure.leg, pointing
        closed = close((closure,), T[None], near=leg.home[None] if near else None)
        self.reached = near or bool(closed.reached[0])
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

    @property
    def build(self) -> dict[str, object]:
        """Structure of the leg, by name of quantity; it must be equal for equal legs."""
        names = [joint.name for joint in self.joints]
        return {
            "kinds of joints": [joint.kind for joint in self.joints],
            "active joints": self.active,
            "gears": [names.index(joint.leader.joint) for joint in self.joints],
            "ends": sorted(str(end.closes) for end in self.closure.leg.every_end),
        }

    @property
    def base(self) -> Array:
        """Base point of the leg: on its first revolute axis, or else its tip, shape (3,), [m]."""
        turning = [i for i, joint in enumerate(self.joints) if joint.turns]
        return self.points[turning[0]] if turning else self.tip

    def like(self, first: StandingLeg, element: Element) -> StandingLeg:
        """Return this leg with joints and ends, if it is a tree, in the order of a carried leg.

        Each joint of the carried leg is matched with the nearest axis of the same kind.
        """
        counts = [(len(leg.joints), leg.build["ends"]) for leg in (first, self)]
        if not first.closure.leg.ends or counts[0] != counts[1]:
            return self
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


def deviations(first: StandingLeg, element: Element, second: StandingLeg) -> Iterator[Deviation]:
    """Yield what may differ between a carried leg and a leg at the carried pose."""
    second = second.like(first, element)
    builds = zip(first.build.items(), second.build.values(), strict=True)
    unlike = [quantity for (quantity, value), of_second in builds if value != of_second]
    if unlike or not second.reached:
        yield (*unlike, "reach of the pose that home is carried to")[0], np.inf, "1"
        return
    ratios = [[abs(j.leader.ratio) for j in shape.joints] for shape in (first, second)]
    yield "ratios of gears", float(np.ptp(ratios, axis=0).max(initial=0.0)), "m"
    shifts = applied(element.base, np.vstack((first.points, first.tips)))
    shifts = shifts - np.vstack((second.points, second.tips))
    names = [joint.name for joint in second.joints] + ["tip"] * len(second.tips)
    apart = lengths(shifts[:, : first.closure.platform.space]).tolist()
    for name, shift in zip(names, apart, strict=True):
        yield f"position of {name!r}", shift, "m"
    axial = [[np.linalg.det(element.matrix) if joint.turns else 1.0] for joint in first.joints]
    directions = axial * first.directions @ element.matrix.T
    signs = np.where((directions * second.directions).sum(axis=1) >= 0.0, 1.0, -1.0)
    chords = lengths(signs[:, None] * directions - second.directions)
    yield from _turns_apart(first, element.matrix, second, signs, chords)


def _turns_apart(
    first: StandingLeg, Q: Array, second: StandingLeg, signs: Array, chords: Array
) -> Iterator[Deviation]:
    """Yield the differences of joints, carried by Q, in directions and limits."""
    pointing = first.pointing if first.pointing == second.pointing else []
    axes = [(i, joint) for i, joint in enumerate(second.joints) if i not in pointing]
    for index, joint in axes:
        turn = 2.0 * float(np.arcsin(min(1.0, chords[index] / 2.0)))
        yield f"orientation of {joint.name!r}", turn, "rad"
    if pointing:
        name = second.joints[pointing[0]].name
        yield f"limits of {name!r}", _bars_apart(first, Q, second), "rad"
    for index, joint in axes:
        between = _limits_apart(first, second, index, signs[index])
        yield f"limits of {joint.name!r}", between, "rad" if joint.turns else "m"


def _bars_apart(first: StandingLeg, Q: Array, second: StandingLeg) -> float:
    """Return the largest angle between half-spaces, carried by Q, that bar two slides."""
    forms = (closed_form(leg.closure) for leg in (first, second))
    carried, bars = (form.reach().normals for form in forms if form)
    if len(carried) != len(bars):
        return np.inf
    bars = np.linalg.norm((carried @ Q.T)[:, None] - bars, axis=2)
    return float(bars.min(axis=1, initial=np.inf).max(initial=0.0))


def _limits_apart(first: StandingLeg, second: StandingLeg, index: int, sign: float) -> float:
    """Return the difference of a joint's limits, relative to the legs' positions."""
    if not (first.joints[index].limited or second.joints[index].limited):
        return 0.0
    carried, ends = (
        np.array((leg.joints[index].lower, leg.joints[index].upper)) - leg.positions[index]
        for leg in (first, second)
    )
    carried = carried if sign > 0.0 else -carried[::-1]
    with np.errstate(invalid="ignore"):
        shifts = np.where(carried == ends, 0.0, np.abs(carried - ends))
    if second.joints[index].turns and np.isfinite(shifts).all():
        shifts = np.abs(wrapped(shifts))
    return float(shifts.max())
