"""What rows were measured from each other: columns beside the rows, or a table of pairs.

The distance between where the platform stood in rows 3 and 17, by calliper on plotted marks or by
tape, stands in row 17 in ``distance_1 [mm]``, and 3 in ``distance_1_to``; of another row in
``distance_2`` and ``distance_2_to``. A table of pairs, ``row a, row b, distance [mm]``, becomes
such columns. Columns ``dx``, ``dy``, ``dz`` are coordinates of b less those of a: heights of steps.
"""

from __future__ import annotations

import itertools
import re
from collections import defaultdict
from collections.abc import Collection, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from pincal.errors import MeasurementError
from pincal.files.table import TextTable, read_table
from pincal.model.relations import ROW, TO

_KINDS = ("distance", "dx", "dy", "dz")
_LEADS = re.compile(rf"(distance|d[xyz])(_\w+)?{TO}")
_ENDS = ("row a", "row b")


def related_columns(table: TextTable) -> tuple[TextTable, dict[str, str]]:
    """Return a table that names its rows, and its columns that relate them, with their units.

    Rows that no column ``row`` names are called 1, 2, ….

    Raises:
        MeasurementError: a row that is named twice or not at all, or a column that names no other
            row.
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
    known = {name: unit for c in columns for name, unit in ((c, "m"), (f"{c}{TO}", ""))}
    return table, {**known, ROW: ""}


def _named(table: TextTable) -> TextTable:
    """Return a table whose column ``row`` names its rows: 1, 2, … if it does not."""
    numbers = [str(1 + row) for row in range(len(table.lines))]
    units, text = {ROW: None, **table.units}, {ROW: numbers, **table.text}
    return replace(table, units=units, text=text)


def with_pairs(measurements: Any, pairs: Any) -> TextTable:
    """Return a table of measurements with columns of the distances that a table of pairs has.

    Args:
        measurements: Table of rows, with a column ``row`` of their names, or numbered 1, 2, ….
        pairs: Table with the columns ``row a``, ``row b``, one or more of ``distance [mm]``,
            ``dx [mm]``, ``dy [mm]``, ``dz [mm]`` (of b less a), and ``sigma [mm]`` if known.

    Raises:
        MeasurementError: a column or number that is missing, a row that does not exist, a pair that
            was typed twice.
    """
    table, typed = _named(read_table(measurements)), read_table(pairs)
    place = {name: row for row, name in enumerate(table.text[ROW])}
    hosted = [0] * len(table.lines)
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
    """Yield rows a and b, the kind of what is measured between them, it, [m], and its σ if known.

    Rows of names are those of the file ``measured``.
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
    """Yield rows a and b of each line."""
    for line, (a, b) in enumerate(zip(*(table.text[end] for end in _ENDS), strict=True)):
        if a == b or not {a, b} <= {*names}:
            strange = b if a in names else a
            fault = "measured from itself" if a == b else f"no row of {measured}"
            raise MeasurementError(
                f"{table.where(line)}: row {strange!r} is {fault}; expected two rows, by its "
                "column 'row', or by their numbers if it has none"
            )
        yield a, b
