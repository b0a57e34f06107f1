"""Figures as SVG inside a page: the same bytes for the same figure, text as text.

A figure is drawn and written under one set of matplotlib's parameters. Its SVG is read back as
a tree and becomes a part of the page: no document type, names or dates, and nothing that
another figure of the page could be mistaken for.
"""

from __future__ import annotations

import io
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import wraps
from typing import Any, ParamSpec

import matplotlib as mpl
from lxml import etree
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from pincal.words.pages import clean, rendered

P = ParamSpec("P")

_STYLE: dict[Any, Any] = {
    "svg.fonttype": "none",  # text stays text: small, searchable, in any letters
    "font.sans-serif": ["DejaVu Sans", "Verdana"],
    "text.parse_math": False,  # a $ in a name is a $
    "axes.formatter.use_mathtext": False,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": 9,
    "axes.labelsize": 8,
    "xtick.labelsize": 7.5,
    "ytick.labelsize": 7.5,
    "legend.fontsize": 7.5,
    "figure.dpi": 150,
    "hatch.linewidth": 0.6,
}


@contextmanager
def drawing() -> Iterator[None]:
    """Draw figures for pages inside, whatever the user's own style is."""
    with mpl.rc_context(), warnings.catch_warnings():
        mpl.rcdefaults()
        mpl.rcParams.update(_STYLE)
        # letters that matplotlib's font lacks are the browser's to draw
        warnings.filterwarnings("ignore", r"Glyph \d+ .* missing from", UserWarning)
        yield


@dataclass(frozen=True)
class SvgFigure:
    """A figure with its caption, as part of a page."""

    svg: str
    """Elements of HTML; texts in it are escaped."""
    caption: str

    def __html__(self) -> str:
        """Return the figure for a page."""
        return rendered("figure.html", figure=self)


def figure(drawn: Figure, name: str, caption: str) -> SvgFigure:
    """Return a figure with its caption, as part of a page.

    Args:
        drawn: The figure, drawn inside ``drawing``.
        name: Its own in the page.
        caption: What it shows.
    """
    buffer = io.BytesIO()
    canvas: Any = FigureCanvasSVG(drawn)
    with drawing(), mpl.rc_context({"svg.hashsalt": name}):  # ids differ from other figures'
        canvas.print_svg(buffer, metadata={"Date": None})  # savefig would draw twice
    picture = _inline(buffer.getvalue())
    for key, value in (("role", "img"), ("aria-label", clean(caption)), ("id", name)):
        picture.set(key, value)
    return SvgFigure(etree.tostring(picture, method="html", encoding="unicode"), caption)


def on_page(name: str) -> Callable[[Callable[P, tuple[Figure, str]]], Callable[P, SvgFigure]]:
    """Return what makes a function that draws a figure and gives its caption a part of a page.

    Args:
        name: The figure's own in the page.
    """

    def decorate(draw: Callable[P, tuple[Figure, str]]) -> Callable[P, SvgFigure]:
        @wraps(draw)
        def drawn(*args: P.args, **kwargs: P.kwargs) -> SvgFigure:
            with drawing():
                made, caption = draw(*args, **kwargs)
                return figure(made, name, caption)

        return drawn

    return decorate


def _inline(svg: bytes) -> Any:
    """Return an SVG as elements of HTML: no namespaces, no ids but those that are used."""
    parser = etree.XMLParser(
        resolve_entities=False, no_network=True, remove_comments=True, huge_tree=True
    )
    root = etree.fromstring(svg, parser)
    used = set()
    for element in list(root.iter()):
        element.tag = etree.QName(element).localname
        for key, value in list(element.attrib.items()):
            del element.attrib[key]
            if key.startswith("{") and etree.QName(key).localname != "href":
                continue
            if value.startswith("data:"):
                value = "".join(value.split())
            element.set(etree.QName(key).localname, value)
            if value.startswith("#"):
                used.add(value[1:])
            elif "url(#" in value:
                used.update(part.split(")")[0] for part in value.split("url(#")[1:])
    for element in list(root.iter("metadata", "style")):
        parent = element.getparent()
        if parent is not None:
            parent.remove(element)
    for element in root.iter():
        if element.get("id", "") not in used | {""}:
            del element.attrib["id"]
    etree.cleanup_namespaces(root)
    for key in ("width", "height", "version"):
        del root.attrib[key]
    return root
