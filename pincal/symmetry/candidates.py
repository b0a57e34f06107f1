"""Elements that leg points suggest: those that carry where legs begin and end near one another."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.optimize import linear_sum_assignment

from pincal.model.checks import ALIKE
from pincal.model.mechanism import Mechanism
from pincal.symmetry.elements import Element, Isometry
from pincal.types import Array, Index

NEARLY = 0.1
"""Of how far leg points are apart: a symmetry meant, though not kept."""


@dataclass(frozen=True, eq=False)
class Points:
    """Where the legs of a mechanism begin and end."""

    mechanism: Mechanism
    base: Array
    """Base points in the base frame, shape (n_legs, 3), [m]."""

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

    @property
    def centres(self) -> tuple[Array, Array]:
        """Centres of base points and platform points, shape (3,) each, [m]."""
        return self.base.mean(axis=0), self.platform.mean(axis=0)

    @cached_property
    def candidates(self) -> list[Element]:
        """Elements that carry every leg's points near those of some leg, each once."""
        legs, elements = _references(self), [Element(0.0)]
        for images in _images(self, legs):
            for sign in (1.0, -1.0):
                first = self.fitted(images, legs, sign)
                if first is None:
                    continue
                _, to = linear_sum_assignment(self.distances(first))
                element = self.fitted(to.tolist(), range(len(to)), sign) or first
                near = self.distances(element) <= NEARLY
                if not (near.any(axis=0).all() and near.any(axis=1).all()):
                    continue
                if not any(_nearly_equal(element, known) for known in elements):
                    elements.append(element)
        return [element for element in elements if self.keeps_freedoms(element)]

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


def _references(points: Points) -> list[int]:
    """Return a few legs whose images fix an element, far from each other."""
    places = np.hstack((points.base / points.spreads[0], points.platform / points.spreads[1]))
    legs = [0]
    while len(legs) < len(places) and points.fitted(legs, legs, 1.0) is None:
        distances = np.linalg.norm(places[:, None] - places[legs], axis=2).min(axis=1)
        remaining = [i for i in range(len(places)) if i not in legs]
        legs.append(max(remaining, key=lambda i: (distances[i], -i)))
    return legs


def _images(points: Points, legs: list[int]) -> Iterator[list[int]]:
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
                abs(d[new, leg] - d[image, leg_image]) <= 2.0 * NEARLY
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
