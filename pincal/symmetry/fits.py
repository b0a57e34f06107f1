"""Which legs an element carries onto which, and by how much these differ."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache

import numpy as np

from pincal.model.leg import Leg
from pincal.model.mechanism import Mechanism
from pincal.symmetry.carry import bare, canonical, carry
from pincal.symmetry.differences import Difference, Points, Traits, candidates, differences
from pincal.symmetry.elements import Element
from pincal.types import Array

Permutation = tuple[int, ...]
NEARLY = 0.1
"""Of how far leg points are apart: a symmetry meant, though not kept."""


@lru_cache(maxsize=64)
def suggested(mechanism: Mechanism) -> tuple[Element, ...]:
    """Return the elements that leg points suggest, found once."""
    return tuple(candidates(Points(mechanism), NEARLY))


class Fits:
    """Which legs of a mechanism elements carry onto which, and by how much these differ."""

    def __init__(self, mechanism: Mechanism, readings: bool) -> None:
        self.mechanism, self.readings = mechanism, readings
        self.points = Points(mechanism)
        self.legs = [canonical(bare(leg)) for leg in mechanism.legs]
        self.traits = [Traits.of(leg, mechanism.platform) for leg in self.legs]
        self._homed = readings and any(s.homed for leg in mechanism.legs for s in leg.sensors)

    @property
    def centres(self) -> tuple[Array, Array]:
        """Centres of base points and platform points, shape (3,) each, [m]."""
        return self.points.base.mean(axis=0), self.points.platform.mean(axis=0)

    def home_moves(self, element: Element) -> float:
        """Return by how much home moves, [m] and [rad] together."""
        platform = self.mechanism.platform
        home = np.array([platform.home])
        carried = element.poses(platform, home)
        return float(np.abs(platform.twists_between(home, carried)).max())

    def permutation(self, element: Element, tolerance: float) -> Permutation:
        """Return onto which leg each one is carried within a tolerance; empty if some is not."""
        from scipy.optimize import linear_sum_assignment  # slow to load: when needed

        count = len(self.legs)
        if element.is_identity:
            return tuple(range(count))
        if self._homed and self.home_moves(element) > tolerance * max(1.0, self.points.size):
            return ()
        fits = np.zeros((count, count), dtype=bool)
        distances = self.points.distances(element)
        for index, leg in enumerate(self.legs):
            carried = carry(leg, element, leg.name, leg.point.name)
            traits = self.carried_traits(index, element)
            for image in np.flatnonzero(distances[index] <= 2.0 * NEARLY):
                fits[index, image] = not any(
                    d.exceeds(tolerance, self.points.size)
                    for d in self.differences(carried, self.legs[image], traits, int(image))
                )
            if not fits[index].any():
                return ()
        rows, to = linear_sum_assignment(np.where(fits, distances, 1e6))
        return tuple(to.tolist()) if fits[rows, to].all() else ()

    def measured(self, element: Element, permutation: Permutation) -> tuple[float, float]:
        """Return the largest deviation of carried legs in [m] and in [rad]."""
        worst = {"m": 0.0, "rad": 0.0, "1": 0.0}
        for index, (leg, image) in enumerate(zip(self.legs, permutation, strict=True)):
            carried = carry(leg, element, leg.name, leg.point.name)
            for difference in self.differences(
                carried, self.legs[image], self.carried_traits(index, element), image
            ):
                worst[difference.unit] = max(worst[difference.unit], difference.deviation or 0.0)
        return worst["m"], worst["rad"]

    def carried_traits(self, index: int, element: Element) -> Traits:
        """Return the traits of a leg, by index, carried by an element."""
        return self.traits[index].carried(self.legs[index], element, self.mechanism.platform)

    def differences(
        self, carried: Leg, leg: Leg, carried_traits: Traits, image: int
    ) -> Iterator[Difference]:
        """Yield in what a carried leg differs from another one, given by its index too."""
        for difference in differences(carried, leg, carried_traits, self.traits[image]):
            if self.readings or not difference.of_sensor:
                yield difference
