"""Style of charts, pictures and pages: colours, markers, sizes; figures as files or in pages.

Figures are drawn and written with one set of matplotlib's parameters, files whole or not at all;
equal figures give equal bytes.
"""

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

#: Colours of legs, and of sets of poses that serve them. tests/test_style.py checks that all
#: colours here are distinct for people with colour blindness.
LEGS = ("#07a75a", "#0e11a3", "#ac5f71", "#7e7dfe", "#610f0a", "#1a5c4c", "#703e68", "#9f1042")
MARKERS = ("o", "^", "s", "D", "v", "P", "X")
#: Drives: motors, cylinders, winches.
ACTIVE = "#d95e03"
#: Results of nominal parameters, and of identified parameters.
NOMINAL, IDENTIFIED = "#909090", "#4402fc"
#: Rows that do not fit.
OUTLIER = "#c8091c"
GROUND = "#d4d4d4"
#: Lengths, angles, axes and their names in drawings, and poses for every leg.
DIMENSION = EVERY = "#222222"
#: Ground of pages and pictures, and colour of text on it.
PAPER, INK = "#ffffff", "#222222"
PAGE_WIDTH = 170.0  # width of a figure across a page, [mm]


def leg_colour(index: int) -> str:
    """Return the colour of a leg, or of a set, by its number."""
    return LEGS[index % len(LEGS)]


def page_figure(
    name: str, draw: Callable[[Axes], object], caption: str, height: float = 5.0
) -> Markup:
    """Return a figure as HTML across a page, with a caption; ``height`` in inches."""
    with drawing():
        figure = Figure((PAGE_WIDTH / 25.4, height), layout="constrained")
        draw(figure.subplots())
        svg = b64encode(figure_bytes(figure, "svg", whole=True)).decode()
    return Markup(rendered("figure.html", name=name, svg=svg, caption=caption))


#: Metadata by format that would make the bytes depend on date and software.
_METADATA = {"svg": ("Date", "Creator"), "png": ("Software",), "pdf": ("CreationDate", "Creator")}
_STYLE: dict[Any, Any] = {
    "svg.hashsalt": "pincal",
    "svg.fonttype": "none",  # text stays text: small, searchable, in any script
    "font.sans-serif": ["DejaVu Sans", "Verdana"],
    "text.parse_math": False,  # a $ in a name stays a $
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
    """Apply pincal's style to figures drawn inside, whatever the user's own style is."""
    with mpl.rc_context(), warnings.catch_warnings():
        mpl.rcdefaults()
        mpl.rcParams.update(_STYLE)
        # the browser draws letters that matplotlib's font lacks
        warnings.filterwarnings("ignore", r"Glyph \d+ .* missing from", UserWarning)
        yield


def picture_path(path: str | Path) -> Path:
    """Return a picture's path; raise a FileError unless it ends in .svg, .png or .pdf."""
    path = Path(path)
    if path.suffix[1:].lower() not in _METADATA:
        raise FileError(f"{path}: expected a name in .svg, .png or .pdf for a picture")
    return path


def save_figure(
    drawn: Figure, path: str | Path, *, force: bool = False, whole: bool = False
) -> Path:
    """Write a figure in the format of its name, cropped unless ``whole``, and return the path.

    Raises:
        FileError: the name ends otherwise, the file exists and ``force`` is not set, or it
            cannot be written.
    """
    path = picture_path(path)
    with writing(path, force=force) as scratch:
        scratch.write_bytes(figure_bytes(drawn, path.suffix[1:].lower(), whole=whole))
    return path


def figure_bytes(drawn: Figure, kind: str, *, whole: bool = False) -> bytes:
    """Return a figure as svg, png or pdf, without date and software, so that bytes repeat."""
    buffer = io.BytesIO()
    closely: dict[str, Any] = {} if whole else {"bbox_inches": "tight", "pad_inches": 0.05}
    with drawing():
        drawn.savefig(
            buffer, format=kind, dpi=150, metadata=dict.fromkeys(_METADATA[kind]), **closely
        )
    if kind != "svg":
        return buffer.getvalue()
    return re.sub(rb"(?<= )(-?\d+\.\d\d)\d+\b", rb"\1", buffer.getvalue())  # to 0.01 point
