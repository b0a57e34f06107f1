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
from pincal.symmetry.candidates import NEARLY
from pincal.symmetry.elements import Element
from pincal.symmetry.groups import (
    distinct,
    exact,
    generators,
    group_name,
    largest_closed,
    place_of,
    product_table,
    subgroups,
)
from pincal.symmetry.shapes import Fits, Permutation
from pincal.types import Array, Index


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
        return breaks_of(self.mechanism, self.elements, self.tolerance, self.readings)

    @cached_property
    def name(self) -> str:
        """Name of the group: D_2n with its order 2n, C_n of rotations only, or Schoenflies'."""
        return group_name(self.elements)

    @cached_property
    def table(self) -> Index:
        """Index of each product, shape (n, n): first the column's element, then the row's."""
        return product_table(self.elements)

    @property
    def generators(self) -> tuple[Element, ...]:
        """Elements whose products are all of the group; none for the identity alone."""
        return tuple(self.elements[i] for i in generators(self.table))

    def subgroups(self) -> tuple[SymmetryGroup, ...]:
        """Return all subgroups, the largest first.

        The index of one is the number of elements over the number of its own.
        """
        return tuple(self.part(sorted(indices)) for indices in reversed(subgroups(self.table)))

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
        carrier_by_leg: dict[int, Element] = {}
        for element, permutation in zip(self.elements, self.permutations, strict=True):
            carrier_by_leg.setdefault(permutation[first], element)
        for index, name in enumerate(names):
            if leg is None and index not in carrier_by_leg:
                broken = "; ".join(no_symmetries(self.breaks))
                raise SymmetryError(
                    f"no symmetry of {self.mechanism.name!r} carries leg 1 onto {name}"
                    f"{broken and f' ({broken})'}. "
                    "Choose poses for each leg on its own (--protocol independent)"
                )
        return tuple(carrier_by_leg[index] for index in sorted(carrier_by_leg))

    def orbit(self, poses: Poses) -> Array:
        """Return the poses onto which each pose is carried, shape (n_elements, N, dof).

        A pose that an element leaves where it is appears as often as that.
        """
        platform = self.mechanism.platform
        return np.stack([element.poses(platform, poses) for element in self.elements])

    def equivariance(self, poses: Poses) -> float:
        """Return the largest |reading of a carried leg at carried poses − reading| (Eq. 5).

        The identity carries nothing; readings need not follow from poses then.

        Args:
            poses: N poses that the mechanism reaches.
        """
        platform = self.mechanism.platform
        if len(self.elements) == 1:
            return 0.0
        before = inverse(self.mechanism, poses).readings
        columns, worst = self.mechanism.reading_columns, 0.0
        for element, permutation in zip(self.elements, self.permutations, strict=True):
            after = inverse(self.mechanism, element.poses(platform, poses)).readings
            order = np.concatenate([np.r_[columns[index]] for index in permutation])
            worst = max(worst, float(np.abs(after[:, order] - before).max()))
        return worst

    def __repr__(self) -> str:
        """Return the group in a line."""
        count = len(self.elements)
        return f"SymmetryGroup: {self.name} of {self.mechanism.name}, {count} element(s)"

    def __str__(self) -> str:
        """Return a page: the elements, and what breaks the others."""
        lines = [f"{self.name}: {', '.join(str(e) for e in self.elements)}"]
        return "\n".join(
            lines + [f"  no symmetry: {sentence}" for sentence in no_symmetries(self.breaks)]
        )


__all__ = ["NearestGroup", "SymmetryGroup", "nearest_group", "symmetry_group"]


@dataclass(frozen=True)
class NearestGroup:
    """The group that a mechanism would have if it were as symmetric as its leg points suggest."""

    group: SymmetryGroup
    """Nearest exact isometries, and where they carry the legs."""
    displacement: float
    """Largest displacement of any leg point from where its image is, [m]."""
    turn: float
    """Largest angle of any joint's axes from those of its image, [rad]."""
    each: tuple[tuple[float, float], ...]
    """The same of each element, [m] and [rad]."""


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
    fits = Fits(mechanism, readings)
    permuted = {e: fits.permutation(e, tolerance) for e in fits.points.candidates}
    elements = [element for element, permutation in permuted.items() if permutation]
    permutations = [permuted[element] for element in elements]
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


def nearest_group(mechanism: GivenMechanism) -> NearestGroup:
    """Return the largest group that a mechanism nearly has, and how far it is from having it.

    Nearly means that leg points are within a tenth of how far they are apart, and that legs bend
    and are driven alike.
    """
    mechanism = as_mechanism(mechanism)
    group = _group(mechanism, NEARLY, False)
    fits = Fits(mechanism, False)
    deviations = [
        fits.measured(e, p) for e, p in zip(group.elements, group.permutations, strict=True)
    ]
    return NearestGroup(
        group, max(m for m, _ in deviations), max(r for _, r in deviations), tuple(deviations)
    )
