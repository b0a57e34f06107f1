"""A symmetry group: its elements, where they carry legs and poses, products and subgroups."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pincal.errors import SymmetryError
from pincal.kinematics.inverse import inverse
from pincal.model.mechanism import Mechanism
from pincal.model.platform import Poses
from pincal.symmetry.breaks import Break, breaks_of, no_symmetries
from pincal.symmetry.elements import Element
from pincal.symmetry.fits import Permutation
from pincal.symmetry.groups import generators, group_name, product_table, subgroups

Array = NDArray[np.float64]


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
    def table(self) -> NDArray[np.intp]:
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
        return tuple(self.part(sorted(one)) for one in reversed(subgroups(self.table)))

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
        found: dict[int, Element] = {}
        for element, permutation in zip(self.elements, self.permutations, strict=True):
            found.setdefault(permutation[first], element)
        for index, name in enumerate(names):
            if leg is None and index not in found:
                broken = "; ".join(no_symmetries(self.breaks))
                raise SymmetryError(
                    f"no symmetry of {self.mechanism.name!r} carries leg 1 onto {name}"
                    f"{broken and f' ({broken})'}. "
                    "Choose poses for each leg on its own (--independent)"
                )
        return tuple(found[index] for index in sorted(found))

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
        return "\n".join(lines + [f"  no symmetry: {one}" for one in no_symmetries(self.breaks)])
