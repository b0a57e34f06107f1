"""What a metrologist asks of a calibration, each question drawn into axes."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter
from numpy.typing import NDArray

from pincal.calibration.result import CalibrationResult
from pincal.design.information import information_rows
from pincal.design.platform_error import without_frames
from pincal.design.selection.accuracy_bound import accurate_design
from pincal.design.simulate import platform_errors
from pincal.errors import MeasurementError, WorkspaceError
from pincal.estimation.observability.indices import RANK_TOLERANCE
from pincal.kinematics.configurations import legs_at
from pincal.model.measuring.measurements import Noise, Plan
from pincal.show.results import directions, noisy_series, parameters
from pincal.show.style import EVERY, IDENTIFIED, MARKERS, NOMINAL, OUTLIER, look
from pincal.words.numbers import SMALL, STORED, per_si
from pincal.workspace.criteria import in_workspace
from pincal.workspace.sampling import sample_configurations

Array = NDArray[np.float64]
_SAMPLES = 300  # of the workspace
_STEPS = 12  # numbers of poses
_ROWS = 12  # that are named
_NAMED = 3  # parameters of a direction
_ACROSS = 31  # cells of a bed
_SAME = 0.02  # by which the error of all rows may differ from the result's own
_BARS = 25  # parameters beside each other


def worst_of_rows(result: CalibrationResult) -> Array:
    """Return the largest residual of each row in standard deviations, NaN where none is noisy."""
    worst = np.full(len(result.measurements), np.nan)
    for one in noisy_series(result):
        noisy = one.sigma > 0.0
        np.fmax.at(worst, one.rows[noisy], np.abs(one.after[noisy] / one.sigma[noisy]))
    return worst


def refuse_unexplained(result: CalibrationResult) -> None:
    """Raise if no accuracy can be promised.

    Raises:
        MeasurementError: residuals contradict the noise given.
    """
    if not result.explained:
        raise MeasurementError(
            f"{result.nominal.name}: residuals are {result.excess:.3g} times as large as the noise "
            "given makes them, so no accuracy can be promised and none is drawn"
        )


def say_rejected(axes: Axes, result: CalibrationResult) -> None:
    """Name the rows that were rejected, of which no residual is drawn."""
    worst = worst_of_rows(result)
    rows = [one.row for one in result.outliers if not np.isfinite(worst[one.row])]
    if rows:
        some = ", ".join(str(row + 1) for row in sorted(set(rows))[:_ROWS])
        more = " …" if len(set(rows)) > _ROWS else ""
        axes.set_title(f"rejected, not drawn: rows {some}{more}", fontsize=8)


def over_workspace(axes: Axes, result: CalibrationResult) -> Axes:
    """Draw the largest residual of each row where it was measured, x and y; outliers ringed."""
    worst, at = worst_of_rows(result), per_si("m", STORED) * result.poses[:, :2]
    known = np.isfinite(worst) & np.isfinite(at).all(axis=1)
    x, y = at[known].T
    drawn = axes.scatter(x, y, c=worst[known], s=26, cmap="cividis_r", vmin=0.0, vmax=4.0, lw=0)
    bar = axes.figure.colorbar(drawn, ax=axes, extend="max")
    bar.set_label("largest residual of the row [σ]")
    own = [one.row for one in result.outliers if one.row < len(at)]
    if own:
        axes.plot(*at[own].T, "o", ms=9, mfc="none", mec=OUTLIER, mew=1.3, label="outlier")
        axes.legend()
    say_rejected(axes, result)
    axes.set(xlabel=f"x [{STORED['m']}]", ylabel=f"y [{STORED['m']}]", aspect="equal")
    return axes


def over_time(axes: Axes, result: CalibrationResult) -> Axes:
    """Draw the means of residuals over the run, in their standard errors, by tenths of the rows.

    Within ±2 nothing drifts. Over the column ``time`` if measurements have one.
    """
    rows = np.arange(len(result.measurements), dtype=np.float64)
    column = dict(result.measurements.influences or {}).get("time")
    when = rows + 1.0 if column is None else np.asarray(column, dtype=np.float64)
    for index, one in enumerate(noisy_series(result)):
        noisy = one.sigma > 0.0
        order = np.argsort(when[one.rows[noisy]], kind="stable")
        white = (one.after[noisy] / one.sigma[noisy])[order]
        at = when[one.rows[noisy]][order]
        parts = [part for part in np.array_split(np.arange(len(white)), 10) if len(part)]
        own = look(index)
        means = [white[part].sum() / np.sqrt(len(part)) for part in parts]
        middle = [at[part].mean() for part in parts]
        axes.plot(middle, means, own.marker + "-", color=own.colour, ms=4, lw=1, label=one.name)
    axes.axhspan(-1.96, 1.96, color="0.92", zorder=0)
    axes.axhline(0.0, color="0.5", lw=0.8)
    axes.set(xlabel="data row" if column is None else "time", ylabel="mean residual / its σ")
    say_rejected(axes, result)
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False, fontsize=8)
    return axes


def singular_values(axes: Axes, result: CalibrationResult) -> Axes:
    """Draw singular values on a scale of decades, and name what the weakest direction moves."""
    found = directions(result)
    count = np.arange(1, len(found.values) + 1)
    axes.semilogy(count, found.values, MARKERS[0], color=IDENTIFIED, ms=4)
    _plain(axes.yaxis)
    weakest = found.vectors[:, -1]
    most = np.argsort(-np.abs(weakest), kind="stable")[:_NAMED]
    terms = [f"{weakest[i]:+.2f} {found.ids[i]}".replace("-", "−") for i in most]
    axes.set_title("weakest: " + "  ".join(terms), fontsize=7)
    lost = len(found.ids) - len(found.values)
    more = f" ({lost} more are fixed by choice)" if lost else ""
    axes.set(xlabel=f"direction{more}", ylabel="singular value (columns scaled)")
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
    alone = len(result.costs) == 1
    names = [leg.name for leg in result.legs]
    if len(names) != len(result.costs):
        names = [f"fit {number}" for number in range(1, len(result.costs) + 1)]
    for index, (name, costs) in enumerate(zip(names, result.costs, strict=True)):
        own = look(index)
        colour, steps = (IDENTIFIED if alone else own.colour), np.arange(len(costs))
        axes.plot(steps, np.sqrt(costs), own.marker + "-", color=colour, ms=4, lw=1, label=name)
    axes.set_yscale("log")
    axes.axhline(1.0, color="0.5", lw=0.8, ls="--", zorder=0)
    _plain(axes.yaxis)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
    axes.set(xlabel="step of the search", ylabel="residuals, root mean square [σ]")
    if not alone:
        axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False, fontsize=8)
    return axes


def by_poses(axes: Axes, result: CalibrationResult) -> Axes:
    """Draw the expected error of the platform's position after the first n rows, and the bound.

    The bound: no choice of n of the measured poses, repeated at will, does better.

    Raises:
        MeasurementError: noise differs between rows, residuals contradict it, or more than the
            rows made the result.
        WorkspaceError: no workspace was found.
    """
    refuse_unexplained(result)
    rows, C, own = _information(result)
    n, counts = rows.shape[2], np.arange(len(rows)) + 1
    numbers, errors = [], []
    for count in np.unique(np.geomspace(max(2, n // rows.shape[1]), len(rows), _STEPS).astype(int)):
        some = rows[:count].reshape(-1, n)
        if np.linalg.matrix_rank(some) == n:
            half = np.linalg.solve(some.T @ some, C)
            numbers.append(count)
            errors.append(float(np.sqrt((half * C).sum())))
    if not errors or abs(errors[-1] / own - 1.0) > _SAME:
        raise MeasurementError(
            f"{result.nominal.name}: more than the rows and their noise made this result (priors, "
            "legs alone, a loss), so what fewer rows would give is not drawn"
        )
    scale = per_si("m")
    least = np.sqrt(accurate_design(rows, C).least / counts)
    first = numbers[0] - 1
    axes.loglog(
        numbers, scale * np.array(errors), "o-", color=IDENTIFIED, ms=4, label="first n rows"
    )
    axes.loglog(counts[first:], scale * least[first:], "--", color=EVERY, lw=1, label="bound")
    _plain(axes.yaxis)
    axes.set_xticks([one for one in numbers if one >= 1.25 * numbers[0] or one == numbers[0]][::3])
    _plain(axes.xaxis)
    axes.set(xlabel="poses n", ylabel=f"expected error of position [{SMALL['m']}]")
    axes.legend()
    return axes


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
    found = legs_at(machine, Plan(result.poses, readings=readings))
    rows = information_rows(machine, found, noise, None, result.options.setup).rows
    n = len(result.covariance)
    std = np.sqrt(np.diagonal(result.covariance))
    free = np.append(np.isfinite(std) & (std > 0.0), np.ones(rows.shape[2] - n, dtype=bool))
    over = legs_at(machine, sample_configurations(result.nominal, _SAMPLES))
    moved = without_frames(machine, over.poses, over.gain, result.frames_moved)
    gain = moved[:, : machine.platform.lengths]
    C = np.zeros((len(free), gain.shape[0] * gain.shape[1]))
    C[:n] = gain.reshape(-1, n).T / np.sqrt(len(gain))
    own = float(np.sqrt((C[:n] * (result.covariance @ C[:n])).sum()))
    rows, C = rows[..., free], C[free]
    flat = rows.reshape(-1, rows.shape[2])
    size = np.maximum(np.linalg.norm(flat, axis=0), 1e-300)
    _, s, V = np.linalg.svd(flat / size, full_matrices=False)
    into = V[s > RANK_TOLERANCE * s.max()].T  # what all rows determine
    return rows / size @ into, into.T @ (C / size[:, None]), own


def at_platform(axes: Axes, result: CalibrationResult) -> Axes:
    """Draw what each parameter's change moves the platform by, over the workspace, and its ±.

    Root mean square of the position; bars end where the change does, thin lines are its 95 %.

    Raises:
        WorkspaceError: no workspace was found.
    """
    found = legs_at(result.identified, sample_configurations(result.nominal, _SAMPLES))
    moved = without_frames(result.identified, found.poses, found.gain, result.frames_moved)
    gain = moved[:, : result.nominal.platform.lengths]
    per = np.sqrt((gain**2).sum(axis=1).mean(axis=0))  # [m] per unit of each parameter
    every = [p for _, p in parameters(result)]
    own = [(p, one) for p, one in zip(every, per.tolist(), strict=True) if p.high > p.low]
    own.sort(key=lambda one: abs(one[0].change) * one[1])
    count, own = len(own), own[-_BARS:]
    places, scale = np.arange(len(own)), per_si("m")
    changes = np.array([scale * one * abs(p.change) for p, one in own])
    halves = np.array([scale * one * p.half for p, one in own])
    clear = np.array([abs(p.change) > p.half for p, _ in own])
    colours = np.where(clear, IDENTIFIED, NOMINAL).tolist()
    axes.barh(places, changes, color=colours, height=0.7)
    ends = np.minimum(halves, changes), halves
    axes.errorbar(changes, places, xerr=ends, fmt="none", ecolor=EVERY, elinewidth=0.8, capsize=2)
    axes.set_yticks(places, [p.id for p, _ in own], fontsize=7)
    axes.set_xlabel(f"moves the platform by [{SMALL['m']}]; grey: change within its ±")
    axes.set_xlim(left=0.0)
    if count > len(own):
        axes.set_title(f"the {len(own)} largest of {count}", fontsize=8)
    return axes


def runs_compared(axes: Axes, result: CalibrationResult) -> Axes:
    """Draw each run's parameters less their mean, in the standard errors of that.

    Raises:
        MeasurementError: runs were not compared.
    """
    if (runs := result.runs) is None:
        raise MeasurementError(
            f"{result.nominal.name}: no runs were compared; measurements need "
            "several runs, and result.compared() compares them"
        )
    known = runs.predicted > 0.0
    share = np.sqrt(1.0 - 1.0 / len(runs.values))  # a run is in the mean, too
    off = (runs.values - runs.values.mean(axis=0))[:, known] / (share * runs.predicted[known])
    places = np.arange(off.shape[1])
    for index, (name, own) in enumerate(zip(runs.runs, off, strict=True)):
        mark = look(index)
        axes.plot(places, own, mark.marker, color=mark.colour, ms=4, label=name)
    axes.axhspan(-1.96, 1.96, color="0.92", zorder=0)
    names = [name for name, one in zip(runs.names, known, strict=True) if one]
    axes.set_xticks(places, names, rotation=90, fontsize=7)
    axes.set_ylabel("run less mean [its σ]")
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False, fontsize=8)
    return axes


def bed_heights(result: CalibrationResult) -> tuple[Array, Array, Array]:
    """Return x, y and by how much the nominal model misses z over the bed, (n,), (n,), (n, n), [m].

    NaN outside of the workspace. The height is home's, that at which printers probe.

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
    x, y = (np.linspace(low[i], high[i], _ACROSS) for i in (0, 1))
    poses = np.tile(np.array(platform.home), (_ACROSS, _ACROSS, 1))
    poses[..., 0], poses[..., 1] = x, y[:, None]
    flat = poses.reshape(-1, platform.dof)
    inside = in_workspace(result.nominal, flat)
    if not inside.any():
        raise WorkspaceError(f"{machine.name}: no workspace at the height of home")
    heights = np.full(len(flat), np.nan)
    heights[inside] = platform_errors(machine, result.identified, Plan(flat[inside]))[:, 2]
    return x, y, heights.reshape(_ACROSS, _ACROSS)
