"""Closed-form inverse kinematics of legs that point at the platform: rods and lines.

A pointing joint, a revolute in the plane or a universal in space, carries either a rod, and
is moved along a circle or a line by a drive (planar dyads, deltas, rotary hexapods, carriages),
or a slide through its own centre (struts, cables). They give the start from which Newton's
method on the closure needs one step, and say at once what is out of reach. Axes and points
are read off the calibration chain at zero joint positions, so that the forms hold for any
parameter values and URDF frames.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from pincal.kinematics.closure import LegClosure
from pincal.kinematics.forest import cross

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
#: Joint positions (N, n_joints) that take the tip to targets (N, 3), and which are in reach.
ClosedForm = Callable[[LegClosure, Array], tuple[Array, Mask]]
_EXACT = 1e-12  # of the leg's size


@lru_cache(maxsize=256)
def closed_form(closure: LegClosure) -> ClosedForm | None:
    """Return the closed form of a leg, or None if it has none."""
    if closure.leg.closes == "frame":
        return None
    kinds = [joint.kind for joint in closure.leg.moving]
    pointing = ["revolute"] * (closure.platform.space - 1)
    if kinds[1:] == pointing and _points(closure, rod=True):
        return driven_rod
    if kinds == [*pointing, "prismatic"] and _points(closure, rod=False):
        return pointing_slide
    return None


def is_line(closure: LegClosure) -> bool:
    """Return whether a leg is a driven slide on a universal joint, which only measures a length.

    The joint's two ways of pointing somewhere are one line; turned about it, it is no other leg.
    """
    return closure.leg.active == [2] and closed_form(closure) is pointing_slide


@dataclass(frozen=True)
class Pointing:
    """A pointing joint at zero joint positions, read off its chain; base frame.

    With axes e₁ ⟂ e₂ and e₃ = e₁ × e₂, it points along
    u = e₁ sin(q₂ + δ) + (e₃ cos q₁ − e₂ sin q₁) cos(q₂ + δ). A revolute joint in the plane is
    the same with q₂ + δ = 0.
    """

    arm: Array
    """From the joint's centre to the tip, shape (3,), [m]."""
    e1: Array
    e2: Array
    e3: Array
    """Unit axes of a universal joint and their product, shape (3,)."""
    delta: float
    """Angle from e₃ to the pointing direction towards e₁, [rad]."""
    side: float
    """Sign of cos(q₂ + δ) at home: of the two ways of pointing somewhere, which is meant."""

    def angles(self, u: Array) -> Array:
        """Return the joint's angles when it points along unit vectors (N, 3), shape (N, 1 or 2)."""
        along, across, up = u @ self.e1, u @ self.e2, u @ self.e3
        q1 = np.arctan2(-self.side * across, self.side * up)
        q2 = np.arctan2(along, self.side * np.hypot(across, up)) - self.delta
        return np.stack((q1, q2), axis=1)


def pointing_slide(closure: LegClosure, targets: Array) -> tuple[Array, Mask]:
    """Return the angles of a pointing joint and the length of the slide through its centre.

    Every target but the centre is in reach.
    """
    leg, form = closure.leg, slide_geometry(closure)
    arm = _in_space(closure, targets - form.centre)
    length = np.linalg.norm(arm, axis=1)
    with np.errstate(all="ignore"):
        angles = form.pointing.angles(form.forth * arm / length[:, None])
    turns = angles[:, : len(leg.moving) - 1]
    turns = leg.home[:-1] + wrapped(turns - leg.home[:-1])
    return np.column_stack((turns, form.forth * length - form.shift)), length > 0.0


@dataclass(frozen=True)
class SlideGeometry:
    """A slide on a pointing joint at zero joint positions, read off its chain."""

    centre: Array
    """Of the pointing joint, base frame, shape (3,), [m]."""
    pointing: Pointing
    shift: float
    """How far beyond the centre the slide is at zero, [m]."""
    forth: float
    """Sign of the slide's distance from the centre at home."""


@lru_cache(maxsize=256)
def slide_geometry(closure: LegClosure) -> SlideGeometry:
    """Return the geometry of a slide on a pointing joint."""
    tips, columns = closure.joint_columns(np.zeros((1, len(closure.leg.moving))))
    start = _arm(columns[:, 0, :-1])
    shift = float(start @ columns[:3, 0, -1])
    forth = float(np.sign(closure.leg.home[-1] + shift)) or 1.0
    pointing = _pointing(closure, columns[:, 0, :-1], columns[:3, 0, -1], first=0)
    return SlideGeometry(tips[0] - start, pointing, shift, forth)


def driven_rod(closure: LegClosure, targets: Array) -> tuple[Array, Mask]:
    """Return the drive's position and the angles of the pointing joint that it moves.

    The joint's centre C(q) lies on a circle or a line, and as far from the target as the rod
    is long: |t − C(q)| = L has two solutions, on either side of where the drive loses its grip,
    (t − C) · ∂C/∂q = 0. The one on the side of home is taken. A target out of reach gets the
    leg stretched or folded towards it.
    """
    leg, rod = closure.leg, rod_geometry(closure)
    arm = _in_space(closure, targets - rod.centre)
    with np.errstate(all="ignore"):
        if rod.axis is None:
            along = arm @ rod.speed
            square = along**2 - np.einsum("ni,ni->n", arm, arm) + rod.length**2
            possible = square >= 0.0
            drive = along - rod.mode * np.sqrt(np.clip(square, 0.0, None))
            to_tip = arm - drive[:, None] * rod.speed
        else:
            out, on = arm @ rod.out, arm @ rod.speed
            square = np.einsum("ni,ni->n", arm, arm) + rod.radius**2 - rod.length**2
            cos = np.nan_to_num(square / (2 * np.hypot(out, on)))  # at the centre, any angle
            possible = np.abs(cos) <= 1.0
            cos = np.clip(cos, -1.0, 1.0)
            drive = np.arctan2(on, out) - rod.mode * np.arctan2(np.sqrt((1 - cos) * (1 + cos)), cos)
            drive = leg.home[0] + wrapped(drive - leg.home[0])
            c, s = np.cos(drive)[:, None], np.sin(drive)[:, None]
            to_tip = arm - c * rod.out - s * rod.speed
            to_tip = _turned_back(rod.axis, c, s, to_tip)
        angles = rod.pointing.angles(to_tip / np.linalg.norm(to_tip, axis=1)[:, None])
    turns = angles[:, : len(leg.moving) - 1]
    turns = leg.home[1:] + wrapped(turns - leg.home[1:])
    return np.column_stack((drive, turns)), possible


@dataclass(frozen=True)
class RodGeometry:
    """A driven rod at zero joint positions, read off its chain; base frame.

    The pointing joint is at C(q) = centre + out cos q + speed sin q, out ⟂ speed, or at
    C(q) = centre + speed q on a line.
    """

    centre: Array
    """Of the circle, or where the line begins, shape (3,), [m]."""
    axis: Array | None
    """Unit axis of the circle, shape (3,); None for a line."""
    out: Array
    """From the circle's centre to the pointing joint, shape (3,), [m]; zero for a line."""
    speed: Array
    """Velocity of the pointing joint for a unit rate of the drive, shape (3,), [m] or [1]."""
    pointing: Pointing
    mode: float
    """Sign of (t − C) · ∂C/∂q at home."""

    @property
    def radius(self) -> float:
        """Radius of the circle, [m]; zero for a line."""
        return float(np.linalg.norm(self.out))

    @property
    def length(self) -> float:
        """Length of the rod, [m]."""
        return float(np.linalg.norm(self.pointing.arm))


@lru_cache(maxsize=256)
def rod_geometry(closure: LegClosure) -> RodGeometry:
    """Return the geometry of a driven rod."""
    leg = closure.leg
    tips, columns = closure.joint_columns(np.stack((np.zeros(len(leg.moving)), leg.home)))
    pointing = _pointing(closure, columns[:, 0, 1:], _arm(columns[:, 0]), first=1)
    point, speed = tips[0] - pointing.arm, columns[:3, 0, 0]
    axis, out = None, np.zeros(3)
    if leg.moving[0].kind == "revolute":
        axis = columns[3:, 0, 0]
        speed = speed - np.cross(axis, pointing.arm)
        out = np.cross(speed, axis)
    at_home = _arm(columns[:, 1])  # drive and rod as they are there
    grip = at_home @ (columns[:3, 1, 0] - np.cross(columns[3:, 1, 0], at_home))
    return RodGeometry(point - out, axis, out, speed, pointing, float(np.sign(grip)) or 1.0)


def _pointing(closure: LegClosure, axes: Array, arm: Array, first: int) -> Pointing:
    """Return a pointing joint from its twists at the tip, shape (6, 1 or 2), and its arm, [m]."""
    u = arm / np.linalg.norm(arm)
    e1 = axes[3:, 0]
    if axes.shape[1] == 1:
        return Pointing(arm, e1, np.cross(u, e1), u, 0.0, 1.0)
    e2 = axes[3:, 1]
    e3 = np.cross(e1, e2)
    delta = float(np.arctan2(u @ e1, u @ e3))
    side = float(np.sign(np.cos(closure.leg.home[first + 1] + delta))) or 1.0
    return Pointing(arm, e1, e2, e3, delta, side)


def _arm(columns: Array) -> Array:
    """Return the arm from the last axis, which it crosses at a right angle, to the tip, (3,)."""
    return np.cross(columns[:3, -1], columns[3:, -1])


def _points(closure: LegClosure, rod: bool) -> bool:
    """Return whether revolute axes cross at right angles, and the arm starts where they do."""
    columns = closure.joint_columns(np.zeros((1, len(closure.leg.moving))))[1][:, 0]
    axes, arm = (columns[:, 1:], _arm(columns)) if rod else (columns[:, :-1], columns[:3, -1])
    start = arm if rod else _arm(axes)  # from the crossing to the tip
    missed = np.abs(axes[:3].T - np.cross(axes[3:].T, start)).max()
    skew = [] if closure.platform.space == 2 else [axes[3:, 0] @ axes[3:, 1]]
    skew += [] if rod else [axes[3:, -1] @ arm]
    small = _EXACT * closure.size
    beside = 0.0 if rod else float(np.linalg.norm(np.cross(start, arm)))
    degenerate = rod and np.linalg.norm(arm) <= small
    missed = max(missed, beside)
    return bool(missed <= small and np.abs(skew).max(initial=0.0) <= _EXACT and not degenerate)


def _in_space(closure: LegClosure, vectors: Array) -> Array:
    """Return vectors, shape (N, 3), in the plane without their heights."""
    return vectors if closure.platform.space == 3 else vectors * (1.0, 1.0, 0.0)


def _turned_back(axis: Array, c: Array, s: Array, vectors: Array) -> Array:
    """Return vectors, shape (N, 3), turned about an axis by −q, with c, s = cos q, sin q (N, 1)."""
    across = cross(np.broadcast_to(axis, vectors.shape), vectors)
    along = (vectors @ axis)[:, None] * axis
    return along + c * (vectors - along) - s * across


def wrapped(angles: Array) -> Array:
    """Return angles in [-pi, pi)."""
    with np.errstate(invalid="ignore"):
        return (angles + np.pi) % (2 * np.pi) - np.pi
