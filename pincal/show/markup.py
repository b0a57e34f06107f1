"""HTML as a tree: text that is put in stays text, whatever it holds.

A page is made of elements, never of strings, so that escaping cannot be forgotten.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from typing import TypeAlias

from lxml import etree

Element: TypeAlias = etree._Element
Content: TypeAlias = Element | str | None
_UNPRINTABLE = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
_SHORT = 12  # rows of a table that is not broken over printed pages
_NUMBER = re.compile(r"[+-]?\d+(\.\d+)?(e[+-]\d\d)?( of \d+)?")


def tag(name: str, /, *content: Content, **attributes: str) -> Element:
    """Return an element with text and other elements in it.

    Args:
        name: Of the element.
        *content: Texts and elements, in order; None is left out.
        **attributes: By name: ``class_`` is class, ``aria_label`` aria-label.
    """
    found = etree.Element(name)
    for key, value in attributes.items():
        found.set(key.rstrip("_").replace("_", "-"), clean(value))
    for part in content:
        if isinstance(part, str):
            if len(found):
                found[-1].tail = (found[-1].tail or "") + clean(part)
            else:
                found.text = (found.text or "") + clean(part)
        elif part is not None:
            found.append(part)
    return found


def clean(text: str) -> str:
    """Return text without characters that no page can hold."""
    return _UNPRINTABLE.sub("\ufffd", text)


def table(
    caption: str, heads: Sequence[str], rows: Iterable[Sequence[Content]], *, groups: int = 0
) -> Element:
    """Return a table in a frame of its own, which scrolls where the page is too narrow.

    Args:
        caption: What it shows.
        heads: Of the columns.
        rows: Cells; numbers stand to the right.
        groups: Columns, from the left, whose cell heads the rows below it that have none.
    """
    body = tag("tbody")
    for cells in rows:
        row = tag("tr")
        if groups and cells[0]:
            row.set("class", "first")
        for place, cell in enumerate(cells):
            number = isinstance(cell, str) and bool(_NUMBER.fullmatch(cell)) and place >= groups
            if place < groups and cell:
                row.append(tag("th", cell, scope="row"))
            elif number:
                row.append(tag("td", cell, class_="n"))
            else:
                row.append(tag("td", cell))
        body.append(row)
    head = tag("tr", *(tag("th", name, scope="col") for name in heads))
    for place, cell in enumerate(head):
        column = [row[place].get("class") for row in body if len(row) > place]
        if "n" in column:
            cell.set("class", "n")
    whole = tag("table", tag("thead", head), body, aria_label=caption)
    kind = "wide short" if len(body) <= _SHORT else "wide"
    frame = tag("div", whole, class_=kind, role="region", tabindex="0", aria_label=caption)
    return tag("div", tag("p", caption, class_="caption"), frame)


def bullets(lines: Iterable[Content]) -> Element:
    """Return a list."""
    return tag("ul", *(tag("li", line) for line in lines))


def document(title: str, style: str, *content: Content) -> str:
    """Return a page that needs nothing else and may ask for nothing else.

    Args:
        title: Of the page.
        style: Style sheet; ours, never a user's.
        *content: Of the body.
    """
    policy = "default-src 'none'; style-src 'unsafe-inline'; img-src data:"
    head = tag("head", tag("meta", charset="utf-8"))
    head.append(tag("meta", http_equiv="Content-Security-Policy", content=policy))
    head.append(tag("meta", name="viewport", content="width=device-width, initial-scale=1"))
    head.append(tag("title", title))
    head.append(tag("style", style))
    return "<!doctype html>\n" + serialised(tag("html", head, tag("body", *content), lang="en"))


def serialised(element: Element) -> str:
    """Return an element as HTML."""
    return etree.tostring(element, method="html", encoding="unicode") + "\n"
