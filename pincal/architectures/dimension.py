"""A dimension of a data sheet: its name, what it is, its unit, what it may be, and a default."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import degrees, radians
from typing import Any, TypeAlias

from pincal.errors import MechanismError
from pincal.model.checks import must_be, number_of
from pincal.model.mechanism import Mechanism
from pincal.types import Array

#: Dimensions by name: lengths [m], angles [rad], and texts.
Values: TypeAlias = Mapping[str, Any]
Corner: TypeAlias = "Sequence[float] | Array"


@dataclass(frozen=True)
class SheetDimension:
    """One dimension of an architecture."""

    name: str
    """Of the argument, and of the option: ``base_radius``, ``--base-radius``."""
    label: str
    """What it is, for people."""
    unit: str = "m"
    """``"m"``, ``"rad"``, or ``""`` of a text."""
    default: float | str = ""
    """[m], [rad], or a text; with ``of`` a factor."""
    of: str = ""
    """SheetDimension before it, of which the default is a multiple."""
    least: float = 1e-6
    """[m] or [rad]."""
    most: float = 1e3
    """[m] or [rad]."""
    above: str = ""
    """SheetDimension before it, than which it must be more."""
    below: str = ""
    """SheetDimension before it, than which it must be less."""
    goes_with: str = ""
    """Text before it, without which it means nothing."""
    instead_of: str = ""
    """Text before it, with which it means nothing."""
    choices: tuple[str, ...] = ()
    """What a text may be; anything if there are none."""

    def usual(self, before: Values) -> float | str:
        """Return the default, where other dimensions are what they are."""
        return float(self.default) * before[self.of] if self.of else self.default

    def applies(self, before: Values) -> bool:
        """Return whether it means something, where others before it are what they are."""
        meant = not self.goes_with or bool(before[self.goes_with])
        return meant and not (self.instead_of and before[self.instead_of])

    def checked(self, value: Any, before: Values) -> float | str:
        """Return a value that the dimension may have, where those before it are what they are.

        Raises:
            MechanismError: something else.
        """
        if self.choices and value not in self.choices:
            must_be(value, (str,), self.title, MechanismError)
            raise MechanismError(f"{self.title} is {value!r}; expected {' or '.join(self.choices)}")
        if not self.unit:
            return value
        number = number_of(value, self.title, MechanismError)
        if not self.least <= number <= self.most:
            expected = f"{self.text(self.least)} to {self.text(self.most)}"
            if self.least == LEAST and not number >= LEAST:
                expected = "more than zero"
            raise MechanismError(f"{self.title} is {self.text(number)}; expected {expected}")
        for bound, word, sign in ((self.above, "more", 1.0), (self.below, "less", -1.0)):
            if bound and not sign * number > sign * before[bound]:
                raise MechanismError(
                    f"{self.title} is {self.text(number)}; expected {word} than {bound}, "
                    f"{self.text(before[bound])}"
                )
        return number

    @property
    def title(self) -> str:
        """Return what it is and its name, for messages."""
        return f"the {self.label} ({self.name})"

    def text(self, value: float | str, *, typed: bool = False) -> str:
        """Return a value with its unit as data sheets have it, in mm or degrees; or as typed."""
        if not self.unit:
            return str(value)
        number = 1e3 * float(value) if self.unit == "m" else degrees(float(value))
        unit = "mm" if self.unit == "m" else "deg"
        return f"{number:.12g}{unit}" if typed else f"{number:.6g} {unit}"


LEAST = SheetDimension.least


def length(name: str, label: str, default: float, of: str = "", **limits: Any) -> SheetDimension:
    """Return a length, its default in [m], or a multiple of another one before it."""
    return SheetDimension(name, label, "m", default, of, **limits)


def angle(
    name: str, label: str, default: float, least: float = LEAST, most: float = 1e3, above: str = ""
) -> SheetDimension:
    """Return an angle, its default in degrees, its limits in [rad]."""
    return SheetDimension(name, label, "rad", radians(default), "", least, most, above)


@dataclass(frozen=True)
class Architecture:
    """A kind of mechanism, and how one is made from its dimensions."""

    name: str
    title: str
    dimensions: tuple[SheetDimension, ...]
    make: Callable[[Values], Mechanism]
    region: Callable[[Values], tuple[Corner, Corner]] | None = None
    """Lower and upper coordinates between which it works, where readings have no limits that say
    so, [m] and [rad]."""

    def complete(self, dimensions: Values) -> dict[str, float | str]:
        """Return all dimensions in order: those given, others in proportion to these.

        Raises:
            MechanismError: one that the architecture does not have, or that cannot be.
        """
        names = [dimension.name for dimension in self.dimensions]
        if unknown := [name for name in dimensions if name not in names]:
            raise MechanismError(
                f"{unknown[0]} is no dimension of a {self.name}; it has {', '.join(names)}"
            )
        values: dict[str, float | str] = {}
        for dimension in self.dimensions:
            value = dimensions.get(dimension.name)
            value = dimension.usual(values) if value is None else value
            values[dimension.name] = dimension.checked(value, values)
        return values

    def described(self, values: Values) -> str:
        """Return title and dimensions in a line."""
        shown = [item for item in self.dimensions if item.unit or item.choices]
        texts = [f"{item.name} {item.text(values[item.name])}" for item in shown]
        return f"{self.title}{': ' * bool(texts)}{', '.join(texts)}."
