"""An instrument of one's own: what it reads of the platform's pose, as a condition.

What pincal knows of an instrument is its columns, its unknowns and its condition

        e = h(T_frame_platform; p) − m = 0

with derivatives; the place of the base in the frame of the measurements, weights, gauge, forecast
and statistics follow as for everything else that is measured.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from pincal.errors import MeasurementError
from pincal.model.parameter import Parameter

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Condition:
    """What an instrument demands at N poses: one row for each of its r columns."""

    value: Array
    """Predicted less measured, shape (N, r), in the columns' units; angles within ±π."""
    by_pose: Array
    """By the twist of the platform at its origin, linear first, in the axes of the frame of the
    measurements, shape (N, r, 6)."""
    by_parameter: Array
    """By the instrument's own parameters, shape (N, r, p)."""


@runtime_checkable
class Instrument(Protocol):
    """Anything that reads the platform's pose, in its own columns and with its own unknowns.

    One that says where it stands is drawn there by a view of the result: by a method
    ``stand(values)`` that returns T_frame_instrument, shape (4, 4), at values of its parameters. A
    camera, which looks along z, may have ``sees``: half width and half height of its picture at a
    distance of 1.

    Example:
        >>> import numpy as np, pincal
        >>> class Height:
        ...     name, columns = "table", {"gauge": "m"}
        ...     parameters = (pincal.Parameter("table", "z", "m", 0.0),)
        ...
        ...     def condition(self, poses, values, measured):
        ...         by_twist = np.tile([0.0, 0, 1, 0, 0, 0], (len(poses), 1, 1))
        ...         by_own = -np.ones((len(poses), 1, 1))
        ...         height = poses[:, 2, 3:]
        ...         return pincal.Condition(height - values[0] - measured, by_twist, by_own)
        >>> isinstance(Height(), pincal.Instrument)
        True
    """

    @property
    def name(self) -> str:
        """Its name, which owns its parameters: ``gauge_1``."""

    @property
    def columns(self) -> Mapping[str, str]:
        """Its columns in the measurements, and their units: m or rad."""

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Its unknowns; the search starts at their nominal values."""

    def condition(self, poses: Array, values: Array, measured: Array) -> Condition:
        """Return what it demands.

        Args:
            poses: T_frame_platform, in the frame of the measurements, shape (N, 4, 4).
            values: Of its parameters, shape (p,).
            measured: What it read, shape (N, r); NaN where it did not.
        """


def checked(condition: Condition, one: Instrument, count: int) -> Condition:
    """Return a condition of N poses that has the shapes it should have.

    Raises:
        MeasurementError: another shape, or something else than a condition.
    """
    r, p = len(one.columns), len(one.parameters)
    if not isinstance(condition, Condition):
        raise MeasurementError(
            f"instrument {one.name!r} gave {type(condition).__name__}; expected a pincal.Condition"
        )
    for name, shape in (
        ("value", (count, r)),
        ("by_pose", (count, r, 6)),
        ("by_parameter", (count, r, p)),
    ):
        if (given := np.shape(getattr(condition, name))) != shape:
            raise MeasurementError(
                f"{name} of instrument {one.name!r} has shape {given}; expected {shape}"
            )
    return condition
