"""``pincal identifiability``: what a plan of measurements will determine, before measuring."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import typer

from pincal.cli.app import Mech, answer, command, stdout, working
from pincal.cli.options import PlanOptions, TableOptions
from pincal.design.forecast import drift, forecast, scale_effect
from pincal.files.measurements import read_poses
from pincal.kinematics.configurations import as_plan, check_reached
from pincal.show.summary import drift_answer, poses_line, scale_answer
from pincal.show.tables import forecast_table
from pincal.words.numbers import reading_in
from pincal.workspace.sampling import sample_configurations


@dataclass(frozen=True)
class ForecastOptions(TableOptions, PlanOptions):
    """What will be measured, and in which units numbers are read."""


@command(answers=True)
def identifiability(
    mech: Mech,
    how: ForecastOptions,
    plan: Annotated[
        Path | None,
        typer.Argument(metavar="PLAN.csv", help="Poses to measure; else --count random ones."),
    ] = None,
    per_leg: Annotated[
        bool,
        typer.Option("--per-leg", help="Say also what each leg alone gives, by its own poses."),
    ] = False,
    accuracy: Annotated[
        float | None,
        typer.Option(help="Wanted root mean square position error over the workspace [m]."),
    ] = None,
    count: Annotated[int, typer.Option(min=1, help="Number of poses without a plan.")] = 50,
) -> None:
    """Say beforehand what measurements will determine.

    Prints the rank, what cannot be determined, the standard error of each parameter as 'pincal
    calibrate' will give it (the Cramér-Rao bound: the best that any calibration can reach), and
    the platform error over the workspace; with --accuracy how many poses that takes; what a drift
    over the run would do if poses are measured in the plan's order, and a wrong scale of the
    instrument. With --per-leg also what 'pincal calibrate --per-leg' will give, where poses are
    measured in full.

    Positions are of the platform's origin in the robot's base frame, unless --unknown-frame,
    --unknown-target or --setup say otherwise.
    """
    mechanism = how.load(mech)
    units = how.written_in(mechanism)
    noise, setup = how.noise(), how.read()
    measured = how.measured(mechanism, setup)
    if plan is not None:
        poses = read_poses(plan, mechanism)
        check_reached(mechanism, poses, str(plan))
    with working("sampling the workspace"):
        over = sample_configurations(mechanism, 1000, how.seed)
        if plan is None:
            poses = sample_configurations(mechanism, count, how.seed + 1)
    found = forecast(mechanism, poses, noise, measured, setup)
    error = found.platform_error(over)
    own = forecast(mechanism, poses, noise, measured, setup, "per-leg") if per_leg else None
    alone = None if own is None else own.platform_error(over)
    drifts = [drift(found, over, error)]
    drifts += [] if own is None else [drift(own, over, alone)]
    scale = scale_effect(found, as_plan(mechanism, poses), over, noise, setup)
    needed = needed_alone = None
    if accuracy is not None:
        needed = found.poses_for(accuracy, over)
        needed_alone = None if own is None else own.poses_for(accuracy, over)
    with reading_in(units.printed):
        stdout.print(forecast_table(found, error, found.poses, alone, drifts, scale))
        if accuracy is not None and needed is not None:
            stdout.print(poses_line(accuracy, needed, needed_alone), markup=False)
    names = [(leg.name, name) for leg in mechanism.legs for name in leg.parameter_names]
    answer(
        {
            "mechanism": mechanism.name,
            "poses": found.poses,
            "measured": found.measured,
            "rank": found.rank.rank,
            "unknowns": found.rank.n_params,
            "condition": found.rank.condition,
            "not_separable": found.rank.groups,
            "weakly_determined": [asdict(pair) for pair in found.weak],
            "freedoms_of_frames": found.gauge.shape[1],
            "parameters": [
                {"leg": leg, "name": name, "std": std}
                for (leg, name), std in zip(names, found.std, strict=True)
            ],
            "platform_error": {"position": error.position, "orientation": error.orientation},
            "poses_for_accuracy": needed,
            "drift": drift_answer(drifts[0]),
            "scale": scale_answer(scale),
            "leg_by_leg": None
            if alone is None
            else {
                "platform_error": {"position": alone.position, "orientation": alone.orientation},
                "poses_for_accuracy": needed_alone,
                "drift": drift_answer(drifts[1]),
            },
        }
    )
