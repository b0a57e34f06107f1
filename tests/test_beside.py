"""Figures of a report by a process beside this one, and held-out rows that go on from a fit."""

from __future__ import annotations

import gc
import subprocess
import sys
import time
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import undated

import pincal
from pincal.calibration.calibrate import identified, prepared
from pincal.calibration.checks.missed import _times
from pincal.calibration.checks.validation import with_held_out
from pincal.cli.drawing import drawer, ready_to_draw
from pincal.collection import no_collection
from pincal.show.report import beside
from pincal.show.report.beside import OF_CHECKS, OF_FITS, OF_NO_OPTIMUM, Drawer, drawing_beside
from pincal.show.report.figures import FIGURES
from pincal.show.report.findings import Findings
from pincal.show.report.residual_figures import _Lane


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Measurements of a five-bar."""
    places = [[x, y] for x in (-0.3, 0.0, 0.3) for y in (1.0, 1.1, 1.2, 1.3)]
    truth = pincal.disturb("5R", 1e-3, seed=1)
    noise = pincal.Noise(1e-4)
    data = pincal.simulate("5R", truth, pincal.Plan(np.array(places)), noise, seed=1).measurements
    path = tmp_path_factory.mktemp("beside") / "measured.csv"
    data.to_csv(path, pincal.load_mechanism("5R"))
    return path


def started(code: str) -> Drawer:
    """Return a drawer whose process runs code."""
    pipe = subprocess.PIPE
    return Drawer(subprocess.Popen([sys.executable, "-c", code], stdin=pipe, stdout=pipe))


def test_every_figure_is_asked_for_once() -> None:
    """What follows from fits, and what waits for checks, are all the figures of a report."""
    assert sorted((*OF_FITS, *OF_CHECKS)) == sorted(FIGURES)


def test_a_report_without_an_optimum_shows_what_is_asked_for_it(table: Path) -> None:
    """No figure of it is left to the process that waits."""
    page = replace(pincal.calibrate("5R", table), converged=False).report()
    shown: list[str] = []
    page._figure = shown.append  # type: ignore[assignment, attr-defined]
    page.html()
    assert tuple(shown) == OF_NO_OPTIMUM


@pytest.mark.slow
def test_figures_drawn_beside_are_the_same_bytes(table: Path, tmp_path: Path) -> None:
    """A command that has a process to draw writes the report of one that has none."""
    run = (
        "import atexit, sys; from pincal.show.report import beside; from pincal.cli import main; "
        "atexit.register(lambda: print('matplotlib' in sys.modules)); "
    )
    for name, spare in (("beside", True), ("here", False)):
        typed = ["calibrate", "5R", str(table), "-o", str(tmp_path / name)]
        code = f"{run} beside._spare_core = lambda: {spare}; main()"
        ran = subprocess.run(
            [sys.executable, "-c", code, *typed], check=True, capture_output=True, text=True
        )
        assert ran.stdout.endswith(f"{not spare}\n")
    pages = [undated((tmp_path / name / "report.html").read_bytes()) for name in ("beside", "here")]
    assert pages[0] == pages[1]
    assert pages[0].count(b"<figure>") == 8


@pytest.mark.slow
def test_figures_of_fits_wait_for_no_check(table: Path) -> None:
    """Held-out rows change none of the figures that are drawn meanwhile."""
    result, fits = identified(prepared("5R", table))
    early = Findings(result, None)
    late = Findings(with_held_out(result, 3, whole=fits), None)
    for name in OF_FITS:
        one, other = FIGURES[name](early), FIGURES[name](late)
        assert (one is None) == (other is None)
        assert one is None or one.svg == other.svg


@pytest.mark.parametrize(
    "code", ["", "import sys; sys.stdin.read(1); sys.exit(3)", "import os; os.write(1, b'no')"]
)
def test_a_process_that_fails_has_drawn_nothing(code: str) -> None:
    """It ends, answers what is none, or fails: figures are drawn here then, and nothing hangs."""
    found = started(code)
    assert dict(found.drawn()) == {}
    found.end()
    assert dict(found.drawn()) == {}


def test_a_process_that_draws_for_ever_is_ended() -> None:
    """A command that ends does not wait for what it does not need."""
    found = started("import time; time.sleep(1000)")
    found.end()
    assert found._process.returncode not in (None, 0)


@pytest.mark.skipif(not Path("/proc/self/stat").is_file(), reason="no /proc says what runs")
def test_forks_end_with_their_process(tmp_path: Path) -> None:
    """What draws beside a command does not outlive it."""
    file = tmp_path / "fork"
    code = (
        "import os, pathlib, sys, time; fork = os.fork(); "
        "fork and pathlib.Path(sys.argv[1]).write_text(f'{fork} '); time.sleep(1000)"
    )
    run, pipe = [sys.executable, "-c", code, str(file)], subprocess.PIPE
    found = Drawer(subprocess.Popen(run, stdin=pipe, stdout=pipe, start_new_session=True))
    while not (file.is_file() and file.read_text().endswith(" ")):
        time.sleep(0.01)
    state = Path("/proc", file.read_text().strip(), "stat")
    assert running(state)
    found.end()
    begin = time.monotonic()
    while running(state) and time.monotonic() - begin < 10.0:
        time.sleep(0.01)
    assert not running(state)


def running(state: Path) -> bool:
    """Return whether a process runs, by what the system says of it."""
    try:
        return state.read_text().rpartition(")")[2].split()[0] not in "ZX"
    except OSError:
        return False


def test_what_ends_as_a_command_begins_takes_no_core(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of some moments the one counts at which the fewest processes compute."""
    said = iter(["4", "2", "3", "1", "9"])
    told = type("Told", (), {"read_text": lambda _: f"0.2 0.2 0.1 {next(said)}/80 11206"})
    monkeypatch.setattr(beside, "Path", lambda _: told())
    assert beside._others() == 0.0


def test_without_processes_figures_are_drawn_here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where no process may be started, or no core is idle, there is no drawer."""

    def refused(*_: Any, **__: Any) -> None:
        raise PermissionError

    monkeypatch.setattr(beside.os, "sched_getaffinity", lambda _: {0, 1}, raising=False)
    monkeypatch.setattr(beside, "_others", lambda: 0.0)
    monkeypatch.setattr(beside.subprocess, "Popen", refused)
    with drawing_beside() as found:
        assert found is None
    monkeypatch.setattr(beside.subprocess, "Popen", None)
    for cores, busy in (({0}, 0.0), ({0, 1}, 1.0)):
        monkeypatch.setattr(beside.os, "sched_getaffinity", lambda _, own=cores: own, raising=False)
        monkeypatch.setattr(beside, "_others", lambda own=busy: own)
        with drawing_beside() as found:
            assert found is None


@pytest.mark.parametrize(
    "typed", ["", "select 3RRR", "calibrate --help", "calibrate 5R a.csv -o b --no-report"]
)
def test_only_reports_have_a_process(typed: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Commands that draw no report start none."""
    monkeypatch.setattr("pincal.cli.drawing.drawing_beside", None)
    with ready_to_draw(typed.split()):
        assert drawer() is None


def test_held_out_rows_go_on_from_the_fit(table: Path) -> None:
    """With the fits at hand the answers are those of fits made again, to 1e-9."""
    result, fits = identified(prepared("5R", table, noise=pincal.Noise(1e-4)))
    again, on = result.validated(3).validation, with_held_out(result, 3, whole=fits).validation
    assert again is not None
    assert on is not None
    numbers = [
        [value for value in asdict(one).values() if isinstance(value, float)] for one in (again, on)
    ]
    np.testing.assert_allclose(*numbers, rtol=1e-9)
    np.testing.assert_allclose(again.targets[0].rms_ends, on.targets[0].rms_ends, rtol=1e-9)


def test_draws_are_counted() -> None:
    """Sums over what was drawn are products with how often it was."""
    random = np.random.default_rng(0)
    drawn, values = random.integers(7, size=(50, 7)), random.normal(size=(3, 7))
    np.testing.assert_allclose(values @ _times(drawn).T, values[:, drawn].sum(axis=2), atol=1e-13)


def test_values_of_a_lane_stay_in_it() -> None:
    """From its lowest to its highest value a lane rises, within half its height; so do ticks."""
    lane = _Lane(-2.0, -3.7e-5, 8.1e-5)
    values = np.linspace(lane.low, lane.high, 20)
    assert (np.diff(lane.at(values)) > 0.0).all()
    assert np.abs(lane.at(values) + 2.0).max() < 0.5
    assert len(lane.ticks) >= 2
    assert np.abs(lane.at(lane.ticks) + 2.0).max() < 0.5


def test_collection_goes_on_behind() -> None:
    """Rings of objects are looked for again, also behind an error."""
    assert gc.isenabled()
    with no_collection():
        assert not gc.isenabled()
        with pytest.raises(RuntimeError, match="within"), no_collection():
            raise RuntimeError("within")
        assert not gc.isenabled()
    assert gc.isenabled()
