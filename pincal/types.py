"""Types of arrays and points; docstrings state the shapes where arrays are used."""

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]
"""Array of numbers."""
Mask: TypeAlias = NDArray[np.bool_]
"""Array that selects elements by True."""
Index: TypeAlias = NDArray[np.intp]
"""Array of indices of elements."""
Point: TypeAlias = tuple[float, float, float]
"""Coordinates x, y, z."""


class Quantity(float):
    """A number in SI that knows the dimension of the unit with which it was typed."""

    dimension = ""
    """``"m"``, ``"rad"``, … as the keys of units; empty without a unit."""
