"""Plots of results, mechanisms and poses, drawn into matplotlib axes, for paper and screen.

Legs differ in colour and in marker or hatch, so that plots read in black and white and in
colour-blindness.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pincal.calibration.result import CalibrationResult
from pincal.errors import WorkspaceError
from pincal.show.pictures import charts, residual_charts
from pincal.show.pictures import charts as image_charts
from pincal.show.pictures.parts import draw_bars, draw_map, room, wrapped
from pincal.show.result_tables import parameters
from pincal.show.style import PAGE
from pincal.show.workspace_answers import error_maps
from pincal.words import plots as words
from pincal.words.numbers import per_si


@dataclass(frozen=True)
class Plots:
    """Plots of a result, as ``result.plot``: each returns its axes, those given or new ones."""

    result: CalibrationResult

    def residuals(self, ax: Axes | None = None) -> Axes:
        """Draw residuals after the calibration in standard deviations, against the row.

        Those of the legs or, if their readings are exact, of the platform as measured. A residual's
        standard deviation is that of its noise less what the fit takes up of it, σ√(1−h) of its
        leverage h: one that shares what is missed with others is judged as hard as any. Dashed
        lines: between which 95 of 100 are. Rows that were rejected are named.
        """
        return residual_charts.over_rows(_axes_of(ax, 6.4, 3.6), self.result)

    def parameters(self, ax: Axes | None = None) -> Axes:
        """Draw the change of each parameter from nominal over its 95 % half width.

        Bars longer than 1 are changes that the measurements show; fixed ones have none.
        """
        values: dict[str, dict[str, float]] = {leg.name: {} for leg in self.result.legs}
        for leg, p in parameters(self.result):
            if 0.0 < p.std < np.inf:
                values[leg.name][p.name] = p.change / p.half
        axes = draw_bars(_axes_of(ax, 6.4, 3.6), values)
        residual_charts.levels(axes, 1.0, "±")
        axes.set_ylabel(wrapped(words.CHANGE, room(axes)[1]))
        return axes

    def error_map(self, ax: Axes | None = None) -> Axes:
        """Draw the expected error of the calibrated platform's position over x and y.

        The other coordinates are as at home; in space, z is in the middle of the workspace.

        Raises:
            MeasurementError: residuals are so large that no accuracy can be promised.
            WorkspaceError: no workspace was found with the default margins.
        """
        name = self.result.nominal.name
        charts.refuse_unexplained(self.result)
        if (maps := error_maps(self.result)) is None:
            raise WorkspaceError(words.no_map(name, by_readings=self.result.nominal.by_readings))
        axes, middle = _axes_of(ax, 5.0, 4.2), len(maps.heights) // 2
        image = draw_map(axes, (maps.x, maps.y), per_si("m") * maps.after[middle, ..., 0])
        axes.figure.colorbar(image, ax=axes, label=wrapped(words.EXPECTED, room(axes)[1]))
        height = maps.heights[middle]
        axes.set(xlabel=words.along("x"), ylabel=words.along("y"), title=words.height(height))
        return axes

    def correlation(self, ax: Axes | None = None) -> Axes:
        """Draw the correlations of all parameters that were identified."""
        axes, covariance = _axes_of(ax, 5.4, 4.8), self.result.covariance
        std = np.sqrt(np.diagonal(covariance))
        free = np.flatnonzero(np.isfinite(std) & (std > 0.0))
        rho = covariance[np.ix_(free, free)] / np.outer(std[free], std[free])
        image = axes.imshow(rho, vmin=-1.0, vmax=1.0, cmap="RdBu_r")
        axes.figure.colorbar(image, ax=axes, label=words.CORRELATION)
        ids = [p.id for _, p in parameters(self.result)]
        places, names = list(range(len(free))), [ids[i] for i in free]
        fit = int(min(room(axes)) / PAGE.line_small)  # letters stay large
        if len(free) > fit and len(self.result.legs) > 1:  # legs alone
            begin = [i for i in places if i == 0 or _owner(names[i]) != _owner(names[i - 1])]
            places, names = begin, [_owner(names[i]) for i in begin]
        elif len(free) > fit:
            step = -(-len(free) // fit)
            places, names = places[::step], names[::step]
        axes.set_xticks(places, names, rotation=90, fontsize=7)
        axes.set_yticks(places, names, fontsize=7)
        return axes

    def workspace(self, ax: Axes | None = None) -> Axes:
        """Draw each row's largest residual where it was measured; outliers are ringed."""
        return residual_charts.over_workspace(_axes_of(ax, 5.0, 4.2), self.result)

    def time(self, ax: Axes | None = None) -> Axes:
        """Draw means of residuals over the run, by tenths of the rows: what drifts leaves ±2."""
        return residual_charts.over_time(_axes_of(ax, 6.4, 3.6), self.result)

    def images(self, ax: Axes | None = None) -> Axes:
        """Draw residuals as arrows over the images of cameras, magnified, with their scale.

        Of instruments with an ``image`` (``pincal.Image``), side by side: from each point as seen
        towards where it is predicted, coloured by the residual over its standard deviation.

        Raises:
            MeasurementError: no camera measured.
        """
        return image_charts.over_images(_axes_of(ax, 6.4, 3.6), self.result)

    def singular(self, ax: Axes | None = None) -> Axes:
        """Draw singular values of the identification Jacobian, and name the weakest direction."""
        return charts.singular_values(_axes_of(ax, 6.4, 3.6), self.result)

    def poses(self, ax: Axes | None = None) -> Axes:
        """Draw the expected error after the first n rows, and the bound of any n of them.

        Raises:
            MeasurementError: noise differs between rows, or parameters are undetermined.
            WorkspaceError: no workspace was found.
        """
        return charts.by_poses(_axes_of(ax, 6.4, 3.6), self.result)

    def convergence(self, ax: Axes | None = None) -> Axes:
        """Draw what was minimised, step by step, in standard deviations.

        Raises:
            MeasurementError: a result that was saved before steps were kept.
        """
        return charts.step_by_step(_axes_of(ax, 6.4, 3.6), self.result)

    def platform(self, ax: Axes | None = None) -> Axes:
        """Draw by how much each parameter's change moves the platform over the workspace.

        Raises:
            WorkspaceError: no workspace was found.
        """
        return charts.at_platform(_axes_of(ax, 6.4, 4.6), self.result)

    def runs(self, ax: Axes | None = None) -> Axes:
        """Draw the parameters of each run less their mean, in standard errors.

        Raises:
            MeasurementError: runs were not compared.
        """
        return charts.runs_compared(_axes_of(ax, 6.4, 4.0), self.result)

    def bed(self, ax: Axes | None = None) -> Axes:
        """Draw by how much the nominal model misses z over the bed of a printer.

        Raises:
            WorkspaceError: a machine without x, y and z, or no workspace at home's height.
        """
        x, y, heights = charts.bed_heights(self.result)
        axes, off = _axes_of(ax, 5.0, 4.2), per_si("m") * heights
        most = float(np.nanmax(np.abs(off)))
        image = draw_map(axes, (x, y), off, (-most, most))
        image.set_cmap("RdBu_r")
        axes.figure.colorbar(image, ax=axes, label=wrapped(words.BED, room(axes)[1]))
        axes.set(xlabel=words.along("x"), ylabel=words.along("y"))
        return axes

    def drawing(self, ax: Axes | None = None, leg: str = "") -> Axes:
        """Draw a leg with its dimensions, lines in the colours of changes over their ±.

        Without axes a page of A4 (``axes.figure``), with the values of all legs like it beneath.

        Args:
            ax: Where to draw.
            leg: Name of the leg, the first if not given.

        Raises:
            MechanismError: no such leg.
        """
        from pincal.show.pictures.sheet import draw_dimensioned, sheet

        if ax is None:
            drawn: Axes = sheet(self.result, leg).axes[0]
            return drawn
        name = self.result.nominal.leg(leg or self.result.nominal.leg_names[0]).name
        return draw_dimensioned(ax, self.result, name)


def _axes_of(ax: Axes | None, width: float, height: float) -> Axes:
    """Return axes to draw into, of a new figure if none are given, [inch]."""
    return ax or Figure(figsize=(width, height), layout="compressed").subplots()


def _owner(identity: str) -> str:
    """Return whose a parameter is, of its id."""
    return identity.rpartition(".")[0]
