"""``pincal workspace``: poses for selection, and workspaces of every kind on grids."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

import pincal
from pincal import Grid, Margins, Mechanism, Orientations, Workspace, WorkspaceError
from pincal.cli.app import command, remark, stdout, working, wrote
from pincal.cli.options import FORCE, SEED, Mech, output_option, refuse_options
from pincal.files.columns import columns_of
from pincal.files.output import refuse_existing
from pincal.files.table import write_table
from pincal.option import option
from pincal.show.tables import workspace_table
from pincal.words.numbers import WRITTEN
from pincal.workspace.criteria import refuse_readings
from pincal.workspace.grid import POSITION_AXES, Axis, closer_grid, default_grid
from pincal.workspace.region import KINDS

#: Options that only regions have; only samples of poses have a number of poses.
_OF_REGIONS = ("axis", "symmetry", "connected")


@dataclass(frozen=True)
class WorkspaceOptions:
    """Options of a workspace."""

    kind: str = option("poses", f"What to find: poses or {', '.join(KINDS)}.")
    axis: tuple[str, ...] = option(
        (),
        "Axis of the grid, as often as needed: 'x [mm]=-500:500:10' (low:high:step), 'z=1.8', "
        "'phi [deg]=0,20,40'. Positions: x, y or radius, bearing; z. Orientations: phi; azimuth, "
        "tilt, torsion; rx, ry, rz; yaw, pitch, roll. Other axes span what the legs reach.",
        metavar="AXIS",
    )
    count: int = option(30_000, "Number of poses.", least=1)
    seed: int = option(0, SEED)
    margins: bool = option(
        True, "Ignore margins from singularities: only reach and joint limits count."
    )
    symmetry: bool = option(True, "Compute every position instead of a fundamental domain.")
    connected: bool = option(False, "Keep only the connected part nearest to home.")
    force: bool = option(False, FORCE)


@command
def workspace(
    mech: Mech,
    output: Annotated[Path, output_option("OUTPUT.csv", "Poses or positions in the workspace.")],
    options: WorkspaceOptions,
    margins: Margins,
) -> None:
    """Compute a workspace: poses to choose from, or positions.

    poses (default): --count poses spread over the workspace, candidates for 'pincal select',
    that every leg reaches in its working mode, within joint limits and margins from
    singularities, and that are connected to home.

    reachable, constant-orientation, total-orientation, dexterous: positions reached in any
    orientation, in the given one, in all given ones, and in all orientations, respectively.

    Axes that are not given span what the legs can reach.
    """
    if options.kind not in ("poses", *KINDS):
        raise WorkspaceError(f"--kind {options.kind}: unknown; expected poses, {', '.join(KINDS)}")
    foreign = _OF_REGIONS if options.kind == "poses" else ("count",)
    refuse_options(options, foreign, f"--kind {options.kind}")
    if not options.margins and margins != Margins():
        raise typer.BadParameter("--no-margins leaves no margin to set; give one or the other")
    refuse_existing(output, force=options.force)
    least = margins if options.margins else Margins.none()
    mechanism = pincal.load_mechanism(mech)
    if options.kind != "poses":
        refuse_readings(mechanism)
        _region(mechanism, output, options, least)
        return
    with working("sampling the workspace", options.count) as done:
        plan = pincal.sample_configurations(mechanism, options.count, options.seed, least, done)
    write_table(output, columns_of(mechanism, plan), units=WRITTEN, force=options.force)
    ends = zip(plan.poses.min(axis=0), plan.poses.max(axis=0), strict=True)
    coordinates = zip(mechanism.platform.coordinates, ends, mechanism.platform.units, strict=True)
    ranges = (f"{name} {low:.3f} to {high:.3f} {unit}" for name, (low, high), unit in coordinates)
    remark(f"{len(plan)} poses, {', '.join(ranges)}")
    wrote(output)


def _region(mechanism: Mechanism, output: Path, options: WorkspaceOptions, least: Margins) -> None:
    """Compute and write the positions of a workspace, and print its facts."""
    axes = [Axis.parse(text) for text in options.axis]
    places = [axis for axis in axes if axis.name in POSITION_AXES]
    turns = [axis for axis in axes if axis not in places]
    orientations = Orientations.of(mechanism.platform, *turns) if turns else None

    def compute(grid: Grid, text: str) -> Workspace:
        with working(text, grid.size) as done:
            return pincal.compute_workspace(
                mechanism,
                options.kind,
                grid,
                orientations,
                least,
                symmetry=options.symmetry,
                connected=options.connected,
                progress=done,
            )

    region = compute(default_grid(mechanism, places), f"{options.kind} workspace")
    closer = closer_grid(region.asked, region.inside, [axis.name for axis in places])
    if closer is not None:
        region = compute(closer, "finer grid around the workspace")
    region.save(output, force=options.force)
    stdout.print(workspace_table(region))
    wrote(output)
