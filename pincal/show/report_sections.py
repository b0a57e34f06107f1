"""Sections of a report: words, tables and figures on one subject each."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence

import numpy as np

from pincal.calibration.result import CalibrationResult
from pincal.model.measurements import EVERY_LEG, Noise
from pincal.model.mechanism import Mechanism
from pincal.show.calibration import sentence, shortened, trust_in_words
from pincal.show.findings import Findings
from pincal.show.markup import Content, Element, bullets, table, tag
from pincal.show.markup_tables import (
    LISTED,
    external_table,
    observed_table,
    outliers_table,
    parameters_table,
    residuals_table,
)
from pincal.show.report_figures import (
    changes_figure,
    observability_figure,
    platform_figure,
    poses_figure,
)
from pincal.show.report_maps import maps_figure
from pincal.show.report_residuals import histogram_figure, residuals_figure
from pincal.show.series import readings_exact
from pincal.show.tables import SHOWN, weak_in_words
from pincal.words.sentences import sentence as said

_METHODS = {
    "per-leg": "each leg alone, poses as measured",
    "all-legs": "all legs at once, with the poses of the platform as unknowns",
}
_RESIDUALS = {
    "closure": "closure residuals: by how much a leg misses the platform point, weighted by the "
    "noise",
    "joint": "joint residuals: predicted less measured readings, not weighted",
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


def section(name: str, title: str, *content: Content) -> Element:
    """Return a section of a report."""
    return tag("section", tag("h2", title), *content, id=name)


def measured(found: Findings) -> Element:
    """Return what was measured, and how well."""
    result, data = found.result, found.data
    platform = result.nominal.platform
    facts: list[tuple[str, Content]] = [
        ("mechanism", result.nominal.name),
        ("rows", _rows(found)),
        ("of the platform", _columns(found)),
        ("readings", ", ".join(_readings(result.nominal))),
        ("noise", f"{_SOURCES.get(result.noise_source, result.noise_source)}: {_noise(found)}"),
        ("identified", f"{_METHODS[result.method]}; {_RESIDUALS[result.options.residual]}"),
    ]
    if not result.options.every_pose and data.sets is not None:
        facts.append(("poses", "each leg uses the poses that were chosen for it"))
    if result.loss != "none":
        facts.append(("robust loss", result.loss))
    if result.external:
        names = ", ".join(p.id for p in result.external)
        facts.append(("unknown outside", f"{names}: see below"))
    if result.gauge:
        facts.append(
            (
                "fixed by choice",
                "no such measurement can tell it, so of equal parameters those nearest to nominal "
                f"were taken: {'; '.join(map(shortened, map(said, result.gauge)))}",
            )
        )
    listed = tag("dl")
    for name, text in facts:
        listed.append(tag("dt", name))
        listed.append(tag("dd", text))
    words = platform.coordinates[: platform.units.count("m")]
    where = f"Positions {', '.join(words)} are those of the platform's frame in the base frame"
    plain = not result.external and result.method != "latent"
    return section(
        "measured",
        "What was measured, and how well",
        listed,
        tag("p", f"{where}.") if plain else None,
        poses_figure(found),
    )


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
    told = [
        name if count == len(data) else f"{name} ({count} rows)"
        for name, count in counts.items()
        if count
    ]
    return ", ".join(told) or "nothing"


def _noise(found: Findings) -> str:
    """Return standard deviations of what was measured."""
    noise, data = found.result.noise, found.data
    if noise is None:
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
        noise = Noise(*middle)
        return f"σ, median of the rows: {_sigmas(noise, found)}"
    return f"σ {_sigmas(noise, found)}"


def _sigmas(noise: Noise, found: Findings) -> str:
    angles = np.array([unit == "rad" for unit in found.result.nominal.platform.units])
    told, more = np.isfinite(found.data.poses), bool(found.data.extra)
    parts = []
    if told[:, ~angles].any() or more:
        parts.append(f"{1e3 * noise.position:.3g} mm in position")
    if told[:, angles].any() or (more and found.turns):
        parts.append(f"{1e3 * noise.orientation:.3g} mrad in orientation")
    units = {SHOWN[unit][0] for unit in found.result.nominal.reading_units}
    reading = f"{1e3 * noise.reading:.3g} {' or '.join(sorted(units))} in readings"
    return ", ".join([*parts, reading if noise.reading else "readings exact"])


def parameters(found: Findings) -> Element:
    """Return all parameters by leg, and those outside the mechanism."""
    result = found.result
    outside = external_table(result) if result.external else None
    return section(
        "parameters", "Parameters", parameters_table(result), changes_figure(found), outside
    )


def residuals(found: Findings) -> Element:
    """Return residuals by leg, row and size."""
    observed = observed_table(found.result) if found.result.observed else None
    figures = (residuals_figure(found), histogram_figure(found))
    title = "Residuals before and after"
    if readings_exact(found.result):
        return section("residuals", title, tag("p", _EXACT), observed, *figures)
    return section("residuals", title, residuals_table(found.result), *figures, observed)


def platform(found: Findings) -> Element:
    """Return the platform's errors over the workspace."""
    maps = found.maps
    return section(
        "platform",
        "Error of the platform",
        platform_figure(found),
        maps_figure(maps, found.turns)
        if maps is not None
        else tag("p", f"No maps: {_why_no_maps(found.result.nominal)}."),
    )


def observability(found: Findings) -> Element:
    """Return how well the poses used tell the parameters."""
    rows = [
        (leg.name, f"{leg.rank} of {len(leg.parameters)}", f"{leg.condition:.3g}")
        for leg in found.result.legs
    ]
    caption = "Rank and condition of each leg's identification Jacobian, whitened, columns scaled"
    weak = weak_in_words(found.result.weak, found.result.nominal)
    return section(
        "observability",
        "Observability",
        table(caption, ("leg", "rank", "condition"), rows, groups=1),
        observability_figure(found),
        bullets(f"{line}." for line in weak) if weak else None,
    )


def outliers(result: CalibrationResult) -> Element:
    """Return rows that were rejected, weighted down, or just do not fit."""
    title = "What was rejected or weighted down"
    loss = "No robust loss was used" if result.loss == "none" else f"Robust loss: {result.loss}"
    if not result.outliers:
        return section("outliers", title, tag("p", f"{loss}; all rows fit each other."))
    more = len(result.outliers) - LISTED
    moved = (
        ""
        if result.shift is None
        else f" With these rows, parameters would move by up to {result.shift:.1f} standard errors."
    )
    return section(
        "outliers",
        title,
        tag("p", f"{loss}; rows that do not fit the others: {len(result.outliers)}.{moved}"),
        outliers_table(result),
        tag("p", f"And {more} more in result.json.") if more > 0 else None,
    )


def trust(result: CalibrationResult, notes: Sequence[str]) -> Element:
    """Return ties, held-out rows and runs."""
    lines: list[str] = [
        f"Tie of {one.name}: {'holds' if one.holds else 'is contradicted'} (p = {one.p_value:.2g}, "
        f"{one.restrictions} parameters fewer)."
        for one in result.ties
    ]
    lines += [f"{sentence(text)}." for text in trust_in_words(result)]
    lines += [f"{text}." for text in notes]
    content: list[Content] = [bullets(lines or ["No rows were held out, and no ties tested."])]
    if (runs := result.runs) is not None:
        content.append(
            table(
                "Spread of the parameters over the runs, against their standard errors, in SI",
                ("parameter", "spread", "predicted"),
                [
                    (name, f"{spread:.3g}", f"{predicted:.3g}")
                    for name, spread, predicted in zip(
                        runs.names, runs.spread, runs.predicted, strict=True
                    )
                ],
            )
        )
    return section("trust", "Held-out rows, ties and runs", *content)


def reproduction(
    command: str, versions: Iterable[str], files: Iterable[tuple[str, str]], date: str
) -> Element:
    """Return how to make the same result again."""
    rows = list(files)
    return section(
        "reproduction",
        "How to reproduce it",
        tag("pre", tag("code", command)) if command else None,
        tag("p", f"Made on {date} with {', '.join(versions)}. No random choice is involved."),
        table("Files read, and their SHA-256", ("file", "SHA-256"), rows) if rows else None,
    )


def _why_no_maps(mechanism: Mechanism) -> str:
    if mechanism.by_readings:
        return "its poses are made from readings, and do not fill a plane"
    return "no workspace was found with the default margins"


def _readings(mechanism: Mechanism) -> list[str]:
    """Return the names of readings with their units."""
    read = zip(mechanism.reading_names, mechanism.reading_units, strict=True)
    return [f"{name} [{unit}]" for name, unit in read]
