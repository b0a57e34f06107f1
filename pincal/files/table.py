"""Tables with units in their headers, CSV or .xlsx: columns of text, numbers in SI; writing them.

Headers are ``x [mm]``, ``phi [deg]``, ``leg_1 [rad]``. Written numbers are read back bit for bit.
"""

from __future__ import annotations

import csv
import io
import logging
import re
import warnings
import zipfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain, islice
from pathlib import Path
from typing import Any

import lazy_loader
import numpy as np

from pincal.errors import FileError, MeasurementError
from pincal.files.output import OTHER_TABLES, writing
from pincal.files.text import (
    LARGEST_FILE,
    Numeral,
    in_plain_digits,
    plain_number,
    read_bytes,
    read_text,
    why_no_number,
)
from pincal.model.checks import LARGEST, must_be
from pincal.types import Array
from pincal.words.numbers import COUNTS, SCALE, SI, UNITS, Units

openpyxl: Any = lazy_loader.load("openpyxl")
xlsxwriter: Any = lazy_loader.load("xlsxwriter")
_log = logging.getLogger(__name__)
_HEADER = re.compile(r"\w\s*\[[^]]+\]\s*$")
_SEPARATORS = {";": "semicolons", "\t": "tabs"}
_MOST_COLUMNS, _MOST_ROWS = 1000, 2**20  # columns and rows of a sheet
_MOST_TITLES = 30  # most rows above the headers


@dataclass(frozen=True)
class TextTable:
    """Rows of text under named columns, as read."""

    path: Path
    units: dict[str, str | None]
    """Unit of each column as written, None if it has none."""
    text: dict[str, list[str]]
    """Cells by column."""
    lines: list[int]
    """Line of the file in which each row ends, or row number of a sheet."""
    counted: str = "line"
    """Whether ``lines`` count each a ``"line"`` or a ``"row"``."""
    counts: Mapping[str, float | None] = field(default_factory=dict)
    """Encoder counts per rad or m, by column that may be in counts; None if not known."""

    @property
    def file_lines(self) -> tuple[int, ...] | None:
        """Line of the file in which each row ends; None if the table is no text file."""
        return tuple(self.lines) if self.counted == "line" else None

    def where(self, row: int) -> str:
        """Return the place of a row, file and line, for messages."""
        return f"{self.path}, {self.counted} {self.lines[row]}"

    def __contains__(self, column: str) -> bool:
        return column in self.units

    def where_measured(self, columns: Iterable[str]) -> TextTable:
        """Return the rows with a value in any of some columns; log how many are skipped."""
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

    def array(
        self, units: Mapping[str, str], *, blank: bool = False, optional: bool = False
    ) -> Array:
        """Return columns in SI units, (N, n); NaN for blank cells and missing optional columns."""
        array = np.full((len(self.lines), len(units)), np.nan)
        for place, (name, unit) in enumerate(units.items()):
            if name in self or not optional:
                array[:, place] = self.numbers(name, unit, blank=blank)
        return array

    def numbers(self, column: str, dimension: str, *, blank: bool = False) -> Array:
        """Return a column in SI units, (N,); NaN where blank; only dimension "1" needs no unit."""
        unit, header, fault = self.units.get(column), f"'{column} [{dimension}]'", ""
        kind, factor = UNITS.get(unit or "1", ("", 1.0))
        per_unit = self.counts.get(column) if unit == COUNTS else None
        if column not in self:
            fault = f"no column {column!r}; expected {header}. The file has {', '.join(self.units)}"
        elif unit is None and dimension != "1":
            fault = f"column {column!r} has no unit; write it in the header, for example {header}"
        elif unit == COUNTS and column in self.counts and per_unit is None:
            fault = f"column {column!r} is in counts, of unknown number per {dimension}: {SCALE}"
        elif kind != dimension and per_unit is None:
            expected = " or ".join(f"[{u}]" for u, (kind, _) in UNITS.items() if kind == dimension)
            fault = f"column {column!r} has unit [{unit}]; expected {expected}"
        if fault:
            raise MeasurementError(f"{self.path}: {fault}")
        values = self.plain(column, blank=blank)
        return values * factor if per_unit is None else values / per_unit

    def plain(self, column: str, *, blank: bool = False) -> Array:
        """Return the numbers of a column without conversion, shape (N,)."""
        values = np.array([plain_number(cell) for cell in self.text[column]])
        for row in np.flatnonzero(~(np.abs(values) <= LARGEST)):
            cell, place = self.text[column][row], f" in column {column!r}"
            if cell.strip():
                fault = why_no_number(cell, "in the header", place)
            elif blank:
                continue
            else:
                fault = f"empty cell{place}"
            raise MeasurementError(f"{self.where(int(row))}: {fault}; correct it or remove the row")
        return values


def write_table(
    path: str | Path,
    columns: Mapping[str, Iterable[float] | Iterable[str]],
    *,
    units: Units = SI,
    force: bool = False,
) -> None:
    """Write columns (header with SI unit, ``x [m]``, to values) to a CSV or .xlsx file.

    See ``writing``.
    """
    columns = units.written(columns)
    with writing(path, force=force) as scratch:
        cells = (map(cell_text, values) for values in columns.values())
        rows = [list(columns), *map(list, zip(*cells, strict=True))]
        if Path(path).suffix.lower() == ".xlsx":
            _write_book(scratch, rows)
            return
        with scratch.open("w", newline="", encoding="utf-8") as file:
            csv.writer(file, lineterminator="\n").writerows(rows)


def cell_text(value: object) -> str:
    """Return the text of a value in a file; a missing value is an empty cell."""
    if isinstance(value, float):
        return "" if np.isnan(value) else Numeral(float(value))
    return "" if value is None else str(value)


def read_table(source: Any) -> TextTable:
    """Return the columns of a CSV or .xlsx file as text."""
    if isinstance(source, TextTable):
        return source
    path = Path(must_be(source, (str, Path), "a table", MeasurementError, "a CSV file"))
    suffix = path.suffix.lower()
    if suffix == ".xlsx":
        return _of_rows(path, _sheet_rows(path), "row", "")
    if suffix in OTHER_TABLES:
        raise MeasurementError(
            f"{path}: {suffix} files are not read; save the table as {OTHER_TABLES[suffix]}"
        )
    return _of_csv(path)


def _of_csv(path: Path) -> TextTable:
    """Return the table of a CSV file; its header shows whether ``,``, ``;`` or tabs separate."""
    text = read_text(path, LARGEST_FILE["table"], MeasurementError, pipe=True, otherwise="cp1252")
    begun = [line for line in text.splitlines() if line.strip()][:_MOST_TITLES]
    head = next((line for line in begun if "[" in line), next(iter(begun), ""))
    separator = next((sign for sign in (",", *_SEPARATORS) if sign in head), ",")
    reader = csv.reader(io.StringIO(text, newline=""), strict=True, delimiter=separator)
    try:
        separated = None if separator == "," else f"cells separated by {_SEPARATORS[separator]}"
        return _of_rows(path, ((reader.line_num, row) for row in reader), "line", separated)
    except csv.Error as error:
        raise MeasurementError(f"{path}, line {reader.line_num}: not CSV: {error}") from error


def _of_rows(
    path: Path, lines: Iterable[tuple[int, list[str]]], counted: str, separated: str | None
) -> TextTable:
    """Return the table of numbered rows; commas are not decimal if they separate cells (None)."""
    filled = ((n, row) for n, row in lines if any(cell.strip() for cell in row))
    above = list(islice(filled, _MOST_TITLES))
    if not above:
        raise MeasurementError(f"{path}: empty; expected a header line and rows")
    titles = _titles([row for _, row in above])
    top, header = above[titles]
    units, numbers, rows = _header(path, header, top, counted), [], []
    for number, row in chain(above[titles + 1 :], filled):
        if len(row) != len(header):
            raise MeasurementError(f"{path}{_uneven(row, number, header, top)}")
        rows.append(row)
        numbers.append(number)
    if not rows:
        raise MeasurementError(f"{path}: a header but no rows")
    notes = [separated] if separated else []
    notes += [f"{titles} {counted}s above the headers skipped"] if titles else []
    notes += in_plain_digits(rows, [*units.values()], commas=separated is not None)
    if notes:
        _log.info("%s: %s", path, ", ".join(notes))
    text = dict(zip(units, map(list, zip(*rows, strict=True)), strict=True))
    return TextTable(path, units, text, numbers, counted)


def _titles(rows: Sequence[Sequence[str]]) -> int:
    """Return the number of title rows above the headers; titles have no units or just one cell."""
    headed = (n for n, row in enumerate(rows) if any(map(_HEADER.search, row)))
    several = (n for n, row in enumerate(rows) if sum(bool(cell.strip()) for cell in row) > 1)
    return next(headed, next(several, 0))


def _write_book(path: Path, rows: Sequence[Sequence[str]]) -> None:
    """Write rows of text to an .xlsx file, the first bold, cells to measure coloured.

    The file is made in memory: only ``path`` is written. A table that is too large for a sheet is
    a FileError.
    """
    data, as_text = io.BytesIO(), {"strings_to_formulas": False, "strings_to_urls": False}
    with xlsxwriter.Workbook(data, {"in_memory": True, **as_text}) as book:
        sheet = book.add_worksheet("measure")
        sheet.freeze_panes(1, 0)
        bold, to_measure = book.add_format({"bold": True}), book.add_format({"bg_color": "#FFF2CC"})
        for column, head in enumerate(rows[0]):
            sheet.set_column(column, column, max(8, len(head) + 2))
            for number, text in enumerate(texts[column] for texts in rows):
                style = to_measure if not text and "[" in head else None
                value = plain_number(text)
                cell = value if np.isfinite(value) else text
                if sheet.write(number, column, cell, style if number else bold):
                    raise FileError(f"a sheet holds {_MOST_ROWS} rows at most; name a .csv file")
    path.write_bytes(data.getvalue())


def _sheet_rows(path: Path) -> Iterator[tuple[int, list[str]]]:
    """Yield number and cells of each row of an .xlsx file's first sheet, without blank columns.

    A cell with an error (``#DIV/0!``), or a formula that was never computed, says so: it is not
    empty.
    """
    data = io.BytesIO(read_bytes(path, LARGEST_FILE["table"], MeasurementError))
    rows: dict[int, dict[int, str]] = {}
    try:
        with warnings.catch_warnings(action="ignore"), zipfile.ZipFile(data) as archive:
            if sum(part.file_size for part in archive.infolist()) > LARGEST_FILE["table"]:
                raise MeasurementError("its sheet is larger than 256 MiB; save it as CSV")
            read = []
            for computed in (True, False):
                book = openpyxl.load_workbook(data, read_only=True, data_only=computed)
                book.worksheets[0].reset_dimensions()  # as the file says them they may be wrong
                read.append(book.worksheets[0].iter_rows(max_row=_MOST_ROWS))
            for cells in zip(*read, strict=True):
                for value, formula in zip(*cells, strict=True):
                    if text := _cell_of(value, formula):
                        rows.setdefault(value.row, {})[value.column] = text
    except MeasurementError as error:
        raise MeasurementError(f"{path}: {error}") from error
    except Exception as error:  # openpyxl declares no errors for files of other kinds
        raise MeasurementError(f"{path}: no .xlsx file: {error}") from error
    columns = sorted({column for row in rows.values() for column in row})
    for number in sorted(rows):
        yield number, [rows[number].get(column, "") for column in columns]


def _cell_of(value: Any, formula: Any) -> str:
    """Return a cell's text; the two arguments are the cell with its value and with its formula."""
    text = "" if value.value is None else str(value.value).strip()
    uncomputed = formula.data_type == "f" and not text and value.data_type != "str"
    if uncomputed or (text and value.column > _MOST_COLUMNS) or value.data_type == "e":
        place = f"in cell {value.coordinate} of sheet {value.parent.title}"
        if value.column > _MOST_COLUMNS:
            raise MeasurementError(
                f"something stands {place}, too far from the other cells to be read; delete the "
                "rows and columns beyond the table"
            )
        return f"{text or 'formula that was never computed'} {place}"
    return Numeral(text) if value.data_type == "n" else text


def renamed(table: TextTable, headers: Mapping[str, str]) -> TextTable:
    """Return a table whose columns are renamed to headers such as ``leg_1 [mm]``.

    A header without a unit keeps the unit of the column. ``A`` also names the column ``A (mm)``.

    Raises:
        MeasurementError: the table does not have a column, or two get the same name.
    """
    names = {name: (name, unit) for name, unit in table.units.items()}
    bare = {name.partition("(")[0].strip(): name for name in table.units}
    for typed, header in headers.items():
        column = typed if typed in names else bare.get(typed, typed)
        if column not in names:
            raise MeasurementError(
                f"{table.path}: no column {column!r}, which is to be {header!r}. The file has "
                f"{', '.join(table.units)}"
            )
        name, _, unit = (part.strip() for part in header.partition("["))
        behind = column.partition("(")[2].rstrip(") ")
        unit = unit.removesuffix("]") or table.units[column] or behind * (behind in UNITS)
        names[column] = name, unit or None
    if len(units := dict(names.values())) < len(names):
        raise MeasurementError(f"{table.path}: {dict(headers)} gives two columns the same name")
    text = {names[column][0]: cells for column, cells in table.text.items()}
    return replace(table, units=units, text=text)


def _uneven(row: list[str], line: int, header: list[str], top: int) -> str:
    """Return the fault of a row that is not as long as the header, for a message."""
    if any(_HEADER.search(cell) for cell in row):
        return (
            f", line {top} is taken for the header ({', '.join(header)[:60]!r}), but line {line} "
            f"has {len(row)} cells; remove the lines above the header, or comments and titles"
        )
    counts = f", line {line}: {len(row)} cells under {len(header)} headers"
    if len(row) > len(header) and not any(cell.strip() for cell in row[len(header) :]):
        return f"{counts}, the last ones empty; remove the commas at the end of the row"
    return f"{counts}; separate cells by commas, decimals by points"


def _header(path: Path, header: Sequence[str], line: int, counted: str) -> dict[str, str | None]:
    if len(header) > _MOST_COLUMNS:
        raise MeasurementError(f"{path}: {len(header)} columns; more than {_MOST_COLUMNS}")
    units: dict[str, str | None] = {}
    if nameless := [index + 1 for index, cell in enumerate(header) if not cell.strip()]:
        raise MeasurementError(
            f"{path}: column {nameless[0]} has no header in {counted} {line}, which is taken for "
            f"the headers; name the column or remove it, and remove {counted}s above the headers"
        )
    for cell in header:
        name, bracket, unit = (part.strip() for part in cell.strip().partition("["))
        inner = unit.removesuffix("]")
        if not name or set("[]") & {*name, *inner} or bool(bracket) != (inner != unit):
            raise MeasurementError(
                f"{path}: header {cell!r} is not a name with a unit, such as 'x [mm]'"
            )
        if name in units:
            raise MeasurementError(f"{path}: column {name!r} appears twice")
        units[name] = inner.strip() if bracket else None
    return units
