"""CSV tables whose headers carry units: ``x [mm]``, ``phi [deg]``, ``leg_1 [rad]``.

Values are SI and radians inside. What pincal writes it reads back bit for bit.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pincal.errors import FileError, MeasurementError
from pincal.model.output import writing

Array = NDArray[np.float64]

#: Units as people write them: dimension, and factor to SI.
UNITS: dict[str, tuple[str, float]] = {
    "m": ("m", 1.0),
    "cm": ("m", 1e-2),
    "mm": ("m", 1e-3),
    "um": ("m", 1e-6),
    "µm": ("m", 1e-6),  # micro sign
    "μm": ("m", 1e-6),  # Greek letter
    "in": ("m", 0.0254),
    "1": ("1", 1.0),
    "rad": ("rad", 1.0),
    "mrad": ("rad", 1e-3),
    "deg": ("rad", np.pi / 180),
    "°": ("rad", np.pi / 180),
}
_HEADER = re.compile(r"^\s*([^\[\]]*?)\s*(?:\[\s*([^\[\]]*?)\s*\])?\s*$")
_MOST_COLUMNS = 1000


@dataclass(frozen=True)
class Table:
    """Rows of text under named columns, as read."""

    path: Path
    units: dict[str, str | None]
    """Unit of each column as written, None where there is none."""
    text: dict[str, list[str]]
    """Cells by column."""
    lines: list[int]
    """Line of the file in which each row ends."""

    def __contains__(self, column: str) -> bool:
        return column in self.units

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
        """Return the numbers of a column as they stand, shape (N,).

        Raises:
            MeasurementError: a cell is not a finite number.
        """
        values = np.array([_number_or_nan(cell) for cell in self.text[column]])
        empty = np.array([blank and not cell.strip() for cell in self.text[column]])
        if not (np.isfinite(values) | empty).all():
            row = int(np.argmin(np.isfinite(values) | empty))
            raise MeasurementError(
                f"{self.path}, line {self.lines[row]}: {self.text[column][row]!r} in column "
                f"{column!r} is not a finite number; correct it or remove the row"
            )
        return values


def _number_or_nan(cell: str) -> float:
    try:
        return np.nan if "_" in cell else float(cell)
    except ValueError:
        return np.nan


def read_table(path: str | Path) -> Table:
    """Return a CSV file's columns as text.

    Raises:
        FileError: the file is missing or cannot be read.
        MeasurementError: no header, no rows, repeated columns, or rows of uneven length.
    """
    path = Path(path)
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            reader = csv.reader(file, strict=True)
            header = next((row for row in reader if any(cell.strip() for cell in row)), None)
            if not header:
                raise MeasurementError(f"{path}: empty; expected a header line and rows")
            units = _header(path, header)
            rows, lines = [], []
            for row in reader:
                if not row or not any(cell.strip() for cell in row):
                    continue
                if len(row) != len(header):
                    raise MeasurementError(
                        f"{path}, line {reader.line_num}: {len(row)} cells under "
                        f"{len(header)} headers; separate cells by commas, decimals by points"
                    )
                rows.append(row)
                lines.append(reader.line_num)
    except OSError as error:
        raise FileError(f"cannot read {path}: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        raise MeasurementError(f"{path}: not UTF-8 text ({error.reason})") from error
    except csv.Error as error:
        raise MeasurementError(f"{path}, line {reader.line_num}: not CSV: {error}") from error
    if not rows:
        raise MeasurementError(f"{path}: a header but no rows")
    columns = zip(*rows, strict=True)
    return Table(path, units, dict(zip(units, map(list, columns), strict=True)), lines)


def _header(path: Path, header: Sequence[str]) -> dict[str, str | None]:
    if len(header) > _MOST_COLUMNS:
        raise MeasurementError(f"{path}: {len(header)} columns; more than {_MOST_COLUMNS}")
    for name, separator in (("semicolons", ";"), ("tabs", "\t")):
        if len(header) == 1 and separator in header[0]:
            raise MeasurementError(
                f"{path}: cells are separated by {name}; separate them by commas"
            )
    units: dict[str, str | None] = {}
    for cell in header:
        match = _HEADER.match(cell)
        if not match or not match[1]:
            raise MeasurementError(
                f"{path}: header {cell!r} is not a name with a unit, such as 'x [mm]'"
            )
        if match[1] in units:
            raise MeasurementError(f"{path}: column {match[1]!r} appears twice")
        units[match[1]] = match[2]
    return units


def write_table(
    path: str | Path,
    columns: Mapping[str, Iterable[float] | Iterable[str]],
    *,
    force: bool = False,
) -> None:
    """Write columns (header to values, SI) to a CSV file, whole or not at all.

    Raises:
        FileError: the file exists and ``force`` is not set, or cannot be written.
    """
    with writing(path, force=force) as scratch, scratch.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        cells = (map(_cell, values) for values in columns.values())
        writer.writerows(zip(*cells, strict=True))


def _cell(value: float | str) -> str:
    if isinstance(value, str):
        return value
    return "" if math.isnan(value) else repr(float(value))
