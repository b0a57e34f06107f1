"""Closed-form inverse kinematics and reach of legs with rods or slides.

A pointing joint, a revolute in the plane or a universal in space, carries either a rod and is moved
along a circle or a line by a drive (planar dyads, deltas, rotary hexapods, carriages), or a slide
through its centre (struts, cables). From the closed form Newton's method on the closure takes one
step. The reach is a shell around the leg's centre, cut by planes; for many positions and
orientations at once it is a product of matrices. Axes and points are read off the chain at zero
joint positions, for any parameter values and URDF frames.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from pincal.kinematics.batches import lengths
from pincal.kinematics.closure import LegClosure
from pincal.model.checks import ROUNDING, wrapped
from pincal.types import Array, Mask


@dataclass(frozen=True)
class ClosedForm:
    """A pointing joint and its slide, or its drive and rod, at zero joint positions; base frame.

    With axes e₁ ⟂ e₂ and e₃ = e₁ × e₂, the joint points along
    u = e₁ sin(q₂ + δ) + (e₃ cos q₁ − e₂ sin q₁) cos(q₂ + δ). A revolute joint in the plane is
    the same with q₂ + δ = 0.

    A slide goes through the joint's centre. A rod's joint is at C(q) = centre + radius (u cos q +
    v sin q), where u and v are the first columns of the frame, or on a line at C(q) = centre + v q.
    |t − C(q)| = L has two solutions, on either side of the type-1 singularity (t − C) · ∂C/∂q = 0;
    the one on the side of home is taken.
    """

    closure: LegClosure
    driven: int
    """The joint that is usually driven: the slide, or the drive of the rod."""
    centre: Array
    """Centre of the pointing joint or a rod's circle, or start of its line, shape (3,), [m]."""
    axes: Array
    """Columns e₁, e₂, e₃, shape (3, 3)."""
    delta: float
    """Angle from e₃ to the pointing direction towards e₁, [rad]."""
    side: float
    """Sign of cos(q₂ + δ) at home, which selects one of two ways of pointing."""
    length: float
    """Length of a rod, or distance of a slide past the centre at zero, [m]."""
    mode: float
    """Sign at home of a slide's distance from the centre, or of (t − C) · ∂C/∂q."""
    radius: float = 0.0
    """Radius of a rod's circle, [m]; zero for a line."""
    frame: Array | None = None
    """Columns of a rod's circle: radial and tangential direction at zero, axis, shape (3, 3)."""

    def to_tip(self, targets: Array) -> Array:
        """Return the vectors from the pointing joint to targets, shape (N, 3), [m]."""
        if self.frame is None:
            return self._from_centre(targets)
        _, (x, y, z), (c, s), _ = self._driven(self.frame, targets)
        return np.asarray((self.frame @ np.array((c * x - s * y, s * x + c * y, z))).T)

    def joints(self, targets: Array) -> tuple[Array, Mask]:
        """Return joints that take the tip to targets, (N, n_joints), and which are in reach.

        Out of a rod's reach the leg is stretched or folded towards the target.
        """
        if self.frame is None:
            arm = self._from_centre(targets)
            distance = lengths(arm)
            slide = self.mode * distance - self.length
            return np.stack((*self._angles(self.mode * arm), slide)).T, distance > 0.0
        drive, elbow, _, possible = self._driven(self.frame, targets)
        return np.stack((drive, *self._angles((self.frame @ elbow).T))).T, possible

    def _from_centre(self, targets: Array) -> Array:
        """Return the vectors from the centre to targets, (N, 3), with z = 0 in the plane."""
        arm = targets - self.centre
        if self.closure.platform.space == 2:
            arm[:, 2] = 0.0
        return arm

    def _angles(self, vectors: Array) -> list[Array]:
        """Return the joint's one or two angles, (N,) each, when it points along vectors (N, 3)."""
        e1, e2, e3 = self.axes.T
        across, height = self.side * (vectors @ e2), self.side * (vectors @ e3)
        angles = [np.arctan2(-across, height)]
        if self.closure.platform.space == 3:
            level = self.side * np.sqrt(across * across + height * height)
            angles.append(np.arctan2(vectors @ e1, level) - self.delta)
        home = self.closure.leg.home[:-1] if self.frame is None else self.closure.leg.home[1:]
        return [at_home + wrapped(q - at_home) for q, at_home in zip(angles, home, strict=True)]

    def _driven(self, frame: Array, targets: Array) -> tuple[Array, Array, tuple[Array, ...], Mask]:
        """Return drives (N,), rods turned to zero (3, N), drives as (cos, sin), and reach."""
        radial, way, height = frame.T @ self._from_centre(targets).T
        with np.errstate(all="ignore"):
            if not self.radius:
                square = self.length**2 - radial * radial - height * height
                drive = way - self.mode * np.sqrt(np.clip(square, 0.0, None))
                turn = np.ones_like(way), np.zeros_like(way)
                return drive, np.array((radial, way - drive, height)), turn, square >= 0.0
            flat = radial * radial + way * way
            far = np.sqrt(flat)
            safe = np.where(far > 0.0, far, 1.0)  # at the centre any angle
            cos = flat + height * height + self.radius**2 - self.length**2
            cos = cos / (2 * self.radius * far)
            cos = np.where(np.isnan(cos), 0.0, cos)
            possible, cos = np.abs(cos) <= 1.0, np.clip(cos, -1.0, 1.0)
            sin = self.mode * np.sqrt((1 - cos) * (1 + cos))
            radial, way = radial / safe, way / safe  # turned to the drive
            c, s = cos * radial + sin * way, cos * way - sin * radial
        home = self.closure.leg.home[0]
        drive = home + wrapped(np.arctan2(s, c) - home)
        return drive, np.array((far * cos - self.radius, far * sin, height)), (c, s), possible

    def reach(self, least_type1: float = 0.0) -> Reach:
        """Return the region of the leg's tip; a type-1 margin bounds the elbow.

        It is the shell of a slide, cut by the first axis' limits; the ring of a dyad, |cos of the
        elbow| ≤ √(1 − margin²); a shell around all tips for rods in space and on lines.
        """
        leg, centre, planes = self.closure.leg, self.centre, list[Array]()
        exact, drives = True, leg.active == [self.driven]
        if not drives:  # the margin of another joint is another quantity
            exact = least_type1 == 0.0
        if self.frame is None:
            slide = leg.moving[-1]
            ends = (self.mode * (end + self.length) for end in (slide.lower, slide.upper))
            low, high = sorted(ends)
            planes, bounded = self._planes()
            exact &= bounded and least_type1 <= 1.0 - ROUNDING  # a drive along the leg has margin 1
        elif self.radius:
            dyad = self.closure.platform.space == 2
            exact &= dyad and not any(joint.limited for joint in leg.moving)
            grip = least_type1 if dyad and drives else 0.0
            squares, swing = self.radius**2 + self.length**2, 2 * self.radius * self.length
            swing *= np.sqrt(1.0 - grip**2)
            low, high = np.sqrt(max(squares - swing, 0.0)), np.sqrt(squares + swing)
        else:
            drive, exact = leg.moving[0], False
            centre = centre + self.frame[:, 1] * (drive.lower + drive.upper) / 2
            low, high = 0.0, (drive.upper - drive.lower) / 2 + self.length
        slack = ROUNDING * self.closure.size
        point = self.closure.targets(np.eye(4)[None])[0]
        if self.closure.platform.space == 2:
            centre = np.array([centre[0], centre[1], point[2]])  # z does not count
        bounds = (float((low - slack) ** 2) if low > slack else -np.inf, float((high + slack) ** 2))
        normals = np.array(planes if exact else []).reshape(-1, 3)
        return Reach(point, centre, bounds, normals, slack, bool(exact))

    def _planes(self) -> tuple[list[Array], bool]:
        """Return normals of the half-spaces of a slide's limits, and whether they are exact."""
        first, *second = self.closure.leg.moving[:-1]
        planes, exact = [], True
        if first.limited:
            # with C, S = r cos q₁, r sin q₁: sin(q₁ − lower) ≥ 0 and sin(upper − q₁) ≥ 0
            exact = first.upper - first.lower <= np.pi + ROUNDING
            C, S = self.side * self.mode * self.axes[:, 2], -self.side * self.mode * self.axes[:, 1]
            planes = [
                S * np.cos(first.lower) - C * np.sin(first.lower),
                C * np.sin(first.upper) - S * np.cos(first.upper),
            ]
            if np.allclose(planes[0], planes[1], rtol=0.0, atol=ROUNDING):
                planes = planes[:1]
        for joint in second:
            if joint.limited:  # q₂ + δ lies within ± π/2 of the side's middle, modulo full turns
                middle = 0.0 if self.side > 0 else np.pi
                centre = (joint.lower + joint.upper) / 2 + self.delta
                middle += 2 * np.pi * np.round((centre - middle) / (2 * np.pi))
                exact &= joint.lower + self.delta <= middle - np.pi / 2 + ROUNDING
                exact &= joint.upper + self.delta >= middle + np.pi / 2 - ROUNDING
        return planes, bool(exact)


@lru_cache(maxsize=256)
def closed_form(closure: LegClosure) -> ClosedForm | None:
    """Return the closed form of a leg, or None if it has none."""
    leg, space, small = closure.leg, closure.platform.space, ROUNDING * closure.size
    kinds = [joint.kind * (joint.follows is None) for joint in leg.articulated]
    pointing = ["revolute"] * (space - 1)
    rod = kinds[1:] == pointing
    if closure.projects or not (rod or kinds == [*pointing, "prismatic"]):
        return None
    joints = np.stack((np.zeros(len(kinds)), leg.home))
    zero, home = closure.motion(joints).twists(slice(len(kinds))).transpose(2, 0, 1)
    driven = 0 if rod else len(kinds) - 1
    turning = np.delete(zero, driven, axis=1)
    start = _arm(turning)  # from the crossing of the axes to the tip
    arm = start if rod else zero[:3, -1]
    length, e1 = float(np.linalg.norm(arm)), turning[3:, 0]
    e2 = np.cross(arm / max(length, small), e1) if space == 2 else turning[3:, 1]
    missed = np.abs(turning[:3].T - np.cross(turning[3:].T, start)).max()
    skew = max(abs(e1 @ e2), 0.0 if rod else abs(turning[3:, -1] @ arm))
    if missed > small or length <= small or skew > ROUNDING:
        return None
    axes, delta, side = np.stack((e1, e2, np.cross(e1, e2)), axis=1), 0.0, 1.0
    if space == 3:
        delta = float(np.arctan2(arm @ e1, arm @ axes[:, 2]))
        side = _sign(np.cos(leg.home[2 if rod else 1] + delta))
    pointed = closure, driven, closure.tips(joints)[0] - start, axes, delta, side
    if not rod:
        shift = float(start @ arm)
        return ClosedForm(*pointed, shift, _sign(leg.home[-1] + shift))
    return _rod(ClosedForm(*pointed, length, 0.0), zero, home)


def _rod(form: ClosedForm, zero: Array, home: Array) -> ClosedForm | None:
    """Return the form of a rod with its drive from twists at zero and at home, (6, n)."""
    axis, at_home, radius = zero[3:, 0], _arm(home), 0.0
    way = zero[:3, 0] - np.cross(axis, _arm(zero))
    if np.linalg.norm(way) <= ROUNDING * form.closure.size:
        return None
    if form.closure.leg.moving[0].turns:
        radius = float(np.linalg.norm(way))
        way = way / radius
        frame = np.stack((np.cross(way, axis), way, axis), axis=1)
    else:
        across = np.linalg.qr(np.column_stack((way, np.eye(3))))[0][:, 1:]
        frame = np.stack((across[:, 0], way, across[:, 1]), axis=1)
    mode = _sign(float(at_home @ (home[:3, 0] - np.cross(home[3:, 0], at_home))))
    centre = form.centre - radius * frame[:, 0]
    return replace(form, centre=centre, mode=mode, radius=radius, frame=frame)


def _sign(value: float) -> float:
    return float(np.sign(value)) or 1.0


def _arm(columns: Array) -> Array:
    """Return the perpendicular from the last axis to the tip, (3,)."""
    return np.cross(columns[:3, -1], columns[3:, -1])


def is_line(closure: LegClosure) -> bool:
    """Return whether a leg is a driven slide on a universal joint, with one working mode."""
    form = closed_form(closure)
    return closure.leg.active == [2] and form is not None and form.frame is None


@dataclass(frozen=True)
class Reach:
    """Region of tips that a leg reaches within its limits, for dyads with an elbow margin."""

    point: Array
    """Platform point b, platform frame, shape (3,), [m]."""
    centre: Array
    """Centre of the shell, base frame, shape (3,), [m]."""
    bounds: tuple[float, float]
    """Least and largest squared distance from the centre, [m²]; slack included."""
    normals: Array
    """Half-spaces n · (tip − centre) ≥ −slack, unit normals, shape (n_planes, 3)."""
    slack: float
    """Tolerance of the half-spaces, [m]."""
    exact: bool
    """Whether the region is sufficient; otherwise it is only necessary."""

    def holds(self, matrices: Array) -> Mask:
        """Return which poses ``T_base_platform``, shape (N, 4, 4), the leg reaches."""
        arm = matrices[:, :3, 3] + matrices[:, :3, :3] @ self.point - self.centre
        squared = np.einsum("ni,ni->n", arm, arm)
        inside = (squared >= self.bounds[0]) & (squared <= self.bounds[1])
        for normal in self.normals:
            inside &= arm @ normal >= -self.slack
        return inside

    def holds_each(self, positions: Array, arms: Array) -> Mask:
        """Return which pairs of a position (P, 3), [m], and an orientation are reached, (P, O).

        ``arms`` are the platform point R b for each orientation, shape (3, O), [m].
        """
        # |r + R b − c|² = |r − c|² + |b|² + 2 (r − c) · R b
        offset = positions - self.centre
        constant = np.einsum("ni,ni->n", offset, offset) + self.point @ self.point
        factor = np.vstack((2.0 * arms, np.ones(arms.shape[1])))
        squared = np.column_stack((offset, constant)) @ factor
        inside = (squared >= self.bounds[0]) & (squared <= self.bounds[1])
        for normal in self.normals:
            inside &= (offset @ normal)[:, None] + normal @ arms >= -self.slack
        return inside
