"""A sensor is the linear law between an active joint and its reading: gain, offset, direction."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Sensor:
    """Linear sensor on an active joint, in one of the two forms of the papers.

    With joint coordinate q (taken from ``zero``), direction d = ±1, gain k and offset γ:

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
    zero: float = 0.0
    """Joint position from which q counts, [rad] or [m]."""

    def constants(self, parameters: Mapping[str, float]) -> tuple[float, float]:
        """Return d k and γ at the given parameter values."""
        gain = parameters[self.gain] if isinstance(self.gain, str) else self.gain
        offset = parameters[self.offset] if isinstance(self.offset, str) else self.offset
        return self.direction * gain, offset

    def reading(self, joint: Array, parameters: Mapping[str, float]) -> Array:
        """Return the readings ψ of joint positions, same shape, [rad] or [m]."""
        gain, offset = self.constants(parameters)
        if self.form == "joint":
            return (joint - self.zero - offset) / gain
        return gain * (joint - self.zero) + offset

    def position(self, reading: Array, parameters: Mapping[str, float]) -> Array:
        """Return the joint positions of readings ψ, same shape, [rad] or [m]."""
        gain, offset = self.constants(parameters)
        if self.form == "joint":
            return gain * reading + offset + self.zero
        return (reading - offset) / gain + self.zero

    def derivatives(
        self, reading: Array, parameters: Mapping[str, float]
    ) -> tuple[float, Array, float]:
        """Return ∂q/∂ψ, ∂q/∂k (shape of the readings) and ∂q/∂γ at given readings."""
        gain, offset = self.constants(parameters)
        if self.form == "joint":
            return gain, self.direction * reading, 1.0
        return 1.0 / gain, -self.direction * (reading - offset) / gain**2, -1.0 / gain
