"""What a calibration found, for people: tables, and sentences on whether to trust it."""

from __future__ import annotations

from rich.console import Group, RenderableType
from rich.markup import escape

from pincal.calibration.result import CalibrationResult
from pincal.calibration.validation import Validation
from pincal.model.measurements import Measurements
from pincal.show.parameters import HEADS, given_cells, parameter_cells
from pincal.show.series import observed_cells, observed_heads, readings_exact
from pincal.show.tables import SHOWN, plain_table, titled, weak_in_words
from pincal.show.workspace_errors import WorkspaceErrors
from pincal.words.sentences import sentence as said

_NO_FREEDOM = (
    "as many unknowns as measured values: residuals vanish whatever the machine is, and tell "
    "nothing; measure more poses"
)
_ROWS = 20  # outliers in the table; all are in result.json
_MISSES = 10.0  # by how many σ a fit misses its own rows that is none
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
    given = given_cells(result)
    for name in ("leg", *HEADS, *([] if given is None else ["given"])):
        words = name in ("leg", "parameter", "unit", "given")
        table.add_column(escape(name), justify="left" if words else "right", no_wrap=name != "leg")
    of_row = iter(given or ())
    for leg in result.legs:
        for i, p in enumerate(leg.parameters):
            table.add_row(
                leg.name if i == 0 else "",
                *parameter_cells(p),
                *([] if given is None else [next(of_row)]),
                end_section=i == len(leg.parameters) - 1,
            )
    return titled(
        f"{result.nominal.name} calibrated: {result.method}, {result.options.residual} residual",
        table,
        "change [σ]: by how many standard errors the parameter moved",
    )


def legs_table(result: CalibrationResult) -> Group:
    """Return a table of residuals, rank and condition of each leg."""
    table = plain_table()
    exact = readings_exact(result)
    sizes = () if exact else ("rms before", "rms after", "unit")
    for name in ("leg", *sizes, "poses", "rank", "condition"):
        table.add_column(name, justify="left" if name in ("leg", "unit") else "right")
    for leg in result.legs:
        unit, factor = SHOWN[leg.unit]
        rms = (f"{factor * leg.rms_before:.4f}", f"{factor * leg.rms_after:.4f}", unit)
        rank = f"{leg.rank} of {len(leg.parameters)}"
        table.add_row(
            leg.name, *(() if exact else rms), str(leg.n_poses), rank, f"{leg.condition:.3g}"
        )
    return titled("legs; readings were taken as exact" if exact else "residuals", table)


def external_table(result: CalibrationResult) -> Group:
    """Return a table of frames and targets."""
    table = plain_table()
    table.add_column("unknown")
    table.add_column("value", justify="right")
    table.add_column("± 95 %", justify="right")
    table.add_column("unit")
    for p in result.external:
        table.add_row(*(cell for place, cell in enumerate(parameter_cells(p)[:5]) if place != 1))
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
    for name in ("rows", *observed_heads(result)):
        table.add_column(name, justify="right")
    table.add_column("unit")
    for one in result.observed:
        sizes, unit = observed_cells(result, one)
        table.add_row(one.name, str(one.count), *sizes, unit)
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
        table.add_row(
            str(one.row + 1),
            f"{one.sigma:.1f}",
            weight,
            of,
            f"{one.quantity} off by {one.off:.1f} σ",
        )
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
            + "; ".join(map(shortened, map(said, result.gauge)))
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
    if unused and not result.options.every_pose and data.sets is not None:
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


def sentence(words: str) -> str:
    """Return words of ours with a capital; never those that begin with a name, such as ``l``."""
    return f"{words[0].upper()}{words[1:]}"


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
        text = held_out_in_words(one)
        if one.position is not None and one.fit <= _MISSES:
            text += f". Platform: {1e3 * one.position[1]:.3g} mm held out, "
            text += f"{1e3 * one.position[0]:.3g} in the fit"
            if one.orientation is not None:
                text += f"; {1e3 * one.orientation[1]:.3g} mrad and {1e3 * one.orientation[0]:.3g}"
            text += " (measuring noise included)"
        lines.append(f"{text} ({one.folds} folds)")
    if result.runs is not None:
        lines.append(
            f"{len(result.runs.runs)} runs: parameters spread {result.runs.ratio:.2f} times as "
            f"much as their standard errors say (p = {result.runs.p_value:.2g})"
        )
    return lines


def held_out_in_words(one: Validation) -> str:
    """Return how rows that a fit has not seen compare with its own, where these fit at all."""
    if one.fit > _MISSES:
        return (
            f"held-out rows prove nothing: the fit misses even its own rows by {one.fit:.3g} σ. "
            "Look at the warnings first"
        )
    return (
        f"held-out rows miss by {one.held_out:.2f} σ, those of the fit by {one.fit:.2f} σ; "
        f"{one.expected:.2f} σ are expected held out"
    )


def scaled_in_words(sizes: tuple[float, float], by: float, turns: bool) -> str:
    """Return errors of the platform, [m] and [rad], times a factor."""
    return size_in_words(by * sizes[0], by * sizes[1], turns)


def size_in_words(position: float, orientation: float, turns: bool) -> str:
    """Return an error of the platform in mm and, if it turns, mrad."""
    return f"{1e3 * position:.3g} mm" + (f" and {1e3 * orientation:.3g} mrad" if turns else "")
