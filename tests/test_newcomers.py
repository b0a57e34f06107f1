"""What newcomers stumbled over, in their words."""

from __future__ import annotations

import re
import shlex
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import Outcome, done, run
from measured import machine
from scipy.spatial.transform import Rotation

import pincal
from pincal.show.tables import outside_table, parameters_table

NOISE = pincal.Noise(1e-4, 1e-4, 1e-5)


@pytest.fixture(scope="module")
def elsewhere() -> tuple[pincal.CalibrationResult, np.ndarray]:
    """A 3-RRR calibrated from a tracker that stands elsewhere, and where the tracker says it is."""
    mechanism, _, data = machine("3RRR", 24, NOISE)
    frame = np.eye(4)
    frame[:3, :3] = Rotation.from_rotvec([0.0, 0.0, 0.7]).as_matrix()
    frame[:2, 3] = 1.2, -0.4
    platform = mechanism.platform
    poses = platform.from_matrices(frame @ platform.transforms(data.poses).as_matrix())
    setup = pincal.Setup(unknown_frame=True)
    data = replace(data, poses=poses)
    return pincal.calibrate(mechanism, data, noise=NOISE, setup=setup), frame


def test_start_under_an_unknown_frame_is_where_the_search_began(
    elsewhere: tuple[pincal.CalibrationResult, np.ndarray],
) -> None:
    """By rigid alignment, near where the base is: not zero, nor what was found."""
    result, frame = elsewhere
    near = {"tracker.x": frame[0, 3], "tracker.y": frame[1, 3], "tracker.rz": 0.7}
    for id_, there in near.items():
        start = result[id_].nominal
        assert start == pytest.approx(there, abs=0.05)
        assert start != result[id_].identified
    assert "start: initial values" in outside_table(result).caption


def test_tables_say_that_plus_minus_in_an_unknown_frame_depends_on_a_choice(
    elsewhere: tuple[pincal.CalibrationResult, np.ndarray],
) -> None:
    """Both tables; in the base frame nothing was chosen, and nothing is said."""
    result, _ = elsewhere
    words = "Values and ± depend on what was fixed by choice"
    assert words in parameters_table(result).caption
    assert words in outside_table(result).caption
    assert words not in parameters_table(replace(result, gauge=())).caption


@pytest.mark.parametrize("times", [3.0, 100.0])
def test_noise_given_too_small_is_said_once(times: float) -> None:
    """One cause, one warning: not also that all rows do not fit the others."""
    mechanism, _, data = machine("3RRR", 40, NOISE)
    small = pincal.Noise(*(value / times for value in (1e-4, 1e-4, 1e-5)))
    result = pincal.calibrate(mechanism, data, noise=small)
    assert [one.code for one in result.findings if one.severity == "warning"] == ["chi2-too-large"]
    assert not result.outliers
    assert "e+" not in result.warnings[0]


def test_far_rows_are_named_also_where_the_noise_given_is_too_small() -> None:
    """The worst of few, by the scale of the others."""
    mechanism, _, data = machine("3RRR", 40, NOISE)
    poses = data.poses.copy()
    poses[7, 0] += 0.01
    given = pincal.Noise(5e-5, 5e-5, 5e-6)
    result = pincal.calibrate(mechanism, replace(data, poses=poses), noise=given)
    assert result.outliers[0].row == 7
    assert len(result.outliers) < 5


def test_print_of_a_parameter_is_a_line_of_words() -> None:
    """Value ± with unit and nominal value; of one that was held, that."""
    mechanism, _, data = machine("3RRR", 24, NOISE)
    result = pincal.calibrate(mechanism, data, noise=NOISE, fixed=("k",))
    number = r"-?\d+\.\d+"
    line = rf"leg_1\.L: {number} ± {number} mm \(95 %\), nominal 1500\.000 mm"
    assert re.fullmatch(line, str(result["leg_1.L"]))
    assert str(result["leg_1.k"]) == "leg_1.k: 1.000000, fixed, nominal 1.000000"


def test_a_folder_to_import_is_asked_about(tmp_path: Path) -> None:
    """The file in it is named; it was taken for a table."""
    (tmp_path / "robot.urdf").write_text("<robot/>")
    outcome = run("import", tmp_path, "-o", tmp_path / "out")
    assert outcome.code == 2
    assert f"is a folder; name the file to read, such as {tmp_path / 'robot.urdf'}" in outcome.err


def test_many_undetermined_parameters_are_not_all_listed() -> None:
    """Dozens that move together are counted by leg."""
    mechanism, _, data = machine("6UPS", 36)
    near = np.array(mechanism.platform.home) + 1e-3 * (data.poses - data.poses.mean(axis=0))
    near = pincal.simulate(mechanism, mechanism, pincal.Plan(near), NOISE, seed=1).measurements
    with pytest.raises(pincal.ObservabilityError) as caught:
        pincal.calibrate(mechanism, near, strict=True)
    named = str(caught.value).partition(" move together")[0]
    assert re.search(r": 8 parameters of leg_1, .* and [0-9] parameters of leg_6$", named)
    assert named.count("leg_") == 6
    assert len(str(caught.value)) < 1500


@pytest.fixture(scope="module")
def tables(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Measurements of a 3-RRR: without phi, and six rows; readings alone of cables."""
    folder = tmp_path_factory.mktemp("tables")
    mechanism, _, data = machine("3RRR", 24, NOISE)
    unturned = data.poses.copy()
    unturned[:, 2] = np.nan
    replace(data, poses=unturned).to_csv(folder / "no_phi.csv", mechanism)
    data.rows(np.arange(6)).to_csv(folder / "six.csv", mechanism)
    cables, _, lines = machine("4cable", 40, NOISE)
    readings_only = replace(lines, poses=np.full_like(lines.poses, np.nan))
    readings_only.to_csv(folder / "lines.csv", cables)
    return folder


def calibrated(*words: object) -> Outcome:
    """Run a calibration that draws no report."""
    return run("calibrate", *words, "--no-report", "--folds", "0")


def test_a_coordinate_that_is_not_measured_is_said_in_a_line(tables: Path) -> None:
    """A column phi that is missing is named, with what that means; not so where it is there."""
    given = ("--noise-position", "0.1mm", "--noise-reading", "1e-5")
    outcome = calibrated("3RRR", tables / "no_phi.csv", *given, "-o", tables / "no_phi")
    assert outcome.code == 0
    said = "phi: forecast, not measured"
    assert said in " ".join(outcome.out.split())
    whole = calibrated(
        "3RRR", tables / "six.csv", *given, "--noise-orientation", "0.1mrad", "-o", tables / "six"
    )
    assert "not measured" not in whole.out


def test_what_is_not_determined_is_measured_next(tables: Path) -> None:
    """Cables without positions: what comes next names what to measure, and works as it stands."""
    outcome = calibrated(
        "4cable", tables / "lines.csv", "--noise-reading", "0.1mm", "-o", tables / "cables"
    )
    assert "Not determined" in outcome.out
    assert "x, y, z: forecast, not measured" in outcome.out
    (line,) = re.findall(r"next: (pincal .*)", outcome.out)
    _, command, *words = shlex.split(line)
    assert command == "select"
    assert words[words.index("--measure") + 1] == "x,y,z"
    words[words.index("-o") + 1] = str(tables / "plan.csv")
    assert re.search(r"x, y, z", done(command, *words, "--count", 8, "--starts", 1).out)


@pytest.mark.parametrize(
    "noise", [(), ("--noise-position", "0.1mm", "--noise-orientation", "1e-4")]
)
def test_too_few_rows_are_too_few_for_the_doctor(tables: Path, noise: tuple[str, ...]) -> None:
    """He counts what is missing, and tries neither frames nor terms; with noise and without."""
    outcome = run("doctor", "3RRR", tables / "six.csv", *noise)
    assert outcome.code == 1
    assert "too few rows: measure 2 more at least, better 10" in outcome.out
    assert "pincal select 3RRR -o PLAN.csv" in outcome.out
    assert not re.search("explain|elsewhere|frame", outcome.out)


def test_few_rows_without_noise_are_refused_with_the_reason(tables: Path) -> None:
    """With noise given they are accepted, and few; without, it says that the noise is why."""
    noise = ("--noise-position", "0.1mm", "--noise-orientation", "1e-4")
    accepted = calibrated("3RRR", tables / "six.csv", *noise, "-o", tables / "accepted")
    assert "6 poses for 8 parameters" in accepted.err
    refused = calibrated("3RRR", tables / "six.csv", "-o", tables / "refused")
    assert refused.code == 2
    assert "The noise was not given, and so few rows do not show it; give it" in refused.trouble


def test_wrong_kinds_are_named_as_the_documentation_names_them() -> None:
    """Articles, None, and all that is taken."""
    with pytest.raises(
        pincal.MeasurementError, match=r"noise of Options: expected Noise \| None; got 3"
    ):
        pincal.calibrate("3RRR", "none.csv", noise=3)
    with pytest.raises(
        pincal.MeasurementError,
        match="measurements: expected Measurements or a CSV file; got 3",
    ):
        pincal.calibrate("3RRR", 3)
