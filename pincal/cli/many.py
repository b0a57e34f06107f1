"""``pincal montecarlo``, ``batch``, ``history``: many machines, and one over months."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import Annotated

import typer

from pincal import FileError, Noise, Options, Plan, load_mechanism, montecarlo
from pincal.calibration.calibrate import run
from pincal.calibration.history import history_of
from pincal.calibration.many import Workers, add_rows
from pincal.calibration.options import By
from pincal.cli.app import command, fail, say, typed, warn, working, wrote
from pincal.cli.calibration import InputOptions, again
from pincal.cli.options import Force, Mech, PlanOptions, offered, output_option
from pincal.design.planning import with_reading_noise
from pincal.design.simulate import ERROR
from pincal.files.journal import FAILURE, Row, RowFile
from pincal.files.measurements import read_poses
from pincal.option import Option, option
from pincal.show.many import (
    HistoryPage,
    batch_lines,
    montecarlo_lines,
    row_columns,
    row_of_result,
)
from pincal.words.numbers import amount

_Rows = Annotated[
    Path, output_option("TABLE", "Table with a row of each machine, .csv or .parquet.")
]
_WORKSPACE = Option(
    "Poses over which errors are stated [default: 200 of the workspace].", metavar="CSV"
)


@contextmanager
def _growing(table: Path) -> Iterator[Callable[[str], None]]:
    """Show how a table grows; Ctrl-C says how to go on."""
    try:
        with working("calibrating machines") as progress:
            yield progress
    except KeyboardInterrupt:
        fail(130, f"stopped; {table} keeps what is done. To go on: {typed()}")
    wrote(table)


@dataclass(frozen=True)
class MachinesOptions(Workers, PlanOptions):
    """Which machines are drawn, and what is looked at."""

    machines: int = option(1000, "How many machines are drawn.", least=1)
    workspace: Path | None = option(None, _WORKSPACE)


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
    mechanism, setup = load_mechanism(mech), drawn.read_setup()
    options = replace(options, setup=setup, priors=options.priors_of(mechanism.parameters))
    if not options.priors_by_name(mechanism):
        size = amount(ERROR * mechanism.size, "m").replace(" ", "")
        warn(f"no --tolerance: machines are drawn as by --tolerance {size},1mrad,0.001")
    planned = read_poses(plan, mechanism, setup=setup)
    with _growing(output) as progress:
        study = montecarlo(
            mechanism,
            planned,
            drawn.machines,
            output,
            drawn.workers,
            drawn.scheduler,
            noise=with_reading_noise(noise, mechanism),
            options=replace(options, progress=progress),
            workspace=drawn.workspace,
            measured=None if drawn.measure is None else drawn.measured(mechanism, setup),
            seed=drawn.seed,
        )
    say(*montecarlo_lines(study))
    planning = {field.name for field in fields(PlanOptions)}
    dropped = [field for field in fields(MachinesOptions) if field.name not in planning]
    say(f"next: {again('identifiability', dropped=(*dropped, *fields(Options)))}")
    if any(study.columns[FAILURE]):
        fail(1, "exit code 1, since machines have no result")


@dataclass(frozen=True)
class BatchOptions(Workers):
    """What is made of each file, and by whom."""

    by: By = option("region", "What is held out together: regions, rows in turn, or runs.")
    workspace: Path | None = option(None, _WORKSPACE)
    results: Path | None = option(
        None, "Folder for a result of each machine, as 'pincal calibrate' writes it."
    )


def _row(
    mech: str,
    folder: Path,
    options: Options,
    known: InputOptions,
    running: BatchOptions,
    workspace: Plan | None,
    *file: str,
) -> Row:
    """Return the row of a file, by its name in a folder."""
    result, *_ = run(known.calibration(mech, folder / file[0], options), options.folds, running.by)
    if running.results is not None:
        running.results.mkdir(parents=True, exist_ok=True)
        result.save(running.results / Path(file[0]).stem, force=True)
    return row_of_result(result, workspace)


@command
def batch(
    mech: Mech,
    folder: Annotated[
        Path, typer.Argument(metavar="FOLDER", help="A CSV or .xlsx of each machine.")
    ],
    output: _Rows,
    options: Options,
    known: InputOptions,
    running: BatchOptions,
) -> None:
    """Calibrate many machines, each from its table.

    All of one mechanism: the table has a row of each file with verdict, accuracy, χ² and
    parameters, or why it has no result. Machines whose parameters lie outside the control limits of
    the others are named. The table grows: files that are added later are done by the same command,
    those that changed again. Exit code 1 if a machine has no result, or a bad one.
    """
    mechanism = load_mechanism(mech)
    files = sorted(path for path in folder.glob("*") if path.suffix.lower() in (".csv", ".xlsx"))
    if not (files := [path for path in files if path.resolve() != output.resolve()]):
        raise FileError(f"{folder} has no tables; expected a .csv or .xlsx of each machine")
    items = [(path.name, sha256(path.read_bytes()).hexdigest()[:12]) for path in files]
    over = running.workspace
    poses = None if over is None else read_poses(over, mechanism)
    make_row = partial(_row, mech, folder, options, known, running, poses)
    with _growing(output) as progress:
        file = RowFile(output, row_columns(mechanism))
        columns = add_rows(make_row, items, file, running, progress)
    lines, bad = batch_lines(columns, mechanism)
    say(*lines)
    if bad:
        measured, dropped = (folder, folder / bad[0]), fields(BatchOptions)
        say(f"next: {again('doctor', measured=measured, dropped=dropped)}")
        fail(1, "exit code 1, since machines have no result, or a bad one")
    if running.results is None:
        say(f"next: {typed()} --results RESULTS")
    else:
        first = running.results / Path(items[0][0]).stem
        say(f"next: pincal deploy {shlex.quote(str(first))} -o controller")


@command
def history(
    results: Annotated[
        list[Path],
        typer.Argument(metavar="RESULTS", help="Results of 'calibrate', or folders of them."),
    ],
    output: Annotated[
        Path | None, output_option("HISTORY.html", "Page with charts of the parameters.")
    ] = None,
    accuracy: Annotated[
        float | None,
        offered("accuracy", Option("Root mean square error to stay within.", unit="m rad")),
    ] = None,
    force: Force = False,
) -> None:
    """See what changed on a machine over months.

    Its calibrations, dated by their folders' names (2026-03-31), are compared by the joint
    covariance of their parameters: what changed is named, and what would explain it as well. With
    --accuracy: until when the drift leaves the machine within it. Exit code 1 if it changed.
    """
    page = HistoryPage(history_of(results), accuracy)
    say(*page.lines)
    if output is not None:
        wrote(page.save(output, force=force))
    step = "pincal deploy RESULT -o controller" if output else f"{typed()} -o HISTORY.html"
    say(f"next: {step}")
    if any(page.history.changes):
        fail(1, "exit code 1, since the machine changed")
