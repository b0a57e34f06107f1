"""Sections of a report: words, tables and figures on one subject each."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from pincal.calibration.result import CalibrationResult
from pincal.model.measurements import EVERY_LEG, Noise
from pincal.show.report.figures import (
    changes_figure,
    observability_figure,
    platform_figure,
    poses_figure,
)
from pincal.show.report.findings import Findings
from pincal.show.report.maps import maps_figure
from pincal.show.report.parts import Command, Part, Section
from pincal.show.report.residuals import histogram_figure, residuals_figure
from pincal.show.result_tables import (
    CONDITION,
    SIGMA,
    legs_table,
    observed_table,
    outliers_table,
    outside_table,
    parameters_table,
    runs_table,
)
from pincal.show.results import gauge, noise_said, readings_exact
from pincal.show.summary import check_lines, method_line, tie_lines, weak_lines
from pincal.words.numbers import capital
from pincal.words.table import Column, Table

_LISTED = 50  # outliers in the table; all are in result.json
_RESIDUALS = {
    "closure": "closure residuals: by how much a leg misses the platform point, weighted by the "
    "noise",
    "joint": "joint residuals: predicted less measured readings, not weighted",
    "reading": "predicted less measured readings and quantities of the platform, weighted by the "
    "noise",
}
_SOURCES = {
    "given": "as given",
    "rows": "of each row, in the measurements",
    "repeats": "from rows that were measured repeatedly",
    "estimated": "estimated from the residuals, since none was given",
}
_EXACT = (
    "Readings were taken as exact: the legs close by construction, and what the model leaves over "
    "is by how much the platform misses what was measured of it."
)


def measured(found: Findings) -> Section:
    """Return what was measured, and how well."""
    result = found.result
    platform, mechanism = result.nominal.platform, result.nominal
    read = zip(mechanism.reading_names, mechanism.reading_units, strict=True)
    facts = {
        "mechanism": mechanism.name,
        "rows": _rows(found),
        "of the platform": _columns(found),
        "readings": ", ".join(f"{name} [{unit}]" for name, unit in read),
        "noise": f"{_SOURCES.get(result.noise_source, result.noise_source)}: {_noise(found)}",
        "identified": f"{method_line(result)}; {_RESIDUALS[_residual(result)]}",
    }
    if result.loss != "none":
        facts["robust loss"] = result.loss
    if result.external:
        names = ", ".join(p.id for p in result.external)
        facts["unknown outside"] = f"{names}: see below"
    if result.gauge:
        facts["fixed by choice"] = (
            "no such measurement can determine it, so of equal parameters those nearest to nominal "
            f"were taken: {'; '.join(gauge(result))}"
        )
    words = platform.coordinates[: platform.units.count("m")]
    where = f"Positions {', '.join(words)} are those of the platform's frame in the base frame."
    plain = result.options.setup.plain
    parts = (facts, where if plain else None, poses_figure(found))
    return Section("measured", "What was measured, and how well", parts)


def _residual(result: CalibrationResult) -> str:
    return "reading" if result.options.latent else result.options.residual


def _rows(found: Findings) -> str:
    data = found.data
    text = f"{len(data)}"
    for name, values in (("sets", data.sets), ("runs", data.runs)):
        if values is not None:
            counts = Counter(values)
            text += f"; {name}: " + ", ".join(
                f"{'every leg' if one in ('', EVERY_LEG) else one} {n}" for one, n in counts.items()
            )
    if data.places is not None:
        text += f"; {len(set(data.places))} poses, some measured more than once"
    return text


def _columns(found: Findings) -> str:
    """Return which quantities of the platform were measured, and how often if not always."""
    data, platform = found.data, found.result.nominal.platform
    columns = dict(zip(platform.coordinates, data.poses.T, strict=True)) | dict(data.extra)
    counts = {name: int(np.isfinite(values).sum()) for name, values in columns.items()}
    shown = [
        name if count == len(data) else f"{name} ({count} rows)"
        for name, count in counts.items()
        if count
    ]
    return ", ".join(shown) or "nothing"


def _noise(found: Findings) -> str:
    """Return standard deviations of what was measured."""
    noise, data = found.result.noise, found.data
    if noise is not None:
        return f"σ {noise_said(found.result, noise)}"
    sigma = data.sigma_poses
    linear = np.array([unit == "m" for unit in found.result.nominal.platform.units])
    middle = [
        0.0 if values is None or not np.isfinite(values).any() else float(np.nanmedian(values))
        for values in (
            None if sigma is None else sigma[:, linear],
            None if sigma is None else sigma[:, ~linear],
            data.sigma_readings,
        )
    ]
    return f"σ, median of the rows: {noise_said(found.result, Noise(*middle))}"


def parameters(found: Findings) -> Section:
    """Return all parameters by leg, and those outside the mechanism."""
    result = found.result
    outside = outside_table(result) if result.external else None
    parts = (parameters_table(result), changes_figure(found), outside)
    return Section("parameters", "Parameters", parts)


def residuals(found: Findings) -> Section:
    """Return residuals by leg, row and size."""
    result = found.result
    observed = observed_table(result) if result.observed else None
    figures = (residuals_figure(found), histogram_figure(found))
    heads = ("leg", "rms before", "rms after", "σ", "unit", "poses")
    legs = replace(legs_table(result).only(*heads, caption=SIGMA), title="Residuals of the legs")
    parts: tuple[Part, ...] = (legs, *figures, observed)
    if readings_exact(result):
        parts = (_EXACT, observed, *figures)
    return Section("residuals", "Residuals before and after", parts)


def platform(found: Findings) -> Section:
    """Return the platform's errors over the workspace."""
    shown: Part = f"No maps: {_why_no_maps(found.result)}."
    if found.maps is not None:
        shown = maps_figure(found.maps, found.turns)
    return Section("platform", "Error of the platform", (platform_figure(found), shown))


def observability(found: Findings) -> Section:
    """Return how well the poses used determine the parameters."""
    weak = weak_lines(found.result.weak, found.result.nominal)
    table = legs_table(found.result).only("leg", "rank", "condition", caption=CONDITION)
    table = replace(table, title="Rank and condition of the legs")
    parts = (table, observability_figure(found), [f"{line}." for line in weak] or None)
    return Section("observability", "Observability", parts)


def outliers(result: CalibrationResult) -> Section:
    """Return rows that were rejected, weighted down, or just do not fit."""
    title = "What was rejected or weighted down"
    loss = "No robust loss was used" if result.loss == "none" else f"Robust loss: {result.loss}"
    if not result.outliers:
        return Section("outliers", title, (f"{loss}; all rows fit each other.",))
    moved = (
        ""
        if result.shift is None
        else f" With these rows, parameters would move by up to {result.shift:.1f} standard errors."
    )
    said = f"{loss}; rows that do not fit the others: {len(result.outliers)}.{moved}"
    return Section("outliers", title, (said, outliers_table(result, _LISTED)))


def checks(result: CalibrationResult, notes: Sequence[str]) -> Section:
    """Return ties, held-out rows and runs."""
    lines = [f"{capital(text)}." for text in (*tie_lines(result), *check_lines(result))]
    lines += [f"{text}." for text in notes]
    parts: list[Part] = [lines or ["No rows were held out, and no ties tested."]]
    if (runs := result.runs) is not None:
        parts.append(runs_table(runs.names, runs.spread.tolist(), runs.predicted.tolist()))
    return Section("checks", "Held-out rows, ties and runs", tuple(parts))


def reproduction(
    command: str, versions: Iterable[str], files: Sequence[tuple[str, str]], date: str
) -> Section:
    """Return how to make the same result again."""
    hashes = Table("Files read, and their SHA-256", (Column("file"), Column("SHA-256")), files)
    parts = (
        Command(command) if command else None,
        f"Made on {date} with {', '.join(versions)}. No random choice is involved.",
        hashes if files else None,
    )
    return Section("reproduction", "How to reproduce it", parts)


def _why_no_maps(result: CalibrationResult) -> str:
    if not result.explained:
        return "no accuracy can be promised"
    if result.nominal.by_readings:
        return "its poses are made from readings, and do not fill a plane"
    return "no workspace was found with the default margins"
