"""Residuals as arrows over the pictures of cameras: from where a point was seen to where it is due.

Images are side by side in one pair of axes; arrows are magnified alike in all of them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from pincal.calibration.result import CalibrationResult
from pincal.errors import MeasurementError
from pincal.model.measuring.image import Camera
from pincal.show.pictures.parts import room, wrapped
from pincal.show.pictures.residual_charts import say_left_out, standardised
from pincal.show.results import Series, observed_series
from pincal.show.style import INK
from pincal.words import plots as words
from pincal.words.pages import clean

Array = NDArray[np.float64]
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
