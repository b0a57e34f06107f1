"""``pincal measure``: a session beside the robot, in a terminal or on a page."""

from __future__ import annotations

import json
import socket
import sys
import time
import webbrowser
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from threading import Event, Lock
from typing import Annotated, TextIO

import typer

import pincal
from pincal import FileError, MeasurementError, Mechanism, Noise, Setup
from pincal.calibration.session import Session, SessionOptions
from pincal.cli.app import command, fail, say, stdout, warn, working
from pincal.cli.options import Mech, PlanOptions
from pincal.design.planning import sampled, with_reading_noise
from pincal.files.columns import columns_of
from pincal.files.measurements import read_poses
from pincal.files.table import write_table
from pincal.option import option
from pincal.show.measuring import obeyed, progress, responding, set_points
from pincal.show.view.view import PageServer
from pincal.words.numbers import percent

_CANDIDATES = 500  # poses, where no plan is given
_PATIENCE = 5.0  # seconds in which an instrument must take the call
_OFF = 10  # rows in a row off, after which a source is asked no more
_WAIT = 0.2  # seconds between two looks at a file that grows
_HELP = (
    "enter what was measured, in the columns' order; readings that are left out are those "
    "commanded. u: undo the last row, u 3 the third; s: skip this pose; r 12: measure row 12; p: "
    "parameters; q: quit (the same command goes on)"
)
Ask = Callable[[dict[str, float]], str]
"""Returns the line that a source gives at set points."""


@dataclass(frozen=True)
class SourceOptions:
    """Where poses and measurements come from, and where they are shown."""

    plan: Path | None = option(
        None,
        "Poses to choose from, of 'pincal select'; else 500 are sampled from the workspace.",
        metavar="PLAN.csv",
    )
    terminal: bool = option(False, "Stay in the terminal, without a page.")
    open: bool = option(True, "Print the address without opening a browser.")
    follow: Path | None = option(None, "Take each line that a file grows by.", metavar="FILE")
    tcp: str | None = option(
        None, "Send set points as a line of JSON, take the line that answers.", metavar="HOST:PORT"
    )
    pattern: str | None = option(
        None,
        "What was measured is in the groups of this expression, by name or in order.",
        metavar="REGEX",
    )


@command
def measure(
    mech: Mech,
    session: Annotated[Path, typer.Option(metavar="FOLDER", help="Folder of the session.")],
    source: SourceOptions,
    session_options: SessionOptions,
    options: PlanOptions,
    noise: Noise,
) -> None:
    """Measure with the robot beside you.

    Says which pose to drive to, takes what was measured there, checks it at once, and says what
    error to expect and how many more poses it takes to --accuracy. FOLDER holds the plan and
    rows.csv, which 'pincal calibrate' reads; every row is on disk before it is shown. Stopped at
    any moment, the session goes on by the same command. On a page that is served to this machine
    alone, until Ctrl-C, or in the terminal.
    """
    mechanism, setup = pincal.load_mechanism(mech), options.read_setup()
    with working("looking at the poses"):
        opened = Session(
            session,
            mechanism,
            _plan(session / "plan.csv", mechanism, setup, source.plan, options.seed),
            replace(
                session_options,
                noise=with_reading_noise(noise, mechanism),
                setup=setup,
                measured=options.measured(mechanism, setup),
                units=options.written_in(mechanism),
            ),
        )
    try:
        with _source(source) as ask:
            if source.terminal:
                _in_terminal(opened, ask, source.pattern)
            else:
                _on_page(opened, ask, source)
    except (KeyboardInterrupt, EOFError):
        pass
    finally:
        opened.journal.close()
        say(f"{len(opened.journal.rows)} rows in {opened.journal.path}")


def _plan(
    path: Path, mechanism: Mechanism, setup: Setup, source: Path | None, seed: int
) -> pincal.Plan:
    """Return the plan of a session's folder, written there if it is new.

    Raises:
        FileError: it cannot be written.
    """
    if not path.is_file():
        if source is None:
            plan = sampled(mechanism, setup, _CANDIDATES, seed)
        else:
            plan = read_poses(source, mechanism, setup=setup)
        try:
            path.parent.mkdir(exist_ok=True)
        except OSError as error:
            raise FileError(f"cannot make {path.parent}: {error.strerror or error}") from error
        write_table(path, columns_of(mechanism, plan))
    return read_poses(path, mechanism, setup=setup)


@contextmanager
def _source(options: SourceOptions) -> Iterator[Ask | None]:
    """Yield what asks for measurements, None if they are typed."""
    if options.follow is not None and options.tcp is not None:
        raise typer.BadParameter("--follow and --tcp both give measurements; leave one of them")
    host, _, port = (options.tcp or "").rpartition(":")
    if options.tcp is not None and not (host and port.isdecimal()):
        raise typer.BadParameter(f"--tcp {options.tcp}: expected HOST:PORT")
    try:
        if options.follow is not None:
            with options.follow.open(encoding="utf-8", errors="replace") as file:
                file.seek(0, 2)
                yield lambda _: _grown(file)
        elif options.tcp is not None:
            with socket.create_connection((host, int(port)), _PATIENCE) as line:
                line.settimeout(None)
                with line.makefile("rw", encoding="utf-8", newline="\n") as stream:
                    yield lambda points: _answer(stream, points)
        else:
            yield None
    except FileError:
        raise
    except OSError as error:
        raise FileError(f"{options.follow or options.tcp}: {error.strerror or error}") from error


def _grown(file: TextIO) -> str:
    """Return the next line of a file, once it is whole."""
    line = ""
    while not line.endswith("\n") or not line.strip():
        line = line.lstrip("\n") + file.readline()
        if not line.endswith("\n"):
            time.sleep(_WAIT)
    return line


def _answer(stream: TextIO, points: dict[str, float]) -> str:
    """Return the line by which a machine or an instrument answers set points."""
    stream.write(json.dumps(points) + "\n")
    stream.flush()
    line = "\n"
    while line.isspace():
        line = stream.readline()
    if not line:
        raise FileError("the other end hung up; start it again, then this command")
    if line.startswith('{"trouble"'):
        warn(f"the pose is skipped: {line.strip()}")
        return "s"
    return line


def _in_terminal(session: Session, ask: Ask | None, pattern: str | None) -> None:
    """Measure one pose after another, until the user leaves, or a source has given enough.

    With nobody there a row that is off is taken back, unless the one before was off as well, which
    speaks against earlier ones; so is one that all others contradict. No pose is measured twice.
    """
    if ask is None:
        say(_HELP)
    attended, chosen, off = ask is None or sys.stdin.isatty(), None, 0
    while not (ask and session.enough and not session.doubtful):
        if not attended and (session.questioned or session.doubtful):
            _settle(session, keep=off > 1)
            continue
        if ask and not session.questioned:
            _end_of_what_is_left(session, off)
        row, gain = session.next_pose()
        row = row if chosen is None else chosen
        line = _asked(session, row, gain, ask)
        try:
            chosen = _taken(session, line, row, pattern)
        except (MeasurementError, FileError) as error:
            if ask:
                raise
            warn(str(error))
        off = off + 1 if session.questioned else 0


def _end_of_what_is_left(session: Session, off: int) -> None:
    """End the command if no pose is left, or too many rows in a row were off."""
    if session.exhausted or off >= _OFF:
        last = f"the last {off} rows were off" if off >= _OFF else "no pose of the plan is left"
        fail(1, f"{last}, and it is not enough")


def _asked(session: Session, row: int, gain: float, ask: Ask | None) -> str:
    """Return what a source, or the user, answers at a row of the plan."""
    if session.questioned:
        return input("u: undo it, k: keep it > ")
    points = _shown(session, row, gain)
    return ask(points) if ask else input("> ")


def _settle(session: Session, *, keep: bool) -> None:
    """Keep the row that is off, or take it or the doubtful one back and skip its pose."""
    if session.questioned and keep:
        session.keep()
        return
    place = -1 if session.questioned or not session.doubtful else session.doubtful[0]
    row = session.measured[place]
    session.undo(place)
    session.skip(row)
    say(f"row {row + 1} of the plan is taken back, and comes no more", *progress(session))


def _taken(session: Session, line: str, row: int, pattern: str | None) -> int | None:
    """Do what a line says at a row of the plan; return the row that it chooses, if it does.

    Raises:
        EOFError: it says to leave.
        MeasurementError: it is no measurement.
    """
    match line.split():
        case []:
            return row
        case ["q"]:
            raise EOFError
        case ["p"]:
            stdout.print(session.result.tables()[0] if session.result else "nothing is known yet")
            return row
        case ["r", number] if number.isdecimal() and 0 < int(number) <= len(session.plan):
            return int(number) - 1
    say(*filter(None, (obeyed(session, line, row, pattern), *progress(session))))
    return None


def _shown(session: Session, row: int, gain: float) -> dict[str, float]:
    """Say what to drive to, and return it."""
    falls, points = f"; errors fall by {percent(gain)}" * (gain > 0.0), set_points(session, row)
    say(f"\nrow {row + 1} of {len(session.plan)}{falls}. Drive to")
    say("  " + ", ".join(f"{head} {value:.7g}" for head, value in points.items()))
    say(f"  then {', '.join(session.observed or session.columns)}:")
    return points


def _on_page(session: Session, ask: Ask | None, options: SourceOptions) -> None:
    """Serve the page, on which somebody measures, or watches a source."""
    lock = Lock()
    server = PageServer(responding(session, options.pattern, lock))
    say(server.url)
    sys.stdout.flush()
    if options.open and not webbrowser.open(server.url):
        warn("no browser opened; open the address above in one")
    try:
        while ask and not session.enough and not session.exhausted:
            if session.questioned:  # on the page
                time.sleep(_WAIT)
                continue
            row, _ = session.next_pose()
            line = ask(set_points(session, row))
            with lock:
                obeyed(session, line, row, options.pattern)
        Event().wait()
    finally:
        server.close()
