"""Boards on paper in true size, with a bar to check it; and photos with the points seen in them."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch
from matplotlib.path import Path as Outline

from pincal.errors import MeasurementError
from pincal.instruments.board import CHEQUERED, Board
from pincal.instruments.detect import PhotoPoints
from pincal.show.style import LEGS, OUTLIER, drawing

PAPERS = {
    "a4": (0.210, 0.297),
    "letter": (0.2159, 0.2794),
    "a3": (0.297, 0.420),
    "a2": (0.420, 0.594),
    "a1": (0.594, 0.841),
    "a0": (0.841, 1.189),
}
"""Width and height of papers, [m]."""
_MARGIN, _FOOT = 0.004, 0.018  # [m]; the foot holds the bar and a description of the board
_INCH = 0.0254  # [m]


def board_figure(board: Board, paper: str = "") -> Figure:
    """Return a page that shows a board in true size.

    Without a paper of ``PAPERS`` it is of the smallest A size that fits, or else as large as the
    board.

    Raises:
        MeasurementError: the paper is too small for the board.
    """
    needed = np.add(board.size, (2 * _MARGIN, _MARGIN + _FOOT))
    sizes = [PAPERS[paper]] if paper else [PAPERS[name] for name in PAPERS if name != "letter"]
    turned = [side for size in sizes for side in (size, size[::-1])]
    page = next((np.array(side) for side in turned if (needed - 1e-6 <= side).all()), needed)
    if paper and page is needed:
        width, height = 1e3 * needed
        raise MeasurementError(
            f"the board needs {width:.0f} x {height:.0f} mm, and {paper} is smaller; take smaller "
            "or fewer squares, or another paper"
        )
    x_left, bottom = (page[0] - board.size[0]) / 2, (page[1] + _FOOT - _MARGIN - board.size[1]) / 2
    length = 0.01 * np.floor(min(0.1, 0.5 * page[0]) / 0.01)
    bar = (_MARGIN + 0.002 - x_left, -0.010, length, 0.002)
    x, y, width, height = np.vstack((board.black, bar)).T
    corners = [(x, y), (x + width, y), (x + width, y + height), (x, y + height), (x, y)]
    vertices = np.array(corners).transpose(2, 0, 1).reshape(-1, 2)
    vertices += (x_left, bottom)
    codes = [Outline.MOVETO, *[Outline.LINETO] * 3, Outline.CLOSEPOLY] * len(x)
    marker = f", markers {1e3 * board.marker:g} mm of {board.dictionary}, from {board.first}"
    side = f"{'squares' if board.kind in CHEQUERED else 'cells'} of {1e3 * board.square:g} mm"
    texts = (
        f"The bar is {1e3 * length:.0f} mm long: print at 100 %, measure it.",
        f"{board.name}: {board.kind} {board.squares[0]}x{board.squares[1]}, {side}"
        f"{marker * bool(board.markers)}",
    )
    with drawing():
        figure = Figure(tuple(page / _INCH))
        axes = figure.add_axes((0, 0, 1, 1), xlim=(0, page[0]), ylim=(0, page[1]))
        axes.axis("off")
        axes.add_patch(PathPatch(Outline(vertices, codes), color="black", linewidth=0))
        for number, text in enumerate(texts):
            place = (_MARGIN + 0.005 + length, bottom - 0.0082 - 0.003 * number)
            axes.text(*place, text, fontsize=6.0)
    return figure


_ACROSS, _WIDTH = 4, 3.2  # photos side by side, and the width of each [in]


def contact_sheet(photos: Sequence[PhotoPoints]) -> Figure:
    """Return thumbnails of photos with their used points and the points left out."""
    count = min(_ACROSS, len(photos))
    heights = [photo.size[1] / photo.size[0] for photo in photos]
    rows = -(-len(photos) // count)
    with drawing():
        figure = Figure((count * _WIDTH, rows * (_WIDTH * max(heights) + 0.35)), layout="tight")
        grid = figure.subplots(rows, count, squeeze=False).ravel()
        for axes in grid:
            axes.axis("off")
        for axes, photo in zip(grid, photos, strict=False):
            width, height = photo.size
            axes.imshow(photo.small, cmap="gray", extent=(-0.5, width - 0.5, height - 0.5, -0.5))
            for points, colour in ((photo.omitted, OUTLIER), (photo.points, LEGS[0])):
                places = np.array([(u, v) for u, v, _ in points.values()]).reshape(-1, 2)
                axes.plot(*places.T, "+", color=colour, markersize=4, markeredgewidth=0.8)
            title = f"{photo.name}: {len(photo.points)}"
            title += f", {len(photo.omitted)} left out" * bool(photo.omitted)
            axes.set_title(f"{title}\n{photo.reason[:60]}", fontsize=6, loc="left")
    return figure
