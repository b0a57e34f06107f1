"""Charts of a calibration, as a metrologist would ask for them.

``Plots`` is the registry of charts, and the class of ``result.plot``. ``pincal plot`` and the
report draw its charts by name; the methods' docstrings are their captions. Residuals after the fit
are divided by their standard deviations σ√(1−h), with leverage h.
"""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.transforms import Affine2D

from pincal.calibration.result import CalibrationResult
from pincal.errors import MeasurementError
from pincal.show.misses import camera_misses, noisy_residuals
from pincal.show.picture import shortened
from pincal.show.style import EVERY, GROUND, INK, OUTLIER, leg_colour
from pincal.show.view.scene import rounded_down
from pincal.words.numbers import amount
from pincal.words.wording import clean

_NORMAL = 1.96  # standard deviations within which 95 % of normal numbers lie
_NAMED = 6  # outliers that are named
_GAP = 0.08  # gap between images, over the width of the widest image
_ARROW = 0.07  # length of a typical large arrow, over the width of the widest image
_LARGE = 0.9  # share of arrows that are shorter than a typical large arrow


class Plots:
    """Charts of a result, as ``result.plot``; each draws into the given or new axes."""

    def __init__(self, result: CalibrationResult) -> None:
        self.result = result

    def residuals(self, ax: Axes | None = None) -> Axes:
        """Draw residuals after the calibration against the row of the measurements.

        Each is divided by its own standard deviation after the fit, σ√(1−h). 95 % are expected in
        the bands, which reach to ±1.96. Hollow: held-out rows, each with its error as a whole in σ.
        Crosses at the upper edge: rows that do not fit the others.
        """
        ax, result = ax or _axes(6.4, 4.2), self.result
        groups, held = noisy_residuals(result), result.validation
        lanes = [(shortened(group.name), group.rows, group.standardised) for group in groups]
        if held is not None:
            lanes.append((held.kind, np.arange(len(held.sigma)), held.sigma))
        sizes = [np.nanmax(np.abs(values), initial=0.0) for _, _, values in lanes]
        lane = max(6.0, 2.2 * float(max(sizes, default=0.0)))  # spacing of the groups
        for index, (_, rows, values) in enumerate(lanes):
            of_leg = index < len(groups) and groups[index].parameters
            colour = leg_colour(index) if of_leg else EVERY
            fill, size = ("none", 4.0) if index == len(groups) else (None, 2.5)
            middle = -lane * index
            within = Affine2D().translate(0.0, middle) + ax.transData
            ax.plot(rows + 1, values, "o", ms=size, color=colour, mfc=fill, transform=within)
            ax.axhspan(middle - _NORMAL, middle + _NORMAL, color=GROUND, lw=0, alpha=0.5, zorder=0)
        ax.set_yticks(-lane * np.arange(len(lanes)), [name for name, *_ in lanes])
        ax.set(xlabel="data row", ylabel="residual / (σ√(1−h)), bands ±1.96")
        ax.set_ylim(lane * (0.5 - len(lanes)), lane / 2)
        edge = ax.get_xaxis_transform()
        for rank, outlier in enumerate(self.result.outliers):
            place = outlier.row + 1, 1.0
            ax.plot(*place, "X", ms=6, color=OUTLIER, transform=edge, clip_on=False)
            if rank < _NAMED:
                ax.annotate(
                    str(outlier.row + 1), place, (6, 2), edge, textcoords="offset points", size=7
                )
        _name_undrawn(ax, self.result)
        return ax

    def images(self, ax: Axes | None = None) -> Axes:
        """Draw the residuals of cameras: arrows from each seen point towards its prediction.

        All images have the same magnification. Where the arrows of a region point one way, the
        model of the lens does not fit the lens.

        Raises:
            MeasurementError: no camera measured.
        """
        ax = ax or _axes(6.4, 3.6)
        if not (cameras := camera_misses(self.result)):
            raise MeasurementError(
                f"{self.result.nominal.name}: no camera measured it: no instrument of the setup is "
                "a pincal.Camera"
            )
        widest, highest = np.max([misses.camera.lens.size for misses in cameras], axis=0)
        gap, low = _GAP * widest, highest + _GAP * widest
        lengths = np.concatenate([np.linalg.norm(misses.missed, axis=1) for misses in cameras])
        magnified = rounded_down(_ARROW * widest / max(float(np.quantile(lengths, _LARGE)), 1e-12))
        for index, (camera, _, seen, missed, standardised, metres) in enumerate(cameras):
            x, off = index * (widest + gap), np.linalg.norm(missed, axis=1)
            ax.add_patch(Rectangle((x, 0.0), *camera.lens.size, fill=False, ec="0.6", lw=0.8))
            rms, far = (float(np.sqrt((sizes**2).mean())) for sizes in (off, off * metres))
            title = f"{clean(camera.name)}: {len(off)} points, {rms:.2g} px, {amount(far, 'm', 2)}"
            ax.text(x, -0.2 * gap, title, size=8, va="bottom")
            arrows = ax.quiver(
                x + seen[:, 0],
                seen[:, 1],
                *(magnified * missed.T),
                np.nan_to_num(standardised),
                cmap="cividis_r",
                clim=(0.0, 4.0),
                angles="xy",
                scale_units="xy",
                scale=1.0,
                width=0.0025,
            )
        pixels = rounded_down(_ARROW * widest / magnified)
        ax.plot((0.0, magnified * pixels), (low, low), color=INK, lw=1.5, solid_capstyle="butt")
        key = f"  {pixels:g} px of residual, predicted less seen"
        ax.text(magnified * pixels, low, key, size=8, va="center")
        label = "larger residual / (σ√(1−h))"
        ax.figure.colorbar(arrows, ax=ax, extend="max", shrink=0.8, label=label)
        right = len(cameras) * (widest + gap) - gap
        ax.set(xlim=(-0.2 * gap, right + 0.2 * gap), ylim=(low + 0.5 * gap, -gap), aspect="equal")
        ax.set_axis_off()
        _name_undrawn(ax, self.result)
        return ax


def _axes(width: float, height: float) -> Axes:
    return Figure((width, height), layout="compressed").subplots()


def _name_undrawn(axes: Axes, result: CalibrationResult) -> None:
    unchecked = sum(
        int((~np.isfinite(group.standardised) & (group.sigma > 0.0)).sum())
        for group in noisy_residuals(result)
    )
    if unchecked:
        axes.set_title(f"{unchecked} not drawn: the fit follows these values exactly", fontsize=8)
