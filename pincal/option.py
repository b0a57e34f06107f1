"""Options that Python and the command line share: fields of dataclasses, declared once.

``option`` gives a field its default, its help, and the kind of unit in which people may write it.
Python takes such a dataclass as it is; the command line is filled from its fields
(``pincal.cli.options``): ``fixed`` is ``--fixed``, and ``symmetry = True`` is ``--no-symmetry``.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Any


@dataclass(frozen=True)
class Option:
    """What the command line says of a field, and takes for it."""

    help: str
    metavar: str | None = None
    """What stands for the value in help; made from the type if not given."""
    unit: str = ""
    """Kinds of unit that the number may have: ``"m"``, ``"rad"``, or both with a blank."""
    needs_unit: bool = False
    """Whether a number without a unit is refused; else it is in SI."""
    least: int | None = None
    most: int | None = None
    name: str = ""
    """Name on the command line, if not the field's."""
    kind: Any = None
    """Type that is typed, if the field takes other objects in Python."""


def option(default: Any, description: str | Option, **properties: Any) -> Any:
    """Return a field of a dataclass that is an option, too, with further fields of ``Option``.

    A default that is a class is called. The description is its help, or another field's option.
    """
    declared = description
    if isinstance(declared, str):
        declared = Option(declared, **properties)
    metadata = {"option": declared}
    if isinstance(default, type):
        return field(default_factory=default, metadata=metadata)
    return field(default=default, metadata=metadata)


def option_of(group: type, name: str) -> Option:
    """Return the option that a field of a dataclass is."""
    declared: Option = {column.name: column for column in fields(group)}[name].metadata["option"]
    return declared
