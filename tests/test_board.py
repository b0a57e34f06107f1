"""Boards are what they are said to be: in OpenCV's layout, in true size, read back as written."""

from __future__ import annotations

import re
import zlib
from pathlib import Path

import numpy as np
import pytest
from command_line import done, run

from pincal import MeasurementError
from pincal.instruments.board import Board, read_board

cv2 = pytest.importorskip("cv2")


def raster(board: Board, pixels: int) -> np.ndarray:
    """Return the board as a picture with so many pixels a square, 0 black, 255 white."""
    columns, rows = board.squares
    picture = np.full((rows * pixels, columns * pixels), 255, np.uint8)
    scale = pixels / board.square
    for x, y, width, height in np.rint(board.black * scale).astype(int):
        top = rows * pixels - y - height
        picture[top : top + height, x : x + width] = 0
    return picture


@pytest.mark.parametrize("squares", [(5, 7), (4, 6)])
def test_charuco_is_drawn_as_opencv_draws_it(squares: tuple[int, int]) -> None:
    """A ChArUco board has the squares and markers of OpenCV's, its corners under its numbers."""
    board = Board("b", "charuco", squares, 0.03, 0.018)
    words = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_250)
    theirs = cv2.aruco.CharucoBoard(squares, 0.03, 0.018, words)
    size = (squares[0] * 50, squares[1] * 50)
    assert (raster(board, 50) == theirs.generateImage(size)).all()
    places = np.array(list(board.points.values()))
    flipped = theirs.getChessboardCorners() * (1, -1, 1) + (0, squares[1] * 0.03, 0)
    assert np.abs(places - flipped).max() < 1e-7


def test_grid_of_apriltags_is_numbered_as_opencv_numbers_it() -> None:
    """Markers of a grid, and their corners, are those that OpenCV's detector names."""
    board = Board("b", "apriltag", (3, 2), 0.05, 0.04, first=7)
    words = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    picture = cv2.copyMakeBorder(raster(board, 100), *[20] * 4, cv2.BORDER_CONSTANT, value=255)
    corners, numbers, _ = cv2.aruco.ArucoDetector(words).detectMarkers(picture)
    assert sorted(numbers.ravel().tolist()) == list(range(7, 13))
    for corner, number in zip(corners, numbers.ravel(), strict=True):
        for letter, (u, v) in zip("abcd", corner[0], strict=True):
            x, y, _ = board.points[f"b_{number}{letter}"]
            assert np.hypot(u - 20 - x * 2000, v - 20 - (0.1 - y) * 2000) < 1.5


@pytest.mark.parametrize("kind", ["charuco", "chessboard"])
def test_print_has_its_true_size(kind: str, tmp_path: Path) -> None:
    """Squares and bar of the PDF are as long as they are said to be, within a micrometre."""
    file = tmp_path / "board.pdf"
    squares = ["--squares", "8x11", "--square", "25mm"]
    done("board", "--kind", kind, *squares, "-o", file)
    data = file.read_bytes()
    streams = re.findall(rb"stream\r?\n(.*?)\r?\nendstream", data, re.S)
    drawn = max((zlib.decompress(s) for s in streams), key=lambda text: text.count(b" m\n"))
    number = rb"(-?\d+\.?\d*)"
    points = np.array(re.findall(number + rb" " + number + rb" [ml]\b", drawn), float) * 25.4 / 72
    points = points[4:]  # the page
    bar, squares_drawn = points[points[:, 1] < 12], points[points[:, 1] > 12]
    assert np.ptp(bar, axis=0) == pytest.approx((100.0, 2.0), abs=1e-3)
    assert np.ptp(squares_drawn, axis=0) == pytest.approx((200.0, 275.0), abs=1e-3)
    assert b"/MediaBox [ 0 0 595.27" in data  # A4


def test_file_is_read_as_written(tmp_path: Path) -> None:
    """The file beside the drawing gives the same board; a scale moves all points."""
    done("board", "--kind", "aruco", "--squares", "3x4", "--first", 5, "-o", tmp_path / "wall.pdf")
    file = tmp_path / "wall.yaml"
    board = read_board(file)
    assert board == Board("wall", "aruco", (3, 4), 0.025, first=5)
    assert run("board", "-o", tmp_path / "wall.pdf").code == 2  # both exist
    file.write_text(file.read_text().replace("scale: [1.0, 1.0]", "scale: [0.98, 1.01]"))
    scaled = read_board(file).points
    expected = np.array(list(board.points.values())) * (0.98, 1.01, 1.0)
    assert np.allclose(list(scaled.values()), expected, atol=1e-12)


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("square: 0.025", "square: 0.024", "line 16: points.wall_0: the squares place it"),
        ("kind: charuco", "kind: chess", "line 4: board.kind: expected 'charuco' or"),
        ("marker: 0.0175", "marker: 0.03", "the marker within its square"),
        ("  first", "  fist", "did you mean 'first'?"),
    ],
)
def test_faults_of_a_file_are_named(old: str, new: str, told: str, tmp_path: Path) -> None:
    """What is wrong in a board's file is named by line and key."""
    file = tmp_path / "wall.yaml"
    file.write_text(Board("wall", "charuco", (3, 4), 0.025).yaml().replace(old, new))
    with pytest.raises(MeasurementError, match=re.escape(told)):
        read_board(file)


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (["--squares", "8"], "expected two numbers, such as 8x11"),
        (["--kind", "chessboard", "--squares", "8x10"], "upside down"),
        (["--squares", "30x40"], "has no marker 250"),
        (["--square", "40mm", "--paper", "a4"], "needs 328 x 462 mm, and a4 is smaller"),
        (["--dictionary", "9X9"], "no dictionary '9X9'"),
        (["-o", "."], "expected a name in .svg, .png or .pdf"),
    ],
)
def test_boards_that_cannot_be_are_refused(options: list[str], told: str, tmp_path: Path) -> None:
    """What cannot be printed or told apart is refused with what to do, and nothing is written."""
    outcome = run("board", "-o", tmp_path / "board.pdf", *options)
    assert outcome.code == 2
    assert told in outcome.trouble
    assert not list(tmp_path.iterdir())
