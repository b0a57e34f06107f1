"""What a metrologist asks of a calibration, each question drawn into axes."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter
from numpy.typing import NDArray

from pincal.calibration.result import CalibrationResult
from pincal.design.exchange import accurate_design
from pincal.design.information import information_rows
from pincal.design.platform_error import without_frames
from pincal.errors import MeasurementError, WorkspaceError
from pincal.estimation.observability.indices import RANK_TOLERANCE
from pincal.kinematics.configurations import legs_at
from pincal.model.measuring.measurements import Noise, Plan
from pincal.show.pictures.parts import NORMAL, label, marks, name_places, outside, room, wrapped
from pincal.show.results import directions, parameters
from pincal.show.style import EVERY, IDENTIFIED, MARKERS, NOMINAL
from pincal.show.workspace_errors import moved_apart
from pincal.words import plots as words
from pincal.words.numbers import per_si
from pincal.workspace.criteria import in_workspace
from pincal.workspace.sampling import sample_configurations

Array = NDArray[np.float64]
_SAMPLES = 300  # of the workspace
_STEPS = 12  # numbers of poses
_NAMED = 3  # parameters of a direction
_ACROSS = 31  # cells of a bed
_SAME = 0.02  # by which the error of all rows may differ from the result's own
_BAR = 0.125  # height of a bar with its name, [inch]
_LEGEND = 0.35  # height of a legend of two lines, [inch]


def refuse_unexplained(result: CalibrationResult) -> None:
    """Raise if no accuracy can be promised.

    Raises:
        MeasurementError: residuals contradict the noise given.
    """
    if not result.explained:
        raise MeasurementError(words.unexplained(result.nominal.name, result.excess))


def singular_values(axes: Axes, result: CalibrationResult) -> Axes:
    """Draw singular values on a scale of decades, and name what the weakest direction moves."""
    found = directions(result)
    count = np.arange(1, len(found.values) + 1)
    axes.semilogy(count, found.values, MARKERS[0], color=IDENTIFIED, ms=4)
    _plain(axes.yaxis)
    weakest = found.vectors[:, -1]
    most = np.argsort(-np.abs(weakest), kind="stable")[:_NAMED]
    said = words.weakest([(float(weakest[i]), found.ids[i]) for i in most])
    axes.set_title(wrapped(said, room(axes)[0]), fontsize=7)
    lost = len(found.ids) - len(found.values)
    axes.set(xlabel=words.directions(lost), ylabel=wrapped(words.SINGULAR, room(axes)[1]))
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    return axes


def step_by_step(axes: Axes, result: CalibrationResult) -> Axes:
    """Draw the root of the cost per degree of freedom after each step of the search.

    One line for all legs, or one for each. 1 is what the noise alone makes.

    Raises:
        MeasurementError: a result that was saved before steps were kept.
    """
    if not result.costs:
        raise MeasurementError(words.no_steps(result.nominal.name))
    alone = len(result.costs) == 1
    names = [leg.name for leg in result.legs]
    of_leg = len(names) == len(result.costs)
    if not of_leg:
        names = [words.fit(number) for number in range(1, len(result.costs) + 1)]
    for index, (name, costs) in enumerate(zip(names, result.costs, strict=True)):
        own = marks(index, of_leg=of_leg) | ({"color": IDENTIFIED} if alone else {})
        axes.plot(np.arange(len(costs)), np.sqrt(costs), **own, ms=4, lw=1, label=label(name))
    axes.set_yscale("log")
    axes.axhline(1.0, color="0.5", lw=0.8, ls="--", zorder=0)
    _plain(axes.yaxis)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
    axes.set(xlabel=words.STEP, ylabel=wrapped(words.COST, room(axes)[1]))
    if not alone:
        outside(axes)
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
        raise MeasurementError(words.not_rows_alone(result.nominal.name))
    scale = per_si("m")
    least = np.sqrt(accurate_design(rows, C).least / counts)
    first = numbers[0] - 1
    axes.loglog(numbers, scale * np.array(errors), "o-", color=IDENTIFIED, ms=4, label=words.FIRST)
    axes.loglog(counts[first:], scale * least[first:], "--", color=EVERY, lw=1, label=words.BOUND)
    _plain(axes.yaxis)
    axes.set_xticks([one for one in numbers if one >= 1.25 * numbers[0] or one == numbers[0]][::3])
    _plain(axes.xaxis)
    axes.set(xlabel=words.POSES, ylabel=wrapped(words.EXPECTED, room(axes)[1]))
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
        raise MeasurementError(words.uneven_noise(machine.name))
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
    own = [(p, one) for p, one in zip(every, per.tolist(), strict=True) if 0.0 < p.std < np.inf]
    own.sort(key=lambda one: abs(one[0].change) * one[1])
    count, most = len(own), int((room(axes)[1] - _LEGEND) / _BAR)
    own = own[-most:]
    places, scale = np.arange(len(own)), per_si("m")
    changes = np.array([scale * one * abs(p.change) for p, one in own])
    halves = np.array([scale * one * p.half for p, one in own])
    clear = np.array([abs(p.change) > p.half for p, _ in own])
    colours = np.where(clear, IDENTIFIED, NOMINAL).tolist()
    axes.barh(places, changes, color=colours, height=0.7)
    ends = np.minimum(halves, changes), halves
    axes.errorbar(changes, places, xerr=ends, fmt="none", ecolor=EVERY, elinewidth=0.8, capsize=2)
    axes.set_yticks(places, [p.id for p, _ in own], fontsize=7)
    axes.set_xlabel(words.MOVED)
    keys = ((IDENTIFIED, words.CLEAR), (NOMINAL, words.WITHIN))
    axes.legend(handles=[Patch(color=one, label=said) for one, said in keys], loc="lower right")
    axes.set_xlim(left=0.0)
    legend = _LEGEND * (len(own) + 1.0) / (room(axes)[1] - _LEGEND)  # in bars
    axes.set_ylim(-0.7 - legend, len(own) - 0.4)
    if count > len(own):
        axes.set_title(words.some_of(len(own), count), fontsize=8)
    return axes


def runs_compared(axes: Axes, result: CalibrationResult) -> Axes:
    """Draw each run's parameters less their mean, in the standard errors of that.

    Raises:
        MeasurementError: runs were not compared.
    """
    if (runs := result.runs) is None:
        raise MeasurementError(words.no_runs(result.nominal.name))
    known = runs.predicted > 0.0
    share = np.sqrt(1.0 - 1.0 / len(runs.values))  # a run is in the mean, too
    off = (runs.values - runs.values.mean(axis=0))[:, known] / (share * runs.predicted[known])
    places = np.arange(off.shape[1])
    for index, (name, own) in enumerate(zip(runs.runs, off, strict=True)):
        axes.plot(places, own, **marks(index, of_leg=False), ls="", ms=4, label=label(name))
    axes.axhspan(-NORMAL, NORMAL, color="0.92", zorder=0, label=words.NORMAL)
    name_places(axes, [name for name, one in zip(runs.names, known, strict=True) if one])
    axes.set_ylabel(wrapped(words.RUN, room(axes)[1]))
    outside(axes)
    return axes


def bed_heights(result: CalibrationResult) -> tuple[Array, Array, Array]:
    """Return x, y and by how much the nominal model misses z over the bed, (n,), (n,), (n, n), [m].

    NaN outside of the workspace. The height is home's, that at which printers probe. Where frames
    were fixed by choice, less what motions of these explain.

    Raises:
        WorkspaceError: a machine without x, y and z, or no workspace at that height.
    """
    machine, platform = result.begun, result.nominal.platform
    if platform.coordinates[:3] != ("x", "y", "z"):
        raise WorkspaceError(words.no_bed(machine.name, "axes"))
    if machine.by_readings:
        raise WorkspaceError(words.no_bed(machine.name, "readings"))
    samples = sample_configurations(result.nominal, 1000).poses
    low, high = samples.min(axis=0), samples.max(axis=0)
    x, y = (np.linspace(low[i], high[i], _ACROSS) for i in (0, 1))
    poses = np.tile(np.array(platform.home), (_ACROSS, _ACROSS, 1))
    poses[..., 0], poses[..., 1] = x, y[:, None]
    flat = poses.reshape(-1, platform.dof)
    inside = in_workspace(result.nominal, flat)
    if not inside.any():
        raise WorkspaceError(words.no_bed(machine.name, "height"))
    heights = np.full(len(flat), np.nan)
    heights[inside] = moved_apart(result, machine, Plan(flat[inside]))[:, 2]
    return x, y, heights.reshape(_ACROSS, _ACROSS)
