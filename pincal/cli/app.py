"""The application, and the parts that its commands share: consoles, options, progress.

A command prints its answer on stdout, and remarks on its work on stderr. Commands do not deal with
``--quiet``: the decorator ``command`` adds the option and silences the consoles.
"""

import inspect
import io
import logging
import os
import re
import shlex
import signal
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import is_dataclass
from functools import cache, wraps
from itertools import pairwise
from pathlib import Path
from threading import Event, Thread, current_thread, main_thread
from time import monotonic
from typing import Annotated, Any, NoReturn

import numpy as np
import typer
from rich.console import Console
from typer.core import TyperArgument, TyperCommand, TyperOption

from pincal import __version__
from pincal.cli.options import filled, option_parameters
from pincal.errors import PincalError
from pincal.files.text import sparing_inputs

_WIDTH = None if sys.stdout and sys.stdout.isatty() else 100  # width of tables in a file or pipe


def plain(text: str) -> str:
    """Return text for a terminal, with control characters escaped and long texts shortened."""
    shown = _CONTROL.sub(lambda match: ascii(match.group())[1:-1], text)
    if len(shown) <= _LONGEST:
        return shown
    return f"{shown[: _LONGEST // 2]} … {shown[-_LONGEST // 2 :]}"


class _Console(Console):
    """A console that lets the work go on if its reader leaves or its disk is full."""

    failure = ""
    """Why the terminal, file or pipe took no more text; empty if all was printed."""

    def print(self, *objects: Any, **style: Any) -> None:
        """Print objects; text may come from files and hold any characters."""
        shown = [plain(text) if isinstance(text, str) else text for text in objects]
        try:
            super().print(*shown, **style)
        except OSError as error:
            self.failure = error.strerror or str(error)
            self.on_broken_pipe()

    def on_broken_pipe(self) -> None:
        """Discard what is printed from now on."""
        with Path(os.devnull).open("w") as discarded:
            os.dup2(discarded.fileno(), self.file.fileno())


_PLAIN: dict[str, Any] = {"highlight": False, "markup": False, "emoji": False}
stdout = _Console(width=_WIDTH, **_PLAIN)
stderr = _Console(stderr=True, soft_wrap=True, **_PLAIN)  # warnings and errors
_remarks = _Console(stderr=True, soft_wrap=True, **_PLAIN)  # everything else but the answer
_CONTROL = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069]")
_LONGEST = 1300  # characters
_REMIND = 30.0  # seconds between progress lines without a spinner
logging.getLogger("matplotlib").setLevel(logging.ERROR)  # nobody needs its remarks on font caches
_typed: list[str] = []
#: The error of options typed wrong, of click or of the copy that typer may bring.
_TypedWrong: type[Exception] = typer.BadParameter.__mro__[2]
_NAMED = inspect.Parameter.KEYWORD_ONLY


TyperArgument.display_type_rich = lambda *_, **__: None  # type: ignore[method-assign]  # help names no types
app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,  # so that [m] in a help text stays
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Calibrate parallel robots and arms: choose the poses to measure, identify the "
    "parameters, state how certain they are.\n\nMECH is the name of a bundled mechanism (see "
    "'pincal mechanisms') or a mechanism folder. Tables are CSV files whose headers carry units: "
    "'x [mm]', 'phi [deg]', 'leg_1 [rad]'. Every step on a simulated machine: 'pincal demo'.",
)
_commands = cache(lambda: typer.main.get_command(app))  # made once, though ``demo`` runs several


@app.callback(invoke_without_command=True)
def _main(
    version: Annotated[bool, typer.Option("--version", help="Show the version.")] = False,
) -> None:
    if version:
        stdout.print(f"pincal {__version__}")
        raise typer.Exit


_Quiet = Annotated[bool, typer.Option("--quiet", help="Print only warnings and errors.")]


def _valued(parameters: Iterable[object]) -> dict[str, bool]:
    """Return the options among parameters, as typed, and whether each takes a value."""
    options = (option for option in parameters if isinstance(option, TyperOption))
    return {name: not option.is_flag for option in options for name in option.opts}


class _Command(TyperCommand):
    """A command that refuses an option as the value of another option."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the words behind the command's name."""
        valued = _valued(self.params)
        for option, value in pairwise(args):
            if valued.get(option) and re.match("--?[a-z]", value):
                raise typer.BadParameter(f"{option} takes a value, and {value} is an option", ctx)
        return super().parse_args(ctx, args)


def command(function: Callable[..., None]) -> Callable[..., None]:
    """Register a function as a command with ``--quiet``.

    A parameter that is a dataclass is a group of options: each field declared by ``option``.
    """
    groups: dict[str, type] = {}
    offered: list[inspect.Parameter] = []
    for argument in inspect.signature(function, eval_str=True).parameters.values():
        if is_dataclass(argument.annotation):
            groups[argument.name] = argument.annotation  # type: ignore[assignment]
            offered += option_parameters(groups[argument.name])
        else:
            offered.append(argument.replace(kind=_NAMED))
    offered.append(inspect.Parameter("quiet", _NAMED, default=False, annotation=_Quiet))

    @wraps(function)
    def run(**values: Any) -> None:
        stdout.quiet = _remarks.quiet = values.pop("quiet")
        values |= {group: filled(kind, values) for group, kind in groups.items()}
        with sparing_inputs():
            function(**values)

    run.__signature__ = inspect.Signature(offered)  # type: ignore[attr-defined]
    run.__annotations__ = {parameter.name: parameter.annotation for parameter in offered}
    app.command(function.__name__.rstrip("_"), cls=_Command)(run)  # import_ is a command too
    return function


def typed() -> str:
    """Return the command line as it can be typed again."""
    return shlex.join(["pincal", *_typed])


def retyped(command: str, *added: str, measured: tuple[Path, Path] | None = None) -> str:
    """Return the typed words as another command, with added words, without options it has not.

    ``measured`` is the typed file of measurements and its replacement.
    """
    commands: dict[str, TyperCommand] = _commands().commands  # type: ignore[attr-defined]
    valued, line, words = _valued(commands[_typed[0]].params), list[str](), iter(_typed[1:])
    offered = _valued(commands[command].params).keys() - {"-o", "--output", "--quiet", "--force"}
    if command == "explain" or "--terms" in added:  # instead of the terms that were tried
        offered -= {"--terms"}
    for word in words:
        name, joined, _ = word.partition("=") if word.startswith("--") else (word[:2], word[2:], "")
        option = [word, next(words)] if valued.get(name) and not joined else [word]
        if name in offered or name not in valued:
            line += option
    if measured:
        line = [str(measured[1]) if Path(word) == measured[0] else word for word in line]
    output = ("-o", "RESULT") if command == "calibrate" else ()
    return shlex.join(["pincal", command, *line, *added, *output])


def run_step(*words: object, allowed: int = 0) -> None:
    """Show a command as typed, and run it within another; end at an exit code above ``allowed``."""
    _typed[:] = map(str, words)
    stdout.print(f"\n$ {typed()}", style="bold", soft_wrap=True)
    code = _commands()(args=_typed, prog_name="pincal", standalone_mode=False) or 0
    if code > allowed:
        raise typer.Exit(code)


def say(*lines: object) -> None:
    """Print parts of the answer; lines are never wrapped, as they hold commands and paths."""
    for line in lines:
        stdout.print(line, soft_wrap=isinstance(line, str))


@contextmanager
def working(text: str, total: int = 0) -> Iterator[Callable[[Any], None]]:
    """Show progress: a spinner on a terminal, elsewhere a line every 30 s (stderr).

    Yields a function that takes another text, or the amount done of a total.
    """
    counted = f"{text}: {{}} of {total}" if total else "{}"
    if _remarks.is_terminal and not _remarks.quiet:
        with _remarks.status(text) as status:
            yield lambda step: status.update(counted.format(step))
        return
    remark(f"{text} …")
    steps, done, begun = [text], Event(), monotonic()

    def remind() -> None:
        while not done.wait(_REMIND):
            remark(f"{steps[-1]} … {monotonic() - begun:.0f} s")

    Thread(target=remind, daemon=True).start()
    try:
        yield lambda step: steps.append(counted.format(step))
    finally:
        done.set()


def remark(text: str) -> None:
    """Print a remark on the work (stderr)."""
    _remarks.print(text)


class _Remarks(logging.Handler):
    """Handler that prints what the package logs, such as columns that are not used (stderr)."""

    def emit(self, record: logging.LogRecord) -> None:
        remark(record.getMessage())


def warn(*texts: str) -> None:
    """Print warnings (stderr), even if ``--quiet``."""
    for text in texts:
        stderr.print(f"warning: {text}", style="yellow")


def fail(code: int, text: str = "") -> NoReturn:
    """End a command that did its work with an exit code and a warning."""
    if text:
        warn(text)
    raise typer.Exit(code)


def wrote(*paths: Path) -> None:
    """Print remarks that name written files."""
    for path in paths:
        remark(f"wrote {path}")


def main(argv: list[str] | None = None) -> None:
    """Run the command line and raise ``SystemExit`` with the exit code.

    Codes are 0 done, 1 not converged, 2 wrong input, 3 no report, 4 the answer could not be
    printed. ``argv`` are the words behind ``pincal``; those of the process by default.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # χ and ± where the encoding lacks them
            stream.reconfigure(errors="replace")
    if current_thread() is main_thread():
        signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))
    _typed[:] = sys.argv[1:] if argv is None else argv
    log = logging.getLogger("pincal")
    log.setLevel(logging.INFO)
    log.handlers, log.propagate = [_Remarks()], False
    stdout.failure = ""
    try:
        code = _commands()(args=argv, prog_name="pincal", standalone_mode=False) or 0
        if stdout.failure and not code:
            _leave(4, f"the answer could not be printed ({stdout.failure}); the work is done")
        sys.exit(code)
    except _TypedWrong as error:  # shortened, without the prefix of the checker
        error.message = plain(str(error.message).removeprefix("Value error, "))  # type: ignore[attr-defined]
        error.show()  # type: ignore[attr-defined]
        sys.exit(error.exit_code)  # type: ignore[attr-defined]
    except PincalError as error:
        _leave(2, str(error))
    except OSError as error:
        if error.filename is not None:
            _leave(2, f"{error.filename}: {error.strerror}")
        stdout.on_broken_pipe()  # typer prints by itself, to a stream without a name
        _leave(4, f"the answer could not be printed ({error.strerror})")
    except MemoryError as error:
        _leave(2, f"not enough memory ({error}); ask for less at once")
    except np.linalg.LinAlgError as error:
        _leave(
            2,
            f"numerical failure ({error}): look for values in the files and options that are far "
            "too large or too small",
        )


def _leave(code: int, message: str) -> NoReturn:
    """End the process with a message on stderr."""
    stderr.print(f"pincal: {message}", style="bold red")
    sys.exit(code)
