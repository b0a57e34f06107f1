"""By how much machines differ from their drawings: the scale of plausible changes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pincal.kinematics.legs.closure import largest_size
from pincal.model.leg import Leg
from pincal.model.mechanism import Mechanism

Array = NDArray[np.float64]
DIFFER = 0.05
"""Of a mechanism's size, of a gain, and [rad]: by more no machine differs from its drawing."""


def plausible_changes(mechanism: Mechanism, legs: Sequence[Leg] | None = None) -> Array:
    """Return by how much parameters of legs may differ from their drawing, shape (n_params,).

    In the parameters' order and units; of all legs if none are given.
    """
    size = largest_size(mechanism.legs)
    return np.concatenate([changes_of(leg, size) for leg in legs or mechanism.legs])


def nearest_to_nominal(mechanism: Mechanism, directions: Array) -> Array:
    """Return what moves parameters along directions to those nearest to nominal, shape (n, n).

    Each change is measured by how much machines differ: P = I − G (W G)⁺ W, W = 1 / these.

    Args:
        mechanism: The mechanism.
        directions: Of the parameters of all legs, columns G of shape (n, k).
    """
    scales = plausible_changes(mechanism)
    amounts = np.linalg.pinv(directions / scales[:, None]) / scales
    return np.asarray(np.eye(len(scales)) - directions @ amounts)


def changes_of(leg: Leg, size: float) -> Array:
    """Return by how much a leg's parameters may differ, shape (n_params,).

    Lengths by a share of ``size``, gains of themselves, angles of a radian, numbers of 1.
    """
    scales = {name: size if leg.units[name] == "m" else 1.0 for name, _ in leg.parameters}
    gains = {sensor.gain for sensor in leg.sensors}
    scales |= {name: abs(value) or 1.0 for name, value in leg.parameters if name in gains}
    return DIFFER * np.array(list(scales.values()))
