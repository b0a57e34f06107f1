"""``pincal workspace``: poses for selection, and workspaces of every kind on grids or samples."""

from __future__ import annotations

from contextlib import AbstractContextManager
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated

import typer

from pincal.cli.app import (
    Force,
    Mech,
    Seed,
    answer,
    command,
    counting,
    output_option,
    remark,
    stdout,
    working,
    wrote,
)
from pincal.errors import WorkspaceError
from pincal.files.measurement_writing import write_plan
from pincal.files.mechanism_folders import load_mechanism
from pincal.files.output import refuse_existing, writing_together
from pincal.files.table import write_table
from pincal.model.mechanism import Mechanism
from pincal.model.units import WRITTEN
from pincal.show.workspace_answers import (
    articular_answer,
    articular_columns,
    orientation_name,
    poses_answer,
    region_answer,
)
from pincal.workspace.axes import Axis, Orientations
from pincal.workspace.box import closer_grid, default_grid, default_samples
from pincal.workspace.criteria import Margins, articular_space, articular_symmetry, refuse_readings
from pincal.workspace.inscribed import largest_inscribed
from pincal.workspace.positions import POSITION_AXES, Positions
from pincal.workspace.region import KINDS, Workspace, compute_workspace
from pincal.workspace.sampling import sample_configurations, sample_workspace

_COUNT = 30_000
_OF_REGIONS = ("samples", "no_symmetry", "connected", "inscribed", "jobs", "scheduler")


@dataclass(frozen=True)
class WorkspaceOptions:
    """What is looked for, and how."""

    kind: Annotated[
        str, typer.Option(help=f"What to find: poses, {', '.join(KINDS)} or articular.")
    ] = "poses"
    axis: Annotated[
        list[str] | None,
        typer.Option(
            "--axis",
            metavar="AXIS",
            help="Axis of the grid, as often as needed: 'x [mm]=-500:500:10' (low:high:step), "
            "'z=1.8', 'phi [deg]=0,20,40'. Positions: x, y or radius, bearing; z. Orientations: "
            "phi; azimuth, tilt, torsion; rx, ry, rz; yaw, pitch, roll. "
            "Those not given: what the legs reach.",
        ),
    ] = None
    count: Annotated[
        int | None, typer.Option(min=1, help="Number of poses (poses, articular) [default: 30000].")
    ] = None
    samples: Annotated[
        int | None, typer.Option(min=1, help="Ask at random positions instead of on a grid.")
    ] = None
    seed: Seed = 0
    margin_type1: Annotated[
        float | None,
        typer.Option(
            help="Least distance from type-1 singularities, a dyad's elbow sine [default: 0.23]."
        ),
    ] = None
    margin_type2: Annotated[
        float | None,
        typer.Option(
            help="Least distance from type-2 singularities [default: 0.2, at most half of home's]."
        ),
    ] = None
    no_margins: Annotated[
        bool, typer.Option("--no-margins", help="Only reach and joint limits count.")
    ] = False
    no_symmetry: Annotated[
        bool, typer.Option("--no-symmetry", help="Compute all, not a fundamental domain.")
    ] = False
    connected: Annotated[
        bool,
        typer.Option(
            "--connected",
            help="Keep what hangs together, by position, with the part nearest to home.",
        ),
    ] = False
    inscribed: Annotated[
        bool, typer.Option("--inscribed", help="Find the largest circle or ball inside.")
    ] = False
    picture: Annotated[
        Path | None, typer.Option(metavar="FILE.svg|png|pdf", help="Draw the workspace.")
    ] = None
    jobs: Annotated[int, typer.Option(max=1024, help="Processes; -1 for one a core.")] = 1
    scheduler: Annotated[
        str | None, typer.Option(metavar="tcp://HOST:PORT", help="Run on a Dask cluster.")
    ] = None

    def check(self) -> None:
        """Raise if options do not go together.

        Raises:
            WorkspaceError: an unknown kind; samples, of which neighbours are asked.
            BadParameter: options that a kind of workspace does not have, or that contradict.
        """
        kind, regions = self.kind, self.kind in KINDS
        if not regions and kind not in ("poses", "articular"):
            raise WorkspaceError(
                f"--kind {kind}: unknown; expected poses, {', '.join(KINDS)} or articular"
            )
        strange = ["count"] if regions else list(_OF_REGIONS)
        strange += ["axis", "picture"] if kind == "poses" else []
        given = [one for one in fields(self) if getattr(self, one.name) not in (one.default, [])]
        wrong = [f"--{one.name.replace('_', '-')}" for one in given if one.name in strange]
        if wrong:
            raise typer.BadParameter(f"{', '.join(wrong)}: not for --kind {kind}")
        if self.samples is not None and (self.connected or self.inscribed):
            raise WorkspaceError(
                "samples have no neighbours: --connected and --inscribed need a grid"
            )
        if self.no_margins and (self.margin_type1 is not None or self.margin_type2 is not None):
            raise typer.BadParameter("--no-margins leaves no margin to set; give one or the other")

    def refuse_existing(self, output: Path, *, force: bool) -> None:
        """Raise if files cannot be written, or the picture has another ending than pictures."""
        refuse_existing(output, force=force)
        if (picture := self.picture) is None:
            return
        refuse_existing(picture, force=force)
        if picture.suffix.lower() not in (".svg", ".png", ".pdf"):
            raise typer.BadParameter(f"--picture {picture}: expected a name in .svg, .png or .pdf")
        if picture.absolute() == output.absolute():
            raise typer.BadParameter(f"--picture {picture}: is the output too")

    def writing(self, output: Path, *, force: bool) -> AbstractContextManager[list[Path]]:
        """Write the table and, if one is wanted, the picture, together or not at all."""
        return writing_together(
            [(path, ()) for path in filter(None, (output, self.picture))], force=force
        )

    def wrote(self, output: Path) -> None:
        """Say which files were written."""
        for path in filter(None, (output, self.picture)):
            wrote(path)

    def margins(self) -> Margins:
        """Return the margins that are kept."""
        type1 = Margins().type1 if self.margin_type1 is None else self.margin_type1
        return Margins.none() if self.no_margins else Margins(type1, self.margin_type2)

    def axes(self) -> tuple[list[Axis], list[Axis]]:
        """Return the axes of positions, and those of orientations."""
        axes = [Axis.parse(text) for text in self.axis or ()]
        places = [one for one in axes if one.name in POSITION_AXES]
        return places, [one for one in axes if one not in places]


@command(answers=True)
def workspace(
    mech: Mech,
    output: Annotated[Path, output_option("OUTPUT.csv", "Poses or positions that count.")],
    how: WorkspaceOptions,
    force: Force = False,
) -> None:
    """Find a workspace: poses to choose from, or positions.

    poses (default): --count poses spread over the workspace, candidates for 'pincal select',
    that every leg reaches in its working mode, within joint limits and margins from
    singularities, and that are connected to home.

    reachable, constant-orientation, total-orientation, dexterous: positions reached in
    any orientation, in the one given, in every one given, in every one there is, one by one.

    articular: poses and sensor readings over the workspace, with the check that permuted
    readings are reached too; --axis phi=0,0.4,0.6 adds workspaces of constant orientation.

    Not given, axes hold what the legs reach, drawn close around what counts.
    """
    how.check()
    mechanism = load_mechanism(mech)
    if how.kind != "poses":
        refuse_readings(mechanism)
    how.refuse_existing(output, force=force)
    find = {"poses": _poses, "articular": _articular}.get(how.kind, _region)
    find(mechanism, output, how, force)


def _poses(mechanism: Mechanism, output: Path, how: WorkspaceOptions, force: bool) -> None:
    """Write poses spread over the workspace."""
    least = how.margins()
    with counting("sampling the workspace", (how.count or _COUNT)) as done:
        plan = sample_configurations(mechanism, (how.count or _COUNT), how.seed, least, done)
    poses = plan.poses
    write_plan(plan, output, mechanism, units=WRITTEN, force=force)
    platform = mechanism.platform
    box = zip(
        platform.coordinates, poses.min(axis=0), poses.max(axis=0), platform.units, strict=True
    )
    ranges = ", ".join(f"{n} {a:.3f} to {b:.3f} {u}" for n, a, b, u in box)
    remark(f"{len(poses)} poses, {ranges}")
    wrote(output)
    answer(poses_answer(mechanism, poses))


def _region(mechanism: Mechanism, output: Path, how: WorkspaceOptions, force: bool) -> None:
    """Write the positions of a workspace."""
    least, (places, turns) = how.margins(), how.axes()
    if how.samples is not None and places:
        raise WorkspaceError(
            f"--samples come from all that the legs reach, not on --axis {places[0].name}"
        )
    orientations = Orientations.of(mechanism.platform, *turns) if turns else None

    def compute(positions: Positions, text: str) -> Workspace:
        with counting(text, positions.size) as done:
            return compute_workspace(
                mechanism,
                how.kind,
                positions,
                orientations,
                least,
                symmetry=not how.no_symmetry,
                connected=how.connected,
                jobs=how.jobs,
                scheduler=how.scheduler,
                progress=done,
            )

    if how.samples is not None:
        positions: Positions = default_samples(mechanism, how.samples, how.seed)
        found = compute(positions, f"{how.kind} workspace")
    else:
        found = compute(default_grid(mechanism, places), f"{how.kind} workspace")
        closer = closer_grid(found, [one.name for one in places])
        if closer is not None:
            found = compute(closer, "closer around what counts")
    _report(found, output, how, force)


def _report(found: Workspace, output: Path, how: WorkspaceOptions, force: bool) -> None:
    """Write the positions and the picture of a workspace, and print what it is."""
    from pincal.show.pictures.files import save_figure
    from pincal.show.tables import workspace_table
    from pincal.show.workspace_plots import workspace_figure

    circle = None
    if how.inscribed and found.count:
        with working("looking for the largest circle or ball inside"):
            circle = largest_inscribed(found)
    with how.writing(output, force=force) as (table, *pictures):
        found.save(table)
        for picture in pictures:
            save_figure(workspace_figure(found, circle), picture)
    stdout.print(workspace_table(found, circle, wanted=how.inscribed))
    how.wrote(output)
    answer(region_answer(found, circle))


def _articular(mechanism: Mechanism, output: Path, how: WorkspaceOptions, force: bool) -> None:
    """Write poses and readings, over the whole workspace and at constant orientations."""
    from pincal.show.pictures.files import save_figure
    from pincal.show.tables import articular_table
    from pincal.show.workspace_plots import articular_figure

    least, (places, turns) = how.margins(), how.axes()
    if places and not turns:
        raise WorkspaceError("positions by --axis need orientations to ask there, such as phi=0.4")
    grid = default_grid(mechanism, places)
    single = Orientations.of(mechanism.platform, *turns).rotations if turns else []
    with counting("sampling the workspace", (how.count or _COUNT)) as done:
        spaces = {"all": sample_workspace(mechanism, (how.count or _COUNT), how.seed, least, done)}
    for rotation in single:
        orientation = Orientations.from_rotations(rotation)
        found = compute_workspace(mechanism, "constant-orientation", grid, orientation, least)
        spaces[orientation_name(mechanism, orientation)] = found.poses()
    readings = {name: articular_space(mechanism, poses) for name, poses in spaces.items()}
    with working("solving the forward kinematics of permuted readings"):
        checks = articular_symmetry(mechanism, spaces["all"][:2000], least)
    table = articular_table(mechanism, readings, checks)
    with how.writing(output, force=force) as (written, *pictures):
        write_table(written, articular_columns(mechanism, spaces, readings))
        for picture in pictures:
            save_figure(articular_figure(mechanism, readings), picture)
    stdout.print(table)
    how.wrote(output)
    answer(articular_answer(mechanism, readings, checks))
