"""A sensor is the linear law between an active joint and its reading: gain, offset, direction."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SensorLaw:
    """Joint position of a reading at some parameter values: q = slope ψ + start."""

    slope: float
    """∂q/∂ψ, [1]."""
    start: float
    """Joint position at which the reading is zero, [rad] or [m]."""
    slope_by_parameter: Array
    """∂slope/∂φ, shape (n_params,)."""
    start_by_parameter: Array
    """∂start/∂φ, shape (n_params,)."""

    def reading(self, joint: Array) -> Array:
        """Return the readings ψ of joint positions, same shape, [rad] or [m]."""
        return (joint - self.start) / self.slope

    def position(self, reading: Array) -> Array:
        """Return the joint positions of readings ψ, same shape, [rad] or [m]."""
        return self.slope * reading + self.start

    def by_parameter(self, reading: Array) -> Array:
        """Return ∂q/∂φ at given readings, shape (N,) to (N, n_params)."""
        return reading[:, None] * self.slope_by_parameter + self.start_by_parameter


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

    def law(
        self, parameters: Mapping[str, float], zero: float, zero_by_parameter: Array
    ) -> SensorLaw:
        """Return the law at parameter values.

        Args:
            parameters: Values of the leg's parameters by name, in order.
            zero: Joint position from which q counts, [rad] or [m].
            zero_by_parameter: Its derivative, shape (n_params,).
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
        return SensorLaw(slope, start + zero, slopes, starts + zero_by_parameter)
