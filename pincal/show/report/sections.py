"""What a report's sections show: facts, tables and figures by name; their words are the page's."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from typing import Any

import numpy as np

from pincal.calibration.result import CalibrationResult
from pincal.model.measurements import EVERY_LEG, Noise
from pincal.show.report import figures
from pincal.show.report.findings import Findings
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
from pincal.show.results import gauge, noise_said, promised, readings_exact
from pincal.show.summary import check_lines, method_line, tie_lines, weak_lines
from pincal.words.numbers import capital
from pincal.words.table import Column, Table

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


def shown(
    found: Findings, files: tuple[tuple[str, str], ...], notes: tuple[str, ...]
) -> dict[str, Any]:
    """Return what the page of a report shows, by name; nothing of a fit that did not converge.

    Args:
        found: The calibration.
        files: Those that were read, and their SHA-256.
        notes: Sentences beside those on held-out rows and runs.
    """
    result, drawn = found.result, {"poses": figures.poses_figure(found)}
    heads = Column("file"), Column("SHA-256")
    hashes = Table("Files read, and their SHA-256", heads, files)
    tables = {"files": hashes if files else None}
    units = result.nominal.platform.units
    always = {
        "method": method_line(result),
        "facts": _facts(found),
        "lengths": result.nominal.platform.coordinates[: units.count("m")],
        "figures": drawn,
        "tables": tables,
    }
    if not result.converged:
        return always
    drawn |= {
        "changes": figures.changes_figure(found),
        "residuals": figures.residuals_figure(found),
        "histogram": figures.histogram_figure(found),
        "platform": figures.platform_figure(found),
        "maps": figures.maps_figure(found),
        "observability": figures.observability_figure(found),
    }
    legs, runs = legs_table(result), result.runs
    sizes = legs.only("leg", "rms before", "rms after", "σ", "unit", "poses", caption=SIGMA)
    rank = legs.only("leg", "rank", "condition", caption=CONDITION)
    tables |= {
        "parameters": parameters_table(result),
        "outside": outside_table(result) if result.external else None,
        "legs": replace(sizes, title="Residuals of the legs"),
        "observed": observed_table(result) if result.observed else None,
        "rank": replace(rank, title="Rank and condition of the legs"),
        "outliers": outliers_table(result, 50) if result.outliers else None,
        "runs": runs_table(runs) if runs is not None else None,
    }
    checks = [capital(line) for line in (*tie_lines(result), *check_lines(result))]
    return always | {
        "exact": readings_exact(result),
        "no_maps": "" if found.maps else _why_no_maps(result),
        "weak": [f"{line}." for line in weak_lines(result.weak, result.nominal)],
        "checks": [f"{line}." for line in (*checks, *notes)],
    }


def _facts(found: Findings) -> dict[str, str]:
    """Return what was measured, and how well."""
    result, mechanism = found.result, found.result.nominal
    read = zip(mechanism.reading_names, mechanism.reading_units, strict=True)
    residual = "reading" if result.options.latent else result.options.residual
    facts = {
        "mechanism": mechanism.name,
        "rows": _rows(result),
        "of the platform": _columns(result),
        "readings": ", ".join(f"{name} [{unit}]" for name, unit in read),
        "noise": f"{_SOURCES.get(result.noise_source, result.noise_source)}: {_noise(result)}",
        "identified": f"{method_line(result)}; {_RESIDUALS[residual]}",
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
    return facts


def _rows(result: CalibrationResult) -> str:
    data = result.measurements
    parts = [f"{len(data)}"]
    for name, values in (("sets", data.sets), ("runs", data.runs)):
        if values is not None:
            counts = Counter("every leg" if one in ("", EVERY_LEG) else one for one in values)
            parts.append(f"{name}: {', '.join(f'{one} {n}' for one, n in counts.items())}")
    if data.places is not None:
        parts.append(f"{len(set(data.places))} poses, some measured more than once")
    return "; ".join(parts)


def _columns(result: CalibrationResult) -> str:
    """Return which quantities of the platform were measured, and how often if not always."""
    data, platform = result.measurements, result.nominal.platform
    columns = dict(zip(platform.coordinates, data.poses.T, strict=True)) | dict(data.extra)
    counts = {name: int(np.isfinite(values).sum()) for name, values in columns.items()}
    often = {name: "" if n == len(data) else f" ({n} rows)" for name, n in counts.items() if n}
    return ", ".join(map("".join, often.items())) or "nothing"


def _noise(result: CalibrationResult) -> str:
    """Return standard deviations of what was measured."""
    if result.noise is not None:
        return f"σ {noise_said(result, result.noise)}"
    data, units = result.measurements, np.array(result.nominal.platform.units)
    sigma = data.sigma_poses
    parts = [None if sigma is None else sigma[:, units == unit] for unit in ("m", "rad")]
    known = (
        np.ones(0) if one is None else one[np.isfinite(one)]
        for one in (*parts, data.sigma_readings)
    )
    middle = (float(np.median(one)) if one.size else 0.0 for one in known)
    return f"σ, median of the rows: {noise_said(result, Noise(*middle))}"


def _why_no_maps(result: CalibrationResult) -> str:
    if promised(result) is None:
        return "no accuracy can be promised"
    if result.nominal.by_readings:
        return "its poses are made from readings, and do not fill a plane"
    return "no workspace was found with the default margins"
