"""Boards, and what photos show of them: ``pincal board``, ``pincal detect``."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from pincal import MeasurementError
from pincal.cli.app import command, remark, say, wrote
from pincal.cli.options import FORCE, named_after, output_option
from pincal.files.output import writing_together
from pincal.instruments.board import SHARE, Board, BoardKind
from pincal.model.option import option
from pincal.show.pictures.board import board_figure
from pincal.show.pictures.files import figure_bytes, picture_path

Paper = Literal["a4", "letter", "a3", "a2", "a1", "a0"]


@dataclass(frozen=True)
class BoardOptions:
    """What is printed."""

    kind: BoardKind = option(
        "charuco",
        "charuco and chessboard have points between squares, aruco and apriltag are grids of "
        "markers, markers are to be cut apart.",
    )
    squares: str = option("8x11", "Squares, or markers, along x and y.", metavar="NxM")
    square: float = option(0.025, "Pitch of the squares.", unit="m", needs_unit=True)
    marker: float | None = option(
        None, f"Side of a marker; {SHARE} of the pitch if not given.", unit="m", needs_unit=True
    )
    dictionary: str = option(
        "", "Of the markers, by OpenCV's name; 4X4_250, or APRILTAG_36h11, if not given."
    )
    first: int = option(
        0, "Number of the first marker: boards in one photo must share none.", least=0
    )
    paper: Paper | None = option(None, "Paper; the smallest A size that fits, if not given.")
    force: bool = option(False, FORCE)


@command
def board(
    output: Annotated[Path, output_option("BOARD.pdf", "PDF or SVG; BOARD.yaml goes beside it.")],
    options: BoardOptions,
) -> None:
    """Draw a board for a camera to see, in true size.

    Print it at 100 %, on paper that is glued to something flat, and measure the bar by a calliper:
    what it is longer or shorter goes into BOARD.yaml as its scale, which all measured lengths
    follow. BOARD.yaml has the points of the board, for 'pincal detect' and for the setup.
    """
    if not (grid := re.fullmatch(r"(\d{1,3})x(\d{1,3})", options.squares)):
        raise MeasurementError(f"--squares {options.squares!r}: expected two numbers, such as 8x11")
    printed = Board(
        named_after(output.with_suffix("")),
        options.kind,
        (int(grid[1]), int(grid[2])),
        options.square,
        options.marker or 0.0,
        options.dictionary,
        options.first,
    )
    form, described = picture_path(output).suffix[1:].lower(), output.with_suffix(".yaml")
    page = board_figure(printed, options.paper or "")
    outputs: list[tuple[Path, tuple[str, ...]]] = [(output, ()), (described, ())]
    with writing_together(outputs, force=options.force) as (picture, text):
        picture.write_bytes(figure_bytes(page, form, whole=True))
        text.write_text(printed.yaml(), encoding="utf-8")
    width, height = (1e3 * side for side in page.get_size_inches() * 0.0254)
    say(f"{len(printed.points)} points on {width:.0f} x {height:.0f} mm")
    remark(f"print at 100 %, measure the bar, write its scale into {described}")
    wrote(output, described)
