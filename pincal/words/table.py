"""Tables, which a terminal, a page and plain text show alike.

A cell is a number in SI, a string, None, or a ``Cell`` with a text of its own. Numbers are shown in
the unit of their column, which its head names: ``rms [mm]``.
"""

from __future__ import annotations

import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from typing import TYPE_CHECKING, Literal, NamedTuple, TypeAlias

from pincal.words.numbers import SMALL, fixed, rounded, shown_in
from pincal.words.wording import rendered

if TYPE_CHECKING:
    from rich.console import Console, ConsoleOptions, RenderResult


class Cell(NamedTuple):
    """A value together with its text, where the column's format does not do."""

    value: float | str | None
    """Value in SI; numbers align their column to the right."""
    text: str


Value: TypeAlias = "float | str | Cell | None"


def quantity(
    value: float, unit: str, half: float = 0.0, units: Mapping[str, str] = SMALL, sign: str = ""
) -> Cell:
    """Return a cell for a value with an SI unit of its own, rounded by ``fixed``; NaN is empty."""
    return Cell(value, "" if value != value else fixed(value, half, unit, units, sign))


_HEAD = re.compile(r"(.*?)(?: \[(m|rad)\])?(?::(\.\d[fg]))?")


@dataclass(frozen=True)
class Table:
    """A table that rich's console, a page's template and a notebook can show."""

    title: str
    columns: Sequence[str]
    """Heads with SI unit and number format: ``rms``, ``worst [m]:.3f``."""
    rows: Sequence[Sequence[Value]]
    caption: str = ""
    """Note below the table."""
    heads: bool = True
    """Whether to show heads; a list of facts has none."""

    @property
    def _parts(self) -> list[tuple[str, str, str]]:
        """Name, SI unit (or an empty string) and number format of each column."""
        matches = (_HEAD.fullmatch(column) for column in self.columns)
        return [(m[1], m[2] or "", m[3] or ".4g") for m in matches if m]

    @property
    def head_cells(self) -> list[str]:
        """Heads of the columns, with displayed units."""
        return [f"{name} [{SMALL[unit]}]" if unit else name for name, unit, _ in self._parts]

    def cells(self) -> list[list[str]]:
        """Return all cells as text."""
        parts = self._parts
        return [
            [_text(value, unit, form) for (_, unit, form), value in zip(parts, row, strict=True)]
            for row in self.rows
        ]

    @property
    def aligned(self) -> tuple[Literal["left", "right"], ...]:
        """Alignment of each column: to the right if it has a number."""
        raw = [[v.value if isinstance(v, Cell) else v for v in row] for row in self.rows]
        places = range(len(self.columns))
        numeric = [any(isinstance(row[i], int | float) for row in raw) for i in places]
        return tuple("right" if number else "left" for number in numeric)

    def __html__(self) -> str:
        """Return the table as HTML, in a frame that scrolls where the page is too narrow."""
        return rendered("table.html", table=self, sides=self.aligned)

    _repr_html_ = __html__

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Yield title, table and caption; text of a table that is too wide wraps between words."""
        from rich import box
        from rich.table import Table as RichTable
        from rich.text import Text

        cells, table = self.cells(), RichTable(pad_edge=False, show_header=self.heads)
        table.box = box.SIMPLE_HEAD if self.heads else None
        for place, (head, side) in enumerate(zip(self.head_cells, self.aligned, strict=True)):
            words = " ".join([head, *(row[place] for row in cells)]).split()
            numbers = max((len(row[place]) for row in cells), default=1) if side == "right" else 1
            least = max(numbers, *map(len, words), 1)
            table.add_column(Text(head), justify=side, overflow="fold", min_width=least)
        for row in cells:
            table.add_row(*map(Text, row))
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


def _text(value: Value, unit: str, form: str) -> str:
    if isinstance(value, Cell):
        return value.text
    if value is None or value != value:
        return ""
    if isinstance(value, str | int):
        return str(value)
    if not isfinite(value):
        return "∞"
    shown = shown_in(value, unit) if unit else value
    return rounded(shown, int(form[1:-1])) if form.endswith("g") else f"{shown:{form}}"
