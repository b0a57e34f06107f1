"""``pincal measure``: a session beside the robot.

``--tcp`` sends set points as a line of JSON (``{"leg_1 [mm]": 812.4, …}``), and receives the
measurements there as a line. A person, a growing file and a machine are treated alike: each gives
one line per pose.
"""

import json
import os
import shlex
import socket
import sys
import time
import webbrowser
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, fields, replace
from pathlib import Path
from threading import Event, Lock
from typing import Annotated, Any, BinaryIO, TextIO, get_args

import typer

import pincal
from pincal import FileError, MeasurementError, Mechanism, Noise
from pincal.calibration.session import Session, SessionOptions
from pincal.cli.app import command, fail, remark, say, stdout, typed, warn, working
from pincal.cli.options import Mech, PlanOptions, TableOptions, option_parameters, typed_name
from pincal.design.planning import sampled, with_reading_noise
from pincal.errors import explaining
from pincal.files.columns import columns_of
from pincal.files.journal import Journal
from pincal.files.measurements import read_poses
from pincal.files.table import write_table
from pincal.option import option
from pincal.show.measuring import obeyed, progress, responding, set_points, verdict_on_row
from pincal.show.view.view import PageServer
from pincal.words.numbers import percent

_CANDIDATES = 500  # number of poses without a plan
_IN_JSON: dict[type, Any] = {float: (float, int), Path: str}
_PATIENCE = 5.0  # seconds in which an instrument must accept the connection
_OFF = 10  # successive rows that are off, after which a source is not asked again
_WAIT = 0.2  # seconds between two looks at a growing file
_HELP = (
    "enter the measurements, in the order of the columns; readings left out are taken as "
    "commanded. u: undo the last row, u 3: row 3; s: skip this pose; r 12: go to pose 12 of the "
    "plan; p: parameters; h: help; q: quit ('pincal measure MECH --session FOLDER' continues)"
)
Ask = Callable[[dict[str, float]], str]
"""Function that sends set points to a source and returns its line."""


@dataclass(frozen=True)
class SourceOptions:
    """Options on the sources of poses and measurements, and on the page."""

    plan: Path | None = option(
        None,
        "Poses to choose from, by 'pincal select' [default: 500 samples of the workspace].",
        metavar="PLAN.csv",
    )
    terminal: bool = option(False, "Stay in the terminal, without a page.")
    open: bool = option(True, "Print the address without opening a browser.")
    follow: Path | None = option(None, "Read each line appended to a file.", metavar="FILE")
    tcp: str | None = option(
        None, "Send set points as a line of JSON, and read a line in answer.", metavar="HOST:PORT"
    )
    pattern: str | None = option(
        None,
        "Regular expression whose groups are the measurements, by name or in order.",
        metavar="REGEX",
    )


@dataclass(frozen=True)
class MeasuredOptions(TableOptions, PlanOptions):
    """Options on the measured quantities, and on units of output."""


@command
def measure(
    mech: Mech,
    session: Annotated[Path, typer.Option(metavar="FOLDER", help="Folder of the session.")],
    source: SourceOptions,
    session_options: SessionOptions,
    options: MeasuredOptions,
    noise: Noise,
) -> None:
    """Measure with the robot beside you.

    Names the pose to drive to, takes the measurements there, checks them at once, and prints the
    expected error and the number of further poses to --accuracy. FOLDER holds the plan, the options
    and rows.csv, which 'pincal calibrate' reads; every row is on disk before it is shown. After any
    stop, 'pincal measure MECH --session FOLDER' continues the session. It runs in the terminal, or
    on a page that is served to this machine alone, until Ctrl-C.
    """
    mechanism, path = pincal.load_mechanism(mech), session / "plan.csv"
    groups = session_options, options, noise
    with working("looking at the poses"), _remembered(session, mechanism, *groups) as remembered:
        journal, session_options, options, noise = remembered
        setup = options.read_setup()
        if not path.is_file():
            if source.plan is None:
                plan = sampled(mechanism, setup, _CANDIDATES, options.seed)
            else:
                plan = read_poses(source.plan, mechanism, setup=setup)
            write_table(path, columns_of(mechanism, plan))
        elif source.plan is not None:
            remark(f"--plan is not read: the session goes on with the poses of {path}")
        noise = with_reading_noise(noise, mechanism)
        words = ["pincal", "calibrate", mech, str(session / "rows.csv")]
        words += ["--setup", str(options.setup_file)] * (options.setup_file is not None)
        words += ["--unknown-frame"] * options.unknown_frame
        words += ["--unknown-target"] * options.unknown_target
        for name, sigma in vars(noise).items():
            words += [f"--noise-{name}", f"{sigma:.12g}"] * (name != "pixel" or bool(setup.pixels))
        asked = replace(
            session_options,
            following=f"next: {shlex.join([*words, '-o', 'RESULT'])}",
            noise=noise,
            setup=setup,
            measured=options.measured(mechanism, setup),
            units=options.written_in(mechanism),
        )
        opened = Session(journal, mechanism, read_poses(path, mechanism, setup=setup), asked)
    lock, server = Lock(), None
    if opened.checked:
        say(verdict_on_row(opened.checked), *progress(opened))
    try:
        if not source.terminal:
            server = PageServer(responding(opened, source.pattern, lock))
            say(server.url)
            sys.stdout.flush()
            if source.open and not webbrowser.open(server.url):
                warn("no browser opened; open the address above in one")
        with _source(source) as ask:
            _measure(opened, ask, source, lock)
    except (KeyboardInterrupt, EOFError):
        pass
    finally:
        if server:
            server.close()
        journal.close()
        say(f"{len(journal.rows)} rows in {journal.path}", *[asked.following] * bool(journal.rows))


@contextmanager
def _remembered(folder: Path, mechanism: Mechanism, *groups: Any) -> Iterator[list[Any]]:
    """Yield the journal of a folder, and options as typed, else as stored there; store them.

    The folder is locked before anything is read there; a new one is removed if anything fails.

    Raises:
        FileError: the session is open in another process, or is of another machine, or options
            cannot be read or written.
    """
    path, journal = folder / "options.json", Journal(folder)
    with ExitStack() as undo:
        undo.callback(journal.close)
        undo.callback(journal.withdraw)
        with explaining(f"delete {path}, and type its options again", Exception):
            before = path.read_text("utf-8") if path.is_file() else "{}"
            stored: dict[str, Any] = json.loads(before)
            drawn = {parameter.id: parameter.nominal for parameter in mechanism.parameters}
            name, values = stored.setdefault("mechanism", [mechanism.name, drawn])
            if values != drawn:
                raise FileError(
                    f"{folder} is a session of {name!r}, and {mechanism.name!r} has other "
                    f"parameters; measure {name!r}, or name another folder (--session)"
                )
            known = [_as_stored(g, stored.setdefault(type(g).__name__, {})) for g in groups]
        yield [journal, *known]
        new, text = path.with_suffix(".new"), json.dumps(stored, indent=1)
        if text != before:
            new.write_text(text, encoding="utf-8")
            new.replace(path)
        undo.pop_all()


def _as_stored(group: Any, known: dict[str, Any]) -> Any:
    """Return options as typed, else as known; add the typed ones to the known ones."""
    stored, words = {}, [word.partition("=")[0] for word in shlex.split(typed())]
    columns = [column for column in fields(group) if "option" in column.metadata]
    for column, parameter in zip(columns, option_parameters(type(group)), strict=True):
        name, value = column.name, getattr(group, column.name)
        if f"--{typed_name(column)}" in words:
            value = str(value.absolute()) if isinstance(value, Path) else value
            if (former := known.get(name, value)) != value:
                warn(f"--{typed_name(column)} was {former} so far and is now {value}")
            known[name] = value
        if name in known:
            kinds = get_args(parameter.annotation.__origin__ | None)
            if not isinstance(known[name], tuple(_IN_JSON.get(kind, kind) for kind in kinds)):
                raise TypeError(f"{name} is {known[name]!r}")
            stored[name] = known[name]
    return replace(group, **stored)


@contextmanager
def _source(options: SourceOptions) -> Iterator[Ask | None]:
    """Yield the function that asks a source for measurements; None if they are typed."""
    host, _, port = (options.tcp or "").rpartition(":")
    if options.follow is not None and options.tcp is not None:
        raise typer.BadParameter("--follow and --tcp both give measurements; leave out one of them")
    if options.tcp is not None and not (host and port.isdecimal()):
        raise typer.BadParameter(f"--tcp {options.tcp}: expected HOST:PORT")
    with explaining(str(options.follow or options.tcp)):
        if options.follow is not None:
            lines = _appended(options.follow, options.follow.stat().st_size)
            yield lambda _: next(lines)
        elif options.tcp is not None:
            with socket.create_connection((host, int(port)), _PATIENCE) as line:
                line.settimeout(None)
                with line.makefile("rw", encoding="utf-8", newline="\n") as stream:
                    yield lambda points: _answer(stream, points)
        else:
            say(*[_HELP] * options.terminal)
            yield None


def _appended(path: Path, start: int) -> Iterator[str]:
    """Yield the lines by which a file grows from its start, and all lines when it begins anew."""
    while True:
        with path.open("rb") as file:
            file.seek(start)
            line = b""
            while not _replaced(path, file):
                line = line.lstrip() + file.readline()
                if not line.endswith(b"\n"):
                    time.sleep(_WAIT)
                elif not line.isspace():
                    yield line.decode(errors="replace")
                    line = b""
        warn(f"{path} begins anew, and is read from its beginning")
        start = 0


def _replaced(path: Path, file: BinaryIO) -> bool:
    """Return whether a path is another file than the open one, or shorter than what was read."""
    try:
        now = path.stat()
    except FileNotFoundError:  # a log that rotates is renamed, then made again
        return False
    return not os.path.samestat(os.fstat(file.fileno()), now) or now.st_size < file.tell()


def _answer(stream: TextIO, points: dict[str, float]) -> str:
    """Return the line that answers set points.

    Raises:
        FileError: the other end closed the connection.
    """
    stream.write(json.dumps(points) + "\n")
    stream.flush()
    line = "\n"
    while line.isspace():
        line = stream.readline()
    if not line.endswith("\n"):
        raise FileError("the other end hung up; start it again, then this command")
    if line.startswith('{"trouble"'):
        warn(f"the pose is skipped: {line.strip()}")
        return "s"
    return line


def _measure(session: Session, ask: Ask | None, source: SourceOptions, lock: Lock) -> None:
    """Measure one pose after another, until the user leaves, or a source has given all.

    The user decides on a row that is off, on the page or in the terminal. Unattended, it is undone,
    unless the row before was off as well, which speaks against earlier rows; so is a row that all
    others contradict. No pose is measured twice.
    """
    on_page, off = not source.terminal, 0
    attended = ask is None or on_page or sys.stdin.isatty()
    while ask or not on_page:
        if (session.questioned or session.doubtful) and not attended:
            _settle(session, keep=off > 1)
        elif ask and session.finished:
            if session.missing:
                fail(1, "no pose of the plan is left, but the accuracy is not reached")
            break
        elif session.questioned and on_page:
            time.sleep(_WAIT)
        else:
            row, line = _asked(session, ask, off)
            with lock:
                _take(session, line, row, source.pattern, strict=ask is not None)
            off = off + 1 if session.questioned else 0
    if on_page:
        Event().wait()


def _asked(session: Session, ask: Ask | None, off: int) -> tuple[int, str]:
    """Return the next row of the plan, and the line that a source or the user enters there."""
    row, gain = session.next_pose()
    if session.questioned:
        return row, input("enter it again, or u: undo it, k: keep it > ")
    if ask and off >= _OFF:
        fail(1, f"the last {off} rows were off, but the accuracy is not reached")
    points, falls = set_points(session, row), f"; errors fall by {percent(gain)}" * (gain > 0.0)
    say(f"\npose {row + 1} of {len(session.plan)}{falls}. Drive to")
    say("  " + ", ".join(f"{head} {value:.7g}" for head, value in points.items()))
    say(f"  then {', '.join(session.observed or session.columns)}:")
    return row, ask(points) if ask else input("> ")


def _take(session: Session, line: str, row: int, pattern: str | None, *, strict: bool) -> None:
    """Execute a line; a faulty one is a warning, or ends the command if a source sent it.

    Raises:
        EOFError: the line says to quit.
    """
    match line.split():
        case ["q"]:
            raise EOFError
        case ["h" | "?" | "help"]:
            say(_HELP)
        case ["p"]:
            stdout.print(session.result.tables()[0] if session.result else "nothing is known yet")
        case [_, *_]:
            try:
                say(*obeyed(session, line, row, pattern))
            except (MeasurementError, FileError) as error:
                if strict and not session.questioned:  # then it was typed
                    raise
                warn(str(error))


def _settle(session: Session, *, keep: bool) -> None:
    """Keep the row that is off, or undo it (or the doubtful row) and skip its pose."""
    if session.questioned and keep:
        session.keep()
        return
    last = len(session.measured) - 1
    place = last if session.questioned or not session.doubtful else session.doubtful[0]
    row = session.measured[place]
    session.undo(place)
    session.skip(row)
    say(f"pose {row + 1} is undone, and not asked for again", *progress(session))
