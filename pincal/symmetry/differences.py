"""In what a carried leg differs from another: places and axes, bending, limits, sensors."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pincal.kinematics.closed_forms import is_line, reach_of
from pincal.kinematics.closing import home_mode
from pincal.kinematics.closure import LegClosure
from pincal.model.checks import ALIKE
from pincal.model.leg import Leg
from pincal.model.mechanism import Mechanism
from pincal.model.platform import Platform
from pincal.symmetry.elements import Element, Isometry, wrapped
from pincal.types import Array, Index


@dataclass(frozen=True)
class Difference:
    """One quantity in which two legs differ."""

    quantity: str
    deviation: float | None
    """By how much, in the unit; None where it is no number."""
    unit: str = "1"
    """m, rad or 1."""
    of_sensor: bool = False
    """Whether it is of a sensor: the legs move alike, their readings differ."""

    def exceeds(self, tolerance: float, size: float) -> bool:
        """Return whether it is more than a tolerance, relative to a size [m] for lengths."""
        scale = size if self.unit == "m" else 1.0
        return self.deviation is None or not self.deviation <= tolerance * scale


@dataclass(frozen=True)
class Traits:
    """What is read off a leg's loop; of a carried leg it follows from that of the leg."""

    mode: float
    """Working mode: sign of the determinant of the closure by its joints, at home."""
    barred: Array | None
    """Unit normals of half-spaces that bound a leg which is a line, shape (k, 3); else None."""

    @classmethod
    def of(cls, leg: Leg, platform: Platform) -> Traits:
        """Return the traits of a leg in canonical form."""
        closure = LegClosure(leg, platform)
        reach = reach_of(closure) if is_line(closure) else None
        barred = reach.normals if reach is not None and reach.exact else None
        return cls(home_mode(leg, platform), barred)

    def carried(self, leg: Leg, element: Element, platform: Platform) -> Traits:
        """Return the traits of the leg carried by an element, in canonical form.

        Columns of the closure turn by Q; a joint whose axis is turned over changes its sign.
        """
        barred = None if self.barred is None else self.barred @ element.matrix.T
        if not element.reflection:
            return Traits(self.mode, barred)
        sign = -1.0 if leg.closes == "point" or platform.space == 3 else 1.0
        for joint in leg.moving:
            along = int(np.argmax(np.abs(joint.axis)))  # the local mirror turns y over
            if (along == 1) != joint.turns:
                sign = -sign
        square = len(platform.closing(leg.closes)) == len(leg.moving) and leg.passive
        return Traits(self.mode * (sign if square else 1.0), barred)


def differences(
    carried: Leg, leg: Leg, carried_traits: Traits, traits: Traits
) -> Iterator[Difference]:
    """Yield every quantity in which a carried leg and another one differ, and by how much.

    Args:
        carried: The carried leg.
        leg: The other one.
        carried_traits: Traits of the carried leg.
        traits: Traits of the other one.
    """
    if [joint.kind for joint in carried.joints] != [joint.kind for joint in leg.joints]:
        yield Difference("sequence of joints", None)
        return
    if carried.parameter_names != leg.parameter_names:
        yield Difference("set of parameters", None)
        return
    for name, a, b in zip(leg.parameter_names, carried.nominal, leg.nominal, strict=True):
        unit = leg.units[name]
        yield Difference(f"parameter {name!r}", _deviation(float(a - b), unit), unit)
    line_turn = _line_turn(carried_traits.barred, traits.barred)
    yield from _places_differ(carried, leg, oriented=line_turn is None)
    if line_turn is not None:
        turn = line_turn if np.isfinite(line_turn) else None
        yield Difference(f"orientation of joint {leg.moving[0].name!r}", turn, "rad")
    elif carried_traits.mode != traits.mode:
        yield Difference("working mode (the side on which the leg bends)", None)
    if carried.active != leg.active or carried.closes != leg.closes:
        yield Difference("active joint" if carried.active != leg.active else "end", None)
        return
    for index in range(len(leg.sensors)):
        yield from _sensors_differ(carried, leg, index)
    yield from _limits_differ(carried, leg, slides_only=line_turn is not None)


def _deviation(value: float, unit: str) -> float:
    """Return how large a difference is, of angles without full turns."""
    return abs(wrapped(value)) if unit == "rad" and np.isfinite(value) else abs(value)


def _places_differ(carried: Leg, leg: Leg, oriented: bool) -> Iterator[Difference]:
    """Yield by how much the places of two legs' joints differ, and if wanted their orientations."""
    points = (leg.joints[-1], leg.point) if leg.closes == "point" else ()  # they have no axes
    for a, b in zip((*carried.joints, carried.point), (*leg.joints, leg.point), strict=True):
        shift = float(np.linalg.norm(np.subtract(a.placement.xyz, b.placement.xyz)))
        yield Difference(f"position of joint {b.name!r}", shift, "m")
        if oriented and not (b.kind == "fixed" and any(b is point for point in points)):
            turn = a.placement.origin()[:3, :3].T @ b.placement.origin()[:3, :3]
            sine = float(np.linalg.norm(turn - np.eye(3))) / 8**0.5
            angle = 2.0 * float(np.arcsin(min(1.0, sine)))
            if a.kind != "fixed":
                angle = max(angle, float(np.linalg.norm(np.subtract(a.axis, b.axis))))
            yield Difference(f"orientation of joint {b.name!r}", angle, "rad")


def _sensors_differ(carried: Leg, leg: Leg, index: int) -> Iterator[Difference]:
    """Yield by how much two legs' sensors of an index differ."""
    a, b = carried.sensors[index], leg.sensors[index]
    unit = leg.reading_units[index]

    def sensor(quantity: str, deviation: float | None, unit: str = "1") -> Difference:
        return Difference(f"{quantity} of the sensor", deviation, unit, of_sensor=True)

    if [term.basis for term in a.terms] != [term.basis for term in b.terms]:
        yield sensor("terms", None)
        return
    for first, second in zip(a.terms, b.terms, strict=True):
        amplitude = carried.nominal_by_name[first.parameter]
        yield sensor("terms", abs(amplitude - leg.nominal_by_name[second.parameter]), unit)
    if (a.form, a.direction) != (b.form, b.direction):
        yield sensor("form or direction", None)
        return
    gain, offset = a.constants(carried.nominal_by_name)
    other_gain, other_offset = b.constants(leg.nominal_by_name)
    yield sensor("gain", abs(gain - other_gain))
    if a.homed != b.homed:
        yield sensor("zero", None)
        return
    yield sensor("offset", _deviation(offset - other_offset, unit), unit)
    if not (isinstance(a.zero, str) or isinstance(b.zero, str)):
        yield sensor("zero", _deviation(a.zero - b.zero, unit), unit)


def _limits_differ(carried: Leg, leg: Leg, slides_only: bool) -> Iterator[Difference]:
    """Yield by how much the limits of two legs' joints differ."""
    for a, b in zip(carried.moving, leg.moving, strict=True):
        if (a.limited or b.limited) and not (slides_only and a.turns):
            unit = "rad" if a.turns else "m"
            ends = [_deviation(a.lower - b.lower, unit), _deviation(a.upper - b.upper, unit)]
            largest = max(ends) if np.isfinite(ends).all() else None
            yield Difference(f"limits of joint {b.name!r}", largest, unit)


def _line_turn(first: Array | None, second: Array | None) -> float | None:
    """Return how far apart are the directions that two legs bar which are lines, [rad].

    Such a leg is the same however its universal joint is turned about it. None if the legs are no
    lines, infinite if they bar other directions.
    """
    if first is None or second is None:
        return None
    if len(first) != len(second):
        return float("inf")
    distances = np.linalg.norm(first[:, None] - second, axis=2)
    return float(distances.min(axis=1).max()) if len(first) else 0.0


@dataclass(frozen=True)
class Points:
    """Where the legs of a mechanism begin and end."""

    mechanism: Mechanism

    @cached_property
    def base(self) -> Array:
        """Base points in the base frame, shape (n_legs, 3), [m]."""
        return np.array([leg.joints[0].placement.xyz for leg in self.mechanism.legs])

    @cached_property
    def platform(self) -> Array:
        """Platform points in the platform frame, shape (n_legs, 3), [m]."""
        return np.array([leg.point.placement.xyz for leg in self.mechanism.legs])

    @cached_property
    def home(self) -> Array:
        """Home pose ``T_base_platform``, shape (4, 4)."""
        return self.mechanism.platform.home_pose.as_matrix()[0]

    @cached_property
    def size(self) -> float:
        """Scale of the mechanism, wherever its frames are, [m]."""
        platform_at_home = self.platform @ self.home[:3, :3].T + self.home[:3, 3]
        spread = np.linalg.norm(self.base - self.base.mean(axis=0), axis=1).max()
        return float(max(spread, np.linalg.norm(platform_at_home - self.base, axis=1).max())) or 1.0

    @cached_property
    def spreads(self) -> tuple[float, float]:
        """Largest distance of base points from their centre, and of platform points, [m]."""
        radii = [
            float(np.linalg.norm(points - points.mean(axis=0), axis=1).max())
            for points in (self.base, self.platform)
        ]
        base, platform = (spread if spread > ALIKE * self.size else 0.0 for spread in radii)
        return base or self.size, platform or base or self.size

    @cached_property
    def _free(self) -> tuple[Array, Array] | None:
        """Points of base and platform if each fixes its own isometry; None if not."""
        if not self.mechanism.platform.turns:
            return None
        bodies = (self.base, self.platform)
        return bodies if all(self._rank(points) >= self._least_rank for points in bodies) else None

    @property
    def _least_rank(self) -> int:
        """Independent directions that fix an isometry, given whether it reflects."""
        return self.mechanism.platform.space - 1

    @cached_property
    def _joined(self) -> tuple[Array, Index]:
        """Points that turn together, base frame, (n, 3), and to which leg each belongs; or −1.

        A platform that does not turn, turns as the base does; else both are one body at home.
        Where that leaves the axis open, it is home's position, and then the base's z.
        """
        legs = np.arange(len(self.base))
        if not self.mechanism.platform.turns:
            base, platform = (body - body.mean(axis=0) for body in (self.base, self.platform))
            points = np.concatenate((base, platform, -base, -platform))  # about their centres
            owners = np.tile(legs, 4)
            if self._rank(points) >= self._least_rank:
                return points, owners
        platform_at_home = self.platform @ self.home[:3, :3].T + self.home[:3, 3]
        points, owners = np.concatenate((self.base, platform_at_home)), np.concatenate((legs, legs))
        for anchor in (self.home[:3, 3], self.base.mean(axis=0) + self.size * np.eye(3)[2]):
            if self._rank(points) < self._least_rank:
                points, owners = np.vstack((points, anchor)), np.append(owners, -1)
        return points, owners

    def fitted(self, images: Sequence[int], legs: Sequence[int], sign: float) -> Element | None:
        """Return the element that best carries some legs onto their images.

        Args:
            images: Indices of legs onto which they go.
            legs: Indices of the legs.
            sign: 1 of rotations, −1 of reflections.

        Returns:
            None if the points leave an axis open.
        """
        space = self.mechanism.platform.space
        to = dict(zip(legs, images, strict=True))
        sources, its = list(legs), list(images)
        if self._free:
            pairs = [(points[sources], points[its]) for points in self._free]
            if any(self._rank(first) < self._least_rank for first, _ in pairs):
                return None
            base, platform = (_procrustes(a, b, sign, space) for a, b in pairs)
            return Element.of(base, platform)
        points, owners = self._joined
        rows = [i for i, owner in enumerate(owners) if owner < 0 or owner in to]
        targets = [i if owners[i] < 0 else self._row(i, to[int(owners[i])]) for i in rows]
        if self._rank(points[rows]) < self._least_rank:
            return None
        base = _procrustes(points[rows], points[targets], sign, space)
        if self.mechanism.platform.turns:
            home_inverse = np.linalg.inv(self.home)
            return Element.of(base, Isometry.of(home_inverse @ base.matrix @ self.home))
        return Element.of(
            *(_shifted(base.Q, p[sources], p[its]) for p in (self.base, self.platform))
        )

    def _rank(self, points: Array) -> int:
        """Return how many directions points span, seen from their centre."""
        s = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
        return int(np.count_nonzero(s > ALIKE * self.size))

    def _row(self, row: int, leg: int) -> int:
        """Return the row of another leg's point of the same kind."""
        n = len(self.base)
        return leg + n * (row // n)

    def distances(self, element: Element) -> Array:
        """Return how far carried legs' points are from others, over the spreads, shape (n, n)."""
        bodies = ((self.base, element.base), (self.platform, element.platform))
        return np.maximum(
            *(
                np.linalg.norm(isometry(points)[:, None] - points, axis=2) / spread
                for (points, isometry), spread in zip(bodies, self.spreads, strict=True)
            )
        )

    def keeps_freedoms(self, element: Element) -> bool:
        """Return whether the platform's poses are carried to poses that it can have."""
        platform = self.mechanism.platform
        rng = np.random.default_rng(0)
        twists = rng.uniform(-0.5, 0.5, (3, platform.dof))
        twists[:, : platform.lengths] *= self.size
        matrices = platform.displaced(platform.home_pose[[0, 0, 0]].as_matrix(), twists)
        carried = element.matrices(matrices)
        deviation = platform.matrices(platform.from_matrices(carried)) - carried
        deviation[:, :3, 3] /= self.size
        return bool(np.abs(deviation).max() <= ALIKE)


def candidates(points: Points, nearly: float) -> list[Element]:
    """Return the elements that carry every leg's points near those of some leg, each once.

    Args:
        points: The legs' points.
        nearly: How near, relative to how far the points are apart.
    """
    from scipy.optimize import linear_sum_assignment  # slow to load: when needed

    legs, elements = _references(points), [Element(0.0)]
    for images in _images(points, legs, nearly):
        for sign in (1.0, -1.0):
            first = points.fitted(images, legs, sign)
            if first is None:
                continue
            _, to = linear_sum_assignment(points.distances(first))
            every = list(range(len(to)))
            element = points.fitted(to.tolist(), every, sign) or first
            near = points.distances(element) <= nearly
            if not (near.any(axis=0).all() and near.any(axis=1).all()):
                continue
            if not any(_nearly_equal(element, known) for known in elements):
                elements.append(element)
    return [element for element in elements if points.keeps_freedoms(element)]


def _references(points: Points) -> list[int]:
    """Return a few legs whose images fix an element, far from each other."""
    places = np.hstack((points.base / points.spreads[0], points.platform / points.spreads[1]))
    legs = [0]
    while len(legs) < len(places) and points.fitted(legs, legs, 1.0) is None:
        distances = np.linalg.norm(places[:, None] - places[legs], axis=2).min(axis=1)
        remaining = [i for i in range(len(places)) if i not in legs]
        legs.append(max(remaining, key=lambda i: (distances[i], -i)))
    return legs


def _images(points: Points, legs: list[int], nearly: float) -> Iterator[list[int]]:
    """Yield where some legs may go: distances between them stay."""
    distances = [
        np.linalg.norm(body[:, None] - body, axis=2) / spread
        for body, spread in zip((points.base, points.platform), points.spreads, strict=True)
    ]

    def extend(images: list[int]) -> Iterator[list[int]]:
        if len(images) == len(legs):
            yield images
            return
        new = legs[len(images)]
        for image in range(len(points.base)):
            if image not in images and all(
                abs(d[new, leg] - d[image, leg_image]) <= 2.0 * nearly
                for d in distances
                for leg, leg_image in zip(legs, images, strict=False)
            ):
                yield from extend([*images, image])

    return extend([])


def _nearly_equal(first: Element, second: Element) -> bool:
    """Return whether two elements are the same but for how they were fitted."""
    deviations = (
        np.linalg.norm(a.Q - b.Q)
        for a, b in ((first.base, second.base), (first.platform, second.platform))
    )
    return bool(max(deviations) <= 1e-3)


def _procrustes(first: Array, second: Array, sign: float, space: int) -> Isometry:
    """Return the isometry that best takes points to others, in the plane if space is 2."""
    M = (second - second.mean(axis=0)).T @ (first - first.mean(axis=0))
    U, _, Vt = np.linalg.svd(M[:space, :space])
    flip = np.ones(space)
    flip[-1] = sign * np.sign(np.linalg.det(U @ Vt))
    Q = np.eye(3)
    Q[:space, :space] = U @ (flip[:, None] * Vt)
    return _shifted(Q, first, second)


def _shifted(Q: Array, first: Array, second: Array) -> Isometry:
    """Return the isometry of a matrix that takes points' centre to others'."""
    return Isometry.of(Q, second.mean(axis=0) - Q @ first.mean(axis=0))
