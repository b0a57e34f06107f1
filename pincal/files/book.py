"""Sheets of .xlsx files: rows of text, read from the first sheet, or written to be filled in."""

from __future__ import annotations

import io
import posixpath
import re
import zipfile
from collections.abc import Iterator, Sequence
from functools import reduce
from pathlib import Path
from xml.sax.saxutils import escape

import numpy as np
from lxml import etree

from pincal.errors import MeasurementError
from pincal.files.text import LARGEST_FILE, plain_number, read_bytes

MOST_COLUMNS = 1000
_COLUMN = re.compile("[A-Z]{1,3}")
_BOOK_LINKS = "_rels/workbook.xml.rels"
_PARTS = {
    "[Content_Types].xml": (
        '<Types xmlns="http://schemas.openxmlformats.org/package/2006/content-types">'
        '<Default Extension="rels" '
        'ContentType="application/vnd.openxmlformats-package.relationships+xml"/>'
        '<Override PartName="/xl/workbook.xml" ContentType="{kind}.sheet.main+xml"/>'
        '<Override PartName="/xl/styles.xml" ContentType="{kind}.styles+xml"/>'
        '<Override PartName="/xl/sheet.xml" ContentType="{kind}.worksheet+xml"/></Types>'
    ),
    "_rels/.rels": (
        '<Relationships xmlns="{rels}"><Relationship Id="book" Type="{office}/officeDocument" '
        'Target="xl/workbook.xml"/></Relationships>'
    ),
    "xl/_rels/workbook.xml.rels": (
        '<Relationships xmlns="{rels}">'
        '<Relationship Id="sheet" Type="{office}/worksheet" Target="sheet.xml"/>'
        '<Relationship Id="styles" Type="{office}/styles" Target="styles.xml"/></Relationships>'
    ),
    "xl/workbook.xml": (
        '<workbook xmlns="{main}" xmlns:r="{office}"><sheets>'
        '<sheet name="measure" sheetId="1" r:id="sheet"/></sheets></workbook>'
    ),
    "xl/styles.xml": (
        '<styleSheet xmlns="{main}"><fonts count="2"><font><sz val="11"/><name val="Calibri"/>'
        '</font><font><b/><sz val="11"/><name val="Calibri"/></font></fonts><fills count="3">'
        '<fill><patternFill patternType="none"/></fill><fill><patternFill patternType="gray125"/>'
        '</fill><fill><patternFill patternType="solid"><fgColor rgb="FFFFF2CC"/></patternFill>'
        '</fill></fills><borders count="1"><border/></borders><cellStyleXfs count="1"><xf/>'
        '</cellStyleXfs><cellXfs count="3"><xf/><xf fontId="1" applyFont="1"/>'
        '<xf fillId="2" applyFill="1"/></cellXfs><cellStyles count="1">'
        '<cellStyle name="Normal" xfId="0" builtinId="0"/></cellStyles></styleSheet>'
    ),
}
"""Parts of an .xlsx file but for its sheet (ECMA-376): cells plain, bold, and to be filled in."""
_NAMESPACES = {
    "main": "http://schemas.openxmlformats.org/spreadsheetml/2006/main",
    "office": "http://schemas.openxmlformats.org/officeDocument/2006/relationships",
    "rels": "http://schemas.openxmlformats.org/package/2006/relationships",
    "kind": "application/vnd.openxmlformats-officedocument.spreadsheetml",
}


def write_book(path: Path, rows: Sequence[Sequence[str]]) -> None:
    """Write rows of text to an .xlsx file, the first bold, cells to measure coloured."""
    widths = "".join(
        f'<col min="{column}" max="{column}" width="{max(8, len(head) + 2)}" customWidth="1"/>'
        for column, head in enumerate(rows[0], start=1)
    )
    lines = "".join(
        f'<row r="{number}">{"".join(map(_book_cell, cells, rows[0]))}</row>'
        for number, cells in enumerate(rows, start=1)
    )
    sheet = (
        f'<worksheet xmlns="{_NAMESPACES["main"]}"><sheetViews><sheetView workbookViewId="0">'
        '<pane ySplit="1" topLeftCell="A2" state="frozen"/></sheetView></sheetViews>'
        f"<cols>{widths}</cols><sheetData>{lines}</sheetData></worksheet>"
    )
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, text in _PARTS.items():
            archive.writestr(name, text.format(**_NAMESPACES))
        archive.writestr("xl/sheet.xml", sheet)


def _book_cell(text: str, head: str) -> str:
    """Return a cell of an .xlsx sheet: a number, text (bold if it heads), or to be measured."""
    if not text:
        return '<c s="2"/>' if "[" in head else "<c/>"
    if np.isfinite(plain_number(text)):
        return f"<c><v>{text}</v></c>"
    return f'<c s="{int(text == head)}" t="inlineStr"><is><t>{escape(text)}</t></is></c>'


def sheet_rows(path: Path) -> Iterator[tuple[int, list[str]]]:
    """Yield number and cells of each row of an .xlsx file's first sheet, without blank columns.

    A cell with an error (``#DIV/0!``), or a formula that was never computed, says so: it is not
    empty.
    """
    data = read_bytes(path, LARGEST_FILE["table"], MeasurementError)
    rows: dict[int, dict[int, str]] = {}
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            if sum(part.file_size for part in archive.infolist()) > LARGEST_FILE["table"]:
                raise MeasurementError("its sheet is larger than 256 MiB; save it as CSV")
            book, links = (_xml(archive, f"xl/{n}") for n in ("workbook.xml", _BOOK_LINKS))
            (first, *_) = book.iterfind(".//{*}sheet")
            (link,) = (item for item in links if item.get("Id") in first.values())
            sheet_path = posixpath.normpath(posixpath.join("/xl", link.get("Target", "")))
            shared = "xl/sharedStrings.xml"
            texts = [*map(_text_in, _xml(archive, shared))] if shared in archive.namelist() else []
            number = 0
            with archive.open(sheet_path.lstrip("/")) as sheet:
                for _, row in etree.iterparse(sheet, tag="{*}row", resolve_entities=False):
                    number = int(row.get("r", number + 1))
                    if cells := dict(_sheet_cells(row, number, texts, first.get("name", ""))):
                        rows[number] = cells
                    row.clear(keep_tail=False)
    except MeasurementError as error:
        raise MeasurementError(f"{path}: {error}") from error
    except (zipfile.BadZipFile, KeyError, ValueError, IndexError, etree.LxmlError) as error:
        raise MeasurementError(f"{path}: no .xlsx file: {error}") from error
    columns = sorted({column for row in rows.values() for column in row})
    for number in sorted(rows):
        yield number, [rows[number].get(column, "") for column in columns]


def _xml(archive: zipfile.ZipFile, name: str) -> etree._Element:
    return etree.fromstring(archive.read(name))


def _text_in(element: etree._Element) -> str:
    """Return the text of an element of an .xlsx file, in one piece or as runs of one format."""
    pieces = [*element.iterfind("{*}t"), *element.iterfind("{*}r/{*}t")]
    return "".join(piece.text or "" for piece in pieces)


def _sheet_cells(
    row: etree._Element, number: int, texts: Sequence[str], title: str
) -> Iterator[tuple[int, str]]:
    """Yield column, from 1, and text of a row's cells in which something stands."""
    column = 0
    for cell in row:
        letters = _COLUMN.match(cell.get("r", ""))
        column += 1
        if letters:  # A is 1, AA is 27
            column = reduce(lambda place, letter: 26 * place + ord(letter) - 64, letters[0], 0)
        place = f"in cell {cell.get('r', f'R{number}C{column}')} of sheet {title}"
        value, kind = cell.findtext("{*}v") or "", cell.get("t", "n")
        if kind == "e":
            value = f"{value} {place}"
        elif kind == "inlineStr":
            value = "".join(map(_text_in, cell))
        elif kind == "s" and value:
            value = texts[int(value)]
        elif not value and kind != "str" and cell.find("{*}f") is not None:
            value = f"formula that was never computed {place}"
        if value.strip():
            if column > MOST_COLUMNS:
                raise MeasurementError(
                    f"something stands {place}, too far from the other cells to be read; delete "
                    "the rows and columns beyond the table"
                )
            yield column, value.strip()
