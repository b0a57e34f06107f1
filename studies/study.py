"""A study is a page of text with tables and figures, and a folder that holds them.

The page is Markdown; tables are written as CSV and Markdown, figures as SVG and PNG. What
takes time on the machine at hand is shown in figures only, so that the same seed gives
the same text and tables byte for byte.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeAlias

import matplotlib as mpl
from matplotlib.figure import Figure

Cell: TypeAlias = str | float | int
Columns: TypeAlias = Mapping[str, Sequence[Cell]]
_DPI = 110
_DIGITS = 4


@dataclass(frozen=True)
class Claim:
    """A figure or claim of a paper beside what was measured."""

    what: str
    paper: str
    measured: str
    verdict: str
    """Whether they agree, and if not, why."""


@dataclass
class Study:
    """Text, tables and figures of one study, in the order in which they were added."""

    name: str
    """Of the mechanism."""
    title: str
    paper: str
    """Title of the paper that it follows."""
    command: str
    """What to type for it."""
    parts: list[str] = field(default_factory=list)
    """Paragraphs, tables and figures in Markdown, paths relative to the folder."""
    tables: dict[str, dict[str, list[Cell]]] = field(default_factory=dict)
    figures: dict[str, Figure] = field(default_factory=dict)

    def heading(self, text: str) -> None:
        """Begin a section."""
        self.parts.append(f"## {text}")

    def say(self, text: str) -> None:
        """Add a paragraph."""
        self.parts.append(" ".join(text.split()))

    def table(self, name: str, caption: str, columns: Columns) -> None:
        """Add a table: headers with units to cells."""
        kept = {header: list(cells) for header, cells in columns.items()}
        self.tables[name] = kept
        self.parts.append(f"{' '.join(caption.split())} (`tables/{name}.csv`)\n\n{markdown(kept)}")

    def figure(self, name: str, caption: str, figure: Figure) -> None:
        """Add a figure."""
        self.figures[name] = figure
        text = " ".join(caption.split())
        self.parts.append(f"![{text}](figures/{name}.png)\n\n*{text}*")

    def claims(self, claims: Sequence[Claim]) -> None:
        """Add the table of what agrees with the paper and what does not."""
        self.heading("Against the paper")
        columns = {
            "what": [c.what for c in claims],
            "paper": [c.paper for c in claims],
            "measured": [c.measured for c in claims],
            "verdict": [c.verdict for c in claims],
        }
        self.table("against_the_paper", "What the paper says, and what was measured.", columns)

    def page(self, folder: str = "") -> str:
        """Return the page, its figures and tables in a folder relative to it."""
        head = f"# {self.title}\n\nAfter *{self.paper}*. Written by `{self.command}`."
        text = "\n\n".join([head, *self.parts])
        if folder:
            text = text.replace("](figures/", f"]({folder}/figures/")
            text = text.replace("(`tables/", f"(`{folder}/tables/")
        return text + "\n"

    def write(self, folder: Path) -> None:
        """Write the page ``study.md``, ``tables/`` and ``figures/`` into a folder."""
        (folder / "study.md").write_text(self.page(), encoding="utf-8")
        for part in ("tables", "figures"):
            (folder / part).mkdir()
        for name, columns in self.tables.items():
            stem = folder / "tables" / name
            with stem.with_suffix(".csv").open("w", newline="", encoding="utf-8") as file:
                rows = zip(*columns.values(), strict=True)
                writer = csv.writer(file, lineterminator="\n")
                writer.writerows([list(columns), *([_cell(c, 8) for c in row] for row in rows)])
            stem.with_suffix(".md").write_text(markdown(columns) + "\n", encoding="utf-8")
        with mpl.rc_context({"svg.hashsalt": self.name}):
            for name, figure in self.figures.items():
                stem = folder / "figures" / name
                figure.savefig(stem.with_suffix(".svg"), dpi=_DPI, metadata={"Date": None})
                figure.savefig(stem.with_suffix(".png"), dpi=_DPI)


def by_rows(headers: Sequence[str], rows: Sequence[Sequence[Cell]]) -> dict[str, list[Cell]]:
    """Return the columns of a table that is written down row by row."""
    return {header: [row[place] for row in rows] for place, header in enumerate(headers)}


def markdown(columns: Columns) -> str:
    """Return a table in Markdown, numbers to four digits and to the right."""
    numeric = [all(not isinstance(c, str) for c in cells) for cells in columns.values()]
    lines = [
        "| " + " | ".join(columns) + " |",
        "|" + "|".join("---:" if n else "---" for n in numeric) + "|",
    ]
    rows = zip(*columns.values(), strict=True)
    lines += ["| " + " | ".join(_cell(c, _DIGITS) for c in row) + " |" for row in rows]
    return "\n".join(lines)


def _cell(value: Cell, digits: int) -> str:
    """Return a cell as text."""
    return f"{value:.{digits}g}" if isinstance(value, float) else str(value)
