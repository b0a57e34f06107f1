"""``pincal montecarlo``, ``batch``, ``history``: many machines, and one machine over months."""

import shlex
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from hashlib import sha256
from os.path import realpath
from pathlib import Path
from typing import Annotated

import typer

from pincal import FileError, Noise, Options, Plan, load_mechanism, montecarlo
from pincal.calibration.calibrate import run
from pincal.calibration.history import history_of
from pincal.calibration.many import Workers, add_rows
from pincal.calibration.options import By
from pincal.cli.app import command, fail, retyped, say, typed, warn, working, wrote
from pincal.cli.calibration import InputOptions
from pincal.cli.options import Force, Mech, PlanOptions, offered, output_option
from pincal.design.planning import with_reading_noise
from pincal.design.simulate import ERROR
from pincal.files.journal import FAILURE, Row, RowFile
from pincal.files.measurements import read_poses
from pincal.model.checks import listed
from pincal.option import Option, option
from pincal.show.many import HistoryPage, batch_lines, montecarlo_lines, row_columns, row_of_result
from pincal.words.numbers import amount

_Rows = Annotated[Path, output_option("TABLE", "CSV table with a row for each machine.")]
_WORKSPACE = Option(
    "Poses over which errors are stated [default: 200 in the workspace].", metavar="CSV"
)


@contextmanager
def _growing(table: Path) -> Iterator[Callable[[str], None]]:
    """Show the progress of a table; on Ctrl-C print the command that continues it."""
    try:
        with working("calibrating machines") as progress:
            yield progress
    except KeyboardInterrupt:
        fail(130, f"stopped; {table} keeps the machines done. To continue: {typed()}")
    wrote(table)


@dataclass(frozen=True)
class MachinesOptions(Workers, PlanOptions):
    """Options on the machines drawn, and on their errors."""

    machines: int = option(1000, "Number of machines that are drawn.", least=1)
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

    Machines are drawn at random (--tolerance, --priors), measured along the plan with noise, and
    calibrated as by 'pincal calibrate' with the same options. Prints the errors of the platform
    over the workspace before and after, and the share of each tolerance in them.

    The table grows row by row and does not depend on the number of workers: after a stop the same
    command continues. Without --tolerance, standard deviations are 0.001 of the machine's size for
    lengths, 0.001 otherwise.
    """
    mechanism, setup = load_mechanism(mech), drawn.read_setup()
    options = replace(options, setup=setup, priors=options.priors_of(mechanism.parameters))
    if not options.priors_by_name(mechanism):
        size = amount(ERROR * mechanism.size, "m").replace(" ", "")
        warn(f"no --tolerance: machines are drawn with --tolerance {size},1mrad,0.001")
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
    say(f"next: {retyped('identifiability')}")
    if any(study.columns[FAILURE]):
        fail(1, "exit code 1, since machines have no result")


@dataclass(frozen=True)
class BatchOptions(Workers):
    """Options on the calibration of each file, and on workers."""

    by: By = option("region", "Rows that are held out together: regions, rows in turn, or runs.")
    workspace: Path | None = option(None, _WORKSPACE)
    results: Path | None = option(
        None, "Folder for the result of each machine, as 'pincal calibrate' writes it."
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
    """Calibrate by a file, named in a folder, and return its row of the table."""
    result, *_ = run(known.calibration(mech, folder / file[0], options), options.folds, running.by)
    if running.results is not None:
        running.results.mkdir(parents=True, exist_ok=True)
        result.save(running.results / Path(file[0]).stem, force=True)
    return row_of_result(result, workspace)


@command
def batch(
    mech: Mech,
    folder: Annotated[
        Path, typer.Argument(metavar="FOLDER", help="Folder with a CSV or .xlsx of each machine.")
    ],
    output: _Rows,
    options: Options,
    known: InputOptions,
    running: BatchOptions,
) -> None:
    """Calibrate many machines, each from its table.

    All machines are of one mechanism. TABLE has a row for each file with verdict, accuracy, χ² and
    parameters, or the reason why there is no result. Machines with parameters outside the control
    limits of the others are named. The same command adds rows for new and changed files later. Exit
    code 1 if a machine has no result, or a bad one.
    """
    mechanism = load_mechanism(mech)
    in_folder = sorted(p for p in folder.glob("[!.]*") if realpath(p) != realpath(output))
    files = [p for p in in_folder if p.suffix.lower() in (".csv", ".xlsx") and not p.is_fifo()]
    if skipped := [path.name for path in in_folder if not (path.is_dir() or path in files)]:
        warn(f"skipped, since it is no .csv or .xlsx: {listed(skipped)}")
    if not files:
        raise FileError(f"{folder} has no tables; expected a .csv or .xlsx for each machine")
    items = [(path.name, sha256(path.read_bytes()).hexdigest()[:12]) for path in files]
    poses = None if (over := running.workspace) is None else read_poses(over, mechanism)
    make_row = partial(_row, mech, folder, options, known, running, poses)
    with _growing(output) as progress:
        file = RowFile(output, row_columns(mechanism))
        columns = add_rows(make_row, items, file, running, progress)
    lines, bad = batch_lines(columns, mechanism)
    say(*lines)
    if bad:
        say(f"next: {retyped('doctor', measured=(folder, folder / bad[0]))}")
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
        float | None, offered("accuracy", Option("Largest RMS error allowed.", unit="m rad"))
    ] = None,
    force: Force = False,
) -> None:
    """See what changed on a machine over months.

    Its calibrations, dated by their folders' names (2026-03-31), are compared by the joint
    covariance of their parameters: changed parameters are named, with those that explain a change
    equally well. With --accuracy: when the drift will exceed it. Exit code 1 if it changed.
    """
    page = HistoryPage(history_of(results), accuracy)
    say(*page.lines)
    if output is not None:
        wrote(page.save(output, force=force))
    cause = "find what moved, then " * (changed := any(page.history.changes))
    use = f"{cause}pincal deploy RESULT -o controller"
    say(f"next: {use if output else f'{typed()} -o HISTORY.html'}")
    if changed:
        fail(1, "exit code 1, since the machine changed")
