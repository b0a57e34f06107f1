"""``pincal bench``: how long people wait on this machine, beside what the work itself needs."""

from __future__ import annotations

from typing import Annotated

import typer

from pincal.cli.app import answer, command, stdout, working
from pincal.cli.waits import Wait, measure, tasks
from pincal.words.table import Table, columns


@command(answers=True)
def bench(
    names: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="TASK", help="Tasks by the names of the table, such as command-help; else all."
        ),
    ] = None,
    runs: Annotated[int, typer.Option(min=1, help="Runs of each, of which the median counts.")] = 3,
) -> None:
    """Time what people wait for, on this machine.

    Selections, samples, calibrations and commands, each beside the time of something that shows
    how quick it could be. Takes about a minute; other work on the machine makes it longer.
    """
    every = list(tasks())
    known = [task.name for task in every]
    for name in names or ():
        if name not in known:
            raise typer.BadParameter(f"no task {name!r}; expected some of {', '.join(known)}")
    found = []
    for task in every:
        if not names or task.name in names:
            with working(task.what):
                found.append(measure(task, runs))
    stdout.print(waits_table(found))
    answer({"waits": [vars(one) for one in found]})


def waits_table(found: list[Wait]) -> Table:
    """Return a table of waits and their limits."""
    rows = []
    for one in found:
        ratio = None if one.least is None else one.seconds / one.least
        rows.append((one.name, one.what, one.seconds, one.least, ratio, one.limit))
    return Table(
        "What people wait for, on this machine",
        columns("task", "what", "time [s]:.3g", "could be [s]:.3g", "ratio:.3g", "as quick as"),
        rows,
        "medians; what a task could be is no promise: it shows how much of the time is its own",
    )
