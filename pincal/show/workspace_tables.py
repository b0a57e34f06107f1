"""Tables of workspaces: how large, how symmetric, and the space of their readings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from rich.console import Group
from rich.markup import escape
from rich.table import Table

from pincal.model.mechanism import Mechanism
from pincal.show.tables import plain_table, titled
from pincal.workspace.articular import ArticularSymmetry
from pincal.workspace.inscribed import Inscribed
from pincal.workspace.positions import Grid
from pincal.workspace.region import Workspace


def workspace_table(
    workspace: Workspace, inscribed: Inscribed | None = None, *, wanted: bool = False
) -> Group:
    """Return what a workspace is: how large, in how many orientations, by which symmetry.

    Args:
        workspace: The workspace.
        inscribed: Its largest circle or ball.
        wanted: Whether one was looked for.
    """
    asked, test = workspace.asked, workspace.test
    name, unit = {1: ("length", "m"), 2: ("area", "m²"), 3: ("volume", "m³")}[asked.dimension or 1]
    table = Table(box=None, show_header=False, padding=(0, 2, 0, 0))
    how = "at most: half a cell along the edge" if isinstance(asked, Grid) else "95 %"
    table.add_row(name, f"{workspace.measure:.5g} ± {workspace.uncertainty:.2g} {unit} ({how})")
    apart = f"; {workspace.apart:,} of them apart from home's" if workspace.apart else ""
    table.add_row("positions", f"{workspace.count:,} of {asked.size:,} count{apart}")
    every = "in every one of" if test.every else "in any of"
    table.add_row("orientations", f"{every} {len(test.orientations):,}")
    least = test.least
    type2 = least.least_type2(test.mechanism)
    sides = "both sides of type 2" if type2 == -np.inf else f"type 2 ≥ {type2:.3g}"
    text = f"type 1 ≥ {least.type1:.3g}, {sides}"
    table.add_row("margins", text)
    table.add_row("symmetry", _by_symmetry(workspace))
    if workspace.cut:
        table.add_row("", "cut off by the edge of the grid: widen the axes to see the whole")
    if inscribed is None and wanted:
        table.add_row("largest inscribed", "none: no position counts")
    if inscribed:
        kept = len(asked.axes) if isinstance(asked, Grid) else 3
        centre = ", ".join(f"{v + 0.0:.4f}" for v in inscribed.centre[:kept].round(6))
        body = "ball" if asked.dimension == 3 else "circle"
        loose = inscribed.bound > 1.001 * inscribed.radius
        touches = f"; none is larger than {inscribed.bound:.4f} m" if loose else ""
        touches += "; it touches the edge of the grid" if inscribed.at_edge else ""
        table.add_row(
            f"largest {body}", f"radius {inscribed.radius:.4f} m around ({centre}) m{touches}"
        )
    return titled(f"{test.mechanism.name}: {workspace.kind} workspace", table)


def _by_symmetry(workspace: Workspace) -> str:
    """Return which elements were used, and which were not."""
    used = ", ".join(str(e) for e in workspace.elements)
    text = f"{workspace.computed:,} positions computed"
    if len(workspace.elements) > 1:
        text += f", the others by {len(workspace.elements)} elements: {used}"
    if workspace.unused:
        left = ", ".join(str(e) for e in workspace.unused)
        text += f"; not used, or not a symmetry of these positions and orientations: {left}"
    return text


def articular_table(
    mechanism: Mechanism,
    spaces: Mapping[str, NDArray[np.float64]],
    checks: Sequence[ArticularSymmetry],
) -> Group:
    """Return the extent of spaces of readings, and whether permuted readings are reached."""
    table = plain_table()
    for name in ("space", "poses", "leg", "from", "to"):
        numeric = name in ("poses", "from", "to")
        table.add_column(name, justify="right" if numeric else "left", no_wrap=True)
    for name, readings in spaces.items():
        heads = [name, f"{len(readings):,}"]
        read = zip(mechanism.reading_names, mechanism.reading_units, readings.T, strict=True)
        for reading, unit, column in read:
            low, high = (column.min(), column.max()) if len(column) else (np.nan, np.nan)
            ends = [f"{low:.3f}", escape(f"{high:.3f} [{unit}]")]
            table.add_row(*heads, reading, *ends)
            heads = ["", ""]
    lines = [
        f"{check.element}: {check.solved} of {check.asked} permuted readings solved, "
        f"{check.inside} in the workspace, at most {check.off:.2g} from the carried pose"
        for check in checks
    ]
    return titled(
        f"{mechanism.name}: articular-variables space",
        table,
        "\n".join(lines or ["no symmetry but the identity"]),
    )
