"""``pincal select``, ``identifiability`` and ``simulate``: measurements before they are made."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

import pincal
from pincal import FileError, MeasurementError, Mechanism, Noise, Plan, Setup, SymmetryError
from pincal.cli.app import command, remark, stdout, working, wrote
from pincal.cli.options import (
    FORCE,
    SEED,
    Force,
    Mech,
    PlanOptions,
    TableOptions,
    offered,
    output_option,
)
from pincal.design.orbits import selection_group
from pincal.design.order import in_turns, with_distances, with_reference, with_verification
from pincal.design.select import Goal, Protocol
from pincal.estimation.noise import assumed_noise
from pincal.files.columns import columns_of, write_sheet
from pincal.files.measurements import read_poses
from pincal.files.mechanism_folders import MECHANISM_FILES, write_mechanism
from pincal.files.output import refuse_existing_of, writing_together
from pincal.files.table import write_table
from pincal.instruments.setup_file import read_setup
from pincal.kinematics.collision import arm_free_of_collision
from pincal.kinematics.configurations import check_reached
from pincal.model.checks import listed
from pincal.model.option import Option, option
from pincal.show import explanation, tables
from pincal.words.numbers import amount, reading_in
from pincal.words.table import Table

_CONFIGURATIONS = 3000  # candidates, where all parameters are looked at together
_POSES = 30_000  # candidates, where legs have poses of their own
_FORECAST = 50  # poses, where no plan is given


@dataclass(frozen=True)
class SelectOptions(PlanOptions):
    """How poses are chosen."""

    count: int = option(
        24,
        "Poses for each leg; orbits with --protocol orbits; of all legs with --protocol common, "
        "--goal platform, --measure or an unknown frame.",
        least=1,
    )
    protocol: Protocol | None = option(
        None,
        "independent: each leg its own poses; symmetric: leg 1's poses, mapped to the other legs; "
        "orbits: whole orbits, every pose serves every leg; common: COUNT poses for the parameters "
        "of all legs together.",
    )
    candidates: Path | None = option(
        None,
        "Poses to choose from; else 30000 are sampled, 3000 for all legs at once.",
        metavar="CSV",
    )
    collision: Path | None = option(
        None, "Avoid self-collisions of an arm, by this file's geometry.", metavar="ROBOT.urdf"
    )
    goal: Goal = option("parameters", "Best for the parameters, or for the calibrated platform.")
    starts: int = option(5, "Starts of the search; the best is kept.", least=1)
    distances: int = option(
        0,
        "Distances from each pose to others, by calliper or tape, in place of positions.",
        least=0,
    )
    verify: int = option(0, "Additional random poses to verify the calibration with.", least=0)
    reference: int | None = option(
        None, "Repeat one pose every so many rows, which shows drift.", least=1
    )
    sheet: Path | None = option(
        None,
        "Also a sheet to fill in, .xlsx or .csv: what to drive to, cells for what to measure.",
        metavar="SHEET.xlsx",
    )
    force: bool = option(False, FORCE)

    def read_setup(self) -> Setup:
        """Return the setup; distances say of a machine what positions in an unknown frame say."""
        return super().read_setup().anywhere(frame=self.distances > 0)

    def measured(self, mechanism: Mechanism, setup: Setup) -> tuple[str, ...]:
        """Return what is measured of the platform, or what distances stand for."""
        platform = mechanism.platform
        every = super().measured(mechanism, setup)
        return platform.freedoms[: platform.lengths] if self.distances else every


@command
def select(
    mech: Mech,
    output: Annotated[Path, output_option("PLAN.csv", "Poses to measure, with their sets.")],
    options: SelectOptions,
    noise: Noise,
) -> None:
    """Choose the poses to measure.

    The efficiency printed is relative to a bound that no choice can exceed. Without --protocol:
    symmetric if the mechanism allows it, otherwise independent.

    If only part of the pose is measured (--measure), or in a tracker's own frame, COUNT poses are
    chosen for all parameters together by what 'pincal calibrate' will draw from them; so are the
    configurations of serial arms, with the readings to drive to. With --goal platform they make the
    calibrated platform most accurate over the workspace, even if single parameters are less
    certain.

    The plan mixes the sets at random, so that drift while you measure is not taken for an error of
    one leg. --verify adds poses reserved for verification (set 'verify'). --reference N repeats the
    middle pose every N rows, named 'reference' in the column 'pose'. --distances N measures N
    distances to other poses from each pose, instead of positions (columns 'distance_1_to' …).
    """
    mechanism = pincal.load_mechanism(mech)
    if mechanism.influences:
        remark(
            f"planned with {', '.join(mechanism.influences)} at their reference: their terms need "
            "rows in which they differ"
        )
        mechanism = mechanism.at_reference
    units, sheet = options.written_in(mechanism), options.sheet
    outputs = [path for path in (output, sheet) if path is not None]
    refuse_existing_of([(path, ()) for path in outputs], force=options.force)
    with working("choosing poses") as progress:
        plan, candidates, table = _choose(
            mechanism, options, with_reading_noise(noise, mechanism), progress
        )
    if options.verify:
        plan = with_verification(mechanism, plan, candidates, options.verify, options.seed)
        remark(f"{options.verify} more poses, in the set 'verify', are kept for verification")
    plan = in_turns(plan, options.seed)
    if options.reference is not None:
        count = len(plan)
        plan = with_reference(mechanism, plan, options.reference)
        remark(f"one pose is measured {len(plan) - count} times more, as the pose 'reference'")
    plan = with_distances(plan, options.distances)
    with writing_together([(path, ()) for path in outputs], force=options.force) as scratch:
        write_table(scratch[0], columns_of(mechanism, plan), units=units)
        if sheet is not None:
            _write_sheet(scratch[1], mechanism, plan, options)
    stdout.print(table)
    wrote(*outputs)


def _write_sheet(path: Path, mechanism: Mechanism, plan: Plan, options: SelectOptions) -> None:
    """Write the sheet of a plan, with cells for what options say is measured."""
    setup = options.read_setup()
    if plan.readings is None:
        plan = replace(plan, readings=pincal.inverse(mechanism, plan.poses).readings)
    measured = () if options.distances else options.measured(mechanism, setup)
    write_sheet(path, mechanism, plan, measured, setup, options.written_in(mechanism))


def with_reading_noise(noise: Noise, mechanism: Mechanism) -> Noise:
    """Return noise with which more readings than freedoms can agree: exact ones cannot."""
    if noise.reading or not mechanism.redundant:
        return noise
    reading = assumed_noise(mechanism, exact=False).reading
    size = amount(reading, mechanism.reading_units[0]).replace(" ", "")
    remark(f"more readings than freedoms cannot all be exact: --noise-reading {size} is taken")
    return replace(noise, reading=reading)


def _choose(
    mechanism: Mechanism, options: SelectOptions, noise: Noise, progress: Callable[[str], None]
) -> tuple[Plan, Plan, Table]:
    """Choose poses by a protocol, or for all legs together; return plan, candidates and a table."""
    setup = options.read_setup()
    partial = options.measure not in (None, "pose") or not setup.plain or options.goal == "platform"
    together = mechanism.by_readings or partial or options.collision is not None
    if together and options.protocol not in (None, "common"):
        raise typer.BadParameter(
            f"--protocol {options.protocol} chooses whole poses in the base frame that are best "
            "for the parameters; leave it out where something else is measured or wanted: poses "
            "are then common to all legs"
        )
    if options.candidates is None:
        progress("sampling the workspace")
        count = _CONFIGURATIONS if together else _POSES
        candidates = sampled(mechanism, setup, count, options.seed)
    else:
        candidates = read_poses(options.candidates, mechanism, setup=setup)
    search: dict[str, Any] = {"noise": noise, "seed": options.seed, "starts": options.starts}
    if not together:
        protocol = options.protocol
        if protocol is None:
            try:
                selection_group(mechanism)
                protocol = "symmetric"
            except SymmetryError as error:
                remark(f"independent selection: {error}")
                protocol = "independent"
        chosen = pincal.select_poses(mechanism, candidates.poses, options.count, protocol, **search)
        if chosen.unreachable:
            remark(f"{chosen.unreachable} candidate poses are out of reach and were left out")
        return chosen.plan, candidates, tables.selection_table(chosen)
    if options.candidates is not None:
        check_reached(mechanism, candidates, str(options.candidates))
    if options.collision is not None:
        total = len(candidates)
        candidates = arm_free_of_collision(mechanism, candidates, options.collision)
        remark(f"{total - len(candidates)} of {total} candidates collide and were left out")
    choice = pincal.select_configurations(
        mechanism,
        candidates,
        options.count,
        measured=options.measured(mechanism, setup),
        setup=setup,
        goal=options.goal,
        **search,
    )
    return choice.plan, candidates, tables.selection_table(choice, mechanism.name)


def sampled(mechanism: Mechanism, setup: Setup, count: int, seed: int) -> Plan:
    """Return configurations of the workspace, at the points of contacts if the setup has any."""
    if not setup.contacts:
        return pincal.sample_configurations(mechanism, count, seed)
    plan, placed = pincal.sample_contacts(mechanism, setup, count, seed)
    planned = [
        f"{column} {point} at ({', '.join(f'{x:.3g}' for x in contact.points[point] or ())}) m"
        for column, point, contact in placed.touched.values()
        if setup.contacts[column].points[point] is None
    ]
    if planned:
        remark(f"planned with {listed(planned)}: give places in the setup if they are elsewhere")
    return plan


@command
def identifiability(
    mech: Mech,
    options: PlanOptions,
    noise: Noise,
    plan: Annotated[
        Path | None, typer.Argument(metavar="PLAN.csv", help="Poses to measure; else 50 at random.")
    ] = None,
    accuracy: Annotated[
        float | None,
        offered(
            "accuracy",
            Option("Wanted root mean square position error over the workspace [m].", unit="m"),
        ),
    ] = None,
) -> None:
    """Predict what measurements will determine.

    Prints the rank, what cannot be determined, the standard error of each parameter that 'pincal
    calibrate' will attain (the Cramér-Rao bound), and the platform error over the workspace; with
    --accuracy also how many poses that takes.

    Positions are of the platform's origin in the robot's base frame, unless --unknown-frame,
    --unknown-target or --setup say otherwise.
    """
    mechanism = pincal.load_mechanism(mech)
    units = options.written_in(mechanism)
    setup = options.read_setup()
    if plan is not None:
        poses = read_poses(plan, mechanism, setup=setup)
        setup = setup.of_rows(poses.contacts)
        check_reached(mechanism, poses, str(plan))
    measured = options.measured(mechanism, setup)
    with working("sampling the workspace"):
        workspace = pincal.sample_configurations(mechanism, 1000, options.seed)
        if plan is None:
            if setup.contacts:  # the same points as 'select' plans
                poses = sampled(mechanism, setup, _CONFIGURATIONS, options.seed)
                poses = poses.rows(np.arange(len(poses)) < _FORECAST)
            else:
                poses = pincal.sample_configurations(mechanism, _FORECAST, options.seed + 1)
    expected = pincal.forecast(
        mechanism, poses, with_reading_noise(noise, mechanism), measured, setup
    )
    error = expected.platform_error(workspace)
    with reading_in(units.printed):
        stdout.print(tables.standard_errors(expected))
        stdout.print(*explanation.forecast_lines(expected, error), sep="\n")
        if accuracy is not None:
            needed = expected.poses_for(accuracy, workspace)
            count = f"{needed:,.0f}" if np.isfinite(needed) else "no number of"
            noisy = ", too many to measure: reduce the noise" * (1e5 < needed < np.inf)
            stdout.print(f"for {amount(accuracy, 'm', 6)}: {count} poses like these{noisy}")


@dataclass(frozen=True)
class SimulateOptions(TableOptions):
    """What is simulated."""

    disturb: float | None = option(
        None,
        "Standard deviation of the errors of all parameters [m, rad or 1; default: 0.001 of the "
        "machine's size for lengths, 0.001 otherwise].",
    )
    seed: int = option(0, SEED)
    setup_file: Path | None = option(
        None, "Points of contact that targets touch in the plan.", name="setup", metavar="YAML"
    )
    truth: Path | None = option(
        None,
        "Folder for the true mechanism. Without --disturb, if it exists, it is the truth.",
        metavar="TRUE_MECH",
    )


@command
def simulate(
    mech: Mech,
    plan: Annotated[Path, typer.Argument(metavar="PLAN.csv", help="Poses to command.")],
    output: Annotated[Path, output_option("MEASUREMENTS.csv", "Measured poses and readings.")],
    options: SimulateOptions,
    noise: Noise,
    force: Force = False,
) -> None:
    """Simulate measurements of a disturbed machine.

    The nominal mechanism commands the poses, the true one moves. A machine with more legs than
    degrees of freedom is placed at the poses themselves. Poses that the true mechanism cannot reach
    are left out and named.
    """
    mechanism = pincal.load_mechanism(mech)
    units = options.written_in(mechanism)
    truth = options.truth
    disturbed, measured = map(np.random.default_rng, np.random.SeedSequence(options.seed).spawn(2))
    outputs: list[tuple[Path, Sequence[str]]] = [(output, ())]
    if truth is not None and options.disturb is None and truth.is_dir():
        true_mechanism = pincal.load_mechanism(truth)
        kinds = [(m.leg_names, m.platform.kind) for m in (true_mechanism, mechanism)]
        if kinds[0] != kinds[1]:
            raise FileError(
                f"{truth} holds {true_mechanism.name!r}, whose legs or platform differ from those "
                f"of {mechanism.name!r}"
            )
    else:
        outputs = [(truth, MECHANISM_FILES), *outputs] if truth is not None else outputs
        true_mechanism = pincal.disturb(mechanism, options.disturb, disturbed)
    refuse_existing_of(outputs, force=force)
    setup = Setup() if options.setup_file is None else read_setup(options.setup_file)
    planned = read_poses(plan, true_mechanism, setup=setup)
    with working("simulating measurements"):
        simulation = pincal.simulate(mechanism, true_mechanism, planned, noise, measured, setup)
    if not len(simulation.measurements):
        reason = simulation.unreachable[0][1]
        raise MeasurementError(f"{plan}: no planned pose can be measured ({reason})")
    with writing_together(outputs, force=force) as scratch:
        write_table(scratch[-1], columns_of(mechanism, simulation.measurements), units=units)
        for folder in scratch[:-1]:
            write_mechanism(true_mechanism, folder)
    for reason in dict.fromkeys(reason for _, reason in simulation.unreachable):
        places = [planned.place(row) for row, why in simulation.unreachable if why == reason]
        remark(f"not measured, {reason}: {listed(places)} of the plan")
    lost = len(simulation.unreachable)
    remark(f"{len(simulation.measurements)} poses measured, {lost} not reached")
    wrote(*(path for path, _ in outputs))
