"""Puts the table that a benchmark made where the docs link it."""

from __future__ import annotations

import csv
from collections.abc import Iterable
from pathlib import Path

TABLES = Path(__file__).parents[1] / "docs" / "tables"


def write_table(benchmark: str, lines: Iterable[str]) -> None:
    """Write a table in Markdown as ``docs/tables/BENCHMARK.csv``."""
    text = "\n".join(lines).splitlines()
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in text]
    with (TABLES / f"{benchmark}.csv").open("w", newline="", encoding="utf-8") as file:
        csv.writer(file, lineterminator="\n").writerows(row for row in rows if "---" not in row[0])
