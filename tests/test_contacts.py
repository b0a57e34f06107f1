"""Points of contact: a target that is brought again and again to sockets at unknown places.

Arms are computed by Pinocchio alone, the 3-RRR by closed forms, estimates by SciPy.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from arms import loaded, reference
from command_line import done, run
from cramer_rao import Machine
from differences import assert_observed, differentiated
from scipy.optimize import least_squares
from scipy.spatial.distance import pdist
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

import pincal
from pincal.estimation.observation import Observation
from pincal.show.view.scene import calibrated, scene

Array = np.ndarray
TIP = np.array([0.12, -0.05, 0.08])
HOME = np.array([0.1, -1.2, 1.3, -0.8, -1.5, 0.2])
SOCKETS = "ABC"


def _setup(points: dict[str, tuple[float, ...] | None], **more: object) -> pincal.Setup:
    contact = pincal.Contact(points, "tip", **more)
    return pincal.Setup(targets={"tip": pincal.Target(tuple(TIP))}, contacts={"socket": contact})


def _unknown() -> pincal.Setup:
    return _setup(dict.fromkeys(SOCKETS))


def _measured(
    robot: pincal.Mechanism, readings: Array, names: tuple[str, ...]
) -> pincal.Measurements:
    nothing = np.full((len(readings), robot.platform.dof), np.nan)
    return pincal.Measurements(poses=nothing, readings=readings, contacts={"socket": names})


def _tips(matrices: Array) -> Array:
    return matrices[:, :3, 3] + matrices[:, :3, :3] @ TIP


def _arm(count: int = 14) -> tuple[pincal.Mechanism, Array, pincal.Measurements, Array]:
    """Return an arm, true parameters, readings whose tip is in sockets, and where these are.

    By Newton's steps of the readings through Pinocchio.
    """
    robot, alone, rng = loaded("ur5"), reference("ur5"), np.random.default_rng(2)
    true = 1e-3 * rng.standard_normal(len(robot.parameters))
    middle = _tips(alone.poses(true, HOME[None]))
    sockets = middle + rng.uniform(-0.2, 0.2, (len(SOCKETS), 3))
    wanted = np.repeat(sockets, count, axis=0)
    q, h = HOME + rng.uniform(-0.6, 0.6, (len(wanted), 6)), 1e-6
    for _ in range(12):
        ends = [_tips(alone.poses(true, q + s * h * e)) for e in np.eye(6) for s in (1, -1)]
        J = np.stack([(a - b) / (2 * h) for a, b in zip(ends[::2], ends[1::2], strict=True)], 2)
        step = np.linalg.pinv(J) @ (wanted - _tips(alone.poses(true, q)))[:, :, None]
        q = q + np.clip(step[:, :, 0], -0.2, 0.2)
    touches = np.linalg.norm(wanted - _tips(alone.poses(true, q)), axis=1) < 1e-12
    names = np.repeat(list(SOCKETS), count)[touches]
    return robot, true, _measured(robot, q[touches], tuple(names.tolist())), sockets


def _parallel(count: int = 14, noise: float = 0.0, seed: int = 3) -> tuple[Machine, Array, Array]:
    """Return a 3-RRR at poses whose tip is in sockets but for noise, these, and which it is."""
    robot, rng = pincal.load_mechanism("3RRR"), np.random.default_rng(seed)
    start = np.concatenate([leg.nominal for leg in robot.legs])
    true = start + 2e-3 * np.random.default_rng(1).standard_normal(len(start))
    sockets = np.array([[-0.2, -0.15], [0.25, -0.1], [0.05, 0.2]])
    which = np.repeat(np.arange(3), count)
    turns = Rotation.from_rotvec(np.outer(rng.uniform(-0.35, 0.35, len(which)), [0.0, 0.0, 1.0]))
    positions = sockets[which] - turns.apply(TIP)[:, :2]
    positions += noise * rng.standard_normal(positions.shape)
    truth = Machine(robot, true, positions, turns)
    ok = np.isfinite(truth.readings(true, np.zeros((len(which), 3)))).all(axis=1)
    return Machine(robot, true, positions[ok], turns[ok]), sockets, which[ok]


def _of(truth: Machine, which: Array) -> pincal.Measurements:
    readings = truth.readings(truth.parameters, np.zeros((len(which), 3)))
    return _measured(truth.nominal, readings, tuple(SOCKETS[place] for place in which))


def _alike(points: Array, wanted: Array, *, grows: bool) -> float:
    """Return by how much points miss others at best, moved or grown as one (Umeyama 1991)."""
    a, b = points - points.mean(axis=0), wanted - wanted.mean(axis=0)
    U, s, Vt = np.linalg.svd(b.T @ a)
    grown = s.sum() / (a**2).sum() if grows else 1.0
    return float(np.abs(b - grown * a @ (U @ Vt).T).max())


def _places(result: pincal.CalibrationResult) -> dict[str, list[float]]:
    """Return where sockets were found."""
    places: dict[str, list[float]] = {}
    for parameter in result.external:
        places.setdefault(parameter.owner.removeprefix("socket_"), []).append(parameter.identified)
    return places


def _codes(result: pincal.CalibrationResult) -> dict[str, int]:
    return {free.code: int(free.values.get("freedoms", 1)) for free in result.gauge}


@pytest.mark.parametrize(
    "known", [(), *(pytest.param(tuple(n), marks=pytest.mark.slow) for n in ("ABC", "BC"))]
)
def test_arm_is_found_by_sockets(known: tuple[str, ...]) -> None:
    """Exact contacts: where the tip goes elsewhere is the truth's to 1e-9, as is each socket.

    At unknown places but for where the base is and how long a metre is; that is said by name.
    """
    robot, true, data, sockets = _arm()
    points = dict.fromkeys(SOCKETS) | {n: tuple(sockets[SOCKETS.index(n)]) for n in known}
    result = pincal.calibrate(robot, data, setup=_setup(points), noise=pincal.Noise(1e-5))
    assert result.converged
    assert result.reduced_chi2 < 1e-12
    q = HOME + np.random.default_rng(5).uniform(-0.8, 0.8, (20, 6))
    poses = pincal.forward(result.identified, q).poses
    tips = _tips(robot.platform.transforms(poses).as_matrix())
    wanted = _tips(reference("ur5").poses(true, q))
    places = dict(zip(SOCKETS, sockets, strict=True)) | _places(result)
    found = np.vstack((tips, [places[name] for name in SOCKETS]))
    gauge = _codes(result)
    assert gauge.get("gauge-base-frame", 0) == {0: 6, 2: 1, 3: 0}[len(known)]
    assert ("gauge-scale" in gauge) == (not known)
    if len(known) == 3:
        np.testing.assert_allclose(tips, wanted, rtol=0.0, atol=1e-9)
    assert _alike(found, np.vstack((wanted, sockets)), grows=not known) < 1e-9


@pytest.mark.parametrize("fixed", [(), pytest.param(("A", "B"), marks=pytest.mark.slow)])
def test_parallel_machine_is_found_by_sockets(fixed: tuple[str, ...]) -> None:
    """Exact contacts of a 3-RRR: where its readings take it, and sockets, are the truth's to 1e-9.

    But for base frame and scale, which are named; two known sockets fix both in their plane.
    """
    truth, sockets, which = _parallel()
    known = {n: (*sockets[SOCKETS.index(n)], 0.0) for n in fixed}
    setup = _setup(dict.fromkeys(SOCKETS) | known)
    noise = pincal.Noise(1e-7)
    result = pincal.calibrate(truth.nominal, _of(truth, which), setup=setup, noise=noise)
    assert result.converged
    gauge = _codes(result)
    assert (gauge.get("gauge-base-frame", 0), "gauge-scale" in gauge) == (
        (0, False) if known else (3, True)
    )
    other, _, _ = _parallel(seed=8)
    readings = other.readings(other.parameters, np.zeros((len(other.positions), 3)))
    start = other.coordinates(np.zeros((len(readings), 3)))
    solution = pincal.forward(result.identified, readings, start)
    poses = solution.poses[solution.converged]
    assert len(poses) > 20  # the others are at the end of a leg's reach
    tips = _tips(truth.nominal.platform.transforms(poses).as_matrix())[:, :2]
    wanted = (other.positions + other.rotations.apply(TIP)[:, :2])[solution.converged]
    places = {n: place[:2] for n, place in ({**known, **_places(result)}).items()}
    found = np.vstack((tips, [places[name] for name in SOCKETS]))
    assert _alike(found, np.vstack((wanted, sockets)), grows=not known) < 1e-9


def test_derivatives_of_contacts_are_central_differences() -> None:
    """By the pose and by all that is outside: frame, target, points; to 1e-7.

    Steps follow ``moved``: of a machine in an unknown frame with an unknown target.
    """
    robot, _, data, sockets = _arm(count=2)
    contact = pincal.Contact({"A": None, "B": tuple(sockets[1]), "C": None}, "tip", 1e-4)
    targets = {"tip": pincal.Target(tuple(TIP), unknown=True)}
    setup = pincal.Setup(unknown_frame=True, targets=targets, contacts={"socket": contact})
    observation = Observation(robot, data, setup)
    rng, outside = np.random.default_rng(0), observation.external
    values = outside.moved(outside.start, 0.3 * rng.standard_normal(len(outside)))
    matrices = robot.platform.matrices(pincal.forward(robot, data.readings).poses)
    assert_observed(observation, robot.platform, matrices, values)
    seen = values.frame @ matrices
    tips = seen[:, :3, 3] + seen[:, :3, :3] @ values.offsets[1]
    places = values.features[[SOCKETS.index(name) for name in data.contacts["socket"]], :3]
    columns = [observation.names.index(f"socket_{axis}") for axis in "xyz"]
    missed = observation.residuals(matrices, values)[0][:, columns]
    np.testing.assert_allclose(missed, tips - places, atol=1e-14)


def _noisy(
    noise: pincal.Noise, seed: int, count: int
) -> tuple[Machine, Array, Array, pincal.Measurements]:
    """Return a 3-RRR, sockets, which is touched and what is read there, both with noise."""
    truth, sockets, which = _parallel(count, noise.position, seed)
    fixed = [p.name in FIXED or p.id in FIXED for p in truth.nominal.parameters]
    nominal = truth.nominal.parameters.values
    truth = replace(truth, parameters=np.where(fixed, nominal, truth.parameters))
    data, rng = _of(truth, which), np.random.default_rng(seed)
    shaken = data.readings + noise.reading * rng.standard_normal(data.readings.shape)
    return truth, sockets, which, replace(data, readings=shaken)


FIXED = ("leg_1.beta_b", "k")  # where the platform's frame lies; what hardly shows


def _calibrated(
    robot: pincal.Mechanism, data: pincal.Measurements, sockets: Array, noise: pincal.Noise
) -> tuple[pincal.CalibrationResult, Array]:
    """Return a calibration by two known sockets and one unknown, and which parameters it has."""
    setup = _setup({"A": (*sockets[0], 0.0), "B": (*sockets[1], 0.0), "C": None})
    result = pincal.calibrate(robot, data, setup=setup, noise=noise, fixed=FIXED)
    assert result.converged
    return result, np.array([p.std > 0.0 for leg in result.legs for p in leg.parameters])


@pytest.mark.slow
def test_estimates_are_those_of_full_least_squares() -> None:
    """Parameters and a socket to 1e-6 standard errors; these are the Cramér-Rao bound's to 1e-4.

    SciPy's least squares of readings and contacts with all poses among the unknowns, of so little
    noise that they do not curve with it.
    """
    noise = pincal.Noise(position=1e-6, reading=1e-6)
    truth, sockets, which, data = _noisy(noise, 4, 14)
    result, free = _calibrated(truth.nominal, data, sockets, noise)
    n, count = int(free.sum()), len(which)

    def missed(unknowns: Array) -> Array:
        parameters = truth.parameters.copy()
        parameters[free] = unknowns[:n]
        twists = unknowns[n + 2 :].reshape(count, 3)
        places = np.vstack((sockets[:2], unknowns[n : n + 2]))
        turns = Rotation.from_rotvec(np.pad(twists[:, 2:], ((0, 0), (2, 0)))) * truth.rotations
        tips = truth.positions + twists[:, :2] + turns.apply(TIP)[:, :2]
        read = (truth.readings(parameters, twists) - data.readings) / noise.reading
        return np.concatenate([read.ravel(), ((tips - places[which]) / noise.position).ravel()])

    def slopes(unknowns: Array) -> Array:
        return differentiated(lambda move: missed(unknowns + move), len(unknowns), 2e-4)

    start = np.concatenate([truth.parameters[free], sockets[2], np.zeros(3 * count)])
    best = least_squares(missed, start, slopes, method="lm", x_scale="jac", xtol=1e-15)
    wanted = (best.x - np.linalg.lstsq(best.jac, best.fun, rcond=None)[0])[: n + 2]
    bound = np.sqrt(np.diagonal(np.linalg.inv(best.jac.T @ best.jac)))[: n + 2]
    legs = [p for leg in result.legs for p in leg.parameters]
    found = [p for p, identified in zip(legs, free, strict=True) if identified]
    values, std = np.array([(p.identified, p.std) for p in (*found, *result.external)]).T
    np.testing.assert_allclose(std, bound, rtol=1e-4)
    np.testing.assert_allclose((values - wanted) / bound, 0.0, atol=1e-6)


@pytest.mark.slow
def test_errors_are_as_large_as_is_said() -> None:
    """Six noisy sets: squares of the errors by their covariance have the χ² distribution."""
    noise, statistic, freedoms = pincal.Noise(position=1e-5, reading=1e-5), 0.0, 0
    for seed in range(6):
        truth, sockets, _, data = _noisy(noise, seed, 14)
        result, free = _calibrated(truth.nominal, data, sockets, noise)
        errors = np.concatenate([leg.identified for leg in result.legs]) - truth.parameters
        covariance = result.covariance[np.ix_(free, free)]
        statistic += errors[free] @ np.linalg.solve(covariance, errors[free])
        freedoms += int(free.sum())
    assert 1e-3 < chi2.sf(statistic, freedoms) < 1.0 - 1e-3


def test_poses_are_planned_at_sockets() -> None:
    """Tips of an arm's planned readings are in their sockets to 1e-9 m, ever otherwise turned.

    By Pinocchio; a socket at a known place stays there, others lie apart. Such rows calibrate,
    frames and scale being named, also where some poses about them reach no socket.
    """
    robot, alone = loaded("ur5"), reference("ur5")
    setup = _setup({"A": None, "B": (0.4, 0.3, 0.2), "C": None, "D": None})
    plan, placed = pincal.sample_contacts(robot, setup, 600, seed=1)
    places, names = placed.contacts["socket"].points, np.array(plan.contacts["socket"])
    assert places["B"] == (0.4, 0.3, 0.2)
    matrices = alone.poses(np.zeros(len(robot.parameters)), plan.readings)
    np.testing.assert_allclose(_tips(matrices), [places[name] for name in names], atol=1e-9)
    for name in "ABCD":
        turns = Rotation.from_matrix(matrices[names == name, :3, :3])
        assert len(turns) > 15
        assert np.degrees((turns * turns[0].inv()).magnitude()).max() > 90.0
    assert pdist(list(places.values())).min() > 0.3
    noise = pincal.Noise(2e-5, reading=2e-5)
    unknown = _setup(dict.fromkeys("ABCD"))
    truth = pincal.disturb(robot, 1e-3, seed=0)
    data = pincal.simulate(robot, truth, plan, noise, setup=unknown).measurements
    result = pincal.calibrate(robot, data, setup=unknown, noise=noise)
    assert result.converged
    assert {"gauge-base-frame", "gauge-scale"} <= set(_codes(result))
    assert "undetermined-held" not in {finding.code for finding in result.findings}
    far = _setup({"A": None, "B": (3.0, 0.0, 0.0)})
    with pytest.raises(pincal.WorkspaceError, match="no target to socket 'B'"):
        pincal.sample_contacts(robot, far, 50)
    with pytest.raises(pincal.WorkspaceError, match="no contacts"):
        pincal.sample_contacts(robot, pincal.Setup(), 50)


def test_a_wrong_name_shows_as_rows_that_do_not_fit() -> None:
    """Two of 42 rows with the name of another socket: these are named, and the fit without right.

    The start is where most rows of a socket agree.
    """
    robot, _, data, _ = _arm()
    names = list(data.contacts["socket"])
    names[3], names[30] = "C", "A"
    wrong = replace(data, contacts={"socket": tuple(names)})
    noise = pincal.Noise(1e-5, reading=1e-6)
    result = pincal.calibrate(robot, wrong, setup=_unknown(), noise=noise, loss="reject")
    assert result.converged
    assert sorted(outlier.row for outlier in result.outliers) == [3, 30]
    assert all(outlier.quantity.startswith("measured socket") for outlier in result.outliers)


def test_where_another_socket_begins_is_no_step() -> None:
    """Sockets one after the other, two at known places: no step is named, of 0.3 m or another.

    With a step between the two the scale would be free, and shrink the residuals.
    """
    robot, _, data, sockets = _arm()
    shaken = data.readings + 2e-5 * np.random.default_rng(3).standard_normal(data.readings.shape)
    known = {name: tuple(sockets[place]) for place, name in enumerate("AB")}
    noise = pincal.Noise(1e-5, reading=2e-5)
    setup = _setup({**known, "C": None})
    result = pincal.calibrate(robot, replace(data, readings=shaken), setup=setup, noise=noise)
    assert result.converged
    assert {remark.code for remark in result.findings}.isdisjoint({"step", "model-lacks"})


def test_runs_with_sockets_of_their_own_are_not_held_out() -> None:
    """No other row says where a socket is that one run alone touches: that is said."""
    robot, _, data, _ = _arm(count=8)
    runs = tuple("second" if name == "C" else "first" for name in data.contacts["socket"])
    noise = pincal.Noise(1e-5, reading=1e-6)
    result = pincal.calibrate(robot, replace(data, runs=runs), setup=_unknown(), noise=noise)
    with pytest.raises(pincal.MeasurementError, match="is touched by rows alone"):
        result.validated(by="run")


def test_what_is_touched_is_said_where_it_is_not_understood() -> None:
    """Names that the setup has not, and points touched once or never, are refused by row."""
    robot, _, data, _ = _arm(count=3)
    lined = replace(data, lines=tuple(range(2, 2 + len(data))))

    def trouble(names: tuple[str, ...], setup: pincal.Setup) -> str:
        touched = replace(lined, contacts={"socket": names})
        with pytest.raises(pincal.MeasurementError) as error:
            pincal.calibrate(robot, touched, setup=setup)
        return str(error.value)

    names = data.contacts["socket"]
    assert trouble(("D", *names[1:]), _unknown()).startswith("line 2: socket 'D' is no point")
    once = tuple("B" if name == "A" else name for name in names[1:])
    assert trouble(("A", *once), _unknown()).startswith("line 2 alone touches socket 'A'")
    assert trouble(("B", *once), _unknown()).startswith("no row touches socket 'A'")
    with pytest.raises(pincal.MeasurementError, match="no column 'socket', which says what is"):
        pincal.calibrate(robot, replace(data, contacts={}), setup=_unknown())
    for points, more in (({}, {}), ({"A": (1.0, 2.0)}, {}), ({"A": None}, {"noise": -1.0})):
        with pytest.raises(pincal.MeasurementError):
            pincal.Contact(points, **more)
    with pytest.raises(pincal.MeasurementError, match="'tip' is a contact and a target"):
        replace(_unknown(), contacts={"tip": pincal.Contact({"A": None}, "tip")})


@pytest.mark.slow
def test_sockets_from_plan_to_report(tmp_path: Path) -> None:
    """Simulated, forecast, chosen, calibrated, diagnosed and read again: all know the sockets.

    Rows of a socket are predicted by others of it; residuals are socket by socket; the next socket
    is not accused as a step.
    """
    robot, _, data, _ = _arm()
    poses = pincal.forward(robot, data.readings).poses
    plan = pincal.Plan(poses, readings=data.readings, contacts=data.contacts)
    plan.to_csv(tmp_path / "plan.csv", robot)
    robot.save(tmp_path / "arm")
    file = tmp_path / "setup.yaml"
    file.write_text(
        "pincal_setup: 1\ntargets:\n  tip: {offset: [0.12, -0.05, 0.08], unknown: true}\n"
        "contacts:\n  socket:\n    target: tip\n"
        "    points: {A: unknown, B: unknown, C: unknown}\n    noise: 2.0e-5\n"
    )
    noise = ("--noise-position", "20um", "--noise-reading", "0.02mrad")
    known = (tmp_path / "arm", tmp_path / "plan.csv", "--setup", file, *noise)
    measured, result = tmp_path / "measured.csv", tmp_path / "result"
    done("simulate", *known, "-o", measured)
    written = [line.rpartition(",")[2] for line in measured.read_text().splitlines()]
    assert written == ["socket", *data.contacts["socket"]]
    forecast = done("identifiability", *known, "--measure", "socket")
    assert "measured: socket_x, socket_y, socket_z" in " ".join(forecast.out.split())
    done(
        "select",
        tmp_path / "arm",
        "--setup",
        file,
        *noise,
        "--count",
        30,
        "--verify",
        5,
        "-o",
        tmp_path / "chosen.csv",
    )
    head, *chosen = [line.split(",") for line in (tmp_path / "chosen.csv").read_text().splitlines()]
    assert {row[head.index("socket")] for row in chosen} == {*SOCKETS}
    report = done("calibrate", tmp_path / "arm", measured, "--setup", file, *noise, "-o", result)
    assert "best-fit frames and scale" in " ".join(report.out.split())
    loaded_result = pincal.load_result(result)
    drawn = calibrated(scene(robot, pincal.Plan(loaded_result.poses)), loaded_result).layers
    dots = {layer.name: layer.points[0] for layer in drawn if layer.path.startswith("touched")}
    places = _places(loaded_result)
    for name in SOCKETS:
        np.testing.assert_allclose(dots[f"socket_{name}"], places[name], atol=1e-12)
    assert loaded_result.options.setup.contacts["socket"].points == dict.fromkeys(SOCKETS)
    assert {part.name for part in loaded_result.observed} == {
        f"socket_{name}_{axis}" for name in SOCKETS for axis in "xyz"
    }
    assert not loaded_result.contradictions
    assert loaded_result.validation is not None
    assert [part.target for part in loaded_result.validation.targets] == ["socket"]
    diagnosed = run("doctor", tmp_path / "arm", measured, "--setup", file, *noise)
    assert diagnosed.code == 0
    assert "works" in diagnosed.out
