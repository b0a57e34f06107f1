"""Where numbers come to their edges: each case has a stated answer, and NumPy warns of nothing.

Warnings are errors in all tests (pyproject.toml).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from marks import slow_or_fuzz, some_slow
from measured import workspace
from numpy.typing import NDArray
from random_mechanisms import KINDS, poses_near_home, random_leg, random_mechanism
from resized import scaled

import pincal
from pincal import Measurements, Mechanism, Noise, Platform
from pincal.model.consistency import home_gap
from pincal.workspace.criteria import in_workspace

Array = NDArray[np.float64]
AROUND = (-1e-6, -1e-12, -1e-15, 0.0, 1e-15, 1e-12, 1e-6)
NOISE = Noise(position=1e-5, orientation=1e-5, reading=1e-6)


@cache
def sampled(mechanism: Mechanism) -> Array:
    """Return poses of the workspace; asked once, as other poses change nothing about it."""
    return pincal.sample_workspace(mechanism, 20, seed=0)


def everything(mechanism: Mechanism, poses: Array) -> list[str]:
    """Ask all of kinematics, and return the errors that were raised on purpose."""
    refused = []
    readings = pincal.inverse(mechanism, poses).readings
    told = np.isfinite(readings).all(axis=1)
    questions: list[Callable[[], object]] = [
        lambda: pincal.margins(mechanism, poses),
        lambda: [pincal.identification_jacobian(mechanism, n, poses) for n in mechanism.leg_names],
        lambda: pincal.forward(mechanism, readings[told]),
        lambda: pincal.forward(mechanism, readings[told], poses[told]),
        lambda: in_workspace(mechanism, poses),
        lambda: sampled(mechanism),
        lambda: pincal.symmetry_group(mechanism),
        lambda: pincal.calibrate(mechanism, Measurements(poses, readings=readings), noise=NOISE),
        lambda: pincal.select_poses(mechanism, poses, 12, "independent", starts=1),
        lambda: pincal.forecast(mechanism, poses, noise=NOISE),
    ]
    for question in questions:
        try:
            question()
        except pincal.PincalError as error:
            refused.append(str(error))
    return refused


def around(mechanism: Mechanism, pose: Array, size: float = 1e-3) -> Array:
    """Return 30 poses around one."""
    twists = size * np.random.default_rng(0).standard_normal((30, mechanism.platform.dof))
    return mechanism.platform.moved(np.tile(pose, (30, 1)), twists)


# Singularities


@pytest.mark.parametrize("folded", [False, True])
def test_around_type1_singularities_a_leg_reaches_or_says_no(folded: bool) -> None:
    """Within rounding of a stretched or folded dyad: joints that close it, or NaN; never between.

    Inside by 1e-12 it is reached with a margin of the root of that, outside by 1e-12 it is not.
    """
    mechanism = pincal.load_mechanism("5R")
    p = mechanism.legs[0].nominal_by_name
    reach = abs(p["l"] - p["L"]) if folded else p["l"] + p["L"]
    way = np.array([np.cos(1.3), np.sin(1.3)])
    inward = -1.0 if folded else 1.0
    depth = -inward * np.array(AROUND) * np.sign(inward)
    poses = np.array([p["A_x"], p["A_y"]]) + way * (reach * (1.0 - inward * depth))[:, None]
    there, margins = pincal.inverse(mechanism, poses), pincal.margins(mechanism, poses)
    inside, outside = depth >= 1e-12, depth <= -1e-12
    assert there.reached[inside, 0].all()
    assert not there.reached[outside, 0].any()
    closed = there.reached[:, 0]
    q, elbow = there.joints["leg_1"][closed].T
    tip = p["A_x"] + 1j * p["A_y"] + np.exp(1j * q) * (p["l"] + p["L"] * np.exp(1j * elbow))
    np.testing.assert_allclose(tip, poses[closed, 0] + 1j * poses[closed, 1], atol=1e-13)
    assert np.isnan(there.readings[~closed, 0]).all()
    assert np.isnan(margins.type1[~closed, 0]).all()
    np.testing.assert_allclose(margins.type1[closed, 0], np.abs(np.sin(elbow)), atol=1e-7)
    assert (margins.type1[closed, 0] < 1e-2).all()
    J = pincal.identification_jacobian(mechanism, "leg_1", poses)
    assert np.isfinite(J[inside]).all()
    assert np.isnan(J[~closed]).all()
    for row, closes in enumerate(closed):
        assert closes or "leg_1" in there.reason(row)
    assert not in_workspace(mechanism, poses).any()
    everything(mechanism, np.concatenate((poses, around(mechanism, poses[3], 1e-9))))


@pytest.mark.parametrize("turned", [0.0, np.pi])
def test_around_type2_singularities_a_pose_answers_or_says_no(turned: bool) -> None:
    """Struts that meet in one point: margin 0, out of the workspace; what forward finds, fits.

    The margin is of first order in the angle; poses that are found give the readings back.
    """
    mechanism = pincal.load_mechanism("3RPR")
    p = mechanism.legs[0].nominal_by_name
    angles = p["beta"] - p["beta_b"] + turned + np.array(AROUND)
    poses = np.stack((0 * angles, 0 * angles, angles), axis=1)
    there, margins = pincal.inverse(mechanism, poses), pincal.margins(mechanism, poses)
    assert there.reached.all()
    slope = (margins.type2[-1] - margins.type2[0]) / (AROUND[-1] - AROUND[0])
    assert 0.1 < abs(slope) < 10.0
    np.testing.assert_allclose(margins.type2, slope * np.array(AROUND), atol=1e-14, rtol=1e-4)
    assert not in_workspace(mechanism, poses).any()
    found = pincal.forward(mechanism, there.readings, poses)
    again = pincal.inverse(mechanism, found.poses[found.converged])
    np.testing.assert_allclose(again.readings, there.readings[found.converged], atol=1e-8)
    assert all(found.reasons[row] for row in np.flatnonzero(~found.converged))
    assert np.isnan(found.poses[~found.converged]).all()
    everything(mechanism, np.concatenate((poses, around(mechanism, poses[3]))))


@pytest.mark.slow
@pytest.mark.parametrize(
    "pose",
    [
        (0, 0, 1e-12, 0, 0, 0),
        (0, 0, 0, 0, 0, 0),
        (0, 0, 1.8, 0, 0, np.pi / 2),
        (0, 0, 1.8, 0, 0, -np.pi / 2),
    ],
)
def test_singular_hexapods(pose: tuple[float, ...]) -> None:
    """A flat hexapod, and one turned by a right angle (Fichter): margin 0, no workspace."""
    mechanism, poses = pincal.load_mechanism("6UPS"), np.array([pose])
    assert abs(pincal.margins(mechanism, poses).type2[0]) < 1e-12
    assert not in_workspace(mechanism, poses).any()
    everything(mechanism, np.concatenate((poses, around(mechanism, poses[0]))))


# Degenerate geometry

DEGENERATE = {
    "crank of no length": ("3RRR", {"l": 0.0}),
    "rod of no length": ("3RRR", {"L": 0.0}),
    "links of no length": ("3RRR", {"l": 0.0, "L": 0.0}),
    "one base point": ("3RRR", {"OA": 0.0}),
    "one platform point": ("6UPS", {"ob": 0.0}),
    "one base point in space": ("6UPS", {"OA": 0.0}),
    "cranks of no length in space": ("6RUS", {"l": 0.0}),
    "rods of no length in space": ("delta", {"L": 0.0}),
    "rods of no length on rails": ("6PUS", {"L": 0.0}),
    "rods of no length in the plane": ("3PRR", {"L": 0.0}),
    "base points of two legs": ("5R", {"A_x": 0.0, "A_y": 0.0}),
}
#: What still moves, and what no pose tells then.
STILL_MOVES = {"one base point": "beta", "base points of two legs": "", "one platform point": "b"}


@pytest.mark.parametrize(
    "case",
    some_slow(
        DEGENERATE,
        "links of no length",
        "rod of no length",
        "one platform point",
        "rods of no length in the plane",
        *(case for case in DEGENERATE if "space" in case),
    ),
)
def test_degenerate_geometry_has_an_answer(case: str, tmp_path: Path) -> None:
    """Lengths of zero: home is reached as before, or is said to be out of reach or singular.

    A parameter that has no effect any more is named, not identified.
    """
    name, zeros = DEGENERATE[case]
    mechanism = pincal.load_mechanism(name)
    mechanism = mechanism.with_parameters({leg.name: zeros for leg in mechanism.legs})
    home = np.array([mechanism.platform.home])
    refused = " ".join(everything(mechanism, np.concatenate((home, around(mechanism, home[0])))))
    there = pincal.inverse(mechanism, home)
    singular = abs(pincal.margins(mechanism, home).type2[0]) < 1e-12
    if case in STILL_MOVES:
        assert there.reached.all()
        assert STILL_MOVES[case] in refused
    else:
        assert singular or not there.reached.any()
        assert "reach" in refused or "singularity" in refused
    saved = mechanism.save(tmp_path / "m")
    gaps = [max(home_gap(leg, mechanism.platform)) / leg.size for leg in mechanism.legs]
    if max(gaps) < 0.1:
        assert pincal.load_mechanism(saved) == mechanism
    else:
        with pytest.raises(pincal.MechanismError, match="does not close at home"):
            pincal.load_mechanism(saved)


@pytest.mark.parametrize("name", ["3RRR", "5R", "6UPS"])
@pytest.mark.parametrize("gain", [1e-9, 1e9, 1e-13, 1e13, 1e-320, 0.0])
def test_gains_near_zero_are_computed_with_or_refused(name: str, gain: float) -> None:
    """Gains within twelve digits of one are gains like others; beyond, the leg is refused."""
    mechanism = pincal.load_mechanism(name)
    values = {leg.name: {"k": gain} for leg in mechanism.legs}
    if not 1e-12 <= gain <= 1e12:
        with pytest.raises(pincal.MechanismError, match=r"leg_1.*gain"):
            mechanism.with_parameters(values)
        return
    mechanism = mechanism.with_parameters(values)
    home = np.array([mechanism.platform.home])
    poses = around(mechanism, home[0], 0.1)
    truth = mechanism.with_parameters(
        {leg.name: leg.nominal * (1.0 + 1e-4) for leg in mechanism.legs}
    )
    readings = pincal.inverse(truth, poses).readings
    found = pincal.forward(mechanism, pincal.inverse(mechanism, home).readings)
    np.testing.assert_allclose(found.poses, home, atol=1e-9)
    noise = Noise(position=1e-5, orientation=1e-5)
    result = pincal.calibrate(mechanism, Measurements(poses, readings=readings), noise=noise)
    for leg in result.legs:
        k = {p.name: p.identified for p in leg.parameters}["k"]
        assert k == pytest.approx(truth.leg(leg.name).nominal_by_name["k"], rel=1e-8)


# Scale


@pytest.mark.parametrize(
    "name",
    some_slow(["5R", "delta", "3RRR", "3PRR", "6UPS"], "delta", "3RRR", "3PRR", "6UPS"),
)
@pytest.mark.parametrize("factor", [1e-9, 1e6])
def test_a_mechanism_of_any_size_is_the_same(name: str, factor: float, tmp_path: Path) -> None:
    """Of a nanometre or a thousand kilometres: the same angles, margins, poses, standard errors."""
    usual = pincal.load_mechanism(name)
    large, factors = scaled(usual, factor)
    poses = poses_near_home(usual, 40, 0, 0.2)
    truth = pincal.disturb(usual, 1e-3, 1)
    results, places = [], []
    for mechanism, true, f in (
        (usual, truth, np.ones(len(factors))),
        (large, scaled(truth, factor)[0], factors),
    ):
        size = f[0]
        there, own = poses * f, pincal.inverse(mechanism, poses * f).readings
        found = pincal.forward(mechanism, own)
        places.append(
            (
                pincal.margins(mechanism, there).type2,
                in_workspace(mechanism, there),
                np.where(found.converged[:, None], found.poses / f, 0.0),
                pincal.sample_workspace(mechanism, 50, seed=0) / f,
                len(pincal.symmetry_group(mechanism).elements),
            )
        )
        slides = mechanism.reading_units[0] == "m"
        noise = Noise(1e-5 * size, 1e-5, 1e-6 * (size if slides else 1.0))
        data = Measurements(there, readings=pincal.inverse(true, there).readings)
        result = pincal.calibrate(mechanism, data, noise=noise)
        assert result.converged
        results.append(
            [
                (np.array([p.identified, p.std]) / (size if p.unit == "m" else 1.0), p.std)
                for leg in result.legs
                for p in leg.parameters
            ]
        )
    for first, second in zip(*places, strict=True):
        np.testing.assert_allclose(second, first, rtol=1e-9, atol=1e-12)
    for (first, std), (second, _) in zip(*results, strict=True):
        np.testing.assert_allclose(second, first, rtol=0.0, atol=1e-5 * std)
    assert pincal.load_mechanism(large.save(tmp_path / "m")) == large


# Angles across half a turn


@pytest.mark.parametrize("kind", ["planar", "spatial"])
def test_orientations_across_half_a_turn_are_neighbours(kind: str) -> None:
    """Poses on both sides of ±π, measured as they are written, are calibrated like any other."""
    home = (0.1, 0.2, np.pi) if kind == "planar" else (0.1, 0.2, 0.3, np.pi, 0.4, np.pi)
    platform, rng = Platform(kind, home), np.random.default_rng(3)
    families = KINDS[kind][1]
    legs = tuple(random_leg(f"leg_{i}", families[i % 3], platform, rng) for i in range(6))
    mechanism = Mechanism("turned", platform, legs[: platform.dof])
    poses = poses_near_home(mechanism, 40, 0, 0.35)
    truth = pincal.disturb(mechanism, 1e-3, 1)
    angles = [i for i, unit in enumerate(platform.units) if unit == "rad"]
    some = poses.copy()  # the same, every second one written with another turn
    some[::2, angles] += 2 * np.pi * np.where(np.array(platform.units)[angles] == "rad", 1, 0)
    readings = pincal.inverse(truth, poses).readings
    np.testing.assert_allclose(pincal.inverse(truth, some).readings, readings, atol=1e-12)
    wrapped = platform.coordinates_of(platform.transforms(poses))
    assert wrapped[:, angles[0]].min() < -3.0 < 3.0 < wrapped[:, angles[0]].max()
    for given in (poses, wrapped):
        result = pincal.calibrate(mechanism, Measurements(given, readings=readings), noise=NOISE)
        assert result.converged
        for leg in result.legs:
            found = [p.identified for p in leg.parameters]
            std = np.array([p.std for p in leg.parameters])
            assert (np.abs(found - truth.leg(leg.name).nominal) < 1e-4 * std).all()
    found = pincal.forward(mechanism, pincal.inverse(mechanism, poses).readings, poses)
    np.testing.assert_allclose(platform.twists_between(poses, found.poses), 0.0, atol=1e-10)
    exact = np.array([home, home, home])
    exact[:, angles[0]] = np.pi, -np.pi, np.nextafter(np.pi, 4.0)
    readings = pincal.inverse(mechanism, exact).readings
    np.testing.assert_allclose(readings, readings[[0, 0, 0]], atol=1e-12)


def test_drives_across_half_a_turn_do_not_jump() -> None:
    """A drive at home near π is read on both sides of it without a jump."""
    platform, rng = Platform("planar", (0.0, 0.0, 0.0)), np.random.default_rng(0)
    legs = []
    while len(legs) < 3:
        leg = random_leg(f"leg_{len(legs)}", KINDS["planar"][1][0], platform, rng)
        if abs(leg.home[0]) > 2.95:
            legs.append(leg)
    mechanism = Mechanism("turned", platform, tuple(legs))
    ways = np.linspace(-0.25, 0.25, 400)[:, None] * np.array([[0.6, 0.8, 0.3]])
    there = pincal.inverse(mechanism, ways)
    ways = ways[there.reached.all(axis=1)]
    assert len(ways) > 200
    there = pincal.inverse(mechanism, ways)
    drives = np.stack([there.joints[leg.name][:, 0] for leg in legs], axis=1)
    assert (np.abs(drives).max(axis=0) > np.pi).any()
    assert np.abs(np.diff(drives, axis=0)).max() < 0.05


# Data that tell little


@pytest.mark.parametrize("name", slow_or_fuzz(["5R", "3RRR"], ["6UPS"]))
def test_nearly_deficient_data_are_refused_or_honest(name: str) -> None:
    """Poses ever more alike: errors within ten standard errors, not converged, or refused.

    Intervals are of first order: where little is told, six standard errors were seen.
    """
    mechanism, refused = pincal.load_mechanism(name), []
    truth = pincal.disturb(mechanism, 1e-4, 2)
    home = np.array(mechanism.platform.home)
    rng = np.random.default_rng(0)
    for size in (0.2, 3e-2, 1e-2, 1e-3, 1e-4, 1e-6, 1e-9, 1e-12, 0.0):
        poses = around(mechanism, home, size)
        poses = poses[pincal.inverse(truth, poses).reached.all(axis=1)]
        readings = pincal.inverse(truth, poses).readings
        readings += 1e-6 * rng.standard_normal(readings.shape)
        measured = mechanism.platform.moved(poses, 1e-5 * rng.standard_normal(poses.shape))
        try:
            result = pincal.calibrate(
                mechanism, Measurements(measured, readings=readings), noise=NOISE, strict=True
            )
        except pincal.ObservabilityError as error:
            refused.append(size)
            assert "leg_" in str(error)  # noqa: PT017
            continue
        assert result.converged or size < 1e-2, result.message
        for leg in result.legs if result.converged else ():
            error = np.array([p.identified for p in leg.parameters]) - truth.leg(leg.name).nominal
            assert (np.abs(error) < 10.0 * np.array([p.std for p in leg.parameters])).all(), size
    assert 0.2 not in refused
    assert {1e-6, 1e-9, 1e-12, 0.0} <= set(refused)


@pytest.mark.parametrize("name", ["5R", "3RRR", "6UPS", "3RPS"])
def test_one_pose_and_none(name: str) -> None:
    """One pose has kinematics, and tells no parameters; no pose gives empty answers."""
    mechanism = pincal.load_mechanism(name)
    home = np.array([mechanism.platform.home])
    readings = pincal.inverse(mechanism, home).readings
    if np.isfinite(readings).all():
        found = pincal.forward(mechanism, readings)
        np.testing.assert_allclose(found.poses, home, atol=1e-9)
    for method in ("per-leg", "all-legs"):
        asked = {"noise": NOISE, "method": method, "strict": True}
        with pytest.raises((pincal.ObservabilityError, pincal.MeasurementError)):
            pincal.calibrate(mechanism, Measurements(home, readings=readings), **asked)
    with pytest.raises(pincal.ObservabilityError):
        pincal.select_poses(mechanism, home, 12, "independent")
    none = home[:0]
    assert pincal.inverse(mechanism, none).readings.shape == (0, len(mechanism.reading_names))
    assert pincal.forward(mechanism, readings[:0]).poses.shape == none.shape
    assert pincal.margins(mechanism, none).type2.shape == (0,)
    assert in_workspace(mechanism, none).shape == (0,)
    for method in ("per-leg", "all-legs"):
        with pytest.raises((pincal.ObservabilityError, pincal.MeasurementError)):
            pincal.calibrate(
                mechanism, Measurements(none, readings=readings[:0]), noise=NOISE, method=method
            )
    with pytest.raises((pincal.ObservabilityError, pincal.MeasurementError)):
        pincal.select_poses(mechanism, none, 12, "independent")


@pytest.mark.parametrize("kind", KINDS)
def test_all_candidates_may_be_chosen(kind: str) -> None:
    """As many poses as there are candidates are all of them, each once."""
    mechanism = random_mechanism(kind, KINDS[kind][0][0], 5)
    poses = poses_near_home(mechanism, 16, 0, 0.4)
    plan = pincal.select_poses(mechanism, poses, 16, "independent", starts=2).plan
    for leg in mechanism.legs:
        own = plan.poses[plan.serves(leg.name)]
        np.testing.assert_array_equal(np.unique(own, axis=0), np.unique(poses, axis=0))


def test_orbits_of_candidates_that_are_images_are_chosen_once() -> None:
    """Candidates with their own images among them: no pose of the plan comes twice."""
    mechanism = pincal.load_mechanism("3RRR")
    first = workspace("3RRR", 40)
    elements = pincal.symmetry_group(mechanism).elements
    images = np.concatenate([e.poses(mechanism.platform, first) for e in elements])
    plan = pincal.select_poses(mechanism, images, 20, "orbits", starts=2).plan
    apart = np.abs(plan.poses[:, None] - plan.poses[None]).max(axis=2) + np.eye(len(plan.poses))
    assert len(plan.poses) == 60
    assert apart.min() > 1e-6


@pytest.mark.parametrize("count", slow_or_fuzz([30_000], [1_000_000]))
def test_very_many_rows(count: int, tmp_path: Path) -> None:
    """Written, read, solved both ways and calibrated: the same as few rows, only better."""
    mechanism, rng = pincal.load_mechanism("3RRR"), np.random.default_rng(0)
    truth = pincal.disturb(mechanism, 1e-3, 1)
    poses = rng.uniform(-0.2, 0.2, (count, 3))
    there = pincal.inverse(truth, poses)
    assert there.reached.all()
    found = pincal.forward(truth, there.readings)
    assert found.converged.all()
    np.testing.assert_allclose(found.poses, poses, atol=1e-9)
    measured = poses + 1e-5 * rng.standard_normal(poses.shape)
    data = Measurements(measured, readings=there.readings)
    data.to_csv(tmp_path / "many.csv", mechanism)
    again = pincal.Measurements.from_csv(tmp_path / "many.csv", mechanism)
    np.testing.assert_array_equal(again.poses, data.poses)
    np.testing.assert_array_equal(again.readings, data.readings)
    result = pincal.calibrate(mechanism, again, noise=Noise(1e-5, 1e-5, 0.0))
    assert result.converged
    assert result.reduced_chi2 == pytest.approx(1.0, abs=0.01)
    few = pincal.forecast(truth, poses[:10_000], Noise(1e-5, 1e-5, 0.0)).std
    few = few * np.sqrt(10_000 / count)
    bounds = np.split(few, len(result.legs))
    for leg, bound in zip(result.legs, bounds, strict=True):
        error = np.array([p.identified for p in leg.parameters]) - truth.leg(leg.name).nominal
        std = np.array([p.std for p in leg.parameters])
        assert (np.abs(error) < 5.0 * std).all()
        assert (std > 0.95 * bound).all()
        assert (std < 1.2 * bound).all()


@pytest.mark.parametrize("protocol", ["independent", "symmetric", "orbits", "common"])
@pytest.mark.parametrize("name", some_slow(["3RRR", "6UPS"], "6UPS"))
def test_one_pose_said_in_several_ways_is_chosen_once(name: str, protocol: Any) -> None:
    """Candidates again a whole turn on, with the tilt reversed, and off in the last digit."""
    mechanism = pincal.load_mechanism(name)
    first = workspace(name, 60)
    turned, near = first.copy(), first + 1e-14
    turned[:, -1] += 2 * np.pi
    if name == "6UPS":
        turned[:, 3:5] = np.column_stack((turned[:, 3] + np.pi, -turned[:, 4]))
    poses = np.concatenate((first, turned, near, near))
    plan = pincal.select_poses(mechanism, poses, 12, protocol, starts=2).plan
    matrices = mechanism.platform.transforms(plan.poses).as_matrix().reshape(len(plan.poses), -1)
    same = np.abs(matrices[:, None] - matrices[None]).max(axis=2) < 1e-9
    sets = np.array(plan.sets)
    assert not (np.triu(same, 1) & (sets[:, None] == sets[None])).any()
    if protocol in ("symmetric", "common"):
        alone = pincal.select_poses(mechanism, first, 12, protocol, starts=2)
        np.testing.assert_array_equal(plan.poses, alone.plan.poses)


@pytest.mark.parametrize("sigma", [-1.0, 1e-300, 1e-60, 1e13, np.inf, np.nan])
def test_noise_that_no_arithmetic_bears_is_refused(sigma: float) -> None:
    """Standard deviations whose squares underflow, or beyond all lengths, are refused by value."""
    for name in ("position", "orientation", "reading"):
        with pytest.raises(pincal.MeasurementError, match=f"noise of {name} is"):
            Noise(**{name: sigma})


def test_noise_of_rows_that_no_arithmetic_bears_is_refused() -> None:
    """A standard deviation of a row whose square underflows is refused by its row."""
    mechanism = pincal.load_mechanism("5R")
    poses = workspace("5R", 24)
    sigmas = np.full(poses.shape, 1e-5)
    sigmas[6, 1] = 1e-200
    data = Measurements(
        poses, readings=pincal.inverse(mechanism, poses).readings, sigma_poses=sigmas
    )
    for method in ("per-leg", "all-legs"):
        with pytest.raises(pincal.MeasurementError, match="data row 7: a standard deviation is"):
            pincal.calibrate(mechanism, data, method=method)


@pytest.mark.parametrize("method", ["per-leg", "all-legs"])
@pytest.mark.parametrize("noise", [Noise(1e-50, 1e-50), Noise(1e-5, 1e-5, 1e-50), Noise(1e4, 1e4)])
def test_noise_at_its_limits_is_borne(noise: Noise, method: Any) -> None:
    """The least standard deviations have an answer, huge ones an error that says why."""
    mechanism = pincal.load_mechanism("5R")
    poses = workspace("5R", 24)
    data = pincal.simulate(mechanism, mechanism, pincal.Plan(poses), Noise(1e-6, 1e-6)).measurements
    if noise.position > 1.0:
        with pytest.raises(pincal.MeasurementError, match="more than 2 % of a leg's length"):
            pincal.calibrate(mechanism, data, noise=noise, method=method)
        return
    result = pincal.calibrate(mechanism, data, noise=noise, method=method)
    assert np.isfinite(result.reduced_chi2)
    assert np.isfinite(result.covariance).all()


@pytest.mark.parametrize("name", ["3RRR", "3RPS"])
def test_one_configuration_said_in_several_ways_is_chosen_once(name: str) -> None:
    """For all parameters together too, of mechanisms told by poses or by readings."""
    mechanism = pincal.load_mechanism(name)
    first = pincal.sample_configurations(mechanism, 60, seed=1)
    turned = first.poses.copy()
    turned[:, -1] += 2 * np.pi
    poses = np.concatenate((first.poses, turned))
    readings = None if first.readings is None else np.tile(first.readings, (2, 1))
    chosen = pincal.select_configurations(
        mechanism, pincal.Plan(poses, readings=readings), 24, starts=2
    )
    matrices = mechanism.platform.transforms(chosen.plan.poses).as_matrix()
    apart = np.abs(matrices[:, None] - matrices[None]).max(axis=(2, 3)) + np.eye(24)
    assert apart.min() > 1e-9


def test_blas_has_its_threads_back() -> None:
    """Within, one thread; after the last that is within, or an error, what was there before."""
    from threadpoolctl import threadpool_info, threadpool_limits

    def threads() -> set[int]:
        return {one["num_threads"] for one in threadpool_info() if one["user_api"] == "blas"}

    def within(_: int) -> None:
        pincal.inverse("5R", [[0.0, 0.3]])
        assert threads() == {1}
        raise ValueError

    with threadpool_limits(2, user_api="blas"):
        before = threads()
        with pytest.raises(ValueError):
            pincal.sample_workspace("5R", 3, progress=within)
        assert threads() == before


def test_numbers_beyond_all_machines_are_refused() -> None:
    """Counts so coarse that their sizes overflow are refused."""
    sensor = pincal.load_mechanism("5R").legs[0].sensors[0]
    with pytest.raises(pincal.MechanismError, match="counts_per_unit"):
        replace(sensor, counts_per_unit=1e-320)
    with pytest.raises(pincal.MechanismError, match=r"pose 2 .* above 1e\+12"):
        pincal.inverse("5R", [[0.0, 1.1], [1e300, 0.0]])
