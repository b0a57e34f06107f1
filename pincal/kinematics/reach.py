"""Where a leg can have its tip, in closed form: a shell around a centre, cut by half-spaces.

Planar dyads, struts and cables reach a platform point if its distance from the
leg's centre lies between two bounds, and on the right side of planes. Stroke, elbow
margin and the turn of a universal joint all take this form, which for many positions and
orientations at once is a product of matrices. What bars other driven rods is a shell too, and more.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pincal.kinematics.closed_forms import (
    closed_form,
    driven_rod,
    rod_geometry,
    slide_geometry,
)
from pincal.kinematics.closure import LegClosure
from pincal.model.checks import ROUNDING
from pincal.types import Array, Mask


@dataclass(frozen=True)
class Turned:
    """Platform point of a leg in O orientations: what does not depend on the position."""

    factor: Array
    """Columns (2 R b, 1) of a squared distance, shape (4, O)."""
    heights: Array
    """R b along the normal of each half-space, shape (n_planes, O), [m]."""
    lowest: Array
    """Least of the heights, shape (n_planes,), [m]."""


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

    def turned(self, R: Array) -> Turned:
        """Return the platform point turned by orientations, shape (O, 3, 3), for what follows."""
        arms = (R @ self.point).T
        heights = self.normals @ arms
        factor = np.vstack((2.0 * arms, np.ones(len(R))))
        return Turned(factor, heights, heights.min(axis=1, initial=np.inf))

    def holds_each(self, positions: Array, turned: Turned) -> Mask:
        """Return which pairs of position and orientation the leg reaches, shape (P, O).

        Args:
            positions: Shape (P, 3), [m].
            turned: The platform point in each orientation, from ``turned``.
        """
        squared = self._squared(positions, turned)
        inside = (squared >= self.bounds[0]) & (squared <= self.bounds[1])
        for normal, heights in zip(self.normals, turned.heights, strict=True):
            inside &= ((positions - self.centre) @ normal)[:, None] + heights >= -self.slack
        return inside

    def holds_all(self, positions: Array, turned: Turned) -> Mask:
        """Return which positions the leg reaches in all orientations, shape (P,)."""
        squared = self._squared(positions, turned)
        inside = squared.min(axis=1) >= self.bounds[0]
        inside &= squared.max(axis=1) <= self.bounds[1]
        for normal, lowest in zip(self.normals, turned.lowest, strict=True):
            inside &= (positions - self.centre) @ normal + lowest >= -self.slack
        return inside

    def _squared(self, positions: Array, turned: Turned) -> Array:
        """Return |r + R b − c|² = |r − c|² + |b|² + 2 (r − c) · R b, shape (P, O)."""
        offset = positions - self.centre
        constant = np.einsum("ni,ni->n", offset, offset) + self.point @ self.point
        return np.column_stack((offset, constant)) @ turned.factor


def reach_of(closure: LegClosure, least_type1: float = 0.0) -> Reach | None:
    """Return where a leg can have its tip, or None if it has no closed form.

    Args:
        closure: The leg at its parameter values.
        least_type1: Margin from type-1 singularities, which at a dyad bounds the elbow.
    """
    form = closed_form(closure)
    if form is None:
        return None
    return (_rod if form is driven_rod else _slide)(closure, least_type1)


def _rod(closure: LegClosure, least_type1: float) -> Reach:
    """Return the ring of a dyad: |cos of the elbow| ≤ √(1 − margin²); else a shell around it all.

    In space a drive turns its rod's joint in one plane only, and a line has two ends: what is
    outside the shell is out of reach, what is within need not be in reach.
    """
    rod, leg = rod_geometry(closure), closure.leg
    line = leg.moving[0].kind == "prismatic"
    dyad = closure.platform.space == 2 and not line
    exact = dyad and not any(joint.limited for joint in leg.moving)
    if leg.active != [0]:  # the grip of a driven elbow is another quantity
        exact &= least_type1 == 0.0
    grip = least_type1 if dyad and leg.active == [0] else 0.0
    if line:
        first = leg.moving[0]
        middle = rod.centre + rod.frame[:, 1] * (first.lower + first.upper) / 2
        high = (first.upper - first.lower) / 2 + rod.length
        return _reach(closure, middle, (0.0, high), [], exact)
    squares, swing = rod.radius**2 + rod.length**2, 2 * rod.radius * rod.length
    swing *= np.sqrt(1.0 - grip**2)
    low, high = np.sqrt(max(squares - swing, 0.0)), np.sqrt(squares + swing)
    return _reach(closure, rod.centre, (low, high), [], exact)


def _slide(closure: LegClosure, least_type1: float) -> Reach:
    """Return the shell of a slide on a pointing joint, cut by the first axis' limits."""
    form = slide_geometry(closure)
    pointing, (first, *second, slide) = form.pointing, closure.leg.moving
    ends = (slide.lower + form.shift, slide.upper + form.shift)
    low, high = sorted(form.forth * end for end in ends)
    planes: list[Array] = []
    exact = least_type1 <= 1.0 - ROUNDING  # a slide along the leg always has full grip
    if closure.leg.active != [len(second) + 1]:  # not so where another joint is driven
        exact &= least_type1 == 0.0
    if first.limited:
        # with C, S = r cos q₁, r sin q₁: sin(q₁ − lower) ≥ 0 and sin(upper − q₁) ≥ 0
        exact &= first.upper - first.lower <= np.pi + ROUNDING
        C = pointing.side * form.forth * pointing.e3
        S = -pointing.side * form.forth * pointing.e2
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
    return _reach(closure, form.centre, (low, high), planes if exact else [], exact)


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
