"""``pincal select``: which poses to measure."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

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
from pincal.cli.setups import (
    Measure,
    NoiseOrientation,
    NoisePosition,
    NoiseReading,
    SetupFile,
    UnknownFrame,
    UnknownTarget,
    measured_of,
    setup_from,
)
from pincal.design.select import Protocol, select_poses
from pincal.design.select_configurations import select_configurations
from pincal.errors import MechanismError, ObservabilityError, SymmetryError
from pincal.files.measurement_writing import write_poses
from pincal.files.measurements import read_poses
from pincal.files.mechanism_folders import load_mechanism
from pincal.files.output import refuse_existing
from pincal.kinematics.closure import LegClosure
from pincal.kinematics.configurations import check_reached
from pincal.kinematics.inverse import sensor_law
from pincal.kinematics.readers import free_of_collision
from pincal.model.measurements import Noise, Plan
from pincal.model.mechanism import Mechanism
from pincal.model.setup import Setup
from pincal.show.tables import choice_table, selection_table
from pincal.symmetry.detect import symmetry_group
from pincal.workspace.sampling import sample_configurations, sample_workspace

_CONFIGURATIONS = 3000  # candidates, where all parameters are looked at together


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
    measure: Measure = None,
    setup: SetupFile = None,
    unknown_frame: UnknownFrame = False,
    unknown_target: UnknownTarget = False,
    collision: Annotated[
        Path | None,
        typer.Option(
            metavar="ROBOT.urdf", help="Keep a serial arm free of itself, by this file's geometry."
        ),
    ] = None,
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

    If only part of the pose is measured (--measure), or in a tracker's own frame, COUNT poses are
    chosen for all parameters together by what 'pincal calibrate --method latent' will draw from
    them; so are the configurations of serial arms, with the readings to drive to.
    """
    mechanism = load_mechanism(mech)
    refuse_existing(output, force=force)
    how = setup_from(setup, unknown_frame=unknown_frame, unknown_target=unknown_target)
    noise = Noise(noise_position, noise_orientation, noise_reading)
    if mechanism.by_readings or measure is not None or not how.plain or collision is not None:
        if independent or symmetric or orbits or common:
            raise typer.BadParameter(
                "poses for single legs are of whole poses in the base frame; leave out the protocol"
            )
        _together(
            mechanism,
            output,
            count,
            candidates,
            measured_of(mechanism, measure or "pose", how),
            how,
            noise,
            collision,
            starts=starts,
            seed=seed,
            force=force,
        )
        return
    protocol = _protocol(mechanism, independent, symmetric, orbits, common)
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


def _check_arm(mechanism: Mechanism) -> None:
    """Raise if a mechanism is no serial arm.

    Raises:
        MechanismError: it has several legs, or joints that are not read.
    """
    if len(mechanism.legs) > 1 or mechanism.legs[0].passive:
        raise MechanismError(f"{mechanism.name!r} is no serial arm; --collision is for such")


def _together(
    mechanism: Mechanism,
    output: Path,
    count: int,
    candidates: Path | None,
    measured: tuple[str, ...],
    setup: Setup,
    noise: Noise,
    collision: Path | None,
    *,
    starts: int,
    seed: int,
    force: bool,
) -> None:
    """Choose configurations for the parameters of all legs together."""
    if collision is not None:
        _check_arm(mechanism)
    with working("choosing configurations") as tell:
        tell("sampling configurations")
        if candidates is None:
            offered = sample_configurations(mechanism, _CONFIGURATIONS, seed)
        else:
            offered = read_poses(candidates, mechanism)
            check_reached(mechanism, offered, str(candidates))
        offered = offered if collision is None else _free(mechanism, offered, collision)
        chosen = select_configurations(
            mechanism,
            offered,
            count,
            noise=noise,
            measured=measured,
            setup=setup,
            seed=seed,
            starts=starts,
            progress=tell,
        )
    write_poses(output, mechanism, chosen.plan, force=force)
    stdout.print(choice_table(mechanism, chosen))
    wrote(output)
    answer(
        {
            "mechanism": mechanism.name,
            "plan": str(output),
            "poses": len(chosen.plan.poses),
            "candidates": chosen.candidates,
            "efficiency": chosen.efficiency,
            "rank": chosen.rank.rank,
            "unknowns": chosen.rank.n_params,
            "measured": chosen.measured,
        }
    )


def _free(mechanism: Mechanism, offered: Plan, collision: Path) -> Plan:
    """Return the configurations of a plan at which a serial arm is free of itself.

    Raises:
        ObservabilityError: none is.
    """
    (leg,), readings = mechanism.legs, offered.readings
    if readings is None:
        raise MechanismError(f"{mechanism.name!r} is planned by poses; --collision needs readings")
    law = sensor_law(LegClosure(leg, mechanism.platform))
    names = [leg.moving[index].name for index in leg.active]
    free = free_of_collision(collision, names, law.position(readings))
    if not free.any():
        raise ObservabilityError(f"no candidate is free of collisions by {collision}")
    remark(f"{int((~free).sum())} of {len(free)} candidates collide and were left out")
    return Plan(offered.poses[free], readings=readings[free])


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
