"""Configurations chosen for all parameters together, and free of collisions."""

from __future__ import annotations

from itertools import combinations
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from arms import loaded, robot, urdf
from command_line import run
from measured import put, workspace

import pincal
from pincal import free_of_collision
from pincal.design.forecast import information_rows
from pincal.estimation.observability.identifiable import plausible_changes
from pincal.kinematics.closure import LegClosure
from pincal.kinematics.configurations import joints_at, legs_at

NOISE = pincal.Noise(1e-4, 1e-4, 0.0)
POINT = pincal.Setup(unknown_frame=True, targets={"platform": pincal.Target((0.05, 0.1, 0.02))})


def information(
    mechanism: pincal.Mechanism,
    plan: pincal.Plan,
    measured: tuple[str, ...],
    setup: pincal.Setup,
    noise: pincal.Noise = NOISE,
) -> np.ndarray:
    """Return the information of each configuration, in what all of them determine, (N, r, r)."""
    rows = information_rows(mechanism, legs_at(mechanism, plan), noise, measured, setup)[0]
    flat = rows.reshape(-1, rows.shape[2])
    lengths = np.linalg.norm(flat, axis=0)
    lengths[lengths == 0.0] = 1.0
    _, s, axes = np.linalg.svd(flat / lengths, full_matrices=False)
    kept = (rows / lengths) @ axes[s > 1e-9 * s[0]].T
    return kept.transpose(0, 2, 1) @ kept


def test_what_is_lost_of_the_frame_alone_takes_nothing_of_the_parameters() -> None:
    """Of x and y a tracker's height says nothing: standard errors nearest to nominal, all the same.

    By least squares with faint pulls to nominal, all in units of how far machines differ.
    """
    mechanism = pincal.load_mechanism("6UPS")
    plan, setup = pincal.Plan(workspace("6UPS", 50)), pincal.Setup(unknown_frame=True)
    forecast = pincal.forecast(mechanism, plan, NOISE, ["x", "y"], setup)
    assert forecast.rank.n_params - forecast.rank.rank == 10
    assert (forecast.gauge.shape[1], forecast.lost.shape[1]) == (9, 0)
    legs = legs_at(mechanism, plan)
    rows = information_rows(mechanism, legs, NOISE, ["x", "y"], setup)[0]
    scale = np.append(plausible_changes(mechanism), np.full(6, 1e6))
    J, pulls = rows.reshape(-1, len(scale)) * scale, np.append(np.full(48, 1e-4), np.full(6, 1e-7))
    noise = np.eye(len(J), len(J) + len(scale)).T
    estimate = np.linalg.lstsq(np.vstack((J, np.diag(pulls))), noise, rcond=None)[0]
    wanted = (scale * np.linalg.norm(estimate, axis=1))[:48]
    np.testing.assert_allclose(forecast.std, wanted, rtol=1e-5)


def log_det(every: np.ndarray, chosen: list[int]) -> float:
    """Return the logarithm of the determinant of chosen information."""
    sign, value = np.linalg.slogdet(every[chosen].sum(axis=0))
    return float(value) if sign > 0 else -np.inf


def rows_of(plan: pincal.Plan, chosen: pincal.Plan) -> list[int]:
    """Return which configurations were chosen, by their readings."""
    assert plan.readings is not None
    assert chosen.readings is not None
    off = np.abs(plan.readings[:, None] - chosen.readings[None]).max(axis=2)
    assert (off.min(axis=0) == 0.0).all()
    return [int(row) for row in off.argmin(axis=0)]


@pytest.mark.parametrize("noise", [NOISE, pincal.Noise(1e-6, 1e-2, 0.0)])
def test_small_choices_are_the_best(noise: pincal.Noise, tmp_path: Path) -> None:
    """Of twelve configurations of a two-joint arm, five: as good as the best of all 792.

    The efficiency bounds what could be better: no choice of five reaches more than it allows.
    """
    file = tmp_path / "two.urdf"
    file.write_text(robot("a|revolute|0 1 0|0 0 0\nb|revolute|.6 0 .8|.35 0 .1"))
    mechanism = pincal.Mechanism.from_urdf(file, "l2")
    plan = pincal.sample_configurations(mechanism, 12, 3)
    found = pincal.select_configurations(mechanism, plan, 5, noise=noise)
    measured, setup = ("x", "y", "z", "rx", "ry", "rz"), pincal.Setup()
    every = information(mechanism, plan, measured, setup, noise)
    best = max(log_det(every, list(one)) for one in combinations(range(12), 5))
    chosen = rows_of(plan, found.plan)
    assert len(set(chosen)) == 5
    assert log_det(every, chosen) == pytest.approx(best, abs=1e-9)
    assert found.rank.rank == 14 == every.shape[1]
    assert 0.0 < found.efficiency <= 1.0


@pytest.mark.slow
@pytest.mark.parametrize("points", [False, True])
def test_choices_beat_chance(points: bool) -> None:
    """Thirty of 400 configurations say more than any of 200 random plans; none is taken twice."""
    mechanism = loaded("ur10")
    plan = pincal.sample_configurations(mechanism, 400, 0)
    measured = ("x", "y", "z", *(() if points else ("rx", "ry", "rz")))
    setup = POINT if points else pincal.Setup()
    found = pincal.select_configurations(
        mechanism, plan, 30, noise=NOISE, measured=measured, setup=setup, starts=3
    )
    every = information(mechanism, plan, measured, setup)
    chosen = rows_of(plan, found.plan)
    assert len(set(chosen)) == 30
    rng = np.random.default_rng(1)
    chance = [log_det(every, list(rng.choice(400, 30, replace=False))) for _ in range(200)]
    rank = every.shape[1]
    assert found.rank.rank == rank == (27 if points else 30)
    assert log_det(every, chosen) > max(chance)
    assert found.efficiency > 0.95
    # the certificate: a random plan's own efficiency follows from its determinant
    relative = np.exp((max(chance) - log_det(every, chosen)) / rank) * found.efficiency
    assert relative < found.efficiency <= 1.0


def test_too_few_are_refused() -> None:
    """Fewer equations than unknowns that can be identified: the least number is named."""
    mechanism = loaded("ur10")
    plan = pincal.sample_configurations(mechanism, 60, 0)
    with pytest.raises(pincal.ObservabilityError, match="at least 5"):
        pincal.select_configurations(mechanism, plan, 4, noise=NOISE)


def test_collisions_are_pinocchios() -> None:
    """At 50 configurations the answer is that of Pinocchio asked pair by pair.

    Pairs of one body or of neighbouring joints are left out, and such as touch at zero.
    """
    file, mechanism = urdf("ur10_robot.urdf"), loaded("ur10")
    readings = pincal.sample_configurations(mechanism, 50, 0).readings
    names = mechanism.reading_names
    assert readings is not None
    free = free_of_collision(file, names, readings)
    model = pin.buildModelFromUrdf(str(file))
    shapes = pin.buildGeomFromUrdf(
        model, str(file), pin.GeometryType.COLLISION, package_dirs=[str(file.parents[4])]
    )
    bodies = shapes.geometryObjects
    pairs = [
        (i, j)
        for i, j in combinations(range(shapes.ngeoms), 2)
        if abs(bodies[i].parentJoint - bodies[j].parentJoint) > 1  # one chain: joints in a row
    ]
    for i, j in pairs:
        shapes.addCollisionPair(pin.CollisionPair(i, j))
    data, found = model.createData(), shapes.createData()

    def touching(q: np.ndarray) -> np.ndarray:
        pin.updateGeometryPlacements(model, data, shapes, found, q)
        return np.array([pin.computeCollision(shapes, found, k) for k in range(len(pairs))])

    design = touching(pin.neutral(model))
    wanted = [not (touching(q) & ~design).any() for q in readings]
    np.testing.assert_array_equal(free, wanted)
    assert 0 < free.sum() < 50


def test_what_cannot_be_checked(tmp_path: Path) -> None:
    """Passive joints, unknown joints, no geometry, no file: one message, nothing written."""
    file = urdf("ur10_robot.urdf")
    out = tmp_path / "plan.csv"
    said = run("select", "6UPS", "--count", 12, "--collision", file, "-o", out)
    assert said.code == 2
    assert "no serial arm" in said.trouble
    assert not out.exists()
    with pytest.raises(pincal.MechanismError, match="no joint named 'nothing'"):
        free_of_collision(file, ["nothing"], np.zeros((1, 1)))
    bare = tmp_path / "bare.urdf"
    bare.write_text(robot("a|revolute|0 0 1|0 0 0"))
    with pytest.raises(pincal.MechanismError, match="no <collision>"):
        free_of_collision(bare, ["a"], np.zeros((1, 1)))
    with pytest.raises(pincal.FileError, match="no such file"):
        free_of_collision(tmp_path / "none.urdf", ["a"], np.zeros((1, 1)))
    lost = tmp_path / "lost.urdf"
    mesh = '<collision><geometry><mesh filename="package://lost/a.stl"/></geometry></collision>'
    lost.write_text(bare.read_text().replace('<link name="l1"/>', f'<link name="l1">{mesh}</link>'))
    with pytest.raises(pincal.FileError, match="collision geometry cannot be read"):
        free_of_collision(lost, ["a"], np.zeros((1, 1)))


def test_joints_are_where_readings_put_them() -> None:
    """Of a 3-RPS, every leg closes there; with a reading far off, that leg's joints are NaN."""
    mechanism = pincal.load_mechanism("3RPS")
    plan = pincal.sample_configurations(mechanism, 20, 1)
    assert plan.readings is not None
    found = joints_at(mechanism, plan)
    assert found.reached.all()
    matrices = mechanism.platform.transforms(plan.poses).as_matrix()
    for leg in mechanism.legs:
        gap = LegClosure(leg, mechanism.platform).evaluate(found.joints[leg.name], matrices).gap
        np.testing.assert_allclose(gap, 0.0, atol=1e-9)
    plan = put(plan, "readings", np.s_[:5, 1], plan.readings[:5, 1] * 1.1)
    wrong = joints_at(mechanism, plan)
    for place, name in enumerate(mechanism.leg_names):
        lost = np.arange(20) < (5 if place == 1 else 0)
        np.testing.assert_array_equal(wrong.reached[:, place], ~lost)
        np.testing.assert_array_equal(np.isnan(wrong.joints[name]).all(axis=1), lost)
        np.testing.assert_allclose(wrong.joints[name][~lost], found.joints[name][~lost], atol=1e-12)
