"""Tables beside the measurements: distances between rows, and corners in photographs.

A distance between the platform's places in rows 3 and 17, by calliper on plotted marks or by tape,
is written in row 17: its value in ``distance_1 [mm]``, and 3 in ``distance_1_to``; a distance to
another row in ``distance_2`` and ``distance_2_to``. A table of pairs, ``row a, row b, distance
[mm]``, is converted to such columns. Columns ``dx``, ``dy``, ``dz`` are coordinates of b minus a,
such as heights of steps. Corners have a table of their own, one per line.
"""

import itertools
import logging
import re
from collections import Counter, defaultdict
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from pincal.errors import MeasurementError
from pincal.files.columns import Columns
from pincal.files.table import TextTable, read_table
from pincal.files.text import plain_number
from pincal.model import ROW, TO, Measurements, Setup
from pincal.model.checks import listed
from pincal.types import Array

_log = logging.getLogger(__name__)
_KINDS = ("distance", "dx", "dy", "dz")
_LEADS = re.compile(rf"(distance|d[xyz])(_\w+)?{TO}")
_ENDS = ("row a", "row b")
Pairs = Mapping[tuple[str, str], tuple[str, str]]
"""Columns of u (right) and v (down) by names of camera and point."""
Pixels = dict[str, Array]


def related_columns(table: TextTable) -> tuple[TextTable, dict[str, str]]:
    """Return a table with named rows, and the columns that relate rows, with their units.

    Without a column ``row`` the rows are named 1, 2, ….

    Raises:
        MeasurementError: a row has no name or another row's, or a cell names no other row.
    """
    columns = [name.removesuffix(TO) for name in table.units if _LEADS.fullmatch(name)]
    if not columns:
        return table, {}
    table = _named(table)
    places = {name: row for row, name in enumerate(table.text[ROW])}
    for row, name in enumerate(table.text[ROW]):
        if not name or places[name] != row:
            raise MeasurementError(f"{table.where(row)}: row {name!r}; give each row its own name")
        for column in columns:
            met = table.text[f"{column}{TO}"][row]
            if met and places.get(met, row) == row:
                raise MeasurementError(
                    f"{table.where(row)}: {column}{TO} is {met!r}; expected the name of another "
                    "row, as in the column 'row', or its number if there is none"
                )
    _check_distances(table, [column for column in columns if column.startswith("distance")])
    known = {name: unit for c in columns for name, unit in ((c, "m"), (f"{c}{TO}", ""))}
    return table, {**known, ROW: ""}


def _check_distances(table: TextTable, columns: Sequence[str]) -> None:
    for column in columns:
        for row, cell in enumerate(table.text.get(column, ())):
            if plain_number(cell) <= 0.0:
                raise MeasurementError(
                    f"{table.where(row)}: {column} is {cell}; a distance is above 0 (a height "
                    "above another row is 'dz')"
                )


def _named(table: TextTable) -> TextTable:
    """Return a table with a column ``row`` of names, 1, 2, … if it has none."""
    numbers = [str(1 + row) for row in range(len(table.lines))]
    units, text = {ROW: None, **table.units}, {ROW: numbers, **table.text}
    return replace(table, units=units, text=text)


def with_pairs(measurements: Any, pairs: Any) -> TextTable:
    """Return a table of measurements with additional columns for a table of distances.

    Args:
        measurements: Table of rows, with a column ``row`` of their names, or numbered 1, 2, ….
        pairs: Table with the columns ``row a``, ``row b``, one or more of ``distance [mm]``,
            ``dx [mm]``, ``dy [mm]``, ``dz [mm]`` (of b less a), and ``sigma [mm]`` if known.

    Raises:
        MeasurementError: a column or number is missing, a row does not exist, or a pair was typed
            twice.
    """
    table, typed = _named(read_table(measurements)), read_table(pairs)
    place, hosted = {name: row for row, name in enumerate(table.text[ROW])}, [0] * len(table.lines)
    cells: dict[str, list[str]] = defaultdict(lambda: [""] * len(hosted))
    for a, b, kind, value, sigma in _pairs(typed, place, table.path):
        host, partner = (b, a) if hosted[place[b]] <= hosted[place[a]] else (a, b)
        hosted[place[host]] += 1
        slots = (f"{kind}_{slot}" for slot in itertools.count(1))
        column = next(n for n in slots if n not in table and not cells[n][place[host]])
        reverse = host == a and kind != "distance"
        cells[column][place[host]] = repr(-value if reverse else value)
        cells[f"{column}{TO}"][place[host]] = partner
        if sigma is not None:
            cells[f"sigma_{column}"][place[host]] = repr(sigma)
    units = {name: None if name.endswith(TO) else "m" for name in cells}
    return replace(table, units=table.units | units, text=table.text | cells)


def _pairs(
    table: TextTable, names: Collection[str], measured: Path
) -> Iterator[tuple[str, str, str, float, float | None]]:
    """Yield rows a and b, the kind of distance between them, its value, [m], and its σ or None.

    ``names`` are the rows of the file ``measured``.
    """
    values = {kind: table.numbers(kind, "m", blank=True) for kind in _KINDS if kind in table}
    if missing := [end for end in (*_ENDS, *_KINDS[: not values]) if end not in table]:
        raise MeasurementError(
            f"{table.path}: no column {missing[0]!r}; expected row a, row b, distance [mm]. The "
            f"file has {', '.join(table.units)}"
        )
    sigma = table.numbers("sigma", "m").tolist() if "sigma" in table else [None] * len(table.lines)
    for line in np.flatnonzero(values.get("distance", np.empty(0)) <= 0.0).tolist():
        raise MeasurementError(
            f"{table.where(line)}: a distance is above 0; correct it (a height of row b less "
            "that of row a is 'dz')"
        )
    first: dict[tuple[object, ...], int] = {}
    for line, (a, b) in enumerate(_ends(table, names, measured)):
        filled = {kind: float(column[line]) for kind, column in values.items()}
        for kind, value in ((kind, v) for kind, v in filled.items() if np.isfinite(v)):
            before = first.setdefault((kind, frozenset((a, b)), abs(value)), line)
            if before != line:
                raise MeasurementError(
                    f"{table.where(line)}: the {kind} of rows {a} and {b} is the same as in "
                    f"{table.counted} {table.lines[before]}; a pair typed twice counts twice: "
                    "leave one out (one measured again differs in its last digit)"
                )
            yield a, b, kind, value, sigma[line]
    if not first:
        raise MeasurementError(f"{table.path}: no distance is filled in")


def _ends(table: TextTable, names: Collection[str], measured: Path) -> Iterator[tuple[str, str]]:
    """Yield the names of rows a and b for each line."""
    for line, (a, b) in enumerate(zip(*(table.text[end] for end in _ENDS), strict=True)):
        if a == b or not {a, b} <= {*names}:
            strange = b if a in names else a
            fault = "measured from itself" if a == b else f"no row of {measured}"
            raise MeasurementError(
                f"{table.where(line)}: row {strange!r} is {fault}; expected two rows, by its "
                "column 'row', or by their numbers if it has none"
            )
        yield a, b


def read_corners(setup: Setup, table: TextTable, lines: Sequence[int]) -> tuple[Pixels, Pixels]:
    """Read a setup's table of corners: pixels, and their standard deviations if given, by column.

    Values are for the rows of measurements on ``lines``, NaN where no point was seen. Both are
    empty if the setup has no such table.

    Raises:
        FileError: the table is missing or cannot be read.
        MeasurementError: a row, camera or point is unknown, or a corner appears twice.
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
        """Return quantities for u and v by column of the measurements."""
        spread = np.full((len(lines), len(every)), np.nan)
        for quantity, places in zip(quantities, columns.reshape(-1, 2).T, strict=True):
            spread[np.array(rows)[used], places] = corners.numbers(quantity, "px")[used]
        return dict(zip(every, spread.T, strict=True))

    sigmas = by_column("sigma", "sigma") if "sigma" in corners else {}
    return by_column("u", "v"), sigmas


def corners_of(setup: Setup, data: Measurements) -> Columns:
    """Return the table of corners that a setup's cameras saw, as ``read_corners`` reads it.

    Raises:
        MeasurementError: the cameras saw no corner.
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
    """Return camera and point of each corner; without cameras, each point must have just one."""
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
    """Return the row of the measurements, counted from 0, for each corner."""
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
