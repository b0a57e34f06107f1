"""How models show themselves: on one line, numbers short."""

from __future__ import annotations

from collections.abc import Iterable

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
