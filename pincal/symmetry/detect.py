"""Detection of a mechanism's symmetry group from geometry, limits and working modes.

Candidates carry every leg near a leg, the group's elements within a tolerance. The group is their
largest closed subset, with isometries made exact; each element is then checked again with these.
For every other element that leg points suggest, a deviation that breaks it is named.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal
from functools import cached_property, lru_cache

import numpy as np
from scipy.optimize import linear_sum_assignment

from pincal.errors import SymmetryError
from pincal.files.mechanism_folders import GivenMechanism, as_mechanism
from pincal.model import Mechanism
from pincal.model.checks import ALIKE, number_of
from pincal.symmetry.candidates import NEARLY, LegImages, Permutation
from pincal.symmetry.elements import (
    Element,
    distinct,
    exact,
    group_name,
    isometry,
    largest_closed,
    place_of,
    product_table,
    subgroups,
)
from pincal.words.numbers import listed


@dataclass(frozen=True, repr=False)
class SymmetryGroup:
    """Group of the elements that leave a mechanism unchanged, with their permutations of legs."""

    mechanism: Mechanism
    elements: tuple[Element, ...]
    """Elements of the group, the identity first."""
    permutations: tuple[Permutation, ...]
    """For each element, the index of the leg onto which each leg is carried."""
    tolerance: float = 1e-6
    """Tolerance of the detection, relative to the size for lengths, [rad] for angles."""

    @cached_property
    def breaks(self) -> dict[str, dict[Element, str]]:
        """Other elements that leg points suggest, with a leg that differs, by the difference."""
        images, breaks = _leg_images(self.mechanism), dict[str, dict[Element, str]]()
        for element in sorted(_meant(images), key=place_of):
            near = min(np.abs(element.matrix - e.matrix).max() for e in self.elements) < NEARLY
            if not near and (broken := _deviation(images, element, self.tolerance)):
                leg, difference = broken
                breaks.setdefault(difference, {})[element] = leg
        return breaks

    @property
    def reasons(self) -> list[str]:
        """Sentences that say why other elements are no symmetries, one for each difference."""
        sentences = []
        for difference, legs in self.breaks.items():
            differing = list(dict.fromkeys(legs.values()))
            verb = f"differ{'s' * (len(differing) == 1)} from what is carried there in"
            sentences.append(f"{listed(legs)}: {listed(differing)} {verb} {difference}")
        return sentences

    @cached_property
    def name(self) -> str:
        """Name of the group: D_2n of order 2n, C_n of rotations only, or a count of elements."""
        return group_name(self.elements)

    def subgroups(self) -> tuple[SymmetryGroup, ...]:
        """Return all subgroups, the largest first."""
        closed = subgroups(product_table(self.elements))
        return tuple(self.part(sorted(indices)) for indices in reversed(closed))

    def part(self, indices: Sequence[int]) -> SymmetryGroup:
        """Return the subgroup of the elements with some indices, which must be closed."""
        elements = tuple(self.elements[i] for i in indices)
        permutations = tuple(self.permutations[i] for i in indices)
        return SymmetryGroup(self.mechanism, elements, permutations, self.tolerance)

    @property
    def leg_orbits(self) -> tuple[tuple[str, ...], ...]:
        """Orbits: names of the legs that the elements carry onto each other."""
        names = self.mechanism.leg_names
        orbits = [sorted({p[i] for p in self.permutations}) for i in range(len(names))]
        return tuple(dict.fromkeys(tuple(names[i] for i in orbit) for orbit in orbits))

    def carriers(self, leg: str | None = None) -> tuple[Element, ...]:
        """Return G_C, an element that carries one leg onto each leg (3-RRR paper, Eq. 7).

        By default the first leg must be carried onto every leg; a leg that is named is carried onto
        the legs of its orbit.

        Raises:
            SymmetryError: no leg is named, and no element carries the first one onto some leg.
        """
        names = self.mechanism.leg_names
        first = names.index(leg) if leg is not None else 0
        carriers: dict[int, Element] = {}
        for element, permutation in zip(self.elements, self.permutations, strict=True):
            carriers.setdefault(permutation[first], element)
        if leg is None and len(carriers) < len(names):
            missed = next(name for index, name in enumerate(names) if index not in carriers)
            broken = "; ".join(self.reasons)
            raise SymmetryError(
                f"no symmetry of {self.mechanism.name!r} carries {names[0]} onto {missed}"
                f"{broken and f' ({broken})'}. "
                "Choose poses for each leg separately (--protocol independent)"
            )
        return tuple(carriers[index] for index in sorted(carriers))

    def __repr__(self) -> str:
        count = len(self.elements)
        return f"SymmetryGroup: {self.name} of {self.mechanism.name}, {count} element(s)"

    def __str__(self) -> str:
        """Return a text with the elements, and a line for each broken symmetry."""
        broken = (f"  no symmetry: {sentence}" for sentence in self.reasons)
        return "\n".join((f"{self.name}: {', '.join(map(str, self.elements))}", *broken))


_WITHIN, _WRITTEN, _ROUNDED = 1e-6, range(5, 9), 4.0  # tolerance; digits; tolerance in roundings


def written_within(mechanism: Mechanism) -> float:
    """Return the tolerance that allows for the rounding of parameters with 5 to 8 digits.

    It is four rounding errors of the largest number, at least 1e-6; fewer digits count as exact.
    """
    values = [Decimal(repr(v)).normalize() for leg in mechanism.legs for v in leg.nominal.tolist()]
    digits = max((len(v.as_tuple().digits) for v in values if v), default=0)
    if digits not in _WRITTEN:
        return _WITHIN
    largest = max(v.adjusted() for v in values if v)
    return max(_WITHIN, _ROUNDED * 0.5 * 10.0 ** (largest + 1 - digits))


def symmetry_group(mechanism: GivenMechanism, tolerance: float | None = None) -> SymmetryGroup:
    """Return the symmetry group of a mechanism's nominal geometry, limits and working modes.

    Legs move alike under it, but their sensors may have other gains and offsets.

    Args:
        mechanism: The mechanism.
        tolerance: Largest deviation, relative to the mechanism's size for lengths, [rad] for
            angles; by default 1e-6, or more if the digits of the parameters require it.
    """
    mechanism = as_mechanism(mechanism)
    tolerance = written_within(mechanism) if tolerance is None else tolerance
    return _group(mechanism, number_of(tolerance, "tolerance", SymmetryError))


_leg_images = lru_cache(maxsize=4)(LegImages)  # its candidates serve every tolerance


@lru_cache(maxsize=64)
def _group(mechanism: Mechanism, tolerance: float) -> SymmetryGroup:
    """Return the symmetry group of a mechanism, cached: see ``symmetry_group``."""
    images = _leg_images(mechanism)
    permuted = {e: p for e in images.candidates if (p := images.permutation(e, tolerance))}
    elements, permutations = list(permuted), list(permuted.values())
    chosen = distinct(elements, permutations)
    while True:
        elements, permutations = [elements[i] for i in chosen], [permutations[i] for i in chosen]
        closed = largest_closed(product_table(elements, permutations))
        elements = exact([elements[i] for i in closed], images.centres, images.size)
        permutations = [images.permutation(element, tolerance) for element in elements]
        chosen = [i for i, legs in enumerate(permutations) if legs]  # at least the identity
        closes = len(chosen) == len(elements)
        if closes and (product_table(elements, permutations) >= 0).all():
            break
    group = SymmetryGroup(mechanism, tuple(elements), tuple(permutations), tolerance)
    return group.part(sorted(chosen, key=lambda i: place_of(elements[i])))


def _meant(images: LegImages) -> list[Element]:
    """Return elements that leg points suggest, with exact isometries; none turns home over.

    Elements about the base's z axis are preferred: a fit spreads one leg's error.
    """
    elements = images.candidates
    labels = [tuple(linear_sum_assignment(images.distances(e))[1].tolist()) for e in elements]
    closed = [elements[i] for i in largest_closed(product_table(elements, labels))]
    fitted, drawn = exact(closed, images.centres, images.size), list[Element]()
    for Q in (element.matrix for element in fitted):
        flat = Element(float(np.arctan2(Q[1, 0], Q[0, 0])), bool(np.linalg.det(Q[:2, :2]) < 0.0))
        turn = isometry(flat.matrix @ np.diag([1.0, 1.0, np.sign(Q[2, 2])]))
        drawn.append(Element.of(turn, turn))
    near = all(images.distances(element).min(axis=1).max() < NEARLY for element in drawn)
    meant, space = drawn if near else fitted, images.mechanism.platform.space
    over = (space == 3 and e.matrix[2, 2] < 0.0 and images.home_moves(e) > NEARLY for e in meant)
    return [element for element, upside_down in zip(meant, over, strict=True) if not upside_down]


def _deviation(images: LegImages, element: Element, tolerance: float) -> tuple[str, str] | None:
    """Return a leg that differs from what an element carries there, and in what, by how much."""
    standing = images.standing(element)
    for index, distances in enumerate(images.distances(element)):
        near = np.flatnonzero(distances <= distances.min() + ALIKE).tolist()
        broken = [images.deviation(index, element, standing[i], tolerance) for i in near]
        if all(broken):
            return images.mechanism.leg_names[near[0]], broken[0]
    return None
