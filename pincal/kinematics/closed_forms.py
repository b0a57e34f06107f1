"""Closed-form inverse kinematics of legs that have one: planar dyads and universal-prismatic legs.

They give the start from which Newton's method on the closure needs one step, and say at
once what is out of reach. Axes and points are read off the calibration chain at zero
joint positions, so that the forms hold for any parameter values and URDF frames.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pincal.kinematics.closure import LegClosure
from pincal.kinematics.forest import cross

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
#: Joint positions (N, n_joints) that take the tip to targets (N, 3), and which are in reach.
ClosedForm = Callable[[LegClosure, Array], tuple[Array, Mask]]
_EXACT = 1e-12  # of the leg's size


def closed_form(closure: LegClosure) -> ClosedForm | None:
    """Return the closed form of a leg, or None if it has none."""
    if closure.leg.closes == "frame":
        return None
    kinds = [joint.kind for joint in closure.leg.moving]
    spatial = closure.platform.space == 3
    if not spatial and kinds == ["revolute", "revolute"]:
        return planar_dyad
    if spatial and kinds == ["revolute", "revolute", "prismatic"] and _is_universal(closure):
        return universal_prismatic
    return None


def is_line(closure: LegClosure) -> bool:
    """Return whether a leg is a driven slide on a universal joint, which only measures a length.

    The joint's two ways of pointing somewhere are one line; turned about it, it is no other leg.
    """
    return closure.leg.active == [2] and closed_form(closure) is universal_prismatic


def planar_dyad(closure: LegClosure, targets: Array) -> tuple[Array, Mask]:
    """Return the two angles of a planar dyad by the cosine law, bent to the side of home.

    A target out of reach gets the angles of the leg stretched or folded towards it.
    """
    leg, dyad = closure.leg, dyad_geometry(closure)
    a, b = dyad.a, dyad.b
    reach = targets[:, 0] + 1j * targets[:, 1] - dyad.shoulder
    with np.errstate(all="ignore"):
        cos = (np.abs(reach) ** 2 - a**2 - b**2) / (2 * a * b)
    sin = dyad.mode * np.sqrt(np.clip((1 - cos) * (1 + cos), 0.0, None))
    bend = np.arctan2(sin, np.clip(cos, -1.0, 1.0))
    angle = np.angle(reach) - np.angle(a + b * np.exp(1j * bend)) - dyad.angle_zero
    angles = np.stack((angle, bend - dyad.bend_zero), axis=1) * dyad.signs
    return leg.home + wrapped(angles - leg.home), np.abs(cos) <= 1.0


@dataclass(frozen=True)
class DyadGeometry:
    """A planar dyad at zero joint positions, read off its chain."""

    shoulder: complex
    a: float
    """Length of the upper arm, [m]."""
    b: float
    """Length of the forearm, [m]."""
    angle_zero: float
    """Direction of the upper arm, [rad]."""
    bend_zero: float
    """Angle from upper arm to forearm, [rad]."""
    signs: tuple[float, float]
    """Of the two axes along the base's z."""
    mode: float
    """Sign of the elbow's sine at home."""


def dyad_geometry(closure: LegClosure) -> DyadGeometry:
    """Return the geometry of a planar dyad."""
    probes = np.array([[0.0, 0.0], [np.pi, 0.0], [0.0, np.pi / 2]])
    points, columns = closure.joint_columns(probes)
    tips = points[:, :2] @ np.array([1.0, 1j])
    sign, sign_elbow = np.sign(columns[5, 0]).tolist()
    shoulder = complex(tips[0] + tips[1]) / 2
    elbow = (tips[2] - 1j * sign_elbow * tips[0]) / (1 - 1j * sign_elbow)
    upper, fore = elbow - shoulder, tips[0] - elbow
    bend_zero = float(np.angle(fore) - np.angle(upper))
    mode = float(np.sign(np.sin(sign_elbow * closure.leg.home[1] + bend_zero)))
    angle_zero = float(np.angle(upper))
    signs = (sign, sign_elbow)
    return DyadGeometry(
        shoulder, float(abs(upper)), float(abs(fore)), angle_zero, bend_zero, signs, mode
    )


def universal_prismatic(closure: LegClosure, targets: Array) -> tuple[Array, Mask]:
    """Return the angles of a universal joint and the length of the slide through its centre.

    With axes e₁ ⟂ e₂ and e₃ = e₁ × e₂ at zero, the slide's direction is
    u = e₁ sin(q₂ + δ) + (e₃ cos q₁ − e₂ sin q₁) cos(q₂ + δ). Of the two solutions the one
    on the side of home is taken. Every target but the centre is in reach.
    """
    leg, form = closure.leg, universal_geometry(closure)
    arm = targets - form.centre
    length = np.linalg.norm(arm, axis=1)
    with np.errstate(all="ignore"):
        u = form.forth * arm / length[:, None]
    along, across, up = u @ form.e1, u @ form.e2, u @ form.e3
    q2 = np.arctan2(along, form.side * np.hypot(across, up)) - form.delta
    q1 = np.arctan2(-form.side * across, form.side * up)
    turns = leg.home[:2] + wrapped(np.stack((q1, q2), axis=1) - leg.home[:2])
    return np.column_stack((turns, form.forth * length)), length > 0.0


@dataclass(frozen=True)
class UniversalGeometry:
    """A universal-prismatic leg at zero joint positions, read off its chain."""

    centre: Array
    """Of the universal joint, base frame, shape (3,), [m]."""
    e1: Array
    e2: Array
    e3: Array
    """Unit axes of the universal joint and their product, base frame, shape (3,)."""
    slide: Array
    """Direction of the slide, shape (3,)."""
    delta: float
    """Angle from e₃ to the slide towards e₁, [rad]."""
    side: float
    """Sign of cos(q₂ + δ) at home."""
    forth: float
    """Sign of the slide's position at home."""


def universal_geometry(closure: LegClosure) -> UniversalGeometry:
    """Return the geometry of a universal-prismatic leg."""
    leg = closure.leg
    tips, columns = closure.joint_columns(np.zeros((1, 3)))
    e1, e2, slide = columns[3:, 0, 0], columns[3:, 0, 1], columns[:3, 0, 2]
    e3 = cross(e1[None], e2[None])[0]
    delta = float(np.arctan2(slide @ e1, slide @ e3))
    side = float(np.sign(np.cos(leg.home[1] + delta))) or 1.0
    forth = float(np.sign(leg.home[2])) or 1.0
    return UniversalGeometry(tips[0], e1, e2, e3, slide, delta, side, forth)


def _is_universal(closure: LegClosure) -> bool:
    """Return whether two crossing perpendicular axes carry a slide that starts at the crossing."""
    _, columns = closure.joint_columns(np.zeros((1, 3)))
    speed = np.abs(columns[:3, 0, :2]).max()  # of the tip about the axes: none at the crossing
    form = universal_geometry(closure)
    skew = max(abs(form.e1 @ form.e2), abs(form.e2 @ form.slide))
    return bool(speed <= _EXACT * closure.size and skew <= _EXACT)


def wrapped(angles: Array) -> Array:
    """Return angles in [-pi, pi)."""
    with np.errstate(invalid="ignore"):
        return (angles + np.pi) % (2 * np.pi) - np.pi
