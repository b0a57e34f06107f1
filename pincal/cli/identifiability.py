"""``pincal identifiability``: what a plan of measurements will tell, before measuring."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from pincal.cli.app import Mech, Seed, app, stdout, working
from pincal.cli.experiment import NoiseOrientation, NoisePosition, NoiseReading
from pincal.experiment.forecast import forecast
from pincal.model.files import load_mechanism
from pincal.model.measurement_files import read_poses
from pincal.model.measurements import Noise
from pincal.model.mechanism import Mechanism
from pincal.show.tables import forecast_table
from pincal.workspace.sampling import sample_workspace


@app.command()
def identifiability(
    mech: Mech,
    plan: Annotated[
        Path | None,
        typer.Argument(metavar="[PLAN.csv]", help="Poses to measure; else --count random ones."),
    ] = None,
    measure: Annotated[
        str,
        typer.Option(
            metavar="pose|position|orientation|nothing|x,y,…",
            help="What is measured of the platform; all sensors are read at every pose.",
        ),
    ] = "pose",
    noise_position: NoisePosition = 1e-4,
    noise_orientation: NoiseOrientation = 1e-4,
    noise_reading: NoiseReading = 0.0,
    accuracy: Annotated[
        float | None,
        typer.Option(help="Wanted root mean square position error over the workspace [m]."),
    ] = None,
    count: Annotated[int, typer.Option(min=1, help="Number of poses without a plan.")] = 50,
    seed: Seed = 0,
) -> None:
    """Say what measurements will tell about the parameters, before they are made.

    Prints the rank, what cannot be told apart, the standard error of each parameter (the
    Cramér-Rao bound: the best that any calibration of all legs can reach), and the
    platform error over the workspace; with --accuracy how many poses that takes.

    Positions are measured at the platform's origin, in the robot's base frame. 'pincal
    calibrate' takes full poses; what parts of them would tell is forecast here only.
    """
    mechanism = load_mechanism(mech)
    noise = Noise(noise_position, noise_orientation, noise_reading)
    measured = _measured(mechanism, measure)
    if plan is not None:
        poses = read_poses(plan, mechanism).poses
    with working("sampling the workspace"):
        over = sample_workspace(mechanism, 1000, seed)
        if plan is None:
            poses = sample_workspace(mechanism, count, seed + 1)
    found = forecast(mechanism, poses, noise, measured)
    error = found.platform_error(over)
    stdout.print(forecast_table(found, error, len(poses)))
    if accuracy is not None:
        needed = found.poses_for(accuracy, over)
        text = f"{needed:,.0f} poses like these" if np.isfinite(needed) else "no number of poses"
        stdout.print(f"for {1e3 * accuracy:g} mm: {text}", markup=False)


def _measured(mechanism: Mechanism, measure: str) -> tuple[str, ...]:
    """Return the freedoms that are measured."""
    platform = mechanism.platform
    pairs = list(zip(platform.freedoms, platform.units, strict=True))
    named = {
        "pose": platform.freedoms,
        "position": tuple(name for name, unit in pairs if unit == "m"),
        "orientation": tuple(name for name, unit in pairs if unit == "rad"),
        "nothing": (),
    }
    return named[measure] if measure in named else tuple(measure.replace(" ", "").split(","))
