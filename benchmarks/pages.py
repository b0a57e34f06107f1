"""Puts the table that a benchmark made where a page of the docs has it."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

DOCS = Path(__file__).parents[1] / "docs"


def write_table(page: str, benchmark: str, lines: Iterable[str]) -> None:
    """Write lines between ``<!-- made by benchmarks/… -->`` and ``<!-- end -->`` of a page."""
    path, table = DOCS / page, "\n".join(lines)
    block = re.compile(
        rf"(<!-- made by benchmarks/{re.escape(benchmark)} -->\n).*?(<!-- end -->)", re.DOTALL
    )
    text = path.read_text(encoding="utf-8")
    path.write_text(block.sub(lambda m: f"{m[1]}{table}\n{m[2]}", text), encoding="utf-8")
