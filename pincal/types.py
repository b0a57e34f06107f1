"""Types of arrays, by what they hold, and of points; shapes are said where they are used."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]
"""Numbers."""
Mask: TypeAlias = NDArray[np.bool_]
"""Which elements count."""
Index: TypeAlias = NDArray[np.intp]
"""Places of elements."""
Point: TypeAlias = tuple[float, float, float]
"""x, y, z."""
