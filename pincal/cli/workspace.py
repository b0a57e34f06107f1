"""``pincal workspace``: poses for selection, and workspaces of every kind on grids or samples."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from pincal.cli.app import (
    Count,
    Force,
    Mech,
    Seed,
    app,
    counting,
    output_option,
    stderr,
    stdout,
    working,
    wrote,
)
from pincal.errors import WorkspaceError
from pincal.model.files import load_mechanism
from pincal.model.measurements import Plan, write_poses
from pincal.model.mechanism import Mechanism
from pincal.model.output import refuse_existing, writing
from pincal.model.table import write_table
from pincal.workspace.articular import articular_space, articular_symmetry
from pincal.workspace.axes import Axis
from pincal.workspace.box import default_grid, default_samples
from pincal.workspace.criteria import Margins
from pincal.workspace.inscribed import largest_inscribed
from pincal.workspace.orientations import Orientations
from pincal.workspace.positions import Grid, Positions
from pincal.workspace.region import KINDS, Workspace, compute_workspace
from pincal.workspace.sampling import sample_workspace

_POSITION_AXES = ("x", "y", "z", "radius", "bearing")
_WRITTEN = 1_000_000  # positions looked at at a time

Kind = Annotated[str, typer.Option(help=f"What to find: poses, {', '.join(KINDS)} or articular.")]
AxisTexts = Annotated[
    list[str] | None,
    typer.Option(
        "--axis",
        metavar="AXIS",
        help="Axis of the grid, as often as needed: 'x [mm]=-500:500:10' (low:high:step), "
        "'z=1.8', 'phi [deg]=0,20,40'. Positions: x, y or radius, bearing; z. Orientations: "
        "phi; azimuth, tilt, torsion; rx, ry, rz; yaw, pitch, roll. Those not given: within reach.",
    ),
]
MarginType1 = Annotated[
    float, typer.Option(help="Least distance from type-1 singularities; a dyad's elbow sine.")
]
MarginType2 = Annotated[
    float | None,
    typer.Option(
        help="Least distance from type-2 singularities [default: 0.2, at most half of home's]."
    ),
]


@app.command()
def workspace(
    mech: Mech,
    output: Annotated[Path, output_option("OUTPUT.csv", "Poses or positions that count.")],
    kind: Kind = "poses",
    axis: AxisTexts = None,
    count: Count = 30_000,
    samples: Annotated[
        int | None, typer.Option(min=1, help="Ask at random positions instead of on a grid.")
    ] = None,
    seed: Seed = 0,
    margin_type1: MarginType1 = 0.23,
    margin_type2: MarginType2 = None,
    no_margins: Annotated[
        bool, typer.Option("--no-margins", help="Only reach and joint limits count.")
    ] = False,
    no_symmetry: Annotated[
        bool, typer.Option("--no-symmetry", help="Compute all, not a fundamental domain.")
    ] = False,
    connected: Annotated[
        bool, typer.Option("--connected", help="Keep what hangs together with home's part.")
    ] = False,
    inscribed: Annotated[
        bool, typer.Option("--inscribed", help="Find the largest circle or ball inside.")
    ] = False,
    picture: Annotated[
        Path | None, typer.Option(metavar="FILE.svg|png|pdf", help="Draw the workspace.")
    ] = None,
    jobs: Annotated[int, typer.Option(help="Processes; -1 for one a core.")] = 1,
    scheduler: Annotated[
        str | None, typer.Option(metavar="tcp://HOST:PORT", help="Run on a Dask cluster.")
    ] = None,
    force: Force = False,
) -> None:
    """Find a workspace: poses to choose from, or the positions that count.

    poses (default): --count poses spread over the workspace, candidates for 'pincal select',
    that every leg reaches in its working mode, within joint limits and margins from
    singularities, and that are connected to home.

    reachable, constant-orientation, total-orientation, dexterous: positions reached in
    any orientation, in the one given, in every one given, in every one there is, one by one.

    articular: poses and sensor readings over the workspace, with the check that permuted
    readings are reached too; --axis phi=0,0.4,0.6 adds workspaces of constant orientation.
    """
    mechanism = load_mechanism(mech)
    for path in (output, picture):
        if path is not None:
            refuse_existing(path, force=force)
    if picture is not None and picture.suffix.lower() not in (".svg", ".png", ".pdf"):
        raise typer.BadParameter(f"--picture {picture}: expected a name in .svg, .png or .pdf")
    least = Margins.none() if no_margins else Margins(margin_type1, margin_type2)
    axes = [Axis.parse(text) for text in axis or ()]
    if kind == "poses":
        if axes or picture or inscribed or samples:
            raise typer.BadParameter("--axis, --samples, --inscribed, --picture need a --kind")
        _poses(mechanism, output, count, seed, least, force)
    elif kind == "articular":
        _articular(mechanism, output, axes, count, seed, least, picture, force)
    else:
        if kind not in KINDS:
            raise WorkspaceError(
                f"--kind {kind}: unknown; expected poses, {', '.join(KINDS)} or articular"
            )
        positions: Positions
        if samples is None:
            positions = default_grid(mechanism, [a for a in axes if a.name in _POSITION_AXES])
        else:
            positions = default_samples(mechanism, samples, seed)
        turns = [a for a in axes if a.name not in _POSITION_AXES]
        orientations = Orientations.of(mechanism.platform, turns) if turns else None
        with counting(f"{kind} workspace", positions.size) as done:
            found = compute_workspace(
                mechanism,
                kind,
                positions,
                orientations,
                least,
                symmetry=not no_symmetry,
                connected=connected,
                jobs=jobs,
                scheduler=scheduler,
                progress=done,
            )
        _report(found, output, inscribed, picture, force)


def _poses(
    mechanism: Mechanism, output: Path, count: int, seed: int, least: Margins, force: bool
) -> None:
    """Write poses spread over the workspace."""
    with counting("sampling the workspace", count) as done:
        poses = sample_workspace(mechanism, count, seed, least, done)
    write_poses(output, mechanism, Plan(poses), force=force)
    box = zip(mechanism.platform.coordinates, poses.min(axis=0), poses.max(axis=0), strict=True)
    stderr.print(f"{count} poses, {', '.join(f'{n} {a:.3f} to {b:.3f}' for n, a, b in box)}")
    wrote(output)


def _report(
    found: Workspace, output: Path, inscribed: bool, picture: Path | None, force: bool
) -> None:
    """Write the positions and the picture of a workspace, and print what it is."""
    from pincal.show.workspace_tables import workspace_table

    circle = None
    if inscribed:
        with working("looking for the largest circle or ball inside"):
            circle = largest_inscribed(found)
    names = ("x", "y", "z")[: found.test.mechanism.platform.units.count("m")]
    columns = {f"{name} [m]": _column(found, place) for place, name in enumerate(names)}
    write_table(output, columns, force=force)
    stdout.print(workspace_table(found, circle))
    wrote(output)
    if picture is not None:
        from pincal.show.workspace_plots import workspace_figure

        with writing(picture, force=force) as scratch:
            figure = workspace_figure(found, circle)
            figure.savefig(scratch, format=picture.suffix[1:].lower(), dpi=150)
        wrote(picture)


def _column(found: Workspace, place: int) -> Iterator[float]:
    """Yield one coordinate of the positions that count, a bounded number at a time."""
    for begin in range(0, len(found.inside), _WRITTEN):
        index = begin + np.flatnonzero(found.inside[begin : begin + _WRITTEN])
        yield from found.asked.at(index)[:, place].tolist()


def _articular(
    mechanism: Mechanism,
    output: Path,
    axes: list[Axis],
    count: int,
    seed: int,
    least: Margins,
    picture: Path | None,
    force: bool,
) -> None:
    """Write poses and readings, over the whole workspace and at constant orientations."""
    from pincal.show.workspace_tables import articular_table

    with counting("sampling the workspace", count) as done:
        spaces = {"all": sample_workspace(mechanism, count, seed, least, done)}
    turns = [a for a in axes if a.name not in _POSITION_AXES]
    grid = default_grid(mechanism, [a for a in axes if a.name in _POSITION_AXES])
    for turn in turns:
        for value in turn.values:
            spaces[f"{turn.name} = {value:.6g} rad"] = _constant(
                mechanism, grid, Axis(turn.name, np.array([value])), least
            )
    readings = {name: articular_space(mechanism, poses) for name, poses in spaces.items()}
    platform = mechanism.platform
    poses = np.concatenate(list(spaces.values()))
    columns: dict[str, list[str] | list[float]] = {
        "space": [name for name, poses in spaces.items() for _ in poses]
    }
    for place, name in enumerate(platform.coordinates):
        columns[f"{name} [{platform.units[place]}]"] = poses[:, place].tolist()
    values = np.concatenate(list(readings.values()))
    for place, leg in enumerate(mechanism.legs):
        columns[f"{leg.name} [{leg.reading_unit}]"] = values[:, place].tolist()
    with working("solving the forward kinematics of permuted readings"):
        checks = articular_symmetry(mechanism, spaces["all"][:2000], least)
    write_table(output, columns, force=force)
    stdout.print(articular_table(mechanism, readings, checks))
    wrote(output)
    if picture is not None:
        from pincal.show.workspace_plots import articular_figure

        with writing(picture, force=force) as scratch:
            figure = articular_figure(mechanism, readings)
            figure.savefig(scratch, format=picture.suffix[1:].lower(), dpi=150)
        wrote(picture)


def _constant(mechanism: Mechanism, grid: Grid, turn: Axis, least: Margins) -> np.ndarray:
    """Return the poses of a constant orientation workspace, coordinates of shape (N, dof)."""
    orientation = Orientations.of(mechanism.platform, [turn])
    found = compute_workspace(mechanism, "constant-orientation", grid, orientation, least)
    matrices = np.broadcast_to(np.eye(4), (found.count, 4, 4)).copy()
    matrices[:, :3, :3] = orientation.rotations.as_matrix()[0]
    matrices[:, :3, 3] = found.positions
    return mechanism.platform.from_matrices(matrices)
