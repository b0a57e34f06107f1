"""Charts of a calibration: what a metrologist asks, each question drawn into axes once.

``Plots`` is the registry, and ``result.plot``: the command ``pincal plot`` draws these by name, the
report takes some of them. Charts of residuals are drawn in ``residual_charts``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter

from pincal.calibration.leg_result import IdentifiedParameter
from pincal.calibration.result import CalibrationResult
from pincal.design.certificate import continuous_design
from pincal.design.criteria import MeanVariance
from pincal.design.information import information_rows
from pincal.design.platform_error import without_frames
from pincal.errors import MeasurementError, WorkspaceError
from pincal.estimation.observability.indices import RANK_TOLERANCE
from pincal.kinematics.configurations import home_of, legs_at
from pincal.model.measurements import Noise, Plan
from pincal.show import residual_charts
from pincal.show.pictures.figure import draw_scene
from pincal.show.pictures.parts import (
    NORMAL,
    axis_name,
    draw_bars,
    draw_map,
    height_name,
    label,
    legend_beside,
    levels,
    marks,
    name_places,
    room,
    wrapped,
)
from pincal.show.result_tables import directions, parameters
from pincal.show.style import EVERY, IDENTIFIED, INK, MARKERS, NOMINAL, PAGE
from pincal.show.view.scene import scene
from pincal.show.workspace_answers import error_maps, moved_apart
from pincal.types import Array
from pincal.words.numbers import SMALL, minus, per_si
from pincal.workspace.criteria import in_workspace
from pincal.workspace.sampling import sample_configurations

_SAMPLES = 300  # of the workspace
_STEPS = 12  # numbers of poses
_NAMED = 3  # parameters of a direction
_CELLS = 31  # of a bed, along each side
_AGREEMENT = 0.02  # by which the error of all rows may differ from the result's own
_BAR = 0.125  # height of a bar with its name, [inch]
_LEGEND = 0.35  # height of a legend of two lines, [inch]
_EXPECTED = f"expected error of position [{SMALL['m']}]"


def changes(axes: Axes, result: CalibrationResult) -> Axes:
    """Draw the change of each parameter from nominal over its 95 % half width.

    Bars longer than 1 are changes that the measurements show; fixed ones have none.
    """
    values: dict[str, dict[str, float]] = {leg.name: {} for leg in result.legs}
    for leg, p in parameters(result):
        if 0.0 < p.std < np.inf:
            values[leg.name][p.name] = p.change / p.half
    draw_bars(axes, values)
    levels(axes, 1.0, "±")
    axes.set_ylabel(wrapped("change / half width of its 95 % interval", room(axes)[1]))
    return axes


def expected_errors(axes: Axes, result: CalibrationResult) -> Axes:
    """Draw the expected error of the calibrated platform's position over x and y.

    The other coordinates are as at home; in space, z is in the middle of the workspace.

    Raises:
        MeasurementError: residuals are so large that no accuracy can be promised.
        WorkspaceError: no workspace was found with the default margins.
    """
    nominal = result.nominal
    _refuse_unexplained(result)
    if (maps := error_maps(result)) is None:
        if nominal.by_readings:
            raise WorkspaceError(
                f"{nominal.name}: its poses follow from readings: errors over x and y are not drawn"
            )
        raise WorkspaceError(f"{nominal.name}: no workspace was found to draw errors over x and y")
    middle = len(maps.heights) // 2
    image = draw_map(axes, (maps.x, maps.y), per_si("m") * maps.after[middle, ..., 0])
    axes.figure.colorbar(image, ax=axes, label=wrapped(_EXPECTED, room(axes)[1]))
    height = height_name(maps.heights[middle])
    axes.set(xlabel=axis_name("x"), ylabel=axis_name("y"), title=height)
    return axes


def correlations(axes: Axes, result: CalibrationResult) -> Axes:
    """Draw the correlations of all parameters that were identified."""
    covariance = result.covariance
    std = np.sqrt(np.diagonal(covariance))
    free = np.flatnonzero(np.isfinite(std) & (std > 0.0))
    rho = covariance[np.ix_(free, free)] / np.outer(std[free], std[free])
    image = axes.imshow(rho, vmin=-1.0, vmax=1.0, cmap="RdBu_r")
    axes.figure.colorbar(image, ax=axes, label="correlation")
    ids = [p.id for _, p in parameters(result)]
    places, names = list(range(len(free))), [ids[i] for i in free]
    capacity = int(min(room(axes)) / PAGE.line_small)  # letters stay large
    if len(free) > capacity and len(result.legs) > 1:  # legs alone
        owners = [name.rpartition(".")[0] for name in names]
        places = [i for i in places if i == 0 or owners[i] != owners[i - 1]]
        names = [owners[i] for i in places]
    elif len(free) > capacity:
        step = -(-len(free) // capacity)
        places, names = places[::step], names[::step]
    axes.set_xticks(places, names, rotation=90, fontsize=7)
    axes.set_yticks(places, names, fontsize=7)
    return axes


def singular_values(axes: Axes, result: CalibrationResult) -> Axes:
    """Draw singular values of the identification Jacobian, and name the weakest direction."""
    ranked = directions(result)
    count = np.arange(1, len(ranked.values) + 1)
    axes.semilogy(count, ranked.values, MARKERS[0], color=IDENTIFIED, ms=4)
    _plain(axes.yaxis)
    weakest = ranked.vectors[:, -1]
    largest = np.argsort(-np.abs(weakest), kind="stable")[:_NAMED]
    shares = (f"{minus(f'{weakest[i]:+.2f}')}\u00a0{ranked.ids[i]}" for i in largest)
    axes.set_title(wrapped(f"weakest: {' '.join(shares)}", room(axes)[0]), fontsize=7)
    fixed = len(ranked.ids) - len(ranked.values)
    axes.set_xlabel("direction" + (f" ({fixed} more are fixed by choice)" if fixed else ""))
    axes.set_ylabel(wrapped("singular value (columns scaled)", room(axes)[1]))
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    return axes


def step_by_step(axes: Axes, result: CalibrationResult) -> Axes:
    """Draw the root of the cost per degree of freedom after each step of the search.

    One line for all legs, or one for each. 1 is what the noise alone makes.

    Raises:
        MeasurementError: a result that was saved before steps were kept.
    """
    if not result.costs:
        raise MeasurementError(
            f"{result.nominal.name}: this result does not hold the steps of its search; calibrate "
            "again"
        )
    names = [leg.name for leg in result.legs]
    of_leg = len(names) == len(result.costs)
    if not of_leg:
        names = [f"fit {number}" for number in range(1, len(result.costs) + 1)]
    for index, (name, costs) in enumerate(zip(names, result.costs, strict=True)):
        style = marks(index, of_leg=of_leg)
        if len(result.costs) == 1:
            style["color"] = IDENTIFIED
        axes.plot(np.arange(len(costs)), np.sqrt(costs), **style, ms=4, lw=1, label=label(name))
    axes.set_yscale("log")
    axes.axhline(1.0, color="0.5", lw=0.8, ls="--", zorder=0)
    _plain(axes.yaxis)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
    axes.set_xlabel("step of the search")
    axes.set_ylabel(wrapped("residuals, root mean square [σ]", room(axes)[1]))
    return axes if len(result.costs) == 1 else legend_beside(axes)


def by_poses(axes: Axes, result: CalibrationResult) -> Axes:
    """Draw the expected error of the platform's position after the first n rows, and the bound.

    The bound: no choice of n of the measured poses, repeated at will, does better.

    Raises:
        MeasurementError: noise differs between rows, residuals contradict it, or more than the
            rows made the result.
        WorkspaceError: no workspace was found.
    """
    _refuse_unexplained(result)
    rows, C, promised = _information(result)
    n, counts = rows.shape[2], np.arange(len(rows)) + 1
    numbers, errors = [], []
    for count in np.unique(np.geomspace(max(2, n // rows.shape[1]), len(rows), _STEPS).astype(int)):
        first_rows = rows[:count].reshape(-1, n)
        if np.linalg.matrix_rank(first_rows) == n:
            half = np.linalg.solve(first_rows.T @ first_rows, C)
            numbers.append(count)
            errors.append(float(np.sqrt((half * C).sum())))
    if not errors or abs(errors[-1] / promised - 1.0) > _AGREEMENT:
        raise MeasurementError(
            f"{result.nominal.name}: more than the rows and their noise made this result (priors, "
            "legs alone, a loss), so what fewer rows would give is not drawn"
        )
    scale = per_si("m")
    bound = continuous_design((rows,), MeanVariance(C)).bound
    least = np.sqrt(np.exp(-bound) / counts)
    first = numbers[0] - 1
    axes.loglog(
        numbers, scale * np.array(errors), "o-", color=IDENTIFIED, ms=4, label="first n rows"
    )
    axes.loglog(counts[first:], scale * least[first:], "--", color=EVERY, lw=1, label="bound")
    _plain(axes.yaxis)
    axes.set_xticks([n for n in numbers if n >= 1.25 * numbers[0] or n == numbers[0]][::3])
    _plain(axes.xaxis)
    axes.set(xlabel="poses n", ylabel=wrapped(_EXPECTED, room(axes)[1]))
    axes.legend()
    return axes


def at_platform(axes: Axes, result: CalibrationResult) -> Axes:
    """Draw what each parameter's change moves the platform by, over the workspace, and its ±.

    Root mean square of the position; bars end where the change does, thin lines are its 95 %.

    Raises:
        WorkspaceError: no workspace was found.
    """
    columns = legs_at(result.identified, sample_configurations(result.nominal, _SAMPLES))
    moved = without_frames(result.identified, columns.poses, columns.gain, result.frames_moved)
    gain = moved[:, : result.nominal.platform.lengths]
    per_unit = np.sqrt((gain**2).sum(axis=1).mean(axis=0))  # [m] per unit of each parameter
    identified = zip((p for _, p in parameters(result)), per_unit.tolist(), strict=True)
    bars = [(p, factor) for p, factor in identified if 0.0 < p.std < np.inf]
    bars.sort(key=lambda bar: abs(bar[0].change) * bar[1])
    count, capacity = len(bars), int((room(axes)[1] - _LEGEND) / _BAR)
    bars = bars[-capacity:]
    places, scale = np.arange(len(bars)), per_si("m")
    changes = np.array([scale * factor * abs(p.change) for p, factor in bars])
    halves = np.array([scale * factor * p.half for p, factor in bars])
    clear = np.array([abs(p.change) > p.half for p, _ in bars])
    colours = np.where(clear, IDENTIFIED, NOMINAL).tolist()
    axes.barh(places, changes, color=colours, height=0.7)
    ends = np.minimum(halves, changes), halves
    axes.errorbar(changes, places, xerr=ends, fmt="none", ecolor=EVERY, elinewidth=0.8, capsize=2)
    axes.set_yticks(places, [p.id for p, _ in bars], fontsize=7)
    axes.set_xlabel(f"moves the platform by [{SMALL['m']}]")
    keys = ((IDENTIFIED, "changed by more than its ±"), (NOMINAL, "by less"))
    handles = [Patch(color=colour, label=text) for colour, text in keys]
    axes.legend(handles=handles, loc="lower right")
    axes.set_xlim(left=0.0)
    legend = _LEGEND * (len(bars) + 1.0) / (room(axes)[1] - _LEGEND)  # in bars
    axes.set_ylim(-0.7 - legend, len(bars) - 0.4)
    if count > len(bars):
        axes.set_title(f"the {len(bars)} largest of {count}", fontsize=8)
    return axes


def compared_runs(axes: Axes, result: CalibrationResult) -> Axes:
    """Draw the parameters of each run less their mean, in standard errors.

    Raises:
        MeasurementError: runs were not compared.
    """
    if (comparison := result.runs) is None:
        raise MeasurementError(
            f"{result.nominal.name}: no runs were compared; measurements need several runs, and "
            "result.compared() compares them"
        )
    known = comparison.predicted > 0.0
    share = np.sqrt(1.0 - 1.0 / len(comparison.values))  # a run is in the mean, too
    deviations = (comparison.values - comparison.values.mean(axis=0))[:, known]
    standardised = deviations / (share * comparison.predicted[known])
    places = np.arange(deviations.shape[1])
    for index, (name, values) in enumerate(zip(comparison.runs, standardised, strict=True)):
        axes.plot(places, values, **marks(index, of_leg=False), ls="", ms=4, label=label(name))
    axes.axhspan(-NORMAL, NORMAL, color="0.92", zorder=0, label=residual_charts.LEVEL)
    name_places(axes, np.array(comparison.names)[known].tolist())
    axes.set_ylabel(wrapped("run less mean / its standard error", room(axes)[1]))
    return legend_beside(axes)


def bed_heights(axes: Axes, result: CalibrationResult) -> Axes:
    """Draw by how much the nominal model misses z over the bed of a printer.

    At home's height, at which printers probe. Where frames were fixed by choice, less what motions
    of these explain.

    Raises:
        WorkspaceError: a machine without x, y and z, or no workspace at that height.
    """
    machine, platform = result.begun, result.nominal.platform
    if platform.coordinates[:3] != ("x", "y", "z"):
        raise WorkspaceError(f"{machine.name}: a bed needs a platform that moves in x, y and z")
    if machine.by_readings:
        raise WorkspaceError(f"{machine.name}: its poses follow from readings, so no bed is drawn")
    samples = sample_configurations(result.nominal, 1000).poses
    low, high = samples.min(axis=0), samples.max(axis=0)
    x, y = (np.linspace(low[i], high[i], _CELLS) for i in (0, 1))
    grid = np.tile(np.array(platform.home), (_CELLS, _CELLS, 1))
    grid[..., 0], grid[..., 1] = x, y[:, None]
    poses = grid.reshape(-1, platform.dof)
    inside = in_workspace(result.nominal, poses)
    if not inside.any():
        raise WorkspaceError(f"{machine.name}: no workspace at the height of home")
    heights = np.full(len(poses), np.nan)
    heights[inside] = per_si("m") * moved_apart(result, machine, Plan(poses[inside]))[:, 2]
    largest = float(np.nanmax(np.abs(heights)))
    image = draw_map(axes, (x, y), heights.reshape(_CELLS, _CELLS), (-largest, largest))
    image.set_cmap("RdBu_r")
    name = wrapped(f"z, true less commanded [{SMALL['m']}]", room(axes)[1])
    axes.figure.colorbar(image, ax=axes, label=name)
    axes.set(xlabel=axis_name("x"), ylabel=axis_name("y"))
    return axes


#: Changes over ± from which a colour is used, with what it says.
LEVELS = (
    (0.0, NOMINAL, "changed by less than its ±"),
    (1.0, "#7352e8", "by 1 to 5 times its ±"),
    (5.0, IDENTIFIED, "by more than 5 times its ±"),
)


def colour_of(p: IdentifiedParameter) -> str:
    """Return the colour of a parameter by its change over half its 95 % interval."""
    if not np.isfinite(p.half) or p.half <= 0.0:
        return INK[0]
    return [colour for least, colour, _ in LEVELS if abs(p.change) >= least * p.half][-1]


def dimensioned(axes: Axes, result: CalibrationResult, leg: str = "") -> Axes:
    """Draw the nominal mechanism, dimensions of a leg in the colours of their changes."""
    mechanism = result.nominal
    name = mechanism.leg(leg or mechanism.leg_names[0]).name
    colours = {
        p.name: colour_of(p)
        for block in result.legs
        for p in block.parameters
        if block.name == name
    }
    return draw_scene(axes, scene(mechanism, home_of(mechanism)), 0, [name], colours)


def _refuse_unexplained(result: CalibrationResult) -> None:
    """Raise if no accuracy can be promised.

    Raises:
        MeasurementError: residuals contradict the noise given.
    """
    if not result.explained:
        raise MeasurementError(
            f"{result.nominal.name}: residuals are {result.excess:.3g} times as large as the noise "
            "given makes them, so no accuracy can be promised and none is drawn"
        )


def _plain(axis: Axis) -> None:
    """Write numbers of an axis of decades as they are read: 1, 2 and 5 of each."""
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def _information(result: CalibrationResult) -> tuple[Array, Array, float]:
    """Return white rows of each pose, C with L = C Cᵀ, and the result's own error, [m].

    Rows, shape (N, r, n), are in coordinates of the n directions that all of them determine; L is
    of the platform's position over the workspace, without what motions of frames explain.
    """
    machine, noise = result.identified, result.noise
    if not isinstance(noise, Noise):
        raise MeasurementError(
            f"{machine.name}: noise differs between rows; expected one noise for all of them"
        )
    readings = result.measurements.readings if machine.by_readings else None
    measured = legs_at(machine, Plan(result.poses, readings=readings))
    rows = information_rows(machine, measured, noise, None, result.options.setup).rows
    n = len(result.covariance)
    std = np.sqrt(np.diagonal(result.covariance))
    free = np.append(np.isfinite(std) & (std > 0.0), np.ones(rows.shape[2] - n, dtype=bool))
    sampled = legs_at(machine, sample_configurations(result.nominal, _SAMPLES))
    moved = without_frames(machine, sampled.poses, sampled.gain, result.frames_moved)
    gain = moved[:, : machine.platform.lengths]
    C = np.zeros((len(free), gain.shape[0] * gain.shape[1]))
    C[:n] = gain.reshape(-1, n).T / np.sqrt(len(gain))
    promised = float(np.sqrt((C[:n] * (result.covariance @ C[:n])).sum()))
    rows, C = rows[..., free], C[free]
    flat = rows.reshape(-1, rows.shape[2])
    size = np.maximum(np.linalg.norm(flat, axis=0), 1e-300)
    _, s, V = np.linalg.svd(flat / size, full_matrices=False)
    determined = V[s > RANK_TOLERANCE * s.max()].T
    return rows / size @ determined, determined.T @ (C / size[:, None]), promised


def _chart(
    draw: Callable[[Axes, CalibrationResult], Axes], width: float = 6.4, height: float = 3.6
) -> Callable[..., Axes]:
    """Return a method of ``Plots`` that draws a chart into axes.

    Args:
        draw: The chart.
        width: Of the figure that is made where no axes are given, [inch].
        height: Of the same.
    """

    def method(self: Plots, ax: Axes | None = None) -> Axes:
        return draw(ax or Figure((width, height), layout="compressed").subplots(), self.result)

    method.__name__, method.__doc__ = draw.__name__, draw.__doc__
    return method


@dataclass(frozen=True)
class Plots:
    """Charts of a result, as ``result.plot``: each returns its axes, those given or new ones."""

    result: CalibrationResult

    residuals = _chart(residual_charts.residuals)
    workspace = _chart(residual_charts.workspace, 5.0, 4.2)
    time = _chart(residual_charts.time)
    images = _chart(residual_charts.images)
    parameters = _chart(changes)
    platform = _chart(at_platform, 6.4, 4.6)
    correlation = _chart(correlations, 5.4, 4.8)
    singular = _chart(singular_values)
    convergence = _chart(step_by_step)
    poses = _chart(by_poses)
    error_map = _chart(expected_errors, 5.0, 4.2)
    bed = _chart(bed_heights, 5.0, 4.2)
    runs = _chart(compared_runs, 6.4, 4.0)

    def drawing(self, ax: Axes | None = None, leg: str = "") -> Axes:
        """Draw a leg with its dimensions, lines in the colours of changes over their ±.

        Args:
            ax: Where to draw.
            leg: Name of the leg, the first if not given.

        Raises:
            MechanismError: no such leg.
        """
        axes = ax or Figure((6.4, 5.0), layout="compressed").subplots()
        return dimensioned(axes, self.result, leg)
