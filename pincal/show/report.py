"""``result.report()``: a calibration as one page to read, print and keep."""

from __future__ import annotations

import platform
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import cached_property
from hashlib import file_digest
from importlib.metadata import version
from pathlib import Path

import numpy as np

from pincal import __version__
from pincal.calibration.result import CalibrationResult
from pincal.errors import FileError
from pincal.model.measurements import EVERY_LEG
from pincal.model.units import SI, Units
from pincal.show import result_tables, summary
from pincal.show.answers import Answers, ReportFacts, report_facts, warning_lines
from pincal.show.figures import figure
from pincal.show.page import Page
from pincal.show.style import dark_variables
from pincal.words.numbers import counted, reading_in
from pincal.words.wording import rendered

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

    def __init__(self, facts: ReportFacts, origin: Origin, units: Units = SI) -> None:
        self.facts = facts
        self.origin = origin
        self.units = units

    @cached_property
    def _page(self) -> str:
        versions = [f"{name} {version(name)}" for name in _LIBRARIES]
        result = self.facts.result
        with reading_in(self.units.printed):
            return rendered(
                "report.html",
                facts=self.facts,
                result=result,
                origin=self.origin,
                about={
                    "minimised": minimised(result),
                    "rows": rows(result),
                    "columns": columns(result),
                },
                figure=lambda name: figure(name, self.facts),
                summary=summary,
                tables=result_tables,
                warnings=warning_lines(result),
                dark=dark_variables(),
                answers=Answers(self.facts, self.origin.notes),
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
    today = datetime.now().astimezone().strftime("%Y-%m-%d %H:%M %z")
    regular = [path for path in map(Path, files) if not path.is_fifo()]  # a pipe is read once
    hashes = tuple((path.name, _sha256(path)) for path in regular)
    origin = Origin(command, hashes, tuple(notes), today if date is None else date)
    nominal = result.nominal
    read = Units.of(units, nominal.counts, nominal.reading_names)
    return Report(report_facts(result), origin, read)


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


def minimised(result: CalibrationResult) -> str:
    """Return which residuals were minimised."""
    if result.options.latent:
        return (
            "predicted less measured readings and quantities of the platform, weighted by the noise"
        )
    if result.options.residual == "joint":
        return "joint residuals: predicted less measured readings, not weighted"
    return "closure residuals: by how much a leg misses the platform point, weighted by the noise"


def rows(result: CalibrationResult) -> str:
    """Return how many rows there are, of which sets, runs and poses."""
    data = result.measurements
    parts = [f"{len(data)}"]
    for name, values in (("sets", data.sets), ("runs", data.runs)):
        if values is not None:
            counts = Counter("every leg" if value in ("", EVERY_LEG) else value for value in values)
            parts.append(f"{name}: {', '.join(f'{value} {n}' for value, n in counts.items())}")
    if data.places is not None:
        counts = Counter(name for name in data.places if name)
        repeated = sum(n > 1 for n in counts.values())
        parts.append(f"{counted(repeated, 'pose')} measured more than once")
    return "; ".join(parts)


def columns(result: CalibrationResult) -> str:
    """Return which quantities of the platform were measured, and how often if not always."""
    data, platform = result.measurements, result.nominal.platform
    measured = dict(zip(platform.coordinates, data.poses.T, strict=True)) | dict(data.extra)
    counts = {name: int(np.isfinite(values).sum()) for name, values in measured.items()}
    often = {name: "" if n == len(data) else f" ({n} rows)" for name, n in counts.items() if n}
    return ", ".join(map("".join, often.items())) or "nothing"
