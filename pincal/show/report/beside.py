"""Figures of a report by a process beside this one: it loads matplotlib while this one computes.

It is asked through a pipe for figures as soon as what they show is known, and answers with all of
them when nothing more is asked. Where there is no such process, or it fails, they are drawn here:
the same bytes.
"""

from __future__ import annotations

import gc
import os
import pickle
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import cache, lru_cache
from importlib import import_module
from pathlib import Path
from time import sleep
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pincal.show.pictures.svg import SvgFigure
    from pincal.show.report.findings import Findings

#: Figures that follow from the fits alone, and those that wait for the checks of a result.
OF_FITS = ("images", "changes", "drawing", "residuals", "histogram", "observability")
OF_CHECKS = ("maps", "poses", "rms")  # the longest first
#: Those of the latter that a result shows whose fit did not converge.
OF_NO_OPTIMUM = ("poses",)
_LOOKS, _BETWEEN = 4, 1e-3  # at what else computes, [s]
#: What a pipe raises that has ended, or says what is no pickle.
_NOT_UNDERSTOOD = (
    OSError,
    ValueError,
    EOFError,
    pickle.UnpicklingError,
    AttributeError,
    ImportError,
    IndexError,
)
#: What the process runs: modules are found where this process finds them.
_RUN = (
    "import pickle, sys; sys.path[:] = pickle.load(sys.stdin.buffer); "
    "from pincal.show.report.beside import answer; answer()"
)


class Drawer:
    """A process that draws the figures of one report."""

    def __init__(self, process: subprocess.Popen[bytes]) -> None:
        self._process = process
        self._talk = ThreadPoolExecutor(1)  # who writes to a pipe waits until it is read
        self._written: list[Future[None]] = []
        self._write(sys.path)

    def _write(self, said: Any) -> None:
        data, pipe = pickle.dumps(said), self._process.stdin

        def write() -> None:
            if pipe is not None:
                pipe.write(data)
                pipe.flush()

        self._written.append(self._talk.submit(write))

    def ask(self, found: Findings, names: Sequence[str], units: Mapping[str, str]) -> None:
        """Ask for figures of what was found, whose numbers are read in units."""
        calibration = found.result.calibration
        silent = replace(calibration.options, progress=None)  # code does not go through pipes
        result = replace(found.result, calibration=replace(calibration, options=silent))
        with suppress(AttributeError, TypeError, pickle.PicklingError):  # then drawn here
            self._write((names, pickle.dumps((replace(found, result=result), dict(units)))))

    def drawn(self) -> Mapping[str, SvgFigure | None]:
        """Return all figures that were asked for, none of them if the process failed."""
        into, out = self._process.stdin, self._process.stdout
        if into is None or out is None:
            return {}
        try:
            for one in self._written:
                one.result()
            into.close()  # nothing more is asked
            return dict(pickle.load(out))
        except _NOT_UNDERSTOOD:
            return {}  # it has ended, or says nothing that is understood

    def end(self) -> None:
        """End the process and its forks, whatever they do."""
        if hasattr(os, "killpg") and self._process.returncode is None:  # its number is its own
            with suppress(OSError):
                os.killpg(self._process.pid, signal.SIGKILL)
        self._process.kill()
        self._talk.shutdown()
        with suppress(OSError), self._process:  # closes its pipes
            pass


def _spare_core() -> bool:
    """Return whether a core would else be idle: two processes compute more than one, in all."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return 1.0 + _others() < (cores or 1)


def _others() -> float:
    """Return how many other processes compute at this moment; where no system says so, lately.

    The fewest of some moments: what starts a command is often still ending.
    """
    least = float("inf")
    try:  # of Linux: 0.20 0.18 0.12 1/80 11206, of 80 one runs, which asks
        for look in range(_LOOKS):
            sleep(_BETWEEN if look else 0.0)
            running = float(Path("/proc/loadavg").read_text().split()[3].split("/")[0])
            least = min(least, running - 1.0)
            if least <= 0.0:
                break
        return least
    except (OSError, ValueError, IndexError):
        return os.getloadavg()[0] if hasattr(os, "getloadavg") else 0.0


@contextmanager
def drawing_beside() -> Iterator[Drawer | None]:
    """Start a process that draws, and end it behind; None where none can be, or helps."""
    process = None
    if _spare_core() and sys.executable and not getattr(sys, "frozen", False):
        run = [sys.executable, "-P", "-c", _RUN]
        to, by = subprocess.PIPE, subprocess.DEVNULL
        with suppress(OSError):
            process = subprocess.Popen(run, stdin=to, stdout=to, stderr=by, start_new_session=True)
    found = None if process is None else Drawer(process)
    try:
        yield found
    finally:
        if found is not None:
            found.end()


def answer() -> None:
    """Draw what is asked for on stdin until that ends, then write the figures to stdout."""
    gc.disable()  # it lives for a moment
    out, sys.stdout = sys.stdout.buffer, sys.stderr
    import_module("pincal.show.report.figures")  # before forks of this process draw
    asked: dict[str, Future[SvgFigure | None]] = {}
    with _hands() as hands:
        while (one := _asked()) is not None:
            names, data = one
            asked |= {name: hands.submit(_figure, data, name) for name in names}
        drawn = {name: figure.result() for name, figure in asked.items()}
        pickle.dump(drawn, out)
        out.flush()  # no one waits for forks and modules to be put away


def _hands() -> Executor:
    """Return what draws: two forks of this process, or itself where there are no forks."""
    from concurrent.futures import ProcessPoolExecutor  # slow to import, needed here only
    from multiprocessing import get_all_start_methods, get_context

    if "fork" not in get_all_start_methods():
        return ThreadPoolExecutor(1)
    return ProcessPoolExecutor(2, get_context("fork"))


def _figure(data: bytes, name: str) -> SvgFigure | None:
    """Return a figure of what was asked for."""
    from pincal.show.report.figures import FIGURES
    from pincal.words.numbers import reading_in

    found, units = _understood(data)
    with reading_in(units):
        return FIGURES[name](found)


@lru_cache(maxsize=2)
def _understood(data: bytes) -> tuple[Findings, dict[str, str]]:
    """Return what figures show, and in which units: once for all figures of one process."""
    found, units = pickle.loads(data)
    return found, units


def _asked() -> Any:
    """Return what is asked next on stdin, None where that ends."""
    try:
        return pickle.load(sys.stdin.buffer)
    except EOFError:
        return None


def figures(
    found: Findings, units: Mapping[str, str], drawer: Drawer | None = None
) -> Callable[[str], SvgFigure | None]:
    """Return what gives figures by name, drawn beside as far as they are, else drawn when asked.

    Args:
        found: What they show.
        units: In which numbers are read, while they are drawn beside.
        drawer: The process, if there is one, already asked for the figures ``OF_FITS``.
    """
    if drawer is not None:
        drawer.ask(found, OF_CHECKS if found.result.converged else OF_NO_OPTIMUM, units)

    @cache
    def beside() -> Mapping[str, SvgFigure | None]:
        return {} if drawer is None else drawer.drawn()

    def figure(name: str) -> SvgFigure | None:
        if name in beside():
            return beside()[name]
        from pincal.show.report.figures import FIGURES  # imports matplotlib: slow

        return FIGURES[name](found)

    return figure
