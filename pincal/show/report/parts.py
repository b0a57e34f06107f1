"""Parts of pages, each made by its template: sections, and the cards of the first screen."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeAlias

from pincal.words.pages import clean, rendered


class Html(Protocol):
    """What knows its own HTML."""

    def __html__(self) -> str:
        """Return it."""


#: A paragraph, a list, facts by name, or what knows its own HTML.
Part: TypeAlias = str | Sequence[str] | Mapping[str, str] | Html | None


@dataclass(frozen=True)
class Section:
    """A section of a report."""

    name: str
    title: str
    parts: tuple[Part, ...]

    def __html__(self) -> str:
        """Return the section for a page."""
        return rendered("section.html", section=self)


@dataclass(frozen=True)
class Card:
    """An answer on the first screen."""

    question: str
    verdict: str
    parts: tuple[Part, ...]
    tone: str
    """``"good"``, ``"care"``, ``"bad"``, or empty for neither."""


@dataclass(frozen=True)
class Answers:
    """The first screen."""

    cards: tuple[Card, ...]

    def __html__(self) -> str:
        """Return the section for a page."""
        return rendered("answers.html", answers=self)


@dataclass(frozen=True)
class Sizes:
    """Errors of the platform before and after, for a card."""

    rows: Sequence[tuple[str, str, str]]

    def __html__(self) -> str:
        """Return the table for a page."""
        return rendered("sizes.html", rows=self.rows)


@dataclass(frozen=True)
class Command:
    """What was typed."""

    text: str

    def __html__(self) -> str:
        """Return it as it was typed."""
        return f"<pre><code>{html.escape(clean(self.text))}</code></pre>"
