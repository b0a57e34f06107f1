"""By how much machines differ from their drawings: the scale of plausible changes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pincal.kinematics.closure import largest_size
from pincal.model.leg import Leg
from pincal.model.mechanism import Mechanism

Array = NDArray[np.float64]
DIFFER = 0.05
"""Of a mechanism's size, [rad] and [1]: by more no machine differs from its drawing."""


def plausible_changes(mechanism: Mechanism, legs: Sequence[Leg] | None = None) -> Array:
    """Return by how much parameters of legs may differ from their drawing, shape (n_params,).

    In the parameters' order and units; of all legs if none are given.
    """
    size = largest_size(mechanism.legs, mechanism.platform)
    return np.concatenate([changes_of(leg, size) for leg in legs or mechanism.legs])


def changes_of(leg: Leg, size: float) -> Array:
    """Return by how much a leg's parameters may differ, shape (n_params,); lengths of ``size``."""
    units = [leg.units[name] for name in leg.parameter_names]
    return DIFFER * np.array([size if unit == "m" else 1.0 for unit in units])
