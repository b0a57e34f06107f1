"""Printed boards that cameras see, and the positions of their points.

A board is a grid of cells. In a ChArUco board and a chessboard, every second cell is black, and the
points are the corners between cells; a ChArUco board has markers in its white cells. A grid of
markers has one in each cell, and the points are the corners of the markers. Loose markers are cut
apart, so that only the positions within each marker are known.

The board's frame is at the lower left corner of the grid: x right, y up, z out of the paper.
Markers, and corners of ChArUco boards, are numbered as in OpenCV: by rows, from above.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, TypeAlias, get_args

import lazy_loader
import numpy as np

from pincal.errors import MeasurementError, located
from pincal.files.yaml import Entry, Readers, read_yaml
from pincal.model.checks import count_of
from pincal.types import Array

cv2: Any = lazy_loader.load("cv2")  # imported at the first use

BoardKind: TypeAlias = Literal["charuco", "chessboard", "aruco", "apriltag", "markers"]
CHEQUERED = ("charuco", "chessboard")
DICTIONARIES = {"apriltag": "APRILTAG_36h11", "chessboard": ""}
"""Default dictionary of markers by kind of board; ``4X4_250`` for other kinds."""
SHARE = 0.7
"""Default side of a marker, over the pitch: detection needs the white border around it."""
UNCHECKED = 2e-3
"""Relative standard uncertainty of printed lengths that were not measured."""


@dataclass(frozen=True)
class Board:
    """Printed pattern whose points cameras see.

    >>> from pincal.instruments.board import Board
    >>> board = Board("board", "charuco", (8, 11), 0.025)
    >>> len(board.points), board.points["board_0"]
    (70, (0.025, 0.25, 0.0))
    """

    name: str
    """Prefix of its points' names: ``name_0``, and of markers ``name_12a`` to ``name_12d``,
    clockwise from the upper left corner."""
    kind: BoardKind
    squares: tuple[int, int]
    """Number of cells along x and along y."""
    square: float
    """Pitch of the cells, [m]."""
    marker: float = 0.0
    """Side of a marker, [m]; by default 0.7 of the pitch."""
    dictionary: str = ""
    """Dictionary of the markers: OpenCV's name without ``DICT_``."""
    first: int = 0
    """Number of the first marker; boards in the same photo must not share markers."""
    scale: tuple[float, float] = (1.0, 1.0)
    """Printed length over nominal length, along x and along y."""
    scale_sigma: float = UNCHECKED
    """Relative standard uncertainty of both scales."""

    def __post_init__(self) -> None:
        least = 3 if self.kind in CHEQUERED else 1  # fewer squares have too few corners
        for number in self.squares:
            count_of(number, "number of squares", MeasurementError, least)
        count_of(self.first, "number of the first marker", MeasurementError, 0)
        columns, rows = self.squares
        if self.kind == "chessboard" and (columns + rows) % 2 == 0:
            raise MeasurementError(
                f"a chessboard of {columns}x{rows} squares looks the same upside down; take one "
                f"even number and one odd, such as {columns}x{rows + 1}"
            )
        sizes = np.array([self.square, self.scale_sigma, *self.scale, self.marker or self.square])
        if not ((sizes > 0.0).all() and np.isfinite(sizes).all() and self.marker < self.square):
            raise MeasurementError(
                f"a square of {self.square:g} m, a marker of {self.marker:g} m; expected lengths "
                "above 0, and the marker within its square"
            )
        words = self.dictionary or DICTIONARIES.get(self.kind, "4X4_250")
        object.__setattr__(self, "dictionary", words)
        object.__setattr__(self, "marker", self.marker or round(SHARE * self.square, 9))

    @property
    def size(self) -> tuple[float, float]:
        """Nominal width and height of all cells together, [m]."""
        return self.squares[0] * self.square, self.squares[1] * self.square

    @property
    def clear(self) -> float:
        """Radius around points in which nothing else is printed, [m]."""
        gap = self.square - self.marker
        if self.kind == "charuco":
            return gap / float(np.sqrt(2.0))
        if not self.markers:
            return 0.45 * self.square
        cells = marker_dictionary(self.dictionary).markerSize + 2
        return min(float(np.sqrt(2.0)) * self.marker / cells, gap)

    @cached_property
    def markers(self) -> dict[int, Array]:
        """Corners of each marker by its number, clockwise from the upper left, (4, 2), [m]."""
        columns, rows = self.squares
        if self.kind == "chessboard":
            return {}
        cells = [(r, c) for r in range(rows) for c in range(columns)]
        if self.kind == "charuco":
            cells = [(r, c) for r, c in cells if (r + c) % 2]
        half = self.marker / 2 * np.array([[-1, 1], [1, 1], [1, -1], [-1, -1]])
        centres = [((c + 0.5) * self.square, (rows - r - 0.5) * self.square) for r, c in cells]
        return {self.first + number: centre + half for number, centre in enumerate(centres)}

    @cached_property
    def points(self) -> dict[str, tuple[float, float, float]]:
        """Printed positions of the points by name, in the board's frame, [m]."""
        columns, rows = self.squares
        if self.kind in CHEQUERED:
            steps = [(c, rows - r) for r in range(1, rows) for c in range(1, columns)]
            named = {f"{self.name}_{i}": np.multiply(p, self.square) for i, p in enumerate(steps)}
        else:
            named = {
                f"{self.name}_{number}{letter}": corner
                for number, corners in self.markers.items()
                for letter, corner in zip("abcd", corners, strict=True)
            }
        sx, sy = self.scale
        return {
            name: (round(float(x * sx), 12), round(float(y * sy), 12), 0.0)
            for name, (x, y) in named.items()
        }

    @cached_property
    def black(self) -> Array:
        """Black rectangles of the pattern: x, y, width and height, (n, 4), [m].

        Raises:
            MeasurementError: OpenCV is missing, or does not have the dictionary or a marker.
        """
        columns, rows = self.squares
        side = self.square
        rectangles = [
            (c * side, (rows - r - 1) * side, side, side)
            for r in range(rows)
            for c in range(columns)
            if self.kind in CHEQUERED and (r + c) % 2 == 0
        ]
        words = marker_dictionary(self.dictionary) if self.markers else None
        for number, corners in self.markers.items():
            if words is None or number >= len(words.bytesList):
                raise MeasurementError(
                    f"the dictionary {self.dictionary} has no marker {number}; take fewer squares, "
                    "a lower first marker, or a larger dictionary, such as 5X5_1000"
                )
            cells = words.markerSize + 2
            bit, (x_left, top) = self.marker / cells, corners[0]
            dark = cv2.aruco.generateImageMarker(words, number, cells, borderBits=1) == 0
            for r, row in enumerate(dark):
                turns = np.flatnonzero(np.diff(np.concatenate(([0], row, [0])).astype(int)))
                for start, end in turns.reshape(-1, 2):
                    place = (x_left + start * bit, top - (r + 1) * bit)
                    rectangles.append((*place, (end - start) * bit, bit))
        return np.array(rectangles)

    def yaml(self) -> str:
        """Return the text of the board's file, which ``read_board`` reads."""
        points = "".join(f"  {name}: {list(place)}\n" for name, place in self.points.items())
        return (
            f"pincal_board: 1\nboard:\n  name: {self.name}\n  kind: {self.kind}\n"
            f"  squares: {list(self.squares)}\n  square: {self.square!r}  # metres\n"
            f"  marker: {self.marker!r}\n  dictionary: '{self.dictionary}'\n"
            f"  first: {self.first}  # number of the first marker\n"
            "  # Measured length of the print over what it should be, along x (the bar) and y,\n"
            f"  # corrected by photos; its σ is {UNCHECKED} unmeasured, 0.0003 by calliper.\n"
            f"  scale: {list(self.scale)}\n  scale_sigma: {self.scale_sigma!r}\n"
            "# At scale 1, in metres: x right, y up from the lower left corner of the squares.\n"
            f"points:\n{points}"
        )


def marker_dictionary(name: str) -> Any:
    """Return OpenCV's dictionary of markers of a name without ``DICT_``."""
    try:
        number = getattr(cv2.aruco, f"DICT_{name}", None)
    except ModuleNotFoundError as error:
        raise MeasurementError(
            "boards and photos need OpenCV, which is not installed: python -m pip install "
            "'pincal[camera]'"
        ) from error
    if number is None:
        known = sorted(key[5:] for key in dir(cv2.aruco) if key.startswith("DICT_"))
        raise MeasurementError(f"no dictionary {name!r} of markers; expected {', '.join(known)}")
    return cv2.aruco.getPredefinedDictionary(number)


def read_board(path: str | Path) -> Board:
    """Return the board of a file that ``pincal board`` wrote.

    Raises:
        FileError: the file is missing or cannot be read.
        MeasurementError: the file does not parse, or its points disagree with its squares.
    """
    path = Path(path)
    readers: Readers = {
        "pincal_board": lambda part: part.choice(1),
        "board": lambda part: part.built(Board, *_NEEDED, **_READERS),
        "points": Entry.pairs,
    }
    with located(path, MeasurementError):
        values = read_yaml(path, MeasurementError).values(readers, ("pincal_board", "board"))
        board: Board = values["board"]
        places = replace(board, scale=(1.0, 1.0)).points
        for name, entry in values.get("points", {}).items():
            if not np.allclose(entry.vector(), places.get(name, np.inf), atol=1e-7):
                entry.refuse("the squares place it elsewhere; state the size of a print by 'scale'")
    return board


_NEEDED = ("name", "kind", "squares", "square")
_READERS: dict[str, Callable[[Entry], Any]] = {
    "name": Entry.name,
    "kind": lambda part: part.choice(*get_args(BoardKind)),
    "squares": lambda part: tuple(item.value for item in part.items(2, 2)),
    "first": lambda part: part.value,
    "scale": lambda part: tuple(item.number() for item in part.items(2, 2)),
}
