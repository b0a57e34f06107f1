"""``result.report()``: a calibration as one page to read, print and keep."""

from __future__ import annotations

import html
import platform
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import cached_property
from hashlib import file_digest
from importlib.metadata import version
from pathlib import Path

from pincal.calibration.result import CalibrationResult
from pincal.errors import FileError
from pincal.files.output import writing
from pincal.show.report.findings import Findings, findings

_PACKAGES = ("pincal", "pin", "numpy", "scipy")


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


class Report:
    """A report: a page to save, or to see in a notebook."""

    def __init__(self, found: Findings, origin: Origin) -> None:
        self.found = found
        self.origin = origin

    def html(self) -> str:
        """Return the page, which needs no other file and no network."""
        return self._page

    @cached_property
    def _page(self) -> str:
        import pincal.show.report.sections as sections  # imports matplotlib: slow
        from pincal.show.report.answers import answers, warning_lines
        from pincal.show.summary import method_line
        from pincal.words.pages import rendered

        found, origin, result = self.found, self.origin, self.found.result
        shown = [sections.measured(found)]
        if result.converged:
            shown += [
                one(found)
                for one in (
                    sections.parameters,
                    sections.residuals,
                    sections.platform,
                    sections.observability,
                )
            ]
            shown += [sections.outliers(result), sections.checks(result, origin.notes)]
        versions = [f"{package} {version(package)}" for package in _PACKAGES]
        made = (*versions, f"Python {platform.python_version()}")
        return rendered(
            "report.html",
            name=result.nominal.name,
            description=result.nominal.description,
            about=(
                f"{origin.date} · {len(found.data)} rows · {method_line(result)} · {result.message}"
            ),
            warnings=warning_lines(result),
            answers=answers(found, origin.notes),
            sections=[
                *shown,
                sections.reproduction(origin.command, made, origin.files, origin.date),
            ],
        )

    def save(self, path: str | Path, *, force: bool = False) -> Path:
        """Write the page to a file, whole or not at all, and return its path.

        Raises:
            FileError: the file exists and ``force`` is not set, or cannot be written.
        """
        with writing(path, force=force) as scratch:
            scratch.write_text(self.html(), encoding="utf-8")
        return Path(path)

    def _repr_html_(self) -> str:
        """Return the page in a frame of its own, for notebooks."""
        return (
            '<iframe sandbox="" style="width: 100%; height: 800px; border: 0" '
            f'srcdoc="{html.escape(self.html())}"></iframe>'
        )


def report(
    result: CalibrationResult,
    *,
    command: str = "",
    files: Sequence[str | Path] = (),
    notes: Sequence[str] = (),
    date: str | None = None,
) -> Report:
    """Return a report of a calibration: ``html()``, ``save(path)``, or shown by a notebook.

    Args:
        result: The calibration.
        command: What was typed, to say how to do it again.
        files: Files that were read; the report holds their SHA-256.
        notes: Sentences beside those on held-out rows and runs.
        date: When it was made; now if not given. Nothing else differs from one time to the next.

    Raises:
        FileError: a file that cannot be read.
    """
    now = datetime.now().astimezone().strftime("%Y-%m-%d %H:%M %z")
    kept = [path for path in map(Path, files) if not path.is_fifo()]  # a pipe is read once
    hashes = tuple((path.name, _sha256(path)) for path in kept)
    origin = Origin(command, hashes, tuple(notes), now if date is None else date)
    return Report(findings(result), origin)


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
