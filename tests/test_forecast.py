"""Forecasts: the bound that calibrations reach, for any part of the pose that is measured."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from arms import loaded
from command_line import done, run
from differences import differentiated
from marks import quick
from measured import put, seen_from_elsewhere, workspace

import pincal
from pincal.estimation.observability.identifiable import plausible_changes
from pincal.show.explanation import forecast_lines
from pincal.show.tables import standard_errors

NOISE = pincal.Noise(1e-4, 2e-4, 3e-5)


@pytest.fixture(scope="module")
def poses() -> dict[str, np.ndarray]:
    """Some poses of each bundled mechanism."""
    return {name: workspace(name, 40) for name in ("5R", "3RRR", "6UPS", "4cable")}


def readings(mechanism: pincal.Mechanism, values: np.ndarray, poses: np.ndarray) -> np.ndarray:
    """Return the readings of a mechanism with other parameters, shape (N, n_legs)."""
    parts = np.split(values, np.cumsum([len(leg.parameters) for leg in mechanism.legs])[:-1])
    changed = mechanism.with_parameters(dict(zip(mechanism.leg_names, parts, strict=True)))
    return pincal.inverse(changed, poses).readings


def fisher(mechanism: pincal.Mechanism, poses: np.ndarray, measured: list[int]) -> np.ndarray:
    """Return the information of the parameters, every pose an unknown, by central differences.

    The pose enters with its own measurements, and is eliminated by the Schur complement.
    """
    start, dof = np.concatenate([leg.nominal for leg in mechanism.legs]), mechanism.platform.dof
    by_parameter = differentiated(lambda h: readings(mechanism, start + h, poses), len(start))
    by_pose = differentiated(lambda h: readings(mechanism, start, poses + h), dof)
    prior = np.zeros(mechanism.platform.dof)
    prior[measured] = NOISE.of_poses(mechanism)[measured] ** -2
    weight = NOISE.reading**-2
    total = np.zeros((len(start), len(start)))
    for P, X in zip(by_parameter, by_pose, strict=True):
        own, cross = weight * X.T @ X + np.diag(prior), weight * P.T @ X
        total += weight * P.T @ P - cross @ np.linalg.solve(own, cross.T)
    return total


@pytest.mark.parametrize(
    ("name", "measured"),
    quick(3, [("5R", "x,y"), ("5R", "x"), ("3RRR", "y,phi"), ("3RRR", "x,y,phi"), ("3RRR", "x,y")]),
)
def test_information_equals_that_of_latent_poses(
    poses: dict[str, np.ndarray], name: str, measured: str
) -> None:
    """Schur complement of a Fisher matrix by differences of inverse kinematics alone."""
    mechanism = pincal.load_mechanism(name)
    some = poses[name][:20]
    found = pincal.forecast(mechanism, some, NOISE, measured.split(","))
    rows = [mechanism.platform.freedoms.index(m) for m in measured.split(",")]
    expected = fisher(mechanism, some, rows)
    scale = np.sqrt(np.diagonal(expected))
    values, axes = np.linalg.eigh(expected / np.outer(scale, scale))
    n_lost = found.rank.n_params - found.rank.rank
    lost = np.arange(len(values)) < n_lost
    if not n_lost:
        covariance = np.linalg.inv(expected)
        np.testing.assert_allclose(found.std, np.sqrt(np.diagonal(covariance)), rtol=1e-3)
    else:
        assert values[n_lost - 1] < 1e-2 * values[n_lost]  # what differences leave of zero
        kept, free = axes[:, ~lost] / scale[:, None], axes[:, lost] / scale[:, None]
        near = free.T / plausible_changes(mechanism) ** 2  # of all equal parameters the nearest
        follow = np.eye(len(scale)) - free @ np.linalg.solve(near @ free, near)
        variance = ((follow @ kept) ** 2 / values[~lost]).sum(axis=1)
        finite = np.isfinite(found.std)
        assert finite.any()
        np.testing.assert_allclose(found.std[finite], np.sqrt(variance[finite]), rtol=1e-2)


@pytest.mark.parametrize("name", ["5R", "3RRR", "6UPS", "4cable"])
def test_full_poses_give_the_covariance_of_the_calibration(
    poses: dict[str, np.ndarray], name: str
) -> None:
    """Of all legs together, on exact data: parameters and platform alike."""
    mechanism = pincal.load_mechanism(name)
    exact = pincal.simulate(
        mechanism, mechanism, pincal.Plan(poses[name]), pincal.Noise(0.0, 0.0, 0.0)
    ).measurements
    result = pincal.calibrate(mechanism, exact, poses="all", noise=NOISE)
    found = pincal.forecast(mechanism, poses[name], NOISE)
    assert found.rank.complete
    np.testing.assert_allclose(found.covariance, result.covariance, rtol=1e-6, atol=1e-18)
    one = found.platform_error(poses[name])
    other = result.expected_error(poses[name])
    assert one.position == pytest.approx(other.position, rel=1e-6)
    assert one.orientation == pytest.approx(other.orientation, rel=1e-6)


@pytest.mark.parametrize("name", ["3RRR", "6UPS"])
def test_frames_that_are_not_measured_are_chosen_alike(
    poses: dict[str, np.ndarray], name: str
) -> None:
    """Of an unknown frame too: forecast and calibration take the same of all equal parameters."""
    mechanism, setup = pincal.load_mechanism(name), pincal.Setup(unknown_frame=True)
    plan, exact = pincal.Plan(poses[name]), pincal.Noise(0.0, 0.0, 0.0)
    data = pincal.simulate(mechanism, mechanism, plan, exact).measurements
    result = pincal.calibrate(
        mechanism, seen_from_elsewhere(mechanism, data), noise=NOISE, setup=setup
    )
    found = pincal.forecast(mechanism, plan, NOISE, setup=setup)
    std = np.array([p.std for leg in result.legs for p in leg.parameters])
    np.testing.assert_allclose(found.std, std, rtol=1e-5)


def test_what_positions_alone_do_not_tell(poses: dict[str, np.ndarray]) -> None:
    """The platform's frame may turn: platform azimuths move together, all else stays known."""
    mechanism = pincal.load_mechanism("3RRR")
    found = pincal.forecast(mechanism, poses["3RRR"], NOISE, ["x", "y"])
    assert found.rank.rank == 23
    words = "leg_1.beta_b, leg_2.beta_b and leg_3.beta_b move together"
    assert found.rank.describe() == words
    names = [name for leg in mechanism.legs for name in leg.parameter_names]
    turned = found.gauge[:, 0] / np.abs(found.gauge[:, 0]).max()
    moved = [n for n, t in zip(names, turned, strict=True) if abs(t) > 1e-6]
    assert found.gauge.shape[1] == 1
    assert moved == ["beta_b"] * 3
    assert np.isfinite(found.std).all()  # of those nearest to the nominal ones
    error = found.platform_error(poses["3RRR"])  # but for a turn of the platform's frame
    assert 0 < error.position < np.inf
    assert 0 < error.orientation < np.inf
    assert found.poses_for(1e-4, poses["3RRR"]) < np.inf
    hexapod = pincal.load_mechanism("6UPS")
    found = pincal.forecast(hexapod, poses["6UPS"], NOISE, ["x", "y", "z"])
    assert found.rank.rank == 45
    assert found.gauge.shape[1] == 3  # turns of the platform's frame


def test_what_too_few_poses_do_not_tell(poses: dict[str, np.ndarray]) -> None:
    """Seven full poses leave a direction of each leg open, which moves the platform."""
    mechanism = pincal.load_mechanism("3RRR")
    found = pincal.forecast(mechanism, poses["3RRR"][:7], NOISE)
    assert found.rank.rank == 21
    assert (found.gauge.shape[1], found.lost.shape[1]) == (0, 3)
    assert np.isinf(found.std).any()
    assert found.platform_error(poses["3RRR"]).position == np.inf
    assert found.poses_for(1e-4, poses["3RRR"]) == np.inf


def test_what_an_unknown_frame_costs(poses: dict[str, np.ndarray]) -> None:
    """A tracker at an unknown place leaves six freedoms of frames and the platform's error.

    With legs that have all base points among their parameters, frames are theirs to take up.
    """
    mechanism = pincal.load_mechanism("6UPS")
    known = pincal.forecast(mechanism, poses["6UPS"], NOISE)
    unknown = pincal.forecast(
        mechanism, poses["6UPS"], NOISE, setup=pincal.Setup(unknown_frame=True)
    )
    assert (unknown.gauge.shape[1], unknown.lost.shape[1]) == (6, 0)
    assert unknown.rank.rank == known.rank.rank
    free = pincal.forecast(
        mechanism,
        poses["6UPS"],
        NOISE,
        setup=pincal.Setup(unknown_frame=True, targets={"platform": pincal.Target(unknown=True)}),
    )
    assert (free.gauge.shape[1], free.lost.shape[1]) == (12, 0)
    one, other = (f.platform_error(poses["6UPS"]) for f in (unknown, free))
    assert other.position <= one.position * (1 + 1e-9)


def test_errors_fall_with_the_root_of_the_poses(poses: dict[str, np.ndarray]) -> None:
    """As many poses as are said bring the error to what is wanted."""
    mechanism = pincal.load_mechanism("3RRR")
    some = poses["3RRR"]
    one = pincal.forecast(mechanism, some, NOISE)
    four = pincal.forecast(mechanism, np.tile(some, (4, 1)), NOISE)
    np.testing.assert_allclose(four.std, one.std / 2, rtol=1e-9)
    now = one.platform_error(some).position
    assert one.poses_for(now / 2.001, some) == pytest.approx(4 * len(some), abs=1)
    assert one.poses_for(1.0, some) == 8  # never fewer than the parameters need
    with pytest.raises(pincal.MeasurementError, match="more than 0"):
        one.poses_for(0.0, some)


@pytest.mark.parametrize(
    ("measured", "noise", "message"),
    [
        (["q"], NOISE, "no freedom 'q'"),
        ([], NOISE, "leaves no equation"),
        (None, pincal.Noise(0.0, 0.0, 0.0), "no noise at all"),
    ],
)
def test_wrong_questions_are_refused(
    poses: dict[str, np.ndarray], measured: list[str] | None, noise: pincal.Noise, message: str
) -> None:
    """Unknown freedoms, nothing measured, nothing uncertain."""
    with pytest.raises(pincal.MeasurementError, match=message):
        pincal.forecast(pincal.load_mechanism("3RRR"), poses["3RRR"], noise, measured)


@pytest.mark.slow
def test_the_command(tmp_path: Path, poses: dict[str, np.ndarray]) -> None:
    """Standard errors by leg, rank, what moves together, and the poses for an accuracy."""
    mechanism = pincal.load_mechanism("3RRR")
    plan = tmp_path / "plan.csv"
    pincal.Plan(poses["3RRR"]).to_csv(plan, mechanism)
    noise = ["--noise-position", 1e-4, "--noise-orientation", 2e-4, "--noise-reading", 3e-5]
    outcome = done("identifiability", "3RRR", plan, *noise, "--accuracy", 1e-5)
    assert "rank 24 of 24" in outcome.out
    assert "for 0.01 mm: " in outcome.out
    assert "less noise" not in outcome.out
    far = done("identifiability", "3RRR", plan, *noise, "--accuracy", 1e-9)
    assert "too many to measure: reduce the noise" in " ".join(far.out.split())
    assert "more than 0" in run("identifiability", "3RRR", plan, "--accuracy", "inf").trouble
    std = pincal.forecast(mechanism, poses["3RRR"], NOISE).std
    assert f" {1e3 * std[0]:.2g} " in outcome.out
    outcome = done("identifiability", "3RRR", plan, "--measure", "position", "--accuracy", 1e-5)
    said = " ".join(outcome.out.split())
    assert "rank 23 of 24: 1 freedom of frames" in said
    assert "(leg_1.beta_b, leg_2.beta_b and leg_3.beta_b move together)" in said
    outcome = done("identifiability", "3RRR", plan, *noise, "--unknown-frame", "--unknown-target")
    said = " ".join(outcome.out.split())
    assert ": 6 freedoms of frames" in said
    assert "not determined" not in said
    assert "frame x" not in said
    few = tmp_path / "few.csv"
    pincal.Plan(poses["3RRR"][:7]).to_csv(few, mechanism)
    said = " ".join(done("identifiability", "3RRR", few).out.split())
    assert "not determined (—): leg_" in said
    assert "position not determined, orientation not determined" in said
    assert "freedom" not in said
    outcome = done("identifiability", "5R", "--measure", "x")
    assert "measured: x" in outcome.out
    assert run("identifiability", "3RRR", "--measure", "nothing").code == 2


def test_what_is_not_determined_is_so_in_words_and_table() -> None:
    """Of an arm's freedoms each is named once; parameters in words have no number in the table."""
    arm = loaded("ur5")
    plan, setup = pincal.sample_configurations(arm, 30, 1), pincal.Setup().anywhere(frame=True)
    expected = pincal.forecast(arm, plan, NOISE, ["x", "y", "z"], setup)
    first, lost, *_ = forecast_lines(expected, expected.platform_error(plan))
    rank, unknowns, frames = map(int, re.findall(r"\d+", first)[:3])
    assert rank + frames + int(re.findall(r", (\d+) freedoms more", lost)[0]) == unknowns
    rows = {str(row[0]): str(row[-1]) for row in standard_errors(expected).cells()}
    assert {rows[name] for name in re.findall(r"\.(\w+) and \w+\.\w+ move", lost)} == {"—"}
    assert "held" in rows.values()


def test_measurements_without_noise_are_refused() -> None:
    """What is exact has no information that could be weighed."""
    mechanism = pincal.load_mechanism("3RRR")
    plan = pincal.sample_configurations(mechanism, 20, 0)
    with pytest.raises(pincal.MeasurementError, match="no noise at all"):
        pincal.forecast(mechanism, plan, pincal.Noise(0.0, 0.0, 0.0))


def test_what_people_see(poses: dict[str, np.ndarray]) -> None:
    """A line, and a page of forty lines."""
    found = pincal.forecast(pincal.load_mechanism("6UPS"), poses["6UPS"], NOISE, ["x", "y", "z"])
    assert repr(found) == "Forecast('6UPS', 40 poses, rank 45 of 48)"
    assert len(str(found).splitlines()) <= 40
    assert "leg_1" in str(found)
    assert "not determined apart" in str(found)


def test_a_parameter_without_effect_spoils_no_other() -> None:
    """An arm's last joint does not move its tip: others are as certain in any order of rows."""
    arm, setup = loaded("ur5"), pincal.Setup().anywhere(frame=True)
    plan = pincal.sample_configurations(arm, 30, 1)
    turned = plan.rows(np.arange(30)[::-1])
    stds = [
        pincal.forecast(arm, rows, NOISE, ["x", "y", "z"], setup).std for rows in (plan, turned)
    ]
    np.testing.assert_allclose(*stds, rtol=1e-6, atol=1e-12)


def test_an_arm_is_as_certain_as_forecast() -> None:
    """Positions in an unknown frame: the same parameters have intervals, of the same size."""
    arm, setup = loaded("ur5"), pincal.Setup().anywhere(frame=True)
    plan = pincal.sample_configurations(arm, 30, 1)
    data = pincal.simulate(arm, arm, plan, NOISE, 1, setup).measurements
    seen = put(data, "poses", np.s_[:, 3:], np.nan)
    result = pincal.calibrate(arm, seen, noise=NOISE, setup=setup)
    std = [parameter.std for parameter in result.legs[0].parameters]
    expected = pincal.forecast(arm, plan, NOISE, ["x", "y", "z"], setup).std
    np.testing.assert_allclose(std, expected, rtol=0.01, atol=1e-12)
