"""Tables of mechanisms, plans, forecasts, groups and workspaces."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from pincal.design.forecast import Drift, Forecast, ScaleEffect
from pincal.design.platform_error import PlatformError
from pincal.design.select import Selection
from pincal.design.select_configurations import ConfigurationChoice
from pincal.design.simulate import Accuracy
from pincal.model.mechanism import Mechanism
from pincal.show.summary import drift_lines, forecast_lines, scale_line
from pincal.symmetry.breaks import no_symmetries
from pincal.symmetry.detect import SymmetryGroup
from pincal.types import Array
from pincal.words.numbers import STORED, counted
from pincal.words.table import Cell, Column, Quantity, Table, Uncertainty, UnitOf, Value, columns
from pincal.words.wording import mapped_diagonals
from pincal.workspace.criteria import ArticularSymmetry
from pincal.workspace.inscribed import Inscribed
from pincal.workspace.region import Workspace


def nominal_table(mechanism: Mechanism) -> Table:
    """Return the nominal parameters, one column a leg, or one row where legs are more."""
    names = dict.fromkeys(name for leg in mechanism.legs for name in leg.parameter_names)
    grid: list[list[Value]] = [["parameter", *mechanism.leg_names, "unit"]]
    for name in names:
        unit = next(leg.units[name] for leg in mechanism.legs if name in leg.units)
        nominal = (leg.nominal_by_name.get(name) for leg in mechanism.legs)
        values = (None if value is None else Quantity(value, unit) for value in nominal)
        grid.append([name, *values, UnitOf(unit)])
    if len(mechanism.legs) > len(names):
        grid = [list(row) for row in zip(*grid, strict=True)]
    heads, *rows = grid
    title, labels = f"{mechanism.name}: nominal parameters", mechanism.labelled
    return Table(title, columns(*map(str, heads), units=STORED), rows, labels)


def selection_table(selection: Selection) -> Table:
    """Return what a selection gives each leg."""
    return Table(
        f"{len(selection.plan.poses)} poses, {selection.protocol} selection from "
        f"{selection.candidates} candidates",
        columns("leg", "poses", "efficiency:.4f", "O1:.4f", "condition:.3g"),
        [
            (leg.leg, leg.poses, leg.efficiency, leg.indices.O1_per_parameter, leg.condition)
            for leg in selection.legs
        ],
        "\n".join(
            (
                "efficiency: (det / det of the continuous D-optimal bound)^(1/n), at most 1; "
                "O1: of the unweighted Jacobian, over the number of parameters",
                *([mapped_diagonals(selection.diagonals_differ)] if selection.mapped else []),
            )
        ),
    )


GOALS = {
    "parameters": "all parameters together",
    "platform": "the platform's accuracy over the candidates",
}
"""What configurations are chosen for."""


def choice_table(mechanism: Mechanism, chosen: ConfigurationChoice) -> Table:
    """Return how good chosen configurations are, and what they determine."""
    rank = chosen.rank
    lost = rank.n_params - rank.rank
    words = f"; {lost} directions are not observable at any candidate" if lost else ""
    candidates = Cell(chosen.candidates, f"{chosen.candidates:,}")
    determined = Cell(rank.rank, f"{rank.rank} of {rank.n_params}")
    row = (
        len(chosen.plan.poses),
        candidates,
        chosen.efficiency,
        determined,
        ", ".join(chosen.measured),
    )
    return Table(
        f"{mechanism.name}: configurations for {GOALS[chosen.goal]}{words}",
        columns("poses", "of", "efficiency:.3f", "rank", "measured"),
        [row],
    )


def accuracy_table(errors: Mapping[str, Accuracy], turns: bool) -> Table:
    """Return platform errors by model, the nominal one first, and by what the others are better."""
    keep = slice(None, None if turns else 2)
    rows: list[list[Value]] = []
    better: list[list[Value]] = []
    before: list[float] = []
    for name, accuracy in errors.items():
        sizes = [accuracy.position, accuracy.worst_position, accuracy.orientation][keep]
        rows.append([name, *sizes, accuracy.unreachable])
        ratios = [old / new for old, new in zip(before, sizes, strict=False)]
        times: list[Value] = [Cell(ratio, f"{ratio:.1f} times") for ratio in ratios]
        better += [[f"{name}: better by", *times, None]] if before else []
        before = before or sizes
    names = {"position rms": "m", "worst": "m", "orientation rms": "rad"}
    shown = [Column(name, unit, ".4f") for name, unit in names.items()]
    return Table(
        f"platform error over the workspace, {next(iter(errors.values())).poses} poses",
        (Column("model"), *shown[keep], Column("not reached")),
        [*rows, *better],
    )


def forecast_table(
    forecast: Forecast,
    error: PlatformError,
    planned: int,
    alone: PlatformError | None = None,
    drifts: Sequence[Drift] = (),
    scale: ScaleEffect | None = None,
) -> Table:
    """Return what a plan will give: standard errors by parameter and leg, and what they mean.

    Args:
        forecast: The forecast.
        error: Of the platform over the workspace.
        planned: Number of poses in the plan.
        alone: The same error with each leg calibrated alone, if that can be.
        drifts: What a drift over the run would do; then the same of each leg alone.
        scale: What a wrong scale of the instrument would do.
    """
    lines = (
        *forecast_lines(forecast, error, planned, alone),
        *drift_lines(drifts),
        *scale_line(scale),
    )
    return standard_errors(forecast, "\n".join(lines))


def standard_errors(forecast: Forecast, caption: str = "") -> Table:
    """Return the standard errors of a forecast by parameter and leg, with what is said beneath."""
    mechanism = forecast.mechanism
    names = [(leg.name, name) for leg in mechanism.legs for name in leg.parameter_names]
    errors = dict(zip(names, forecast.std.tolist(), strict=True))
    units = {name: leg.units[name] for leg in mechanism.legs for name in leg.parameter_names}

    def cell(leg: str, name: str, unit: str) -> Value:
        if (std := errors.get((leg, name))) is None:
            return None
        return Uncertainty(std, unit) if std < np.inf else Cell(std, "—")

    return Table(
        f"{mechanism.name}: standard errors (1 σ) from {forecast.poses} poses, measured: "
        f"{', '.join(forecast.measured) or 'nothing'}",
        (Column("parameter"), Column("unit"), *(Column(leg) for leg in mechanism.leg_names)),
        [
            (name, UnitOf(unit), *(cell(leg, name, unit) for leg in mechanism.leg_names))
            for name, unit in units.items()
        ],
        caption,
    )


def workspace_table(
    workspace: Workspace, inscribed: Inscribed | None = None, *, wanted: bool = False
) -> Table:
    """Return what a workspace is: how large, in how many orientations, by which symmetry.

    Args:
        workspace: The workspace.
        inscribed: Its largest circle or ball.
        wanted: Whether one was looked for.
    """
    positions, test = workspace.asked, workspace.test
    name = {1: "length", 2: "area", 3: "volume"}[positions.dimension or 1]
    separate = f"; {workspace.apart:,} of them apart from home's" if workspace.apart else ""
    least, type2 = test.least, test.least.least_type2(test.mechanism)
    sides = "both sides of type 2" if type2 == -np.inf else f"type 2 ≥ {type2:.3g}"
    every = "in every one of" if test.every else "in any of"
    facts = [
        (name, f"{workspace.size} (at most: half a cell along the edge)"),
        ("positions", f"{workspace.count:,} of {positions.size:,} count{separate}"),
        ("orientations", f"{every} {len(test.orientations):,}"),
        ("margins", f"type 1 ≥ {least.type1:.3g}, {sides}"),
        ("symmetry", _by_symmetry(workspace)),
    ]
    if workspace.cut:
        facts.append(("", "cut off by the edge of the grid: widen the axes to see the whole"))
    if inscribed is None and wanted:
        facts.append(("largest inscribed", "none: no position counts"))
    if inscribed:
        centre = ", ".join(
            f"{v + 0.0:.4f}" for v in inscribed.centre[: len(positions.axes)].round(6)
        )
        body = "ball" if positions.dimension == 3 else "circle"
        loose = inscribed.bound > 1.001 * inscribed.radius
        touches = f"; none is larger than {inscribed.bound:.4f} m" if loose else ""
        touches += "; it touches the edge of the grid" if inscribed.at_edge else ""
        radius = f"radius {inscribed.radius:.4f} m around ({centre}) m{touches}"
        facts.append((f"largest {body}", radius))
    title = f"{test.mechanism.name}: {workspace.kind} workspace"
    return Table(title, columns("what", "is"), facts, heads=False)


def _by_symmetry(workspace: Workspace) -> str:
    """Return which elements were used, and which were not."""
    used = ", ".join(str(e) for e in workspace.elements)
    text = f"{workspace.computed:,} positions computed"
    if len(workspace.elements) > 1:
        text += f", the others by {len(workspace.elements)} elements: {used}"
    if workspace.unused:
        unused = ", ".join(str(e) for e in workspace.unused)
        text += f"; not used, or not a symmetry of these positions and orientations: {unused}"
    return text


def articular_table(
    mechanism: Mechanism,
    spaces: Mapping[str, Array],
    checks: Sequence[ArticularSymmetry],
) -> Table:
    """Return the extent of spaces of readings, and whether permuted readings are reached."""
    rows: list[tuple[Value, ...]] = []
    for name, readings in spaces.items():
        heads: tuple[Value, Value] = (name, Cell(len(readings), f"{len(readings):,}"))
        read = zip(mechanism.reading_names, mechanism.reading_units, readings.T, strict=True)
        for reading, unit, column in read:
            low, high = (column.min(), column.max()) if len(column) else (np.nan, np.nan)
            ends = (Cell(float(low), f"{low:.3f}"), Cell(float(high), f"{high:.3f} [{unit}]"))
            rows.append((*heads, reading, *ends))
            heads = ("", None)
    sampled = f"{len(spaces['all']):,} random poses" if "all" in spaces else ""
    lines = [f"all: {sampled}, so the space reaches a little farther"] * bool(sampled)
    lines += [
        f"{check.element}: {check.solved} of {check.asked} permuted readings solved, "
        f"{check.inside} in the workspace, at most {check.off:.2g} from the carried pose"
        for check in checks
    ]
    return Table(
        f"{mechanism.name}: articular-variables space",
        columns("space", "poses", "leg", "from", "to"),
        rows,
        "\n".join(lines if checks else [*lines, "no symmetry but the identity"]),
        wrap=False,
    )


def symmetry_table(group: SymmetryGroup, equivariance: float) -> Table:
    """Return a group's elements, where they carry the legs, and what breaks others."""
    names = group.mechanism.leg_names
    lines = [f"readings follow within {equivariance:.2g} (Eq. 5: F(λ q) = λ F(q))"]
    lines += [f"no symmetry: {text}" for text in no_symmetries(group.breaks)]
    size = f"{group.name}, {counted(len(group.elements), 'element')}"
    return Table(
        f"{group.mechanism.name}: {size}, nominal geometry and modes",
        (Column("element"), *(Column(f"{name} to") for name in names)),
        [
            (str(element), *(names[i] for i in permutation))
            for element, permutation in zip(group.elements, group.permutations, strict=True)
        ],
        "\n".join(lines),
        wrap=False,
    )
