"""Tables: columns and rows said once, shown in a terminal, on a page, as text, as data.

A cell is a number, a string, None, or a ``Cell`` whose text is its own. Numbers are SI and stay so
in ``records``; a column's unit says in what they are read. Headers say that unit: ``rms [mm]``.
"""

from __future__ import annotations

import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from math import isfinite
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypeAlias

from pincal.words.numbers import SMALL, fixed, rounded, shown_in
from pincal.words.wording import rendered

if TYPE_CHECKING:
    from rich.console import Console, ConsoleOptions, RenderResult


class Cell(NamedTuple):
    """A value and how it is shown, where that depends on more than its column."""

    value: float | str | None
    """Raw, SI."""
    text: str


Value: TypeAlias = "float | str | Cell | None"
_WIDE = 10_000  # columns: as wide as any table is


def quantity(
    value: float, unit: str, half: float = 0.0, units: Mapping[str, str] = SMALL, sign: str = ""
) -> Cell:
    """Return a number of SI units that are not those of its whole column; see ``fixed``."""
    return Cell(value, "" if value != value else fixed(value, half, unit, units, sign))


@dataclass(frozen=True)
class Column:
    """A column of a table."""

    name: str
    """What heads it, and the key of its values in records."""
    unit: str = ""
    """SI unit of its numbers, ``"m"``, ``"rad"`` or ``"1"``, if it is one for all."""
    format: str = ".4g"
    """Of its numbers, in the unit in which they are read."""
    units: Mapping[str, str] = field(default_factory=lambda: SMALL)
    """In which unit numbers are read, by SI unit."""

    @property
    def head(self) -> str:
        """The name with the unit in which numbers are read."""
        shown = self.units[self.unit] if self.unit else ""
        return f"{self.name} [{shown}]" if shown else self.name

    def text(self, value: Value) -> str:
        """Return a value as it is shown."""
        if isinstance(value, Cell):
            return value.text
        if value is None or value != value:
            return ""
        if isinstance(value, str | int):
            return str(value)
        if not isfinite(value):
            return "∞"
        shown = shown_in(value, self.unit, self.units) if self.unit else value
        if self.format.endswith("g"):
            return rounded(shown, int(self.format[1:-1]))
        return f"{shown:{self.format}}"


_HEAD = re.compile(r"(.*?)(?: \[(m|rad)\])?(?::(\.\d[fg]))?")


def columns(*heads: str) -> tuple[Column, ...]:
    """Return columns by heads, with the SI unit and the format of numbers: ``worst [m]:.3f``."""
    parts = (_HEAD.fullmatch(head) for head in heads)
    return tuple(Column(m[1], m[2] or "", m[3] or ".4g") for m in parts if m)


@dataclass(frozen=True)
class Table:
    """A table: shown by rich's console, by a page's template, by a notebook."""

    title: str
    columns: tuple[Column, ...]
    rows: Sequence[Sequence[Value]]
    caption: str = ""
    """What to know of it."""
    grouped: bool = False
    """Whether the first column heads groups of rows: said once in each."""
    heads: bool = True
    """Whether columns have heads; a list of facts has none."""

    def cells(self) -> list[list[str]]:
        """Return all cells as text, those of a group's name but once."""
        shown = [
            [column.text(value) for column, value in zip(self.columns, row, strict=True)]
            for row in self.rows
        ]
        if self.grouped:
            for above, row in reversed(list(pairwise(shown))):
                row[0] = "" if row[0] == above[0] else row[0]
        return shown

    @property
    def aligned(self) -> tuple[Literal["left", "right"], ...]:
        """On which side each column's cells stand: to the right if there is a number in it."""
        return tuple(
            "right" if any(isinstance(_raw(row[i]), int | float) for row in self.rows) else "left"
            for i in range(len(self.columns))
        )

    def records(self) -> list[dict[str, Any]]:
        """Return the rows for JSON: raw values in SI by the columns' names; None if not finite."""
        names = [column.name for column in self.columns]
        raw = [[_raw(value) for value in row] for row in self.rows]
        return [
            {
                name: None if isinstance(value, float) and not isfinite(value) else value
                for name, value in zip(names, row, strict=True)
            }
            for row in raw
        ]

    def __html__(self) -> str:
        """Return the table for templates, in a frame that scrolls where the page is too narrow."""
        return rendered("table.html", table=self, sides=self.aligned)

    _repr_html_ = __html__

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Yield the title, the table, and the caption as wide as the terminal.

        Where it is too wide, units go below heads and text is broken between words; words are
        broken only where their longest alone are wider than the terminal.
        """
        from rich import box
        from rich.table import Table as RichTable
        from rich.text import Text

        cells, style = self.cells(), box.SIMPLE_HEAD if self.heads else None

        def drawn(*, broken: bool, whole_words: bool = False) -> RichTable:
            table = RichTable(box=style, pad_edge=False, show_header=self.heads)
            for place, (column, side) in enumerate(zip(self.columns, self.aligned, strict=True)):
                head = column.head.replace(" [", "\n[") if broken else column.head
                words = " ".join([head, *(row[place] for row in cells)]).split()
                table.add_column(
                    Text(head),
                    justify=side,
                    no_wrap=not broken or side == "right",
                    overflow="fold",
                    min_width=max(map(len, words), default=1) if whole_words else None,
                )
            for row, after in zip(cells, [*cells[1:], [""]], strict=False):
                table.add_row(*map(Text, row), end_section=self.grouped and bool(after[0]))
            return table

        unbounded = options.update(max_width=_WIDE)
        table = drawn(broken=False)
        if console.measure(table, options=unbounded).maximum > options.max_width:
            table = drawn(broken=True, whole_words=True)
            if console.measure(table, options=unbounded).minimum > options.max_width:
                table = drawn(broken=True)
        yield Text(self.title, style="bold")
        yield table
        if self.caption:
            yield Text(self.caption + "\n")

    def __str__(self) -> str:
        """Return the table as text."""
        from rich.console import Console

        buffer = io.StringIO()
        Console(file=buffer, width=120).print(self)
        return "\n".join(line.rstrip() for line in buffer.getvalue().splitlines())


def _raw(value: Value) -> float | str | None:
    """Return a value without its looks."""
    return value.value if isinstance(value, Cell) else value
