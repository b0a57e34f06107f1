"""What photographs show: corners in a table of their own, one a line, for rows of measurements."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np

from pincal.errors import MeasurementError
from pincal.files.columns import Columns
from pincal.files.table import TextTable, read_table
from pincal.model.checks import listed
from pincal.model.measurements import Measurements
from pincal.model.setup import Setup
from pincal.types import Array

_log = logging.getLogger(__name__)
Pairs = Mapping[tuple[str, str], tuple[str, str]]
"""Columns of right and down by the names of camera and point."""
Pixels = dict[str, Array]


def read_corners(setup: Setup, table: TextTable, lines: Sequence[int]) -> tuple[Pixels, Pixels]:
    """Return pixels, and their standard deviations if said, of a setup's table of corners.

    By column, for the rows of the measurements on these lines; NaN where nothing was seen. Both
    empty without such a table.

    Raises:
        FileError: the table is missing or cannot be read.
        MeasurementError: a row, camera or point that there is not, or a corner that is there twice.
    """
    if setup.corners is None:
        return {}, {}
    corners, place = read_table(setup.corners), {line: i for i, line in enumerate(lines)}
    for name, unit in {"point": "", "u": " [px]", "v": " [px]"}.items():
        if name not in corners:
            raise MeasurementError(f"{corners.path}: no column '{name}{unit}' of corners")
    pairs = {
        (device.name, point): pair
        for device in setup.instruments
        for point, pair in getattr(device, "marks", {}).items()
    }
    names = _cameras_and_points(corners, pairs)
    rows = [place.get(table.lines[row], -1) for row in _rows(corners, table)]
    used = np.array([name in pairs and row >= 0 for name, row in zip(names, rows, strict=True)])
    _check_repeats(corners, list(zip(rows, names, strict=True)))
    every = [column for pair in pairs.values() for column in pair]
    columns = np.array([[*map(every.index, pairs[names[i]])] for i in np.flatnonzero(used)])

    def by_column(*quantities: str) -> Pixels:
        """Return numbers of u and v by the columns of their cameras."""
        spread = np.full((len(lines), len(every)), np.nan)
        for quantity, places in zip(quantities, columns.reshape(-1, 2).T, strict=True):
            spread[np.array(rows)[used], places] = corners.numbers(quantity, "px")[used]
        return dict(zip(every, spread.T, strict=True))

    sigmas = by_column("sigma", "sigma") if "sigma" in corners else {}
    return by_column("u", "v"), sigmas


def corners_of(setup: Setup, data: Measurements) -> Columns:
    """Return the table of corners that a setup's cameras saw, as ``read_corners`` reads it.

    Raises:
        MeasurementError: they saw none.
    """
    corners = [
        (row, device.name, point, *(float(data.extra[column][row]) for column in pair))
        for device in setup.instruments
        for point, pair in getattr(device, "marks", {}).items()
        for row in np.flatnonzero(np.isfinite(data.extra[pair[0]])).tolist()
    ]
    if not corners:
        raise MeasurementError("no camera of the setup sees a point at any pose of the plan")
    rows, cameras, points, right, down = zip(*sorted(corners), strict=True)
    named = {"row": tuple(str(row + 1) for row in rows), "camera": cameras, "point": points}
    return {**named, "u [px]": np.array(right), "v [px]": np.array(down)}


def _cameras_and_points(corners: TextTable, pairs: Pairs) -> list[tuple[str, str]]:
    """Return camera and point of each corner; of a point that only one camera may see, it is it."""
    points, cameras = corners.text["point"], corners.text.get("camera")
    if cameras is None:
        of_point = {point: camera for camera, point in pairs}
        cameras = [of_point.get(point, "") for point in points]
        if len(of_point) < len(pairs):
            raise MeasurementError(
                f"{corners.path}: no column 'camera', and several cameras of the setup see the "
                "same points; add it"
            )
    names = list(zip(cameras, points, strict=True))
    strange = {*names} - {*pairs}
    unused = sorted(f"{point} of {camera or 'no camera'}" for camera, point in strange)
    if len(unused) == len({*names}):
        raise MeasurementError(
            f"{corners.path}: no corner is of a point that a camera of the setup sees: there are "
            f"{listed(unused)}; the setup has {listed(f'{p} of {camera}' for camera, p in pairs)}"
        )
    if unused:
        _log.info("%s: corners not used: %s", corners.path, listed(unused))
    return names


def _check_repeats(corners: TextTable, names: Sequence[tuple[int, tuple[str, str]]]) -> None:
    """Raise if a point was seen twice in a row of the measurements by one camera."""
    first = dict[tuple[int, tuple[str, str]], int]()
    for i, name in enumerate(names):
        if (earlier := first.setdefault(name, i)) != i and name[0] >= 0:
            raise MeasurementError(
                f"{corners.where(i)}: point {name[1][1]!r} was seen in this row before, in "
                f"{corners.counted} {corners.lines[earlier]}; leave one of them"
            )


def _rows(corners: TextTable, table: TextTable) -> list[int]:
    """Return the row of the measurements to which each corner belongs, counted from 0."""
    if "row" in corners:
        numbers = corners.plain("row")
        strange = ~np.isin(numbers, np.arange(1, len(table.lines) + 1))
        for i in np.flatnonzero(strange).tolist():
            raise MeasurementError(
                f"{corners.where(i)}: row {numbers[i]:g}; {table.path} has the rows 1 to "
                f"{len(table.lines)}"
            )
        return [int(number) - 1 for number in numbers]
    key = next((key for key in ("image", "pose") if key in corners and key in table), None)
    if key is None:
        raise MeasurementError(
            f"{corners.path}: nothing says to which rows corners belong; add a column 'row', or "
            f"'image' here and in {table.path}"
        )
    counts = Counter(table.text[key])
    for i, name in enumerate(corners.text[key]):
        if (count := counts[name]) != 1:
            raise MeasurementError(
                f"{corners.where(i)}: {key} {name!r} is in {count or 'no'} row{'s' * (count > 1)} "
                f"of {table.path}; expected in one"
            )
    return [table.text[key].index(name) for name in corners.text[key]]
