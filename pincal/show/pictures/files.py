"""Figures as files: svg, png or pdf by name, whole or not at all, the same bytes for the same."""

from __future__ import annotations

import io
import re
import warnings
from pathlib import Path

import matplotlib as mpl
from matplotlib.figure import Figure

from pincal.errors import FileError
from pincal.files.output import writing
from pincal.show.pictures.svg import drawing

#: What each format would say about its making.
_SAID = {"svg": ("Date", "Creator"), "png": ("Software",), "pdf": ("CreationDate", "Creator")}


def picture_path(path: str | Path) -> Path:
    """Return the path of a picture if its name ends as a picture's does.

    Raises:
        FileError: it does not.
    """
    path = Path(path)
    if path.suffix[1:].lower() not in _SAID:
        raise FileError(f"{path}: expected a name in .svg, .png or .pdf for a picture")
    return path


def save_figure(drawn: Figure, path: str | Path, *, force: bool = False) -> Path:
    """Write a figure, closely cut, in the format of its name, and return its path.

    Raises:
        FileError: the name ends otherwise, the file exists and ``force`` is not set, or it
            cannot be written.
    """
    path = picture_path(path)
    with writing(path, force=force) as scratch:
        scratch.write_bytes(figure_bytes(drawn, path.suffix[1:].lower()))
    return path


def figure_bytes(drawn: Figure, kind: str) -> bytes:
    """Return a figure as svg, png or pdf; names and dates of its making are left out."""
    buffer = io.BytesIO()
    with drawing(), mpl.rc_context({"svg.hashsalt": "pincal"}):
        warnings.filterwarnings("ignore", r"Glyph \d+ .* missing from", UserWarning)
        drawn.savefig(
            buffer,
            format=kind,
            dpi=150,
            bbox_inches="tight",
            pad_inches=0.05,
            metadata=dict.fromkeys(_SAID[kind]),
        )
    if kind != "svg":
        return buffer.getvalue()
    return re.sub(rb"(?<= )(-?\d+\.\d\d)\d+\b", rb"\1", buffer.getvalue())  # of a point
