"""``pincal select`` and ``pincal simulate``: which poses to measure, and trying it out."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from pincal.cli.app import (
    Force,
    Mech,
    Seed,
    answer,
    command,
    output_option,
    remark,
    stdout,
    working,
    wrote,
)
from pincal.errors import FileError, MeasurementError, SymmetryError
from pincal.experiment.selection import Protocol, select_poses
from pincal.experiment.simulation import disturb as disturbed
from pincal.experiment.simulation import simulate as simulated
from pincal.model.files import load_mechanism, write_mechanism
from pincal.model.measurement_files import read_poses, write_measurements, write_poses
from pincal.model.measurements import Noise
from pincal.model.mechanism import Mechanism
from pincal.model.output import refuse_existing, writing
from pincal.show.tables import selection_table
from pincal.symmetry.detect import symmetry_group
from pincal.workspace.sampling import sample_workspace

NoisePosition = Annotated[float, typer.Option(help="Standard deviation of positions [m].")]
NoiseOrientation = Annotated[float, typer.Option(help="Standard deviation of angles [rad].")]
NoiseReading = Annotated[float, typer.Option(help="Standard deviation of readings [rad or m].")]


@command(answers=True)
def select(
    mech: Mech,
    output: Annotated[Path, output_option("PLAN.csv", "Poses to measure, with their sets.")],
    count: Annotated[
        int, typer.Option(min=1, help="Poses for each leg; number of orbits with --orbits.")
    ] = 24,
    candidates: Annotated[
        Path | None,
        typer.Option(metavar="CSV", help="Poses to choose from; else 30000 are sampled."),
    ] = None,
    independent: Annotated[
        bool, typer.Option("--independent", help="Each leg its own poses.")
    ] = False,
    symmetric: Annotated[
        bool, typer.Option("--symmetric", help="Leg 1's poses, mapped to the other legs.")
    ] = False,
    orbits: Annotated[
        bool, typer.Option("--orbits", help="Whole orbits: every pose serves every leg.")
    ] = False,
    common: Annotated[
        bool, typer.Option("--common", help="COUNT poses for the parameters of all legs together.")
    ] = False,
    starts: Annotated[
        int, typer.Option(min=1, help="Starts of the search; the best is kept.")
    ] = 20,
    noise_position: NoisePosition = 1e-4,
    noise_orientation: NoiseOrientation = 1e-4,
    noise_reading: NoiseReading = 0.0,
    seed: Seed = 0,
    force: Force = False,
) -> None:
    """Choose the poses to measure.

    The efficiency printed compares them with a bound that no choice can exceed. Without a
    protocol named, symmetric where the mechanism allows it, else independent.
    """
    mechanism = load_mechanism(mech)
    refuse_existing(output, force=force)
    protocol = _protocol(mechanism, independent, symmetric, orbits, common)
    noise = Noise(noise_position, noise_orientation, noise_reading)
    with working("choosing poses") as tell:
        if candidates is None:
            tell("sampling the workspace")
            poses = sample_workspace(mechanism, 30_000, seed)
        else:
            poses = read_poses(candidates, mechanism).poses
        selection = select_poses(
            mechanism,
            poses,
            count,
            protocol,
            noise=noise,
            seed=seed,
            starts=starts,
            progress=tell,
        )
    write_poses(output, mechanism, selection.plan, force=force)
    stdout.print(selection_table(selection))
    if selection.unreachable:
        remark(f"{selection.unreachable} candidate poses are out of reach and were left out")
    wrote(output)
    answer(
        {
            "mechanism": mechanism.name,
            "plan": str(output),
            "protocol": selection.protocol,
            "poses": len(selection.plan.poses),
            "candidates": selection.candidates,
            "unreachable": selection.unreachable,
            "efficiency": selection.efficiency,
            "legs": [asdict(leg) for leg in selection.legs],
        }
    )


def _protocol(
    mechanism: Mechanism, independent: bool, symmetric: bool, orbits: bool, common: bool
) -> Protocol:
    """Return the protocol asked for, or the one that the mechanism's symmetry allows."""
    named: dict[Protocol, bool] = {
        "independent": independent,
        "symmetric": symmetric,
        "orbits": orbits,
        "common": common,
    }
    asked = [name for name, chosen in named.items() if chosen]
    if len(asked) > 1:
        raise typer.BadParameter(f"choose one of --{', --'.join(asked)}")
    if asked:
        return asked[0]
    try:
        symmetry_group(mechanism).carriers()
    except SymmetryError as error:
        remark(f"independent selection: {error}")
        return "independent"
    return "symmetric"


@command(answers=True)
def simulate(
    mech: Mech,
    plan: Annotated[Path, typer.Argument(metavar="PLAN.csv", help="Poses to command.")],
    output: Annotated[Path, output_option("MEASUREMENTS.csv", "Measured poses and readings.")],
    disturb: Annotated[
        float | None,
        typer.Option(help="Standard deviation of the errors of all parameters [default: 0.002]."),
    ] = None,
    noise_position: NoisePosition = 1e-4,
    noise_orientation: NoiseOrientation = 1e-4,
    noise_reading: NoiseReading = 0.0,
    seed: Seed = 0,
    truth: Annotated[
        Path | None,
        typer.Option(
            metavar="TRUE_MECH",
            help="Folder for the true mechanism. Without --disturb, if it exists, it is the truth.",
        ),
    ] = None,
    force: Force = False,
) -> None:
    """Simulate measurements of a disturbed machine.

    The nominal mechanism commands the poses, the true one moves. With more legs than freedoms
    it is taken to the poses themselves.
    Poses that the true mechanism cannot reach are left out and listed.
    """
    mechanism = load_mechanism(mech)
    refuse_existing(output, force=force)
    noise = Noise(noise_position, noise_orientation, noise_reading)
    planned = read_poses(plan, mechanism)
    parts = np.random.SeedSequence(seed).spawn(2)
    given = truth is not None and disturb is None and truth.is_dir()
    if truth is not None and given:
        true_mechanism = _same_kind(load_mechanism(truth), mechanism, truth)
    else:
        if truth is not None:
            refuse_existing(truth, force=force, folder=True)
            if truth.absolute() == output.absolute():
                raise FileError(
                    f"{truth} is named for both the true mechanism and the measurements"
                )
        sigma = 0.002 if disturb is None else disturb
        true_mechanism = disturbed(mechanism, sigma, np.random.default_rng(parts[0]))
    with working("simulating measurements"):
        rng = np.random.default_rng(parts[1])
        simulation = simulated(mechanism, true_mechanism, planned, noise, rng)
    if not len(simulation.measurements):
        reason = simulation.unreachable[0][1]
        raise MeasurementError(f"{plan}: no planned pose can be measured ({reason})")
    with ExitStack() as both:  # written together, or neither
        if truth is not None and not given:
            folder = both.enter_context(writing(truth, force=force, folder=True))
            write_mechanism(true_mechanism, folder)
        write_measurements(output, mechanism, simulation.measurements, force=force)
    if truth is not None and not given:
        wrote(truth)
    for row, reason in simulation.unreachable:
        remark(f"row {row + 1} of the plan is not measured: {reason}")
    lost = len(simulation.unreachable)
    remark(f"{len(simulation.measurements)} poses measured, {lost} not reached")
    wrote(output)
    answer(
        {
            "mechanism": mechanism.name,
            "measurements": str(output),
            "truth": None if truth is None else str(truth),
            "poses": len(simulation.measurements),
            "not_reached": [
                {"row": row + 1, "reason": reason} for row, reason in simulation.unreachable
            ],
        }
    )


def _same_kind(truth: Mechanism, mechanism: Mechanism, path: Path) -> Mechanism:
    """Return the truth if it has the mechanism's legs and platform."""
    if (truth.leg_names, truth.platform.kind) != (mechanism.leg_names, mechanism.platform.kind):
        raise FileError(
            f"{path} holds {truth.name!r}, whose legs or platform differ from those of "
            f"{mechanism.name!r}"
        )
    return truth
