"""What reads the platform's pose: the seam for instruments of one's own, and the tracker."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol, TypeAlias, runtime_checkable

import numpy as np

from pincal.errors import MeasurementError
from pincal.model.checks import check_sizes, set_point
from pincal.model.parameter import Parameter
from pincal.types import Array

Residuals: TypeAlias = tuple[Array, Array, Array]


@runtime_checkable
class Instrument(Protocol):
    """Anything that reads the platform's pose, in its own columns and with its own unknowns.

    Further, if it has them: ``priors``, standard deviations of nominal values by id; ``shared``,
    owners of parameters that other instruments have, too;
    ``begin(poses, measured, known)``, values from which a search begins, at poses of the nominal
    machine and values by id that others share; ``visible(poses, values)``, which columns it could
    measure at poses, shape (N, r), for plans and simulations; ``metres_per_pixel(poses, values)``,
    what one of its pixels is at what it sees, shape (N, r), [m/px]; ``marks``, columns of right and
    down by the names of points, which tables of corners fill.

    Example:
        >>> import numpy as np, pincal
        >>> class Height:
        ...     name, columns = "table", {"gauge": "m"}
        ...     parameters = (pincal.Parameter("table", "z", "m", 0.0),)
        ...
        ...     def evaluate(self, poses, values, measured):
        ...         by_twist = np.tile([0.0, 0, 1, 0, 0, 0], (len(poses), 1, 1))
        ...         by_own = -np.ones((len(poses), 1, 1))
        ...         height = poses[:, 2, 3:]
        ...         return height - values[0] - measured, by_twist, by_own
        >>> isinstance(Height(), pincal.Instrument)
        True
    """

    @property
    def name(self) -> str:
        """Its name, which owns its parameters: ``gauge_1``."""

    @property
    def columns(self) -> Mapping[str, str]:
        """Its columns in the measurements, and their units: m, rad or px."""

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Its unknowns; the search starts at their nominal values."""

    def evaluate(self, poses: Array, values: Array, measured: Array) -> Residuals:
        """Return its residuals, their derivatives by the pose, and those by its own parameters.

        Residuals are predicted less measured, in the columns' units, angles within ±π, shape
        (N, r). The pose is the twist of the platform at its origin, linear first, in the axes of
        the frame of the measurements: shape (N, r, 6). Parameters: shape (N, r, p).

        Args:
            poses: T_frame_platform, in the frame of the measurements, shape (N, 4, 4).
            values: Of its parameters, shape (p,).
            measured: What it read, shape (N, r); NaN where it did not.
        """


def evaluated(instrument: Instrument, poses: Array, values: Array, measured: Array) -> Residuals:
    """Return what an instrument evaluates, its shapes checked: see ``Instrument.evaluate``."""
    arrays = instrument.evaluate(poses, values, measured)
    rows = (len(poses), len(instrument.columns))
    shapes = (rows, (*rows, 6), (*rows, len(instrument.parameters)))
    shown = tuple(map(np.shape, arrays)) if isinstance(arrays, tuple) else type(arrays).__name__
    if shown != shapes:
        raise MeasurementError(
            f"evaluate of instrument {instrument.name!r} gave {shown}; expected residuals, and "
            "their derivatives by the platform's twist and by its parameters, of the shapes "
            f"{', '.join(map(str, shapes))}"
        )
    return arrays


def fault_of(instrument: Instrument, names: set[str]) -> str:
    """Return what is wrong with an instrument beside others with names; empty if nothing is."""
    name = instrument.name
    if name in names or not name.isidentifier():
        return (
            f"an instrument is named {name!r}; expected a word that no target and no other "
            "instrument has"
        )
    for column, unit in instrument.columns.items():
        if unit not in ("m", "rad", "px"):
            return f"column {column!r} of instrument {name!r} is in {unit!r}; expected m, rad or px"
    for parameter in instrument.parameters:
        if parameter.owner not in (name, *getattr(instrument, "shared", ())):
            return (
                f"parameter {parameter.id!r} is of instrument {name!r}; expected "
                f"'{name}.{parameter.name}'"
            )
    return ""


POLAR = ("range", "azimuth", "elevation")
"""What a tracker measures."""


@dataclass(frozen=True)
class Tracker:
    """An instrument that measures positions by a range and two angles."""

    at: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Where its axes meet, in the frame of the measurements, [m]; azimuth is about z."""
    range: float = 0.0
    """Standard deviation of the range, [m]."""
    azimuth: float = 0.0
    """Of the azimuth, [rad]."""
    elevation: float = 0.0
    """Of the elevation, [rad]."""

    def __post_init__(self) -> None:
        set_point(self, "at", "place of the tracker", MeasurementError)
        check_sizes(self, POLAR, "noise of the tracker's", MeasurementError)

    def by_polar(self, points: Array) -> Array:
        """Return how points move by range [1], azimuth and elevation [m/rad], shape (N, 3, 3).

        Points are positions in the frame of the measurements, shape (N, 3), [m].
        """
        x, y, z = ray = (points - self.at).T
        azimuth, level = np.arctan2(y, x), np.hypot(x, y)
        c, s = np.cos(azimuth), np.sin(azimuth)
        length = np.hypot(level, z)
        along = ray / np.where(length > 0.0, length, 1.0)
        turned = np.column_stack((-y, x, 0 * z))
        raised = np.column_stack((-z * c, -z * s, level))
        return np.stack((along.T, turned, raised), axis=2)
