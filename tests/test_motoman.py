"""Two real arms of seven joints seen by a laser tracker. Skipped where the data are absent."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import motoman
import numpy as np
import pytest
from marks import slow_or_fuzz
from motoman import SIDES, table_of
from scipy.spatial.transform import Rotation

import pincal
from pincal.estimation.observability.identifiable import plausible_changes
from pincal.estimation.problem import Linear, Problem
from pincal.estimation.unknowns import State

pytestmark = pytest.mark.skipif(
    not all(motoman.data_file(side).is_file() for side in SIDES),
    reason=f"no measurements in {motoman.DATA}",
)
NOISE = pincal.Noise(5e-5, 1e-4, 0.0)
SETUP = pincal.Setup(unknown_frame=True)


#: Root mean square distance held out, over ten splits, [m].
BOUNDS = {"left": 0.080e-3, "right": 0.074e-3}


@pytest.fixture(scope="module")
def mechanism() -> pincal.Mechanism:
    """The left arm of the nominal table."""
    return motoman.mechanism("left")


@pytest.fixture(scope="module")
def data() -> pincal.Measurements:
    """Positions of the left arm's reflector in the tracker's frame, and readings, of 208 rows."""
    return motoman.measurements("left")


@cache
def calibrated(seed: int) -> pincal.CalibrationResult:
    """Return the left arm by 70 % of its rows, the tracker's place unknown."""
    rows, _ = motoman.split("left", seed)
    data, known = motoman.measurements("left").rows(rows), {"noise": NOISE, "setup": SETUP}
    return pincal.calibrate(motoman.mechanism("left"), data, rough=True, **known)


def external(result: pincal.CalibrationResult) -> tuple[Rotation, np.ndarray]:
    """Return where the base stands in the tracker's frame."""
    frame = np.array([one.identified for one in result.external])
    return Rotation.from_rotvec(frame[3:]), frame[:3]


@pytest.mark.parametrize("side", SIDES)
def test_nominal_table(side: str) -> None:
    """The arm's forward kinematics are the product of the table's transforms."""
    mechanism = motoman.mechanism(side)
    readings = np.random.default_rng(0).uniform(-2.0, 2.0, (5, 7))
    poses = pincal.forward(mechanism, readings).poses
    independent, _ = motoman.positions(side, readings, np.zeros((8, 6)))
    np.testing.assert_allclose(poses[:, :3], independent, atol=1e-12)
    for pose, q in zip(mechanism.platform.transforms(poses).as_matrix(), readings, strict=True):
        wanted = np.eye(4)
        for (a, d, alpha, theta), turn in zip(table_of(side), [*q, 0.0], strict=True):
            wanted = wanted @ motoman.link(a, d, alpha, theta + turn)
        np.testing.assert_allclose(pose, wanted, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_held_out_rows(mechanism: pincal.Mechanism, data: pincal.Measurements, seed: int) -> None:
    """Identified from 70 % of the rows, the others are predicted to 0.085 mm (root mean square).

    An independent fit of the Denavit-Hartenberg quantities found 0.078 mm; registration alone
    leaves 0.380 mm. The first joint stood still: four directions are held and named. Of equal
    parameters those nearest to the drawing are taken, by how much machines differ from one: those
    that no held direction moves are known to within that, the others have no interval.
    """
    verification = data.rows(motoman.split("left", seed)[1])
    result = calibrated(seed)
    assert result.converged
    turn, shift = external(result)
    points = pincal.forward(result.identified, verification.readings).poses[:, :3]
    off = turn.apply(points) + shift - verification.poses[:, :3]
    rms = float(np.sqrt((off**2).sum(axis=1).mean()))
    print(f"seed {seed}: {1e3 * rms:.4f} mm held out")
    assert rms <= 0.085e-3
    assert result.legs[0].rank == 27
    (redundant,) = (one for one in result.gauge if one.code == "redundant-parameters")
    assert redundant.values["count"] == 14
    (held,) = (one for one in result.findings if one.code == "undetermined-held")
    assert len(held.values["groups"]) == 4
    assert any("arm.q_S_ry" in group for group in held.values["groups"])
    assert held.values["weak"] == ()
    std = np.array([p.std for p in result.legs[0].parameters])
    known = np.isfinite(std)
    assert (std[known] <= plausible_changes(mechanism)[known]).all()
    assert len(std) / 2 < known.sum() < len(std)


def test_the_joint_that_stood_still_is_refused(
    mechanism: pincal.Mechanism, data: pincal.Measurements
) -> None:
    """Where that is asked for, directions that the rows do not tell are refused by name."""
    assert np.ptp(data.readings[:, 0]) == 0.0
    with pytest.raises(pincal.ObservabilityError, match=r"q_S_x.*--strict"):
        pincal.calibrate(mechanism, data, noise=NOISE, setup=SETUP, rough=True, strict=True)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("side", "framed"),
    [("left", True), ("right", False)],
    ids=["left, unknown frame", "right, aligned"],
)
def test_ten_splits(side: str, framed: bool) -> None:
    """Ten splits in 70 % and 30 %: converged in all, held out as well as by an independent fit.

    Within 3 % of SciPy's Levenberg-Marquardt on every split (weak directions are held here), with
    the tracker's place unknown or positions moved into the base frame by a rigid alignment of the
    rows fitted. SciPy's over ten splits: 0.0774 mm (left) and 0.0729 mm (right, 0.0716 over the
    first five).
    """
    mechanism, data = motoman.mechanism(side), motoman.measurements(side)
    squares, lost, worse = [], [], []
    for seed in range(10):
        rows, others = motoman.split(side, seed)
        seen = data
        if framed:
            result = calibrated(seed)
        else:
            nominal, _ = motoman.positions(side, data.readings, np.zeros((8, 6)))
            turn, shift = motoman.aligned(data.poses[rows, :3], nominal[rows])
            poses = data.poses.copy()
            poses[:, :3] = turn.apply(poses[:, :3]) + shift
            seen = replace(data, poses=poses)
            result = pincal.calibrate(mechanism, seen.rows(rows), noise=NOISE, rough=True)
        turn, shift = external(result) if framed else (Rotation.identity(), np.zeros(3))
        points = pincal.forward(result.identified, data.readings[others]).poses[:, :3]
        off = turn.apply(points) + shift - seen.poses[others, :3]
        squares.append(float((off**2).sum(axis=1).mean()))
        wanted = motoman.reference(side, seed).held_out
        print(f"{side} {seed}: {1e3 * squares[-1] ** 0.5:.4f} mm, SciPy {1e3 * wanted:.4f}")
        if not result.converged:
            lost.append((seed, result.message))
        if squares[-1] ** 0.5 > 1.03 * wanted:
            worse.append((seed, squares[-1] ** 0.5, wanted))
    assert not lost
    assert not worse
    assert np.mean(squares) ** 0.5 <= BOUNDS[side]


@pytest.mark.parametrize(
    ("side", "least"), slow_or_fuzz([("left", 0.0739e-3)], [("right", 0.0669e-3)])
)
def test_gravity_on_all_joints_pays(side: str, least: float) -> None:
    """Held out as an independent fit of ten splits says: 0.0774 to 0.0739 mm, 0.0729 to 0.0669.

    Small, but there: chance below 1e-10. What weighs how much does not count, only where it is.
    """
    alone = [motoman.reference(side, seed).under_weight for seed in range(10)]
    assert np.sqrt(np.mean(np.square(alone))) == pytest.approx(least, rel=2e-3)
    load = pincal.Load(5.0, (0.0, 0.0, 0.0), (0.0, 0.0, -9.81))
    found = pincal.explain(
        replace(motoman.mechanism(side), load=load),
        motoman.measurements(side),
        noise=NOISE,
        setup=SETUP,
        rough=True,
        terms="gravity",
    )
    geometry, gravity = found.models[1:3]
    assert found.terms == ("gravity",)
    assert gravity.chance < 1e-10
    assert gravity.position == pytest.approx(least, rel=0.03)
    assert gravity.position < 0.96 * geometry.position


@pytest.mark.slow
def test_the_independent_fit() -> None:
    """SciPy's fits of five splits: 0.0716 mm held out (right arm), where registration leaves 0.34.

    Rank 27 of 48 displacements: so many numbers are all that positions can tell.
    """
    found = [motoman.reference("right", seed) for seed in range(5)]
    assert {one.rank for one in found} == {27}
    assert np.mean([one.held_out for one in found]) == pytest.approx(0.0716e-3, rel=2e-3)
    assert np.mean([one.registered for one in found]) == pytest.approx(0.344e-3, rel=0.03)


@pytest.mark.slow
@pytest.mark.parametrize("side", SIDES)
def test_noise_that_is_not_given_holds_at_nominal_values(side: str) -> None:
    """Without a noise rows held out are as well predicted as by an independent fit, within 3 %.

    What estimated noise leaves undetermined is held at nominal values, not where a search at the
    assumed noise had taken it: the same noise given finds the same parameters, from the table. (The
    rows determine the tool to 28 mm, 66 to 82 mm off for the right arm.)
    """
    mechanism, data = motoman.mechanism(side), motoman.measurements(side)
    squares, wanted = [], []
    for seed in range(2):
        rows, others = motoman.split(side, seed)
        result = pincal.calibrate(mechanism, data.rows(rows), setup=SETUP, rough=True)
        turn, shift = external(result)
        points = pincal.forward(result.identified, data.readings[others]).poses[:, :3]
        off = turn.apply(points) + shift - data.poses[others, :3]
        squares.append((off**2).sum(axis=1).mean())
        wanted.append(motoman.reference(side, seed).held_out ** 2)
        given = pincal.calibrate(
            mechanism, data.rows(rows), noise=result.noise, setup=SETUP, rough=True
        )
        for p, same in zip(result.parameters, given.parameters, strict=True):
            assert abs(p.change - same.change) <= 0.02 * min(p.std, 0.05) + 1e-9
    assert np.mean(squares) <= 1.03**2 * np.mean(wanted)


@pytest.mark.slow
def test_refits_at_other_noise_stay_near(
    mechanism: pincal.Mechanism, data: pincal.Measurements, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The default fit of the left arm evaluates its conditions 400 times at most, not 970 times.

    Directions that noise barely determines are curved valleys. A search without adjusted readings,
    begun where one with them had ended, led up and away. It takes 334.
    """
    counted, evaluate = [], Problem.evaluate

    def evaluated(problem: Problem, state: State) -> Linear:
        counted.append(len(state.matrices))
        return evaluate(problem, state)

    monkeypatch.setattr(Problem, "evaluate", evaluated)
    result = pincal.calibrate(mechanism, data, setup=SETUP, rough=True)
    assert result.converged
    assert len(counted) <= 400
