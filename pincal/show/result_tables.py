"""Residuals, directions and tables of a calibration, in the units in which people read them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from pincal.calibration.leg_result import IdentifiedParameter, LegResult, Observed
from pincal.calibration.result import CalibrationResult
from pincal.calibration.runs import RunComparison
from pincal.estimation.observability.indices import RANK_TOLERANCE
from pincal.model.measurements import Noise
from pincal.types import Array, Index
from pincal.words.numbers import VALUES
from pincal.words.sentences import WORDINGS, sentence
from pincal.words.table import Cell, Quantity, Table, Uncertainty, UnitOf, Value, columns
from pincal.words.wording import noise_in_words

#: Redundancy up to which a residual is what the fit made of it, and says nothing of the noise.
CONTROLLED = 1e-3


@dataclass(frozen=True)
class Series:
    """Residuals of a leg, or of a measured quantity of the platform."""

    name: str
    unit: str
    rows: Index
    before: Array
    """With nominal parameters, at the poses that suit these best where poses are unknowns."""
    after: Array
    sigma: Array
    """Of the noise."""
    of_leg: bool
    redundancy: Array | None = None
    """Variance after the fit over that of the noise, 1 − h; None of results saved before that was
    kept."""

    @property
    def spread(self) -> Array:
        """Standard deviation after the fit, σ√(1−h); that of the noise if h is not known."""
        return self.sigma if self.redundancy is None else self.sigma * np.sqrt(self.redundancy)

    @property
    def standardised(self) -> Array:
        """Residuals after the fit over their standard deviations; NaN where nothing checks one."""
        least = np.sqrt(CONTROLLED) * self.sigma
        checked = (self.spread > least) & (self.sigma > 0.0)
        return np.where(checked, self.after, np.nan) / np.where(checked, self.spread, 1.0)

    @property
    def rms(self) -> tuple[float, float, float]:
        """Root mean squares before, after, and of the standard deviations; NaN of no rows."""
        if not len(self.rows):
            return np.nan, np.nan, np.nan
        three = np.array([self.before, self.after, self.sigma])
        before, after, sigma = np.sqrt(np.mean(three**2, axis=1)).tolist()
        return before, after, sigma


def legs_series(result: CalibrationResult) -> list[Series]:
    """Return the residuals of the legs."""
    scale = np.sqrt(result.reduced_chi2) if result.noise_source == "estimated" else 1.0
    return [_series(leg, leg.sigma * scale) for leg in result.legs]


def observed_series(result: CalibrationResult) -> list[Series]:
    """Return the residuals of what was measured of the platform, where poses are unknowns."""
    return [_series(observed, observed.sigmas) for observed in result.observed]


def _series(block: LegResult | Observed, sigma: Array) -> Series:
    fields = block.rows, block.residuals_before, block.residuals, sigma
    return Series(block.name, block.unit, *fields, isinstance(block, LegResult), block.redundancy)


def noisy_series(result: CalibrationResult) -> list[Series]:
    """Return residuals that carry noise: of legs, of the platform if legs cannot miss, or both.

    Both where readings have noise: they share with the platform what is missed.
    """
    if readings_exact(result):
        return observed_series(result)
    shared = any(leg.quantity == "reading" for leg in result.legs)
    return legs_series(result) + (observed_series(result) if shared else [])


def whose(series: Sequence[Series]) -> str:
    """Return what residuals are of: leg, measured quantity, or both."""
    names = {True: "leg", False: "measured quantity"}
    return " and ".join(dict.fromkeys(names[block.of_leg] for block in series))


def readings_exact(result: CalibrationResult) -> bool:
    """Return whether legs close by construction, so that only the platform can miss something."""
    return bool(result.observed) and not any((leg.sigma > 0.0).any() for leg in result.legs)


def noise_said(result: CalibrationResult, sizes: Noise) -> str:
    """Return standard deviations of what was measured, each in its unit."""
    observed = result.calibration.observation
    columns = zip(observed.units, observed.measured.T, strict=True)
    measured_units = {unit for unit, values in columns if values.any()}
    return noise_in_words(
        sizes.position if "m" in measured_units else None,
        sizes.orientation if "rad" in measured_units else None,
        sizes.reading,
        sorted(set(result.nominal.reading_units)),
    )


def turns(result: CalibrationResult) -> bool:
    """Return whether the platform has an orientation."""
    return "rad" in result.nominal.platform.units


def parameters(result: CalibrationResult) -> Iterator[tuple[LegResult, IdentifiedParameter]]:
    """Yield every parameter of the legs with its leg."""
    for leg in result.legs:
        for p in leg.parameters:
            yield leg, p


class Directions(NamedTuple):
    """Directions of parameters, by how well they were identified."""

    ids: list[str]
    """Of what was identified, length n."""
    values: Array
    """Singular values of the Jacobian with columns of unit length, the largest first, shape (r,):
    about 1 where parameters are independent, near 0 where errors of several go together."""
    vectors: Array
    """Columns, in the units below, shape (n, r)."""
    units: Array
    """Standard errors of the parameters if all others were known, shape (n,)."""


def directions(result: CalibrationResult) -> Directions:
    """Return the directions of what was identified; those fixed by choice are left out."""
    ids = [p.id for _, p in parameters(result)]
    std = np.sqrt(np.diagonal(result.covariance))
    free = np.flatnonzero(np.isfinite(std) & (std > 0.0))
    scale = np.outer(std[free], std[free])
    values, axes = np.linalg.eigh(result.covariance[np.ix_(free, free)] / scale)
    determined = values > RANK_TOLERANCE * values.max(initial=0.0)
    information = (axes[:, determined] / values[determined]) @ axes[:, determined].T
    lengths = np.sqrt(np.diagonal(information))
    squares, vectors = np.linalg.eigh(information / np.outer(lengths, lengths))
    squares, vectors = squares[::-1][: determined.sum()], vectors[:, ::-1][:, : determined.sum()]
    singular = np.sqrt(np.maximum(squares, 0.0))
    return Directions([ids[i] for i in free], singular, vectors, std[free] / lengths)


def warnings(result: CalibrationResult) -> list[str]:
    """Return the warnings; one that several legs share is said once, with their names."""
    legs: dict[str, list[str]] = {}
    for text in result.warnings:
        name, colon, text_of_leg = text.partition(": ")
        of_leg = bool(colon) and name in result.nominal.leg_names
        legs.setdefault(text_of_leg if of_leg else text, []).extend([name] if of_leg else [])
    return [f"{', '.join(names)}: {text}" if names else text for text, names in legs.items()]


def gauge(result: CalibrationResult) -> list[str]:
    """Return what was fixed by choice, lists cut where they are long (result.json has all)."""
    return [sentence(finding) for finding in result.gauge]


def unpromised(result: CalibrationResult) -> str:
    """Return why no limit is promised, in titles of findings; empty if one is."""
    titles = dict.fromkeys(WORDINGS[finding.code].title for finding in result.contradictions)
    return ", ".join(title[:1].lower() + title[1:] for title in titles)


_MOST_SIGMAS = 1e6  # standard errors, above which their number says nothing
_HEADS = ("parameter", "nominal", "identified", "± 95 %", "unit", "change", "change [σ]")
_SIZES = ("rms before", "rms after", "σ", "unit")
_SHIFT = "change [σ]: by how many standard errors the parameter moved"
_SIGMA = "σ: what the noise alone makes of residuals"
_CONDITION = "condition: of the leg's whitened identification Jacobian, columns scaled"


def calibration_tables(result: CalibrationResult) -> list[Table]:
    """Return all tables of a calibration that a terminal shows."""
    tables = [parameters_table(result), legs_table(result)]
    tables += [outside_table(result)] if result.external else []
    tables += [observed_table(result)] if result.observed else []
    tables += [outliers_table(result)] if result.outliers and result.loss != "none" else []
    return tables


def parameters_table(result: CalibrationResult) -> Table:
    """Return identified parameters with 95 % intervals and changes."""
    sources = [p.given.replace("fixed", "") for _, p in parameters(result)]
    source_head = ["given"] if any(sources) else []
    return Table(
        f"{result.nominal.name}: parameters, nominal and identified",
        columns("leg", *_HEADS, *source_head, units=VALUES),
        [
            (leg.name, *_cells(p), *[source] * len(source_head))
            for (leg, p), source in zip(parameters(result), sources, strict=True)
        ],
        "; ".join(filter(None, (f"{_SHIFT}{_chosen(result)}", result.nominal.labelled))),
        grouped=True,
    )


def _chosen(result: CalibrationResult) -> str:
    """Return what values and ± depend on, where freedoms were fixed by choice."""
    if not result.gauge:
        return ""
    return (
        ". Values and ± depend on what was fixed by choice, of equal parameters those nearest to "
        "nominal; errors of the platform do not"
    )


def _cells(p: IdentifiedParameter) -> tuple[Value, ...]:
    """Return the cells of a parameter below ``_HEADS``."""
    half, change = p.half, p.identified - p.nominal
    known = half > 0.0 and np.isfinite(p.std)
    none = Cell(None, "∞" if half else p.given or "held")
    return (
        p.name,
        Quantity(p.nominal, p.unit, half),
        Quantity(p.identified, p.unit, half),
        Uncertainty(half, p.unit) if known else none,
        UnitOf(p.unit),
        Cell(change, "") if p.given == "fixed" else Quantity(change, p.unit, half, sign="+"),
        Cell(change / p.std, _moved(change / p.std)) if 0.0 < p.std < np.inf else None,
    )


def _moved(sigmas: float) -> str:
    """Return by how many standard errors a parameter moved, or that they are many."""
    return f"{sigmas:+.1f}" if abs(sigmas) < _MOST_SIGMAS else "> 1e6"


def outside_table(result: CalibrationResult) -> Table:
    """Return the unknowns outside the mechanism: frames and targets."""
    return Table(
        "Outside the mechanism",
        columns("unknown", "start", *_HEADS[2:5], units=VALUES),
        [(p.id, *_cells(p)[1:5]) for p in result.external],
        "tracker: where the base is in the frame of the measurements (rx, ry, rz a rotation "
        "vector); others: where what was measured is on the platform; start: where the search "
        f"began, measured positions laid on those of the nominal machine{_chosen(result)}",
    )


def legs_table(result: CalibrationResult) -> Table:
    """Return residuals, rank and condition of each leg."""
    exact = readings_exact(result)
    table = Table(
        "Legs: residuals, rank and condition",
        columns("leg", *_SIZES, "poses", "rank", "condition:.3g"),
        [
            (
                leg.name,
                *_sizes(series),
                leg.n_poses,
                Cell(leg.rank, f"{leg.rank} of {len(leg.parameters)}"),
                leg.condition,
            )
            for leg, series in zip(result.legs, legs_series(result), strict=True)
        ],
        f"{_SIGMA}; {_CONDITION}",
    )
    if not exact:
        return table
    table = table.only("leg", "poses", "rank", "condition", caption=_CONDITION)
    return replace(table, title="Legs; readings were taken as exact")


def residuals_table(result: CalibrationResult) -> Table:
    """Return the residuals of the legs alone."""
    table = legs_table(result).only("leg", *_SIZES, "poses", caption=_SIGMA)
    return replace(table, title="Residuals of the legs")


def rank_table(result: CalibrationResult) -> Table:
    """Return rank and condition of the legs alone."""
    table = legs_table(result).only("leg", "rank", "condition", caption=_CONDITION)
    return replace(table, title="Rank and condition of the legs")


def observed_table(result: CalibrationResult) -> Table:
    """Return how the measured quantities of the platform fit, where poses are unknowns."""
    return Table(
        "The platform as measured, at the estimated poses",
        columns("measured", "rows", *_SIZES),
        [(series.name, len(series.rows), *_sizes(series)) for series in observed_series(result)],
    )


def _sizes(series: Series) -> tuple[Value, ...]:
    """Return root mean squares before and after, σ, and the unit."""
    return (
        *(Quantity(value, series.unit, format=".4f") for value in series.rms),
        UnitOf(series.unit),
    )


def outliers_table(result: CalibrationResult, most: int = 20) -> Table:
    """Return the worst of the rows that do not fit."""
    every = {leg.name for leg in result.legs}
    omitted = len(result.outliers) - most
    return Table(
        f"Rows that do not fit, the worst first (robust loss: {result.loss})",
        columns("data row", "residual [σ]:.1f", "weight:.2f", "of", "what"),
        [
            (
                outlier.row + 1,
                outlier.sigma,
                Cell(0.0, "rejected") if outlier.weight == 0.0 else outlier.weight,
                "all legs" if set(outlier.legs) == every else ", ".join(outlier.legs),
                f"{outlier.quantity} off by {outlier.off:.1f} σ",
            )
            for outlier in result.outliers[:most]
        ],
        f"and {omitted} more in result.json" if omitted > 0 else "",
    )


def files_table(files: Sequence[tuple[str, str]]) -> Table:
    """Return files that were read, and their SHA-256."""
    return Table("Files read, and their SHA-256", columns("file", "SHA-256"), files)


def runs_table(runs: RunComparison) -> Table:
    """Return the spread of parameters over runs against their standard errors."""
    return Table(
        "Spread of the parameters over the runs, against their standard errors, in SI",
        columns("parameter", "spread:.3g", "predicted:.3g"),
        list(zip(runs.names, runs.spread.tolist(), runs.predicted.tolist(), strict=True)),
    )
