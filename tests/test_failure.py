"""Fits that fail: what explains them is named, poses are not blamed, nothing is promised."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import run
from marks import slow_or_fuzz
from measured import put, workspace

import pincal
from pincal.calibration.findings import findings_of
from pincal.calibration.fits import fitted
from pincal.words.findings import sentences

NOISE = pincal.Noise(2e-5, 5e-5)
FRAME = pincal.Setup(unknown_frame=True)


def measured(
    kind: str, reach: float = 0.03, count: int = 60
) -> tuple[pincal.Mechanism, pincal.Measurements]:
    """Return measurements near home, of a machine 2e-3 off."""
    mechanism = pincal.load_mechanism(kind)
    truth = pincal.disturb(mechanism, 2e-3, 1)
    home = np.tile(mechanism.platform.home, (count, 1))
    shift = np.random.default_rng(0).uniform(-reach, reach, home.shape)
    plan = pincal.Plan(mechanism.platform.moved(home, shift))
    return mechanism, pincal.simulate(mechanism, truth, plan, NOISE, 0).measurements


def other_sign(data: pincal.Measurements, column: int) -> pincal.Measurements:
    """Return measurements with the sign of one coordinate of the poses changed."""
    poses = data.poses.copy()
    poses[:, column] *= -1.0
    return replace(data, poses=poses)


def still(data: pincal.Measurements) -> pincal.Measurements:
    """Return measurements in which no reading moves."""
    return replace(data, readings=np.tile(data.readings[:1], (len(data), 1)))


def said(mechanism: pincal.Mechanism, data: pincal.Measurements, **options: Any) -> str:
    """Return what a calibration refuses with, or else its first warning, if it promises nothing."""
    try:
        result = pincal.calibrate(mechanism, data, poses="all", noise=NOISE, **options)
    except pincal.PincalError as error:
        return str(error)
    return "" if result.promises else result.warnings[0]


@pytest.mark.slow
@pytest.mark.parametrize("method", ["per-leg", "all-legs"])
def test_what_a_rough_mechanism_hides_is_named_when_the_fit_fails(method: str) -> None:
    """Nothing is checked before, but what explains the failure is said, and no pose is blamed."""
    kind = {"per-leg": "5R", "all-legs": "3RRR"}[method]
    mechanism, data = measured(kind, count=36)
    faults = {
        "5R": (
            replace(data, readings=np.roll(data.readings, 1, axis=0)),
            "1 row below",
        ),
        "3RRR": (still(data), "leg_1 reads the same in all rows"),
    }
    wrong, words = faults[kind]
    assert words in said(mechanism, wrong, method=method, rough=True)


@pytest.mark.parametrize(
    ("kind", "reach", "column", "words"),
    slow_or_fuzz(
        [("3RRR", 0.2, 2, "the orientations are inverted")],
        [("6UPS", 0.15, 5, "torsion has the opposite sign")],
    ),
)
def test_a_frame_found_by_the_fit_hides_no_sign(
    kind: str, reach: float, column: int, words: str
) -> None:
    """An angle of the other sign in a tracker's frame: the fit fails, and its sign is named."""
    mechanism, data = measured(kind, reach, 24)
    assert words in said(mechanism, other_sign(data, column), setup=FRAME)


@pytest.mark.parametrize(
    ("option", "words"),
    [
        ({"noise": pincal.Noise(2e-5)}, "exact readings contradict each other"),
        ({"fixed": ["nothing"]}, "no parameter 'nothing'"),
        ({"tied": ["nothing"]}, "no parameter 'nothing'"),
    ],
)
def test_a_wrong_option_is_not_laid_to_a_strange_row(option: dict[str, Any], words: str) -> None:
    """What is refused for its options says so, whatever else a row has."""
    mechanism, data = measured("4cable", 0.2, 24)
    slipped = put(data, "poses", np.s_[3, 0], 0.5)
    with pytest.raises(pincal.MeasurementError, match=words):
        pincal.calibrate(mechanism, slipped, **option)


@pytest.mark.slow
def test_a_slip_is_named_first() -> None:
    """One cell typed as 0 spoils the fit of all rows: its row is named before all else."""
    mechanism, data = measured("6UPS", 0.15)
    data = put(data, "poses", np.s_[7, 2], 0.0)
    result = pincal.calibrate(mechanism, data, poses="all", noise=NOISE)
    assert not result.promises
    assert result.warnings[0].startswith("data row 8 does not fit the others")
    clean = pincal.calibrate(mechanism, data, poses="all", noise=NOISE, loss="reject")
    assert clean.promises
    assert clean.warnings == ()


@pytest.mark.slow
@pytest.mark.parametrize("method", ["per-leg", "all-legs"])
def test_a_search_that_ran_away_says_so(method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where poses tell everything at nominal parameters, they are not said to lack anything."""
    monkeypatch.setattr("pincal.calibration.hypotheses.plausibility.explain_misfit", lambda *_: ())
    mechanism, data = measured("3RRR", 0.2)
    wrong = replace(data, readings=np.roll(data.readings, 1, axis=0))
    text = said(mechanism, wrong, method=method, rough=True)
    assert "the search ran away" in text or "reduced χ² is" in text
    assert "Measure poses" not in text


@pytest.mark.parametrize("method", ["per-leg", "all-legs"])
def test_a_sound_fit_is_silent(method: str) -> None:
    """Nothing is said to have failed where nothing has."""
    mechanism, data = measured("3RRR", 0.2)
    result = pincal.calibrate(mechanism, data, method=method, poses="all", noise=NOISE, rough=True)
    assert result.promises
    assert result.corrects
    assert result.excess == 1.0
    assert result.warnings == ()


def test_what_uncertainty_explains_is_not_said_to_have_moved() -> None:
    """A parameter is far off only if its interval lies beyond what machines differ by."""
    mechanism, data = measured("3RRR", 0.2)
    noise = pincal.Noise(1e-4, 1e-4)
    result = pincal.calibrate(mechanism, data, noise=noise, setup=FRAME)
    legs, said, fits = result.legs, [], fitted(result.calibration)
    for std in (0.04, 0.01):  # of a gain that may differ by 0.05
        one = legs[0].parameters[-1]
        low, high = one.nominal + 0.1 - 2 * std, one.nominal + 0.1 + 2 * std
        far = replace(one, identified=one.nominal + 0.1, std=std, low=low, high=high)
        changed = replace(legs[0], parameters=(*legs[0].parameters[:-1], far))
        found = findings_of(replace(result, legs=(changed, *legs[1:])), fits)
        said.append(" ".join(sentences(found)))
    assert "moved by" not in said[0]
    assert f"{legs[0].parameters[-1].id} changed by +0.1" in said[1]
    assert "--unknown-frame" not in said[1]  # that is said already
    assert "--unknown-target" in said[1]


@pytest.mark.slow
def test_what_readings_alone_lack_is_named() -> None:
    """The scale where gains are free; everything where readings are no more than freedoms."""
    for kind, words in (
        ("4cable", r"line_A\.k.* move together"),
        ("6UPS", "no parameter: readings"),
    ):
        mechanism = pincal.load_mechanism(kind)
        plan = pincal.Plan(workspace(kind, 60))
        noise = pincal.Noise(0.0, 0.0, 1e-3)
        data = pincal.simulate(mechanism, mechanism, plan, noise, 0).measurements
        data = replace(data, poses=np.full_like(data.poses, np.nan))
        with pytest.raises(pincal.ObservabilityError, match=words) as caught:
            pincal.calibrate(mechanism, data, noise=noise, strict=True)
        assert len(str(caught.value)) < 300
        if kind == "4cable":
            result = pincal.calibrate(mechanism, data, noise=noise, fixed=["k"])
            assert result.promises


def test_one_fold_is_refused_before_anything_is_read(tmp_path: Path) -> None:
    """At once, with exit code 2: neither mechanism nor measurements are looked at."""
    outcome = run("calibrate", "none", tmp_path / "no.csv", "--folds", 1, "-o", tmp_path / "out")
    assert outcome.code == 2
    assert "--folds 1: expected 2 or more, or 0" in " ".join(outcome.trouble.split())


def test_one_row_is_spoken_of_as_one() -> None:
    """One row that does not fit, and no rows."""
    mechanism, data = measured("3RRR", 0.2)
    data = put(data, "poses", np.s_[4, 0], data.poses[4, 0] + (2e-4))
    result = pincal.calibrate(mechanism, data, poses="all", noise=NOISE)
    (text,) = (one for one in result.warnings if "not fit the others" in one)
    assert text.startswith("1 of 60 rows does not fit the others: data row 5, by")
    assert "Check it" in text
