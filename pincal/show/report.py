"""Pages to read, print and keep: ``result.report()``, and the output of print and notebooks."""

import html
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import cached_property
from hashlib import sha256
from importlib.metadata import version
from inspect import getdoc
from pathlib import Path
from platform import python_version
from typing import Any, ClassVar

import numpy as np
from markupsafe import Markup

from pincal import __version__
from pincal.calibration.result import CalibrationResult
from pincal.errors import FileError
from pincal.files.measurements import read_poses
from pincal.files.output import writing
from pincal.files.text import LARGEST_FILE, read_bytes
from pincal.model import EVERY_LEG, VERIFY, Mechanism, Plan
from pincal.model.checks import counted
from pincal.show import answers, tables
from pincal.show.misses import WorkspaceErrors, workspace_errors
from pincal.show.picture import picture
from pincal.show.style import page_figure
from pincal.show.view.scene import MOST_POSES, VERIFICATION
from pincal.words.numbers import capital
from pincal.words.table import Table
from pincal.words.wording import rendered


class Page:
    """A page, made when it is first asked for."""

    sandbox: ClassVar[str] = ""
    """Permissions of its scripts in a notebook, as an iframe's ``sandbox``."""
    height: ClassVar[str] = "800px"
    """Height of its frame in a notebook."""

    def html(self) -> str:
        """Return the page as HTML that needs no server, no other file and no network."""
        return self._page

    @cached_property
    def _page(self) -> str:
        raise NotImplementedError

    def save(self, path: str | Path, *, force: bool = False) -> Path:
        """Write the page to a file, whole or not at all, and return its path.

        Raises:
            FileError: the file exists and ``force`` is not set, or cannot be written.
        """
        with writing(path, force=force) as scratch:
            scratch.write_text(self.html(), encoding="utf-8")
        return Path(path)

    def _repr_html_(self) -> str:
        return (
            f'<iframe sandbox="{self.sandbox}" style="width: 100%; height: {self.height}; '
            f'border: 0" srcdoc="{html.escape(self.html())}"></iframe>'
        )


@dataclass(eq=False)
class Report(Page):
    """The report of a calibration: a page to save, or to see in a notebook."""

    result: CalibrationResult
    errors: WorkspaceErrors | None
    """Errors of the platform over the workspace; None if the fit did not converge."""
    command: str = ""
    """Command line that made the calibration; empty for Python."""
    files: tuple[tuple[str, str], ...] = ()
    """Files that were read, and their SHA-256."""
    steps: Sequence[str] = ()
    """Commands to run next; if empty, commands with placeholders for files are shown."""
    notes: Sequence[str] = ()
    """Sentences that say what was not done, and why."""
    date: str = ""

    @property
    def lines(self) -> list[str | Table]:
        """Verdict, errors, warnings and next command, as ``pincal calibrate`` prints them."""
        result, errors = self.result, self.errors
        warnings = [f"warning: {text}" for text in answers.warnings(result)]
        following = answers.next_line(self.steps or answers.next_steps(result, errors))
        first, _ = answers.verdict(result, errors)
        return [first, *answers.summary(result, errors), *warnings, following]

    def __str__(self) -> str:
        return "\n".join(map(str, self.lines))

    @cached_property
    def _page(self) -> str:
        result, steps = self.result, self.steps or answers.next_steps(self.result, self.errors)
        parts = [self.date, f"{len(result.measurements)} rows", result.message]
        return rendered(
            "report.html",
            kind="calibration",
            name=result.nominal.name,
            description=result.nominal.description,
            subtitle=" · ".join(parts),
            warnings=answers.warnings(result),
            answers=answers.answers(result, self.errors, steps, self.notes),
            sections=[
                {"name": name, "title": title, "parts": filter(None, parts)}
                for name, title, *parts in _sections(self)
            ],
        )


def report(
    result: CalibrationResult,
    *,
    command: str = "",
    files: Sequence[str | Path] = (),
    date: str | None = None,
    workspace: Any = None,
) -> Report:
    """Return a report of a calibration, with ``html()`` and ``save(path)``; notebooks show it.

    Args:
        result: The calibration.
        command: Command line that reproduces it.
        files: Files that were read; the report holds their SHA-256.
        date: Date of the report; now if not given. Nothing else differs between two reports.
        workspace: Poses, a plan or its file, over which errors are stated; samples of the whole
            workspace if not given.

    Raises:
        FileError: a file cannot be read.
        MeasurementError: poses have a wrong shape.
    """
    if date is None:
        date = datetime.now().astimezone().strftime("%Y-%m-%d %H:%M %z")
    hashes = tuple(
        (path.name, sha256(read_bytes(path, LARGEST_FILE["table"], FileError)).hexdigest())
        for path in map(Path, files)
        if not path.is_fifo()  # a pipe can only be read once
    )
    poses = None if workspace is None else read_poses(workspace, result.nominal)
    errors = workspace_errors(result, poses) if result.converged else None
    return Report(result, errors, command, hashes, date=date)


def _sections(report: Report) -> list[tuple[Any, ...]]:
    """Return name, title and parts of each section; results only if the fit converged.

    Parts are paragraphs, lists of lines, facts by name, tables and figures; empty parts are not
    shown.
    """
    result, errors = report.result, report.errors
    measured = ("measured", "What was measured, and how well", _poses(result), _measured(result))
    libraries = ", ".join(f"{name} {version(name)}" for name in ("pin", "numpy", "scipy"))
    reproduction = (
        "reproduction",
        "How to reproduce it",
        answers.command_block(report.command),
        f"Made on {report.date} with pincal {__version__}, {libraries}, Python "
        f"{python_version()}. No random choice is involved.",
        Table("Files read, and their SHA-256", ["file", "SHA-256"], report.files)
        if report.files
        else None,
    )
    if errors is None:
        return [measured, reproduction]
    cameras = tables.cameras_table(result)
    return [
        measured,
        (
            "parameters",
            "Parameters",
            tables.parameters_table(result),
            tables.outside_table(result) if result.external else None,
        ),
        (
            "residuals",
            "Residuals before and after",
            tables.residuals_table(result),
            _chart(result, "residuals"),
            _chart(result, "images") if cameras else None,
            cameras,
            tables.outliers_table(result) if result.outliers else None,
        ),
        reproduction,
    ]


def _chart(result: CalibrationResult, name: str) -> Markup:
    """Return a chart with its docstring as the caption."""
    draw, height = getattr(result.plot, name), 3.4 if name == "images" else 4.2  # [inch]
    text, _, _ = str(getdoc(draw)).partition("\n\nRaises:")
    return page_figure(name, draw, capital(" ".join(text.split()[1:])), height)


def _poses(result: CalibrationResult) -> Markup | None:
    """Return a figure of the mechanism at the measured poses; None if no pose is complete."""
    data, poses = result.measurements, result.poses
    rows = np.flatnonzero(np.isfinite(poses).all(axis=1))
    if not len(rows):
        return None
    plan = Plan(poses, data.sets, data.readings).rows(rows[:: -(-len(rows) // MOST_POSES)])
    caption = f"The {len(rows)} measured poses of the platform, and the mechanism at the first."
    return page_figure("poses", picture(result.nominal, plan).draw, caption)


def _quantities(result: CalibrationResult) -> list[str]:
    """Return the platform's measured quantities with counts of rows, photos and points."""
    data, setup = result.measurements, result.options.setup
    columns = dict(zip(result.nominal.platform.coordinates, data.poses.T, strict=True))
    columns, seen_by = columns | dict(data.extra), list[str]()
    for device in setup.instruments:
        if pixels := setup.pixels & {*device.columns}:
            seen = np.isfinite([columns.pop(name) for name in pixels])
            photos, points = int(seen.any(axis=0).sum()), int(seen.sum()) // 2
            named = f"{counted(points, 'point')} in {counted(photos, 'photo')}"
            seen_by.append(f"{device.name} ({named})")
    counts = {name: int(np.isfinite(values).sum()) for name, values in columns.items()}
    return seen_by + [f"{k}{f' ({n} rows)' * (n < len(data))}" for k, n in counts.items() if n]


def _measured(result: CalibrationResult) -> dict[str, str]:
    nominal, data = result.nominal, result.measurements
    readings = zip(nominal.reading_names, nominal.reading_units, strict=True)
    facts = {
        "rows": str(len(data)),
        "of the platform": ", ".join(_quantities(result)) or "nothing",
        "readings": ", ".join(f"{name} [{unit}]" for name, unit in readings),
        "noise": answers.noise_line(result),
    }
    for name, values in (("sets", data.sets), ("runs", data.runs)):
        if values is not None:
            words = {"": "fitted", EVERY_LEG: "fitted", VERIFY: VERIFICATION}
            named = Counter(words.get(value, value) for value in values)
            facts[name] = ", ".join(f"{value} {count}" for value, count in named.items())
    if result.loss != "none":
        facts["loss"] = result.loss
    if result.gauge:
        facts["fixed by choice"] = answers.gauge_line(result)
    return facts


# Mechanisms and results in print and in notebooks


def mechanism_lines(mechanism: Mechanism) -> list[str]:
    """Return lines that describe the platform and each leg."""
    platform = mechanism.platform
    coordinates = zip(platform.coordinates, platform.home, platform.units, strict=True)
    home = (f"{name} {round(value, 9) + 0.0:.6g} {unit}" for name, value, unit in coordinates)
    lines = [f"{platform.kind} platform, at home {', '.join(home)}"]
    for leg in mechanism.legs:
        marks = {sensor.joint: "*" for sensor in leg.sensors}
        marks |= {j.name: f" (follows {j.leader.joint})" for j in leg.articulated if j.follows}
        joints = ", ".join(joint.name + marks.get(joint.name, "") for joint in leg.articulated)
        lines.append(f"{leg.name}: {joints}; {leg.closing}; {len(leg.parameters)} parameters")
    return [*lines, "* driven: its position is read"]


def mechanism_text(mechanism: Mechanism) -> str:
    """Return a mechanism as text: platform, legs, nominal parameters."""
    title = ": ".join(filter(None, (mechanism.name, mechanism.description)))
    table = str(tables.nominal_table(mechanism))
    return "\n".join([title, *mechanism_lines(mechanism), "", table])


def mechanism_html(mechanism: Mechanism) -> str:
    """Return a mechanism as HTML: a picture and its nominal parameters."""
    drawn = page_figure("mechanism", picture(mechanism).draw, f"{mechanism.name} at home")
    coordinates = ", ".join(mechanism.platform.coordinates)
    title = f"{mechanism.name}: {len(mechanism.legs)} legs, {coordinates}"
    parts = [*filter(None, [mechanism.description]), drawn, tables.nominal_table(mechanism)]
    return rendered("notebook.html", title=title, parts=parts)


def result_html(result: CalibrationResult) -> str:
    """Return a calibration as HTML: verdict, errors, next command, and its tables."""
    parts = [*result.report().lines, *(result.tables() if result.converged else ())]
    return rendered("notebook.html", title="", parts=parts)
