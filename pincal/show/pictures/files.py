"""Figures as files and as parts of pages: whole or not at all, the same bytes for the same.

A figure is drawn and written under one set of matplotlib's parameters.
"""

from __future__ import annotations

import io
import re
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
from lxml import etree
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from pincal.errors import FileError
from pincal.files.output import writing
from pincal.show.style import DARK_OF
from pincal.words.wording import clean, rendered

_COLOUR = re.compile(r"#[0-9a-fA-F]{6}\b")


@dataclass(frozen=True)
class SvgFigure:
    """A figure with its caption, as part of a page."""

    svg: str
    """Elements of HTML; texts in it are escaped."""
    caption: str

    def __html__(self) -> str:
        """Return the figure for a page."""
        return rendered("figure.html", figure=self)


def svg_figure(name: str, draw: Callable[[], tuple[Figure, str] | None]) -> SvgFigure | None:
    """Return a figure as part of a page; None where there is nothing to show.

    Args:
        name: The figure's id in the page: ids in it differ from those of other figures.
        draw: Returns the figure and its caption.
    """
    buffer = io.BytesIO()
    with drawing(svg_hashsalt=name):
        if (drawn := draw()) is None:
            return None
        canvas: Any = FigureCanvasSVG(drawn[0])
        canvas.print_svg(buffer, metadata={"Date": None})  # savefig would draw twice
    picture = _inline(buffer.getvalue())
    for key, value in {"role": "img", "aria-label": clean(drawn[1]), "id": name}.items():
        picture.set(key, value)
    return SvgFigure(etree.tostring(picture, method="html", encoding="unicode"), drawn[1])


def _themed(colour: re.Match[str]) -> str:
    """Return a colour as a variable of the page, which has another one on dark ground."""
    hexadecimal = colour[0].lower()
    return f"var(--c{hexadecimal[1:]}, {hexadecimal})" if hexadecimal in DARK_OF else hexadecimal


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
            if (name == "href" or not key.startswith("{")) and (name != "id" or value in used):
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


#: What each format would say about its making.
_METADATA = {"svg": ("Date", "Creator"), "png": ("Software",), "pdf": ("CreationDate", "Creator")}
_STYLE: dict[Any, Any] = {
    "svg.fonttype": "none",  # text stays text: small, searchable, in any letters
    "font.sans-serif": ["DejaVu Sans", "Verdana"],
    "text.parse_math": False,  # a $ in a name is a $
    "axes.formatter.use_mathtext": False,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": 9,
    "axes.titley": 1.0,
    "axes.labelsize": 8,
    "xtick.labelsize": 7.5,
    "ytick.labelsize": 7.5,
    "legend.fontsize": 7.5,
    "figure.dpi": 150,
    "hatch.linewidth": 0.6,
}


@contextmanager
def drawing(**parameters: Any) -> Iterator[None]:
    """Draw figures for pages inside, whatever the user's own style is.

    Args:
        **parameters: Further parameters of matplotlib, ``_`` for the point in their names.
    """
    with mpl.rc_context(), warnings.catch_warnings():
        mpl.rcdefaults()
        mpl.rcParams.update(
            _STYLE | {key.replace("_", "."): value for key, value in parameters.items()}
        )
        # letters that matplotlib's font lacks are the browser's to draw
        warnings.filterwarnings("ignore", r"Glyph \d+ .* missing from", UserWarning)
        yield


def picture_path(path: str | Path) -> Path:
    """Return the path of a picture if its name ends as a picture's does.

    Raises:
        FileError: it does not.
    """
    path = Path(path)
    if path.suffix[1:].lower() not in _METADATA:
        raise FileError(f"{path}: expected a name in .svg, .png or .pdf for a picture")
    return path


def save_figure(
    drawn: Figure, path: str | Path, *, force: bool = False, whole: bool = False
) -> Path:
    """Write a figure in the format of its name, and return its path.

    Args:
        drawn: The figure.
        path: Where to.
        force: Whether to replace what is there.
        whole: Whether it keeps its size; else it is closely cut.

    Raises:
        FileError: the name ends otherwise, the file exists and ``force`` is not set, or it
            cannot be written.
    """
    path = picture_path(path)
    with writing(path, force=force) as scratch:
        scratch.write_bytes(figure_bytes(drawn, path.suffix[1:].lower(), whole=whole))
    return path


def figure_bytes(drawn: Figure, kind: str, *, whole: bool = False) -> bytes:
    """Return a figure as svg, png or pdf; names and dates of its making are left out."""
    buffer = io.BytesIO()
    closely: dict[str, Any] = {} if whole else {"bbox_inches": "tight", "pad_inches": 0.05}
    with drawing(svg_hashsalt="pincal"):
        drawn.savefig(
            buffer, format=kind, dpi=150, metadata=dict.fromkeys(_METADATA[kind]), **closely
        )
    if kind != "svg":
        return buffer.getvalue()
    return re.sub(rb"(?<= )(-?\d+\.\d\d)\d+\b", rb"\1", buffer.getvalue())  # of a point
