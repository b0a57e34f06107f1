"""Tables whose headers carry units: columns of text, their numbers in SI, and writing them.

Headers are ``x [mm]``, ``phi [deg]``, ``leg_1 [rad]``. What is written is read back bit for bit.
"""

from __future__ import annotations

import csv
import io
import logging
import math
import posixpath
import re
import sys
import zipfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from lxml import etree

from pincal.errors import MeasurementError
from pincal.files.output import writing
from pincal.files.text import LARGEST_FILE, plain_number, read_bytes, read_text, why_no_number
from pincal.model.checks import LARGEST, must_be
from pincal.model.units import COUNTS, SI, UNITS, Units, scale_said
from pincal.types import Array

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class TextTable:
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

    def where_measured(self, columns: Iterable[str]) -> TextTable:
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

    def renamed(self, columns: Mapping[str, tuple[str, str]]) -> TextTable:
        """Return the table with other names and units of some columns."""
        units, text = dict(self.units), dict(self.text)
        for column, (name, unit) in columns.items():
            del units[column]
            units[name] = unit
            text[name] = text.pop(column)
        return replace(self, units=units, text=text)

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
        expected = " or ".join(f"[{u}]" for u, (kind, _) in UNITS.items() if kind == dimension)
        if column not in self.units:
            raise MeasurementError(
                f"{self.path}: no column {column!r}; expected '{column} [{dimension}]'. The file "
                f"has {', '.join(self.units)}"
            )
        unit = self.units[column]
        if unit == COUNTS and column in self.counts:
            if (per_unit := self.counts[column]) is None:
                raise MeasurementError(
                    f"{self.path}: column {column!r} is in counts; say how many are in one "
                    f"{dimension}, by {scale_said(column, dimension)}"
                )
            return self.plain(column, blank=blank) / per_unit
        if unit is None:
            raise MeasurementError(
                f"{self.path}: column {column!r} has no unit; write it in the header, for example "
                f"'{column} [{dimension}]'"
            )
        if unit not in UNITS or UNITS[unit][0] != dimension:
            raise MeasurementError(
                f"{self.path}: column {column!r} has unit [{unit}]; expected {expected}"
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


_HEADER = re.compile(r"\w\s*\[[^]]+\]\s*$")
_MOST_COLUMNS = 1000
_CELL = re.compile(r"([A-Z]{1,3})(\d{1,7})")
_MOST_CELLS = 10**7  # of a sheet, empty ones before the last included
#: Files that are no text, and the extra of packages that reads them.
_SHEETS = {".xlsx": "excel", ".xls": "excel", ".ods": "excel", ".parquet": "parquet"}
_SEPARATORS = {";": "semicolons", "\t": "tabs"}
_DECIMAL_COMMA = re.compile(r"[-+]?\d*,\d+(?:[eE][-+]?\d+)?", re.ASCII)
_DECIMAL_POINT = re.compile(r"[-+]?\d*\.\d*(?:[eE][-+]?\d+)?", re.ASCII)


def read_table(source: str | Path | Any) -> TextTable:
    """Return the columns of a CSV file, or of a pandas DataFrame, as text; a table is as it is.

    Raises:
        FileError: the file is missing or cannot be read.
        MeasurementError: no header, no rows, repeated columns, or rows of uneven length.
    """
    if isinstance(source, TextTable):
        return source
    if is_dataframe(source):
        return _of_dataframe(source)
    path = Path(must_be(source, (str, Path), "a CSV file or DataFrame", MeasurementError))
    extra = _SHEETS.get(path.suffix.lower())
    if extra is not None:
        content = _sheet(path, extra)
        if extra == "parquet":
            return replace(_of_dataframe(content), path=path)
        filled = [column for column in zip(*content, strict=True) if any(map(str.strip, column))]
        cells = map(list, zip(*filled, strict=True))
        return _of_rows(path, enumerate(cells, 1), "row", "")
    text = read_text(path, LARGEST_FILE["table"], MeasurementError, pipe=True, otherwise="cp1252")
    separator = _separator(text)
    reader = csv.reader(io.StringIO(text, newline=""), strict=True, delimiter=separator)
    try:
        separated = None if separator == "," else f"cells separated by {_SEPARATORS[separator]}"
        return _of_rows(path, ((reader.line_num, row) for row in reader), "line", separated)
    except csv.Error as error:
        raise MeasurementError(f"{path}, line {reader.line_num}: not CSV: {error}") from error


def _of_rows(
    path: Path, lines: Iterable[tuple[int, list[str]]], counted: str, separated: str | None
) -> TextTable:
    """Return a table of numbered rows of cells: blank ones, headers, and what is below.

    Args:
        path: The file.
        lines: Number and cells of each.
        counted: What the numbers count, ``"line"`` or ``"row"``.
        separated: How cells are separated; None if by commas, which no decimal then has.
    """
    filled = ((n, row) for n, row in lines if any(cell.strip() for cell in row))
    top, header = next(filled, (0, []))
    if not header:
        raise MeasurementError(f"{path}: empty; expected a header line and rows")
    units, numbers, rows = _header(path, header, top, counted), [], []
    for number, row in filled:
        if len(row) != len(header):
            raise MeasurementError(f"{path}{_uneven(row, number, header, top)}")
        rows.append(row)
        numbers.append(number)
    if not rows:
        raise MeasurementError(f"{path}: a header but no rows")
    notes = [separated] if separated else []
    notes += ["decimal commas"] if separated is not None and _with_points(rows) else []
    if notes:
        _log.info("%s: %s", path, ", ".join(notes))
    columns = zip(*rows, strict=True)
    text = dict(zip(units, map(list, columns), strict=True))
    return TextTable(path, units, text, numbers, counted)


def _sheet(path: Path, extra: str) -> Any:
    """Return the text of the first sheet of a spreadsheet, row by row, or a Parquet file.

    Raises:
        FileError: the file is missing or cannot be read.
        MeasurementError: it is none of its kind, too large, or the package that reads it is not
            installed.
    """
    data = read_bytes(path, LARGEST_FILE["table"], MeasurementError)
    try:
        if extra == "parquet":
            import pandas

            return pandas.read_parquet(path)
        from python_calamine import load_workbook

        flaws = _flaws(path, data) if zipfile.is_zipfile(io.BytesIO(data)) else {}
        sheet = load_workbook(path).get_sheet_by_index(0)
        rows = [list(map(_text_in, row)) for row in sheet.to_python(skip_empty_area=False)]
    except ImportError as error:
        raise MeasurementError(
            f"{path}: such files are read with the extra {extra!r}: python -m pip install "
            f"'pincal[{extra}]'; or save the table as CSV"
        ) from error
    except MeasurementError:
        raise
    except Exception as error:  # each package has its own
        kind = path.suffix.lower()
        raise MeasurementError(f"{path}: no {kind} file: {error}") from error
    height = max([len(rows), *(row + 1 for row, _ in flaws)])
    width = max([0, *map(len, rows), *(column + 1 for _, column in flaws)])
    rows = [[*row, *[""] * (width - len(row))] for row in (*rows, *[[]] * (height - len(rows)))]
    for (row, column), flaw in flaws.items():
        rows[row][column] = flaw
    return rows


def _text_in(value: object) -> str:
    """Return a cell of a spreadsheet, where all numbers have decimals, as it would be in a file."""
    return _text(int(value) if isinstance(value, float) and value.is_integer() else value)


def _flaws(path: Path, data: bytes) -> dict[tuple[int, int], str]:
    """Return what stands in cells of an .xlsx file's first sheet that have no value, by place.

    Readers of such files take errors (``#DIV/0!``) and formulas that were never computed for empty
    cells, and take memory for all cells up to the last one, however far it is.

    Raises:
        MeasurementError: the last cell is too far from the first.
    """
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        if "xl/workbook.xml" not in archive.namelist():
            return {}
        title, name = _first_sheet(archive)
        if archive.getinfo(name).file_size > LARGEST_FILE["table"]:
            raise MeasurementError(f"{path}: its sheet is larger than 256 MiB; save it as CSV")
        height, width, flaws = 0, 0, {}
        with archive.open(name) as sheet:
            for _, cell in etree.iterparse(sheet, tag="{*}c", resolve_entities=False):
                row, column = _place(cell)
                place = f"in cell {cell.get('r', f'R{row}C{column}')} of sheet {title}"
                height, width = max(height, row), max(width, column)
                if height * width > _MOST_CELLS:
                    raise MeasurementError(
                        f"{path}: something stands {place}, too far from the other cells to be "
                        "read; delete the rows and columns beyond the table"
                    )
                value, kind = cell.findtext("{*}v"), cell.get("t")
                if kind == "e":
                    flaws[row - 1, column - 1] = f"{value} {place}"
                elif cell.find("{*}f") is not None and not value and kind != "str":
                    flaws[row - 1, column - 1] = f"formula that was never computed {place}"
                cell.clear(keep_tail=False)
    return flaws


def _first_sheet(archive: zipfile.ZipFile) -> tuple[str, str]:
    """Return the title of an .xlsx file's first sheet, and where it is in the archive."""
    book = etree.fromstring(archive.read("xl/workbook.xml"))
    sheet = next(book.iterfind(".//{*}sheet"))
    relations = etree.fromstring(archive.read("xl/_rels/workbook.xml.rels"))
    (target,) = (item.get("Target", "") for item in relations if item.get("Id") in sheet.values())
    return sheet.get("name", ""), posixpath.normpath(posixpath.join("/xl", target)).lstrip("/")


def _place(cell: etree._Element) -> tuple[int, int]:
    """Return row and column of a cell, from 1: by its reference, or by where it stands."""
    if match := _CELL.fullmatch(cell.get("r", "")):
        letters = reversed(match[1])
        return int(match[2]), sum((ord(c) - 64) * 26**k for k, c in enumerate(letters))
    parent = cell.getparent()
    if parent is None:
        return 1, 1
    return sum(1 for _ in parent.itersiblings(preceding=True)) + 1, parent.index(cell) + 1


def _separator(text: str) -> str:
    """Return what separates cells: commas, unless the header has none but semicolons or tabs."""
    header = next((line for line in text.splitlines() if line.strip()), "")
    if "," in header:
        return ","
    return next((separator for separator in _SEPARATORS if separator in header), ",")


def _with_points(rows: list[list[str]]) -> bool:
    """Write decimal points for decimal commas if no cell has points; return whether it was so."""
    cells = [cell for row in rows for cell in row]
    commas = any(_DECIMAL_COMMA.fullmatch(cell.strip()) for cell in cells)
    if not commas or any(_DECIMAL_POINT.fullmatch(cell.strip()) for cell in cells):
        return False
    for row in rows:
        row[:] = [
            cell.replace(",", ".") if _DECIMAL_COMMA.fullmatch(cell.strip()) else cell
            for cell in row
        ]
    return True


def _of_dataframe(frame: Any) -> TextTable:
    path = Path("DataFrame")
    units = _header(path, [str(name) for name in frame.columns], 1, "line")
    if frame.empty:
        raise MeasurementError(f"{path}: no rows")
    columns = (list(map(_text, frame.iloc[:, i].tolist())) for i in range(len(units)))
    rows = list(range(1, len(frame) + 1))
    return TextTable(path, units, dict(zip(units, columns, strict=True)), rows, "row")


def _text(value: object) -> str:
    """Return a cell of a DataFrame as it would be in a file."""
    if isinstance(value, float):
        return cell_of(value)
    missing = value is None or type(value).__name__ in ("NAType", "NaTType")
    return "" if missing else str(value)


def _uneven(row: list[str], line: int, header: list[str], top: int) -> str:
    """Return what is wrong with a row that is not as long as the header."""
    if any(_HEADER.search(cell) for cell in row) or (len(header) == 1 and len(row) > 2):
        return (
            f", line {top} is taken for the header ({', '.join(header)[:60]!r}), but line {line} "
            f"has {len(row)} cells; remove the lines above the header, or comments and titles"
        )
    if len(row) > len(header) and not any(cell.strip() for cell in row[len(header) :]):
        return (
            f", line {line}: {len(row)} cells under {len(header)} headers, the last ones empty; "
            "remove the commas at the end of the row"
        )
    return (
        f", line {line}: {len(row)} cells under {len(header)} headers; separate cells by commas, "
        "decimals by points"
    )


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
