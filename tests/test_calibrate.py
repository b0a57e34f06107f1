"""Identification: recovery, other solvers, statistics, and what must be refused."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from closed_forms import closure
from command_line import done, run
from differences import differentiated
from marks import quick
from measured import error, shaken, workspace
from scipy.optimize import least_squares

import pincal
from pincal import sample_workspace
from pincal.calibration.result_files import read_result
from pincal.workspace.criteria import in_workspace
from studies import three_rrr_errors
from studies.trials import Way, machines

EXACT = pincal.Noise(0.0, 0.0, 0.0)
#: Table 2 of the 5R paper, put in order.
TABLE_2 = {
    "leg_1": {
        "l": 0.7478,
        "L": 1.1006,
        "A_x": -0.5057,
        "A_y": 0.0060,
        "k": 1.0041,
        "gamma": 6.4e-4,
    },
    "leg_2": {
        "l": 0.7417,
        "L": 1.1014,
        "A_x": 0.5059,
        "A_y": -1.9e-4,
        "k": 1.0045,
        "gamma": 0.0046,
    },
}


@pytest.mark.parametrize(
    ("method", "poses"), quick(2, [("per-leg", "own"), ("all-legs", "own"), ("per-leg", "all")])
)
def test_clean_data_recover_the_parameters(
    kind: str, method: str, poses: str, selections: dict[str, pincal.Selection]
) -> None:
    """Parameters disturbed by 5e-3 come back to 1e-9 by every method."""
    mechanism = pincal.load_mechanism(kind)
    truth = pincal.disturb(mechanism, 5e-3, 0)
    data = pincal.simulate(mechanism, truth, selections[kind].plan, EXACT).measurements
    result = pincal.calibrate(
        mechanism,
        data,
        noise=pincal.Noise(1e-4, 1e-4, 1e-5),
        method=method,
        poses=poses,  # type: ignore[arg-type]
    )
    assert result.converged
    assert error(result, truth) < 1e-9
    assert all(leg.rms_after < 1e-12 < leg.rms_before for leg in result.legs)


def test_table_2_of_the_5r_paper_is_recovered(selections: dict[str, pincal.Selection]) -> None:
    """The paper's real parameters come back to 1e-9 from 18 postures a leg."""
    mechanism = pincal.load_mechanism("5R")
    truth = mechanism.with_parameters(TABLE_2)
    data = pincal.simulate(mechanism, truth, selections["5R"].plan, EXACT).measurements
    assert len(data) == 36
    result = pincal.calibrate(mechanism, data)
    assert error(result, truth) < 1e-9
    identified = {leg.name: {p.name: p.identified for p in leg.parameters} for leg in result.legs}
    for leg, values in TABLE_2.items():
        assert identified[leg] == pytest.approx(values, abs=1e-9)


def noisy(
    kind: str, plan: pincal.Plan, seed: int, noise: pincal.Noise, sigma: float = 2e-3
) -> tuple[pincal.Mechanism, pincal.Mechanism, pincal.Measurements]:
    """Return nominal and true mechanism, and noisy measurements."""
    mechanism = pincal.load_mechanism(kind)
    truth = pincal.disturb(mechanism, sigma, seed)
    return mechanism, truth, pincal.simulate(mechanism, truth, plan, noise, seed).measurements


def independent_solution(
    residual: Callable[[np.ndarray], np.ndarray], start: np.ndarray
) -> np.ndarray:
    """Return SciPy's optimum, with derivatives by differences of fourth order."""

    def jacobian(x: np.ndarray) -> np.ndarray:
        return differentiated(lambda h: residual(x + h), len(x))

    found = least_squares(residual, start, jac=jacobian, x_scale="jac", xtol=1e-15, ftol=1e-15)
    for _ in range(3):
        found.x = found.x - np.linalg.lstsq(jacobian(found.x), residual(found.x), rcond=None)[0]
    return found.x


def test_closure_optimum_equals_an_independent_solver(
    kind: str, selections: dict[str, pincal.Selection]
) -> None:
    """SciPy on the closed form, same weights, finds the same parameters to 1e-9."""
    mechanism, _, data = noisy(kind, selections[kind].plan, 4, pincal.Noise(1e-4, 1e-4, 1e-5))
    noise = pincal.Noise(1e-4, 1e-4, 1e-5)
    result = pincal.calibrate(mechanism, data, noise=noise, method="per-leg")
    for index, leg in enumerate(mechanism.legs):
        own = data.serves(leg.name)
        poses, psi = data.poses[own], data.readings[own, index]
        names = leg.parameter_names
        sigma = result.legs[index].sigma

        def whitened(values: np.ndarray, index: int = index, names: tuple = names) -> np.ndarray:
            p = dict(zip(names, values, strict=True))
            return closure(kind, index, p, poses, psi) / sigma  # noqa: B023

        other = independent_solution(whitened, leg.nominal)
        assert np.abs(other - result.legs[index].identified).max() < 1e-9
        values = np.abs(closure(kind, index, dict(zip(names, other, strict=True)), poses, psi))
        np.testing.assert_allclose(np.abs(result.legs[index].residuals), values, atol=1e-9)


def errors_of_noise(
    kind: str, truth: pincal.Mechanism, clean: pincal.Measurements, noise: pincal.Noise
) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return of each leg its rows, and what errors of poses and readings make of its parameters.

    By differences of closed forms: least squares of closures, weighted by their noise. Errors of a
    row are those of the pose, then that of the reading; the map has shape (n, N, dof + 1).
    """
    sigma = np.append(noise.of_poses(truth), noise.reading)
    maps = {}
    for index, leg in enumerate(truth.legs):
        rows = clean.serves(leg.name)
        poses, psi = clean.poses[rows], clean.readings[rows, index]
        n, dof = len(leg.nominal), poses.shape[1]

        def off(
            move: np.ndarray,
            index: int = index,
            leg: pincal.Leg = leg,
            poses: np.ndarray = poses,
            psi: np.ndarray = psi,
        ) -> np.ndarray:
            values, pose, turn = np.split(move, (len(leg.nominal), len(move) - 1))
            p = dict(zip(leg.parameter_names, leg.nominal + values, strict=True))
            return closure(kind, index, p, poses + pose, psi + turn)

        J, D = np.split(differentiated(off, n + dof + 1), [n], axis=1)
        root = 1.0 / np.linalg.norm(D * sigma, axis=1)
        maps[leg.name] = rows, -(np.linalg.pinv(root[:, None] * J) * root)[:, :, None] * D
    return maps


@pytest.mark.slow
def test_standard_errors_of_each_leg_are_those_of_its_noise(
    kind: str, selections: dict[str, pincal.Selection]
) -> None:
    """The propagated ones, to 1e-4; the errors of noisy fits are what this map makes of the noise.

    Hence errors are normal and unbiased, as large as said, and intervals of ± 1.96 cover 95 %:
    nothing of this is left to chance. All legs together: tests/test_statistics.py.
    """
    noise, plan = pincal.Noise(1e-4, 1e-4, 5e-5), selections[kind].plan
    mechanism = pincal.load_mechanism(kind)
    truth = pincal.disturb(mechanism, 2e-3, seed=11)
    clean = pincal.simulate(mechanism, truth, plan, EXACT).measurements
    maps = errors_of_noise(kind, truth, clean, noise)
    sigma = np.append(noise.of_poses(truth), noise.reading)
    std = {leg: np.sqrt(((by * sigma) ** 2).sum(axis=(1, 2))) for leg, (_, by) in maps.items()}
    for leg in pincal.calibrate(truth, clean, noise=noise, method="per-leg").legs:
        np.testing.assert_allclose(leg.std, std[leg.name], rtol=1e-4)
    for seed in range(3):
        data = shaken(mechanism, clean, noise, seed)
        result = pincal.calibrate(mechanism, data, noise=noise, method="per-leg")
        chance = np.sqrt(2.0 / result.degrees_of_freedom)
        assert abs(result.reduced_chi2 - 1) < 3.5 * chance
        for index, (leg, true) in enumerate(zip(result.legs, truth.legs, strict=True)):
            rows, by = maps[leg.name]
            off = np.column_stack((data.poses, data.readings[:, index]))
            off -= np.column_stack((clean.poses, clean.readings[:, index]))
            error = np.einsum("pnj,nj->p", by, off[rows])
            assert (np.abs(leg.identified - true.nominal - error) < 0.1 * std[leg.name]).all()
            half = [(p.high - p.low) / 2 for p in leg.parameters]
            np.testing.assert_allclose(half, 1.96 * std[leg.name], rtol=0.05)


def test_expected_platform_error_is_the_covariance_carried_on(
    kind: str, candidates: dict[str, np.ndarray], selections: dict[str, pincal.Selection]
) -> None:
    """Expected error² is the sum of the errors² that the columns of a root of the covariance make.

    They are made by driving the identified mechanism with slightly different models.
    """
    noise, poses = pincal.Noise(1e-6, 1e-6), candidates[kind][:200]
    mechanism, _, data = noisy(kind, selections[kind].plan, 21, noise)
    result = pincal.calibrate(mechanism, data, noise=noise, poses="all")
    sums = np.zeros(2)
    for column in np.linalg.cholesky(result.covariance).T:
        parts = np.split(column, len(mechanism.legs))
        values = {
            leg.name: leg.nominal + part
            for leg, part in zip(result.identified.legs, parts, strict=True)
        }
        model = result.identified.with_parameters(values)
        made = pincal.accuracy(model, result.identified, poses)
        sums += np.square([made.position, made.orientation])
    expected = result.expected_error(poses)
    assert expected.poses == 200
    found = np.array([expected.position, expected.orientation])
    np.testing.assert_allclose(found, np.sqrt(sums), rtol=1e-3)


def test_an_outlier_is_pointed_out(kind: str, selections: dict[str, pincal.Selection]) -> None:
    """A position 30 mm off is named by its row in the warnings."""
    mechanism, _, data = noisy(kind, selections[kind].plan, 19, pincal.Noise())
    poses = data.poses.copy()
    poses[2, 0] += 0.03
    wrong = pincal.Measurements(poses, data.sets, readings=data.readings)
    result = pincal.calibrate(mechanism, wrong, noise=pincal.Noise())
    assert any("data row 3 " in text for text in result.warnings)


@pytest.mark.slow
def test_protocol_of_the_paper_improves_the_platform(
    candidates: dict[str, np.ndarray], selections: dict[str, pincal.Selection]
) -> None:
    """3-RRR, 24 poses a leg, disturbance 2e-3, noise 1e-4: position RMSE falls 40-fold.

    Median over 15 machines, over 3,000 of the workspace poses.
    """
    noise, ratios = pincal.Noise(1e-4, 1e-4, 0.0), []
    for seed in range(15):
        mechanism, truth, data = noisy("3RRR", selections["3RRR"].plan, seed, noise)
        identified = pincal.calibrate(mechanism, data, noise=noise).identified
        before = pincal.accuracy(mechanism, truth, candidates["3RRR"][::10])
        after = pincal.accuracy(identified, truth, candidates["3RRR"][::10])
        ratios.append(before.position / after.position)
    assert np.median(ratios) >= 40


def test_a_pose_out_of_nominal_reach_does_not_stop_the_closure_residual(
    selections: dict[str, pincal.Selection],
) -> None:
    """A measured pose 2 mm beyond leg 1's stretch is fitted."""
    mechanism = pincal.load_mechanism("5R")
    truth = mechanism.with_parameters({"leg_1": {"L": 1.106}, "leg_2": {"L": 1.106}})
    data = pincal.simulate(mechanism, truth, selections["5R"].plan, EXACT).measurements
    stretched = 1.8555 * np.exp(1.1j) - 0.5  # the nominal leg 1 reaches 1.85
    pose = np.array([[stretched.real, stretched.imag]])
    readings = pincal.inverse(truth, pose).readings
    assert not pincal.inverse(mechanism, pose).reached[0, 0]
    assert np.isfinite(readings).all()
    poses = np.concatenate((data.poses, pose))
    more = pincal.Measurements(poses, readings=np.concatenate((data.readings, readings)))
    result = pincal.calibrate(mechanism, more, noise=pincal.Noise(1e-4))
    assert result.converged
    assert error(result, truth) < 1e-9


def test_noise_scale_does_not_change_the_estimate(
    kind: str, selections: dict[str, pincal.Selection]
) -> None:
    """Only ratios of the noise matter to the estimate; unknown, they and its scale are found."""
    mechanism, _, data = noisy(kind, selections[kind].plan, 6, pincal.Noise(3e-4, 3e-4))
    one = pincal.calibrate(mechanism, data, noise=pincal.Noise(3e-4, 3e-4))
    ten = pincal.calibrate(mechanism, data, noise=pincal.Noise(3e-3, 3e-3))
    unknown = pincal.calibrate(mechanism, data)
    for a, b, c in zip(one.legs, ten.legs, unknown.legs, strict=True):
        np.testing.assert_allclose(b.identified, a.identified, atol=1e-10)
        np.testing.assert_allclose(b.std, 10 * a.std, rtol=1e-6)
        assert 0.5 < (c.std / a.std).mean() < 1.6
    assert unknown.noise is not None
    found = [unknown.noise.position] + [unknown.noise.orientation] * (kind == "3RRR")
    np.testing.assert_allclose(found, 3e-4, rtol=0.25)
    again = pincal.calibrate(mechanism, data, noise=unknown.noise)
    for c, d in zip(unknown.legs, again.legs, strict=True):
        np.testing.assert_allclose(c.identified, d.identified, atol=1e-10)
    for a, c in zip(one.legs, unknown.legs, strict=True):  # some of it may be given to readings
        assert (np.abs(c.identified - a.identified) < a.std).all()
    assert "no noise was given" in unknown.warnings[0]
    assert not one.warnings
    assert any("smaller than given" in text for text in ten.warnings)


def test_sigmas_of_rows_weigh_the_rows(kind: str, selections: dict[str, pincal.Selection]) -> None:
    """A row with a thousandfold sigma does not pull; without its sigma it does."""
    mechanism, truth, data = noisy(kind, selections[kind].plan, 7, pincal.Noise(1e-5, 1e-5))
    bad = data.poses.copy()
    bad[3, 0] += 0.01
    sigma = np.full(bad.shape, 1e-5)
    sigma[3] = 1e-2
    known = pincal.Measurements(bad, data.sets, readings=data.readings, sigma_poses=sigma)
    unknown = pincal.Measurements(bad, data.sets, readings=data.readings)
    others = data.rows(np.arange(len(data)) != 3)
    without = pincal.calibrate(mechanism, others, noise=pincal.Noise(1e-5, 1e-5))
    weighed, pulled = (pincal.calibrate(mechanism, one) for one in (known, unknown))

    def moved(result: pincal.CalibrationResult) -> float:
        pairs = zip(result.parameters, without.parameters, strict=True)
        return max(abs(a.identified - b.identified) / b.std for a, b in pairs)

    assert moved(weighed) < 0.05 < 1.0 < moved(pulled)
    assert error(weighed, truth) < error(pulled, truth)


def test_per_leg_and_together_agree_without_shared_noise(
    kind: str, selections: dict[str, pincal.Selection]
) -> None:
    """With reading noise only, legs are independent and both methods give the same."""
    noise = pincal.Noise(0.0, 0.0, 1e-5)
    mechanism, _, data = noisy(kind, selections[kind].plan, 8, noise)
    alone = pincal.calibrate(mechanism, data, noise=noise, method="per-leg", poses="all")
    together = pincal.calibrate(mechanism, data, noise=noise)
    for a, b in zip(alone.legs, together.legs, strict=True):
        np.testing.assert_allclose(a.identified, b.identified, atol=1e-10)
        np.testing.assert_allclose(a.std, b.std, rtol=1e-5)


def test_order_of_rows_does_not_matter(kind: str, selections: dict[str, pincal.Selection]) -> None:
    """Shuffled rows give the same parameters."""
    mechanism, _, data = noisy(kind, selections[kind].plan, 10, pincal.Noise())
    order = np.random.default_rng(0).permutation(len(data))
    assert data.sets is not None
    shuffled = pincal.Measurements(
        data.poses[order], tuple(data.sets[i] for i in order), readings=data.readings[order]
    )
    one, two = (pincal.calibrate(mechanism, d) for d in (data, shuffled))
    for a, b in zip(one.legs, two.legs, strict=True):
        np.testing.assert_allclose(a.identified, b.identified, atol=1e-11)


def test_result_is_the_same_mechanism_with_other_numbers(
    kind: str, selections: dict[str, pincal.Selection], tmp_path: Path
) -> None:
    """A result saves whole, reads back, and its calibrated mechanism reproduces the truth."""
    mechanism, truth, data = noisy(kind, selections[kind].plan, 12, EXACT)
    result = pincal.calibrate(mechanism, data, noise=pincal.Noise(1e-4, 1e-4))
    result.save(tmp_path / "result")
    calibrated = pincal.load_mechanism(tmp_path / "result" / "mechanism")
    assert calibrated == result.identified
    home = np.array([mechanism.platform.home])
    np.testing.assert_allclose(
        pincal.inverse(calibrated, home).readings, pincal.inverse(truth, home).readings, atol=1e-9
    )
    written = read_result(tmp_path / "result")
    assert written == json.loads((tmp_path / "result" / "result.json").read_text())
    assert [leg["name"] for leg in written["legs"]] == list(mechanism.leg_names)
    for leg, own in zip(written["legs"], result.legs, strict=True):
        assert [p["identified"] for p in leg["parameters"]] == own.identified.tolist()
        assert (leg["rank"], leg["n_residuals"]) == (own.rank, own.n_residuals)
    with pytest.raises(pincal.FileError, match="exists"):
        result.save(tmp_path / "result")
    assert "leg_1" in "".join(map(str, result.tables()))


def test_too_few_rows_are_refused(kind: str, selections: dict[str, pincal.Selection]) -> None:
    """Two rows fewer than parameters raise, saying how many are needed for which leg."""
    mechanism, _, data = noisy(kind, selections[kind].plan, 13, pincal.Noise())
    n = len(mechanism.legs[0].parameters)
    few = pincal.Measurements(data.poses[: n - 2], readings=data.readings[: n - 2])
    with pytest.raises(pincal.ObservabilityError, match=f"leg_1: {n - 2} measured poses for {n}"):
        pincal.calibrate(mechanism, few)


@pytest.mark.slow
@pytest.mark.parametrize(("shake", "known"), [(1e-4, True), (1e-6, False)])
def test_poses_that_differ_by_their_noise_only_are_refused(shake: float, known: bool) -> None:
    """3-RRR poses at one orientation, measured with noise, are refused; parameters are named."""
    mechanism = pincal.load_mechanism("3RRR")
    poses = workspace("3RRR", 400)
    poses[:, 2] = 0.1
    plan = pincal.Plan(poses[in_workspace(mechanism, poses)][:40])
    truth = pincal.disturb(mechanism, 1e-3, seed=2)
    data = pincal.simulate(truth, truth, plan, pincal.Noise(shake, shake), 3).measurements
    noise = pincal.Noise(shake, shake) if known else None
    with pytest.raises(
        pincal.ObservabilityError,
        match=r"leg_1\.(OA|ob).* (apart by their noise|weakly determined)",
    ):
        pincal.calibrate(mechanism, data, noise=noise, strict=True)


@pytest.mark.slow
def test_many_poses_that_differ_by_their_noise_only_are_refused() -> None:
    """However many they are: 1500 at one orientation, each leg alone, have no standard errors."""
    mechanism = pincal.load_mechanism("3RRR")
    poses = workspace("3RRR", 6000)
    poses[:, 2] = 0.1
    plan = pincal.Plan(poses[in_workspace(mechanism, poses)][:1500])
    noise, truth = pincal.Noise(1e-5, 1e-5), pincal.disturb(mechanism, 1e-3, seed=2)
    data = pincal.simulate(truth, truth, plan, noise, 3).measurements
    with pytest.raises(pincal.ObservabilityError, match="by their noise only"):
        pincal.calibrate(mechanism, data, noise=noise, method="per-leg")


def test_unobservable_parameters_are_named(candidates: dict[str, np.ndarray]) -> None:
    """3-RRR poses at one orientation raise, naming the parameters that move together."""
    mechanism = pincal.load_mechanism("3RRR")
    poses = candidates["3RRR"][:300].copy()
    poses[:, 2] = 0.1
    poses = poses[in_workspace(mechanism, poses)]
    sets = ("all",) * len(poses)
    data = pincal.simulate(mechanism, mechanism, pincal.Plan(poses, sets), EXACT).measurements
    with pytest.raises(pincal.ObservabilityError, match=r"leg_1\.ob.* move together"):
        pincal.calibrate(mechanism, data, strict=True)


def test_noise_of_zero_is_refused(kind: str, selections: dict[str, pincal.Selection]) -> None:
    """Weights need some noise: all zero raises."""
    mechanism, _, data = noisy(kind, selections[kind].plan, 16, pincal.Noise())
    with pytest.raises(pincal.MeasurementError, match="no noise at all"):
        pincal.calibrate(mechanism, data, noise=EXACT)


@pytest.mark.slow
def test_a_start_near_a_singularity_says_nothing_of_the_poses(
    candidates: dict[str, np.ndarray],
) -> None:
    """Of a hundred machines one has a pose that noise carries far at nominal: it is calibrated."""
    mechanism, noise = pincal.load_mechanism("3RRR"), three_rrr_errors.NOISE
    plan = pincal.select_poses(mechanism, candidates["3RRR"], 24, "common").plan
    way = Way("common", plan, "all", "per-leg", "closure")
    for truth, seed in machines(mechanism, three_rrr_errors.SIGMA, 0, 20)[10:]:
        assert way.run(mechanism, truth, noise, seed)[1]


@pytest.mark.slow
def test_a_tolerance_predicts_better_than_few_poses(tmp_path: Path) -> None:
    """With few noisy poses, parameters near the drawing go less astray than free ones."""
    plain = pincal.load_mechanism("3RRR")
    noise = pincal.Noise(1e-3, 1e-3, 0.0)
    poses = sample_workspace(plain, 200, seed=3)
    errors = []
    for seed in range(2):
        truth = pincal.disturb(plain, 5e-4, seed=seed)
        data = pincal.simulate(plain, truth, poses[:12], noise, seed=seed).measurements
        tolerance = {"m": 5e-4, "rad": 5e-4, "1": 5e-4}
        both = [
            pincal.calibrate(plain, data, noise=noise, tolerance=one) for one in ({}, tolerance)
        ]
        errors.append([pincal.accuracy(one.identified, truth, poses).position for one in both])
    free, held = np.sqrt(np.mean(np.square(errors), axis=0))
    assert held < 0.5 * free
    data.to_csv(tmp_path / "d.csv", plain)
    given = ("--noise-position", "1mm", "--noise-orientation", "1mrad", "--folds", 0)
    wide = ("--tolerance", "0.5mm,0.5mrad,5e-4")
    done(
        "calibrate", "--no-report", "3RRR", tmp_path / "d.csv", *given, *wide, "-o", tmp_path / "r"
    )
    again = pincal.load_result(tmp_path / "r")
    assert again["leg_1.l"].identified == pytest.approx(both[1]["leg_1.l"].identified, abs=1e-9)
    assert again["leg_1.l"].given == "prior"
    outcome = run(
        "calibrate", "3RRR", tmp_path / "d.csv", "--tolerance", "5kg", "-o", tmp_path / "x"
    )
    assert outcome.code == 2
    assert "--tolerance 5kg" in outcome.trouble
