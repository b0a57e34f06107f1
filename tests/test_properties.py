"""What holds for every mechanism, tried on random ones: a few always, hundreds with -m slow.

Each property draws what it needs; the default run draws the same every time.
"""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
from command_line import contents
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from random_mechanisms import KINDS, mechanisms, poses_near_home, random_leg, reached
from scipy.spatial.transform import Rotation

import pincal
from pincal import Measurements, Mechanism, Noise, Placement, Platform
from pincal.design.forecast import leg_rows
from pincal.design.optimal import continuous_design, exchange
from pincal.kinematics.configurations import leg_demands

Array = NDArray[np.float64]
Draw = Callable[[st.SearchStrategy[Any]], Any]
Property = Callable[[Draw, Path], None]
NOISE = Noise(position=1e-5, orientation=1e-5, reading=1e-6)
SAME = 1e-5  # of a standard error; the fit ends where its steps are below 1e-7 of one
PROPERTIES: dict[str, Property] = {}
SEEDS = st.integers(0, 2**32 - 1)
METHODS = st.sampled_from(["per-leg", "all-legs"])


def holds(function: Property) -> Property:
    """Register a property."""
    PROPERTIES[function.__name__] = function
    return function


# Kinematics


@holds
def forward_undoes_inverse(draw: Draw, folder: Path) -> None:
    """Joints of inverse kinematics put each tip on its platform point; forward finds the pose.

    Tips are computed by products of matrices; forward starts millimetres away. From farther
    away it may find another pose of the same readings, or none, and says so.
    """
    mechanism, seed = draw(mechanisms()), draw(SEEDS)
    platform = mechanism.platform
    poses = poses_near_home(mechanism, 8, seed)
    there = pincal.inverse(mechanism, poses)
    assert there.reached.all()
    T = platform.transforms(poses).as_matrix()
    for leg in mechanism.legs:
        target = T[:, :3, 3] + T[:, :3, :3] @ np.array(leg.point.placement.xyz)
        tips = [reached(leg.with_home(q).joints)[:3, 3] for q in there.joints[leg.name]]
        np.testing.assert_allclose(tips, target, rtol=0.0, atol=1e-13)
    rng = np.random.default_rng(seed)
    near, away = (platform.moved(poses, rng.uniform(-d, d, poses.shape)) for d in (0.001, 0.02))
    found = pincal.forward(mechanism, there.readings, near)
    assert found.converged.all(), found.reasons
    np.testing.assert_allclose(platform.twists_between(poses, found.poses), 0.0, atol=1e-11)
    for guess in (away, None):
        far = pincal.forward(mechanism, there.readings, guess)
        exact = far.converged & (far.gap < 1e-8).all(axis=1)
        assert mechanism.redundant or exact[far.converged].all()  # else nearest, the gap says so
        again = pincal.inverse(mechanism, far.poses[exact])
        np.testing.assert_allclose(again.readings, there.readings[exact], atol=1e-9)


@holds
def carried_poses_are_read_by_carried_legs(draw: Draw, folder: Path) -> None:
    """A generated mechanism has its group, and F(λ x) = λ F(x) for every element of it."""
    homes = {"planar": (0.0,) * 3, "translational": (0.0, 0.0, 0.3)}
    homes["spatial"] = (0.0, 0.0, 0.3, 0.0, 0.0, 0.0)
    kind = draw(st.sampled_from(sorted(homes)))
    platform = Platform(kind, homes[kind])
    rng = np.random.default_rng(draw(SEEDS))
    families = KINDS[platform.kind][1]
    leg = random_leg("leg_1", families[rng.integers(len(families))], platform, rng)
    turns = draw(st.integers(3, 8) if platform.kind != "spatial" else st.integers(6, 8))
    elements = pincal.cyclic(turns)
    if draw(st.booleans()):
        elements = pincal.cyclic(half := max(turns // 2, 3))
        elements += tuple(pincal.Element.mirror(np.pi * k / half) for k in range(half))
    mechanism = pincal.generate("generated", leg, elements, platform)
    group = pincal.symmetry_group(mechanism)
    for element in elements:
        assert any(element.equals(own) for own in group.elements), str(group)
    twists = rng.uniform(-0.1, 0.1, (20, platform.dof))
    poses = platform.moved(np.tile(platform.home, (20, 1)), twists)
    before = pincal.inverse(mechanism, poses)
    T = platform.transforms(poses).as_matrix()
    for element, permutation in zip(group.elements, group.permutations, strict=True):
        there = element.base @ T @ np.linalg.inv(element.platform)
        after = pincal.inverse(mechanism, platform.from_matrices(there))
        order = list(permutation)
        assert (after.reached[:, order] == before.reached).all()
        difference = after.readings[:, order] - before.readings
        turn = np.isfinite(difference) & (np.array(mechanism.reading_units) == "rad")
        difference[turn] = (difference[turn] + np.pi) % (2 * np.pi) - np.pi
        np.testing.assert_allclose(difference[before.reached], 0.0, atol=1e-9)


# Calibration


def measured(
    mechanism: Mechanism, seed: int, truth: Mechanism | None = None, count: int = 40
) -> Measurements:
    """Return measurements of a disturbed mechanism."""
    truth = truth or pincal.disturb(mechanism, 1e-3, seed)
    poses = poses_near_home(mechanism, count, seed, 0.35)
    readings = pincal.inverse(truth, poses).readings
    rng = np.random.default_rng(seed)
    twists = 1e-5 * rng.standard_normal(poses.shape)
    readings += 1e-6 * rng.standard_normal(readings.shape)
    some = np.isfinite(readings).all(axis=1)
    return Measurements(mechanism.platform.moved(poses, twists)[some], readings=readings[some])


def calibrated(
    mechanism: Mechanism, data: Measurements, method: Any = "per-leg"
) -> pincal.CalibrationResult:
    """Return a calibration; mechanisms whose parameters such poses do not tell are left out."""
    try:
        result = pincal.calibrate(mechanism, data, noise=NOISE, method=method)
    except pincal.ObservabilityError:
        assume(False)
    assert result.converged, result.message
    return result


def values(result: pincal.CalibrationResult) -> dict[str, tuple[Array, Array]]:
    """Return identified parameters and their standard errors by leg."""
    return {
        leg.name: (
            np.array([p.identified for p in leg.parameters]),
            np.array([p.std for p in leg.parameters]),
        )
        for leg in result.legs
    }


def assert_same(first: pincal.CalibrationResult, second: pincal.CalibrationResult) -> None:
    """Check that two calibrations say the same, within a small part of a standard error."""
    a, b = values(first), values(second)
    assert set(a) == set(b)
    for leg in a:
        assert (np.abs(a[leg][0] - b[leg][0]) <= SAME * a[leg][1]).all()
        np.testing.assert_allclose(b[leg][1], a[leg][1], rtol=SAME)
    assert second.reduced_chi2 == pytest.approx(first.reduced_chi2, rel=SAME)


@holds
def units_of_the_table_do_not_count(draw: Draw, folder: Path) -> None:
    """Columns in millimetres and degrees give what columns in metres and radians give."""
    mechanism, seed = draw(mechanisms()), draw(SEEDS)
    data = measured(mechanism, seed)
    data.to_csv(folder / "si.csv", mechanism, force=True)
    header, *lines = (folder / "si.csv").read_text(encoding="utf-8").splitlines()
    cells = np.array([line.split(",") for line in lines], dtype=float)
    names = header.split(",")
    chosen = draw(st.lists(st.booleans(), min_size=len(names), max_size=len(names)))
    for i in np.flatnonzero(chosen):
        name, unit = names[i].split(" ")
        names[i] = f"{name} [{ {'[m]': 'mm', '[rad]': 'deg'}[unit] }]".replace("[ ", "[")
        cells[:, i] *= 1e3 if unit == "[m]" else 180.0 / np.pi
    text = [",".join(names), *(",".join(map(repr, row)) for row in cells.tolist()), ""]
    (folder / "other.csv").write_text("\n".join(text), encoding="utf-8")
    results = [
        calibrated(mechanism, pincal.Measurements.from_csv(folder / name, mechanism))
        for name in ("si.csv", "other.csv")
    ]
    assert_same(*results)


@holds
def the_base_frame_does_not_count(draw: Draw, folder: Path) -> None:
    """A mechanism turned and moved with its data has the same parameters, its base moved along.

    Also where the platform's axes turn with the base, as those of a pure translation must.
    """
    mechanism, seed, method = draw(mechanisms()), draw(SEEDS), draw(METHODS)
    platform, rng = mechanism.platform, np.random.default_rng(seed)
    data = measured(mechanism, seed)
    T = np.eye(4)
    if platform.space == 2:
        T[:2, 3] = rng.uniform(-2.0, 2.0, 2)
        T[:3, :3] = Rotation.from_euler("z", rng.uniform(-3.0, 3.0)).as_matrix()
    else:
        T[:3, 3] = rng.uniform(-2.0, 2.0, 3)
        T[:3, :3] = Rotation.random(random_state=rng).as_matrix()
    back = np.eye(4)  # of the platform's axes
    if platform.kind in ("point", "translational"):
        back[:3, :3] = T[:3, :3].T

    def carried(poses: Array) -> Array:
        return platform.from_matrices(T @ platform.transforms(poses).as_matrix() @ back)

    legs = []
    for leg in mechanism.legs:
        p, foot = leg.nominal_by_name, leg.joints[0]
        names = [name for name in p if name.startswith("A_")]
        base = T[:3, :3] @ foot.placement.xyz + T[:3, 3]
        p |= dict(zip(names, base.tolist(), strict=False))
        turn = np.eye(4)
        turn[:3, :3] = T[:3, :3] @ foot.placement.origin()[:3, :3]
        foot = replace(
            foot, placement=Placement.of(p, **dict(zip("xyz", names, strict=False))).at(p, turn)
        )
        point = leg.point
        if platform.kind == "translational":
            xyz = T[:3, :3] @ point.placement.xyz
            point = replace(point, placement=Placement(xyz=tuple(xyz.tolist())))
        parameters = tuple(p.items())
        joints = (foot, *leg.joints[1:])
        legs.append(replace(leg, joints=joints, point=point, parameters=parameters))
    home = tuple(carried(np.array([platform.home]))[0].tolist())
    moved = Mechanism("moved", Platform(platform.kind, home), tuple(legs))
    first = calibrated(mechanism, data, method)
    second = calibrated(moved, Measurements(carried(data.poses), readings=data.readings), method)
    for leg, other in zip(first.legs, second.legs, strict=True):
        own = {p.name: p for p in leg.parameters}
        new = {p.name: p for p in other.parameters}
        base = [name for name in own if name.startswith("A_")]
        rows = len(base)
        expected = T[:rows, :rows] @ [own[name].identified for name in base] + T[:rows, 3]
        wide = max(own[name].std for name in base)
        found = np.array([new[name].identified for name in base])
        assert (np.abs(found - expected) <= SAME * wide).all()
        for name in set(own) - set(base):
            assert abs(new[name].identified - own[name].identified) <= SAME * own[name].std
            assert new[name].std == pytest.approx(own[name].std, rel=SAME)


@holds
def the_order_of_legs_does_not_count(draw: Draw, folder: Path) -> None:
    """Legs in another order, in mechanism and table, get the same parameters."""
    mechanism, seed, method = draw(mechanisms()), draw(SEEDS), draw(METHODS)
    data = measured(mechanism, seed)
    order = draw(st.permutations(range(len(mechanism.legs))))
    other = replace(mechanism, legs=tuple(mechanism.legs[i] for i in order))
    first = calibrated(mechanism, data, method)
    assert_same(first, calibrated(other, replace(data, readings=data.readings[:, order]), method))


@holds
def the_order_of_rows_does_not_count(draw: Draw, folder: Path) -> None:
    """Rows in another order give the same parameters."""
    mechanism, seed, method = draw(mechanisms()), draw(SEEDS), draw(METHODS)
    data = measured(mechanism, seed)
    order = np.random.default_rng(seed).permutation(len(data))
    first = calibrated(mechanism, data, method)
    assert_same(first, calibrated(mechanism, data.rows(order), method))


@holds
def errors_stay_when_the_truth_shifts(draw: Draw, folder: Path) -> None:
    """Identified less true parameters are those of the noise, wherever the truth is.

    To first order: a tenth of the shift changes them by less than a fifth of what the shift does,
    and a shift of 1e-3 by less than a fifth of a standard error, of parameters that are told to
    1e-3.
    """
    mechanism, seed = draw(mechanisms()), draw(SEEDS)
    shift = {
        leg.name: np.random.default_rng((seed, i)).standard_normal(len(leg.parameters))
        for i, leg in enumerate(mechanism.legs)
    }
    errors, std = [], np.empty(0)
    poses = poses_near_home(mechanism, 40, seed, 0.35)
    twists = 1e-5 * np.random.default_rng(seed).standard_normal(poses.shape)
    for size in (0.0, 1e-4, 1e-3):
        nominal = mechanism.nominal
        true = {name: nominal[name] + size * shift[name] for name in nominal}
        there = pincal.inverse(mechanism.with_parameters(true), poses)
        assume(there.reached.all())
        data = Measurements(mechanism.platform.moved(poses, twists), readings=there.readings)
        found = values(calibrated(mechanism, data))
        errors.append(np.concatenate([found[name][0] - true[name] for name in nominal]))
        std = np.concatenate([found[name][1] for name in nominal])
    assume((std < 1e-3).all())
    little, much = (np.abs((error - errors[0]) / std).max() for error in errors[1:])
    assert much < 0.2
    assert little < max(0.2 * much, SAME)


# Determinism


@holds
def the_same_seed_gives_the_same_bytes(draw: Draw, folder: Path) -> None:
    """Plans, measurements and results are the same files, whatever global generators hold.

    They are not touched either.
    """
    mechanism, seed = draw(mechanisms(("point", "planar", "translational"))), draw(SEEDS)
    poses = poses_near_home(mechanism, 60, seed, 0.35)
    written = []
    for run, other in enumerate((1, 2)):
        np.random.seed(other)  # noqa: NPY002
        random.seed(other)
        before = (np.random.get_state()[1].tolist(), random.getstate())  # type: ignore[index]  # noqa: NPY002
        own = folder / str(run)
        own.mkdir(exist_ok=True)
        selection = pincal.select_poses(mechanism, poses, 15, "independent", seed=seed, starts=2)
        selection.plan.to_csv(own / "plan.csv", mechanism, force=True)
        truth = pincal.disturb(mechanism, 1e-3, seed)
        data = pincal.simulate(mechanism, truth, selection.plan, NOISE, seed).measurements
        data.to_csv(own / "data.csv", mechanism, force=True)
        result = calibrated(mechanism, data)
        result.save(own / "result", force=True)
        assert before == (np.random.get_state()[1].tolist(), random.getstate())  # type: ignore[index]  # noqa: NPY002
        written.append(contents(own))
    assert written[0] == written[1]
    assert "result/result.json" in written[0]


# Choice of poses


@holds
def no_exchange_ends_below_its_start(draw: Draw, folder: Path) -> None:
    """The set has no candidate twice, and no smaller determinant than any start."""
    seed, starts = draw(SEEDS), draw(st.integers(1, 4))
    n, r = draw(st.integers(1, 6)), draw(st.integers(1, 3))
    count = draw(st.integers(n, 2 * n + 3))
    rng = np.random.default_rng(seed)
    blocks = rng.standard_normal((count + draw(st.integers(0, 40)), r, n))
    weights = continuous_design((blocks,)).weights
    chosen, value = exchange((blocks,), count, weights, np.random.default_rng(seed), starts)
    again = np.random.default_rng(seed)
    tried = [np.argsort(-weights, kind="stable")[:count]]
    tried += [again.permutation(len(blocks))[:count] for _ in range(starts - 1)]

    def log_det(rows: NDArray[np.intp]) -> float:
        J = blocks[rows].reshape(-1, n)
        return float(np.linalg.slogdet(J.T @ J)[1])

    assert len(set(chosen.tolist())) == count
    assert value == pytest.approx(log_det(chosen), abs=1e-8)
    assert value >= max(map(log_det, tried)) - 1e-8


@holds
def chosen_poses_are_reached_and_told_apart(draw: Draw, folder: Path) -> None:
    """No pose twice, none out of reach, none worse than chance, though candidates hold such."""
    mechanism, seed = draw(mechanisms()), draw(SEEDS)
    protocol: Literal["independent", "common"] = draw(st.sampled_from(["independent", "common"]))
    platform, rng = mechanism.platform, np.random.default_rng(seed)
    good = poses_near_home(mechanism, 40, seed, 0.35)
    far = good[:5] + np.array([50.0 * (unit == "m") for unit in platform.units])
    candidates = rng.permutation(np.concatenate((good, far, good, good[:7])))
    sizes = [len(leg.parameters) for leg in mechanism.legs]
    count = max(sizes) + 3 if protocol == "independent" else max(sizes) + 6
    try:
        found = pincal.select_poses(mechanism, candidates, count, protocol, seed=seed, starts=2)
    except pincal.ObservabilityError:
        assume(False)
    for leg in mechanism.legs:
        own = found.plan.poses[found.plan.serves(leg.name)]
        assert len(np.unique(own, axis=0)) == len(own) == count
        assert pincal.inverse(mechanism, own).reached.all()
        if protocol == "independent":
            log_dets = [_log_det(mechanism, leg.name, own)] + [
                _log_det(mechanism, leg.name, good[rng.permutation(len(good))[:count]])
                for _ in range(20)
            ]
            assert log_dets[0] >= max(log_dets) - 1e-8


def _log_det(mechanism: Mechanism, leg: str, poses: Array) -> float:
    demand = leg_demands(mechanism, pincal.Plan(poses))[mechanism.leg_names.index(leg)]
    rows = leg_rows(demand, mechanism, Noise())
    J = rows.reshape(-1, rows.shape[2])
    return float(np.linalg.slogdet(J.T @ J)[1])


_QUIET = [HealthCheck.too_slow, HealthCheck.function_scoped_fixture, HealthCheck.filter_too_much,
          HealthCheck.data_too_large]  # fmt: skip


@pytest.mark.parametrize("name", PROPERTIES)
@given(data=st.data())
@settings(max_examples=1, derandomize=True, database=None, deadline=None,
          suppress_health_check=_QUIET)  # fmt: skip
def test_property(name: str, data: st.DataObject, tmp_path: Path) -> None:
    """The property holds for a mechanism, the same one in every run."""
    PROPERTIES[name](data.draw, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("name", PROPERTIES)
@given(data=st.data())
@settings(max_examples=8, derandomize=True, database=None, deadline=None,
          suppress_health_check=_QUIET)  # fmt: skip
def test_property_of_many(name: str, data: st.DataObject, tmp_path: Path) -> None:
    """The property holds for eight mechanisms, the same ones in every run."""
    PROPERTIES[name](data.draw, tmp_path)


@pytest.mark.fuzz
@pytest.mark.parametrize("name", PROPERTIES)
@given(data=st.data())
@settings(max_examples=200, deadline=None, suppress_health_check=_QUIET)
def test_property_of_any(name: str, data: st.DataObject, tmp_path: Path) -> None:
    """The property holds for two hundred mechanisms, others in every run."""
    PROPERTIES[name](data.draw, tmp_path)
