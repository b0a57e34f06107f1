"""How models show themselves: on one line, numbers short, and a mechanism on a page."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pincal.model.mechanism import Mechanism


ROWS = 30
"""Of a table or list on a printed page; those that follow are counted."""
_WIDTH = 118  # of a line


def one_line(kind: str, *parts: str) -> str:
    """Return ``Kind(part, part)``, on one line and not longer than it may be."""
    text = f"{kind}({', '.join(part for part in parts if part)})"
    return text if len(text) <= _WIDTH else f"{text[: _WIDTH - 2]}…)"


def triple(values: Iterable[float]) -> str:
    """Return numbers in brackets."""
    return f"({', '.join(f'{value:.4g}' for value in values)})"


def counted(count: int, noun: str) -> str:
    """Return a number and a noun that agrees with it."""
    return f"{count} {noun}{'' if count == 1 else 's'}"


def page(mechanism: Mechanism) -> str:
    """Return a mechanism on a page: platform, legs, and a table of its nominal parameters."""
    platform, legs = mechanism.platform, mechanism.legs
    home = zip(platform.coordinates, platform.home, platform.units, strict=True)
    at_home = ", ".join(f"{name} = {value:.6g} {unit}" for name, value, unit in home)
    rows = [
        (
            leg.name,
            leg.joint_letters,
            f"reads {', '.join(leg.reading_names)}",
            f"closes a {leg.closes}",
        )
        for leg in legs
    ]
    units = {name: unit for leg in legs for name, unit in leg.units.items()}
    names = dict.fromkeys(name for leg in legs for name in leg.parameter_names)
    values = [leg.nominal_by_name for leg in legs]
    grid = [("", *mechanism.leg_names)]
    for name in names:
        cells = (f"{of_leg[name]:.6g}" if name in of_leg else "" for of_leg in values)
        grid.append((f"{name} [{units[name]}]", *cells))
    if len(legs) > len(names):
        grid = list(zip(*grid, strict=True))
    table = _columns(grid)
    return "\n".join(
        (
            f"{mechanism.name}{': ' * bool(mechanism.description)}{mechanism.description}",
            f"platform {platform.kind}, at home {at_home}",
            *_columns(rows),
            "",
            f"nominal parameters, {len(mechanism.parameters)} in all:",
            *table[: ROWS + 1],
            *[f"… and {len(table) - ROWS - 1} rows more"] * (len(table) > ROWS + 1),
            *(f"  {key}: {text}" for key, text in mechanism.used_labels.items()),
        )
    )


def _columns(rows: Sequence[Sequence[str]]) -> list[str]:
    """Return rows of cells as lines whose cells are below each other."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = ("  ".join(map(str.ljust, row, widths)) for row in rows)
    return [f"  {line}".rstrip() for line in lines]
