"""Many machines: their errors are as linear theory says, whoever makes the rows, and how often."""

from __future__ import annotations

import csv
import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import done, run
from scipy import stats

import pincal
from pincal.calibration.many import MonteCarlo, Workers, add_rows
from pincal.design.platform_error import platform_error
from pincal.files.journal import Row, RowFile
from pincal.show.many import batch_lines, out_of_family, warned_by_chance

NOISE = pincal.Noise(position=2e-5, reading=1e-6)
TYPED = ("--noise-position", "20um", "--noise-reading", "1e-6", "--tolerance", "0.1mm,1mrad,0.001")
OPTIONS = pincal.Options(tolerance="0.1mm,1mrad,0.001", noise=NOISE)


@pytest.fixture(scope="module")
def plan(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Twelve poses of a five-bar."""
    path = tmp_path_factory.mktemp("plan") / "plan.csv"
    pincal.sample_configurations("5R", 12, 1).to_csv(path, "5R")
    return path


def third(number: int) -> Row:
    """Return a row, or fail."""
    if number == 2:
        raise pincal.MeasurementError("two is\nmissing")
    return {"x": number / 3}


def test_rows_are_made_once_and_go_on_where_they_ended(tmp_path: Path) -> None:
    """A table cut anywhere is made whole again, to the byte; failures say why, others refuse."""
    items, path = [(number,) for number in range(5)], tmp_path / "t.csv"
    file = RowFile(path, ["number", "failure", "x"])
    columns = add_rows(third, items, file, Workers(1))
    assert columns["failure"].tolist() == ["", "", "two is missing", "", ""]
    np.testing.assert_array_equal(columns["x"], [0.0, 1 / 3, np.nan, 1.0, 4 / 3])
    text = path.read_bytes()
    for cut in range(len(text)):
        path.write_bytes(text[:cut])
        add_rows(third, items, file, Workers(1))
        assert path.read_bytes() == text
    with pytest.raises(pincal.FileError, match="other rows"):
        add_rows(lambda number: {"x": number / 4}, items[1:], file, Workers(1))
    with pytest.raises(pincal.FileError, match="other columns"):
        add_rows(third, items, RowFile(path, ["number", "failure"]), Workers(1))
    assert path.read_bytes() == text
    for foreign in (b"a note\nwithout an end", b"a note", text + b"1\n"):
        path.write_bytes(foreign)
        with pytest.raises(pincal.FileError, match=r"other columns|line 7: 1 cells instead of 3"):
            add_rows(third, items, file, Workers(1))
        assert path.read_bytes() == foreign


def test_a_folder_in_the_place_of_a_table_is_said_in_words(tmp_path: Path) -> None:
    """No number of an error of the system is printed."""
    with pytest.raises(pincal.FileError, match="away, or name another: Is a directory") as refused:
        RowFile(tmp_path, ["number"]).read()
    assert "Errno" not in str(refused.value)


def test_texts_that_are_not_utf8_are_kept_in_a_table(tmp_path: Path) -> None:
    """Names of machines' files are found again in the table that lists them."""
    name, file = os.fsdecode(b"\xe9\xff.csv"), RowFile(tmp_path / "t.csv", ["file", "failure"])
    file.add([{"file": name, "failure": f"{name}: no such file"}])
    assert file.read()["file"].tolist() == [name]


def test_pipes_and_links_in_circles_among_the_tables_of_a_line_are_left_out(tmp_path: Path) -> None:
    """They are named; a pipe that nobody writes to never ends."""
    os.mkfifo(tmp_path / "machine.csv")
    (tmp_path / "loop").symlink_to("loop")
    refused = run("batch", "5R", tmp_path, "-o", tmp_path / "table.csv")
    assert refused.code == 2
    assert "skipped, since it is no .csv or .xlsx: loop, machine.csv" in refused.err


def test_what_is_wrong_with_a_file_is_said_of_it(tmp_path: Path) -> None:
    """A folder among tables, a setup or plan that is not there: exit code 2, nothing written."""
    machine, table = tmp_path / "line" / "a.csv", tmp_path / "t.csv"
    machine.mkdir(parents=True)
    outcome = run("batch", "5R", tmp_path / "line", "-o", table)
    assert outcome.code == 2
    assert outcome.trouble == f"pincal: {machine}: Is a directory"
    machine.rmdir()
    machine.write_text("x [mm]\n1\n", encoding="utf-8")
    typed = ("batch", "5R", tmp_path / "line", "--workers", 1, "-o", table)
    for missing in ("--setup", "--pairs", "--workspace"):
        outcome = run(*typed, missing, tmp_path / "no", "--results", tmp_path / "results")
        assert outcome.code == 2
        assert (
            outcome.trouble == f"pincal: cannot read {tmp_path / 'no'}: No such file or directory"
        )
    (tmp_path / "line" / "rows.csv").write_text("x [mm]\n1\n", encoding="utf-8")
    refused = run("calibrate", "5R", tmp_path / "line", "-o", tmp_path / "result").trouble
    assert f"name a table in it, such as {tmp_path / 'line' / 'rows.csv'}" in refused
    absent = run("montecarlo", "5R", tmp_path / "plan.csv", "-o", tmp_path / "t.csv")
    assert absent.code == 2
    assert "calibrating" not in absent.err
    assert [path.name for path in tmp_path.iterdir()] == ["line"]


def test_a_study_says_first_what_calibrated_machines_reach(plan: Path, tmp_path: Path) -> None:
    """One number first, the next command last; the same rows by the command and in Python."""
    outcome = done("montecarlo", "5R", plan, *TYPED, "--machines", 2, "-o", tmp_path / "t.csv")
    assert outcome.out.startswith("✓ 5R: 95 % of calibrated machines are within 0.0")
    assert outcome.out.splitlines()[-1].startswith("next: pincal ")
    lines = (tmp_path / "t.csv").read_text(encoding="utf-8").splitlines()
    machine = pincal.load_mechanism("5R")
    workspace = pincal.sample_configurations(machine, 200)
    drawn = MonteCarlo(machine, pincal.Plan.from_csv(plan, machine), workspace, NOISE, OPTIONS)
    assert float(lines[2].split(",")[3]) == drawn.row(1)["chi2"]


def test_out_of_family_is_outside_the_prediction_interval_of_the_others() -> None:
    """Who is named lies outside the interval that all others predict for one more, nobody else."""
    machine, rng = pincal.load_mechanism("5R"), np.random.default_rng(5)
    columns = {name: np.full(9, "", dtype=object) for name in ("failure", "file")}
    columns["file"][:] = [f"{number}.csv" for number in range(9)]
    for p in machine.parameters:
        columns[p.column] = p.nominal + 1e-4 * rng.standard_normal(9)
    columns["leg_2.l [m]"][4] += 2e-3
    level = 1.0 - 0.01 / (9 * len(machine.parameters))
    expected = []
    for p in machine.parameters:
        for number, value in enumerate(columns[p.column]):
            others = np.delete(columns[p.column], number)
            low, high = stats.t.interval(
                level, 7, others.mean(), others.std(ddof=1) * np.sqrt(1.0 + 1.0 / 8.0)
            )
            if not low <= value <= high:
                expected.append((f"{number}.csv", p.id))
    named = [(name, text.split()[0]) for name, text in out_of_family(columns, machine)]
    assert named == expected == [("4.csv", "leg_2.l")]


def test_a_sound_line_has_a_warning_in_one_case_of_a_hundred() -> None:
    """Of lines of sound machines, five tests each, 1 % have one that stays; what is clear stays."""
    p = np.random.default_rng(0).uniform(size=(4000, 8, 5)).min(axis=2)
    p[p >= 0.01] = np.nan  # of which nothing is said
    kept = [np.isfinite(line) & ~warned_by_chance({"p_warnings": line}) for line in p]
    assert 0.005 < np.mean(np.any(kept, axis=1)) < 0.015
    p[0, 3:5] = 1e-9, 0.009
    assert warned_by_chance({"p_warnings": p[0]})[3:5].tolist() == [False, True]


def test_the_worst_machine_of_a_line_is_in_its_table() -> None:
    """The first line's number stands beside its machine; warnings by chance are counted there."""
    texts = {"file": ["a.csv", "b.csv"], "failure": ["", ""], "verdict": ["✓ good", "✗ bad"]}
    columns = {name: np.array(entries, dtype=object) for name, entries in texts.items()}
    columns |= {"p_warnings": np.array([np.nan, 9e-3]), "after [m]": np.array([1.7e-5, 3.1e-5])}
    (first, table), bad = batch_lines(columns, pincal.load_mechanism("5R"))
    assert first.startswith("✓ 5R: 2 of 2 machines calibrated · the worst to 0.031 mm · 0 out")
    assert first.endswith(" · 1 with warnings expected by chance")
    assert [row[1] for row in table.cells()] == ["0.017 mm", "0.031 mm"]
    assert not bad


@pytest.mark.slow
def test_a_line_is_one_table(plan: Path, tmp_path: Path) -> None:
    """Each file has the verdict of 'calibrate' or a cause; a file added later is done alone."""
    machine, line, table = pincal.load_mechanism("5R"), tmp_path / "line", tmp_path / "table.csv"
    line.mkdir()
    for number in range(3):
        truth = pincal.disturb(machine, 1e-4, seed=number)
        data = pincal.simulate(machine, truth, pincal.Plan.from_csv(plan, machine), NOISE, number)
        data.measurements.to_csv(line / f"{number}.csv", machine)
    (line / "1.csv").write_text("x [mm]\n1\n", encoding="utf-8")
    (line / "3.parquet").write_bytes(b"PAR1")
    known = ("--noise-position", "20um", "--noise-reading", "1e-6")
    typed = ("batch", "5R", line, *known, "-o", table, "--results", tmp_path / "results")
    outcome = run(*typed)
    assert outcome.code == 1
    assert "skipped, since it is no .csv or .xlsx: 3.parquet" in outcome.err
    assert "2 of 3 machines calibrated" in outcome.out.splitlines()[0]
    rows = list(csv.DictReader(table.read_text(encoding="utf-8").splitlines()))
    assert "1.csv" in rows[1]["failure"]
    result = pincal.load_result(tmp_path / "results" / "2")
    assert float(rows[2]["leg_1.l [m]"]) == result["leg_1.l"].identified
    shown = done("calibrate", "5R", line / "2.csv", *known, "-o", tmp_path / "2", "--no-report")
    assert rows[2]["verdict"] == shown.out.splitlines()[0].replace(" 5R:", "")
    before = table.read_bytes()
    (line / "1.csv").write_bytes((line / "2.csv").read_bytes())
    outcome = done(*typed)
    assert table.read_bytes().startswith(before)
    assert table.read_bytes().count(b"\n") == 5
    assert outcome.out.splitlines()[-1].startswith("next: pincal deploy ")


@pytest.mark.slow
def test_errors_are_those_of_linear_propagation(plan: Path) -> None:
    """Mean squares before and after are GΣGᵀ of central differences and of the Cramér–Rao bound."""
    machine, count = pincal.load_mechanism("5R"), 100
    workspace = pincal.sample_configurations(machine, 50, 2)
    study = pincal.montecarlo(
        machine, plan, count, workers=2, noise=NOISE, options=OPTIONS, workspace=workspace
    )
    squares = study.known**2
    (before, after), spreads = squares.mean(axis=1), squares.std(axis=1) / np.sqrt(count)

    def moved(id_: str, step: float) -> np.ndarray:
        off = machine.with_parameters({id_: machine.parameters[id_].nominal + step})
        readings = pincal.inverse(machine, workspace.poses).readings
        return pincal.forward(off, readings, workspace.poses).poses

    parts = {
        id_: np.mean(np.sum((moved(id_, sigma) - moved(id_, -sigma)) ** 2, axis=1)) / 4.0
        for id_, sigma in study.sigmas.items()
    }
    assert before == pytest.approx(sum(parts.values()), abs=4.0 * spreads[0])
    poses = pincal.Plan.from_csv(plan, machine)
    information = np.linalg.inv(pincal.forecast(machine, poses, NOISE).covariance)
    prior = np.diag([study.sigmas[id_] ** -2.0 for id_ in machine.parameters.ids])
    bound = platform_error(machine, np.linalg.inv(information + prior), workspace).position
    assert after == pytest.approx(bound**2, abs=4.0 * spreads[1])
    for cost in study.costs():
        share = sum(part for id_, part in parts.items() if id_.endswith(f".{cost.name}"))
        assert cost.before == pytest.approx(share / sum(parts.values()), abs=0.01)


@pytest.mark.slow
def test_what_is_not_calibrated_costs_its_tolerance(plan: Path) -> None:
    """Held parameters make what is left; with all of them free, the noise does."""
    errors = {}
    for fixed in ((), ("l",)):
        options = pincal.Options(tolerance={"m": 1e-3, "rad": 1e-3}, fixed=fixed)
        study = pincal.montecarlo("5R", plan, 20, workers=1, noise=NOISE, options=options)
        errors[fixed] = {cost.name: cost.after for cost in study.costs()}
    assert max(errors[()].values()) < 0.1
    assert max(errors["l",], key=errors["l",].__getitem__) == "l"
    assert errors["l",]["l"] > 0.5


@pytest.mark.slow
def test_any_number_of_workers_gives_the_same_table(plan: Path, tmp_path: Path) -> None:
    """One process or two, two workers of Dask, one of them killed: equal to the last digit."""
    distributed = pytest.importorskip("distributed")

    def made(name: str, progress: Any = None, **workers: Any) -> Path:
        study = {"noise": NOISE, "options": replace(OPTIONS, progress=progress), **workers}
        pincal.montecarlo("5R", plan, 10, tmp_path / name, **study)
        return tmp_path / name

    texts = [made(f"{count}.csv", workers=count).read_bytes() for count in (1, 2)]
    assert texts[0] == texts[1]
    cluster = distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address="127.0.0.1:0", host="127.0.0.1"
    )
    with cluster:
        victims = [worker.pid for worker in cluster.workers.values()]

        def kill_one(text: str) -> None:
            if int(text.split()[0]) > 5 and victims:
                os.kill(victims.pop(), signal.SIGKILL)
                victims.clear()

        made("dask.csv", kill_one, scheduler=cluster.scheduler_address)
        assert not victims
    assert (tmp_path / "dask.csv").read_bytes() == texts[0]
    with pytest.raises(pincal.FileError, match=r"tables are CSV; name .*rows\.csv"):
        made("rows.parquet", workers=1)


@pytest.mark.slow
def test_killed_processes_are_done_again(plan: Path, tmp_path: Path) -> None:
    """A killed or interrupted command goes on, a killed worker stops nothing: to the same bytes."""
    typed = ["montecarlo", "5R", plan, *TYPED, "--machines", 24, "-o"]
    done(*typed, tmp_path / "whole.csv", "--workers", 1)
    table, lines = tmp_path / "table.csv", 1
    for victim in ("command", "interrupted", "worker"):
        words = [sys.executable, "-m", "pincal", *map(str, typed), str(table), "--workers", "2"]
        process = subprocess.Popen(
            words, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, start_new_session=True
        )
        while not table.exists() or table.read_bytes().count(b"\n") < lines + 2:
            time.sleep(0.02)
        if victim == "command":
            os.killpg(process.pid, signal.SIGKILL)
            process.communicate()
        elif victim == "interrupted":
            os.killpg(process.pid, signal.SIGINT)
            _, remarks = process.communicate()
            assert process.returncode == 130
            assert f"To continue: pincal montecarlo 5R {plan} ".encode() in remarks
        else:
            with suppress(ProcessLookupError):
                os.kill(_worker_of(process.pid), signal.SIGKILL)
            process.communicate()
            assert process.returncode == 0
        lines = table.read_bytes().count(b"\n")
        assert (lines == 25) == (victim == "worker")
    assert table.read_bytes() == (tmp_path / "whole.csv").read_bytes()


def _worker_of(pid: int) -> int:
    """Return a process that makes rows for another."""
    children = Path(f"/proc/{pid}/task/{pid}/children").read_text(encoding="ascii").split()
    lines = {int(child): Path(f"/proc/{child}/cmdline").read_bytes() for child in children}
    return next(child for child, line in lines.items() if b"popen_loky" in line)
