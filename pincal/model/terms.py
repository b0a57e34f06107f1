"""Terms of sensors and parameters: known functions of a row's columns times unknown amplitudes.

Errors beyond the geometry are modelled in the joint's reading: q = k ψ + γ + Σ a_j b_j; and since
a parameter is a joint, it may be p + Σ a_j b_j. Each b_j is a function of the row's reading or of
an influence quantity (temperature, time, side of approach, load), scaled so that its amplitude is
in the joint's own unit. The model is linear in the unknowns.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from pincal.errors import MechanismError
from pincal.model.checks import array_of, check_kinds, check_sizes, count_of, number_of, set_point
from pincal.types import Array, Point

APPROACH, LOAD = "approach", "load"
OF_JOINTS = (APPROACH, LOAD)
"""Influences that each joint has for itself, computed from the rows where no column gives them; a
length or angle is a joint too, and has a load."""


@dataclass(frozen=True)
class Harmonic:
    """Sine or cosine of a multiple of the reading, as of eccentric gears, encoders and screws.

    It has ``order`` periods in each ``period`` [rad] or [m] of the reading, by default a turn. A
    motor geared 1 : 50 turns 50 times in one turn of the joint: order 50, 100, ….
    """

    order: float
    phase: Literal["sine", "cosine"]
    period: float = 2.0 * np.pi

    def __post_init__(self) -> None:
        _check("a harmonic's order", self.order, positive=True)
        _check("a harmonic's period", self.period, positive=True)
        check_kinds(vars(self), Harmonic, MechanismError)

    @property
    def rate(self) -> float:
        """Derivative of the harmonic's angle by the reading, [rad/rad] or [rad/m]."""
        return 2.0 * np.pi * self.order / self.period

    def __call__(self, value: Array) -> Array:
        """Return the sine or cosine at readings, of the same shape."""
        turn = self.rate * value
        return np.sin(turn) if self.phase == "sine" else np.cos(turn)

    def slope(self, value: Array) -> Array:
        """Return its derivative."""
        turn = self.rate * value
        return self.rate * (np.cos(turn) if self.phase == "sine" else -np.sin(turn))


@dataclass(frozen=True)
class Power:
    """Power of the reading over a range, as for the error of a screw or belt as a polynomial.

    It is 1 at ``centre`` + ``range``. Powers 0 and 1 are the sensor's offset and gain.

    Example:
        >>> import pincal
        >>> bend = pincal.Term("bend", pincal.Power(power=2, range=1.5))
        >>> bend.basis.power
        2
    """

    power: int
    range: float
    """Distance of the reading from the centre at which the power is 1, [rad] or [m]."""
    centre: float = 0.0

    def __post_init__(self) -> None:
        _check("a power's range", self.range, positive=True)
        _check("a power's centre", self.centre)
        count_of(self.power, "a power", MechanismError, 2, 20)  # 0 and 1 are offset and gain

    def __call__(self, value: Array) -> Array:
        """Return the power at readings, of the same shape."""
        return ((value - self.centre) / self.range) ** self.power

    def slope(self, value: Array) -> Array:
        """Return its derivative."""
        relative = (value - self.centre) / self.range
        return np.asarray(self.power / self.range * relative ** (self.power - 1))


@dataclass(frozen=True)
class Share:
    """A column's excess over a reference, divided by ``per``: 1 at ``reference`` + ``per``.

    If all lengths of a leg grow by the same relative amount, their terms share one amplitude, each
    with ``per`` divided by its length; ``per`` is negative for a negative coordinate.

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
        """Return the share at values of the column, of the same shape."""
        return (value - self.reference) / self.per

    def slope(self, value: Array) -> Array:
        """Return its derivative."""
        return np.full_like(value, 1.0 / self.per)


def _check(name: str, value: float, *, positive: bool = False) -> None:
    """Raise MechanismError unless a number is finite, and above 0 if ``positive``."""
    if not abs(number_of(value, name, MechanismError)) < np.inf or (positive and value <= 0.0):
        expected = "a number above 0" if positive else "a finite number"
        raise MechanismError(f"{name} is {value!r}; expected {expected}")


@dataclass(frozen=True)
class Term:
    """Known function b times an unknown amplitude a; the product is added to a joint's position.

    Examples are the sine of a geared motor's angle and the sag of a spool. If b depends on the
    reading, a db/dψ must be so small that q(ψ) remains monotonic. A term of a leg's parameter
    (``Leg.terms``) is added to it: a link grows with temperature, or stretches under its load.
    """

    parameter: str
    """Name of the amplitude a, a parameter of the leg."""
    basis: Callable[[Array], Array]
    """Function b of the reading ψ [rad] or [m], or of the influence; it keeps the shape."""
    slope: Callable[[Array], Array] | None = None
    """Derivative db/dψ, likewise; by default ``basis.slope``."""
    unit: str = ""
    """Unit of the amplitude, that of q over that of b; by default that of q or the parameter."""
    of: str = ""
    """Influence quantity on which b depends: a column of the measurements such as
    ``"temperature"`` or ``"time"``; ``"approach"`` or ``"load"`` of the sensor's own joint;
    ``"load"`` of the parameter. Empty for the reading."""

    def __post_init__(self) -> None:
        if self.slope is None and not callable(getattr(self.basis, "slope", None)):
            raise MechanismError(
                f"term {self.parameter!r} has no slope; give db/dψ as Term(…, slope=…), or a basis "
                "with a method slope"
            )

    def column(self, owner: str) -> str:
        """Return the influence's column; ``owner`` is the reading or parameter with the term."""
        return f"{self.of}_{owner}" if self.of in OF_JOINTS else self.of

    @property
    def has_form(self) -> bool:
        """Whether a file can hold the term: its basis is a form above, no user's function."""
        return self.slope is None and isinstance(self.basis, Harmonic | Power | Share)


@dataclass(frozen=True)
class Cables:
    """Limits of the tension of every cable; cables only pull.

    Example:
        >>> import pincal
        >>> pincal.Cables(least=5.0, most=500.0)
        Cables(least=5.0, most=500.0)
    """

    least: float = 0.0
    """Smallest tension, [N]."""
    most: float = np.inf
    """Largest tension, [N]."""

    def __post_init__(self) -> None:
        least, most = array_of((self.least, self.most), (2,), "tensions [N]", MechanismError)
        if not 0.0 <= least < most:
            raise MechanismError(
                f"limits of tensions are {self.least!r} and {self.most!r} [N]; expected 'least' of "
                "0 or more, and 'most' above it"
            )


@dataclass(frozen=True)
class Load:
    """Weight of platform and payload, on which terms may depend (``of="load"``).

    Example:
        >>> import pincal
        >>> tool = pincal.Load(mass=2.5, centre=(0.0, 0.0, -0.05))
        >>> tool.gravity
        (0.0, 0.0, -9.81)
    """

    mass: float = 0.0
    """Mass of platform and payload, [kg]."""
    centre: Point = (0.0, 0.0, 0.0)
    """Centre of that mass, in the platform's frame, [m]."""
    gravity: Point = (0.0, 0.0, -9.81)
    """Acceleration in the base's frame, [m/s²]."""
    drawn: tuple[tuple[str, float], ...] = ()
    """Parameters by id at which loads are computed: those of the drawing, so that the loads of a
    row are the same before and after calibration. Empty for the mechanism's own parameters."""
    assumed: bool = False
    """Whether the weight is not known but assumed; amplitudes are then relative to it."""

    def __post_init__(self) -> None:
        check_sizes(self, ("mass",), "load's", MechanismError)
        for name in ("centre", "gravity"):
            set_point(self, name, f"the load's {name}", MechanismError)
