"""What a report says was measured, how, and what was checked, each in a line."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from pincal.calibration.result import CalibrationResult
from pincal.model.measuring.measurements import EVERY_LEG, Noise
from pincal.show.results import noise_said
from pincal.show.summary import check_lines, tie_lines
from pincal.words.numbers import capital, counted

SOURCES = {
    "given": "as given",
    "rows": "of each row, in the measurements",
    "repeats": "from rows that were measured repeatedly",
    "estimated": "estimated from the residuals, since none was given",
}


def residuals(result: CalibrationResult) -> str:
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
            counts = Counter("every leg" if one in ("", EVERY_LEG) else one for one in values)
            parts.append(f"{name}: {', '.join(f'{one} {n}' for one, n in counts.items())}")
    if data.places is not None:
        counts = Counter(name for name in data.places if name)
        again = sum(n > 1 for n in counts.values())
        parts.append(f"{counted(again, 'pose')} measured more than once")
    return "; ".join(parts)


def columns(result: CalibrationResult) -> str:
    """Return which quantities of the platform were measured, and how often if not always."""
    data, platform = result.measurements, result.nominal.platform
    measured = dict(zip(platform.coordinates, data.poses.T, strict=True)) | dict(data.extra)
    counts = {name: int(np.isfinite(values).sum()) for name, values in measured.items()}
    often = {name: "" if n == len(data) else f" ({n} rows)" for name, n in counts.items() if n}
    return ", ".join(map("".join, often.items())) or "nothing"


def noise(result: CalibrationResult) -> str:
    """Return standard deviations of what was measured."""
    if result.noise is not None:
        return f"σ {noise_said(result, result.noise)}"
    data, units = result.measurements, np.array(result.nominal.platform.units)
    sigma = data.sigma_poses
    parts = [None if sigma is None else sigma[:, units == unit] for unit in ("m", "rad")]
    middle = [
        0.0 if one is None or not np.isfinite(one).any() else float(np.nanmedian(one))
        for one in (*parts, data.sigma_readings)
    ]
    return f"σ, median of the rows: {noise_said(result, Noise(*middle))}"


def checks(result: CalibrationResult, notes: Sequence[str]) -> list[str]:
    """Return what ties, held-out rows and runs show, and notes on what was not done."""
    lines = [capital(line) for line in (*tie_lines(result), *check_lines(result))]
    return [f"{line}." for line in (*lines, *notes)]
