"""Rows that are on disk before anybody sees them: a table in a folder that one process holds.

``rows.csv`` grows by whole lines, each synchronised with the disk; what is undone goes to
``undone.csv`` first. A kill at any moment leaves whole rows, and a line that was cut short, which
nobody was shown, is removed when the folder is opened again.
"""

from __future__ import annotations

import csv
import fcntl
import io
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from pincal.errors import FileError, MeasurementError

ROWS, UNDONE, LOCK = "rows.csv", "undone.csv", "lock"


class Journal:
    """The rows of a folder, to which this process alone writes, until it is closed."""

    def __init__(self, folder: Path, columns: Sequence[str]) -> None:
        """Open the folder, made if there is none.

        Raises:
            FileError: another process has it open, it cannot be written, or has other columns.
        """
        self.path, self._undone = folder / ROWS, folder / UNDONE
        self.columns = list(columns)
        with ExitStack() as stack, _saying(f"cannot open {folder}"):
            folder.mkdir(exist_ok=True)
            lock = _opened(stack, folder / LOCK)
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError as error:
                raise FileError(
                    f"{folder} is open in another process ({os.read(lock, 20).decode().strip()}); "
                    "close that, or measure into another folder"
                ) from error
            os.ftruncate(lock, 0)
            os.pwrite(lock, str(os.getpid()).encode(), 0)
            self._file = _opened(stack, self.path)
            lines = self._read().splitlines(keepends=True)
            self._ends = [0]  # of the lines that are whole
            for line in lines[: len(lines) - (not lines[-1:] or lines[-1][-1:] != b"\n")]:
                self._ends.append(self._ends[-1] + len(line))
            os.ftruncate(self._file, self._ends[-1])
            if len(self._ends) == 1:
                self._append(self.columns)
            os.fsync(_opened(stack, folder, os.O_RDONLY))
            header, *self.rows = csv.reader(self._read().decode().splitlines())
            if header != self.columns:
                raise FileError(
                    f"{self.path} has other columns than these options give: what is measured, "
                    "and in which units, stays as it was; type them again, or name another folder"
                )
            self.close = stack.pop_all().close

    def append(self, cells: Mapping[str, str]) -> None:
        """Write a row, cells by column; it is on disk when this returns, or not recorded.

        Raises:
            FileError: it cannot be written, as on a full disk.
            MeasurementError: a cell with a line break.
        """
        row = [cells.get(column, "").strip() for column in self.columns]
        if any(not cell.isprintable() for cell in row):
            raise MeasurementError("a cell has characters that cannot be printed; enter it again")
        self._append(row)
        self.rows.append(row)

    def undo(self, row: int = -1) -> None:
        """Take a row back, the last if none is named, after a copy is on disk in ``undone.csv``.

        Raises:
            FileError: it cannot be written, as on a full disk.
            MeasurementError: there is no such row.
        """
        if not -1 <= row < len(self.rows) or not self.rows:
            raise MeasurementError("there is no such row to undo")
        row = range(len(self.rows))[row]
        begin, end = self._ends[row + 1 : row + 3]
        with _saying(f"the row was not undone: {self._undone}"):
            with self._undone.open("ab") as undone:
                undone.write(os.pread(self._file, end - begin, begin))
                undone.flush()
                os.fsync(undone.fileno())
            new = self.path.with_suffix(".new")
            with new.open("w+b") as file:
                text = self._read()
                file.write(text[:begin] + text[end:])
                file.flush()
                os.fsync(file.fileno())
                new.replace(self.path)
                os.dup2(file.fileno(), self._file)
        del self.rows[row], self._ends[row + 2]
        self._ends[row + 2 :] = [place - (end - begin) for place in self._ends[row + 2 :]]

    def _read(self) -> bytes:
        return os.pread(self._file, os.fstat(self._file).st_size, 0)

    def _append(self, row: list[str]) -> None:
        text, end = io.StringIO(), self._ends[-1]
        csv.writer(text, lineterminator="\n").writerow(row)
        line = text.getvalue().encode()
        with _saying(f"the row was not recorded; free some space and enter it again. {self.path}"):
            try:
                while line:
                    written = os.pwrite(self._file, line, end)
                    line, end = line[written:], end + written
                os.fsync(self._file)
            except OSError:
                with suppress(OSError):
                    os.ftruncate(self._file, self._ends[-1])
                raise
        self._ends.append(end)


def _opened(stack: ExitStack, path: Path, mode: int = os.O_RDWR | os.O_CREAT) -> int:
    """Return a file, to be closed by a stack."""
    file = os.open(path, mode | os.O_CLOEXEC, 0o644)
    stack.callback(os.close, file)
    return file


@contextmanager
def _saying(failure: str) -> Iterator[None]:
    """Say what an error of the system meant."""
    try:
        yield
    except FileError:
        raise
    except OSError as error:
        raise FileError(f"{failure}: {error.strerror or error}") from error
