"""``pincal workspace``, ``select``, ``identifiability``, ``simulate``: plans of measurements."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from socketserver import StreamRequestHandler, TCPServer
from typing import Annotated

import numpy as np
import typer

import pincal
from pincal.cli.app import command, remark, say, stdout, working, wrote
from pincal.cli.options import (
    FORCE,
    SEED,
    Force,
    Mech,
    PlanOptions,
    TableOptions,
    offered,
    output_option,
    refuse_options,
)
from pincal.design.planning import CONFIGURATIONS, PlanningOptions, sampled, with_reading_noise
from pincal.design.simulate import SimulatedMachine, Simulation
from pincal.errors import FileError, MeasurementError, WorkspaceError
from pincal.estimation.noise import check_noise
from pincal.files.columns import Columns, columns_of, reading_columns, sheet_columns
from pincal.files.further_tables import corners_of
from pincal.files.measurements import read_poses
from pincal.files.mechanism_folders import MECHANISM_FILES, write_mechanism
from pincal.files.output import refuse_existing, refuse_existing_of, writing_together
from pincal.files.table import write_table
from pincal.instruments.setup_file import read_setup
from pincal.kinematics.configurations import check_reached
from pincal.model import Measurements, Mechanism, Noise, Plan, Setup
from pincal.model.checks import listed
from pincal.option import Option, option
from pincal.show import explanation, tables
from pincal.words.numbers import WRITTEN, Units, amount
from pincal.workspace.criteria import Margins, Orientations, refuse_readings
from pincal.workspace.grid import POSITION_AXES, Axis, Grid, closer_grid, default_grid
from pincal.workspace.region import KINDS, Workspace

_FORECAST = 50  # number of poses without a plan


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
    foreign = ("axis",) if options.kind == "poses" else ("count",)
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
            kind, turned = options.kind, orientations
            return pincal.compute_workspace(mechanism, kind, grid, turned, least, done)

    region = compute(default_grid(mechanism, places), f"{options.kind} workspace")
    closer = closer_grid(region.asked, region.inside, [axis.name for axis in places])
    if closer is not None:
        region = compute(closer, "finer grid around the workspace")
    region.save(output, force=options.force)
    stdout.print(tables.workspace_table(region))
    wrote(output)


@dataclass(frozen=True)
class SelectOptions(TableOptions, PlanOptions, PlanningOptions):
    """Options on the choice of poses, and on output."""

    sheet: Path | None = option(
        None,
        "Also write a sheet to fill in, .xlsx or .csv: set points, and cells for measurements.",
        metavar="SHEET.xlsx",
    )
    force: bool = option(False, FORCE)


@command
def select(
    mech: Mech,
    output: Annotated[Path, output_option("PLAN.csv", "Poses to measure, with their sets.")],
    options: SelectOptions,
    noise: Noise,
    margins: Margins,
) -> None:
    """Choose the poses to measure.

    The efficiency printed is relative to a bound that no choice can exceed. Without --protocol:
    symmetric if the mechanism allows it, otherwise independent.

    If only part of the pose is measured (--measure), or in a tracker's own frame, COUNT poses are
    chosen for all parameters together, by the information that 'pincal calibrate' will draw from
    them; so are the configurations of serial arms, with the readings to drive to. With --goal
    platform they make the calibrated platform most accurate over the workspace, even if single
    parameters are less certain.

    Rows are in driving order: in rounds, each over a random share of every set by a short way.
    Between rounds the middle pose is repeated ('reference' in the column 'pose'), so that drift is
    seen and does not become an error of one leg. Columns 'planned_leg_1' … are set points of the
    drives, in --units (counts, steps: counts_per_unit of the sensors). --verify adds poses for
    verification (set 'verify'). --distances N plans N distances from each pose to others, instead
    of positions (columns 'distance_1_to' …).

    --box, --floor, --keep-out, --clearance and --margin-tension restrict the poses.
    """
    mechanism, setup = pincal.load_mechanism(mech), options.read_setup()
    units, sheet = options.written_in(mechanism), options.sheet
    outputs = [path for path in (output, sheet) if path is not None]
    refuse_existing_of([(path, ()) for path in outputs], force=options.force)
    measured = options.measured(mechanism, setup)
    with working("choosing poses") as progress:
        selection = pincal.select(
            mechanism,
            measured=None if setup.plain and options.measure in (None, "pose") else measured,
            setup=setup,
            noise=noise,
            margins=None if margins == Margins() else margins,
            progress=progress,
            **{field.name: getattr(options, field.name) for field in fields(PlanningOptions)},
        )
    plan = selection.plan
    columns: Columns = {"row": tuple(str(1 + row) for row in range(len(plan)))}
    columns |= columns_of(mechanism, plan)
    if plan.readings is None:
        readings = pincal.inverse(mechanism.at_reference, plan.poses).readings
        columns |= reading_columns(mechanism, readings, "planned_")
        plan = replace(plan, readings=readings)
    with writing_together([(path, ()) for path in outputs], force=options.force) as scratch:
        write_table(scratch[0], columns, units=units)
        if sheet is not None:
            measured = () if options.distances else measured
            write_table(scratch[1], sheet_columns(mechanism, plan, measured, setup, units))
    stdout.print(tables.selection_table(selection, mechanism.name))
    wrote(*outputs)


@command
def identifiability(
    mech: Mech,
    options: PlanOptions,
    noise: Noise,
    plan: Annotated[
        Path | None, typer.Argument(metavar="PLAN.csv", help="Poses to measure [50 at random].")
    ] = None,
    accuracy: Annotated[
        float | None,
        offered(
            "accuracy", Option("Required RMS position error over the workspace [m].", unit="m")
        ),
    ] = None,
) -> None:
    """Predict what measurements will determine.

    Prints the rank, undetermined parameters, the standard error of each parameter that 'pincal
    calibrate' will attain (the Cramér-Rao bound), and the platform error over the workspace; with
    --accuracy also the number of poses for it.

    Positions are of the platform's origin in the robot's base frame, unless --unknown-frame,
    --unknown-target or --setup are given.
    """
    mechanism, setup = pincal.load_mechanism(mech), options.read_setup()
    if plan is not None:
        poses = read_poses(plan, mechanism, setup=setup)
        setup = setup.of_rows(poses.contacts)
        check_reached(mechanism, poses, str(plan))
    measured = options.measured(mechanism, setup)
    with working("sampling the workspace"):
        workspace = pincal.sample_configurations(mechanism, 1000, options.seed)
        if plan is None:
            if setup.contacts:  # the same points as 'select' plans
                poses = sampled(mechanism, setup, CONFIGURATIONS, options.seed)
                poses = poses.rows(np.arange(len(poses)) < _FORECAST)
            else:
                poses = pincal.sample_configurations(mechanism, _FORECAST, options.seed + 1)
    expected = pincal.forecast(
        mechanism, poses, with_reading_noise(noise, mechanism), measured, setup
    )
    error = expected.platform_error(workspace)
    stdout.print(tables.standard_errors(expected))
    stdout.print(*explanation.forecast_lines(expected, error), sep="\n")
    if accuracy is not None:
        needed = expected.poses_for(accuracy, workspace)
        count = f"{needed:,.0f}" if np.isfinite(needed) else "no number of"
        noisy = ", too many to measure: reduce the noise" * (1e5 < needed < np.inf)
        stdout.print(f"for {amount(accuracy, 'm', 6)}: {count} poses like these{noisy}")


@dataclass(frozen=True)
class SimulateOptions(TableOptions):
    """Options of a simulated machine."""

    disturb: float | None = option(
        None,
        "Standard deviation of the errors of all parameters [m, rad or 1; default: 0.001 of the "
        "machine's size for lengths, 0.001 otherwise].",
    )
    seed: int = option(0, SEED)
    setup_file: Path | None = option(
        None, "Measurement setup: contacts, cameras.", name="setup", metavar="YAML"
    )
    truth: Path | None = option(
        None,
        "Folder for the true mechanism. If it exists, it is read, unless --disturb is given.",
        metavar="TRUE_MECH",
    )
    serve: int | None = option(
        None,
        "Simulate a machine on this local port, for 'pincal measure --tcp'; 0: a free port.",
        metavar="PORT",
        least=0,
        most=65535,
    )
    slips: float = option(0.0, "With --serve: share of rows off by 10 σ.", least=0, most=1)
    drift: float = option(0.0, "With --serve: drift along x from row to row [m].", unit="m")


def _true_mechanism(
    mechanism: Mechanism, options: SimulateOptions, rng: np.random.Generator
) -> tuple[Mechanism, bool]:
    """Return the true mechanism, and whether it is new rather than read from a folder.

    Raises:
        FileError: the folder has another machine.
    """
    truth = options.truth
    if truth is None or options.disturb is not None or not truth.is_dir():
        return pincal.disturb(mechanism, options.disturb, rng), True
    true_mechanism = pincal.load_mechanism(truth)
    kinds = [(m.leg_names, m.platform.kind) for m in (true_mechanism, mechanism)]
    if kinds[0] != kinds[1]:
        raise FileError(
            f"{truth} holds {true_mechanism.name!r}, whose legs or platform differ from those "
            f"of {mechanism.name!r}"
        )
    return true_mechanism, False


def _write_simulated(
    mechanism: Mechanism, setup: Setup, data: Measurements, paths: Sequence[Path], units: Units
) -> None:
    if setup.corners is not None:
        write_table(paths[1], corners_of(setup, data))
        extra = {name: x for name, x in data.extra.items() if name not in setup.pixels}
        data = replace(data, extra=extra)
    write_table(paths[0], columns_of(mechanism, data), units=units)


@command
def simulate(
    mech: Mech,
    options: SimulateOptions,
    noise: Noise,
    plan: Annotated[
        Path | None, typer.Argument(metavar="PLAN.csv", help="Poses to command.")
    ] = None,
    output: Annotated[
        Path | None, output_option("MEASUREMENTS.csv", "Measured poses and readings.")
    ] = None,
    force: Force = False,
) -> None:
    """Simulate measurements of a disturbed machine.

    The nominal mechanism commands the poses, the true one moves. A machine with more legs than
    degrees of freedom is placed at the poses themselves. Poses that the true mechanism cannot reach
    are left out and named. Points that cameras of the setup see are written to its table of
    corners. With --serve the command simulates a machine for 'pincal measure'.
    """
    if options.serve is None and (plan is None or output is None):
        raise typer.BadParameter("give PLAN.csv and -o MEASUREMENTS.csv, or --serve PORT")
    mechanism = pincal.load_mechanism(mech)
    units = options.written_in(mechanism)
    disturbed, measured = map(np.random.default_rng, np.random.SeedSequence(options.seed).spawn(2))
    setup = read_setup(options.setup_file or Setup())
    check_noise(mechanism, noise)
    tables = [] if output is None else [output, *map(Path, filter(None, [setup.corners]))]
    outputs: list[tuple[Path, Sequence[str]]] = [(path, ()) for path in tables]
    true_mechanism, made = _true_mechanism(mechanism, options, disturbed)
    if made and options.truth is not None:
        outputs = [(options.truth, MECHANISM_FILES), *outputs]
    refuse_existing_of(outputs, force=force)
    if plan is None or output is None:
        with writing_together(outputs, force=force) as scratch:
            for folder in scratch:
                write_mechanism(true_mechanism, folder)
        machine = SimulatedMachine(mechanism, true_mechanism, noise, setup, units)
        machine.rng, machine.slips, machine.drift = measured, options.slips, options.drift
        serve(machine, options.serve or 0)
        return
    planned = read_poses(plan, true_mechanism, setup=setup)
    with working("simulating measurements"):
        simulation = pincal.simulate(mechanism, true_mechanism, planned, noise, measured, setup)
    if not len(simulation.measurements):
        reason = simulation.unreachable[0][1]
        raise MeasurementError(f"{plan}: no planned pose can be measured ({reason})")
    with writing_together(outputs, force=force) as scratch:
        folders, files = scratch[: -len(tables)], scratch[-len(tables) :]
        _write_simulated(mechanism, setup, simulation.measurements, files, units)
        for folder in folders:
            write_mechanism(true_mechanism, folder)
    _say_unreached(planned, simulation)
    wrote(*dict(outputs))


def serve(machine: SimulatedMachine, port: int) -> None:
    """Answer on a local port, one caller after another, until Ctrl-C."""

    class Line(StreamRequestHandler):
        def handle(self) -> None:
            for line in self.rfile:
                self.wfile.write(machine.answer(line.decode("utf-8", "replace")).encode() + b"\n")

    TCPServer.allow_reuse_address = True
    with TCPServer(("127.0.0.1", port), Line) as server:
        say(f"127.0.0.1:{server.server_address[1]}")
        server.serve_forever()


def _say_unreached(planned: Plan, simulation: Simulation) -> None:
    """Print which rows of a plan were not measured, and why."""
    for reason in dict.fromkeys(reason for _, reason in simulation.unreachable):
        places = [planned.place(row) for row, cause in simulation.unreachable if cause == reason]
        remark(f"not measured, {reason}: {listed(places)} of the plan")
    lost = len(simulation.unreachable)
    remark(f"{len(simulation.measurements)} poses measured, {lost} not reached")
