"""A machine over months: what changed is named, noise is not, and the drift says when it is due."""

from __future__ import annotations

from datetime import date
from pathlib import Path

import numpy as np
import pytest
from command_line import done, run

import pincal
from pincal.calibration.history import History, changes
from pincal.show.many import HistoryPage

NOISE = pincal.Noise(position=2e-5)
MACHINE = pincal.load_mechanism("5R")
PLAN = pincal.sample_configurations(MACHINE, 15, 1)


def calibrated(seed: int, **moved: float) -> pincal.CalibrationResult:
    """Return a calibration of one machine, of which some parameters of leg 2 moved."""
    truth = pincal.disturb(MACHINE, 2e-4, seed=0)
    values = {f"leg_2.{name}": truth.parameters[f"leg_2.{name}"].nominal for name in moved}
    truth = truth.with_parameters({id_: values[id_] + moved[id_[6:]] for id_ in values})
    data = pincal.simulate(MACHINE, truth, PLAN, NOISE, seed).measurements
    return pincal.calibrate(MACHINE, data, noise=NOISE)


@pytest.fixture(scope="module")
def first() -> pincal.CalibrationResult:
    """The machine as it was."""
    return calibrated(1)


@pytest.mark.parametrize("name", ["l", "A_x", "gamma"])
def test_what_changed_is_named(first: pincal.CalibrationResult, name: str) -> None:
    """One planted change is found alone, its value within three of its standard errors.

    Parameters that would explain it as well are few, and the standard error is smaller than the
    parameter's own: what it is certain of together with the others counts.
    """
    later = calibrated(2, **{name: 1e-3})
    (change,) = changes(first, later)
    assert change.parameter.id == f"leg_2.{name}"
    assert change.value == pytest.approx(1e-3, abs=3.0 * change.std)
    alone = np.hypot(first[f"leg_2.{name}"].std, later[f"leg_2.{name}"].std)
    assert change.std < alone


def test_noise_changes_nothing(first: pincal.CalibrationResult) -> None:
    """Two calibrations of one machine differ by noise."""
    assert changes(first, calibrated(3)) == []


def test_a_history_needs_two_results(first: pincal.CalibrationResult, tmp_path: Path) -> None:
    """One result that is named twice is no history; an accuracy is a number above 0."""
    first.save(tmp_path / "2026-03")
    assert "no history" in run("history", tmp_path, tmp_path / "2026-03").trouble
    first.save(tmp_path / "2026-04")
    assert "above 0" in run("history", tmp_path, "--accuracy", "-1mm").trouble
    machine = History(("",) * 3, (date(2026, 1, 1),) * 3, (first,) * 3)
    for accuracy in (-1e-3, np.nan, np.inf):
        with pytest.raises(pincal.MeasurementError, match="above 0"):
            machine.due(accuracy)


def test_where_no_limit_is_promised_there_is_none(first: pincal.CalibrationResult) -> None:
    """A calibration whose residuals contradict the noise has no limit, and no ✓."""
    later = pincal.calibrate(MACHINE, first.measurements, noise=pincal.Noise(position=2e-6))
    days = date(2026, 1, 1), date(2026, 2, 1)
    verdict, *_, table = HistoryPage(History(("a", "b"), days, (first, later))).lines
    assert verdict.startswith("⚠ 5R")
    assert [row[4] for row in table.cells()] == [table.cells()[0][4], "none"]
    assert table.cells()[0][4].endswith(" mm")


def test_drift_is_that_of_the_machine(first: pincal.CalibrationResult) -> None:
    """The platform drifts as what was planted moves it; a check is due when that is used up."""
    daily, days = 1e-5, (0, 40, 90, 150)
    results = (first, *(calibrated(10 + day, gamma=daily * day) for day in days[1:]))
    dates = tuple(date.fromordinal(date(2026, 1, 1).toordinal() + day) for day in days)
    machine = History(tuple(map(str, days)), dates, results)
    truth = pincal.disturb(MACHINE, 2e-4, seed=0)
    moved = truth.with_parameters({"leg_2.gamma": truth.parameters["leg_2.gamma"].nominal + 1e-4})
    expected = pincal.accuracy(truth, moved, PLAN).position / 10.0
    rate, twice = machine.drift
    assert rate == pytest.approx(expected, rel=0.03)
    assert abs(rate - expected) < 2.0 * twice < 0.1 * rate
    last = results[-1].expected_error().position
    left = (machine.due(5e-4) - dates[-1]).days
    assert left == int(np.sqrt(5e-4**2 - last**2) / (rate + twice))
    assert machine.due(last) == dates[-1]
    assert History(machine.names[:2], dates[:2], results[:2]).drift is None


def test_a_jump_is_no_drift(first: pincal.CalibrationResult) -> None:
    """Drift and the next check are by calibrations since the jump; the verdict says which are."""
    results = [first, calibrated(2), calibrated(3), *(calibrated(s, gamma=1e-3) for s in (4, 5, 6))]
    dates = [date(2026, month, 1) for month in range(1, 7)]
    names = [day.isoformat() for day in dates]
    few = History(tuple(names[:5]), tuple(dates[:5]), tuple(results[:5]))
    assert few.since_jump.names == ("2026-04-01", "2026-05-01")
    assert few.drift is None
    verdict, _, drift, _ = HistoryPage(few, 1e-3).lines
    assert verdict.endswith("on three dates since the jump before 2026-04-01")
    assert drift.endswith("three dates since the jump before 2026-04-01")
    history = History(tuple(names), tuple(dates), tuple(results))
    assert history.drift == History(*(part[3:] for part in (names, dates, results))).drift
    assert history.drift[0] < 2.0 * history.drift[1]


def test_what_drifts_after_a_jump_has_a_trend() -> None:
    """Every later calibration differs from the one before it, but none of them is another jump."""
    moved = [0.0, *(1e-3 + 3e-4 * month for month in range(1, 6))]
    results = tuple(calibrated(20 + i, gamma=gamma) for i, gamma in enumerate(moved))
    dates = tuple(date(2026, month, 1) for month in range(1, 7))
    history = History(tuple(day.isoformat() for day in dates), dates, results)
    assert history.since_jump.dates == dates[1:]
    assert history.drift is not None
    assert history.drift[0] > 2.0 * history.drift[1]


@pytest.mark.slow
def test_history_is_a_verdict_and_a_page(first: pincal.CalibrationResult, tmp_path: Path) -> None:
    """Verdict first, the change named with its dates, and a page that needs nothing else."""
    folder, page = tmp_path / "machine", tmp_path / "history.html"
    folder.mkdir()
    for month, result in (
        ("2026-03", first),
        ("2026-05", calibrated(2)),
        ("2026-01", calibrated(3)),
    ):
        result.save(folder / month)
    outcome = done("history", folder, "--accuracy", "1mm", "-o", page)
    lines = outcome.out.splitlines()
    assert lines[0].startswith(
        "✓ 5R: unchanged in 3 calibrations since 2026-01-01 · next check: not"
    )
    assert lines[-1].startswith("next: ")
    calibrated(4, l=1e-3).save(folder / "2026-06")
    outcome = run("history", folder, "-o", page, "--force")
    assert outcome.code == 1
    assert "leg_2.l moved by +" in outcome.out
    assert "between 2026-05 and 2026-06" in outcome.out
    assert "next: find what moved, then pincal deploy" in outcome.out
    text = page.read_text(encoding="utf-8")
    assert "leg_2.l moved by +" in text
    assert "http" not in text.partition("<main>")[2]
    assert "no result" in run("history", tmp_path / "none").trouble


def test_a_folder_of_an_impossible_date_is_named(
    first: pincal.CalibrationResult, tmp_path: Path
) -> None:
    """It is not taken for today; a serial number of six digits is no date."""
    for name in ("arm_554499", "2026-02-31"):
        first.save(tmp_path / name)
    outcome = run("history", tmp_path)
    assert outcome.code == 2
    assert "2026-02-31 is no date; rename the folder" in outcome.trouble


def test_no_limit_is_shown_where_there_is_none(tmp_path: Path) -> None:
    """Calibrations of too few poses have an error and no limit, which is no infinite number."""
    for month in ("2026-01", "2026-02"):
        poses = pincal.Plan(PLAN.poses[:5])
        truth = pincal.disturb(MACHINE, 2e-4, seed=0)
        data = pincal.simulate(MACHINE, truth, poses, NOISE, int(month[-1])).measurements
        pincal.calibrate(MACHINE, data, noise=NOISE).save(tmp_path / month)
    assert "inf" not in run("history", tmp_path).out
