"""``pincal simulate``: measurements of a machine whose errors are known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
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
    working,
    wrote,
)
from pincal.cli.options import NoiseOptions, TableOptions
from pincal.design.simulate import disturb as disturbed
from pincal.design.simulate import simulate as simulated
from pincal.errors import FileError, MeasurementError
from pincal.files.measurement_writing import write_plan
from pincal.files.measurements import read_poses
from pincal.files.mechanism_folders import MECHANISM_FILES, load_mechanism, write_mechanism
from pincal.files.output import refuse_existing, writing_together
from pincal.model.mechanism import Mechanism


@dataclass(frozen=True)
class SimulateOptions(TableOptions, NoiseOptions):
    """What is simulated."""

    disturb: Annotated[
        float | None,
        typer.Option(
            help="Standard deviation of the errors of all parameters [m, rad or 1; default: 0.001 "
            "of the machine's size for lengths, 0.001 otherwise]."
        ),
    ] = None
    seed: Seed = 0
    truth: Annotated[
        Path | None,
        typer.Option(
            metavar="TRUE_MECH",
            help="Folder for the true mechanism. Without --disturb, if it exists, it is the truth.",
        ),
    ] = None


@command(answers=True)
def simulate(
    mech: Mech,
    plan: Annotated[Path, typer.Argument(metavar="PLAN.csv", help="Poses to command.")],
    output: Annotated[Path, output_option("MEASUREMENTS.csv", "Measured poses and readings.")],
    how: SimulateOptions,
    force: Force = False,
) -> None:
    """Simulate measurements of a disturbed machine.

    The nominal mechanism commands the poses, the true one moves. With more legs than freedoms
    it is taken to the poses themselves.
    Poses that the true mechanism cannot reach are left out and listed.
    """
    mechanism = how.load(mech)
    units = how.written_in(mechanism)
    truth, disturb = how.truth, how.disturb
    parts = np.random.SeedSequence(how.seed).spawn(2)
    given = truth is not None and disturb is None and truth.is_dir()
    if truth is not None and given:
        true_mechanism = _same_kind(load_mechanism(truth), mechanism, truth)
    else:
        if truth is not None:
            refuse_existing(truth, force=force, folder=MECHANISM_FILES)
        true_mechanism = disturbed(mechanism, disturb, np.random.default_rng(parts[0]))
    planned = read_poses(plan, true_mechanism)
    refuse_existing(output, force=force)
    with working("simulating measurements"):
        rng = np.random.default_rng(parts[1])
        simulation = simulated(mechanism, true_mechanism, planned, how.noise(), rng)
    if not len(simulation.measurements):
        reason = simulation.unreachable[0][1]
        raise MeasurementError(f"{plan}: no planned pose can be measured ({reason})")
    outputs: list[tuple[Path, Sequence[str]]] = [(output, ())]
    if truth is not None and not given:
        outputs = [(truth, MECHANISM_FILES), (output, ())]
    with writing_together(outputs, force=force) as made:
        write_plan(simulation.measurements, made[-1], mechanism, units=units)
        for folder in made[:-1]:
            write_mechanism(true_mechanism, folder)
    if truth is not None and not given:
        wrote(truth)
    for row, reason in simulation.unreachable:
        remark(f"{planned.place(row)} of the plan is not measured: {reason}")
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
