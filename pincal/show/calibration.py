"""What a calibration found, for people: tables, and sentences on whether to trust it."""

from __future__ import annotations

from rich.console import Group, RenderableType

from pincal.identification.result import CalibrationResult
from pincal.model.measurements import Measurements
from pincal.show.tables import SHOWN, plain_table, titled, weak_in_words
from pincal.show.workspace_errors import WorkspaceErrors

_NO_FREEDOM = (
    "as many unknowns as measured values: residuals vanish whatever the machine is, and tell "
    "nothing; measure more poses"
)
_ROWS = 20  # outliers in the table; all are in result.json
_LISTED = 4  # groups of what moves together


def calibration_tables(result: CalibrationResult) -> list[RenderableType]:
    """Return the tables of a calibration."""
    tables: list[RenderableType] = [result_table(result), legs_table(result)]
    if result.external:
        tables.append(external_table(result))
    if result.observed:
        tables.append(observed_table(result))
    if result.outliers and result.loss != "none":
        tables.append(outliers_table(result))
    return tables


def result_table(result: CalibrationResult) -> Group:
    """Return a table of identified parameters with 95 % intervals and changes."""
    table = plain_table()
    table.add_column("leg")
    table.add_column("parameter", no_wrap=True)
    for name in ("nominal", "identified", "change", "± 95 %"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("unit")
    table.add_column("σ", justify="right", no_wrap=True)
    for leg in result.legs:
        for i, p in enumerate(leg.parameters):
            unit, factor = SHOWN[p.unit]
            change = p.identified - p.nominal
            table.add_row(
                leg.name if i == 0 else "",
                p.name,
                f"{p.nominal:.6f}",
                f"{p.identified:.6f}",
                f"{factor * change:+.4f}",
                f"{factor * (p.high - p.low) / 2:.4f}",
                unit,
                f"{change / p.std:+.1f}" if p.std > 0 else "",
                end_section=i == len(leg.parameters) - 1,
            )
    return titled(
        f"{result.nominal.name} calibrated: {result.method}, {result.residual} residual",
        table,
        "nominal and identified in m, rad and 1; change and its 95 % interval in the unit behind; "
        "σ: how many standard errors the parameter moved",
    )


def legs_table(result: CalibrationResult) -> Group:
    """Return a table of residuals, rank and condition of each leg."""
    table = plain_table()
    table.add_column("leg")
    for name in ("rms before", "rms after", "", "poses", "rank", "condition"):
        table.add_column(name, justify="right" if name else "left")
    for leg in result.legs:
        unit, factor = SHOWN[leg.unit]
        table.add_row(
            leg.name,
            f"{factor * leg.rms_before:.4f}",
            f"{factor * leg.rms_after:.4f}",
            unit,
            str(leg.n_poses),
            f"{leg.rank} of {len(leg.parameters)}",
            f"{leg.condition:.3g}",
        )
    return titled("residuals", table)


def external_table(result: CalibrationResult) -> Group:
    """Return a table of frames and targets."""
    table = plain_table()
    table.add_column("unknown")
    table.add_column("value", justify="right")
    table.add_column("± 95 %", justify="right")
    table.add_column("unit")
    for p in result.external:
        unit, factor = SHOWN[p.unit]
        half = (p.high - p.low) / 2
        plus_minus = f"{factor * half:.4f}" if half == half else ""
        table.add_row(p.name, f"{factor * p.identified:.4f}", plus_minus, unit)
    return titled(
        "outside the mechanism",
        table,
        "frame: the base in the frame of the measurements (rx, ry, rz a rotation vector); others: "
        "what was measured, in the platform's frame",
    )


def observed_table(result: CalibrationResult) -> Group:
    """Return a table of what was measured of the platform, and how it fits."""
    table = plain_table()
    table.add_column("measured")
    for name in ("rows", "rms misfit", "σ"):
        table.add_column(name, justify="right")
    table.add_column("unit")
    for one in result.observed:
        unit, factor = SHOWN[one.unit]
        cells = (str(one.count), f"{factor * one.rms:.4f}", f"{factor * one.sigma:.4f}")
        table.add_row(one.name, *cells, unit)
    return titled("the platform as measured, at the estimated poses", table)


def outliers_table(result: CalibrationResult) -> Group:
    """Return a table of the rows that do not fit."""
    table = plain_table()
    for name in ("data row", "residual [σ]", "weight"):
        table.add_column(name.replace("[", "\\["), justify="right")
    table.add_column("of")
    table.add_column("what")
    every = {leg.name for leg in result.legs}
    for one in result.outliers[:_ROWS]:
        of = "all legs" if set(one.legs) == every else ", ".join(one.legs)
        weight = "rejected" if one.weight == 0.0 else f"{one.weight:.2f}"
        table.add_row(str(one.row + 1), f"{one.sigma:.1f}", weight, of, one.why)
    more = len(result.outliers) - _ROWS
    return titled(
        f"rows that do not fit ({result.loss})",
        table,
        f"and {more} more in result.json" if more > 0 else "",
    )


def calibration_summary(
    data: Measurements, result: CalibrationResult, errors: WorkspaceErrors | None
) -> list[str]:
    """Return what a calibration means, in sentences.

    Args:
        data: What was measured.
        result: The calibration.
        errors: The platform's over the workspace; None if the fit did not converge.
    """
    lines = [result.message, noise_in_words(result)]
    if result.gauge:
        lines.append(
            "fixed by choice, of equal parameters those nearest to nominal: "
            + "; ".join(map(shortened, result.gauge))
        )
    lines += [
        f"tie of {one.name}: {'holds' if one.holds else 'contradicted'} "
        f"(p = {one.p_value:.2g}, {one.restrictions} parameters fewer)"
        for one in result.ties
    ]
    if result.converged:
        lines += weak_in_words(result.weak, result.nominal)
    if errors is not None:
        lines.append(_platform(result, errors))
    lines += trust_in_words(result)
    if result.shift is not None and result.outliers:
        count = len(result.outliers)
        rows = "the row that does" if count == 1 else f"the {count} rows that do"
        lines.append(
            f"with {rows} not fit, parameters would move by up to {result.shift:.1f} standard "
            "errors"
        )
    unused = len(data) - min(leg.n_poses for leg in result.legs)
    if unused and result.poses == "own" and data.sets is not None:
        lines.append(
            f"{unused} of {len(data)} measured poses serve other legs only; --poses all lets every "
            "leg use every pose"
        )
    return lines


def warnings_of(result: CalibrationResult) -> list[str]:
    """Return the warnings; one that several legs share is said once, with their names."""
    legs: dict[str, list[str]] = {}
    for text in result.warnings:
        name, colon, rest = text.partition(": ")
        own = bool(colon) and name in result.nominal.leg_names
        legs.setdefault(rest if own else text, []).extend([name] if own else [])
    return [f"{', '.join(names)}: {text}" if names else text for text, names in legs.items()]


def shortened(words: str) -> str:
    """Return a list of what moves together, cut where it is long: result.json has it whole."""
    head, _, groups = words.rpartition(": ")
    parts = groups.split("; ")
    if len(parts) <= _LISTED + 1:
        return words
    return f"{head}: {'; '.join(parts[:_LISTED])}; and {len(parts) - _LISTED} more (result.json)"


def noise_in_words(result: CalibrationResult) -> str:
    """Return what the noise is, or how the residuals compare with it."""
    turns = "rad" in result.nominal.platform.units
    if result.noise_source in ("estimated", "repeats") and result.noise:
        where = "the residuals" if result.noise_source == "estimated" else "repeated rows"
        text = f"noise estimated from {where}: {1e3 * result.noise.position:.3g} mm in position"
        if turns:
            text += f", {1e3 * result.noise.orientation:.3g} mrad in orientation"
        if result.noise.reading:
            text += f", {1e3 * result.noise.reading:.3g} mm or mrad in readings"
        if result.noise_source == "estimated":
            return text
        more = f"reduced χ² {result.reduced_chi2:.3g}"
        return f"{text}; {more if result.degrees_of_freedom else _NO_FREEDOM}"
    if not result.degrees_of_freedom:
        return _NO_FREEDOM
    return (
        f"reduced χ² {result.reduced_chi2:.3g} on {result.degrees_of_freedom} degrees of "
        "freedom; near 1 the residuals are as large as the noise given makes them"
    )


def _platform(result: CalibrationResult, errors: WorkspaceErrors) -> str:
    """Return by how much the platform was off, and by about how much it should be now."""
    turns, more = "rad" in result.nominal.platform.units, result.excess
    before = size_in_words(*errors.mean_before(), turns)
    text = f"platform, root mean square {errors.where}: "
    if not (result.promises and result.corrects):
        return (
            f"{text}the calibrated model differs from the nominal one by {before}, but no accuracy "
            f"can be promised of it: residuals are {more:.3g} times as large as the noise given "
            f"makes them{'' if result.corrects else ', and hardly fell'}"
        )
    frames = ", but for where the base and platform frames lie" if result.moves_frames else ""
    after = scaled_in_words(errors.mean_after(), more, turns)
    limit = scaled_in_words(errors.limit, more, turns)
    scaled = f", {more:.2g} times as large as the noise given says, as residuals are"
    return (
        f"{text}the nominal model was off by {before}, the calibrated one by about {after}{frames} "
        f"(expected by the parameters' uncertainties{scaled if more > 1.0 else ''}; 95 of 100 such "
        f"calibrations stay below {limit}; ± of single parameters may be larger where they "
        "compensate each other)"
    )


def trust_in_words(result: CalibrationResult) -> list[str]:
    """Return how held-out rows and runs compare."""
    lines, one = [], result.validation
    if one is not None:
        text = (
            f"held-out rows ({one.folds} folds) miss by {one.held_out:.2f} σ, those of the fit by "
            f"{one.fit:.2f}; {one.expected:.2f} are expected held out"
        )
        if one.position is not None:
            text += f". Platform: {1e3 * one.position[1]:.3g} mm held out, "
            text += f"{1e3 * one.position[0]:.3g} in the fit"
        if one.orientation is not None:
            text += f"; {1e3 * one.orientation[1]:.3g} mrad and {1e3 * one.orientation[0]:.3g}"
        lines.append(text + " (measuring noise included)")
    if result.runs is not None:
        lines.append(
            f"{len(result.runs.runs)} runs: parameters spread {result.runs.ratio:.2f} times as "
            f"much as their standard errors say (p = {result.runs.p_value:.2g})"
        )
    return lines


def scaled_in_words(sizes: tuple[float, float], by: float, turns: bool) -> str:
    """Return errors of the platform, [m] and [rad], times a factor."""
    return size_in_words(by * sizes[0], by * sizes[1], turns)


def size_in_words(position: float, orientation: float, turns: bool) -> str:
    """Return an error of the platform in mm and, if it turns, mrad."""
    return f"{1e3 * position:.3g} mm" + (f" and {1e3 * orientation:.3g} mrad" if turns else "")
