"""The symmetry group of a mechanism, detected from geometry, limits, working modes, sensors.

Elements that carry leg points onto leg points are candidates, wherever base and platform frames
are. Those that carry every leg onto a leg within a tolerance are looked at together: the group is
the largest closed subset of them, with isometries that are exact, and each of its elements
is measured again with these.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from pincal.errors import SymmetryError
from pincal.files.mechanism_folders import GivenMechanism, as_mechanism
from pincal.kinematics.inverse import inverse
from pincal.model.checks import number_of
from pincal.model.mechanism import Mechanism
from pincal.model.platform import Poses
from pincal.symmetry.breaks import Break, breaks_of, no_symmetries
from pincal.symmetry.elements import Element
from pincal.symmetry.groups import (
    distinct,
    exact,
    group_name,
    largest_closed,
    place_of,
    product_table,
    subgroups,
)
from pincal.symmetry.shapes import LegImages, Permutation
from pincal.types import Array


@dataclass(frozen=True, repr=False)
class SymmetryGroup:
    """Elements that leave a mechanism as it is, and where they carry its legs: a group."""

    mechanism: Mechanism
    elements: tuple[Element, ...]
    """The identity first."""
    permutations: tuple[Permutation, ...]
    """For each element: index of the leg onto which each leg is carried."""
    tolerance: float = 1e-6
    """Within which it was found."""
    readings: bool = True
    """Whether sensors were compared too: if not, legs move alike and may read differently."""

    @cached_property
    def breaks(self) -> tuple[Break, ...]:
        """Why the other elements that the leg points suggest fail."""
        return breaks_of(LegImages(self.mechanism, self.readings), self.elements, self.tolerance)

    @cached_property
    def name(self) -> str:
        """Name of the group: D_2n with its order 2n, C_n of rotations only, or what it has."""
        return group_name(self.elements)

    def subgroups(self) -> tuple[SymmetryGroup, ...]:
        """Return all subgroups, the largest first."""
        closed = subgroups(product_table(self.elements))
        return tuple(self.part(sorted(indices)) for indices in reversed(closed))

    def part(self, indices: Sequence[int]) -> SymmetryGroup:
        """Return the group of some elements, by index; they are closed."""
        elements = tuple(self.elements[i] for i in indices)
        permutations = tuple(self.permutations[i] for i in indices)
        return SymmetryGroup(self.mechanism, elements, permutations, self.tolerance, self.readings)

    @property
    def leg_orbits(self) -> tuple[tuple[str, ...], ...]:
        """Names of legs that the elements carry onto each other, orbit by orbit."""
        names = self.mechanism.leg_names
        orbits = [sorted({p[i] for p in self.permutations}) for i in range(len(names))]
        return tuple(dict.fromkeys(tuple(names[i] for i in orbit) for orbit in orbits))

    def carriers(self, leg: str | None = None) -> tuple[Element, ...]:
        """Return G_C: for each leg, an element that carries one onto it (3-RRR paper, Eq. 7).

        Args:
            leg: The leg that is carried; leg 1 if not given, which must be carried onto every leg.
                For another one, the legs of its orbit, in order.

        Raises:
            SymmetryError: some leg cannot be reached from leg 1.
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
                "Choose poses for each leg on its own (--protocol independent)"
            )
        return tuple(carriers[index] for index in sorted(carriers))

    def orbit(self, poses: Poses) -> Array:
        """Return the poses onto which each pose is carried, shape (n_elements, N, dof).

        A pose that an element leaves where it is appears as often as that.
        """
        platform = self.mechanism.platform
        return np.stack([element.poses(platform, poses) for element in self.elements])

    def equivariance(self, poses: Poses) -> float:
        """Return the largest |reading of a carried leg at carried poses − reading| (Eq. 5).

        Poses are in reach. The identity carries nothing; readings need not follow from poses then.
        """
        if len(self.elements) == 1:
            return 0.0
        mechanism, worst = self.mechanism, 0.0
        before, columns = inverse(mechanism, poses).readings, mechanism.reading_columns
        for element, permutation in zip(self.elements, self.permutations, strict=True):
            after = inverse(mechanism, element.poses(mechanism.platform, poses)).readings
            order = np.concatenate([np.r_[columns[index]] for index in permutation])
            worst = max(worst, float(np.abs(after[:, order] - before).max()))
        return worst

    def __repr__(self) -> str:
        """Return the group in a line."""
        count = len(self.elements)
        return f"SymmetryGroup: {self.name} of {self.mechanism.name}, {count} element(s)"

    def __str__(self) -> str:
        """Return a page: the elements, and what breaks the others."""
        broken = (f"  no symmetry: {sentence}" for sentence in no_symmetries(self.breaks))
        return "\n".join((f"{self.name}: {', '.join(map(str, self.elements))}", *broken))


def symmetry_group(
    mechanism: GivenMechanism, tolerance: float = 1e-6, *, readings: bool = True
) -> SymmetryGroup:
    """Return the symmetry group of a mechanism's nominal geometry, limits, modes and sensors.

    Args:
        mechanism: The mechanism.
        tolerance: Largest deviation, relative to the mechanism's size for lengths, [rad] for
            angles.
        readings: Whether readings follow too; if not, gains, offsets and zeros of sensors are not
            compared.
    """
    tolerance = number_of(tolerance, "tolerance", SymmetryError)
    return _group(as_mechanism(mechanism), tolerance, readings)


@lru_cache(maxsize=64)
def _group(mechanism: Mechanism, tolerance: float, readings: bool) -> SymmetryGroup:
    """Return the symmetry group of a mechanism, found once."""
    fits = LegImages(mechanism, readings)
    permuted = {e: p for e in fits.points.candidates if (p := fits.permutation(e, tolerance))}
    elements, permutations = list(permuted), list(permuted.values())
    chosen = distinct(elements, permutations)
    while True:
        elements, permutations = [elements[i] for i in chosen], [permutations[i] for i in chosen]
        closed = largest_closed(product_table(elements, permutations))
        elements = exact([elements[i] for i in closed], fits.points.centres, fits.points.size)
        permutations = [fits.permutation(element, tolerance) for element in elements]
        chosen = [i for i, permutation in enumerate(permutations) if permutation]  # the identity
        closes = len(chosen) == len(elements)
        if closes and (product_table(elements, permutations) >= 0).all():
            break
    group = SymmetryGroup(mechanism, tuple(elements), tuple(permutations), tolerance, readings)
    return group.part(sorted(chosen, key=lambda i: place_of(elements[i])))
