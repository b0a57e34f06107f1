"""How drawings look: colours, markers, sizes; figures as files and as parts of pages.

One place for charts, pictures and pages. A figure is drawn and written under one set of
matplotlib's parameters, whole or not at all, the same bytes for the same.
"""

from __future__ import annotations

import io
import re
import warnings
from base64 import b64encode
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib as mpl
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pincal.errors import FileError
from pincal.files.output import writing
from pincal.words.wording import rendered

#: Of legs, and of sets of poses that serve them; all colours here are held apart for people who
#: lack a kind of cone by tests/test_style.py.
LEGS = ("#07a75a", "#0e11a3", "#ac5f71", "#7e7dfe", "#610f0a", "#1a5c4c", "#703e68", "#9f1042")
MARKERS = ("o", "^", "s", "D", "v", "P", "X")
#: What drives: motors, cylinders, winches.
ACTIVE = "#d95e03"
#: Before and after: what nominal parameters say, and what identified ones do.
NOMINAL, IDENTIFIED = "#909090", "#4402fc"
#: Rows that do not fit.
OUTLIER = "#c8091c"
GROUND = "#d4d4d4"
#: Lengths, angles, axes and their names in drawings; poses for every leg.
DIMENSION = EVERY = "#222222"
#: Each colour as it is on a dark ground.
DARK = {
    "#07a75a": "#fdfd0c",
    "#0e11a3": "#b1b7fd",
    "#ac5f71": "#a35448",
    "#7e7dfe": "#04fff4",
    "#610f0a": "#efda81",
    "#1a5c4c": "#c0f3c6",
    "#703e68": "#b6b81e",
    "#9f1042": "#85a862",
    ACTIVE: ACTIVE,
    NOMINAL: "#707070",
    IDENTIFIED: "#9983f9",
    OUTLIER: "#fa7399",
    GROUND: "#3c4148",
    DIMENSION: "#e8e8e8",
}
#: Grounds of pages and drawings, and text on them.
PAPER, INK = ("#ffffff", "#16191d"), ("#222222", "#e8e8e8")
#: Widths of figures in one column and across two, [mm].
COLUMN, PAGE_WIDTH = 80.0, 170.0
RASTER_FROM = 1500  # points from which they are drawn as pixels: a vector picture stays small


def leg_colour(index: int) -> str:
    """Return the colour of a leg, or of a set, by its number."""
    return LEGS[index % len(LEGS)]


def page_figure(
    name: str, draw: Callable[[Axes], object], caption: str, height: float = 5.0
) -> Markup:
    """Return a figure across a page, so many inches high, with its caption, as part of the page."""
    with drawing():
        figure = Figure((PAGE_WIDTH / 25.4, height), layout="constrained")
        draw(figure.subplots())
        svg = b64encode(figure_bytes(figure, "svg", whole=True)).decode()
    return Markup(rendered("figure.html", name=name, svg=svg, caption=caption))


#: What each format would say about its making.
_METADATA = {"svg": ("Date", "Creator"), "png": ("Software",), "pdf": ("CreationDate", "Creator")}
_STYLE: dict[Any, Any] = {
    "svg.hashsalt": "pincal",
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
def drawing() -> Iterator[None]:
    """Draw figures for pages inside, whatever the user's own style is."""
    with mpl.rc_context(), warnings.catch_warnings():
        mpl.rcdefaults()
        mpl.rcParams.update(_STYLE)
        # letters that matplotlib's font lacks are the browser's to draw
        warnings.filterwarnings("ignore", r"Glyph \d+ .* missing from", UserWarning)
        yield


def picture_path(path: str | Path) -> Path:
    """Return the path of a picture; raise a FileError if its name does not end as one's does."""
    path = Path(path)
    if path.suffix[1:].lower() not in _METADATA:
        raise FileError(f"{path}: expected a name in .svg, .png or .pdf for a picture")
    return path


def save_figure(
    drawn: Figure, path: str | Path, *, force: bool = False, whole: bool = False
) -> Path:
    """Write a figure in the format of its name, whole or closely cut, and return its path.

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
    with drawing():
        drawn.savefig(
            buffer, format=kind, dpi=150, metadata=dict.fromkeys(_METADATA[kind]), **closely
        )
    if kind != "svg":
        return buffer.getvalue()
    return re.sub(rb"(?<= )(-?\d+\.\d\d)\d+\b", rb"\1", buffer.getvalue())  # of a point
