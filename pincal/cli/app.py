"""The application, and what its commands share: consoles, options, progress."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

_WIDTH = None if sys.stdout.isatty() else 100  # of tables in a file or pipe
stdout = Console(highlight=False, width=_WIDTH)
stderr = Console(stderr=True, highlight=False, soft_wrap=True)

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,  # so that [m] in a help text stays
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Kinematic calibration of parallel robots: which poses to measure, what the parameters "
    "are, and how sure that is.\n\nMECH is the name of a bundled mechanism (see 'pincal "
    "mechanisms') or a mechanism folder. Tables are CSV files whose headers carry units, such as "
    "'x [mm]', 'phi [deg]', 'leg_1 [rad]'. See it all at work with 'pincal demo'.",
)


def _version(wanted: bool) -> None:
    if wanted:
        stdout.print(f"pincal {version('pincal')}")
        raise typer.Exit


@app.callback()
def _main(
    version: Annotated[
        bool, typer.Option("--version", is_eager=True, callback=_version, help="Show the version.")
    ] = False,
) -> None:
    pass


Mech = Annotated[str, typer.Argument(metavar="MECH", help="Bundled mechanism or folder.")]
Force = Annotated[bool, typer.Option("--force", help="Replace the output if it exists.")]
Seed = Annotated[int, typer.Option("--seed", min=0, help="Seed of all random choices.")]
Count = Annotated[int, typer.Option("--count", min=1, help="Number of poses.")]


def output_option(metavar: str, text: str) -> typer.models.OptionInfo:
    """Return the ``-o`` option of a command."""
    option: typer.models.OptionInfo = typer.Option("-o", "--output", metavar=metavar, help=text)
    return option


@contextmanager
def working(text: str) -> Iterator[Callable[[str], None]]:
    """Show what is being done: a spinner on a terminal, plain lines elsewhere (stderr).

    Yields a function that changes the text.
    """
    if stderr.is_terminal:
        with stderr.status(text) as status:
            yield lambda now: status.update(now)
    else:
        stderr.print(f"{text} …", markup=False)
        yield lambda _: None


@contextmanager
def counting(text: str, total: int) -> Iterator[Callable[[int], None]]:
    """Show a bar with count and remaining time on a terminal, a plain line elsewhere (stderr).

    Yields a function that takes how much is done.
    """
    if not stderr.is_terminal:
        stderr.print(f"{text} …", markup=False)
        yield lambda _: None
        return
    columns = (TextColumn(text), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=stderr, transient=True) as progress:
        task = progress.add_task(text, total=total)
        yield lambda done: progress.update(task, completed=done)


def wrote(path: str | Path) -> None:
    """Say which file was written."""
    stderr.print(f"wrote {path}", markup=False)
