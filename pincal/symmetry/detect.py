"""The symmetry group of a mechanism, detected from geometry, limits, working modes, sensors.

Elements that carry leg points onto leg points are candidates, wherever base and platform frames
are. Those that carry every leg onto a leg within a tolerance are looked at together: the group is
the largest closed subset of them, with isometries that are exact, and each of its elements
is measured again with these.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

from pincal.errors import SymmetryError
from pincal.files.given_mechanism import GivenMechanism, as_mechanism
from pincal.model.checks import number_of
from pincal.model.mechanism import Mechanism
from pincal.symmetry.fits import NEARLY, Fits, suggested
from pincal.symmetry.group import SymmetryGroup
from pincal.symmetry.groups import distinct, exact, largest_closed, place_of, product_table

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
    left = [(e, p) for e in suggested(mechanism) if (p := fits.permutation(e, tolerance))]
    left = [left[i] for i in distinct([e for e, _ in left], [p for _, p in left])]
    while True:
        table = product_table([e for e, _ in left], [p for _, p in left])
        left = [left[i] for i in largest_closed(table)]
        elements = exact([e for e, _ in left], fits.centres, fits.points.size)
        found = [fits.permutation(element, tolerance) for element in elements]
        if all(found) and (product_table(elements, found) >= 0).all():
            break
        left = [(e, p) for e, p in zip(elements, found, strict=True) if p]  # the identity always
    order = sorted(range(len(elements)), key=lambda i: place_of(elements[i]))
    permutations = tuple(found[i] or () for i in order)
    return SymmetryGroup(
        mechanism, tuple(elements[i] for i in order), permutations, tolerance, readings
    )


def nearest_group(mechanism: GivenMechanism) -> NearestGroup:
    """Return the largest group that a mechanism nearly has, and how far it is from having it.

    Nearly means that leg points are within a tenth of how far they are apart, and that legs bend
    and are driven alike.
    """
    mechanism = as_mechanism(mechanism)
    group = _group(mechanism, NEARLY, False)
    fits = Fits(mechanism, False)
    each = [fits.measured(e, p) for e, p in zip(group.elements, group.permutations, strict=True)]
    return NearestGroup(group, max(m for m, _ in each), max(r for _, r in each), tuple(each))
