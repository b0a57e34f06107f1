"""Sessions beside the robot: which pose next, which row is wrong, when it is enough."""

from __future__ import annotations

import io
import json
import os
import resource
import socket
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import cache
from pathlib import Path
from threading import Thread
from typing import Any

import numpy as np
import pytest
from arms import loaded
from bench import NOISE, Bench
from command_line import done, run
from marks import some_slow

import pincal
from pincal.calibration.promise import errors_inside
from pincal.calibration.session import Session, SessionOptions
from pincal.cli.design import serve
from pincal.cli.measure import _appended
from pincal.design.simulate import SimulatedMachine
from pincal.files.columns import columns_of
from pincal.files.journal import Journal
from pincal.show.measuring import progress, verdict_on_row
from pincal.words.numbers import number

ACCURACY = 5e-5


@cache
def bench() -> Bench:
    """Return a 3-RRR with 40 poses that it reaches."""
    mechanism = pincal.load_mechanism("3RRR")
    return Bench(mechanism, pincal.sample_configurations(mechanism, 40, 3))


def session(folder: Path, rows: int = 0, **options: Any) -> Session:
    """Return a session with some rows measured."""
    options = {"noise": NOISE, "accuracy": ACCURACY, **options}
    opened = Session(Journal(folder), bench().mechanism, bench().plan, SessionOptions(**options))
    for _ in range(rows):
        row, _ = opened.next_pose()
        opened.add(bench().entry(opened.columns, row))
    return opened


@pytest.fixture(scope="module")
def begun(tmp_path_factory: pytest.TempPathFactory) -> Session:
    """Return a session of 16 rows, which determine all parameters; tests undo what they add."""
    return session(tmp_path_factory.mktemp("begun") / "s", 16, accuracy=None)


@pytest.mark.slow
def test_enough_is_what_calibrate_promises_and_the_machine_keeps(tmp_path: Path) -> None:
    """At "enough" ``pincal calibrate`` prints the same limit, by rows.csv alone; it is kept."""
    measured = session(tmp_path / "s", 8)
    while not measured.enough and len(measured.measured) < 40:
        measured.add(bench().entry(measured.columns, measured.next_pose()[0]))
    assert 8 < len(measured.measured) < 30
    result = pincal.calibrate(bench().mechanism, measured.journal.path, noise=NOISE)
    error = errors_inside(result, measured.candidates.workspace)[1]
    assert error.limit[0] <= ACCURACY
    measured.journal.close()
    noise = ("--noise-position", "20um", "--noise-orientation", 2e-5, "--noise-reading", 1e-5)
    printed = done("calibrate", "3RRR", measured.journal.path, *noise, "-o", tmp_path / "r").out
    assert f"(95 %: ≤ {number(measured.limit, 'm')})" in printed
    true = pincal.accuracy(result.identified, bench().truth, measured.candidates.workspace)
    assert true.position <= ACCURACY < 10.0 * true.position


def test_next_pose_has_the_largest_determinant(begun: Session) -> None:
    """No other row of the plan leaves a larger determinant of the information (brute force)."""
    design, measured = begun.candidates, begun.measured
    best, falls = design.best(measured)
    fresh = [row for row in range(len(begun.plan)) if row not in measured]
    M = design.information(measured)
    values = [np.linalg.slogdet(M + A.T @ A)[1] for A in design.rows[fresh]]
    before = np.linalg.slogdet(M)[1]
    assert best == fresh[int(np.argmax(values))]
    n = design.rows.shape[2]
    assert falls == pytest.approx(1.0 - np.exp((before - max(values)) / (2 * n)), rel=1e-9)


def test_forecast_is_of_the_limit_that_calibrate_promises(begun: Session) -> None:
    """By the nominal machine alone it is within 2 %, from the same poses, region and χ²."""
    result = pincal.calibrate(begun.mechanism, begun.journal.path, noise=NOISE)
    workspace = pincal.sample_configurations(begun.mechanism, 1000)
    promised = errors_inside(result, workspace)[1].limit[0]
    surplus = result.chi2_freedoms * (result.reduced_chi2 - 1.0)
    assert begun.candidates.limit(begun.measured, surplus) == pytest.approx(promised, rel=0.02)
    assert begun.limit == pytest.approx(promised, rel=1e-6)


def test_further_poses_are_those_of_the_session_played_ahead(begun: Session) -> None:
    """The forecast number of poses is the first at which their limit is the wanted one."""
    design, measured = begun.candidates, begun.measured
    rows = [*measured, *(row for row in design.course if row not in measured)]
    for further in (1, 5, 12):
        accuracy = design.limit(rows[: len(measured) + further])
        assert design.missing(measured, accuracy, 0.0) == further
        assert design.missing(measured, accuracy * 0.9999, 0.0) > further
    assert design.missing(measured, 1e-6, 0.0) > len(begun.plan)
    few = [row for row in design.course if row not in measured][:3]
    assert design.limit(few) == np.inf  # fewer equations than unknowns


def _in_radians(cells: dict[str, str]) -> None:
    cells["leg_2 [deg]"] = repr(float(np.radians(float(cells["leg_2 [deg]"]))))


def _in_rounded_radians(cells: dict[str, str]) -> None:
    cells["leg_2 [deg]"] = f"{np.radians(float(cells['leg_2 [deg]'])):.4f}"


def _turned_round(cells: dict[str, str]) -> None:
    cells["x [mm]"], cells["y [mm]"] = cells["y [mm]"], cells["x [mm]"]


def _other_sign(cells: dict[str, str]) -> None:
    cells["leg_3 [deg]"] = repr(-float(cells["leg_3 [deg]"]))


def _swapped(cells: dict[str, str]) -> None:
    legs = "leg_1 [deg]", "leg_2 [deg]"
    cells[legs[0]], cells[legs[1]] = cells[legs[1]], cells[legs[0]]


def _in_metres(cells: dict[str, str]) -> None:
    for head in ("x [mm]", "y [mm]"):
        cells[head] = repr(float(cells[head]) / 1e3)


@pytest.mark.parametrize(
    ("mistake", "words"),
    [
        (_in_radians, "the readings of leg_2 are in radians"),
        (_in_rounded_radians, "the readings of leg_2 are in radians"),
        (_turned_round, "x and y are swapped"),
        (_other_sign, "the readings of leg_3 have the opposite sign"),
        (_swapped, "legs are swapped: column leg_2 fits leg_1 and column leg_1 fits leg_2"),
        (_in_metres, "the positions are in metres"),
    ],
)
def test_mistake_is_named_on_entry(begun: Session, mistake: Any, words: str) -> None:
    """A unit, a sign, an order that is wrong is named; undone, the file is as it was."""
    before, limit = begun.journal.path.read_bytes(), begun.error
    row, _ = begun.next_pose()
    cells = bench().entry(begun.columns, row)
    mistake(cells)
    checked = begun.add(cells)
    assert checked.off
    assert words in verdict_on_row(checked)
    assert begun.error is limit  # nothing is made of it yet
    typed = begun.journal.path.read_bytes()[len(before) :]
    begun.undo()
    assert begun.journal.path.read_bytes() == before
    assert begun.journal.path.with_name("undone.csv").read_bytes().endswith(typed)
    assert not begun.add(bench().entry(begun.columns, row)).off
    begun.undo()


def test_slip_of_ten_sigma_is_off_and_can_be_kept(begun: Session) -> None:
    """0.2 mm of noise of 20 µm is off in each coordinate; kept, it takes part and is doubted.

    By as many σ, which then follow from a fit with the row, not from a prediction without it.
    """
    row, _ = begun.next_pose()
    for head in ("x [mm]", "y [mm]"):
        cells = bench().entry(begun.columns, row)
        cells[head] = repr(float(cells[head]) + 0.2)
        checked = begun.add(cells)
        assert checked.off
        assert 3.5 < (checked.sigma or 0.0) < 12.0
        assert f"likely the measured {head[0]} alone is wrong" in verdict_on_row(checked)
        begun.keep()
        assert begun.doubtful is not None
        assert begun.doubtful[0] == checked.row
        assert begun.doubtful[1] == pytest.approx(checked.sigma, rel=0.02)
        assert "no 95 % limit yet" in progress(begun)[0]
        begun.undo()
    assert begun.doubtful is None


def test_row_typed_again_replaces_one_that_is_off(begun: Session) -> None:
    """At the question a measurement takes the place of the row; the other is kept aside."""
    row, count = begun.next_pose()[0], len(begun.measured)
    assert begun.add({"x": "1.5", "y": "2.5", "phi": "3.5"}).off
    assert begun.add({"x": "4.5", "y": "2.5", "phi": "3.5"}).off
    assert begun.next_pose()[0] == row
    assert not begun.add(bench().entry(begun.columns, row)).off
    assert len(begun.measured) == count + 1
    begun.undo()


@pytest.mark.parametrize("kind", some_slow(["3RRR", "6UPS"], "6UPS"))
def test_kept_row_that_is_absurd_is_the_one_that_is_named(tmp_path: Path, kind: str) -> None:
    """It does not hold up later fits, nor when the session is resumed, and others are not blamed.

    The rows after it are sound, and stay so.
    """
    mechanism = pincal.load_mechanism(kind)
    machine = Bench(mechanism, pincal.sample_configurations(mechanism, 40, 3))
    options = SessionOptions(noise=NOISE, accuracy=ACCURACY)
    opened = Session(Journal(tmp_path / "s"), mechanism, machine.plan, options)
    begun = time.process_time()
    for count in range(9):
        row = opened.next_pose()[0]
        numbers = enumerate(opened.observed)
        absurd = {head: str(1500.0 + place) for place, head in numbers} if count == 2 else {}
        checked = opened.add(machine.entry(opened.columns, row) | absurd)
        assert checked.off == (count == 2)
        if checked.off:
            opened.keep()
        if count >= 2:
            assert opened.doubtful is not None
            assert opened.doubtful[0] == 2
    opened.journal.close()
    resumed = Session(Journal(tmp_path / "s"), mechanism, machine.plan, options)
    assert time.process_time() - begun < 60.0
    assert resumed.doubtful is not None
    assert resumed.doubtful[0] == 2
    resumed.undo(2)
    assert resumed.doubtful is None


def test_rows_that_no_other_confirms_are_not_doubted(tmp_path: Path) -> None:
    """Three positions in an unknown frame are just enough for it: rounding contradicts none."""
    arm, setup = loaded("ur5"), pincal.Setup(unknown_frame=True)
    poses = pincal.sample_configurations(arm, 300, 5).rows(np.array([148, 87, 237, 75]))
    options = SessionOptions(noise=NOISE, setup=setup, measured=("x", "y", "z"))
    for seed in range(3, 7):
        machine = Bench(arm, poses, setup, seed)
        opened = Session(Journal(tmp_path / str(seed)), arm, machine.plan, options)
        for _ in range(4):
            row, _ = opened.next_pose()
            assert not opened.add(machine.entry(opened.columns, row)).off
            assert opened.doubtful is None


def test_session_goes_on_as_it_was_left(tmp_path: Path) -> None:
    """Killed in the middle of a line, nothing is lost: state and next pose are as without it."""
    left = session(tmp_path / "s", 10)
    error, following, text = left.error, left.next_pose(), left.journal.path.read_bytes()
    with pytest.raises(pincal.FileError, match=rf"open in another process \({os.getpid()}\)"):
        session(tmp_path / "s")
    left.journal.close()
    with left.journal.path.open("ab") as file:
        file.write(b"7,-516.42,-327")
    again = session(tmp_path / "s")
    assert again.journal.path.read_bytes() == text
    assert again.next_pose() == following
    assert again.measured == left.measured
    assert again.error is not None
    assert error is not None
    assert again.error.position == pytest.approx(error.position, rel=1e-6)


def test_only_what_a_session_wrote_is_removed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Refused, a new session leaves no file; those of another process or of the user stay."""
    monkeypatch.chdir(tmp_path)
    pincal.files.table.write_table("p.csv", columns_of("3RRR", bench().plan))
    command = ("measure", "3RRR", "--session", "s", "--terminal", "--plan", "p.csv")
    other = session(Path("s"), 1)
    before = {path: path.read_bytes() for path in Path("s").iterdir()}
    refused = run(*command)
    assert (refused.code, "open in another process" in refused.trouble) == (2, True)
    assert {path: path.read_bytes() for path in Path("s").iterdir()} == before
    other.journal.close()
    assert run(*command, "--units", "m,rad").code == 2
    assert {path: path.read_bytes() for path in Path("s").iterdir()} == before
    Path("mine").mkdir()
    Path("mine/notes.txt").touch()
    for folder in ("new", "mine"):
        assert run(*command, "--session", folder, "--measure", "a,b").code == 2
    assert not Path("new").exists()
    assert {path.name for path in Path("mine").iterdir()} == {"notes.txt"}
    held = Journal(Path("held"))
    held.withdraw()
    again = Journal(Path("held"))  # the lock of a folder that was removed holds no other
    held.close()
    with pytest.raises(pincal.FileError, match="open in another process"):
        Journal(Path("held"))
    again.close()


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lambda text: text.replace(b"\n1,", b"\nabc,"), "there is no pose 'abc'; the last is"),
        (lambda text: text.replace(b"\n1,", b"\n9999,"), "there is no pose '9999'"),
        (lambda text: text + b"9" * 140_000 + b"\n", "line 3: field larger than field limit"),
        (lambda text: text + b"9" * 5_000 + b"," * text.count(b",", 0, 80) + b"\n", "line 3: "),
        (lambda text: b"\xef\xbb\xbf" + text + b"\n\n", ""),
        (lambda text: text + b"7,-516.42,-327", ""),
    ],
)
def test_damaged_rows_are_named_and_stay(tmp_path: Path, damage: Any, words: str) -> None:
    """What is no row is refused by file and line; blank lines and marks of an editor are not."""
    left = session(tmp_path / "s")
    left.add(bench().entry(left.columns, 0), 0)
    left.journal.close()
    damaged = damage(left.journal.path.read_bytes())
    left.journal.path.write_bytes(damaged)
    if not words:
        assert session(tmp_path / "s").measured == [0]
        return
    with pytest.raises((pincal.FileError, pincal.MeasurementError), match=words) as caught:
        session(tmp_path / "s")
    assert "rows.csv" in str(caught.value)
    assert left.journal.path.read_bytes() == damaged


@contextmanager
def full_disk(path: Path) -> Iterator[None]:
    """Let no file grow to more than nine bytes above what one has."""
    _, most = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (path.stat().st_size + 9, most))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))


def test_full_disk_loses_nothing(begun: Session) -> None:
    """A row that the disk does not take whole is not recorded, and that is said."""
    before, row = begun.journal.path.read_bytes(), begun.next_pose()[0]
    with (
        full_disk(begun.journal.path),
        pytest.raises(pincal.FileError, match="not recorded; free some space"),
    ):
        begun.add(bench().entry(begun.columns, row))
    assert begun.journal.path.read_bytes() == before
    assert not begun.add(bench().entry(begun.columns, row)).off
    begun.undo()


def test_any_row_can_be_undone(tmp_path: Path) -> None:
    """A row among others is taken out of the file, and rows go on behind the last."""
    journal = Journal(tmp_path / "s")
    journal.open(["row", "x [mm]"])
    for row in "1234":
        journal.append({"row": row, "x [mm]": row * int(row)})
    journal.undo(1)
    journal.append({"row": "5"})
    journal.undo(2)
    with pytest.raises(pincal.MeasurementError, match="no such row"):
        journal.undo(3)
    assert journal.path.read_text() == "row,x [mm]\n1,1\n3,333\n5,\n"
    assert journal.path.with_name("undone.csv").read_text() == "2,22\n4,4444\n"
    journal.close()
    again = Journal(tmp_path / "s")
    again.open(journal.columns)
    assert again.rows == journal.rows


@pytest.fixture
def machine(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> tuple[SimulatedMachine, str]:
    """Return a five-bar and the port at which it answers, with nobody at the keyboard."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "stdin", io.StringIO())
    mechanism = pincal.load_mechanism("5R")
    truth = pincal.disturb(mechanism, seed=3)
    machine = SimulatedMachine(mechanism, truth, NOISE, pincal.Setup(), pincal.words.numbers.SI)
    machine.rng = np.random.default_rng(1)
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    Thread(target=serve, args=(machine, port), daemon=True).start()
    with socket.socket() as caller:
        while caller.connect_ex(("127.0.0.1", port)):
            time.sleep(0.01)
    return machine, f"127.0.0.1:{port}"


def unattended(port: str, accuracy: str, *plan: str) -> Any:
    """Return the outcome of a session with a machine that answers."""
    noise = ("--noise-position", "20um", "--noise-reading", "0.01mrad", "--accuracy", accuracy)
    return run("measure", "5R", "--session", "s", "--terminal", "--tcp", port, *noise, *plan)


@pytest.mark.slow
def test_simulated_machine_answers_a_session(machine: tuple[SimulatedMachine, str]) -> None:
    """Over TCP a session goes to its end by itself, and its promise is kept."""
    simulated, port = machine
    simulated.slips = 0.15
    answer = simulated.answer('{"leg_1 [deg]": 0}')
    assert json.loads(answer)["trouble"].startswith("set points: no column")
    outcome = unattended(port, "0.1mm")
    assert outcome.code == 0
    assert "enough: 0.1 mm reached" in outcome.out
    result = pincal.calibrate(simulated.mechanism, "s/rows.csv", noise=NOISE)
    assert result.promises
    workspace = pincal.sample_configurations(simulated.mechanism, 100, 9)
    assert pincal.accuracy(result.identified, simulated.truth, workspace).position < 1e-4


@pytest.mark.parametrize(
    ("poses", "drift", "end"),
    [
        (6, 0.0, "no pose of the plan is left"),
        pytest.param(60, 3e-3, "the last 10 rows were off", marks=pytest.mark.slow),
    ],
)
def test_session_with_nobody_there_ends(
    machine: tuple[SimulatedMachine, str], poses: int, drift: float, end: str
) -> None:
    """Where it is never enough, or rows contradict each other, it says so: exit code 1."""
    simulated, port = machine
    simulated.drift = drift
    plan = pincal.sample_configurations(simulated.mechanism, poses, 3)
    pincal.files.table.write_table("plan.csv", columns_of(simulated.mechanism, plan))
    outcome = unattended(port, "1um", "--plan", "plan.csv")
    assert outcome.code == 1
    assert f"{end}, but the accuracy is not reached" in outcome.err
    assert "rows in s/rows.csv" in outcome.out


@pytest.mark.slow
def test_poses_for_verification_follow_when_enough(
    machine: tuple[SimulatedMachine, str],
) -> None:
    """Unattended too, all of them, whether it is enough or no other pose is left."""
    simulated, port = machine
    plan = pincal.sample_configurations(simulated.mechanism, 60, 3)
    sets = ("all",) * 54 + ("verify",) * 6
    table = columns_of(simulated.mechanism, replace(plan, sets=sets))
    pincal.files.table.write_table("plan.csv", table)
    outcome = unattended(port, "0.1mm", "--plan", "plan.csv")
    assert outcome.code == 0
    rows = pincal.Measurements.from_csv("s/rows.csv", simulated.mechanism)
    assert rows.verifying.sum() == 6
    assert len(rows) < 60


def test_followed_file_may_begin_anew(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Truncated or replaced, a log is read from its beginning; half a line waits for its end."""
    log = tmp_path / "log"
    log.write_text("old\n" * 100)
    lines = _appended(log, log.stat().st_size)

    def written(texts: list[str]) -> None:
        for text in texts:
            time.sleep(0.3)
            log.write_text(text)

    def appended(text: str) -> None:
        time.sleep(0.1)
        with log.open("a") as file:
            file.write(text)

    Thread(target=appended, args=("1 2\n\n",)).start()
    assert next(lines) == "1 2\n"
    Thread(target=written, args=(["", "3 ", "3 4\n5 6\n"],)).start()
    assert [next(lines), next(lines)] == ["3 4\n", "5 6\n"]
    (tmp_path / "new").write_text("7 8\n" * 200)
    (tmp_path / "new").replace(log)
    assert next(lines) == "7 8\n"
    assert capsys.readouterr().err.count("begins anew") >= 2


def test_terminal_takes_rows_and_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rows are typed, pasted, as JSON; what is no row is said; the session goes on by its name."""
    monkeypatch.chdir(tmp_path)
    machine = bench()
    pincal.files.table.write_table(Path("plan.csv"), columns_of("3RRR", machine.plan))
    columns = ["x [mm]", "y [mm]", "phi [deg]", "leg_1 [deg]", "leg_2 [deg]", "leg_3 [deg]"]
    typed = [
        f"r 3\n{machine.line(columns, 2)}",
        "r 5\n" + machine.line(columns[:3], 4).replace(" ", "\t"),
        f"r 6\n{json.dumps({head[:-5].strip(): 1.0 for head in columns[:2]})}\n1 2",
        'h\n{"x":' + '{"x":' * 50_000 + "\nu\nq\n",
    ]
    monkeypatch.setattr(sys, "stdin", io.StringIO("\n".join(typed)))
    command = ("measure", "3RRR", "--session", "s", "--terminal")
    noise = ("--noise-position", "20um", "--noise-orientation", "0.02mrad", "--accuracy", "0.1mm")
    outcome = done(*command, "--plan", "plan.csv", *noise)
    assert "row 1 is recorded: " in outcome.out
    assert "3 rows in" not in outcome.out
    assert "'1 2' is no row: expected x [mm], y [mm], phi [deg], or all of x [mm], " in outcome.err
    assert outcome.out.count("u: undo the last row") == 2
    assert outcome.err.count(" is no JSON: ") == 1
    assert "2 rows in s/rows.csv" in outcome.out
    assert outcome.out.splitlines()[-1] == (
        "next: pincal calibrate 3RRR s/rows.csv --noise-position 2e-05 --noise-orientation 2e-05 "
        "--noise-reading 0 -o RESULT"
    )
    rows = pincal.Measurements.from_csv("s/rows.csv", "3RRR")
    exact = machine.measurements.rows(np.array([2, 4]))
    np.testing.assert_allclose(rows.poses, exact.poses, atol=1e-12)
    commanded = pincal.inverse("3RRR", machine.plan.poses[4:5]).readings
    np.testing.assert_allclose(rows.readings[1:], commanded, atol=2e-7)
    monkeypatch.setattr(sys, "stdin", io.StringIO("u 0\nr 99\nu 2\nq\n"))
    resumed = done(*command, "--accuracy", "0.2mm")
    assert "there is no row '0'; the last is row 2" in resumed.err
    assert "there is no pose '99'; the last is pose " in resumed.err
    assert resumed.out.startswith("row 2 is recorded: ")
    assert " 1 pose: not all parameters are determined yet" in resumed.out
    assert " more poses for 0.2 mm" in resumed.out
    assert "warning: --accuracy was 0.0001 so far and is now 0.0002" in resumed.err
    assert "noise" not in resumed.err
    moved = pincal.disturb("3RRR", 1e-3, seed=1)
    moved.save("moved")
    resumed = done(*command, "--plan", "other.csv")
    assert f"the session goes on with the poses of {Path('s', 'plan.csv')}" in resumed.err
    refused = run("measure", "5R", "--session", "new", "--terminal", "--plan", "other.csv")
    assert refused.code == 2
    assert not Path("new").exists()
    for damaged in (b"\xff", b"[]", b"{", b'{"Noise": {"position": "x"}}', b'{"mechanism": 3}'):
        options = Path("s", "options.json")
        before = options.read_bytes()
        options.write_bytes(damaged)
        refused = run(*command)
        assert f"pincal: delete {options}, and type its options again: " in refused.err
        assert options.read_bytes() == damaged
        options.write_bytes(before)
    refused = run("measure", "moved", *command[2:])
    assert refused.code == 2
    assert "s is a session of '3RRR', and '3RRR' has other parameters" in refused.err
    refused = run(*command, "--units", "m,rad")
    assert refused.code == 2
    assert "rows.csv has other columns" in refused.err
    monkeypatch.setattr(sys, "stdin", io.StringIO(machine.line(columns[:3], 4) + "\nq\n"))
    with full_disk(Path("s/rows.csv")):
        outcome = done(*command)
    assert "warning: not recorded; free some space and enter it again. s/rows.csv" in outcome.err
    assert "1 rows in s/rows.csv" in outcome.out
    monkeypatch.setattr(sys, "stdin", io.StringIO())
    outcome = done(*command, "--noise-orientation", "0.1mrad", "--noise-reading", 0)
    assert "warning: --noise-orientation was 2e-05 so far and is now 0.0001" in outcome.err
    options = json.loads(Path("s/options.json").read_text())
    assert options["Noise"] == {"position": 2e-5, "orientation": 1e-4, "reading": 0.0}
    assert options["SessionOptions"] == {"accuracy": 2e-4}


def test_a_plan_whose_poses_are_all_skipped_promises_nothing(tmp_path: Path) -> None:
    """Without any row, no number of further ones is named."""
    opened = session(tmp_path / "s")
    for _ in range(len(opened.plan)):
        opened.skip(opened.next_pose()[0])
    assert progress(opened)[-1] == "no number of these poses suffices for 0.05 mm"
