"""Tables: columns and rows said once, shown in a terminal, on a page, as Markdown, as data.

A cell is a number, a string, None, a ``Quantity`` or the like with its own unit, or a ``Cell``
whose text is its own. Numbers are SI and stay so in ``records``; a column's unit says in what they
are read. Headers say that unit: ``rms [mm]``.
"""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from math import isfinite
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypeAlias

from pincal.words.numbers import SMALL, fixed, rounded, shown_in, uncertainty
from pincal.words.wording import rendered

if TYPE_CHECKING:
    import pandas
    from rich.console import Console, ConsoleOptions, RenderResult


class Cell(NamedTuple):
    """A value and how it is shown, where that depends on more than its column."""

    value: float | str | None
    """Raw, SI."""
    text: str


class Quantity(NamedTuple):
    """A number of SI units that are not those of its whole column."""

    value: float
    """Raw, SI."""
    unit: str
    """``"m"``, ``"rad"`` or ``"1"``."""
    half: float = 0.0
    """Uncertainty, SI, that says to how many digits it is shown; 0 if there is none."""
    format: str = ""
    """In place of these digits."""
    sign: str = ""
    """``"+"`` to show the sign of what is positive too."""

    def text(self, units: Mapping[str, str]) -> str:
        """Return the number in the unit in which it is read; nothing of NaN."""
        if self.value != self.value:
            return ""
        if self.format:
            return f"{shown_in(self.value, self.unit, units):{self.format}}"
        return fixed(self.value, self.half, self.unit, units, self.sign)


class Uncertainty(NamedTuple):
    """A standard error or half an interval, in SI units that are not those of its whole column."""

    value: float
    """Raw, SI; 0 or more."""
    unit: str
    """``"m"``, ``"rad"`` or ``"1"``."""

    def text(self, units: Mapping[str, str]) -> str:
        """Return it to two digits, or as a bound, in the unit in which it is read."""
        return uncertainty(self.value, self.unit, units)


class UnitOf(NamedTuple):
    """The SI unit of what else is in a row: shown as that in which it is read."""

    value: str

    def text(self, units: Mapping[str, str]) -> str:
        """Return the unit in which numbers of the row are read."""
        return units[self.value]


_WIDE = 10_000  # columns: as wide as any table is
Value: TypeAlias = "float | str | Quantity | Uncertainty | UnitOf | Cell | None"


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
        if value is None:
            return ""
        if isinstance(value, Cell):
            return value.text
        if isinstance(value, Quantity | Uncertainty | UnitOf):
            return value.text(self.units)
        if isinstance(value, str):
            return value
        if isinstance(value, int):
            return str(value)
        if not isfinite(value):
            return "" if value != value else "∞"
        shown = shown_in(value, self.unit, self.units) if self.unit else value
        if self.format.endswith("g"):
            return rounded(shown, int(self.format[1:-1]))
        return f"{shown:{self.format}}"


def columns(*heads: str, units: Mapping[str, str] = SMALL) -> tuple[Column, ...]:
    """Return columns of heads with the format of their numbers: ``leg``, ``efficiency:.3f``."""
    parts = (head.partition(":") for head in heads)
    return tuple(Column(name, format=digits or ".4g", units=units) for name, _, digits in parts)


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
    wrap: bool = True
    """Whether words may be broken over lines before a table is as wide as the terminal."""

    def only(self, *names: str, caption: str = "") -> Table:
        """Return the table with some of its columns, those that it has, and another caption."""
        places = [i for i, column in enumerate(self.columns) if column.name in names]
        rows = [[row[i] for i in places] for row in self.rows]
        columns = tuple(self.columns[i] for i in places)
        return replace(self, columns=columns, rows=rows, caption=caption)

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
        places = range(len(self.columns))
        number = (any(isinstance(_raw(row[i]), int | float) for row in self.rows) for i in places)
        return tuple("right" if numeric else "left" for numeric in number)

    def records(self) -> list[dict[str, Any]]:
        """Return the rows for JSON: raw values in SI by the columns' names; None if not finite."""
        return [
            {c.name: _plain(value) for c, value in zip(self.columns, row, strict=True)}
            for row in self.rows
        ]

    def to_dataframe(self) -> pandas.DataFrame:
        """Return the rows as a pandas DataFrame, raw values in SI.

        Raises:
            ImportError: pandas is not installed.
        """
        import pandas  # nothing else needs it

        names = [column.name for column in self.columns]
        rows = [[_raw(value) for value in row] for row in self.rows]
        return pandas.DataFrame(rows, columns=names)

    def markdown(self) -> str:
        """Return the table as Markdown."""
        rule = ["---:" if side == "right" else "---" for side in self.aligned]
        lines = [[_escaped(column.head) for column in self.columns], rule]
        lines += [[_escaped(cell) for cell in row] for row in self.cells()]
        return "".join(f"| {' | '.join(line)} |\n" for line in lines)

    def html(self) -> str:
        """Return the table as HTML, in a frame that scrolls where the page is too narrow."""
        return rendered("table.html", table=self, sides=self.aligned)

    def __html__(self) -> str:
        """Return the table for templates, which escape text but not this."""
        return self.html()

    def _repr_html_(self) -> str:
        """Return the table for notebooks."""
        return self.html()

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Yield the title, the table, and the caption as wide as the terminal."""
        from rich import box
        from rich.table import Table as RichTable
        from rich.text import Text

        style, cells = box.SIMPLE_HEAD if self.heads else None, self.cells()

        def drawn(*, wrap: bool, narrow: bool = False) -> RichTable:
            table = RichTable(box=style, pad_edge=False, show_header=self.heads)
            for place, (column, side) in enumerate(zip(self.columns, self.aligned, strict=True)):
                fold = wrap and side == "left" and not (place and self.grouped)
                head = Text(column.head.replace(" [", "\n[") if narrow else column.head)
                table.add_column(head, justify=side, no_wrap=not fold, overflow="fold")
            for row, after in zip(cells, [*cells[1:], [""]], strict=False):
                table.add_row(*map(Text, row), end_section=self.grouped and bool(after[0]))
            return table

        unfolded = drawn(wrap=self.wrap)
        wide = console.measure(unfolded, options=options.update(max_width=_WIDE)).maximum
        yield Text(self.title, style="bold")
        yield unfolded if wide <= options.max_width else drawn(wrap=True, narrow=True)
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
    if isinstance(value, (Quantity, Uncertainty, UnitOf, Cell)):
        return value.value
    return value


def _plain(value: Value) -> Any:
    """Return a value for JSON."""
    raw = _raw(value)
    return None if isinstance(raw, float) and not isfinite(raw) else raw


def _escaped(text: str) -> str:
    """Return text that Markdown takes for text in a cell."""
    for letter in "\\`*_[]<>|":
        text = text.replace(letter, f"\\{letter}")
    return " ".join(text.split())
