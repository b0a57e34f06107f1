"""Latent poses: derivatives, recovery from any part of the pose, other solvers, the bound."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas
import pytest
from closed_forms import angles, near, reading
from differences import assert_derivative, differentiated
from marks import quick, slow_or_fuzz, some_slow
from measured import (
    EXACT,
    NOISE,
    error,
    machine,
    platform_accuracy,
    put,
    seen_from_elsewhere,
    targets,
    workspace,
)
from scipy.optimize import least_squares

import pincal
from pincal.calibration.calibrate import prepared
from pincal.design.platform_error import platform_error
from pincal.estimation.observability.gauge import find_gauge
from pincal.estimation.observation import Observation
from pincal.estimation.problem import Problem
from pincal.estimation.unknowns import Unknowns
from pincal.words.findings import sentence

KINDS = ["5R", "3RRR", "6UPS"]
FRAME = pincal.Setup(unknown_frame=True)
FREE = pincal.Setup(unknown_frame=True, targets={"platform": pincal.Target(unknown=True)})


def started(
    mechanism: pincal.Mechanism, data: pincal.Measurements, **options: Any
) -> tuple[Problem, Unknowns]:
    """Return the problem of all legs where its search starts, and its unknowns."""
    calibration = prepared(mechanism, data, **options)
    return calibration.started(calibration.latent_problem), calibration.unknowns


def everything(kind: str) -> tuple[pincal.Mechanism, pincal.Measurements, pincal.Setup]:
    """Return measurements of all kinds at once: targets, distances, partial poses."""
    mechanism, _, data = machine(kind, 6)
    rng, poses = np.random.default_rng(3), data.poses.copy()
    extra = targets(mechanism, poses, {"ball": (0.3, -0.1, 0.0)}, 1e-2)
    extra["wire"] = rng.uniform(1, 2, len(data))
    if mechanism.platform.kind == "spatial":
        poses[2, 3:] = np.nan
    poses[1, 0] = np.nan
    setup = pincal.Setup(
        True,
        {
            "platform": pincal.Target((0.1, 0.2, 0.0), True),
            "ball": pincal.Target((0.3, 0, 0), True),
        },
        {"wire": pincal.Distance((1.0, 2.0, 3.0), "ball")},
    )
    return mechanism, replace(data, poses=poses, extra=extra), setup


@pytest.mark.parametrize("kind", some_slow(KINDS, "6UPS"))
def test_derivatives_of_what_is_measured(kind: str) -> None:
    """By the platform's twist and by frame and targets, against central differences."""
    mechanism, data, setup = everything(kind)
    observation, platform = Observation(mechanism, data, setup), mechanism.platform
    unknowns, rng = observation.external, np.random.default_rng(0)
    external = unknowns.moved(unknowns.start, 0.3 * rng.standard_normal(len(unknowns)))
    matrices = np.tile(platform.home_pose.as_matrix(), (len(data), 1, 1))
    matrices = platform.displaced(matrices, 0.2 * rng.standard_normal((len(data), platform.dof)))
    value, by_pose, by_external = observation.residuals(matrices, external)
    assert_derivative(
        by_pose,
        lambda h: observation.residuals(
            platform.displaced(matrices, np.tile(h, (len(data), 1))), external
        )[0],
    )
    assert_derivative(
        by_external,
        lambda h: observation.residuals(matrices, unknowns.moved(external, h))[0],
    )
    assert not value[~observation.measured].any()
    assert not by_pose[~observation.measured].any()


@pytest.mark.parametrize("kind", some_slow(KINDS, "6UPS"))
def test_derivatives_of_the_problem(kind: str) -> None:
    """Conditions of the legs by parameters and poses, where they do not hold, are derivatives."""
    mechanism, _, data = machine(kind, 8)
    problem, unknowns = started(mechanism, data)
    state = problem.start(unknowns.start)

    def values(parameters: np.ndarray, twist: np.ndarray) -> np.ndarray:
        moved = mechanism.platform.displaced(state.matrices, np.tile(twist, (len(data), 1)))
        there = replace(state, parameters=state.parameters + parameters, matrices=moved)
        return problem.leg_block.evaluate(there).value

    rows = problem.leg_block.evaluate(state)
    nowhere = np.zeros(mechanism.platform.dof)
    assert np.abs(values(0 * state.parameters, nowhere)).max() > 1e-5
    assert_derivative(rows.by_parameter, lambda h: values(h, nowhere), precision=5e-12)
    assert_derivative(rows.by_pose, lambda h: values(0 * state.parameters, h), precision=5e-12)


def whitened(
    mechanism: pincal.Mechanism, data: pincal.Measurements
) -> tuple[np.ndarray, np.ndarray]:
    """Return residuals in standard deviations and Jacobian, (N, k) and (N, k, n), poses free."""
    problem, unknowns = started(mechanism, data, noise=NOISE)
    linear = problem.evaluate(problem.start(unknowns.start))
    return linear.residuals, linear.jacobian


@pytest.mark.parametrize("kind", some_slow(KINDS, "6UPS"))
def test_white_rows_weigh_what_was_measured(kind: str) -> None:
    """Squares and gradients are those of inverse kinematics: predicted less measured, over σ.

    To first order a pose has the squares min over x of |P φ + X x + r|² / σ² + |x|² / σ_x²; P and X
    by differences, r what readings are off. Whatever basis the rows are in, J'J, J'e and e'e are
    fixed by that, and fall to a ninth, a quarter or their negative if one of them is not whole.
    """
    mechanism, _, data = machine(kind, 8, noise=EXACT, sigma=0.0)
    poses, platform, off = data.poses, mechanism.platform, 0.1 * NOISE.reading
    start = np.concatenate([leg.nominal for leg in mechanism.legs])
    ends = np.cumsum([len(leg.parameters) for leg in mechanism.legs])[:-1]

    def readings(values: np.ndarray, twist: np.ndarray) -> np.ndarray:
        parts = dict(zip(mechanism.leg_names, np.split(values, ends), strict=True))
        at = platform.moved(poses, np.tile(twist, (len(poses), 1)))
        return pincal.inverse(mechanism.with_parameters(parts), at).readings

    r = off * np.random.default_rng(0).standard_normal(data.readings.shape)
    P = differentiated(lambda h: readings(start + h, np.zeros(platform.dof)), len(start))
    X = differentiated(lambda h: readings(start, h), platform.dof)
    P, X, r = (one / NOISE.reading for one in (P, X, r))
    prior = np.diag(NOISE.of_poses(mechanism) ** -2)
    white, jacobian = whitened(mechanism, replace(data, readings=data.readings - r * NOISE.reading))
    for row in range(len(poses)):
        own = np.eye(len(P[row])) - X[row] @ np.linalg.solve(X[row].T @ X[row] + prior, X[row].T)
        J, e = jacobian[row], white[row]
        for found, wanted in (
            (J.T @ J, P[row].T @ own @ P[row]),
            (J.T @ e, P[row].T @ own @ r[row]),
            (e @ e, r[row] @ own @ r[row]),
        ):
            np.testing.assert_allclose(found, wanted, rtol=0.0, atol=1e-3 * np.abs(wanted).max())


@pytest.mark.parametrize("kind", some_slow(KINDS, "6UPS"))
def test_clean_full_poses_recover_the_parameters(kind: str) -> None:
    """Disturbed by 5e-3, parameters come back to 1e-9, exact readings or noisy ones said."""
    mechanism, truth, data = machine(kind, noise=EXACT, sigma=5e-3)
    for noise in (pincal.Noise(1e-4, 1e-4), pincal.Noise(1e-4, 1e-4, 5e-5)):
        result = pincal.calibrate(mechanism, data, noise=noise)
        assert result.converged
        assert error(result, truth) < 1e-9
        assert result.gauge == ()


@pytest.mark.parametrize("kind", some_slow(["3RRR", "6UPS"], "6UPS"))
def test_clean_positions_alone_recover_the_platform(kind: str) -> None:
    """But for turns of the platform's frame, which are named; readings exact or not."""
    mechanism, truth, data = machine(kind, noise=EXACT)
    lengths = mechanism.platform.units.count("m")
    data = put(data, "poses", np.s_[:, lengths:], np.nan)
    result = pincal.calibrate(mechanism, data, noise=pincal.Noise(1e-4, 0, 1e-5))
    assert result.converged
    assert len(result.gauge) == 1
    assert "platform frame" in sentence(result.gauge[0])
    assert result.estimated_poses is not None
    position, orientation = platform_accuracy(result.identified, truth, result.estimated_poses)
    assert position < 1e-9
    assert orientation < 1e-9


def test_single_coordinates_and_rows_with_nothing_measured() -> None:
    """A 3-RRR from x alone, or from orientation alone, is told; a row without a pose is found."""
    mechanism, truth, data = machine("3RRR", 60, noise=EXACT)
    poses = data.poses.copy()
    data = put(data, "poses", np.s_[10:, 1], np.nan)
    data = put(data, "poses", np.s_[30:, 2], np.nan)
    data = put(data, "poses", np.s_[-5:], np.nan)
    result = pincal.calibrate(mechanism, data, noise=pincal.Noise(1e-4, 1e-4, 1e-5))
    assert error(result, truth) < 1e-8
    assert result.estimated_poses is not None
    np.testing.assert_allclose(result.estimated_poses, poses, atol=1e-8)
    counts = {one.name: one.n_residuals for one in result.observed}
    assert counts == {"x": len(data) - 5, "y": 10, "phi": 30}


def test_missing_readings_are_left_out() -> None:
    """Rows of full poses without some readings serve the other legs, and do no harm."""
    mechanism, truth, data = machine("3RRR", 50, noise=EXACT)
    data = put(data, "readings", np.s_[:12, 1], np.nan)
    result = pincal.calibrate(mechanism, data, noise=NOISE)
    assert error(result, truth) < 1e-9
    assert [leg.n_residuals for leg in result.legs] == [len(data), len(data) - 12, len(data)]
    with pytest.raises(
        pincal.MeasurementError, match=r"row 1: 'leg_2' is not measured.*all legs at once"
    ):
        pincal.calibrate(mechanism, data, method="per-leg")


@pytest.mark.slow
def test_targets_and_distances_take_the_place_of_positions() -> None:
    """A hexapod from three reflectors, or from wires beside orientations, clean: 1e-9."""
    mechanism, truth, data = machine("6UPS", noise=EXACT)
    poses = np.full_like(data.poses, np.nan)
    offsets = {"a": (0.2, 0.0, 0.05), "b": (-0.1, 0.2, 0.05), "c": (-0.1, -0.2, 0.0)}
    balls = targets(mechanism, data.poses, offsets)
    setup = pincal.Setup(targets={name: pincal.Target(o) for name, o in offsets.items()})
    noise = pincal.Noise(1e-4, 1e-4, 1e-5)
    three = replace(data, poses=poses, extra=balls)
    result = pincal.calibrate(mechanism, three, noise=noise, setup=setup)
    assert error(result, truth) < 1e-9
    stations = {"u": (2.0, 0.0, 0.0), "v": (-1.0, 2.0, 0.0), "w": (-1.0, -2.0, 0.5)}
    matrices = mechanism.platform.transforms(data.poses).as_matrix()
    wires = {
        n: np.linalg.norm(matrices[:, :3, 3] - np.array(p), axis=1) for n, p in stations.items()
    }
    setup = pincal.Setup(distances={n: pincal.Distance(p) for n, p in stations.items()})
    poses[:, 3:] = data.poses[:, 3:]
    some = replace(data, poses=poses, extra=wires)
    result = pincal.calibrate(mechanism, some, noise=noise, setup=setup)
    assert error(result, truth) < 1e-8


@pytest.mark.slow
def test_unknown_offsets_of_targets_are_found() -> None:
    """Three reflectors 50 mm from where they were thought: offsets and platform to 1e-9.

    The platform's frame is nobody's but theirs and the platform points': a gauge.
    """
    mechanism, truth, data = machine("6UPS", noise=EXACT)
    offsets = {"a": (0.2, 0.0, 0.05), "b": (-0.1, 0.2, 0.05), "c": (-0.1, -0.2, 0.0)}
    thought = {name: (x + 0.05, y, z - 0.03) for name, (x, y, z) in offsets.items()}
    setup = pincal.Setup(targets={n: pincal.Target(o, unknown=True) for n, o in thought.items()})
    some = replace(
        data,
        poses=np.full_like(data.poses, np.nan),
        extra=targets(mechanism, data.poses, offsets),
    )
    noise = pincal.Noise(1e-4, 1e-4, 1e-5)
    result = pincal.calibrate(mechanism, some, noise=noise, setup=setup)
    position, orientation = platform_accuracy(result.identified, truth, data.poses)
    assert position < 1e-9
    assert orientation < 1e-9
    assert [p.id for p in result.external][:3] == ["a.x", "a.y", "a.z"]
    found = np.array([p.identified for p in result.external]).reshape(3, 3)
    apart = [np.linalg.norm(found[i] - found[i - 1]) for i in range(3)]
    true = np.array(list(offsets.values()))
    np.testing.assert_allclose(apart, [np.linalg.norm(true[i] - true[i - 1]) for i in range(3)])


@pytest.mark.parametrize("kind", quick(2, KINDS))
def test_a_tracker_anywhere_and_a_target_anywhere(kind: str) -> None:
    """Clean data: the platform to 1e-9 but for frames."""
    mechanism, truth, data = machine(kind, noise=EXACT)
    setup, offset, turn = FREE, (0.05, -0.03, 0.04), 0.2
    if mechanism.platform.space == 2:
        offset = (0.05, -0.03, 0.0)
    if kind == "5R":  # a point has no frame of its own
        setup, offset, turn = FRAME, (0.0, 0.0, 0.0), 0.0
    moved = seen_from_elsewhere(mechanism, data, offset, turn)
    options = {"setup": setup, "poses": "all", "noise": pincal.Noise(1e-4, 1e-4, 0.0)}
    result = pincal.calibrate(mechanism, moved, **options)  # type: ignore[arg-type]
    assert result.converged
    position, orientation = platform_accuracy(result.identified, truth, data.poses)
    assert position < 1e-9
    assert orientation < 1e-9
    frames = 6 if mechanism.platform.space == 3 else 3
    assert f"{frames} freedoms" in sentence(result.gauge[0])


def test_of_equal_parameters_the_nearest_to_nominal_are_taken() -> None:
    """Changes have no part along the gauge directions, each measured by what it alone does."""
    mechanism, _, data = machine("3RRR")
    moved = seen_from_elsewhere(mechanism, data)
    gauge = find_gauge(mechanism, *started(mechanism, moved, noise=NOISE, setup=FRAME))
    assert gauge.constraints.shape[0] == 3
    result = pincal.calibrate(mechanism, moved, noise=NOISE, setup=FRAME)
    change = np.concatenate(
        [
            leg.identified - start.nominal
            for leg, start in zip(result.legs, mechanism.legs, strict=True)
        ]
    )
    assert np.abs(change).max() > 1e-4
    parts = gauge.constraints[:, : len(change)] @ change
    sizes = np.linalg.norm(gauge.constraints[:, : len(change)], axis=1) * np.linalg.norm(change)
    assert np.abs(parts / sizes).max() < 1e-9


def test_frames_that_legs_cannot_take_up_are_found() -> None:
    """With base points fixed the tracker's place is no gauge: it is found with the parameters."""
    mechanism, truth, data = machine("3RRR", noise=EXACT)
    truth = truth.with_parameters(
        {leg.name: {"OA": leg.nominal[2], "beta": leg.nominal[3]} for leg in mechanism.legs}
    )
    plan = pincal.Plan(workspace("3RRR", 40))
    data = pincal.simulate(mechanism, truth, plan, EXACT).measurements
    moved = seen_from_elsewhere(mechanism, data)
    options = {"setup": FRAME, "fixed": ("OA", "beta"), "noise": pincal.Noise(1e-4, 1e-4)}
    result = pincal.calibrate(mechanism, moved, **options)  # type: ignore[arg-type]
    assert result.gauge == ()
    assert error(result, truth) < 1e-9
    frame = [p.identified for p in result.external]
    np.testing.assert_allclose(frame, [1.0, 2.0, 1.0], atol=1e-9)


@pytest.mark.parametrize(
    "setup", [FRAME, FREE, pincal.Setup(systematic=pincal.Systematic(scale=1e-5))]
)
def test_poses_as_measured_are_those_of_the_platform_in_the_base(
    setup: pincal.Setup,
) -> None:
    """Frames, targets and common errors are refused, with the option to leave out."""
    remedy = "all legs at once; leave out --method per-leg$"
    with pytest.raises(pincal.MeasurementError, match=remedy):
        pincal.Options(setup=setup, method="per-leg")


def closed_form_problem(
    data: pincal.Measurements, start: np.ndarray
) -> tuple[object, np.ndarray, list[str]]:
    """Return residuals of a five-bar with all poses unknown, by closed-form inverse kinematics."""
    mechanism = pincal.load_mechanism("5R")
    names = list(mechanism.legs[0].parameter_names)
    count, n = len(data), len(names)

    def residual(values: np.ndarray) -> np.ndarray:
        poses = values[2 * n :].reshape(count, 2)
        rows = [(poses - data.poses).ravel() / NOISE.position]
        for index, (leg, bend) in enumerate(zip(mechanism.legs, [-1, 1], strict=True)):
            p = dict(zip(names, values[index * n : (index + 1) * n], strict=True))
            shoulder = leg.home[0] + near(angles("5R", p, poses, bend)[0], leg.home[0])
            rows.append(
                (reading("5R", index, p, shoulder) - data.readings[:, index]) / NOISE.reading
            )
        return np.concatenate(rows)

    return residual, np.concatenate((start, data.poses.ravel())), names


def test_the_optimum_equals_that_of_another_solver() -> None:
    """SciPy on closed forms, all poses among its unknowns: parameters within 1 % of their errors.

    Closure over ∂e/∂ψ is the error of the reading to first order, hence not to more digits.
    """
    mechanism, _, data = machine("5R")
    result = pincal.calibrate(mechanism, data, noise=NOISE)
    start = np.concatenate([leg.nominal for leg in mechanism.legs])
    residual, first, _ = closed_form_problem(data, start)
    other = least_squares(residual, first, x_scale="jac", xtol=1e-15, ftol=1e-15)  # type: ignore[arg-type]
    identified = np.concatenate([leg.identified for leg in result.legs])
    std = np.concatenate([leg.std for leg in result.legs])
    assert np.abs((identified - other.x[: len(identified)]) / std).max() < 0.01
    assert result.estimated_poses is not None
    poses = other.x[len(identified) :].reshape(-1, 2)
    np.testing.assert_allclose(result.estimated_poses, poses, atol=1e-6)
    assert result.reduced_chi2 * result.degrees_of_freedom == pytest.approx(
        2 * other.cost, rel=1e-3
    )


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["5R", "3RRR", "6UPS"])
def test_each_leg_alone_is_less_accurate(kind: str) -> None:
    """Of the same data no parameter is better known by its leg alone, and most are worse.

    That standard errors are what they say: tests/test_statistics.py and tests/test_calibrate.py.
    """
    mechanism, _, data = machine(kind, 40)
    options = {"poses": "all", "noise": NOISE}
    together, alone = (
        np.concatenate([leg.std for leg in pincal.calibrate(mechanism, data, **one).legs])  # type: ignore[arg-type]
        for one in (options, {**options, "method": "per-leg"})
    )
    assert (alone > 0.99 * together).all()
    assert np.median(alone / together) > 1.02


@pytest.mark.parametrize("kind", slow_or_fuzz(["3RRR"], ["6UPS"]))
def test_an_unknown_frame_and_target_cost_no_accuracy(kind: str) -> None:
    """Platform errors with frame and target unknown are those with both known.

    Over 10 noisy data sets, frames aligned for both; means within two of their standard errors.
    """
    pairs = []
    offset = (0.05, -0.03, 0.0 if kind == "3RRR" else 0.04)
    for seed in range(10):
        mechanism, truth, data = machine(kind, seed=seed)
        known = pincal.calibrate(mechanism, data, noise=NOISE)
        moved = seen_from_elsewhere(mechanism, data, offset, 0.2)
        unknown = pincal.calibrate(mechanism, moved, noise=NOISE, setup=FREE)
        poses = data.poses
        pairs.append([platform_accuracy(one.identified, truth, poses) for one in (known, unknown)])
    errors = np.array(pairs)
    difference = errors[:, 1] - errors[:, 0]
    spread = difference.std(axis=0, ddof=1) / np.sqrt(len(difference))
    assert (np.abs(difference.mean(axis=0)) <= 2 * spread + 1e-3 * errors.mean(axis=(0, 1))).all()


@pytest.mark.slow
def test_positions_alone_calibrate_a_hexapod() -> None:
    """Position-only measurements bring a 6-UPS from millimetres to its noise, as forecast."""
    mechanism, truth, data = machine("6UPS", 100)
    poses = data.poses.copy()
    data = put(data, "poses", np.s_[:, 3:], np.nan)
    result = pincal.calibrate(mechanism, data, noise=NOISE)
    before, _ = platform_accuracy(mechanism, truth, poses)
    after, _ = platform_accuracy(result.identified, truth, poses)
    expected = result.expected_error(poses).position
    assert before > 1e-3
    assert after < before / 5
    assert 0.4 < after / expected < 2.5
    planned = pincal.forecast(mechanism, poses, NOISE, ["x", "y", "z"])
    assert planned.platform_error(poses).position == pytest.approx(expected, rel=0.1)


@pytest.mark.parametrize(
    ("change", "options", "message"),
    some_slow(
        WRONG := [
            ("line", {"setup": FRAME}, "all on a line|all at one place"),
            ("turn", {}, "contradict each other by .*--unknown-frame"),
            ("nothing", {}, "2 measured quantities, which do not fix the 3 freedoms"),
            ("exact", {"noise": pincal.Noise(0.0, 0.0, 0.0)}, "carry no noise at all"),
        ],
        *WRONG[:2],
    ),
)
def test_what_cannot_be_is_refused(change: str, options: dict, message: str) -> None:
    """Points that fix no frame, a frame taken for the base's, rows with too little, no noise.

    Mirrored frames and exchanged legs: below. Wrong units: tests/test_misfits.py.
    """
    mechanism, _, data = machine("3RRR" if change == "nothing" else "6UPS", 15)
    data = seen_from_elsewhere(mechanism, data) if "setup" in options else data
    if change == "line":
        data = put(data, "poses", np.s_[2:], np.nan)
    elif change == "turn":
        data = put(data, "poses", np.s_[:, :2], data.poses[:, :2] @ [[0.0, 1.0], [-1.0, 0.0]])
        data = put(data, "poses", np.s_[:, 3:], np.nan)
    elif change == "nothing":
        data = put(data, "poses", 4, np.nan)
        data = put(data, "readings", np.s_[4, 0], np.nan)
    with pytest.raises(pincal.MeasurementError, match=message):
        pincal.calibrate(mechanism, data, **({"noise": NOISE} | options))


@pytest.mark.parametrize("kind", ["3RRR", "6UPS"])
def test_error_in_an_unknown_frame_is_what_was_forecast(kind: str) -> None:
    """What only moves the unknown frames is no error of the machine; with it, it would be."""
    mechanism, truth, data = machine(kind, 40)
    poses = data.poses.copy()
    seen = seen_from_elsewhere(mechanism, data)
    result = pincal.calibrate(mechanism, seen, noise=NOISE, setup=FRAME)
    found = result.expected_error(poses)
    planned = pincal.forecast(truth, poses, NOISE, setup=FRAME).platform_error(poses)
    assert found.position == pytest.approx(planned.position, rel=0.02)
    assert found.orientation == pytest.approx(planned.orientation, rel=0.02)
    with_frames = platform_error(result.identified, result.covariance, poses)
    assert with_frames.position > 2 * found.position


@pytest.mark.slow
def test_refusals_say_true_numbers() -> None:
    """Mirrored positions and exchanged legs are named; what readings contradict is said by size.

    The size is said by the refusal behind the one that names the cause.
    """
    mechanism, _, data = machine("6UPS", 15)
    seen = seen_from_elsewhere(mechanism, data)
    seen = put(seen, "poses", np.s_[:, 1], seen.poses[:, 1] * -1)
    seen = put(seen, "poses", np.s_[:, 3:], np.nan)
    with pytest.raises(pincal.MeasurementError, match="as in a left-handed frame"):
        pincal.calibrate(mechanism, seen, noise=NOISE, setup=FRAME)
    data = put(data, "poses", np.s_[:, 3:], np.nan)
    data = put(data, "readings", np.s_[:, :2], data.readings[:, 1::-1])
    exchanged = "legs are swapped: .* order of the columns"
    with pytest.raises(pincal.MeasurementError, match=exchanged) as refused:
        pincal.calibrate(mechanism, data, noise=NOISE)
    millimetres, percent = re.findall(
        r"by ([\d.]+) mm .* (\d+) % of", str(refused.value.__cause__)
    )[0]
    assert round(float(millimetres) / 10 / mechanism.size) == int(percent) > 0


@pytest.mark.slow
def test_parameters_that_move_too_far_are_doubted() -> None:
    """Positions in a frame 100 mm off: they converge, and the warning asks for the frame."""
    mechanism, _, data = machine("6UPS")
    data = put(data, "poses", np.s_[:, 3:], np.nan)
    assert not pincal.calibrate(mechanism, data, noise=NOISE).warnings
    data = put(data, "poses", np.s_[:, 0], data.poses[:, 0] + 0.1)
    result = pincal.calibrate(mechanism, data, noise=NOISE)
    assert any("more than a machine" in text for text in result.warnings)
    rough = pincal.calibrate(mechanism, data, noise=NOISE, rough=True)
    assert not any("more than a machine" in text for text in rough.warnings)


def test_an_orientation_in_part_is_refused(tmp_path: Path) -> None:
    """By its row, and by the column that a table lacks: no angle is dropped in silence."""
    mechanism, _, data = machine("6UPS", noise=EXACT)
    with pytest.raises(pincal.MeasurementError, match="row 3: an orientation is measured in part"):
        pincal.calibrate(mechanism, put(data, "poses", np.s_[2, 3], np.nan), noise=NOISE)
    for way, column in (("rotation-vector", "ry"), ("quaternion", "qz"), ("tilt-torsion", "tilt")):
        data.to_csv(tmp_path / f"{way}.csv", mechanism, orientation=way)
        cells = pandas.read_csv(tmp_path / f"{way}.csv")
        cells.loc[2, next(name for name in cells if name.startswith(column))] = np.nan
        cells.to_csv(tmp_path / f"{way}.csv", index=False)
        with pytest.raises(
            pincal.MeasurementError, match=rf"{way}\.csv, line 4: an orientation is"
        ):
            pincal.calibrate(mechanism, tmp_path / f"{way}.csv", noise=NOISE)
    data.to_csv(tmp_path / "whole.csv", mechanism, orientation="tilt-torsion")
    table = pandas.read_csv(tmp_path / "whole.csv").rename(columns=lambda name: name.split()[0])
    for left_out, added, message in (
        (["azimuth", "torsion"], {}, "no column 'azimuth' beside 'tilt'"),
        (["azimuth", "tilt", "torsion"], {"yaw": 0.1}, "no column 'pitch' beside 'yaw'"),
    ):
        path = tmp_path / "part.csv"
        table.drop(columns=left_out).assign(**added).to_csv(path, index=False)
        with pytest.raises(pincal.MeasurementError, match=message):
            pincal.calibrate(mechanism, path, noise=NOISE)


@pytest.mark.parametrize(("kind", "freedoms"), [("delta", 6), ("5R", 3)])
def test_frame_and_target_that_move_together_are_no_redundant_parameters(
    kind: str, freedoms: int
) -> None:
    """A platform that does not turn: a target's offset is the frame's, and no parameter's."""
    mechanism = pincal.load_mechanism(kind)
    plan, noise = pincal.Plan(workspace(kind, 30)), pincal.Noise(1e-4, 1e-4, 1e-5)
    data = pincal.simulate(mechanism, mechanism, plan, noise, 0).measurements
    options = {"unknown_frame": True, "unknown_target": True}
    result = pincal.calibrate(mechanism, data, noise=noise, **options)
    (frame,) = result.gauge
    assert (frame.code, frame.values["freedoms"]) == ("gauge-base-frame", freedoms)
    assert result.gauge_directions is not None
    assert np.linalg.matrix_rank(result.gauge_directions) == freedoms
