"""A sensor is the linear law between an active joint and its reading: gain, offset, direction."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SensorLaw:
    """Active joints' positions of readings at some parameter values: q = slope ψ + start."""

    slope: Array
    """∂q/∂ψ, shape (n_active,), [1]."""
    start: Array
    """Joint positions at which readings are zero, shape (n_active,), [rad] or [m]."""
    slope_by_parameter: Array
    """∂slope/∂φ, shape (n_active, n_params)."""
    start_by_parameter: Array
    """∂start/∂φ, shape (n_active, n_params)."""

    def reading(self, joints: Array) -> Array:
        """Return the readings ψ of active joints' positions, shape (N, n_active), [rad] or [m]."""
        return (joints - self.start) / self.slope

    def position(self, readings: Array) -> Array:
        """Return the active joints' positions of readings ψ, shape (N, n_active)."""
        return self.slope * readings + self.start

    def by_parameter(self, readings: Array) -> Array:
        """Return ∂q/∂φ at given readings, shape (N, n_active) to (N, n_active, n_params)."""
        return readings[:, :, None] * self.slope_by_parameter + self.start_by_parameter


@dataclass(frozen=True)
class Sensor:
    """Linear sensor on an active joint, in one of the two forms of the papers.

    With joint coordinate q (counted from ``zero``), direction d = ±1, gain k and offset γ:

    - form ``"joint"``:   q = d k ψ + γ, ψ the reading (3-RRR paper, Eq. 6)
    - form ``"reading"``: ψ = d k q + γ, ψ the reading (5R paper, Eq. 9)
    """

    joint: str
    """Name of the active joint."""
    form: Literal["joint", "reading"] = "joint"
    gain: str | float = 1.0
    """Gain's parameter name, or a constant [1]."""
    offset: str | float = 0.0
    """Offset's parameter name, or a constant [rad] or [m]."""
    direction: int = 1
    zero: float | Literal["home"] = 0.0
    """Joint position from which q counts, [rad] or [m]; ``"home"``: the joint's position at the
    platform's home pose, whatever the parameters, as on machines that are zeroed there."""

    @property
    def homed(self) -> bool:
        """Whether the reading counts from the platform's home pose."""
        return self.zero == "home"

    def constants(self, parameters: Mapping[str, float]) -> tuple[float, float]:
        """Return d k and γ at the given parameter values."""
        gain = parameters[self.gain] if isinstance(self.gain, str) else self.gain
        offset = parameters[self.offset] if isinstance(self.offset, str) else self.offset
        return self.direction * gain, offset

    def law(self, parameters: Mapping[str, float]) -> tuple[float, float, Array, Array]:
        """Return slope and start of q = slope ψ + start, and their derivatives by parameters.

        Args:
            parameters: Values of the leg's parameters by name, in order.
        """
        gain, offset = self.constants(parameters)
        by_gain = np.array([float(name == self.gain) for name in parameters])
        by_offset = np.array([float(name == self.offset) for name in parameters])
        if self.form == "joint":
            slope, start = gain, offset
            slopes, starts = self.direction * by_gain, by_offset
        else:
            slope, start = 1.0 / gain, -offset / gain
            slopes = -self.direction * slope**2 * by_gain
            starts = -slope * by_offset + offset * self.direction * slope**2 * by_gain
        return slope, start, slopes, starts


def sensor_laws(
    sensors: Sequence[Sensor],
    parameters: Mapping[str, float],
    home: Array,
    home_by_parameter: Array,
) -> SensorLaw:
    """Return the law of a leg's sensors at parameter values.

    Args:
        sensors: The sensors.
        parameters: Values of the leg's parameters by name, in order.
        home: The active joints' positions at the platform's home pose, shape (n_active,).
        home_by_parameter: Their derivatives, shape (n_active, n_params).
    """
    slope, start, slopes, starts = map(
        np.array, zip(*(sensor.law(parameters) for sensor in sensors), strict=True)
    )
    homed = np.array([sensor.homed for sensor in sensors])
    zeros = np.array([0.0 if isinstance(one.zero, str) else one.zero for one in sensors])
    return SensorLaw(
        slope,
        start + np.where(homed, home, zeros),
        slopes,
        starts + np.where(homed[:, None], home_by_parameter, 0.0),
    )
