"""``pincal board`` and ``detect``: printed boards, and their points in photos."""

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import typer

from pincal import MeasurementError
from pincal.cli.app import command, remark, say, stdout, working, wrote
from pincal.cli.options import FORCE, named_after, output_option
from pincal.files.output import writing_together
from pincal.files.table import read_table, write_table
from pincal.instruments.board import SHARE, Board, BoardKind, read_board
from pincal.instruments.detect import PhotoPoints, checked, points_in
from pincal.model.checks import counted, listed
from pincal.option import option
from pincal.show.board import board_figure, contact_sheet
from pincal.show.style import figure_bytes, picture_path

Paper = Literal["a4", "letter", "a3", "a2", "a1", "a0"]


@dataclass(frozen=True)
class BoardOptions:
    """Options of a printed board."""

    kind: BoardKind = option(
        "charuco",
        "charuco and chessboard have points between squares, aruco and apriltag are grids of "
        "markers, markers are to be cut apart.",
    )
    squares: str = option("8x11", "Squares, or markers, along x and y.", metavar="NxM")
    square: float = option(0.025, "Pitch of the squares.", unit="m", needs_unit=True)
    marker: float | None = option(
        None, f"Side of a marker [default: {SHARE} of the pitch].", unit="m", needs_unit=True
    )
    dictionary: str = option(
        "", "OpenCV's dictionary of the markers [default: 4X4_250; APRILTAG_36h11 for apriltag]."
    )
    first: int = option(
        0, "Number of the first marker: boards in one photo must share none.", least=0
    )
    paper: Paper | None = option(None, "Paper [default: the smallest A size that fits].")
    force: bool = option(False, FORCE)


@command
def board(
    output: Annotated[Path, output_option("BOARD.pdf", "PDF or SVG; BOARD.yaml goes beside it.")],
    options: BoardOptions,
) -> None:
    """Draw a board for a camera to see, in true size.

    Print it at 100 %, glue the paper to something flat, and measure the bar by a calliper. Write
    its measured over its nominal length into BOARD.yaml as the scale: all lengths depend on it.
    BOARD.yaml has the points of the board, for 'pincal detect' and for the setup.
    """
    if not (grid := re.fullmatch(r"(\d{1,3})x(\d{1,3})", options.squares)):
        raise MeasurementError(f"--squares {options.squares!r}: expected two numbers, such as 8x11")
    form, described = picture_path(output).suffix[1:].lower(), output.with_suffix(".yaml")
    printed = Board(
        named_after(output.with_suffix("")),
        options.kind,
        (int(grid[1]), int(grid[2])),
        options.square,
        options.marker or 0.0,
        options.dictionary,
        options.first,
    )
    page = board_figure(printed, options.paper or "")
    with writing_together([(output, ()), (described, ())], force=options.force) as (picture, text):
        picture.write_bytes(figure_bytes(page, form, whole=True))
        text.write_text(printed.yaml(), encoding="utf-8")
    width, height = (1e3 * side for side in page.get_size_inches() * 0.0254)
    say(f"{len(printed.points)} points on {width:.0f} x {height:.0f} mm")
    remark(f"print at 100 %, measure the bar, write its scale into {described}")
    wrote(output, described)


@dataclass(frozen=True)
class DetectOptions:
    """Options on the rows and the camera of the photos."""

    rows: Path | None = option(
        None,
        "Measurements to whose rows the photos belong: by the column 'image', or in the order in "
        "which the photos were taken, or else are given (img2 before img10).",
        metavar="CSV",
    )
    camera: str = option("", "Name of the camera, if the setup has several.")
    force: bool = option(False, FORCE)


@command
def detect(
    files: Annotated[
        list[Path], typer.Argument(metavar="BOARD.yaml PHOTO...", help="Boards, then photos.")
    ],
    output: Annotated[Path, output_option("CORNERS.csv", "Table; CORNERS.png is drawn beside it.")],
    options: DetectOptions,
) -> None:
    """Find the points of boards in photos.

    CORNERS.csv has the pixels of each point and their standard deviation; name it in the setup as
    its corners. CORNERS.png shows the points in all photos. Corners that are blurred, small or
    doubtful are left out and listed. Pixels are the sensor's: rotations in EXIF data are ignored.
    """
    boards = [read_board(file) for file in files if file.suffix in (".yaml", ".yml")]
    paths = [file for file in files if file.suffix not in (".yaml", ".yml")]
    if not (boards and paths):
        raise MeasurementError("name a board's file (.yaml, by 'pincal board') and photos of it")
    photos: list[PhotoPoints] = []
    with working("looking at photos", len(paths)) as step:
        for photo in points_in(boards, paths):
            photos.append(photo)
            step(len(photos))
    checked(photos)
    row_of = {} if options.rows is None else _rows(options.rows, photos)
    if not any(photo.points for photo in photos):
        reason, number = Counter(photo.reason for photo in photos).most_common(1)[0]
        raise MeasurementError(f"no photo shows the board: {reason} ({number} of {len(photos)})")
    table, drawn = _table(photos, row_of, options.camera), output.parent / f"{output.stem}.png"
    with writing_together([(output, ()), (drawn, ())], force=options.force) as (corners, sheet):
        write_table(corners, table)
        sheet.write_bytes(figure_bytes(contact_sheet(photos), "png"))
    say(*_left_out(photos))
    used = sum(bool(photo.points) for photo in photos)
    sigma = np.median(np.array(table["sigma [px]"]))
    stdout.print(
        f"{counted(len(table['point']), 'corner')} in {used} of "
        f"{counted(len(photos), 'photo')}, standard deviation {sigma:.3f} px (median)"
    )
    wrote(output, drawn)


def _table(
    photos: Sequence[PhotoPoints], row_of: Mapping[str, int], camera: str
) -> dict[str, list[str] | list[float]]:
    """Return the columns of a table of corners."""
    shown = [(photo, name) for photo in photos for name in photo.points]
    table: dict[str, list[str] | list[float]] = {"image": [photo.name for photo, _ in shown]}
    if row_of:
        table["row"] = [str(row_of[photo.name]) for photo, _ in shown]
    if camera:
        table["camera"] = [camera] * len(shown)
    table["point"] = [name for _, name in shown]
    values = np.array([photo.points[name] for photo, name in shown]).round(4).T.tolist()
    return table | dict(zip(("u [px]", "v [px]", "sigma [px]"), values, strict=True))


def _rows(path: Path, photos: Sequence[PhotoPoints]) -> dict[str, int]:
    """Return the row of the measurements, counted from 1, for each photo, by name or by time.

    A photo that is not in exactly one row loses its points.
    """
    table = read_table(path)
    if "image" not in table:
        return _rows_by_time(path, len(table.lines), photos)
    images = [name.strip() for name in table.text["image"]]
    for photo in photos:
        if images.count(photo.name) != 1:
            photo.reason = f"in {images.count(photo.name) or 'no'} rows of {path.name}"
            photo.points = {}
    names = {photo.name for photo in photos}
    if missing := [name for name in images if name and name not in names]:
        remark(f"rows without their photo: {listed(missing)}")
    return {name: row for row, name in enumerate(images, 1)}


def _rows_by_time(path: Path, rows: int, photos: Sequence[PhotoPoints]) -> dict[str, int]:
    """Return the row for each photo by the order of their times, or else as they are given."""
    if len(photos) != rows:
        raise MeasurementError(
            f"{counted(len(photos), 'photo')} and {counted(rows, 'row')} of {path}: some are "
            "missing, and all that follow would get wrong rows; name the photo of each row in a "
            "column 'image'"
        )
    times = {photo.taken for photo in photos}
    by_time = None not in times and len(times) == rows
    reason = "of their times" if by_time else "given, since not every photo has a time of its own"
    remark(f"photos belong to rows in the order {reason}")
    names, ordered = [photo.name for photo in photos], list(photos)
    if by_time:
        order = np.argsort(np.array([photo.taken for photo in photos], "datetime64[us]"))
        ordered = [photos[place] for place in order]
    elif names == sorted(names):  # as a shell lists them: img10 before img2
        ordered.sort(key=lambda photo: _with_numbers(photo.name))
    return {photo.name: row for row, photo in enumerate(ordered, 1)}


def _with_numbers(name: str) -> list[tuple[int, str]]:
    """Return a key that sorts names by the numbers in them: img2 before img10."""
    pieces = re.split(r"(\d+)", name)
    return [(int(part), "") if part.isdecimal() else (0, part) for part in pieces]


def _left_out(photos: Sequence[PhotoPoints]) -> list[str]:
    """Return a line for each photo that lacks points, with the reasons."""
    lines = []
    for photo in photos:
        if photo.reason:
            lines.append(f"{photo.name}: not used: {photo.reason}")
            continue
        reasons = Counter(reason for *_, reason in photo.omitted.values())
        texts = (f"{number} {reason}" for reason, number in reasons.items())
        lines += [f"{photo.name}: left out: {', '.join(texts)}"] * bool(reasons)
    return lines
