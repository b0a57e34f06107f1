"""What is said of a choice of poses: are legs whose poses were mapped as observable as others?"""

from __future__ import annotations

from pincal.model.checks import ALIKE


def mapped_diagonals(differ: float) -> str:
    """Return whether mapped legs are as observable as their references, parameter by parameter.

    Args:
        differ: Largest part by which |R_ii| of a leg differ from those of its reference leg.
    """
    if differ < ALIKE:
        return "|R_ii| of mapped legs are those of their reference legs (Eq. 10)"
    return (
        f"|R_ii| of mapped legs differ by up to {100 * differ:.2g} %: offsets, gains or Cartesian "
        "coordinates turn into each other. Their product, and O1, is equal but for a constant"
    )
