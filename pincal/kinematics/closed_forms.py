"""Legs that point at the platform, rods and lines: closed-form inverse kinematics and reach.

A pointing joint, a revolute in the plane or a universal in space, carries either a rod, and is
moved along a circle or a line by a drive (planar dyads, deltas, rotary hexapods, carriages), or a
slide through its own centre (struts, cables). They give the start from which Newton's method on the
closure needs one step, and say at once what is out of reach. Axes and points are read off the
calibration chain at zero joint positions, so that the forms hold for any parameter values and URDF
frames.

Planar dyads, struts and cables reach a platform point if its distance from the leg's centre lies
between two bounds (a shell), and on the right side of planes. Stroke, elbow margin and the turn of
a universal joint all take this form, which for many positions and orientations at once is a
product of matrices. What bars other driven rods is a shell too, and more.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from pincal.kinematics.batches import lengths
from pincal.kinematics.closure import LegClosure
from pincal.model.checks import ROUNDING, sine_and_cosine, wrapped
from pincal.types import Array, Mask


@lru_cache(maxsize=256)
def closed_form(closure: LegClosure) -> DrivenRod | PointingSlide | None:
    """Return the closed form of a leg, or None if it has none."""
    if closure.leg.closes == "frame":
        return None
    kinds = [joint.kind for joint in closure.leg.moving]
    pointing = ["revolute"] * (closure.platform.space - 1)
    if kinds[1:] == pointing and _points(closure, rod=True):
        return DrivenRod.of(closure)
    if kinds == [*pointing, "prismatic"] and _points(closure, rod=False):
        return PointingSlide.of(closure)
    return None


def is_line(closure: LegClosure) -> bool:
    """Return whether a leg is a driven slide on a universal joint, which only measures a length.

    The joint's two ways of pointing somewhere are one line; turned about it, it is no other leg.
    """
    return closure.leg.active == [2] and isinstance(closed_form(closure), PointingSlide)


def rod_directions(closure: LegClosure, targets: Array) -> Array | None:
    """Return the unit directions of a leg's rod or slide towards targets, shape (N, 3).

    None unless it pushes along itself only: its one sensor reads the drive of the rod, or the
    slide. NaN where a rod has no direction; out of reach, that of the leg stretched or folded.

    Args:
        closure: The leg.
        targets: Shape (N, 3), [m]; may be changed.
    """
    form = closed_form(closure)
    if form is None or closure.leg.active != [form.driven]:
        return None
    arm = form.to_tip(targets)
    with np.errstate(invalid="ignore"):
        return np.asarray(arm / np.linalg.norm(arm, axis=1, keepdims=True))


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
    home: Array
    """Of its one or two angles, [rad]."""
    delta: float = 0.0
    """Angle from e₃ to the pointing direction towards e₁, [rad]."""
    side: float = 1.0
    """Sign of cos(q₂ + δ) at home: of the two ways of pointing somewhere, which is meant."""

    @classmethod
    def of(cls, axes: Array, arm: Array, home: Array) -> Pointing:
        """Return a pointing joint of twists at the tip, shape (6, 1 or 2), and its arm, [m]."""
        u = arm / np.linalg.norm(arm)
        e1 = axes[3:, 0]
        if axes.shape[1] == 1:
            return cls(arm, e1, np.cross(u, e1), u, home)
        e2 = axes[3:, 1]
        e3 = np.cross(e1, e2)
        delta = float(np.arctan2(u @ e1, u @ e3))
        return cls(arm, e1, e2, e3, home, delta, float(np.sign(np.cos(home[1] + delta))) or 1.0)

    def angles(self, vectors: Array) -> list[Array]:
        """Return the joint's angles when it points along vectors (N, 3), one or two, (N,) each."""
        across, height = self.side * (vectors @ self.e2), self.side * (vectors @ self.e3)
        angles = [np.arctan2(-across, height)]
        if len(self.home) == 2:
            level = self.side * np.sqrt(across * across + height * height)
            angles.append(np.arctan2(vectors @ self.e1, level) - self.delta)
        return [home + wrapped(q - home) for q, home in zip(angles, self.home, strict=True)]


@dataclass(frozen=True)
class PointingSlide:
    """A slide on a pointing joint, at zero joint positions, read off its chain."""

    closure: LegClosure
    centre: Array
    """Of the pointing joint, base frame, shape (3,), [m]."""
    pointing: Pointing
    shift: float
    """How far past the centre the slide is at zero, [m]."""
    forth: float
    """Sign of the slide's distance from the centre at home."""

    @classmethod
    def of(cls, closure: LegClosure) -> PointingSlide:
        """Return the closed form of a leg."""
        tips, (columns, _) = closure.at_zero_and_home
        home, start = closure.leg.home, _arm(columns[:, :-1])
        shift = float(start @ columns[:3, -1])
        forth = float(np.sign(home[-1] + shift)) or 1.0
        pointing = Pointing.of(columns[:, :-1], columns[:3, -1], home[:-1])
        return cls(closure, tips[0] - start, pointing, shift, forth)

    @property
    def driven(self) -> int:
        """The joint that a usual leg of this kind drives."""
        return len(self.closure.leg.moving) - 1

    def to_tip(self, targets: Array) -> Array:
        """Return the vectors from the centre to targets, shape (N, 3), [m]."""
        return _in_space(self.closure, targets - self.centre)

    def joints(self, targets: Array) -> tuple[Array, Mask]:
        """Return joint positions, (N, n_joints), that take the tip to targets: all in reach, (N,).

        The centre alone is not.
        """
        arm = self.to_tip(targets)
        length = lengths(arm)
        angles = self.pointing.angles(self.forth * arm)
        return np.stack((*angles, self.forth * length - self.shift)).T, length > 0.0

    def reach(self, least_type1: float) -> Reach:
        """Return the shell of the slide, cut by the first axis' limits."""
        pointing, (first, *second, slide) = self.pointing, self.closure.leg.moving
        ends = (slide.lower + self.shift, slide.upper + self.shift)
        low, high = sorted(self.forth * end for end in ends)
        planes: list[Array] = []
        exact = least_type1 <= 1.0 - ROUNDING  # a slide along the leg always has full grip
        if self.closure.leg.active != [self.driven]:  # not so where another joint is driven
            exact &= least_type1 == 0.0
        if first.limited:
            # with C, S = r cos q₁, r sin q₁: sin(q₁ − lower) ≥ 0 and sin(upper − q₁) ≥ 0
            exact &= first.upper - first.lower <= np.pi + ROUNDING
            C = pointing.side * self.forth * pointing.e3
            S = -pointing.side * self.forth * pointing.e2
            planes = [
                S * np.cos(first.lower) - C * np.sin(first.lower),
                C * np.sin(first.upper) - S * np.cos(first.upper),
            ]
            if np.allclose(planes[0], planes[1], rtol=0.0, atol=ROUNDING):
                planes = planes[:1]
        for joint in second:
            if joint.limited:  # q₂ + δ lies within ± π/2 of the side's middle, modulo full turns
                middle = 0.0 if pointing.side > 0 else np.pi
                centre = (joint.lower + joint.upper) / 2 + pointing.delta
                middle += 2 * np.pi * np.round((centre - middle) / (2 * np.pi))
                exact &= joint.lower + pointing.delta <= middle - np.pi / 2 + ROUNDING
                exact &= joint.upper + pointing.delta >= middle + np.pi / 2 - ROUNDING
        return _reach(self.closure, self.centre, (low, high), planes if exact else [], exact)


@dataclass(frozen=True)
class DrivenRod:
    """A rod on a pointing joint that a drive moves, at zero joint positions; base frame.

    The pointing joint is at C(q) = centre + radius (u cos q + v sin q), with u and v the
    first columns of the frame, or at C(q) = centre + v q on a line. The joint's centre is as far
    from the target as the rod is long: |t − C(q)| = L has two solutions, on either side of where
    the drive loses its grip, (t − C) · ∂C/∂q = 0. The one on the side of home is taken.
    """

    closure: LegClosure
    centre: Array
    """Of the circle, or where the line begins, shape (3,), [m]."""
    radius: float
    """Of the circle, [m]; zero for a line."""
    frame: Array
    """Columns: from the circle's centre to the pointing joint, its way, the axis; unit vectors,
    shape (3, 3). Of a line, the way is the second."""
    pointing: Pointing
    mode: float
    """Sign of (t − C) · ∂C/∂q at home."""
    driven: int = 0

    @classmethod
    def of(cls, closure: LegClosure) -> DrivenRod:
        """Return the closed form of a leg."""
        leg, (tips, (columns, home)) = closure.leg, closure.at_zero_and_home
        pointing = Pointing.of(columns[:, 1:], _arm(columns), leg.home[1:])
        point, speed = tips[0] - pointing.arm, columns[:3, 0]
        radius, axis = 0.0, np.zeros(3)
        if leg.moving[0].turns:
            axis = columns[3:, 0]
            speed = speed - np.cross(axis, pointing.arm)
            radius = float(np.linalg.norm(speed))
            speed = speed / radius
        radial = np.cross(speed, axis)
        frame = np.stack((radial, speed, axis), axis=1)
        at_home = _arm(home)  # drive and rod as they are there
        grip = at_home @ (home[:3, 0] - np.cross(home[3:, 0], at_home))
        mode = float(np.sign(grip)) or 1.0
        return cls(closure, point - radius * radial, radius, frame, pointing, mode)

    @property
    def length(self) -> float:
        """Length of the rod, [m]."""
        return float(np.linalg.norm(self.pointing.arm))

    def to_tip(self, targets: Array) -> Array:
        """Return the vectors from the rod's pointing joint to targets, shape (N, 3), [m]."""
        drive, arm = self._drive(targets)[0], _in_space(self.closure, targets - self.centre)
        if self.radius:
            circle = np.stack(sine_and_cosine(drive)[::-1], axis=1)
            return arm - self.radius * circle @ self.frame[:, :2].T
        return arm - drive[:, None] * self.frame[:, 1]

    def joints(self, targets: Array) -> tuple[Array, Mask]:
        """Return joint positions that take the tip to targets, (N, n_joints), and what is in reach.

        A target out of reach gets the leg stretched or folded towards it.
        """
        drive, to_tip, possible = self._drive(targets)
        return np.stack((drive, *self.pointing.angles(to_tip))).T, possible

    def _drive(self, targets: Array) -> tuple[Array, Array, Mask]:
        """Return the drive's position, where the rod points with the drive at zero, and reach.

        Shapes (N,), (N, 3), (N,).
        """
        arm = _in_space(self.closure, targets - self.centre)
        radial, on, height = self.frame.T @ arm.T
        with np.errstate(all="ignore"):
            if not self.radius:
                square = on**2 - np.einsum("ni,ni->n", arm, arm) + self.length**2
                drive = on - self.mode * np.sqrt(np.clip(square, 0.0, None))
                return drive, arm - drive[:, None] * self.frame[:, 1], square >= 0.0
            flat = radial * radial + on * on
            far = np.sqrt(flat)
            safe = np.where(far > 0.0, far, 1.0)  # at O, any angle
            cos = flat + height * height + self.radius**2 - self.length**2
            cos = cos / (2 * self.radius * far)
            cos = np.where(np.isnan(cos), 0.0, cos)
            possible = np.abs(cos) <= 1.0
            cos = np.clip(cos, -1.0, 1.0)
            sin = self.mode * np.sqrt((1 - cos) * (1 + cos))
            radial, on = (
                radial / safe,
                on / safe,
            )  # the target's way, turned to the drive's: no sines
            c, s = cos * radial + sin * on, cos * on - sin * radial
            home = self.closure.leg.home[0]
            drive = home + wrapped(np.arctan2(s, c) - home)
            # turned back to where the drive is at zero
            elbow = np.stack((far * cos - self.radius, far * sin, height))
        return drive, (self.frame @ elbow).T, possible

    def reach(self, least_type1: float) -> Reach:
        """Return the ring of a dyad, |cos of the elbow| ≤ √(1 − margin²), or a shell around it all.

        In space a drive turns its rod's joint in one plane only, and a line has two ends: what is
        outside the shell is out of reach, what is within need not be in reach.
        """
        leg = self.closure.leg
        dyad = self.closure.platform.space == 2 and bool(self.radius)
        exact = dyad and not any(joint.limited for joint in leg.moving)
        if leg.active != [0]:  # the grip of a driven elbow is another quantity
            exact &= least_type1 == 0.0
        if not self.radius:
            first = leg.moving[0]
            middle = self.centre + self.frame[:, 1] * (first.lower + first.upper) / 2
            high = (first.upper - first.lower) / 2 + self.length
            return _reach(self.closure, middle, (0.0, high), [], exact)
        grip = least_type1 if dyad and leg.active == [0] else 0.0
        squares, swing = self.radius**2 + self.length**2, 2 * self.radius * self.length
        swing *= np.sqrt(1.0 - grip**2)
        low, high = np.sqrt(max(squares - swing, 0.0)), np.sqrt(squares + swing)
        return _reach(self.closure, self.centre, (low, high), [], exact)


def _arm(columns: Array) -> Array:
    """Return the arm from the last axis, which it crosses at a right angle, to the tip, (3,)."""
    return np.cross(columns[:3, -1], columns[3:, -1])


def _points(closure: LegClosure, rod: bool) -> bool:
    """Return whether revolute axes cross at right angles, and the arm starts where they do."""
    columns = closure.at_zero_and_home[1][0]
    axes, arm = (columns[:, 1:], _arm(columns)) if rod else (columns[:, :-1], columns[:3, -1])
    start = arm if rod else _arm(axes)  # from the crossing to the tip
    missed = np.abs(axes[:3].T - np.cross(axes[3:].T, start)).max()
    skew = [] if closure.platform.space == 2 else [axes[3:, 0] @ axes[3:, 1]]
    skew += [] if rod else [axes[3:, -1] @ arm]
    small = ROUNDING * closure.size
    lever = columns[:3, 0] - np.cross(columns[3:, 0], arm)  # of a rod's drive
    degenerate = rod and min(np.linalg.norm(arm), np.linalg.norm(lever)) <= small
    return bool(missed <= small and np.abs(skew).max(initial=0.0) <= ROUNDING and not degenerate)


def _in_space(closure: LegClosure, vectors: Array) -> Array:
    """Return vectors, shape (N, 3), changed in place: in the plane without their heights."""
    if closure.platform.space == 2:
        vectors[:, 2] = 0.0
    return vectors


@dataclass(frozen=True)
class Reach:
    """Tips that a leg reaches within its limits; at dyads with an elbow margin."""

    point: Array
    """Platform point b, platform frame, shape (3,), [m]."""
    centre: Array
    """Centre of the shell, base frame, shape (3,), [m]."""
    bounds: tuple[float, float]
    """Least and largest squared distance from the centre, [m²]; slack included."""
    normals: Array
    """Half-spaces n · (tip − centre) ≥ −slack, unit normals, shape (n_planes, 3)."""
    slack: float
    """[m]."""
    exact: bool
    """Whether nothing else limits the leg; else the shell is necessary, not sufficient."""

    def holds(self, matrices: Array) -> Mask:
        """Return which poses ``T_base_platform``, shape (N, 4, 4), the leg reaches."""
        arm = matrices[:, :3, 3] + matrices[:, :3, :3] @ self.point - self.centre
        squared = np.einsum("ni,ni->n", arm, arm)
        inside = (squared >= self.bounds[0]) & (squared <= self.bounds[1])
        for normal in self.normals:
            inside &= arm @ normal >= -self.slack
        return inside

    def holds_each(self, positions: Array, arms: Array) -> Mask:
        """Return which pairs of position (P, 3), [m], and orientation the leg reaches, (P, O).

        Arms are the platform point turned by each orientation, R b, shape (3, O), [m].
        """
        squared = self._squared(positions, arms)
        inside = (squared >= self.bounds[0]) & (squared <= self.bounds[1])
        for normal in self.normals:
            height = ((positions - self.centre) @ normal)[:, None]
            inside &= height + normal @ arms >= -self.slack
        return inside

    def holds_all(self, positions: Array, arms: Array) -> Mask:
        """Return which positions the leg reaches in all orientations, shape (P,)."""
        squared = self._squared(positions, arms)
        inside = squared.min(axis=1) >= self.bounds[0]
        inside &= squared.max(axis=1) <= self.bounds[1]
        for normal in self.normals:
            inside &= (positions - self.centre) @ normal + (normal @ arms).min() >= -self.slack
        return inside

    def _squared(self, positions: Array, arms: Array) -> Array:
        """Return |r + R b − c|² = |r − c|² + |b|² + 2 (r − c) · R b, shape (P, O)."""
        offset = positions - self.centre
        constant = np.einsum("ni,ni->n", offset, offset) + self.point @ self.point
        factor = np.vstack((2.0 * arms, np.ones(arms.shape[1])))
        return np.column_stack((offset, constant)) @ factor


def reach_of(closure: LegClosure, least_type1: float = 0.0) -> Reach | None:
    """Return where a leg can have its tip, or None if it has no closed form.

    The margin from type-1 singularities bounds a dyad's elbow.
    """
    form = closed_form(closure)
    return None if form is None else form.reach(least_type1)


def _reach(
    closure: LegClosure,
    centre: Array,
    distances: tuple[float, float],
    planes: list[Array],
    exact: bool,
) -> Reach:
    """Return a reach with slack for rounding errors."""
    slack = ROUNDING * closure.size
    point = closure.targets(np.eye(4)[None])[0]
    if closure.platform.space == 2:
        centre = np.array([centre[0], centre[1], point[2]])  # heights do not count
    low, high = distances
    bounds = ((low - slack) ** 2 if low > slack else -np.inf, (high + slack) ** 2)
    normals = np.array(planes).reshape(-1, 3)
    return Reach(point, centre, (float(bounds[0]), float(bounds[1])), normals, slack, bool(exact))
