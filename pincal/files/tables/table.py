"""Tables whose headers carry units: columns of text, their numbers in SI, and writing them.

Headers are ``x [mm]``, ``phi [deg]``, ``leg_1 [rad]``. What is written is read back bit for bit.
"""

from __future__ import annotations

import csv
import logging
import math
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pincal.errors import MeasurementError
from pincal.files.input import plain_number, why_no_number
from pincal.files.output import writing
from pincal.files.tables.units import COUNTS, SI, Units, scale_said
from pincal.model.checks import LARGEST
from pincal.model.units import UNITS

Array = NDArray[np.float64]
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Table:
    """Rows of text under named columns, as read."""

    path: Path
    units: dict[str, str | None]
    """Unit of each column as written, None where there is none."""
    text: dict[str, list[str]]
    """Cells by column."""
    lines: list[int]
    """Line of the file in which each row ends, or number of the row of a DataFrame."""
    counted: str = "line"
    """What ``lines`` are: lines, or rows."""
    counts: Mapping[str, float | None] = field(default_factory=dict)
    """Encoder counts of one rad or m, by column that may be in counts; None if not known."""

    @property
    def file_lines(self) -> tuple[int, ...] | None:
        """Line of the file in which each row ends, None if it was no file."""
        return tuple(self.lines) if self.counted == "line" else None

    def where(self, row: int) -> str:
        """Return where a row is: file and line."""
        return f"{self.path}, {self.counted} {self.lines[row]}"

    def __contains__(self, column: str) -> bool:
        return column in self.units

    def where_measured(self, columns: Iterable[str]) -> Table:
        """Return the rows with something in any of some columns; it is said if others are skipped.

        Raises:
            MeasurementError: no row has.
        """
        cells = [self.text[name] for name in columns if name in self]
        rows = enumerate(zip(*cells, strict=True))
        filled = [row for row, texts in rows if any(map(str.strip, texts))]
        skipped = len(self.lines) - len(filled) if cells else 0
        if not skipped:
            return self
        if not filled:
            raise MeasurementError(
                f"{self.path}: nothing was measured and nothing read; fill in the columns"
            )
        _log.info("%s: %d rows without anything measured or read are skipped", self.path, skipped)
        text = {name: [column[row] for row in filled] for name, column in self.text.items()}
        return replace(self, text=text, lines=[self.lines[row] for row in filled])

    def numbers(self, column: str, dimension: str, *, blank: bool = False) -> Array:
        """Return a column in SI units, shape (N,).

        Args:
            column: Name without unit.
            dimension: ``"m"`` or ``"rad"``.
            blank: Whether cells may be empty; they are NaN.

        Raises:
            MeasurementError: the column is missing, has no or a wrong unit, or a cell is
                not a finite number.
        """
        some = " or ".join(f"[{u}]" for u, (kind, _) in UNITS.items() if kind == dimension)
        if column not in self.units:
            raise MeasurementError(
                f"{self.path}: no column {column!r}; expected '{column} [{dimension}]'. The file "
                f"has {', '.join(self.units)}"
            )
        unit = self.units[column]
        if unit == COUNTS and column in self.counts:
            if (by := self.counts[column]) is None:
                raise MeasurementError(
                    f"{self.path}: column {column!r} is in counts; say how many are in one "
                    f"{dimension}, by {scale_said(column, dimension)}"
                )
            return self.plain(column, blank=blank) / by
        if unit is None:
            raise MeasurementError(
                f"{self.path}: column {column!r} has no unit; write it in the header, for example "
                f"'{column} [{dimension}]'"
            )
        if unit not in UNITS or UNITS[unit][0] != dimension:
            raise MeasurementError(
                f"{self.path}: column {column!r} has unit [{unit}]; expected {some}"
            )
        return self.plain(column, blank=blank) * UNITS[unit][1]

    def plain(self, column: str, *, blank: bool = False) -> Array:
        """Return the numbers of a column as they are, shape (N,).

        Raises:
            MeasurementError: a cell is not a finite number, or above ``LARGEST``.
        """
        values = np.array([plain_number(cell) for cell in self.text[column]])
        empty = np.array([blank and not cell.strip() for cell in self.text[column]])
        sound = np.abs(values) <= LARGEST
        if not (sound | empty).all():
            row = int(np.argmin(sound | empty))
            cell = self.text[column][row]
            place = f" in column {column!r}"
            why = (
                why_no_number(cell, "in the header", place)
                if cell.strip()
                else f"empty cell{place}"
            )
            raise MeasurementError(f"{self.where(row)}: {why}; correct it or remove the row")
        return values


def is_dataframe(value: object) -> bool:
    """Return whether something is a pandas DataFrame; pandas is not imported for it."""
    pandas = sys.modules.get("pandas")
    return pandas is not None and isinstance(value, pandas.DataFrame)


def dataframe(columns: Mapping[str, Iterable[float] | Iterable[str]]) -> Any:
    """Return columns (header to values, SI) as a pandas DataFrame.

    Raises:
        MeasurementError: pandas is not installed.
    """
    try:
        import pandas
    except ImportError as error:
        raise MeasurementError(
            "a DataFrame needs the package pandas: python -m pip install 'pincal[pandas]'"
        ) from error
    return pandas.DataFrame({name: list(values) for name, values in columns.items()})


def write_table(
    path: str | Path,
    columns: Mapping[str, Iterable[float] | Iterable[str]],
    *,
    units: Units = SI,
    force: bool = False,
) -> None:
    """Write columns (header to values, SI) to a CSV file, whole or not at all.

    Args:
        path: The file.
        columns: Header with the SI unit, ``x [m]``, to values.
        units: In which units they are written.
        force: Whether to replace the file if it exists.

    Raises:
        FileError: the file exists and ``force`` is not set, or cannot be written.
    """
    with (
        writing(path, force=force) as scratch,
        scratch.open("w", newline="", encoding="utf-8") as file,
    ):
        writer = csv.writer(file, lineterminator="\n")
        columns = units.written(columns)
        writer.writerow(columns)
        cells = (map(cell_of, values) for values in columns.values())
        writer.writerows(zip(*cells, strict=True))


def cell_of(value: float | str) -> str:
    """Return a value as it is written; none is an empty cell."""
    if isinstance(value, str):
        return value
    return "" if math.isnan(value) else repr(float(value))
