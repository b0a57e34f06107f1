"""A study is a page of text with tables and figures, and a folder that holds them.

The page is Markdown and shows of each table what carries the verdict; the whole table is a CSV
file, each figure an SVG and a PNG. What takes time on the machine at hand is shown in figures only,
so that the same seed gives the same text and tables byte for byte.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TypeAlias

import matplotlib as mpl
from matplotlib.figure import Figure

import pincal

Cell: TypeAlias = str | float | int
Columns: TypeAlias = Mapping[str, Sequence[Cell]]


@dataclass
class Study:
    """What is asked of a study, and its text, tables and figures in the order of their adding."""

    name: str
    """Of the mechanism, or of what is looked at."""
    title: str
    paper: str
    """Title of the paper that it follows; empty if it follows none."""
    seed: int = 0
    """Of all random choices."""
    quick: bool = False
    """Fewer draws and coarser grids."""
    progress: Callable[[str], None] = lambda _: None
    """Called with what is being done."""
    parts: list[str] = field(default_factory=list)
    """Paragraphs, tables and figures in Markdown, paths relative to the folder."""
    tables: dict[str, dict[str, list[Cell]]] = field(default_factory=dict)
    figures: dict[str, Figure] = field(default_factory=dict)

    @cached_property
    def mechanism(self) -> pincal.Mechanism:
        """The nominal mechanism."""
        return pincal.load_mechanism(self.name)

    def heading(self, text: str) -> None:
        """Begin a section."""
        self.parts.append(f"## {text}")

    def say(self, text: str) -> None:
        """Add a paragraph."""
        self.parts.append(" ".join(text.split()))

    def table(self, name: str, caption: str, columns: Columns, omitted: Sequence[str] = ()) -> None:
        """Add a table: headers with units to cells; the omitted headers are in its file alone."""
        self.tables[name] = {header: list(cells) for header, cells in columns.items()}
        shown = {header: cells for header, cells in columns.items() if header not in omitted}
        text = f"{' '.join(caption.split())} (`tables/{name}.csv`)"
        self.parts.append(f"{text}\n\n{markdown(shown)}" if shown else text)

    def figure(self, name: str, caption: str, figure: Figure) -> None:
        """Add a figure."""
        self.figures[name] = figure
        text = " ".join(caption.split())
        label = text.partition(":")[0]
        self.parts.append(f"![{label}](figures/{name}.png)\n\n*{text}*")

    def claims(self, *rows: tuple[str, str, str, str]) -> None:
        """Put first what the paper says, what was measured, and whether they agree or why not."""
        details, self.parts = self.parts, []
        self.heading("Against the paper")
        columns = by_rows(("what", "paper", "measured", "verdict"), rows)
        self.table("against_the_paper", "What the paper says, and what was measured.", columns)
        self.parts += details

    def page(self) -> str:
        """Return the page; it names figures and tables by paths relative to its folder."""
        options = f" --seed {self.seed}" * bool(self.seed) + " --quick" * self.quick
        command = f"python -m studies {self.name}{options} -o FOLDER"
        after = f"After *{self.paper}*. " if self.paper else ""
        head = f"# {self.title}\n\n{after}Written by `{command}`."
        return "\n\n".join([head, *self.parts]) + "\n"

    def write(self, folder: Path) -> None:
        """Write the page ``study.md``, ``tables/`` and ``figures/`` into a folder."""
        (folder / "study.md").write_text(self.page(), encoding="utf-8")
        for part in ("tables", "figures"):
            (folder / part).mkdir()
        for name, columns in self.tables.items():
            stem = folder / "tables" / name
            with stem.with_suffix(".csv").open("w", newline="", encoding="utf-8") as file:
                writer = csv.writer(file, lineterminator="\n")
                writer.writerows([list(columns), *_rows(columns, digits=6)])
        dots = 100 if self.quick else 300  # an inch
        with mpl.rc_context({"svg.hashsalt": self.name, "savefig.dpi": dots}):
            for name, figure in self.figures.items():
                stem = folder / "figures" / name
                figure.savefig(stem.with_suffix(".svg"), metadata={"Date": None})
                figure.savefig(stem.with_suffix(".png"))


def at_most(size: float) -> str:
    """Return a size that may be rounding alone: 1e-12 or more, alike on every machine."""
    return f"{max(size, 1e-12):.0e}"


def by_rows(headers: Sequence[str], rows: Sequence[Sequence[Cell]]) -> dict[str, list[Cell]]:
    """Return the columns of a table that is written down row by row."""
    return {header: [row[place] for row in rows] for place, header in enumerate(headers)}


def markdown(columns: Columns) -> str:
    """Return a table in Markdown, numbers to four digits and to the right."""
    numeric = [all(not isinstance(c, str) for c in cells) for cells in columns.values()]
    lines = [
        "| " + " | ".join(columns) + " |",
        "|" + "|".join("---:" if n else "---" for n in numeric) + "|",
        *("| " + " | ".join(row) + " |" for row in _rows(columns, digits=4)),
    ]
    return "\n".join(lines)


def _rows(columns: Columns, digits: int) -> list[list[str]]:
    """Return the cells of a table as text, row by row."""
    return [
        [f"{cell:.{digits}g}" if isinstance(cell, float) else str(cell) for cell in row]
        for row in zip(*columns.values(), strict=True)
    ]
