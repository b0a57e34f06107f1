"""How well an instrument measures: a tracker's range and angles, and what is off in all rows."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from math import hypot

import numpy as np
from numpy.typing import NDArray

from pincal.errors import MeasurementError
from pincal.model.checks import array_of, number_of

Array = NDArray[np.float64]
POLAR = {"range": "m", "azimuth": "rad", "elevation": "rad"}
"""What a tracker measures, and the units; ``sigma_range`` is a column of its noise."""
STEEL = 11.5e-6
"""Thermal expansion of steel, [1/K]."""


@dataclass(frozen=True)
class Tracker:
    """An instrument that measures positions by a range and two angles."""

    at: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Where its axes meet, in the frame of the measurements, [m]; azimuth is about z."""
    range: float = 0.0
    """Standard deviation of the range, [m], of rows without a column of it."""
    azimuth: float = 0.0
    """Of the azimuth, [rad]."""
    elevation: float = 0.0
    """Of the elevation, [rad]."""

    def __post_init__(self) -> None:
        at = array_of(self.at, (3,), "place of the tracker", MeasurementError)
        object.__setattr__(self, "at", tuple(at.tolist()))
        _check_sizes(self, tuple(POLAR), "noise of the tracker's")

    @property
    def has_noise(self) -> bool:
        """Whether it has noise without columns of it."""
        return any((self.range, self.azimuth, self.elevation))

    def by_polar(self, points: Array) -> Array:
        """Return how points move by range [1], azimuth and elevation [m/rad], shape (N, 3, 3).

        Args:
            points: Positions in the frame of the measurements, shape (N, 3), [m].
        """
        x, y, z = ray = (points - self.at).T
        level = np.hypot(x, y)
        length = np.hypot(level, z)
        away = np.where(level > 0.0, level, 1.0)
        c, s = np.where(level > 0.0, x / away, 1.0), np.where(level > 0.0, y / away, 0.0)
        along = np.where(length > 0.0, ray / np.where(length > 0.0, length, 1.0), 0.0)
        return np.stack(
            (along.T, np.column_stack((-y, x, 0 * z)), np.column_stack((-z * c, -z * s, level))),
            axis=2,
        )


@dataclass(frozen=True)
class Systematic:
    """Standard uncertainties of what is off by the same in all rows (type B, GUM 4.3).

    More rows do not make them smaller: they are taken into what is promised, not into weights.

    Example:
        >>> import pincal
        >>> warm = pincal.Systematic(scale=2e-6, temperature=1.0)  # a tracker's scale; 1 K
        >>> pincal.Setup(systematic=warm).systematic.expansion  # steel
        1.15e-05
    """

    scale: float = 0.0
    """Of measured lengths, relative: 20e-6 for 20 µm/m."""
    temperature: float = 0.0
    """Of the machine against that at which it is to be right, [K]."""
    expansion: float = STEEL
    """Thermal expansion of the machine, [1/K]."""
    target: float = 0.0
    """Of the offset of each target that is taken as known, along each axis, [m]."""

    def __post_init__(self) -> None:
        _check_sizes(self, tuple(vars(self)), "systematic uncertainty, its")

    @property
    def relative(self) -> float:
        """Standard uncertainty of all lengths together, relative."""
        return hypot(self.scale, self.temperature * self.expansion)


def _check_sizes(one: object, names: Iterable[str], what: str) -> None:
    """Make fields numbers of 0 or more.

    Raises:
        MeasurementError: something else.
    """
    for name in names:
        value = number_of(getattr(one, name), f"the {what} {name}", MeasurementError)
        object.__setattr__(one, name, value)
        if not 0.0 <= value < np.inf:
            raise MeasurementError(f"the {what} {name} is {value:g}; expected 0 or more")
