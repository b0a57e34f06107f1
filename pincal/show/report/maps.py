"""Maps of the platform's error over the workspace, for colour, black and white, and paper."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from pincal.show.pictures.svg import on_page
from pincal.show.plots import draw_map
from pincal.show.style import HEIGHT, WIDTH
from pincal.show.workspace_errors import ErrorMaps


@on_page("figure-maps")
def maps_figure(maps: ErrorMaps, turns: bool) -> tuple[Figure, str]:
    """Return the platform's errors over x and y, before and after (3-RRR paper, Figs. 6, 11).

    Args:
        maps: The errors.
        turns: Whether the platform has an orientation.
    """
    quantities = ((0, "position", "mm"), (1, "orientation", "mrad"))[: 1 + turns]
    rows = [
        (f"{what} {when}", unit, 1e3 * values[..., column])
        for column, what, unit in quantities
        for when, values in (("before", maps.before), ("after, expected", maps.after))
    ]
    spatial = len(maps.heights) > 1
    across = len(maps.heights) if spatial else 2
    down = len(rows) * len(maps.heights) // across
    panel = 0.8 * WIDTH / across * float(np.ptp(maps.y) / np.ptp(maps.x))
    drawn = Figure(figsize=(WIDTH, min(down * (panel + 0.5), HEIGHT)), layout="constrained")
    panels = iter(drawn.subplots(down, across, sharex=True, sharey=True).ravel())
    for title, unit, values in rows:
        own = [next(panels) for _ in maps.heights]
        limits = float(np.nanmin(values)), float(np.nanmax(values))
        for axes, error, height in zip(own, values, maps.heights, strict=True):
            draw_map(axes, (maps.x, maps.y), error, limits)
            axes.set_title("" if height is None else f"z = {height:.3g} m")
        own[0].set_title("\n".join((title, own[0].get_title())) if spatial else title)
        drawn.colorbar(own[0].images[0], ax=own if spatial else own[0], label=unit)
    drawn.supxlabel("x [m]", size=8)
    drawn.supylabel("y [m]", size=8)
    where = "the workspace at home orientation" if turns else "the workspace"
    return drawn, (
        f"Error of the platform over {where}: how far the nominal model is off, and what is "
        "to be expected of the calibrated one (standard error). Scales differ; white: not in "
        "the workspace."
    )
