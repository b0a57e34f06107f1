"""Candidate symmetry elements: isometries that carry the legs' end points near those of others.

Also the permutation of the legs that each element makes.
"""

from collections.abc import Sequence
from functools import cached_property
from itertools import permutations

import numpy as np
from scipy.optimize import linear_sum_assignment

from pincal.kinematics.batches import motion_of_points
from pincal.kinematics.closure import nominal_legs
from pincal.model import Mechanism
from pincal.model.checks import ALIKE, ROUNDING
from pincal.symmetry.elements import IDENTITY, Element, applied, isometry
from pincal.symmetry.shapes import StandingLeg, deviations, pointing_joints
from pincal.types import Array, Index
from pincal.words.numbers import POSES, amount

Permutation = tuple[int, ...]

NEARLY = 0.1
"""Largest distance of carried leg points, over their spread, of a symmetry that may be meant."""
_FITTED = 1e-3  # largest difference between two fits of the same element


class LegImages:
    """The legs onto which elements carry a mechanism's legs, and how far the images differ."""

    def __init__(self, mechanism: Mechanism) -> None:
        self.mechanism = mechanism
        self.home = mechanism.platform.home_pose.as_matrix()[0]
        legs = nominal_legs(mechanism)
        pairs = zip(legs, pointing_joints(legs), strict=True)
        self.shapes = [StandingLeg(leg, self.home, joints, near=True) for leg, joints in pairs]
        self.base = base = np.array([shape.base for shape in self.shapes])
        """Base points of the legs, base frame, shape (n_legs, 3), [m]."""
        points = ([p.placement.xyz for p in leg.points] for leg in mechanism.legs)
        self.platform = np.array([np.mean(of_leg, axis=0) for of_leg in points])
        """Mean of each leg's platform points, platform frame, shape (n_legs, 3), [m]."""
        self.at_home = self.platform @ self.home[:3, :3].T + self.home[:3, 3]
        """Platform points in the base frame at home, shape (n_legs, 3), [m]."""
        bodies = base, self.platform
        self.centres = bodies[0].mean(axis=0), bodies[1].mean(axis=0)
        """Centres of the base points and of the platform points, shape (3,) each, [m]."""
        spreads = [float(np.linalg.norm(p - p.mean(axis=0), axis=1).max()) for p in bodies]
        longest = float(np.linalg.norm(self.at_home - base, axis=1).max())
        self.size = max(spreads[0], longest) or 1.0
        """Size of the mechanism, independent of the choice of frames, [m]."""
        first, second = (spread if spread > ALIKE * self.size else 0.0 for spread in spreads)
        self.spreads = first or self.size, second or first or self.size
        """Largest distances of the base points and platform points from their centres, [m]."""
        self._least_rank = mechanism.platform.space - 1  # rank of points that fix an isometry
        turning = bool(mechanism.platform.turns)
        self._free = turning and all(self._rank(p) >= self._least_rank for p in bodies)

    @cached_property
    def _joined(self) -> tuple[Array, Index]:
        """Points of one rigid body, base frame, shape (n, 3), and the leg index of each, or −1.

        A platform without rotations is turned as the base is; otherwise base and platform are one
        body at home. Where these points leave an axis open, home's position and one on z are added.
        """
        legs = np.arange(len(self.base))
        if not self.mechanism.platform.turns:
            bodies = zip((self.base, self.platform), self.centres, strict=True)
            base, platform = (body - centre for body, centre in bodies)
            points = np.concatenate((base, platform, -base, -platform))
            owners = np.tile(legs, 4)
            if self._rank(points) >= self._least_rank:
                return points, owners
        points, owners = np.concatenate((self.base, self.at_home)), np.concatenate((legs, legs))
        for anchor in (self.home[:3, 3], self.centres[0] + self.size * np.eye(3)[2]):
            if self._rank(points) < self._least_rank:
                points, owners = np.vstack((points, anchor)), np.append(owners, -1)
        return points, owners

    def fitted(self, images: Sequence[int], legs: Sequence[int], sign: float) -> Element | None:
        """Return the element that best carries legs onto images, both given by index.

        ``sign`` is 1 for a rotation, −1 for a reflection; None if the points fix no isometry.
        """
        space, sources, targets = self.mechanism.platform.space, list(legs), list(images)
        bodies = self.base, self.platform
        if self._free:
            if any(self._rank(points[sources]) < self._least_rank for points in bodies):
                return None
            pairs = ((points[sources], points[targets]) for points in bodies)
            return Element.of(*(motion_of_points(*pair, space, sign) for pair in pairs))
        points, owners = self._joined
        to = dict(zip(sources, targets, strict=True))
        rows = [i for i, owner in enumerate(owners) if owner < 0 or owner in to]
        if self._rank(points[rows]) < self._least_rank:
            return None
        after = [i + to[int(owners[i])] - owners[i] if owners[i] >= 0 else i for i in rows]
        base = motion_of_points(points[rows], points[after], space, sign)
        if self.mechanism.platform.turns:
            return Element.of(base, np.linalg.inv(self.home) @ base @ self.home)
        Q = base[:3, :3]
        shifts = (p[targets].mean(axis=0) - Q @ p[sources].mean(axis=0) for p in bodies)
        return Element.of(*(isometry(Q, shift) for shift in shifts))

    def _rank(self, points: Array) -> int:
        """Return the dimension that points span about their centre."""
        s = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
        return int(np.count_nonzero(s > ALIKE * self.size))

    def distances(self, element: Element) -> Array:
        """Return distances of carried legs' points from all legs', over the spreads, (n, n)."""
        bodies = (self.base, element.base), (self.platform, element.platform)
        gaps = (np.linalg.norm(applied(G, p)[:, None] - p, axis=2) for p, G in bodies)
        return np.maximum(*(d / spread for d, spread in zip(gaps, self.spreads, strict=True)))

    @cached_property
    def _apart(self) -> list[Array]:
        """Distances between base points and between platform points, over their spreads, (n, n)."""
        bodies = zip((self.base, self.platform), self.spreads, strict=True)
        return [np.linalg.norm(p[:, None] - p, axis=2) / spread for p, spread in bodies]

    @cached_property
    def candidates(self) -> list[Element]:
        """Distinct elements that carry every leg's points near those of some leg."""
        legs, elements = self._references(), [IDENTITY]
        for images in permutations(range(len(self.base)), len(legs)):
            pairs = np.ix_(legs, legs), np.ix_(images, images)
            if max(np.abs(d[pairs[0]] - d[pairs[1]]).max() for d in self._apart) > 2.0 * NEARLY:
                continue  # an isometry keeps the distances between points
            for sign in (1.0, -1.0):
                first = self.fitted(images, legs, sign)
                if first is None:
                    continue
                _, to = linear_sum_assignment(self.distances(first))
                element = self.fitted(to.tolist(), range(len(to)), sign) or first
                near = self.distances(element) <= NEARLY
                fresh = min(np.linalg.norm(element.turns - e.turns) for e in elements) > _FITTED
                if fresh and near.any(axis=0).all() and near.any(axis=1).all():
                    elements.append(element)
        return [element for element in elements if self._keeps_freedoms(element)]

    def _references(self) -> list[int]:
        """Return the indices of a few legs, far from each other, whose images fix an element."""
        places = np.hstack((self.base / self.spreads[0], self.platform / self.spreads[1]))
        legs = [0]
        while len(legs) < len(places) and self.fitted(legs, legs, 1.0) is None:
            distances = np.linalg.norm(places[:, None] - places[legs], axis=2).min(axis=1)
            distances[legs] = -1.0
            legs.append(int(np.argmax(distances)))
        return legs

    def _keeps_freedoms(self, element: Element) -> bool:
        """Return whether an element carries poses of the platform to poses that it can have."""
        platform = self.mechanism.platform
        twists = np.random.default_rng(0).uniform(-0.5, 0.5, (3, platform.dof))
        twists[:, : platform.lengths] *= self.size
        matrices = platform.displaced(platform.home_pose[[0, 0, 0]].as_matrix(), twists)
        carried = element.matrices(matrices)
        deviation = platform.matrices(platform.from_matrices(carried)) - carried
        deviation[:, :3, 3] /= self.size
        return bool(np.abs(deviation).max() <= ALIKE)

    def home_moves(self, element: Element) -> float:
        """Return the largest coordinate, [m] or [rad], of the twist from home to its image."""
        platform = self.mechanism.platform
        home = np.array([platform.home])
        return float(np.abs(platform.twists_between(home, element.poses(platform, home))).max())

    def standing(self, element: Element) -> list[StandingLeg]:
        """Return the legs closed at the image of the home pose."""
        moved, carried = self.home_moves(element), element.matrices(self.home[None])[0]
        if moved <= ROUNDING * self.size:
            return self.shapes
        near = moved <= NEARLY * self.size
        return [StandingLeg(s.closure, carried, s.pointing, near=near) for s in self.shapes]

    def permutation(self, element: Element, tolerance: float) -> Permutation:
        """Return the index of each leg's image within a tolerance; empty if a leg has none."""
        count = len(self.shapes)
        if element.is_identity:
            return tuple(range(count))
        standing, distances = self.standing(element), self.distances(element)
        fits = np.zeros((count, count), dtype=bool)
        for index, image in np.argwhere(distances <= 2.0 * NEARLY):
            fits[index, image] = not self.deviation(index, element, standing[image], tolerance)
        rows, to = linear_sum_assignment(np.where(fits, distances, 1e6))
        return tuple(to.tolist()) if fits[rows, to].all() else ()

    def deviation(self, index: int, element: Element, image: StandingLeg, tolerance: float) -> str:
        """Return the first deviation of a carried leg from its image beyond a tolerance, if any."""
        for quantity, value, unit in deviations(self.shapes[index], element, image):
            if not value <= tolerance * (self.size if unit == "m" else 1.0):
                return quantity + f", by {amount(value, unit, 4, POSES)}" * (value < np.inf)
        return ""
