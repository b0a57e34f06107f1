"""Sheets of .xlsx files: rows of text, read from the first sheet, or written to be filled in."""

from __future__ import annotations

import io
import warnings
import zipfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import lazy_loader
import numpy as np

from pincal.errors import FileError, MeasurementError
from pincal.files.text import LARGEST_FILE, Numeral, plain_number, read_bytes

if TYPE_CHECKING:
    import openpyxl
    import xlsxwriter
else:
    openpyxl, xlsxwriter = map(lazy_loader.load, ("openpyxl", "xlsxwriter"))

MOST_COLUMNS, _MOST_ROWS = 1000, 2**20


def write_book(path: Path, rows: Sequence[Sequence[str]]) -> None:
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


def sheet_rows(path: Path) -> Iterator[tuple[int, list[str]]]:
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
                    if text := _text(value, formula):
                        rows.setdefault(value.row, {})[value.column] = text
    except MeasurementError as error:
        raise MeasurementError(f"{path}: {error}") from error
    except Exception as error:  # what openpyxl makes of other files is not declared
        raise MeasurementError(f"{path}: no .xlsx file: {error}") from error
    columns = sorted({column for row in rows.values() for column in row})
    for number in sorted(rows):
        yield number, [rows[number].get(column, "") for column in columns]


def _text(value: Any, formula: Any) -> str:
    """Return what a cell holds as text, of which ``formula`` is the cell with its formula."""
    text = "" if value.value is None else str(value.value).strip()
    uncomputed = formula.data_type == "f" and not text and value.data_type != "str"
    if uncomputed or (text and value.column > MOST_COLUMNS) or value.data_type == "e":
        place = f"in cell {value.coordinate} of sheet {value.parent.title}"
        if value.column > MOST_COLUMNS:
            raise MeasurementError(
                f"something stands {place}, too far from the other cells to be read; delete the "
                "rows and columns beyond the table"
            )
        return f"{text or 'formula that was never computed'} {place}"
    return Numeral(text) if value.data_type == "n" else text
