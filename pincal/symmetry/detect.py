"""Detection of a mechanism's symmetry group from geometry, limits, working modes and sensors.

The candidates are elements that carry every leg onto a leg within a tolerance. The group is their
largest closed subset, with isometries made exact; each element is then checked again with these.
For every other element that leg points suggest, the difference that breaks it is named.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from decimal import Decimal
from functools import cached_property, lru_cache

import numpy as np
from scipy.optimize import linear_sum_assignment

from pincal.errors import SymmetryError
from pincal.files.mechanism_folders import GivenMechanism, as_mechanism
from pincal.kinematics.closing import home_mode
from pincal.model import Leg, Mechanism
from pincal.model.checks import ALIKE, EXACT, number_of
from pincal.symmetry.candidates import NEARLY, LegImages, Permutation
from pincal.symmetry.carry import canonical, carry
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
    wrapped,
)
from pincal.symmetry.shapes import HOME, Difference, no_symmetries


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
    readings: bool = True
    """Whether sensors were compared too; if not, legs move alike but may read differently."""

    @cached_property
    def breaks(self) -> tuple[Difference, ...]:
        """First difference that breaks each of the other elements that the leg points suggest."""
        fits, breaks = LegImages(self.mechanism, self.readings), []
        for element in sorted(_meant(fits), key=place_of):
            if any(np.abs(element.matrix - e.matrix).max() < NEARLY for e in self.elements):
                continue
            turned_over = self.mechanism.platform.space == 3 and element.matrix[2, 2] < 0.0
            if turned_over and fits.home_moves(element) > NEARLY * fits.size:
                continue  # a machine upside down is no intended symmetry
            if broken := _first_break(fits, element, self.tolerance):
                breaks.append(broken)
        return tuple(breaks)

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
        return SymmetryGroup(self.mechanism, elements, permutations, self.tolerance, self.readings)

    @property
    def leg_orbits(self) -> tuple[tuple[str, ...], ...]:
        """Orbits: names of the legs that the elements carry onto each other."""
        names = self.mechanism.leg_names
        orbits = [sorted({p[i] for p in self.permutations}) for i in range(len(names))]
        return tuple(dict.fromkeys(tuple(names[i] for i in orbit) for orbit in orbits))

    def carriers(self, leg: str | None = None) -> tuple[Element, ...]:
        """Return G_C, an element that carries one leg onto each leg (3-RRR paper, Eq. 7).

        Leg 1 must be carried onto every leg; another leg only onto the legs of its orbit.

        Raises:
            SymmetryError: no element carries leg 1 onto some leg.
        """
        names = self.mechanism.leg_names
        first = names.index(leg) if leg is not None else 0
        carriers: dict[int, Element] = {}
        for element, permutation in zip(self.elements, self.permutations, strict=True):
            carriers.setdefault(permutation[first], element)
        if leg is None and len(carriers) < len(names):
            missed = next(name for index, name in enumerate(names) if index not in carriers)
            broken = "; ".join(no_symmetries(self.breaks))
            raise SymmetryError(
                f"no symmetry of {self.mechanism.name!r} carries leg 1 onto {missed}"
                f"{broken and f' ({broken})'}. "
                "Choose poses for each leg separately (--protocol independent)"
            )
        return tuple(carriers[index] for index in sorted(carriers))

    def __repr__(self) -> str:
        count = len(self.elements)
        return f"SymmetryGroup: {self.name} of {self.mechanism.name}, {count} element(s)"

    def __str__(self) -> str:
        """Return a text with the elements, and a line for each broken symmetry."""
        broken = (f"  no symmetry: {sentence}" for sentence in no_symmetries(self.breaks))
        return "\n".join((f"{self.name}: {', '.join(map(str, self.elements))}", *broken))


_WITHIN, _WRITTEN, _ROUNDED = 1e-6, range(5, 9), 4.0  # tolerance; digits; tolerance in roundings


def written_within(mechanism: Mechanism) -> float:
    """Return the tolerance that allows for the rounding of parameters with 5 to 8 digits.

    It is four rounding errors, [m] or [rad], at least 1e-6. Fewer digits count as exact numbers.
    """
    values = [Decimal(repr(v)).normalize() for leg in mechanism.legs for v in leg.nominal.tolist()]
    digits = max((len(v.as_tuple().digits) for v in values if v), default=0)
    if digits not in _WRITTEN:
        return _WITHIN
    largest = max(v.adjusted() for v in values if v)
    return max(_WITHIN, _ROUNDED * 0.5 * 10.0 ** (largest + 1 - digits))


def symmetry_group(
    mechanism: GivenMechanism, tolerance: float | None = None, *, readings: bool = True
) -> SymmetryGroup:
    """Return the symmetry group of a mechanism's nominal geometry, limits, modes and sensors.

    Args:
        mechanism: The mechanism.
        tolerance: Largest deviation, relative to the mechanism's size for lengths, [rad] for
            angles; by default 1e-6, or more if the digits of the parameters require it.
        readings: Whether to compare the gains, offsets and zeros of sensors too.
    """
    mechanism = as_mechanism(mechanism)
    tolerance = written_within(mechanism) if tolerance is None else tolerance
    return _group(mechanism, number_of(tolerance, "tolerance", SymmetryError), readings)


@lru_cache(maxsize=64)
def _group(mechanism: Mechanism, tolerance: float, readings: bool) -> SymmetryGroup:
    """Return the symmetry group of a mechanism, cached: see ``symmetry_group``."""
    fits = LegImages(mechanism, readings)
    permuted = {e: p for e in fits.candidates if (p := fits.permutation(e, tolerance))}
    elements, permutations = list(permuted), list(permuted.values())
    chosen = distinct(elements, permutations)
    while True:
        elements, permutations = [elements[i] for i in chosen], [permutations[i] for i in chosen]
        closed = largest_closed(product_table(elements, permutations))
        elements = exact([elements[i] for i in closed], fits.centres, fits.size)
        permutations = [fits.permutation(element, tolerance) for element in elements]
        chosen = [i for i, permutation in enumerate(permutations) if permutation]  # the identity
        closes = len(chosen) == len(elements)
        if closes and (product_table(elements, permutations) >= 0).all():
            break
    group = SymmetryGroup(mechanism, tuple(elements), tuple(permutations), tolerance, readings)
    return group.part(sorted(chosen, key=lambda i: place_of(elements[i])))


def _meant(fits: LegImages) -> list[Element]:
    """Return a group of elements that leg points suggest, with exact isometries.

    Elements about the base's z axis are preferred if nearly as good: a fit spreads one leg's error.
    """
    elements = fits.candidates
    labels = [tuple(linear_sum_assignment(fits.distances(e))[1].tolist()) for e in elements]
    closed = [elements[i] for i in largest_closed(product_table(elements, labels))]
    fitted = exact(closed, fits.centres, fits.size)
    drawn = [upright for element in fitted if (upright := _about_z(element))]
    if len(drawn) == len(fitted):
        off_drawn, off_fitted = (
            max(fits.distances(element).min(axis=1).max() for element in version)
            for version in (drawn, fitted)
        )
        if off_drawn <= len(fits.shapes) * off_fitted + EXACT:
            return drawn
    return fitted


def _about_z(element: Element) -> Element | None:
    """Return the element about the base's z axis that is near another element, or None."""
    Q = element.matrix
    side = np.sign(np.linalg.det(Q[:2, :2]))
    turn = Element(float(np.arctan2(Q[1, 0], Q[0, 0])), bool(side < 0.0)).matrix.copy()
    turn[2, 2] = np.sign(Q[2, 2])
    if np.linalg.norm(turn - element.turns, axis=(1, 2)).max() > NEARLY:
        return None
    return Element.of(isometry(turn), isometry(turn))


def _first_break(fits: LegImages, element: Element, tolerance: float) -> Difference | None:
    """Return the first difference that breaks an element, in a parameter where possible."""
    legs, size = fits.mechanism.legs, fits.size
    moves = fits.home_moves(element) > tolerance * max(1.0, size)
    standing = fits.standing(element)
    for index, distances in enumerate(fits.distances(element)):
        if moves and fits.readings and any(sensor.homed for sensor in legs[index].sensors):
            return Difference(HOME, None, element=element, leg=legs[index].name)
        order = np.argsort(distances)
        near = order[distances[order] <= distances.min() + ALIKE].tolist()
        differing = [fits.exceeding(index, element, standing[i], tolerance) for i in near]
        if all(differing):
            image = legs[near[0]]
            named = _named(fits, legs[index], element, image)
            differs = next((d for d in named if d.exceeds(tolerance, size)), differing[0])
            if differs is not None:
                return replace(differs, element=element, leg=image.name)
    return None


def _description(leg: Leg) -> tuple[object, ...]:
    """Return what the numbers of a leg mean: names, active joints, kinds of coordinates."""
    placements = (joint.placement for joint in (*leg.joints, *leg.points))
    kinds = [c.kind for placement in placements for c in placement.coordinates]
    return leg.parameter_names, leg.active, kinds


def _named(fits: LegImages, leg: Leg, element: Element, image: Leg) -> Iterator[Difference]:
    """Yield differences of a carried leg's parameters and constants from those of its image."""
    carried, drawn = carry(leg.without_terms, element), canonical(image.without_terms)
    if _description(carried) != _description(drawn):  # the same numbers mean other places
        return

    def apart(value: float, unit: str) -> float:
        return abs(wrapped(value) if unit == "rad" else value)

    before, after = carried.nominal_by_name, drawn.nominal_by_name
    for name, unit in drawn.units.items():
        yield Difference(f"parameter {name!r}", apart(before[name] - after[name], unit), unit)
    platform = fits.mechanism.platform
    if home_mode(carried, platform) != home_mode(drawn, platform):
        yield Difference("working mode (the side on which the leg bends)", None)
    for a, b, unit in zip(carried.sensors, drawn.sensors, drawn.reading_units, strict=True):
        if not fits.readings or (a.form, a.direction) != (b.form, b.direction):
            continue
        gains, offsets = zip(a.constants(before), b.constants(after), strict=True)
        yield Difference("gain of the sensor", abs(gains[0] - gains[1]))
        yield Difference("offset of the sensor", apart(offsets[0] - offsets[1], unit), unit)
        if not (isinstance(a.zero, str) or isinstance(b.zero, str)):
            yield Difference("zero of the sensor", apart(a.zero - b.zero, unit), unit)
