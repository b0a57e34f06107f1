"""All tables of the output, in displayed units."""

import numpy as np

from pincal.calibration.result import CalibrationResult
from pincal.calibration.result_parts import IdentifiedParameter, ResidualGroup
from pincal.calibration.terms.choice import Explanation
from pincal.calibration.terms.screen import Candidate
from pincal.calibration.validation import MISSES
from pincal.design.forecast import Forecast
from pincal.design.select import Selection
from pincal.estimation.observability.identifiable import NEGLIGIBLE
from pincal.model import ORIGIN, Mechanism
from pincal.model.checks import counted, listed
from pincal.show import misses
from pincal.show.misses import WorkspaceErrors
from pincal.symmetry.detect import SymmetryGroup
from pincal.words.numbers import SMALL, STORED, VALUES, chance, number, shown_in, uncertainty
from pincal.words.table import Cell, Table, Value, quantity
from pincal.words.wording import NAMED, named
from pincal.workspace.region import Workspace

# Mechanisms and their symmetry


def nominal_table(mechanism: Mechanism) -> Table:
    """Return a mechanism's parameters, one column per leg; one row per leg if legs are more."""
    names = dict.fromkeys(name for leg in mechanism.legs for name in leg.parameter_names)
    grid: list[list[Value]] = [["parameter", *mechanism.leg_names, "unit"]]
    for name in names:
        unit = next(leg.units[name] for leg in mechanism.legs if name in leg.units)
        nominal = (leg.nominal_by_name.get(name) for leg in mechanism.legs)
        values = (None if v is None else quantity(v, unit, units=STORED) for v in nominal)
        grid.append([name, *values, STORED[unit]])
    if len(mechanism.legs) > len(names):
        grid = [list(row) for row in zip(*grid, strict=True)]
    heads, *rows = grid
    title = f"{mechanism.name}: parameters"
    return Table(title, [*map(str, heads)], rows, mechanism.labelled)


def symmetry_table(group: SymmetryGroup) -> Table:
    """Return a group's elements with their permutation of legs, and why others are none."""
    names = group.mechanism.leg_names
    size = f"{group.name}, {counted(len(group.elements), 'element')}"
    return Table(
        f"{group.mechanism.name}: {size}, nominal geometry and modes",
        ["element", *(f"{name} to" for name in names)],
        [
            (str(element), *(names[i] for i in permutation))
            for element, permutation in zip(group.elements, group.permutations, strict=True)
        ],
        "\n".join(f"no symmetry: {sentence}" for sentence in group.reasons),
    )


# Plans and forecasts


_GOALS = {
    "parameters": "all parameters together",
    "platform": "the platform's accuracy over the candidates",
}


def selection_table(selection: Selection, name: str = "") -> Table:
    """Return the quality of a selection: by leg, or of whole configurations of a machine."""
    if (rank := selection.rank) is None:
        return Table(
            f"{selection.count} poses, {selection.protocol} selection from "
            f"{selection.candidates} candidates",
            ["leg", "poses", "efficiency:.4f", "O1:.4f", "condition:.3g"],
            [
                (leg.leg, leg.poses, leg.efficiency, leg.indices.O1_per_parameter, leg.condition)
                for leg in selection.legs
            ],
            "efficiency: (det / det of the continuous D-optimal bound)^(1/n), at most 1; "
            "O1: of the unweighted Jacobian, over the number of parameters",
        )
    lost = rank.n_params - rank.rank
    words = f"; {lost} directions are not observable at any candidate" if lost else ""
    row = (
        selection.count,
        Cell(selection.candidates, f"{selection.candidates:,}"),
        selection.efficiency,
        Cell(rank.rank, f"{rank.rank} of {rank.n_params}"),
        listed(selection.measured),
    )
    return Table(
        f"{name}: configurations for {_GOALS[selection.protocol]}{words}",
        ["poses", "of", "efficiency:.3f", "rank", "measured"],
        [row],
    )


def selection_text(selection: Selection) -> str:
    """Return a selection as text: the table, or a line, what was measured, and the rank."""
    if selection.rank is None:
        return str(selection_table(selection))
    return f"{selection!r}\nmeasured: {listed(selection.measured)}; {selection.rank}"


def standard_errors(forecast: Forecast) -> Table:
    """Return the standard errors of a forecast by parameter and leg."""
    mechanism = forecast.mechanism
    units = {p.name: p.unit for p in mechanism.parameters}
    sizes, cells = forecast.std.tolist(), dict[str, Cell]()
    least = _HELD * max((std for std in sizes if std < np.inf), default=0.0)
    for p, std in zip(mechanism.parameters, sizes, strict=True):
        known = uncertainty(std, p.unit, SMALL) if std < np.inf else "—"
        cells[p.id] = Cell(std, "held" if std < least else known)
    return Table(
        f"{mechanism.name}: standard errors (1 σ) from {forecast.poses} poses, measured: "
        f"{listed(forecast.measured) if forecast.measured else 'nothing'}",
        ["parameter", "unit", *mechanism.leg_names],
        [
            (name, SMALL[unit], *(cells.get(f"{leg}.{name}") for leg in mechanism.leg_names))
            for name, unit in units.items()
        ],
    )


def forecast_text(forecast: Forecast) -> str:
    """Return the standard errors of a forecast as text, and the undetermined parameters."""
    lost = "" if forecast.rank.complete else f"not determined apart: {forecast.rank.describe()}"
    return f"{standard_errors(forecast)}\n{lost}"


# Workspaces


def workspace_table(workspace: Workspace) -> Table:
    """Return the facts of a workspace: size, positions, orientations, margins, symmetry."""
    positions, test = workspace.asked, workspace.test
    name = {1: "length", 2: "area", 3: "volume"}[positions.dimension or 1]
    type2 = test.least.least_type2(test.mechanism)
    sides = "both sides of type 2" if type2 == -np.inf else f"type 2 ≥ {type2:.3g}"
    every = "in every one of" if test.every else "in any of"
    symmetry = f"{workspace.computed:,} positions computed"
    if len(workspace.elements) > 1:
        elements = ", ".join(map(str, workspace.elements))
        symmetry += f", the others by {len(workspace.elements)} elements: {elements}"
    if workspace.unused:
        unused = ", ".join(map(str, workspace.unused))
        symmetry += f"; not used, or not a symmetry of these positions and orientations: {unused}"
    facts = [
        (name, f"{workspace.size} (at most: half a cell along the edge)"),
        ("positions", f"{workspace.count:,} of {positions.size:,} count"),
        ("orientations", f"{every} {len(test.orientations):,}"),
        ("margins", f"type 1 ≥ {test.least.least_type1(test.mechanism):.3g}, {sides}"),
        ("symmetry", symmetry),
    ]
    if workspace.cut:
        facts.append(("", "cut off by the edge of the grid: widen the axes to see the whole"))
    title = f"{test.mechanism.name}: {workspace.kind} workspace"
    return Table(title, ["what", "is"], facts, heads=False)


# Calibrations

_MOST_OUTLIERS = 50  # outliers that are listed
_HELD = 1e-8  # largest standard error, over the largest known one, of what stays at nominal
_SEEN = 1e-6  # share of the largest effect, below which a parameter counts as without effect
ERRORS = {"m": "position", "rad": "orientation", "px": "image"}
_CHOSEN = ". Values and ± depend on what was fixed by choice; errors of the platform do not"
_HEADS = ("nominal", "identified", "± 95 %", "unit")


def calibration_tables(result: CalibrationResult) -> list[Table]:
    """Return all tables of a calibration for the terminal."""
    outside = [outside_table(result)] if result.external else []
    outliers = [outliers_table(result)] if result.outliers and result.loss != "none" else []
    cameras = [table] if (table := cameras_table(result)) else []
    return [parameters_table(result), *outside, residuals_table(result), *cameras, *outliers]


def accuracy_table(result: CalibrationResult, errors: WorkspaceErrors) -> list[Table]:
    """Return a table of the platform's errors: nominal, calibrated, at held-out poses; [] if none.

    Errors at held-out poses, and their limit, contain the noise of measurements; they replace the
    calibrated errors where no limit is stated.
    """
    missed, region, rows = held_out_errors(result), "", dict[str, dict[str, str]]()
    if result.explained and errors.determined and errors.moved:
        grown = 0.0 if result.frames_moved is None else np.abs(result.frames_moved[-1])
        scale = " and scale" * bool(np.max(grown, initial=0.0) > NEGLIGIBLE)
        region = f" {errors.where}" + f", best-fit frames{scale}" * result.moves_frames
        sizes = zip(errors.mean_before(), errors.mean_after(), errors.inside.limit, strict=True)
        for unit, (before, after, limit) in zip(("m", "rad"), sizes, strict=True):
            below = f"{number(after, unit)} (≤ {number(limit, unit)})"
            shown = below if result.promises else f"≥ {number(after, unit)}" * (not missed)
            rows.setdefault("nominal", {})[unit] = number(before, unit)
            rows.setdefault("calibrated", {})[unit] = shown
    if missed:
        rows |= [_held_out_row(result)]
        by_hand_eye = misses.hand_eye_misses(result).items()
        rows["held-out photos by hand–eye"] = {u: number(size, u) for u, size in by_hand_eye}
    units = dict.fromkeys([*errors.expected.units, *missed])
    heads = ["", *(f"{ERRORS[unit]} [{SMALL[unit]}]" for unit in units)]
    cells = [[h, *map(row.get, units)] for h, row in rows.items() if any(row.values())]
    return [Table(f"RMS error{region}", heads, cells)] if cells else []


def _held_out_row(result: CalibrationResult) -> tuple[str, dict[str, str]]:
    """Return the head of the row of held-out poses, and their errors by unit."""
    assert result.validation is not None
    targets = result.validation.targets
    measured, every = _measured_parts(result)
    along = f"{named(measured)} alone, " if measured and not every else ""
    if not measured and "px" in result.validation.missed:
        along = "across lines of sight, "
    count = max(target.poses for target in targets)
    cells = {}
    for unit, size in held_out_errors(result).items():
        limit = np.sqrt(np.mean([target.limit**2 for target in targets if target.unit == unit]))
        sign = "≤" if size <= limit else ">"  # one sound set in twenty is above
        cells[unit] = f"{number(size, unit)} ({sign} {number(float(limit), unit)})"
    return f"{along}{counted(count, f'{result.validation.kind} pose')}, with noise", cells


def _measured_parts(result: CalibrationResult) -> tuple[list[str], bool]:
    """Return the names of the measured points, or axes of points, and whether all were measured."""
    positions = result.options.setup.positions(result.nominal.platform)
    observed = {group.name for group in result.observed}
    seen = {target: [n for n in names if n in observed] for target, names in positions.items()}
    parts = list[str]()
    for target, names in seen.items():
        parts += [target] if target != ORIGIN and names == positions[target] else names
    return parts, seen == positions


def held_out_errors(result: CalibrationResult) -> dict[str, float]:
    """Return errors of held-out targets by unit; empty if the fit misses even its own rows."""
    if result.validation is None or result.validation.fit > MISSES:
        return {}
    return {unit: held_out for unit, (_, held_out) in result.validation.missed.items()}


def parameters_table(result: CalibrationResult) -> Table:
    """Return identified parameters with 95 % intervals, by effect on the platform."""
    moved, unit = misses.effects(result)
    least = _SEEN * max(moved.values(), default=0.0)
    ids = sorted((id_ for id_ in moved if moved[id_] > least), key=lambda id_: -moved[id_])
    rows = [
        (p.id, *_values(p), quantity(p.change, p.unit, p.half, VALUES, "+"), moved[p.id])
        for p in map(result.parameters.__getitem__, ids)
    ]
    heads = ["parameter", *_HEADS, "change", f"moves [{unit}]:.3g"]
    lines = [f"moves: by how much the change moves the platform{_CHOSEN * bool(result.gauge)}"]
    causes = {
        p.id: p.given or ("no effect" if np.isfinite(p.std) else "not determined (± ∞)")
        for leg in result.legs
        for p in leg.parameters
        if p.given or p.id not in ids
    }
    for cause in dict.fromkeys(causes.values()):
        lines += [f"{cause}: {named([id_ for id_ in causes if causes[id_] == cause])}"]
    title = f"{result.nominal.name}: parameters, nominal and identified"
    return Table(title, heads, rows, "; ".join(filter(None, (*lines, result.nominal.labelled))))


def _values(p: IdentifiedParameter) -> tuple[Value, ...]:
    interval = Cell(None, "∞" if p.half else p.given or "held")
    if p.half > 0.0 and np.isfinite(p.std):
        interval = Cell(p.half, uncertainty(p.half, p.unit))
    values = (quantity(value, p.unit, p.half, VALUES) for value in (p.nominal, p.identified))
    return (*values, interval, VALUES[p.unit])


def outside_table(result: CalibrationResult) -> Table:
    """Return the unknowns outside the mechanism: frames and targets."""
    return Table(
        "Outside the mechanism",
        ["unknown", "start", *_HEADS[1:]],
        [(p.id, *_values(p)) for p in result.external],
        "tracker: pose of the base in the frame of the measurements (rx, ry, rz: rotation vector); "
        "others: points on the platform, or touched; start: initial values, from an alignment with "
        f"the nominal machine{_CHOSEN * bool(result.gauge)}",
    )


def residuals_table(result: CalibrationResult) -> Table:
    """Return RMS residuals of legs, unless readings are exact, and of the measured platform."""
    exact = misses.readings_exact(result)
    legs, ranks = ([], []) if exact else (result.legs, ["rank", "condition:.3g"])
    rows = [
        (*_sizes(leg), Cell(leg.rank, f"{leg.rank} of {len(leg.parameters)}"), leg.condition)
        for leg in legs
    ]
    rows += [(*_sizes(group), *(None for _ in ranks)) for group in misses.observed_groups(result)]
    caption = "σ: noise alone; condition: of the whitened and scaled identification Jacobian"
    if exact:
        caption = "Readings are exact: legs close by construction, and residuals are the platform's"
    heads = ["of", "rows", "rms before", "rms after", "σ", "unit", *ranks]
    return Table("Residuals, of the platform at the estimated poses", heads, rows, caption)


def _sizes(group: ResidualGroup) -> tuple[Value, ...]:
    unit, sizes = group.unit, (group.rms_before, group.rms_after, group.rms_noise)
    shown = (Cell(size, f"{shown_in(size, unit):.4f}") for size in sizes)
    rows = len(np.unique(group.rows))
    return group.name, rows, *(shown if rows else (None, None, None)), SMALL[unit]


def cameras_table(result: CalibrationResult) -> Table | None:
    """Return residuals of camera points, the largest first; None if no camera measured."""
    rows = list[list[Value]]()
    for camera, points, _, missed, _, metres in misses.camera_misses(result):
        sizes = np.linalg.norm(missed, axis=1)
        each = {name: np.flatnonzero(points == name) for name in dict.fromkeys(points.tolist())}
        worst = sorted(each.items(), key=lambda of_point: -np.square(sizes[of_point[1]]).mean())
        for name, places in [("all", np.arange(len(points))), *worst[:NAMED]]:
            cells = [
                Cell(size, number(size, unit))
                for part, unit in ((sizes[places], "px"), ((sizes * metres)[places], "m"))
                for size in (float(np.sqrt((part**2).mean())), float(np.median(part)))
            ]
            rows.append([camera.name, name, len(places), *cells])
    heads = [f"{kind} [{SMALL[unit]}]" for unit in ("px", "m") for kind in ("RMS", "median")]
    if not rows:
        return None
    return Table(
        "Residuals of points seen by cameras",
        ["camera", "point", "seen", *heads],
        rows,
        f"lengths: across the line of sight, at the point's distance; for each camera the {NAMED} "
        "points with the largest residuals",
    )


def outliers_table(result: CalibrationResult) -> Table:
    """Return the rows that do not fit, the worst first."""
    omitted = len(result.outliers) - _MOST_OUTLIERS
    return Table(
        "Rows that do not fit, the worst first",
        ["data row", "residual [σ]:.1f", "weight:.2f", "what"],
        [
            (
                outlier.row + 1,
                outlier.sigma,
                Cell(0.0, "rejected") if outlier.weight == 0.0 else outlier.weight,
                f"{outlier.quantity} off by {outlier.off:.1f} σ",
            )
            for outlier in result.outliers[:_MOST_OUTLIERS]
        ],
        f"and {omitted} more in result.json" * (omitted > 0),
    )


# Explanations of calibrations that do not fit


def screen_table(explanation: Explanation) -> Table:
    """Return the terms tried, the most significant first."""
    candidates, omitted = explanation.candidates, len(explanation.candidates) - NAMED
    caption = "amplitude: estimated by one step of the fit, in the scale of the term"
    caption += f"; {omitted} more are less clear" * (omitted > 0)
    return Table(
        f"{explanation.result.nominal.name}: what geometry does not explain",
        ["reading", "term", "amplitudes", "off χ² [%]:.1f", "F:.3g", "chance"],
        [
            (candidate.reading, str(candidate.kind), *_amplitudes(candidate))
            for candidate in candidates[:NAMED]
        ],
        caption,
    )


def _amplitudes(candidate: Candidate) -> tuple[Value, ...]:
    """Return a candidate's significant amplitudes, its share of χ², F, and its p-value."""
    if not candidate.rank:
        return Cell(None, "absorbed by geometry"), None, None, None
    single_leg = len({id_.partition(".")[0] for id_ in candidate.names}) == 1
    unit, parts = candidate.unit, []
    for id_, size, std in zip(candidate.names, candidate.values, candidate.std, strict=True):
        if abs(size) > 2.0 * std:
            name = id_.partition(".")[2] if single_leg else id_
            parts.append(f"{name} {quantity(size, unit, std).text} {SMALL[unit]}")
    shown = chance(candidate.corrected)
    return ", ".join(parts) or "unclear", 100.0 * candidate.share, candidate.F, shown


def models_table(explanation: Explanation) -> Table:
    """Return the models compared on held-out rows, with a mark at the chosen one."""
    sizes = {
        name: unit
        for name, unit in (("position", "m"), ("orientation", "rad"))
        if all(np.isfinite(getattr(model, name)) for model in explanation.models)
    }
    heads = ["", "model", "chance", "free", "held out [σ]:.3f", "±:.3f"]
    misses = [f"{name} [{unit}]:.3g" for name, unit in sizes.items()]
    rows = [
        (
            "→" if index == explanation.chosen else "",
            model.name if index < 2 else f"+ {model.name}",
            chance(model.chance) if index > 1 else "",
            model.parameters,
            model.held_out,
            model.spread or None,
            *(getattr(model, name) for name in sizes),
        )
        for index, model in enumerate(explanation.models)
    ]
    return Table(
        "Models on held-out rows",
        (*heads, *misses),
        rows,
        "chance: when the term was added; free: number of parameters; ±: against the best",
    )
