"""Rows that are on disk before anybody sees them: a table in a folder that one process holds.

``rows.csv`` is replaced by each new state of it, which is synchronised with the disk first; what is
undone goes to ``undone.csv`` before. A kill at any moment leaves one state or the next.
"""

from __future__ import annotations

import csv
import fcntl
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

from pincal.errors import FileError, MeasurementError


class Journal:
    """The rows of a folder, to which this process alone writes, until it is closed."""

    def __init__(self, folder: Path, columns: Sequence[str]) -> None:
        """Open the folder, made if there is none.

        Raises:
            FileError: another process has it open, it cannot be written, or has other columns.
        """
        self.path, self.columns = folder / "rows.csv", list(columns)
        with _saying(f"cannot open {folder}"):
            folder.mkdir(exist_ok=True)
            lock = folder / "lock"
            self._lock = os.open(lock, os.O_RDWR | os.O_CREAT)
            try:
                fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError as error:
                self.close()
                raise FileError(
                    f"{folder} is open in another process ({lock.read_text()}); close that, or "
                    "measure into another folder"
                ) from error
            lock.write_text(str(os.getpid()))
            text = self.path.read_text("utf-8") if self.path.exists() else ""
        # a line that was cut short was shown to nobody
        lines = text[: text.rfind("\n") + 1].splitlines()
        header, *self.rows = list(csv.reader(lines)) or [self.columns]
        if header != self.columns:
            self.close()
            raise FileError(
                f"{self.path} has other columns than these options give: what is measured, "
                "and in which units, stays as it was; type them again, or name another folder"
            )
        self._write(self.rows)

    def close(self) -> None:
        """Let other processes open the folder."""
        os.close(self._lock)

    def append(self, cells: Mapping[str, str]) -> None:
        """Write a row, cells by column; it is on disk when this returns, or not recorded.

        Raises:
            FileError: it cannot be written, as on a full disk.
            MeasurementError: a cell with a line break.
        """
        row = [cells.get(column, "").strip() for column in self.columns]
        if any(not cell.isprintable() for cell in row):
            raise MeasurementError("a cell has characters that cannot be printed; enter it again")
        self._write([*self.rows, row])

    def undo(self, row: int = -1) -> None:
        """Take a row back, the last if none is named, after a copy is on disk in ``undone.csv``.

        Raises:
            FileError: it cannot be written, as on a full disk.
            MeasurementError: there is no such row.
        """
        if not -1 <= row < len(self.rows) or not self.rows:
            raise MeasurementError("there is no such row to undo")
        rows = self.rows.copy()
        undone = rows.pop(row)
        with _saying("the row was not undone"):
            _synchronised(self.path.with_name("undone.csv"), "a", [undone])
        self._write(rows)

    def _write(self, rows: list[list[str]]) -> None:
        """Replace the rows, here and on disk."""
        with _saying(f"not recorded; free some space and enter it again. {self.path}"):
            new = self.path.with_suffix(".new")
            _synchronised(new, "w", [self.columns, *rows])
            new.replace(self.path)
            folder = os.open(self.path.parent, os.O_RDONLY)
            os.fsync(folder)
            os.close(folder)
        self.rows = rows


def _synchronised(path: Path, mode: str, rows: list[list[str]]) -> None:
    """Write rows to a file, on the disk when this returns."""
    with path.open(mode, newline="", encoding="utf-8") as file:
        csv.writer(file, lineterminator="\n").writerows(rows)
        file.flush()
        os.fsync(file.fileno())


@contextmanager
def _saying(failure: str) -> Iterator[None]:
    """Say what an error of the system meant."""
    try:
        yield
    except FileError:
        raise
    except OSError as error:
        raise FileError(f"{failure}: {error.strerror or error}") from error
