"""``pincal measure``: a session beside the robot; and the machine of ``pincal simulate --serve``.

``--tcp`` sends set points as a line of JSON (``{"leg_1 [mm]": 812.4, …}``), and receives the
measurements there as a line. A person, a growing file and a machine are treated alike: each gives
one line per pose.
"""

from __future__ import annotations

import json
import shlex
import shutil
import socket
import sys
import time
import webbrowser
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, fields, replace
from pathlib import Path
from socketserver import StreamRequestHandler, TCPServer
from threading import Event, Lock
from typing import Annotated, Any, TextIO, get_args

import numpy as np
import typer

import pincal
from pincal import FileError, MeasurementError, Mechanism, Noise, PincalError, Plan, Setup
from pincal.calibration.session import Session, SessionOptions
from pincal.cli.app import command, fail, remark, say, stdout, warn, working
from pincal.cli.options import Mech, PlanOptions, TableOptions, option_parameters, typed_name
from pincal.design.planning import sampled, with_reading_noise
from pincal.errors import explaining
from pincal.files.columns import columns_of, reading_units
from pincal.files.measurements import read_poses
from pincal.files.table import TextTable, write_table
from pincal.option import option
from pincal.show.measuring import obeyed, progress, responding, set_points
from pincal.show.view.view import PageServer
from pincal.words.numbers import Units, percent

_CANDIDATES = 500  # number of poses without a plan
_IN_JSON: dict[type, Any] = {float: (float, int), Path: str}
_PATIENCE = 5.0  # seconds in which an instrument must accept the connection
_OFF = 10  # successive rows that are off, after which a source is not asked again
_WAIT = 0.2  # seconds between two looks at a growing file
_SLIP = 10.0  # size of a simulated slip, in standard deviations
_HELP = (
    "enter the measurements, in the order of the columns; readings left out are taken as "
    "commanded. u: undo the last row, u 3: row 3; s: skip this pose; r 12: go to pose 12 of the "
    "plan; p: parameters; q: quit ('pincal measure MECH --session FOLDER' continues)"
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
    with working("looking at the poses"), _remembered(session, mechanism, *groups) as groups:
        session_options, options, noise = groups
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
        for name in ("position", "orientation", "reading"):
            words += [f"--noise-{name}", f"{getattr(noise, name):g}"]
        asked = replace(
            session_options,
            following=f"next: {shlex.join([*words, '-o', 'RESULT'])}",
            noise=noise,
            setup=setup,
            measured=options.measured(mechanism, setup),
            units=options.written_in(mechanism),
        )
        opened = Session(session, mechanism, read_poses(path, mechanism, setup=setup), asked)
    lock, server = Lock(), None
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
        opened.journal.close()
        say(f"{len(opened.journal.rows)} rows in {opened.journal.path}")
        say(*[asked.following] * bool(opened.journal.rows))


@contextmanager
def _remembered(folder: Path, mechanism: Mechanism, *groups: Any) -> Iterator[Any]:
    """Yield options as typed, else as stored in a session's folder; store them at the end.

    Raises:
        FileError: the session is of another machine, or options cannot be read or written.
    """
    path = folder / "options.json"
    with ExitStack() as undo:
        if not folder.exists():
            undo.callback(shutil.rmtree, folder, ignore_errors=True)
        folder.mkdir(exist_ok=True)
        with explaining(f"delete {path}, and type its options again", Exception):
            before = path.read_text("utf-8") if path.is_file() else "{}"
            stored: dict[str, Any] = json.loads(before)
            _check_machine(folder, stored, mechanism)
            known = [_as_stored(g, stored.setdefault(type(g).__name__, {})) for g in groups]
        yield known
        new, text = path.with_suffix(".new"), json.dumps(stored, indent=1)
        if text != before:
            new.write_text(text, encoding="utf-8")
            new.replace(path)
        undo.pop_all()


def _as_stored(group: Any, known: dict[str, Any]) -> Any:
    """Return options as typed, else as known; add the typed ones to the known ones."""
    default, stored = type(group)(), {}
    columns = [column for column in fields(group) if "option" in column.metadata]
    for column, parameter in zip(columns, option_parameters(type(group)), strict=True):
        name, value = column.name, getattr(group, column.name)
        if value != getattr(default, name):
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


def _check_machine(folder: Path, stored: dict[str, Any], mechanism: Mechanism) -> None:
    """Raise a FileError if a stored session is of another machine; else store this machine."""
    drawn = {parameter.id: parameter.nominal for parameter in mechanism.parameters}
    name, values = stored.setdefault("mechanism", [mechanism.name, drawn])
    if values != drawn:
        raise FileError(
            f"{folder} is a session of {name!r}, and {mechanism.name!r} has other parameters; "
            f"measure {name!r}, or name another folder (--session)"
        )


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
            with options.follow.open(encoding="utf-8", errors="replace") as file:
                file.seek(0, 2)
                yield lambda _: _line(file)
        elif options.tcp is not None:
            with socket.create_connection((host, int(port)), _PATIENCE) as line:
                line.settimeout(None)
                with line.makefile("rw", encoding="utf-8", newline="\n") as stream:
                    yield lambda points: _line(stream, points)
        else:
            say(*[_HELP] * options.terminal)
            yield None


def _line(stream: TextIO, points: dict[str, float] | None = None) -> str:
    """Return the next complete line of a file, or the line that answers set points.

    Raises:
        FileError: the other end closed the connection.
    """
    if points is not None:
        stream.write(json.dumps(points) + "\n")
        stream.flush()
    line = ""
    while not line.endswith("\n") or line.isspace():
        part = stream.readline()
        if not part and points is not None:
            raise FileError("the other end hung up; start it again, then this command")
        if not part:
            time.sleep(_WAIT)
        line = line.lstrip("\n") + part
    if line.startswith('{"trouble"'):
        warn(f"the pose is skipped: {line.strip()}")
        return "s"
    return line


def _measure(session: Session, ask: Ask | None, source: SourceOptions, lock: Lock) -> None:
    """Measure one pose after another, until the user leaves, or a source has given enough.

    The user decides on a row that is off, on the page or in the terminal. Unattended, it is undone,
    unless the row before was off as well, which speaks against earlier rows; so is a row that all
    others contradict. No pose is measured twice.
    """
    on_page, off = not source.terminal, 0
    attended = ask is None or on_page or sys.stdin.isatty()
    while ask or not on_page:
        doubted = session.questioned or session.doubtful
        if ask and session.enough and not session.doubtful:
            break
        if doubted and not attended:
            _settle(session, keep=off > 1)
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
        return row, input("u: undo it, k: keep it > ")
    exhausted = not session.candidates.fresh(session.measured).any()
    if ask and (exhausted or off >= _OFF):
        last = f"the last {off} rows were off" if off >= _OFF else "no pose of the plan is left"
        fail(1, f"{last}, but the accuracy is not reached")
    points = set_points(session, row)
    falls = f"; errors fall by {percent(gain)}" * (gain > 0.0)
    say(f"\npose {row + 1} of {len(session.plan)}{falls}. Drive to")
    say("  " + ", ".join(f"{head} {value:.7g}" for head, value in points.items()))
    say(f"  then {', '.join(session.observed or session.columns)}:")
    return row, ask(points) if ask else input("> ")


def _take(session: Session, line: str, row: int, pattern: str | None, *, strict: bool) -> None:
    """Execute a line; a faulty line is a warning, or ends the command if ``strict``.

    Raises:
        EOFError: the line says to quit.
    """
    match line.split():
        case ["q"]:
            raise EOFError
        case ["p"]:
            stdout.print(session.result.tables()[0] if session.result else "nothing is known yet")
        case [_, *_]:
            try:
                say(*obeyed(session, line, row, pattern))
            except (MeasurementError, FileError) as error:
                if strict:
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


class SimulatedMachine:
    """A simulated true machine, driven by readings, with slips and drift on request."""

    def __init__(
        self, mechanism: Mechanism, truth: Mechanism, noise: Noise, setup: Setup, units: Units
    ) -> None:
        self.mechanism, self.truth, self.noise, self.setup = mechanism, truth, noise, setup
        self.units = replace(units, names={"m": "mm", "rad": "deg", **units.names})
        self.rng = np.random.default_rng(0)
        self.slips, self.drift = 0.0, 0.0
        """Share of rows with a slip of ten standard deviations; drift along x per row, [m]."""
        self._rows = 0

    def measured(self, set_points: Mapping[str, float]) -> dict[str, float]:
        """Return the measurements at set points, by column with unit.

        Raises:
            MeasurementError: a reading has no set point, or the machine does not reach the pose.
        """
        names = [head.removesuffix("]").partition(" [")[::2] for head in set_points]
        text = {name: [str(v)] for (name, _), v in zip(names, set_points.values(), strict=True)}
        table = TextTable(Path("set points"), dict(names), text, [1], "row", self.mechanism.counts)
        readings = table.array(reading_units(self.mechanism))
        plan = Plan(pincal.forward(self.mechanism, readings).poses)
        if not np.isfinite(plan.poses).all():
            raise MeasurementError("the machine does not reach these set points")
        plan = replace(plan, readings=readings if self.mechanism.by_readings else None)
        made = pincal.simulate(self.mechanism, self.truth, plan, self.noise, self.rng, self.setup)
        if not len(data := made.measurements):
            raise MeasurementError(f"the machine is not measured: {made.unreachable[0][1]}")
        sigma = self.noise.of_poses(self.mechanism)
        place = self.rng.choice(np.flatnonzero(sigma))
        slip = _SLIP * sigma[place] * self.rng.choice((-1.0, 1.0))
        poses, self._rows = data.poses.copy(), self._rows + 1
        poses[0, place] += slip * (self.rng.random() < self.slips)
        poses[0, 0] += self.drift * self._rows
        way = "zyx" if self.mechanism.platform.turns == 3 else "tilt-torsion"
        columns = columns_of(self.mechanism, replace(data, poses=poses), way, self.setup)
        written = self.units.written(columns).items()
        return {head: float(np.asarray(values, dtype=float)[0]) for head, values in written}

    def answer(self, line: str) -> str:
        """Return the line that answers a line of set points, both JSON."""
        try:
            return json.dumps(self.measured(json.loads(line)))
        except (PincalError, ValueError, AttributeError) as error:
            return json.dumps({"trouble": str(error)})


def serve(machine: SimulatedMachine, port: int) -> None:
    """Answer on a local port, one caller after another, until Ctrl-C."""

    class Line(StreamRequestHandler):
        def handle(self) -> None:
            for line in self.rfile:
                self.wfile.write(machine.answer(line.decode("utf-8", "replace")).encode() + b"\n")

    TCPServer.allow_reuse_address = True
    with TCPServer(("127.0.0.1", port), Line) as server:
        say(f"127.0.0.1:{server.server_address[1]}")
        server.serve_forever()
