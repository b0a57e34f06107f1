"""A figure as part of a page: its SVG read back as a tree.

No document type, names or dates, text as text, and nothing that another figure of the page could
be mistaken for.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

from lxml import etree

from pincal.show.style import DARK_OF
from pincal.words.pages import clean, rendered

_COLOUR = re.compile(r"#[0-9a-fA-F]{6}\b")


@dataclass(frozen=True)
class SvgFigure:
    """A figure with its caption, as part of a page."""

    svg: str
    """Elements of HTML; texts in it are escaped."""
    caption: str

    @classmethod
    def of(cls, svg: bytes, name: str, caption: str) -> SvgFigure:
        """Return the figure that matplotlib wrote, by a name that no other has in the page."""
        picture = _inline(svg)
        for key, value in {"role": "img", "aria-label": clean(caption), "id": name}.items():
            picture.set(key, value)
        return cls(etree.tostring(picture, method="html", encoding="unicode"), caption)

    def __html__(self) -> str:
        """Return the figure for a page."""
        return rendered("figure.html", figure=self)


def _themed(colour: re.Match[str]) -> str:
    """Return a colour as a variable of the page, which has another one on dark ground."""
    own = colour[0].lower()
    return f"var(--c{own[1:]}, {own})" if own in DARK_OF else own


def _inline(svg: bytes) -> Any:
    """Return an SVG as elements of HTML: no namespaces, no ids but those that are used."""
    safe: dict[str, Any] = {"resolve_entities": False, "no_network": True, "remove_comments": True}
    root: Any = etree.fromstring(svg, etree.XMLParser(huge_tree=True, **safe))
    for element in list(root.iter("{*}metadata", "{*}style")):
        element.getparent().remove(element)
    used = set(re.findall(r'(?:href="#|url\(#)([^")]+)', svg.decode()))
    for element in root.iter():
        element.tag = etree.QName(element).localname
        for key, value in element.items():
            del element.attrib[key]
            name = etree.QName(key).localname
            if (name == "href" or not key.startswith("{")) and (
                name != "id" or value in used or value.startswith("dimension-")
            ):
                element.set(name, "".join(value.split()) if value[:5] == "data:" else value)
        if (ground := element.attrib.pop("fill", "")) and ground != "none":  # behind a hatch
            element.set("style", f"fill: {ground}; {element.get('style', '')}")
        elif ground:
            element.set("fill", ground)
        if "style" in element.attrib:
            element.set("style", _COLOUR.sub(_themed, element.get("style", "")))
    etree.cleanup_namespaces(root)
    for key in ("width", "height", "version"):
        del root.attrib[key]
    return root
