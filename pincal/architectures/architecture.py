"""Architectures: the dimensions of their data sheets, and checks of machines made of them."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from math import degrees, radians
from typing import Any, TypeAlias

import numpy as np

from pincal.errors import MechanismError
from pincal.kinematics.configurations import beyond_limits
from pincal.kinematics.singularity import home_determinant
from pincal.model import Mechanism
from pincal.model.checks import must_be, number_of
from pincal.symmetry.carry import at_home as closed_at_home

#: Values of dimensions by name: lengths [m], angles [rad], and texts.
Values: TypeAlias = Mapping[str, Any]
LEAST = 1e-6
_FLAT = 1e-3  # determinant at home below which the pose is singular


@dataclass(frozen=True)
class SheetDimension:
    """Dimension of an architecture, which is also a command's option: ``base_radius``."""

    name: str
    label: str
    """Description for people."""
    unit: str = "m"
    """Unit: ``"m"``, ``"rad"``, or ``""`` for a text."""
    default: float | str = ""
    """Default value, [m], [rad] or a text; a factor if there is a ``multiple_of``."""
    multiple_of: str = ""
    """Name of an earlier dimension of which the default is a multiple."""
    least: float = LEAST
    """Smallest value, [m] or [rad]."""
    most: float = 1e3
    above: str = ""
    """Name of an earlier dimension that it must exceed."""
    below: str = ""
    """Name of an earlier dimension that must exceed it."""
    choices: tuple[str, ...] = ()
    """Values that a text may have; any if empty."""

    def checked(self, value: Any, before: Values) -> float | str:
        """Return the value; raise MechanismError unless it fits the limits and values before."""
        title = f"the {self.label} ({self.name})"
        if self.choices and value not in self.choices:
            must_be(value, (str,), title, MechanismError)
            raise MechanismError(f"{title} is {value!r}; expected {' or '.join(self.choices)}")
        if not self.unit:
            return value
        number = number_of(value, title, MechanismError)
        expected = ""
        if not self.least <= number <= self.most:
            above_zero = self.least == LEAST and not number >= LEAST
            limits = f"{self.text(self.least)} to {self.text(self.most)}"
            expected = "more than zero" if above_zero else limits
        elif self.above and not number > before[self.above]:
            expected = f"more than {self.above}, {self.text(before[self.above])}"
        elif self.below and not number < before[self.below]:
            expected = f"less than {self.below}, {self.text(before[self.below])}"
        if expected:
            raise MechanismError(f"{title} is {self.text(number)}; expected {expected}")
        return number

    def text(self, value: float | str) -> str:
        """Return a value with its unit as in data sheets, in mm or degrees."""
        return sized(float(value), self.unit) if self.unit else str(value)


def sized(value: float, unit: str) -> str:
    """Return a length [m] as text in mm, or an angle [rad] as text in degrees."""
    return f"{1e3 * value:.6g} mm" if unit == "m" else f"{degrees(value):.6g} deg"


def length(
    name: str, label: str, default: float, multiple_of: str = "", **limits: Any
) -> SheetDimension:
    """Return a length; the default is in [m], or a factor of the dimension ``multiple_of``."""
    return SheetDimension(name, label, "m", default, multiple_of, **limits)


def angle(
    name: str, label: str, default: float, least: float = LEAST, most: float = 1e3, above: str = ""
) -> SheetDimension:
    """Return an angle; the default is in degrees, the limits are in [rad]."""
    return SheetDimension(name, label, "rad", radians(default), "", least, most, above)


def text(name: str, label: str, *choices: str) -> SheetDimension:
    """Return a text; the default is the first choice."""
    return SheetDimension(name, label, "", (*choices, "")[0], choices=choices)


@dataclass(frozen=True)
class Architecture:
    """A kind of mechanism, and the function that makes one from its dimensions."""

    name: str
    title: str
    dimensions: tuple[SheetDimension, ...]
    make: Callable[[Values], Mechanism]
    box: Callable[[Values], str] = lambda _: ""
    """Working space in the form of ``--box``, if limits of the readings do not bound it."""

    def complete(self, dimensions: Values) -> dict[str, float | str]:
        """Return all dimensions in order; those not given are in proportion to the others."""
        names = [dimension.name for dimension in self.dimensions]
        if unknown := [name for name in dimensions if name not in names]:
            raise MechanismError(
                f"{unknown[0]} is no dimension of a {self.name}; it has {', '.join(names)}"
            )
        values: dict[str, Any] = {}
        for dimension in self.dimensions:
            value = dimensions.get(dimension.name)
            if value is None:
                value = dimension.default
                value = (
                    float(value) * values[dimension.multiple_of] if dimension.multiple_of else value
                )
            values[dimension.name] = dimension.checked(value, values)
        return values

    def sheet(self, values: Values) -> list[str]:
        """Return names and values of the dimensions that are numbers or choices."""
        shown = [item for item in self.dimensions if item.unit or item.choices]
        return [f"{item.name} {item.text(values[item.name])}" for item in shown]

    def at_home(self, made: Mechanism, values: Values) -> Mechanism:
        """Return a mechanism with its legs closed at home; raise MechanismError if one is not."""
        change = f"change one of {', '.join(self.sheet(values))}"
        platform, legs = made.platform, []
        for leg in made.legs:
            try:
                legs.append(closed_at_home(leg, platform))
            except MechanismError as error:
                raise MechanismError(
                    f"{self.name}: {leg.name} is too short or too long for the home pose; {change}"
                ) from error
            for place in np.flatnonzero(beyond_limits(legs[-1], legs[-1].home[None])[0]):
                joint = legs[-1].moving[place]
                ends = (joint.home, joint.lower, joint.upper)
                position, lower, upper = (sized(end, "rad" if joint.turns else "m") for end in ends)
                raise MechanismError(
                    f"{self.name}: at home joint {joint.name!r} of {leg.name} is at {position}, "
                    f"outside its limits {lower} to {upper}; {change}"
                )
        made = replace(made, legs=tuple(legs))
        if not abs(home_determinant(made)) >= _FLAT:  # it is NaN where a leg misses home
            raise MechanismError(
                f"{self.name}: home is a singular pose: legs do not hold the platform; {change}"
            )
        return made
