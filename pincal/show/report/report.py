"""``result.report()``: a calibration as one page to read, print and keep."""

from __future__ import annotations

import platform
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import cached_property
from hashlib import file_digest
from importlib.metadata import version
from pathlib import Path

from pincal import __version__
from pincal.calibration.result import CalibrationResult
from pincal.errors import FileError
from pincal.files.tables.units import SI, Units
from pincal.show.page import Page
from pincal.show.report.findings import Findings, findings
from pincal.show.style import dark_variables
from pincal.words.numbers import reading_in

_LIBRARIES = ("pin", "numpy", "scipy")


@dataclass(frozen=True)
class Origin:
    """Where a result comes from."""

    command: str
    """As it was typed; empty if it was not."""
    files: tuple[tuple[str, str], ...]
    """Files that were read, and their SHA-256."""
    notes: tuple[str, ...]
    """What was not done, and why."""
    date: str


class Report(Page):
    """A report: a page to save, or to see in a notebook."""

    def __init__(self, found: Findings, origin: Origin, units: Units = SI) -> None:
        self.found = found
        self.origin = origin
        self.units = units

    @cached_property
    def _page(self) -> str:
        from pincal.show import result_tables, results, summary
        from pincal.show.report import facts
        from pincal.show.report.answers import Answers, warning_lines
        from pincal.show.report.figures import FIGURES
        from pincal.words.pages import rendered

        found, origin = self.found, self.origin
        versions = [f"{name} {version(name)}" for name in _LIBRARIES]
        with reading_in(self.units.printed):
            return rendered(
                "report.html",
                found=found,
                result=found.result,
                origin=origin,
                facts=facts,
                figure=lambda name: FIGURES[name](found),
                results=results,
                summary=summary,
                tables=result_tables,
                warnings=warning_lines(found.result),
                dark=dark_variables(),
                answers=Answers(found, origin.notes),
                versions=[
                    f"pincal {__version__}",
                    *versions,
                    f"Python {platform.python_version()}",
                ],
            )


def report(
    result: CalibrationResult,
    *,
    command: str = "",
    files: Sequence[str | Path] = (),
    notes: Sequence[str] = (),
    date: str | None = None,
    units: str = "",
) -> Report:
    """Return a report of a calibration: ``html()``, ``save(path)``, or shown by a notebook.

    Args:
        result: The calibration.
        command: What was typed, to say how to do it again.
        files: Files that were read; the report holds their SHA-256.
        notes: Sentences beside those on held-out rows and runs.
        date: When it was made; now if not given. Nothing else differs from one time to the next.
        units: In which numbers are read, such as ``"in,deg"``; mm and mrad where not said.

    Raises:
        FileError: a file that cannot be read.
        MeasurementError: a unit that is not understood.
    """
    now = datetime.now().astimezone().strftime("%Y-%m-%d %H:%M %z")
    kept = [path for path in map(Path, files) if not path.is_fifo()]  # a pipe is read once
    hashes = tuple((path.name, _sha256(path)) for path in kept)
    origin = Origin(command, hashes, tuple(notes), now if date is None else date)
    nominal = result.nominal
    read = Units.of(units, nominal.counts, nominal.reading_names)
    return Report(findings(result), origin, read)


def _sha256(path: Path) -> str:
    """Return the SHA-256 of a file.

    Raises:
        FileError: it cannot be read.
    """
    try:
        with path.open("rb") as file:
            return file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise FileError(f"cannot read {path}: {error.strerror or error}") from error
