"""Residuals over rows, workspace, time and images, each over what it may be after the fit."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes

from pincal.calibration.fits import Fits, Near, fitted
from pincal.calibration.result import CalibrationResult
from pincal.estimation.linear import State
from pincal.estimation.residuals.redundancy import Left, every_residual
from pincal.show.pictures.parts import NORMAL, label, marks, outside, room, wrapped
from pincal.show.result_tables import CONTROLLED, Series, noisy_series
from pincal.show.style import OUTLIER
from pincal.types import Array, Index
from pincal.words import plots as words
from pincal.words.numbers import STORED, per_si

_ROWS = 12  # that are named
_PARTS = 10  # of a run


def worst_of_rows(result: CalibrationResult) -> Array:
    """Return the largest standardised residual of each row, NaN where none is noisy."""
    worst = np.full(len(result.measurements), np.nan)
    for one in noisy_series(result):
        np.fmax.at(worst, one.rows, np.abs(one.standardised))
    return worst


def standardised(result: CalibrationResult) -> bool:
    """Return whether leverages are known: all results but those of old files."""
    return all(one.redundancy is not None for one in noisy_series(result))


def say_left_out(axes: Axes, result: CalibrationResult) -> None:
    """Say which rows were rejected, and how many residuals nothing checks: neither is drawn."""
    worst, series = worst_of_rows(result), noisy_series(result)
    rows = [one.row for one in result.outliers if not np.isfinite(worst[one.row])]
    lost = sum(int((~np.isfinite(one.standardised) & (one.sigma > 0.0)).sum()) for one in series)
    said = [words.rejected(rows, _ROWS)] if rows else []
    said += [words.unchecked(lost)] if lost else []
    if said:
        axes.set_title("\n".join(said), fontsize=8)


def over_rows(axes: Axes, result: CalibrationResult) -> Axes:
    """Draw standardised residuals against the row; dashed: between which 95 of 100 are."""
    for index, one in enumerate(noisy_series(result)):
        own, noisy = marks(index, of_leg=one.of_leg), one.sigma > 0.0
        at = one.rows[noisy] + 1, one.standardised[noisy]
        axes.plot(*at, **own, ls="", ms=3, label=label(one.name))
    levels(axes, NORMAL, words.NORMAL)
    axes.set(xlabel=words.ROW, ylabel=words.residual(standardised=standardised(result)))
    say_left_out(axes, result)
    outside(axes)
    return axes


def over_workspace(axes: Axes, result: CalibrationResult) -> Axes:
    """Draw the largest residual of each row where it was measured, x and y; outliers ringed."""
    worst, at = worst_of_rows(result), per_si("m", STORED) * result.poses[:, :2]
    known = np.isfinite(worst) & np.isfinite(at).all(axis=1)
    x, y = at[known].T
    drawn = axes.scatter(x, y, c=worst[known], s=26, cmap="cividis_r", vmin=0.0, vmax=4.0, lw=0)
    bar = axes.figure.colorbar(drawn, ax=axes, extend="max")
    bar.set_label(wrapped(words.largest(standardised=standardised(result)), room(axes)[1]))
    own = [one.row for one in result.outliers if one.row < len(at)]
    if own:
        axes.plot(*at[own].T, "o", ms=9, mfc="none", mec=OUTLIER, mew=1.3, label=words.OUTLIER)
        axes.legend()
    say_left_out(axes, result)
    axes.set(xlabel=words.along("x"), ylabel=words.along("y"), aspect="equal")
    return axes


def over_time(axes: Axes, result: CalibrationResult) -> Axes:
    """Draw the means of residuals over the run, in their standard errors, by tenths of the rows.

    Standard errors are those after the fit, which has taken up its part of what all rows of a
    tenth share; so it is made once more, from where it ended. Between ±1.96 nothing drifts. Over
    the column ``time`` if measurements have one.
    """
    rows = np.arange(len(result.measurements), dtype=np.float64)
    column = dict(result.measurements.influences or {}).get("time")
    when = rows + 1.0 if column is None else np.asarray(column, dtype=np.float64)
    every = _left(result)
    for index, one in enumerate(noisy_series(result)):
        noisy = np.flatnonzero(one.sigma > 0.0)
        order = noisy[np.argsort(when[one.rows[noisy]], kind="stable")]
        parts = [part for part in np.array_split(order, _PARTS) if len(part)]
        means = [every[one.of_leg, one.name].mean(one, part) for part in parts]
        middle = [when[one.rows[part]].mean() for part in parts]
        own = marks(index, of_leg=one.of_leg)
        axes.plot(middle, means, **own, ms=4, lw=1, label=label(one.name))
    axes.axhspan(-NORMAL, NORMAL, color="0.92", zorder=0, label=words.NORMAL)
    axes.axhline(0.0, color="0.5", lw=0.8)
    axes.set_xlabel(words.ROW if column is None else words.TIME)
    axes.set_ylabel(wrapped(words.MEAN, room(axes)[1]))
    say_left_out(axes, result)
    outside(axes)
    return axes


class _Kind(NamedTuple):
    """What a fit leaves of the residuals of a leg, or of a measured quantity."""

    left: Left
    rows: Index
    """Rows of the measurements, ascending, shape (N,)."""
    scale: float
    """Of the noise, where it was estimated."""

    def mean(self, one: Series, part: Index) -> float:
        """Return the sum of some residuals over its standard deviation; NaN if nothing checks it.

        Args:
            one: The residuals.
            part: Which of them.
        """
        factors = np.zeros(self.left.noise.shape[:2])
        first = np.searchsorted(one.rows, one.rows[part])  # of the row's equations
        places = np.searchsorted(self.rows, one.rows[part]), part - first
        factors[places] = 1.0 / one.sigma[part]
        variance = self.scale**2 * self.left.of_sum(factors)
        if variance < CONTROLLED * len(part):
            return float("nan")
        return float((one.after[part] / one.sigma[part]).sum() / np.sqrt(variance))


def _left(result: CalibrationResult) -> dict[tuple[bool, str], _Kind]:
    """Return what the fit leaves, by whether it is of a leg, and its name."""
    found = {}
    for robust in _again(result).fits:
        fit, problem = robust.fit, robust.fit.problem
        _, follows, columns = every_residual(fit)
        left = Left.of(fit, follows)
        own = [((True, leg.name), one) for leg, one in zip(problem.legs, columns, strict=False)]
        if problem.latent:
            places = range(columns[-1].start, columns[-1].stop)
            names = zip(problem.observation.names, places, strict=True)
            own += [((False, name), slice(place, place + 1)) for name, place in names]
        for kind, one in own:
            found[kind] = _Kind(left.part(one), robust.rows, fit.noise_scale)
    return found


def _again(result: CalibrationResult) -> Fits:
    """Return the fits of a result, begun where they ended."""
    calibration, poses, near = result.calibration, result.estimated_poses, None
    if poses is not None:
        values = np.concatenate([leg.identified for leg in result.legs])
        matrices = result.nominal.platform.matrices(poses)
        outside = result.outside or calibration.observation.external.start
        near = Near(State(values, matrices, (None,) * len(result.legs), outside))
    return fitted(calibration, near=near)


def levels(axes: Axes, size: float, said: str) -> None:
    """Draw lines at zero and, dashed, at a size on both sides, which the legend says."""
    axes.axhline(0.0, color="0.5", lw=0.8, zorder=0)
    for level in (-size, size):
        name = f"_{said}" if level < 0.0 else said
        axes.axhline(level, color="0.5", lw=0.8, ls="--", zorder=0, label=name)
