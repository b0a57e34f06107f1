"""Serial arms measured as machines are: noise, outliers, mistakes; other joints; files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from arms import Reference, loaded, reference, robot, urdf
from command_line import done
from differences import differentiated
from marks import quick

import pincal
from pincal.show.misses import workspace_errors
from pincal.words.findings import sentence

NOISE = pincal.Noise(1e-4, 1e-4, 0.0)
EXACT = pincal.Noise(0.0, 0.0, 0.0)
OFFSET = (0.05, 0.1, 0.02)
POINT = pincal.Setup(unknown_frame=True, targets={"platform": pincal.Target(OFFSET)})


def simulated(
    name: str = "ur10", count: int = 60, noise: pincal.Noise = NOISE, seed: int = 2
) -> tuple[pincal.Mechanism, pincal.Mechanism, pincal.Measurements]:
    """Return a nominal arm, a true one and its measurements."""
    mechanism = loaded(name)
    truth = pincal.disturb(mechanism, 2e-3, 1)
    plan = pincal.sample_configurations(mechanism, count, 0)
    return mechanism, truth, pincal.simulate(mechanism, truth, plan, noise, seed).measurements


def as_points(mechanism: pincal.Mechanism, data: pincal.Measurements) -> pincal.Measurements:
    """Return positions of the target alone."""
    matrices = mechanism.platform.transforms(data.poses).as_matrix()
    poses = np.full(data.poses.shape, np.nan)
    poses[:, :3] = matrices[:, :3, 3] + matrices[:, :3, :3] @ np.array(OFFSET)
    return replace(data, poses=poses)


def twists(a: pincal.Mechanism, b: pincal.Mechanism, readings: np.ndarray) -> np.ndarray:
    """Return how far two arms are apart at readings, shape (N, dof)."""
    one, two = (pincal.forward(m, readings).poses for m in (a, b))
    return a.platform.twists_between(one, two)


@pytest.mark.parametrize("noise", [NOISE, pincal.Noise(1e-4, 1e-4, 1e-4), pincal.Noise(0, 0, 1e-4)])
def test_noise_of_poses_and_encoders(noise: pincal.Noise) -> None:
    """Reduced χ² is one within its spread, and the arm is within the noise of the truth."""
    mechanism, truth, data = simulated(noise=noise)
    result = pincal.calibrate(mechanism, data, noise=noise)
    assert result.converged
    assert abs(result.reduced_chi2 - 1.0) < 4 * np.sqrt(2 / (6 * 60 - 30))
    held_out = pincal.sample_configurations(mechanism, 100, 9).readings
    assert np.sqrt((twists(result.identified, truth, held_out) ** 2).mean()) < 1e-4


@pytest.mark.slow
@pytest.mark.parametrize("points", [True, False])
def test_errors_are_those_of_the_noise(points: bool) -> None:
    """They are what least squares makes of it, to 0.3 %; the covariance is the propagated one.

    Over poses, or a target's positions, by Pinocchio alone, as far as these are moved: redundant
    parameters stay where the fit of clean data has them.
    """
    mechanism, truth, _ = simulated()
    plan = pincal.sample_configurations(mechanism, 60, 0)
    setup = pincal.Setup(targets=POINT.targets) if points else pincal.Setup()
    exact = pincal.simulate(mechanism, truth, plan, EXACT).measurements

    def off(data: pincal.Measurements) -> np.ndarray:
        if points:
            return (as_points(mechanism, data).poses - as_points(mechanism, exact).poses)[:, :3]
        return mechanism.platform.twists_between(exact.poses, data.poses)

    def fit(data: pincal.Measurements) -> pincal.CalibrationResult:
        given = as_points(mechanism, data) if points else data
        return pincal.calibrate(mechanism, given, noise=NOISE, setup=setup)

    def moved(by: np.ndarray) -> np.ndarray:
        matrices = reference("ur10").poses(clean + by, exact.readings)
        return off(replace(exact, poses=mechanism.platform.from_matrices(matrices))).ravel()

    clean = fit(exact).legs[0].identified
    J = differentiated(moved, len(clean))
    U = np.linalg.svd(J, full_matrices=False)[0][:, : np.linalg.matrix_rank(J, rtol=1e-6)]
    for seed in range(3):
        data = pincal.simulate(mechanism, truth, plan, NOISE, seed).measurements
        result = fit(data)
        error = J @ (result.legs[0].identified - clean)
        assert (np.abs(error - U @ (U.T @ off(data).ravel())) < 0.003 * NOISE.position).all()
        said = J @ result.covariance @ J.T / NOISE.position**2
        np.testing.assert_allclose(said, U @ U.T, atol=1e-3)
        np.testing.assert_allclose(result.legs[0].std ** 2, np.diagonal(result.covariance))


def _with_encoders_off() -> tuple[pincal.Mechanism, pincal.Measurements, pincal.Setup]:
    """Return an arm, measurements by encoders 5 to 8 degrees off, unknown frame and target."""
    mechanism, _, data = simulated(count=40)
    off = np.radians([0.0, 6.0, 7.0, 5.0, 8.0, -8.0])
    anywhere = pincal.Setup(unknown_frame=True, targets={"platform": pincal.Target(unknown=True)})
    return mechanism, replace(data, readings=data.readings + off), anywhere


def test_encoders_may_be_degrees_off() -> None:
    """Zeros 5 to 8 degrees off miss the nominal arm by more than files of another machine may.

    No fault explains it, and the fit brings both together: it is calibrated to the noise, and what
    moved far is said.
    """
    mechanism, data, anywhere = _with_encoders_off()
    result = pincal.calibrate(mechanism, data, setup=anywhere)
    assert result.converged
    assert result.options.rough
    assert "far-from-nominal" in [finding.code for finding in result.findings]
    assert result.noise.position == pytest.approx(NOISE.position, rel=0.4)


@pytest.mark.slow
def test_rows_of_another_order_remain_refused() -> None:
    """No machine near the nominal one has made readings that are dealt to other positions."""
    mechanism, data, anywhere = _with_encoders_off()
    shuffled = np.random.default_rng(0).permutation(len(data))
    with pytest.raises(pincal.MeasurementError, match="contradict each other"):
        pincal.calibrate(mechanism, replace(data, readings=data.readings[shuffled]), setup=anywhere)


def test_outliers_are_listed_and_left_out() -> None:
    """Three poses 5 mm off: rejected, they and no other; the arm is as without them."""
    mechanism, truth, data = simulated()
    spoiled = data.poses.copy()
    spoiled[[7, 20, 41], 1] += 5e-3
    bad = replace(data, poses=spoiled)
    result = pincal.calibrate(mechanism, bad, noise=NOISE, loss="reject")
    assert result.converged
    assert {7, 20, 41} <= {one.row for one in result.outliers}
    assert len(result.outliers) <= 5
    held_out = pincal.sample_configurations(mechanism, 100, 9).readings
    off = twists(result.identified, truth, held_out)
    assert np.sqrt((off**2).mean()) < 1e-4


@pytest.mark.parametrize(
    ("wrong", "words"),
    quick(
        1,
        [
            ("degrees", "readings are in degrees under a radian header"),
            ("sign", "elbow_joint has the opposite sign"),
            ("radians", "readings are in radians under a degree header"),
            ("order", "shoulder_pan_joint and shoulder_lift_joint are swapped"),
            ("mm", "positions are in mm under a metre header"),
            ("rows", "no single fault"),
        ],
    ),
)
def test_mistakes_are_refused(wrong: str, words: str) -> None:
    """Wrong units, signs and orders are refused and named with full poses, refused with points."""
    mechanism, _, data = simulated()
    for one, setup in ((data, pincal.Setup()), (as_points(mechanism, data), POINT)):
        q, x = one.readings.copy(), one.poses.copy()
        match wrong:
            case "degrees":
                q = np.degrees(q)
            case "radians":
                q = np.radians(q)
            case "sign":
                q[:, 2] *= -1
            case "order":
                q = q[:, [1, 0, 2, 3, 4, 5]]
            case "mm":
                x[:, :3] *= 1000.0
            case "rows":
                x = x[::-1].copy()
        bad = replace(one, readings=q, poses=x)
        with pytest.raises(pincal.MeasurementError, match=words if setup.plain else "miss|contra"):
            pincal.calibrate(mechanism, bad, noise=NOISE, setup=setup)


def test_a_missing_reading() -> None:
    """A pose without all readings tells nothing; a position does not even fix it: its row named."""
    mechanism, _, data = simulated()
    q = data.readings.copy()
    q[4, 2] = np.nan
    kept = np.delete(np.arange(60), 4)
    one, other = (
        pincal.calibrate(mechanism, d, noise=NOISE)
        for d in (replace(data, readings=q), data.rows(kept))
    )
    far = pincal.sample_configurations(mechanism, 20, 9).readings
    np.testing.assert_allclose(twists(one.identified, other.identified, far), 0.0, atol=1e-9)
    points = replace(as_points(mechanism, data), readings=q)
    with pytest.raises(pincal.MeasurementError, match="data row 5 has 3 measured quantities"):
        pincal.calibrate(mechanism, points, noise=NOISE, setup=POINT)


def test_other_methods_say_what_to_do() -> None:
    """Redundant parameters are for unknown poses."""
    mechanism, _, data = simulated()
    with pytest.raises(pincal.ObservabilityError, match="leave out --method per-leg"):
        pincal.calibrate(mechanism, data, method="per-leg", noise=NOISE)
    with pytest.raises(pincal.ObservabilityError, match="at least 7 are needed"):
        pincal.calibrate(mechanism, data.rows(np.arange(6)), noise=NOISE, strict=True)


GANTRY = "jx|prismatic|1 0 0|0 0 1\njy|prismatic|0 1 0|0.1 0 0\njz|prismatic|0 0 -1|0 0.1 -0.2"
SCARA = (
    "a|revolute|0 0 1|0 0 .4\nb|revolute|0 0 1|.35 0 0\nc|revolute|0 0 1|.3 0 0\n"
    "d|prismatic|0 0 -1|0 0 -.1"
)


@pytest.mark.parametrize(
    ("chain", "told"),
    [
        (GANTRY, 12),
        (SCARA, 20),
        ("a|revolute|0 1 0|0 0 0\nb|revolute|.6 0 .8|.35 0 .1", 14),
        ("a|revolute|0 0 1|0 0 0", 10),
        ("a|prismatic|0 0 1|0 0 0", 8),
    ],
    ids=["gantry", "scara", "2R", "1R", "1P"],
)
def test_any_joints(chain: str, told: int, tmp_path: Path) -> None:
    """Prismatic, mixed and single joints: kinematics, rank, clean recovery and files."""
    file = tmp_path / "made.urdf"
    file.write_text(robot(chain))
    n = len(chain.splitlines())
    mechanism = pincal.Mechanism.from_urdf(file, f"l{n}")
    plan = pincal.sample_configurations(mechanism, 60, 0)
    joints = tuple(sensor.joint for sensor in mechanism.legs[0].sensors)
    alone = Reference(file, f"l{n}", "", joints)
    there = mechanism.platform.transforms(plan.poses).as_matrix()
    np.testing.assert_allclose(there, alone.poses(np.zeros(6 * n + 6), plan.readings), atol=1e-12)
    found = pincal.forecast(mechanism, plan, NOISE)
    assert (found.rank.rank, found.rank.n_params) == (told, 6 * n + 6)
    truth = pincal.disturb(mechanism, 1e-3, 3)
    data = pincal.simulate(mechanism, truth, plan, EXACT).measurements
    result = pincal.calibrate(mechanism, data, noise=NOISE)
    far = pincal.sample_configurations(mechanism, 60, 5).readings
    assert np.abs(twists(result.identified, truth, far)).max() < 1e-9
    assert f"{6 * n + 6 - told} parameters are redundant" in sentence(result.gauge[0])
    mechanism.save(tmp_path / "saved")
    assert pincal.load_mechanism(str(tmp_path / "saved")) == mechanism


def test_a_planar_arm() -> None:
    """A planar leg that closes a frame: closed form, all five parameters from clean poses."""
    parameters = (("x0", 0.0), ("y0", 0.0), ("l1", 0.4), ("zero2", 0.0), ("l2", 0.3))
    Joint, Placement = pincal.Joint, pincal.Placement
    joints = (
        Joint("q1", "revolute", Placement.of(dict(parameters), x="x0", y="y0")),
        Joint("q2", "revolute", Placement.of(dict(parameters), x="l1", rz="zero2")),
        Joint("tip", "fixed", Placement.of(dict(parameters), x="l2")),
    )
    sensors = (pincal.Sensor("q1"), pincal.Sensor("q2"))
    leg = pincal.Leg("arm", joints, sensors, parameters, Joint("tool", "fixed"), closes="frame")
    mechanism = pincal.Mechanism("2R", pincal.Platform("planar", (0.7, 0.0, 0.0)), (leg,))
    truth = pincal.disturb(mechanism, 2e-3, 3)
    plan = pincal.sample_configurations(mechanism, 40, 0)
    x0, y0, l1, zero2, l2 = truth.legs[0].nominal
    q1, q2 = plan.readings.T
    turn = q1 + q2 + zero2
    poses = np.column_stack(
        (
            x0 + l1 * np.cos(q1) + l2 * np.cos(turn),
            y0 + l1 * np.sin(q1) + l2 * np.sin(turn),
            turn,
        )
    )
    apart = mechanism.platform.twists_between(pincal.forward(truth, plan.readings).poses, poses)
    np.testing.assert_allclose(apart, 0.0, atol=1e-12)
    data = pincal.Measurements(poses=poses, readings=plan.readings)
    for method in ("per-leg", "all-legs"):
        result = pincal.calibrate(mechanism, data, method=method, noise=NOISE)
        np.testing.assert_allclose(result.legs[0].identified, truth.legs[0].nominal, atol=1e-9)


@pytest.mark.parametrize(
    ("tip", "base", "words"),
    [
        ("nothing", None, "no frame named 'nothing'"),
        ("tool", None, "it has tool0, "),
        ("ee_link", "nothing", "no frame named 'nothing'"),
        ("base_link", "ee_link", "no chain of joints leads from 'ee_link'"),
        ("base_link", None, "no joint moves"),
        ("ee_link", "ee_link", "no joint"),
    ],
)
def test_links_that_make_no_arm(tip: str, base: str | None, words: str) -> None:
    """Links that do not exist or have no moving joint between them are refused by name."""
    with pytest.raises(pincal.MechanismError, match=words):
        pincal.Mechanism.from_urdf(urdf("ur10_robot.urdf"), tip, base)


def test_files_say_the_same(tmp_path: Path) -> None:
    """A saved arm is equal; Pinocchio reads its URDF alike; an identified one predicts alike."""
    mechanism, _, data = simulated("panda")
    mechanism.save(tmp_path / "arm")
    assert pincal.load_mechanism(str(tmp_path / "arm")) == mechanism
    readings = pincal.sample_configurations(mechanism, 20, 4).readings
    result = pincal.calibrate(mechanism, data, noise=NOISE)
    result.save(tmp_path / "result")
    back = pincal.load_mechanism(str(tmp_path / "result"))
    for one, folder in ((mechanism, "arm"), (result.identified, "result/mechanism")):
        file = tmp_path / folder / "arm.urdf"
        alone = Reference(file, "arm_tip", "", mechanism.reading_names)
        poses = pincal.forward(one, readings).poses
        matrices = one.platform.transforms(poses).as_matrix()
        wanted = alone.poses(np.zeros(len(one.legs[0].parameters)), readings)
        np.testing.assert_allclose(matrices, wanted, atol=1e-12)
    np.testing.assert_array_equal(twists(back, result.identified, readings), 0.0)


@pytest.mark.slow
def test_on_the_command_line(tmp_path: Path) -> None:
    """Plan without collisions, measure, calibrate, use: an arm's folder goes where others go."""
    arm, plan, data = tmp_path / "arm", tmp_path / "plan.csv", tmp_path / "data.csv"
    loaded("ur10").save(arm)
    some = pincal.sample_configurations(loaded("ur10"), 150, 0)
    some.to_csv(tmp_path / "some.csv", loaded("ur10"))
    given = ("--candidates", tmp_path / "some.csv", "--collision", urdf("ur10_robot.urdf"))
    said = done("select", arm, "--count", 20, "--starts", 2, *given, "-o", plan).out
    assert "30 of 42" in said
    done("simulate", arm, plan, "-o", data)
    noise = ("--noise-position", 1e-4, "--noise-orientation", 1e-4, "--folds", 0)
    done("calibrate", arm, data, *noise, "--no-report", "-o", tmp_path / "result")
    codes = [remark.code for remark in pincal.load_result(tmp_path / "result").gauge]
    assert "redundant-parameters" in codes
    done("forward", tmp_path / "result", data, "-o", tmp_path / "poses.csv")
    assert "identity" in done("symmetry", arm).out


def test_expected_error_is_what_was_forecast() -> None:
    """On clean data, over held-out configurations: with redundant parameters, and in any frame."""
    arm = loaded("ur10")
    truth = pincal.disturb(arm, 1e-3, seed=4)
    plan, held_out = (pincal.sample_configurations(arm, n, seed=s) for n, s in ((40, 1), (50, 2)))
    noise = pincal.Noise(1e-4, 1e-4, 0.0)
    data = pincal.simulate(arm, truth, plan, noise, seed=5).measurements
    for unknown in (False, True):
        setup = pincal.Setup(unknown_frame=unknown)
        result = pincal.calibrate(arm, data, noise=noise, setup=setup)
        found = result.expected_error(held_out)
        forecast = pincal.forecast(truth, plan, noise, setup=setup).platform_error(held_out)
        assert found.position == pytest.approx(forecast.position, rel=0.02)
        assert found.orientation == pytest.approx(forecast.orientation, rel=0.02)
        fixed = [p for leg in result.legs for p in leg.parameters if p.std == 0.0]
        assert all(p.identified == p.nominal for p in fixed)


@pytest.mark.parametrize("jitter", [0.0, 1e-4])
def test_what_was_held_is_not_promised_elsewhere(jitter: float) -> None:
    """A joint that stood still, or nearly: errors are told where it stood, and nowhere else."""
    arm = loaded("ur10")
    truth, noise = pincal.disturb(arm, 1e-3, seed=4), pincal.Noise(1e-4, 1e-4, 0.0)
    plan = pincal.sample_configurations(arm, 40, seed=1)
    still = plan.readings.copy()
    still[:, 3] = 0.3 + jitter * np.random.default_rng(6).standard_normal(len(still))
    plan = pincal.Plan(pincal.forward(arm, still).poses, readings=still)
    data = pincal.simulate(arm, truth, plan, noise, seed=5).measurements
    if not jitter:
        with pytest.raises(pincal.ObservabilityError, match=r"together.*--strict"):
            pincal.calibrate(arm, data, noise=noise, strict=True)
    else:
        (said, *_) = pincal.calibrate(arm, data, noise=noise, strict=True).warnings
        assert "weakly determined" in said
    result = pincal.calibrate(arm, data, noise=noise)
    assert result.undetermined_directions is not None
    there = result.expected_error(plan)
    assert 0.0 < there.position < 2e-4
    off = pincal.forward(result.identified, still).poses - pincal.forward(truth, still).poses
    assert np.sqrt((off[:, :3] ** 2).sum(axis=1).mean()) < 2 * there.position
    assert np.isinf(result.expected_error(pincal.sample_configurations(arm, 20)).position)
    found = workspace_errors(result)
    assert found.where == "over measured poses"
    assert found.mean_after()[0] < 2e-4


@pytest.mark.parametrize("seed", [0, 3])
def test_axes_that_are_parallel_as_drawn_do_not_hold_what_the_machine_determines(seed: int) -> None:
    """Positions of a UR5 off by 0.3 %: residuals are noise, as if its true axes had been drawn."""
    arm, noise = loaded("ur5"), pincal.Noise(2e-5, 2e-5, 2e-5)
    truth = pincal.disturb(arm, 3e-3, seed=seed)
    plan = pincal.sample_configurations(arm, 40, seed=seed)
    data = pincal.simulate(arm, truth, plan, noise, seed=seed).measurements
    poses = np.full(data.poses.shape, np.nan)
    poses[:, :3] = data.poses[:, :3] + [1.0, 2.0, 0.5]
    data, setup = replace(data, poses=poses), pincal.Setup(unknown_frame=True)
    as_drawn, as_made = (
        pincal.calibrate(machine, data, noise=noise, setup=setup, folds=0)
        for machine in (arm, truth)
    )
    assert as_drawn.reduced_chi2 == pytest.approx(as_made.reduced_chi2, rel=1e-3)
    assert as_drawn.chi2_freedoms == as_made.chi2_freedoms
    assert as_drawn.reduced_chi2 < 1.3
