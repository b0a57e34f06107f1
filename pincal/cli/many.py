"""``pincal montecarlo``: what accuracy many machines will have."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import typer

from pincal import Noise, Options, load_mechanism, montecarlo
from pincal.calibration.many import FAILURE, Workers
from pincal.cli.app import command, fail, say, stdout, working, wrote
from pincal.cli.design import with_reading_noise
from pincal.cli.options import Mech, PlanOptions, output_option
from pincal.files.measurements import read_poses
from pincal.model.option import option
from pincal.show.many import montecarlo_lines
from pincal.words.numbers import reading_in

_Rows = Annotated[
    Path, output_option("TABLE", "Table with a row of each machine, .csv or .parquet.")
]


@dataclass(frozen=True)
class MachinesOptions(Workers, PlanOptions):
    """Which machines are drawn, and what is looked at."""

    machines: int = option(1000, "How many machines are drawn.", least=1)
    workspace: Path | None = option(
        None, "Poses over which errors are stated [default: 200 of the workspace].", metavar="CSV"
    )


@command
def montecarlo_(
    mech: Mech,
    plan: Annotated[Path, typer.Argument(metavar="PLAN.csv", help="Poses to measure.")],
    output: _Rows,
    options: Options,
    noise: Noise,
    drawn: MachinesOptions,
) -> None:
    """Predict the accuracy that tolerances will give.

    Machines are drawn (--tolerance, --priors), measured along the plan with noise, and calibrated
    as 'pincal calibrate' does it with the same options. Printed are the errors of the platform over
    the workspace before and after, and which tolerance makes them.

    The table grows while it is made, and is the same however many workers make it: the same command
    goes on where it ended. Without --tolerance, parameters differ by 0.001 of the machine's size,
    or 0.001.
    """
    mechanism = load_mechanism(mech)
    setup = drawn.read_setup()
    options = replace(options, setup=setup, priors=options.priors_of(mechanism.parameters))
    measured = None if drawn.measure is None else drawn.measured(mechanism, setup)
    with working("calibrating machines") as progress:
        study = montecarlo(
            mechanism,
            read_poses(plan, mechanism, setup=setup),
            drawn.machines,
            output,
            drawn.workers,
            drawn.scheduler,
            noise=with_reading_noise(noise, mechanism),
            options=replace(options, progress=progress),
            workspace=drawn.workspace,
            measured=measured,
            seed=drawn.seed,
        )
    with reading_in(drawn.written_in(mechanism).printed):
        for line in montecarlo_lines(study):
            stdout.print(line)
    wrote(output)
    say(f"next: pincal identifiability {mech} {plan}")
    if any(study.columns[FAILURE]):
        fail(1, "exit code 1, since machines have no result")
