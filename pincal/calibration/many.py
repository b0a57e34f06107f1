"""Many machines, one table: rows follow from their items alone, whoever makes them, in any number.

A row is made of an item, such as a machine's number, by some process or computer (joblib, Dask),
and added to the table in the order of the items. So the table is the same however many work on it,
and what it holds already is not made again.
"""

from __future__ import annotations

import csv
import io
import os
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from joblib import Parallel, delayed, parallel_config
from joblib.externals.loky.process_executor import TerminatedWorkerError
from numpy.typing import NDArray

from pincal.calibration.options import Progress
from pincal.errors import FileError, PincalError
from pincal.option import option

Item = tuple[Any, ...]
Row = dict[str, Any]
Columns = dict[str, NDArray[Any]]
FAILURE = "failure"
"""Column that says why a row has no numbers."""
_SHARES, _LARGEST = 64, 50  # shares of the work at least, rows of a share at most
_ROUNDING = 1e-6  # relative difference of numbers that another processor may make
_OTHER_COLUMNS = "it has other columns than it should"
_MISSING: Mapping[type, Any] = {str: "", float: np.nan}


@dataclass(frozen=True)
class RowFile:
    """A table that grows by whole rows: a CSV file, or a folder ``*.parquet`` of Parquet files."""

    path: Path
    kinds: Mapping[str, type]
    """Of what each column holds: str, int or float."""

    def read(self) -> Columns:
        """Return all columns, without a row that a process was writing when it ended."""
        parts: list[Mapping[str, Sequence[Any]]] = []
        try:
            if self.path.suffix == ".parquet":
                read = _extra("pyarrow.parquet").read_table
                parts = [read(path).to_pydict() for path in sorted(self.path.glob("part-*"))]
            elif self.path.exists():
                lines = self._lines()
                parts = [{name: [line[i] for line in lines] for i, name in enumerate(self.kinds)}]
            if any(list(part) != list(self.kinds) for part in parts):
                raise ValueError(_OTHER_COLUMNS)
            return {
                name: np.array(
                    [kind(value) for part in parts for value in part[name]],
                    dtype=object if kind is str else kind,
                )
                for name, kind in self.kinds.items()
            }
        except (OSError, ValueError, csv.Error) as error:
            raise FileError(f"{self.path}: {error}; move it away, or name another") from error

    def _lines(self) -> list[list[str]]:
        """Return the lines of a CSV file; what follows its last end of line is cut off.

        Raises:
            ValueError: it is no table with these columns, and is left as it is.
        """
        data, heads = self.path.read_bytes(), ",".join(self.kinds).encode()
        end = data.rfind(b"\n") + 1
        text = (heads if heads.startswith(data) else data[:end] or data).decode()
        first, *lines = csv.reader(io.StringIO(text))
        if first != [*self.kinds] or any(len(line) != len(first) for line in lines):
            raise ValueError(_OTHER_COLUMNS)
        os.truncate(self.path, end)
        return lines

    def add(self, rows: Sequence[Row]) -> None:
        """Add rows; a file of Parquet is there whole, or not at all."""
        lines = [
            [
                kind(row[name] if name in row else _MISSING[kind])
                for name, kind in self.kinds.items()
            ]
            for row in rows
        ]
        try:
            if self.path.suffix == ".parquet":
                self.path.mkdir(parents=True, exist_ok=True)
                part = self.path / f"part-{len(list(self.path.glob('part-*'))):06d}.parquet"
                columns = dict(zip(self.kinds, map(list, zip(*lines, strict=True)), strict=True))
                table = _extra("pyarrow").table(columns)
                _extra("pyarrow.parquet").write_table(table, scratch := self.path / "new.parquet")
                scratch.replace(part)
                return
            headed = self.path.exists() and self.path.stat().st_size
            with self.path.open("a", encoding="utf-8", newline="") as file:
                writer = csv.writer(file, lineterminator="\n")
                writer.writerows(lines if headed else [[*self.kinds], *lines])
        except OSError as error:
            raise FileError(f"{self.path} cannot be written: {error}") from error


@dataclass(frozen=True)
class Workers:
    """Who makes the rows: processes, or computers."""

    workers: int | None = option(None, "Processes [default: as many as cores].", least=1)
    scheduler: str = option(
        "", "Dask scheduler whose workers do the work.", metavar="tcp://HOST:PORT"
    )


def add_rows(
    make_row: Callable[..., Row],
    items: Sequence[Item],
    file: RowFile,
    workers: Workers,
    progress: Progress = None,
) -> Columns:
    """Return columns with a row of each item; rows that a table lacks are made, and added to it.

    Args:
        make_row: Returns the row of an item, wherever it is sent to; what it raises is the row's
            failure.
        items: What rows are of: the first columns of the table.
        file: Where rows are, and are added in the order of the items.
        workers: Who makes them.
        progress: Called with what is done.

    Raises:
        FileError: the table cannot be read or written, or holds rows that are made otherwise.
        PincalError: no scheduler or worker answers, or processes end before a row is made.
    """
    if not file.path.absolute().parent.is_dir():
        raise FileError(f"{file.path} cannot be written: its folder does not exist")
    waiting, keys = _without_rows(make_row, items, file), list(file.kinds)[: len(items[0])]
    size = min(max(len(waiting) // _SHARES, 1), _LARGEST)
    while before := len(waiting):
        shares = [waiting[start : start + size] for start in range(0, before, size)]
        try:
            with _backend(workers.scheduler), warnings.catch_warnings():
                warnings.filterwarnings("ignore", ".* tasks which were still being processed")
                count = -1 if workers.scheduler else workers.workers or -1
                made = Parallel(count, return_as="generator")
                for rows in made(delayed(_rows_of)(make_row, keys, share) for share in shares):
                    file.add(rows)
                    del waiting[: len(rows)]
                    if progress:
                        progress(f"{len(items) - len(waiting)} of {len(items)} machines")
        except TerminatedWorkerError as error:  # its share is done again
            if len(waiting) == before:
                raise PincalError(
                    "processes were ended before they made a row, perhaps for want of memory: try "
                    f"fewer --workers; {file.path} keeps what is done, the same command goes on"
                ) from error
    columns = file.read()
    places = _places(columns, keys)
    return {name: values[[places[item] for item in items]] for name, values in columns.items()}


def _places(columns: Columns, keys: Sequence[str]) -> dict[Item, int]:
    """Return the place of each item's row."""
    return {item: row for row, item in enumerate(zip(*(columns[k] for k in keys), strict=True))}


def _without_rows(make_row: Callable[..., Row], items: Sequence[Item], file: RowFile) -> list[Item]:
    """Return items without a row; one of the others is made again, and must be as it is there."""
    columns, keys = file.read(), list(file.kinds)[: len(items[0])]
    places = _places(columns, keys)
    for item in [item for item in items if item in places][:1]:
        (row,) = _rows_of(make_row, keys, [item])
        held = {name: values[places[item]] for name, values in columns.items() if name in row}
        if not all(_equal(row[name], value) for name, value in held.items()):
            raise FileError(
                f"{file.path} holds other rows: that of {item[0]} is another by this mechanism and "
                "these options; move it away, or name another"
            )
    return [item for item in items if item not in places]


def _rows_of(make_row: Callable[..., Row], keys: Sequence[str], items: Sequence[Item]) -> list[Row]:
    """Return the rows of items, or why they have none."""
    rows = []
    for item in items:
        try:
            row = make_row(*item)
        except (OSError, MemoryError):  # no property of the item
            raise
        except Exception as error:  # whatever it is, the other rows are made
            kind = "" if isinstance(error, PincalError) else f"{type(error).__name__}: "
            row = {FAILURE: " ".join(f"{kind}{error}".split())}
        rows.append(dict(zip(keys, item, strict=True)) | row)
    return rows


def _equal(value: Any, held: Any) -> bool:
    """Return whether a number is what a table holds, but for rounding; a text the same."""
    if isinstance(value, str):
        return bool(value == held)
    return bool(np.isclose(value, held, rtol=_ROUNDING, atol=1e-12, equal_nan=True))


@contextmanager
def _backend(scheduler: str) -> Iterator[None]:
    """Let Dask's workers do the work, if a scheduler is named."""
    if not scheduler:
        yield
        return
    try:
        client = _extra("distributed").Client(scheduler, timeout=10, set_as_default=False)
        client.wait_for_workers(1, timeout=30)
    except (OSError, ValueError) as error:
        raise PincalError(
            f"no Dask scheduler with workers answers at {scheduler}: start 'dask scheduler', and "
            "'dask worker ADDRESS' on each computer, with pincal installed there too"
        ) from error
    with client, parallel_config("dask", client=client):
        yield


def _extra(name: str) -> Any:
    """Return a package of the extra ``cluster``."""
    try:
        return import_module(name)
    except ImportError as error:
        raise PincalError(
            f"{name} is not installed: python -m pip install 'pincal[cluster]'; tables named *.csv "
            "and work without --scheduler do not need it"
        ) from error
