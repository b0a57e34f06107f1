"""``pincal select``: which poses to measure."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any, get_args

import typer

from pincal.cli.app import (
    Force,
    Mech,
    answer,
    command,
    output_option,
    remark,
    stdout,
    working,
    wrote,
)
from pincal.cli.options import PlanOptions, TableOptions
from pincal.design.forecast import Drift, drift, forecast
from pincal.design.orbits import selection_group
from pincal.design.select import Protocol, in_turns, select_poses, with_reference, with_verification
from pincal.design.select_configurations import Goal, select_configurations
from pincal.errors import MeasurementError, SymmetryError
from pincal.files.measurement_writing import write_plan
from pincal.files.measurements import read_poses
from pincal.files.output import refuse_existing
from pincal.kinematics.configurations import check_reached
from pincal.kinematics.readers import arm_free_of_collision
from pincal.model.measurements import EVERY_LEG, VERIFY, Plan
from pincal.model.mechanism import Mechanism
from pincal.show.summary import drift_answer, drift_lines
from pincal.show.tables import choice_table, selection_table
from pincal.words.table import Table
from pincal.workspace.sampling import sample_configurations, sample_workspace

_CONFIGURATIONS = 3000  # candidates, where all parameters are looked at together


@dataclass(frozen=True)
class Candidates:
    """How many poses are chosen, from which."""

    count: Annotated[
        int,
        typer.Option(
            min=1,
            help="Poses for each leg; orbits with --orbits; of all legs with --common, "
            "--goal platform, --measure or an unknown frame.",
        ),
    ] = 24
    candidates: Annotated[
        Path | None,
        typer.Option(
            metavar="CSV",
            help="Poses to choose from; else 30000 are sampled, 3000 for all legs at once.",
        ),
    ] = None
    collision: Annotated[
        Path | None,
        typer.Option(
            metavar="ROBOT.urdf", help="Keep a serial arm free of itself, by this file's geometry."
        ),
    ] = None
    goal: Annotated[
        Goal, typer.Option(help="Best for the parameters, or for the calibrated platform.")
    ] = "parameters"
    starts: Annotated[int, typer.Option(min=1, help="Starts of the search; the best is kept.")] = 5
    jobs: Annotated[
        int, typer.Option(max=1024, help="Processes, with a protocol; -1 for one a core.")
    ] = 1
    verify: Annotated[
        int,
        typer.Option(min=0, help="Random poses beside them, by which the calibration is checked."),
    ] = 0
    reference: Annotated[
        int | None,
        typer.Option(min=1, help="Measure one pose again every so many rows: that shows drift."),
    ] = None
    by_set: Annotated[
        bool, typer.Option("--by-set", help="Write set after set, not in turns: drift misleads.")
    ] = False


@dataclass(frozen=True)
class Protocols:
    """Which legs poses are for."""

    independent: Annotated[bool, typer.Option("--independent", help="Each leg its own poses.")] = (
        False
    )
    symmetric: Annotated[
        bool, typer.Option("--symmetric", help="Leg 1's poses, mapped to the other legs.")
    ] = False
    orbits: Annotated[
        bool, typer.Option("--orbits", help="Whole orbits: every pose serves every leg.")
    ] = False
    common: Annotated[
        bool, typer.Option("--common", help="COUNT poses for the parameters of all legs together.")
    ] = False

    @property
    def named(self) -> Protocol | None:
        """The protocol that is named, if any.

        Raises:
            BadParameter: several.
        """
        named = [name for name in get_args(Protocol) if getattr(self, name)]
        if len(named) > 1:
            raise typer.BadParameter(f"choose one of --{', --'.join(named)}")
        return named[0] if named else None

    def of(self, mechanism: Mechanism) -> Protocol:
        """Return the protocol that is named, or the one that the mechanism's symmetry allows."""
        if self.named is not None:
            return self.named
        try:
            selection_group(mechanism)
        except SymmetryError as error:
            remark(f"independent selection: {error}")
            return "independent"
        return "symmetric"


@dataclass(frozen=True)
class SelectOptions(TableOptions, PlanOptions, Protocols, Candidates):
    """How poses are chosen."""


@command(answers=True)
def select(
    mech: Mech,
    output: Annotated[Path, output_option("PLAN.csv", "Poses to measure, with their sets.")],
    how: SelectOptions,
    force: Force = False,
) -> None:
    """Choose the poses to measure.

    The efficiency printed compares them with a bound that no choice can exceed. Without a
    protocol named, symmetric where the mechanism allows it, else independent.

    If only part of the pose is measured (--measure), or in a tracker's own frame, COUNT poses are
    chosen for all parameters together by what 'pincal calibrate' will draw from them; so are the
    configurations of serial arms, with the readings to drive to. With --goal platform they make
    the calibrated platform most accurate over the workspace, whatever single parameters are.

    The sets take turns in the plan, in a random order, so that what drifts while you measure is
    no leg's error; what a drift would do all the same is printed. --verify adds poses of the set
    'verify', which 'pincal calibrate' predicts. --reference N measures the pose in the middle again
    every N rows; in the column 'pose' its rows have one name, 'reference'.
    """
    mechanism = how.load(mech)
    if mechanism.influences:
        remark(
            f"planned with {', '.join(mechanism.influences)} at their reference: their terms need "
            "rows in which they differ"
        )
        mechanism = mechanism.at_reference
    units = how.written_in(mechanism)
    refuse_existing(output, force=force)
    part = how.measure is not None or not how.read().plain or how.goal == "platform"
    if mechanism.by_readings or part or how.collision is not None:
        if how.independent or how.symmetric or how.orbits or how.common:
            raise typer.BadParameter(
                "--symmetric, --independent, --orbits and --common choose whole poses in the base "
                "frame that are best for the parameters; leave them out where something else is "
                "measured or wanted: poses are then common to all legs"
            )
        choose = _together
    else:
        choose = _by_protocol
    with working("choosing poses") as progress:
        plan, offered, table, found = choose(mechanism, how, progress)
    if how.verify:
        plan = with_verification(mechanism, plan, offered, how.verify, how.seed)
        remark(f"{how.verify} more poses of the set 'verify' are for no fit: they check it")
    plan = plan if how.by_set else in_turns(plan, how.seed)
    if how.reference is not None:
        planned = len(plan)
        plan = with_reference(mechanism, plan, how.reference)
        remark(f"one pose is measured {len(plan) - planned} times more, as the pose 'reference'")
    write_plan(plan, output, mechanism, units=units, force=force)
    stdout.print(table)
    drifts = _drifts(mechanism, plan, how)
    for line in drift_lines(drifts):
        stdout.print(line, markup=False)
    found["drift"] = [drift_answer(one) for one in drifts]
    if found.get("unreachable"):
        remark(f"{found['unreachable']} candidate poses are out of reach and were left out")
    wrote(output)
    more = {"mechanism": mechanism.name, "plan": str(output), "poses": len(plan.poses)}
    answer(more | found)


def _drifts(mechanism: Mechanism, plan: Plan, how: SelectOptions) -> list[Drift]:
    """Return what a drift over the run would do: of all legs, and of each alone if it has a set."""
    setup, sets = how.read(), set(plan.sets or ()) - {EVERY_LEG, VERIFY}
    try:
        found = [forecast(mechanism, plan, how.noise(), how.measured(mechanism, setup), setup)]
        if sets:
            found.append(forecast(mechanism, plan, how.noise(), method="per-leg"))
    except MeasurementError:  # noise that leaves something exact: only its ratios chose the poses
        return []
    return [drift(one, plan) for one in found]


def _by_protocol(
    mechanism: Mechanism, how: SelectOptions, progress: Callable[[str], None]
) -> tuple[Plan, Plan, Table, dict[str, Any]]:
    """Choose poses by a protocol; return the plan, the candidates, a table, and JSON."""
    noise, protocol = how.noise(), how.of(mechanism)
    if how.candidates is None:
        progress("sampling the workspace")
        poses = sample_workspace(mechanism, 30_000, how.seed)
    else:
        poses = read_poses(how.candidates, mechanism).poses
    chosen = select_poses(
        mechanism,
        poses,
        how.count,
        protocol,
        noise=noise,
        seed=how.seed,
        starts=how.starts,
        jobs=how.jobs,
        progress=progress,
    )
    found = {
        "protocol": chosen.protocol,
        "candidates": chosen.candidates,
        "unreachable": chosen.unreachable,
        "efficiency": chosen.efficiency,
        "legs": [asdict(leg) for leg in chosen.legs],
    }
    return chosen.plan, Plan(poses), selection_table(chosen), found


def _together(
    mechanism: Mechanism, how: SelectOptions, progress: Callable[[str], None]
) -> tuple[Plan, Plan, Table, dict[str, Any]]:
    """Choose configurations for the parameters of all legs together, as ``_by_protocol`` does."""
    setup, noise = how.read(), how.noise()
    progress("sampling configurations")
    if how.candidates is None:
        offered = sample_configurations(mechanism, _CONFIGURATIONS, how.seed)
    else:
        offered = read_poses(how.candidates, mechanism)
        check_reached(mechanism, offered, str(how.candidates))
    if how.collision is not None:
        every = len(offered)
        offered = arm_free_of_collision(mechanism, offered, how.collision)
        remark(f"{every - len(offered)} of {every} candidates collide and were left out")
    chosen = select_configurations(
        mechanism,
        offered,
        how.count,
        noise=noise,
        measured=how.measured(mechanism, setup),
        setup=setup,
        goal=how.goal,
        seed=how.seed,
        starts=how.starts,
        progress=progress,
    )
    found = {
        "goal": chosen.goal,
        "candidates": chosen.candidates,
        "efficiency": chosen.efficiency,
        "rank": chosen.rank.rank,
        "unknowns": chosen.rank.n_params,
        "measured": chosen.measured,
    }
    return chosen.plan, offered, choice_table(mechanism, chosen), found
