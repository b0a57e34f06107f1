"""Where parameters, readings and residuals of several legs stand when they are stacked."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pincal.identification.residuals import LegResidual
from pincal.kinematics.derivatives import Demand
from pincal.model.leg import Leg

Array = NDArray[np.float64]


def leg_rows(residuals: Sequence[LegResidual]) -> list[slice]:
    """Return the residuals of each leg among those of all at a pose."""
    ends = np.cumsum([one.width for one in residuals]).tolist()
    return [slice(end - one.width, end) for one, end in zip(residuals, ends, strict=True)]


def leg_readings(legs: Sequence[Leg]) -> list[slice]:
    """Return the readings of each leg among those of some legs."""
    ends = np.cumsum([len(leg.sensors) for leg in legs]).tolist()
    return [slice(end - len(leg.sensors), end) for leg, end in zip(legs, ends, strict=True)]


def by_readings(demand: Demand, sigma: Array) -> Array:
    """Return the covariance of a leg's residuals by its readings' noise, shape (N, k, k).

    Args:
        demand: What the leg demands.
        sigma: Standard deviations of its readings, shape (N, n_active).
    """
    D = demand.reading * sigma[:, None, :]
    return D @ D.transpose(0, 2, 1)


def leg_columns(legs: Sequence[Leg]) -> list[slice]:
    """Return the parameters of each leg among those of all."""
    ends = np.cumsum([len(leg.parameters) for leg in legs])
    return [slice(int(e) - len(g.parameters), int(e)) for e, g in zip(ends, legs, strict=True)]


def joined_units(leg: Leg) -> str:
    """Return the unit of a leg's readings: m, rad, or both."""
    return " or ".join(dict.fromkeys(leg.reading_units))
