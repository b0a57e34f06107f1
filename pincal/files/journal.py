"""Tables on disk that grow by whole rows: a kill at any moment leaves the old or the new state.

Rows are synchronised with the disk before they are reported. A line without an end was never
reported, and is cut off when the table is read again.
"""

import csv
import fcntl
import io
import logging
import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pincal.errors import FileError, MeasurementError, explaining
from pincal.files.output import OTHER_TABLES

Row = dict[str, Any]
Columns = dict[str, NDArray[Any]]
FAILURE = "failure"
"""Column with the reason why a row has no numbers."""
TEXTS = {"file", "sha256", "parameter", "verdict", FAILURE}
"""Columns of a table that hold no numbers."""
_log = logging.getLogger(__name__)


class RowFile:
    """A table of numbers and texts: a CSV file, or in memory (None)."""

    def __init__(self, path: Path | None, columns: Sequence[str]) -> None:
        self.path, self.columns, self._lines = path, list(columns), list[Sequence[Any]]()
        if path and path.suffix.lower() in OTHER_TABLES:
            raise FileError(f"{path}: tables are CSV; name {path.with_suffix('.csv')}")

    def read(self) -> Columns:
        """Return all columns, each of shape (N,).

        Raises:
            FileError: the file has other columns, or cannot be read.
        """
        with explaining(f"move {self.path} away, or name another", ValueError, csv.Error):
            lines = read_lines(self.path, self.columns) if self.path else self._lines
            cells = np.array(lines, dtype=object).reshape(-1, len(self.columns)).T
            columns = dict(zip(self.columns, cells, strict=True))
            return {n: v if n in TEXTS else v.astype(float) for n, v in columns.items()}

    def add(self, rows: Sequence[Row]) -> None:
        """Add rows.

        Raises:
            FileError: the rows cannot be written.
        """
        blank = {name: "" if name in TEXTS else np.nan for name in self.columns}
        lines = [[row.get(name, cell) for name, cell in blank.items()] for row in rows]
        with explaining(f"{self.path} cannot be written"):
            if self.path is None:
                self._lines += lines
            else:
                append_lines(self.path, self.columns, lines)


class Journal:
    """The rows of a session's folder, which a process locks until it closes the journal.

    Rows are copied to ``undone.csv`` before they are undone.
    """

    def __init__(self, folder: Path) -> None:
        """Lock the folder; create it if there is none. ``open`` reads its rows.

        Raises:
            FileError: another process has it open, or it cannot be written.
        """
        self.folder, self.path = folder, folder / "rows.csv"
        self.columns, self.rows, lock = list[str](), list[list[str]](), folder / "lock"
        self._existed = folder.exists()
        with explaining(f"cannot open {folder}"):
            folder.mkdir(exist_ok=True)
            made = set[Path]() if lock.exists() else {lock}
            self._lock = os.open(lock, os.O_RDWR | os.O_CREAT)
            try:
                fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                if not os.path.samestat(os.fstat(self._lock), lock.stat()):  # it was withdrawn
                    raise BlockingIOError
                lock.write_text(str(os.getpid()))
                self._before = set(folder.iterdir()) - made
            except BlockingIOError as error:
                self.close()
                raise FileError(
                    f"{folder} is open in another process ({lock.read_text()}); close that, or "
                    "measure into another folder"
                ) from error

    def open(self, columns: Sequence[str]) -> None:
        """Read the rows that were recorded.

        Raises:
            FileError: the table has other columns, or cannot be read or written.
        """
        self.columns = list(columns)
        remedy = "leave out options of quantities and units, correct its rows, or name another"
        with explaining(f"cannot go on in {self.folder} ({remedy})", ValueError):
            self.rows = read_lines(self.path, self.columns)
            append_lines(self.path, self.columns, [])

    def withdraw(self) -> None:
        """Remove the files of a new session; none that were there when the folder was locked."""
        names = ("plan.csv", "rows.csv", "options.json", "options.new", "lock")
        for path in {self.folder / name for name in names} - self._before:
            path.unlink(missing_ok=True)
        if not self._existed:
            with suppress(OSError):  # somebody put a file there
                self.folder.rmdir()

    def close(self) -> None:
        """Release the folder for other processes."""
        os.close(self._lock)

    def append(self, cells: Mapping[str, str]) -> None:
        """Write a row, cells by column; when this returns it is on the disk.

        Raises:
            FileError: the row cannot be written, as on a full disk; it is not recorded.
            MeasurementError: a cell has characters that cannot be printed, such as a line break.
        """
        row = [cells.get(column, "").strip() for column in self.columns]
        if any(not cell.isprintable() for cell in row):
            raise MeasurementError("a cell has characters that cannot be printed; enter it again")
        with explaining(f"not recorded; free some space and enter it again. {self.path}"):
            append_lines(self.path, self.columns, [row])
        self.rows.append(row)

    def undo(self, row: int) -> None:
        """Remove a row, after a copy of it is on the disk in ``undone.csv``.

        Raises:
            FileError: the files cannot be written, as on a full disk.
            MeasurementError: there is no such row.
        """
        if not 0 <= row < len(self.rows):
            raise MeasurementError("there is no such row to undo")
        rows = self.rows.copy()
        undone, new = rows.pop(row), self.path.with_suffix(".new")
        with explaining("the row was not undone"):
            append_lines(self.path.with_name("undone.csv"), [], [undone])
            new.unlink(missing_ok=True)
            append_lines(new, self.columns, rows)
            new.replace(self.path)
            _synchronise_folder(self.path)
        self.rows = rows


def read_lines(path: Path, columns: Sequence[str]) -> list[list[str]]:
    """Return the rows of a table that ``append_lines`` wrote; no rows if there is no file.

    Raises:
        ValueError: the table has other columns; it is not changed.
        OSError: the table cannot be read.
    """
    if not path.exists():
        return []
    data, head = path.read_bytes(), ",".join(columns).encode()
    end = data.rfind(b"\n") + 1
    text = head if head.startswith(data) else data[:end] or data
    reader = csv.reader(io.StringIO(text.decode("utf-8-sig", "surrogateescape")))
    try:
        if next(reader, []) != [*columns]:
            raise ValueError(f"{path} has other columns")
        lines = [(reader.line_num, line) for line in reader if line]
    except csv.Error as error:
        raise ValueError(f"{path}, line {reader.line_num}: {error}") from error
    for number, line in lines:
        if len(line) != len(columns):
            raise ValueError(f"{path}, line {number}: {len(line)} cells instead of {len(columns)}")
    if data[end:]:
        _log.info("%s: left out, as it has no end: %s", path, data[end:].decode(errors="replace"))
        os.truncate(path, end)
    return [line for _, line in lines]


def append_lines(path: Path, columns: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    """Append rows to a table, after the heads of its columns if it is new: all rows or none.

    Raises:
        OSError: the table cannot be written.
    """
    size = path.stat().st_size if path.exists() else -1
    try:
        with path.open("a", newline="", encoding="utf-8", errors="surrogateescape") as file:
            lines = [columns, *rows] if columns and size <= 0 else rows
            csv.writer(file, lineterminator="\n").writerows(lines)
            file.flush()
            os.fsync(file.fileno())
        if size <= 0:
            _synchronise_folder(path)
    except OSError:
        if size < 0:
            path.unlink(missing_ok=True)
        else:
            os.truncate(path, size)
        raise


def _synchronise_folder(path: Path) -> None:
    folder = os.open(path.parent, os.O_RDONLY)
    os.fsync(folder)
    os.close(folder)
