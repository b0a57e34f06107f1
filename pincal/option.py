"""Options that Python and the command line share: fields of dataclasses, declared once.

``option`` gives a field its default, its help, and the kinds of units that its value may have.
Python functions take the dataclass itself; ``pincal.cli.options`` makes command-line options of its
fields: ``fixed`` is ``--fixed``, and ``margins = True`` is ``--no-margins``.
"""

from dataclasses import dataclass, field, fields
from typing import Any


@dataclass(frozen=True)
class Option:
    """Command-line properties of a field."""

    help: str
    metavar: str | None = None
    """Placeholder of the value in the help; by default it follows from the type."""
    unit: str = ""
    """Kinds of unit that the number may have: ``"m"``, ``"rad"``, or both with a blank."""
    needs_unit: bool = False
    """Whether a number without a unit is refused; otherwise it is in SI units."""
    least: int | None = None
    most: int | None = None
    name: str = ""
    """Name on the command line, if it differs from the field's."""
    kind: Any = None
    """Type on the command line, if the field takes other objects in Python."""


def option(default: Any, description: str | Option, **properties: Any) -> Any:
    """Return a dataclass field that is also an option; ``properties`` are fields of ``Option``.

    A default that is a class is a factory. ``description`` is the help, or another field's option.
    """
    declared = description
    if isinstance(declared, str):
        declared = Option(declared, **properties)
    metadata = {"option": declared}
    if isinstance(default, type):
        return field(default_factory=default, metadata=metadata)
    return field(default=default, metadata=metadata)


def option_of(group: type, name: str) -> Option:
    """Return the option of a dataclass field."""
    declared: Option = {column.name: column for column in fields(group)}[name].metadata["option"]
    return declared
