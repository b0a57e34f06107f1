"""Terms of sensors and parameters: known functions of what a row says, times unknown amplitudes.

What is not geometry lives in the joint's reading: q = k ψ + γ + Σ a_j b_j; and a parameter is a
joint, so it may be p + Σ a_j b_j. Each b_j is a number for each row, of its reading or of an
influence quantity beside it (temperature, time, side of approach, load), scaled so that its
amplitude is in the joint's own unit. Linear in the unknowns.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from pincal.errors import MechanismError
from pincal.model.checks import count_of, number_of
from pincal.types import Array, Point

APPROACH = "approach"
LOAD = "load"
OF_JOINTS = (APPROACH, LOAD)
"""Influences of each joint for itself, that follow from the rows where no column gives them; a
length or angle is a joint too, and has a load."""


@dataclass(frozen=True)
class Harmonic:
    """Sine or cosine of a multiple of the reading: eccentric gears, encoders, screws.

    ``order`` periods in one of the reading: a turn, or ``period`` [rad] or [m] where it is given.
    A motor geared 1 : 50 turns 50 times in one turn of the joint: order 50, 100, ….
    """

    order: float
    phase: Literal["sine", "cosine"]
    period: float = 2.0 * np.pi

    def __post_init__(self) -> None:
        _check("a harmonic's order", self.order, positive=True)
        _check("a harmonic's period", self.period, positive=True)
        if self.phase not in ("sine", "cosine"):
            raise MechanismError(f"a harmonic's phase is {self.phase!r}; expected sine or cosine")

    @property
    def rate(self) -> float:
        """Radians of the angle by one unit of the reading."""
        return 2.0 * np.pi * self.order / self.period

    def __call__(self, value: Array) -> Array:
        """Return the sine or cosine."""
        turn = self.rate * value
        return np.sin(turn) if self.phase == "sine" else np.cos(turn)

    def slope(self, value: Array) -> Array:
        """Return its derivative."""
        turn = self.rate * value
        return self.rate * (np.cos(turn) if self.phase == "sine" else -np.sin(turn))


@dataclass(frozen=True)
class Power:
    """A power of the reading over a range: what a screw or belt is off, as a polynomial.

    1 at ``centre`` + ``range``; powers 0 and 1 are offset and gain, which sensors have.

    Example:
        >>> import pincal
        >>> bend = pincal.Term("bend", pincal.Power(power=2, range=1.5))
        >>> bend.basis.power
        2
    """

    power: int
    range: float
    """[rad] or [m]."""
    centre: float = 0.0

    def __post_init__(self) -> None:
        _check("a power's range", self.range, positive=True)
        _check("a power's centre", self.centre)
        count_of(self.power, "a power", MechanismError, 2, 20)  # 0 and 1 are offset and gain

    def __call__(self, value: Array) -> Array:
        """Return the power."""
        return ((value - self.centre) / self.range) ** self.power

    def slope(self, value: Array) -> Array:
        """Return its derivative."""
        relative = (value - self.centre) / self.range
        return np.asarray(self.power / self.range * relative ** (self.power - 1))


@dataclass(frozen=True)
class Share:
    """A column's excess over a reference, in so many units: 1 at ``reference`` + ``per``.

    ``per`` may be negative, as for a coordinate that is: all lengths of a leg that grow by one
    share a of them have terms with the amplitude a, each by ``per`` over its length.

    Example:
        >>> import pincal
        >>> warm = pincal.Term("grows", pincal.Share(per=10.0, reference=20.0), of="temperature")
        >>> warm.of
        'temperature'
    """

    per: float = 1.0
    reference: float = 0.0

    def __post_init__(self) -> None:
        _check("an influence's reference", self.reference)
        _check("an influence's share ('per')", self.per)
        if self.per == 0.0:
            raise MechanismError(
                "an influence's share ('per') is 0; expected a number other than 0"
            )

    def __call__(self, value: Array) -> Array:
        """Return the share."""
        return (value - self.reference) / self.per

    def slope(self, value: Array) -> Array:
        """Return its derivative."""
        return np.full_like(value, 1.0 / self.per)


def _check(name: str, value: float, *, positive: bool = False) -> None:
    """Raise unless a number is finite, and above 0 if it has to be."""
    if not abs(number_of(value, name, MechanismError)) < np.inf or (positive and value <= 0.0):
        expected = "a number above 0" if positive else "a finite number"
        raise MechanismError(f"{name} is {value!r}; expected {expected}")


@dataclass(frozen=True)
class Term:
    """A known function b of a row times an unknown amplitude a: a b, added to a joint's position.

    Such as the sine of a geared motor's angle, or the sag of a spool. By the reading, its slope
    must be so small that q(ψ) remains monotonic. Of a leg's parameter (``Leg.terms``) it is added
    to that: a link that grows with temperature, or stretches under its load.
    """

    parameter: str
    """Name of the amplitude a, a parameter of the leg."""
    basis: Callable[[Array], Array]
    """b by the reading ψ [rad] or [m], or by the influence, of the same shape."""
    slope: Callable[[Array], Array] | None = None
    """db/dψ, likewise; that of the basis, ``basis.slope``, if not given."""
    unit: str = ""
    """Of the amplitude: that of q over that of b; that of q, or of the parameter, if not given."""
    of: str = ""
    """Influence quantity on which b depends, a column of the measurements: ``"temperature"``,
    ``"time"``, any other; ``"approach"`` and ``"load"`` of this sensor's own joint, ``"load"`` of
    this parameter. The reading if empty."""

    def __post_init__(self) -> None:
        if self.slope is None and not callable(getattr(self.basis, "slope", None)):
            raise MechanismError(
                f"term {self.parameter!r} has no slope; give db/dψ as Term(…, slope=…), or a basis "
                "with a method slope"
            )

    @property
    def slope_of(self) -> Callable[[Array], Array]:
        """db/dψ."""
        basis: Any = self.basis
        slope: Callable[[Array], Array] = self.slope or basis.slope
        return slope

    def column(self, owner: str) -> str:
        """Return the influence's column, of the reading or parameter that has the term, or ""."""
        return f"{self.of}_{owner}" if self.of in OF_JOINTS else self.of

    @property
    def has_form(self) -> bool:
        """Whether a folder can hold it: one of the forms above, no function of one's own."""
        return self.slope is None and isinstance(self.basis, Harmonic | Power | Share)


@dataclass(frozen=True)
class Cables:
    """Limits between which the tension of every cable stays: cables only pull.

    Example:
        >>> import pincal
        >>> pincal.Cables(least=5.0, most=500.0)
        Cables(least=5.0, most=500.0)
    """

    least: float = 0.0
    """[N]."""
    most: float = np.inf
    """[N]."""

    def __post_init__(self) -> None:
        if not 0.0 <= self.least < self.most:
            raise MechanismError(
                f"tensions of cables are between {self.least!r} and {self.most!r}; expected a "
                "least of 0 or more, and a most above it [N]"
            )


@dataclass(frozen=True)
class Load:
    """The weight of platform and payload, on which terms may depend (``of="load"``).

    Example:
        >>> import pincal
        >>> tool = pincal.Load(mass=2.5, centre=(0.0, 0.0, -0.05))
        >>> tool.gravity
        (0.0, 0.0, -9.81)
    """

    mass: float = 0.0
    """Of platform and payload, [kg]."""
    centre: Point = (0.0, 0.0, 0.0)
    """Of that mass, in the platform's frame, [m]."""
    gravity: Point = (0.0, 0.0, -9.81)
    """Acceleration in the base's frame, [m/s²]."""
    drawn: tuple[tuple[str, float], ...] = ()
    """Parameters of the machine whose loads these are, by id: those of the drawing, so that loads
    of a row are the same before and after calibration. The mechanism's own if empty."""
    assumed: bool = False
    """Whether it stands for a weight that nobody said, to which amplitudes are in proportion."""

    def __post_init__(self) -> None:
        if not 0.0 <= self.mass < np.inf:
            raise MechanismError(f"the load's mass is {self.mass!r}; expected 0 or more [kg]")
        for name in ("centre", "gravity"):
            if len(values := getattr(self, name)) != 3 or not np.isfinite(values).all():
                raise MechanismError(f"the load's {name} is {values!r}; expected three numbers")
