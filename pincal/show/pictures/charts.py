"""What a metrologist asks of a calibration, each question drawn into axes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.patches import Patch, Rectangle
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter

from pincal.calibration.result import CalibrationResult
from pincal.design.exchange import accurate_design
from pincal.design.information import information_rows
from pincal.design.platform_error import without_frames
from pincal.errors import MeasurementError, WorkspaceError
from pincal.estimation.observability.indices import RANK_TOLERANCE
from pincal.kinematics.configurations import legs_at
from pincal.model.measurements import Noise, Plan
from pincal.model.setup import Camera
from pincal.show.pictures.parts import NORMAL, label, marks, name_places, outside, room, wrapped
from pincal.show.pictures.residual_charts import say_left_out, standardised
from pincal.show.result_tables import Series, directions, observed_series, parameters
from pincal.show.style import EVERY, IDENTIFIED, INK, MARKERS, NOMINAL
from pincal.show.workspace_answers import moved_apart
from pincal.types import Array
from pincal.words import plots as words
from pincal.words.numbers import per_si
from pincal.words.wording import clean
from pincal.workspace.criteria import in_workspace
from pincal.workspace.sampling import sample_configurations

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


_APART = 0.08  # of the widest image
_ARROW = 0.07  # length of a typical large arrow, of the widest image
_LARGE = 0.9  # share of arrows that are shorter


class Seen(NamedTuple):
    """What a camera saw, and how far that is off."""

    camera: Camera
    at: Array
    """Points as seen, from the upper left corner, shape (N, 2), [px]."""
    off: Array
    """Predicted less seen, shape (N, 2), [px]."""
    size: Array
    """The larger of both, standardised, shape (N,); NaN where nothing checks either."""


def seen_in(result: CalibrationResult) -> list[Seen]:
    """Return what each camera of a result saw; empty if none measured."""
    series = {one.name: one for one in observed_series(result)}
    found = []
    for camera in result.options.setup.instruments:
        if not isinstance(camera, Camera):
            continue
        pairs = [[series.get(c) for c in pair] for pair in camera.image.points.values()]
        parts = [
            _seen(camera, right, down, [result.measurements.extra[c] for c in pair])
            for (right, down), pair in zip(pairs, camera.image.points.values(), strict=True)
            if right and down
        ]
        if parts:
            found.append(Seen(camera, *(np.concatenate(one) for one in zip(*parts, strict=True))))
    return found


def _seen(
    camera: Camera, right: Series, down: Series, columns: list[Array]
) -> tuple[Array, Array, Array]:
    """Return places, errors and sizes of one point where both of its columns were measured."""
    rows, first, second = np.intersect1d(right.rows, down.rows, return_indices=True)
    at = camera.image.at(*(np.asarray(one)[rows] for one in columns))
    off = camera.image.scale * np.stack((right.after[first], down.after[second]), axis=1)
    return at, off, np.fmax(*np.abs((right.standardised[first], down.standardised[second])))


def over_images(axes: Axes, result: CalibrationResult) -> Axes:
    """Draw residuals over images, from points as seen; colours are standardised residuals.

    Raises:
        MeasurementError: no camera measured.
    """
    if not (every := seen_in(result)):
        raise MeasurementError(words.no_images(result.nominal.name))
    sizes = np.array([one.camera.image.size for one in every], dtype=np.float64)
    most, high = sizes.max(axis=0)
    gap = _APART * most
    width, height = room(axes)
    across = _across(len(every), (most + gap) / (high + 2 * gap), width / height)
    lengths = np.concatenate([np.linalg.norm(one.off, axis=1) for one in every])
    magnified = _round(_ARROW * most / max(float(np.quantile(lengths, _LARGE)), 1e-12))
    for index, (one, (wide, tall)) in enumerate(zip(every, sizes, strict=True)):
        corner = np.array([index % across * (most + gap), index // across * (high + 2 * gap)])
        axes.add_patch(Rectangle(tuple(corner), wide, tall, fill=False, ec="0.6", lw=0.8))
        rms = float(np.sqrt((one.off**2).sum(axis=1).mean()))
        said = f"{clean(one.camera.name)}: {words.points(len(one.at), rms)}"
        axes.text(float(corner[0]), float(corner[1]) - 0.2 * gap, said, size=8, va="bottom")
        arrows = axes.quiver(
            *(corner + one.at).T,
            *(magnified * one.off).T,
            np.where(np.isfinite(one.size), one.size, 0.0),
            cmap="cividis_r",
            clim=(0.0, 4.0),
            angles="xy",
            scale_units="xy",
            scale=1.0,
            width=0.0025,
        )
    low = -(-len(every) // across) * (high + 2 * gap) - gap
    pixels = _round(_ARROW * most / magnified)
    axes.plot((0.0, magnified * pixels), (low, low), color=INK[0], lw=1.5, solid_capstyle="butt")
    text = f"  {words.key(pixels)}"
    axes.text(magnified * pixels, low, text, size=8, va="center")
    bar = axes.figure.colorbar(arrows, ax=axes, extend="max", shrink=0.8)
    bar.set_label(wrapped(words.of_point(standardised=standardised(result)), 0.8 * height))
    axes.set(xlim=(-0.02 * most, across * (most + gap) - gap + 0.02 * most), aspect="equal")
    axes.set_ylim(low + 0.5 * gap, -gap)
    axes.set_axis_off()
    say_left_out(axes, result)
    return axes


def _across(count: int, image: float, whole: float) -> int:
    """Return how many images of a shape are side by side so that they are largest."""

    def size(across: int) -> float:
        return min(whole / (across * image), 1.0 / -(-count // across))

    return max(range(1, count + 1), key=size)


def _round(value: float) -> float:
    """Return the next of 1, 2, 5, 10, … that is not above a value."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(power * max(one for one in (1.0, 2.0, 5.0) if one * power <= value * (1 + 1e-9)))
