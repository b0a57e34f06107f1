"""Families of mechanisms against their closed forms: kinematics, identification, symmetry."""

from __future__ import annotations

import runpy
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from family_forms import FAMILIES, Family, joints, nominal, poses_around_home, random_geometry
from moved import equivariance
from numpy.typing import NDArray

import pincal
from pincal import Joint, Leg, Placement
from pincal.estimation.observability.identifiable import identifiability
from pincal.files.mechanism_folders import bundled
from pincal.kinematics.closed_forms import closed_form
from pincal.kinematics.closure import LegClosure
from pincal.model.placement import Coordinate
from pincal.workspace.criteria import in_workspace

Array = NDArray[np.float64]
ROBOTS = Path(__file__).parents[1] / "robots"
NAMES = [family.name for family in FAMILIES]
EXACT = pincal.Noise(0.0, 0.0, 0.0)
GEOMETRIES = 20


@cache
def definition(name: str) -> dict[str, object]:
    """Return what a robot's Python file defines."""
    return runpy.run_path(str(ROBOTS / f"{name}.py"))


def carriers(name: str) -> list[Array]:
    """Return the matrices of the elements that carry leg 1 to each leg."""
    found = definition(name)
    return [element.matrix for element in found.get("LEGS", found["GROUP"])]


@cache
def poses_of(name: str, count: int = 60) -> Array:
    """Return poses around home that count, shape (count, dof)."""
    mechanism = nominal(name)
    size = 0.6 if name == "8cable" else 0.1
    poses = poses_around_home(mechanism, np.random.default_rng(0), 20 * count, size)
    return poses[in_workspace(mechanism, poses)][:count]


SLOW = ("6RUS", "6PUS")


@pytest.mark.parametrize(
    ("family", "mode"),
    [
        pytest.param(
            family, mode, marks=[pytest.mark.slow] if family.name in SLOW or mode < 0 else []
        )
        for family in FAMILIES
        for mode in family.modes
    ],
    ids=lambda value: value.name if isinstance(value, Family) else str(value),
)
def test_inverse_kinematics_equals_the_closed_form(family: Family, mode: int) -> None:
    """On 20 random geometries joints are within 1e-11 of the closed form, in either mode."""
    rng, group, told = np.random.default_rng(mode + 1), carriers(family.name), 0
    for _ in range(GEOMETRIES):
        mechanism = random_geometry(family, group, rng, mode)
        poses = poses_around_home(mechanism, rng, 20)
        solution = pincal.inverse(mechanism, poses)
        expected = joints(family, mechanism, group, poses, mode)
        others = joints(family, mechanism, group, poses, -mode)
        for index, leg in enumerate(mechanism.legs):
            reference, (drive,) = expected[index], leg.active
            found, reached = solution.joints[leg.name], solution.reached[:, index]
            in_reach = np.isfinite(reference).all(axis=1)
            apart = np.abs(reference[:, drive] - others[index][:, drive])
            clear = in_reach if len(family.modes) == 1 else apart > 0.1  # from where modes meet
            assert not reached[~in_reach].any()
            assert reached[clear].all()
            off = found[clear] - reference[clear]
            turns = [joint.kind == "revolute" for joint in leg.moving]
            off[:, turns] = (off[:, turns] + np.pi) % (2 * np.pi) - np.pi
            assert np.abs(off).max(initial=0.0) < 1e-11
            p, law = leg.nominal_by_name, leg.sensors[0]
            read = (reference[clear, drive] - p.get("gamma", 0.0)) / p.get("k", 1.0)
            if law.joint == "drive" and "gamma" in p:  # [rad]
                read += 2 * np.pi * np.round((solution.readings[clear, index] - read) / 2 / np.pi)
            np.testing.assert_allclose(solution.readings[clear, index], read, rtol=0, atol=1e-11)
            told += int(clear.sum())
    assert told > 0.5 * GEOMETRIES * 20 * len(group)


@pytest.mark.slow
def test_cables_read_changes_of_length() -> None:
    """On 20 random geometries readings are k (‖r + R b − A‖ − that at home) within 1e-11 m."""
    rng, bundled = np.random.default_rng(0), nominal("8cable")
    for _ in range(GEOMETRIES):
        values = {leg.name: leg.nominal + rng.uniform(-0.2, 0.2, 7) for leg in bundled.legs}
        robot = bundled.with_parameters(values)
        poses = poses_around_home(robot, rng, 20, 0.6)
        readings = pincal.inverse(robot, poses).readings
        with_home = np.concatenate((poses, [robot.platform.home]))
        T = robot.platform.transforms(with_home).as_matrix()
        for column, leg in zip(readings.T, robot.legs, strict=True):
            A, b, k = leg.nominal[:3], leg.nominal[3:6], leg.nominal[6]
            lengths = np.linalg.norm(T[:, :3, 3] + T[:, :3, :3] @ b - A, axis=1)
            np.testing.assert_allclose(column, k * (lengths[:-1] - lengths[-1]), atol=1e-11)


@pytest.mark.parametrize("name", [*NAMES, "8cable"])
def test_clean_measurements_give_all_parameters(name: str) -> None:
    """Each leg alone, 60 exact poses give every parameter within 1e-9."""
    mechanism = nominal(name)
    truth = pincal.disturb(mechanism, 2e-3, seed=1)
    data = pincal.simulate(mechanism, truth, pincal.Plan(poses_of(name).copy()), EXACT).measurements
    noise = pincal.Noise(1e-4, 1e-4, 1e-5)
    result = pincal.calibrate(mechanism, data, noise=noise, method="per-leg")
    assert result.converged
    for leg in truth.legs:
        found = result.identified.leg(leg.name).nominal
        np.testing.assert_allclose(found, leg.nominal, rtol=0.0, atol=1e-9)


def moved(joint: str, kind: str, name: str) -> Callable[[Leg], Leg]:
    """Return a change that adds a coordinate, zero so far, to a joint's placement."""

    def change(leg: Leg) -> Leg:
        values = {**leg.nominal_by_name, name: 0.0}

        def placed_so(one: Joint) -> Joint:
            coordinates = (*one.placement.coordinates, Coordinate(kind, (name,)))
            rest = one.placement.rest(values, leg.name)
            at = replace(one.placement, coordinates=coordinates).at(values, rest)
            return replace(one, placement=at) if one.name == joint else one

        joints = tuple(placed_so(one) for one in leg.joints)
        return replace(leg, joints=joints, parameters=tuple(values.items()))

    return change


def read_from(name: str) -> Callable[[Leg], Leg]:
    """Return a change that adds an offset of the sensor."""

    def change(leg: Leg) -> Leg:
        sensors = (replace(leg.sensors[0], offset=name),)
        return replace(leg, sensors=sensors, parameters=(*leg.parameters, (name, 0.0)))

    return change


def platform_radius(leg: Leg) -> Leg:
    """Return a delta's leg whose platform point is sought in radius and azimuth."""
    values = leg.nominal_by_name | {"ob": 0.06, "beta_b": leg.nominal_by_name["beta"]}
    point = replace(leg.point, placement=Placement.of(values, polar=("ob", "beta_b")))
    return replace(leg, point=point, parameters=tuple(values.items()))


REDUNDANT = {
    "the platform's radius and azimuth in a delta": ("delta", platform_radius, "ob|beta_b"),
    "an offset along a strut": ("3RPR", moved("tip", "x", "e"), "gamma|e"),
    "a carriage's zero in the plane": ("3PRR", read_from("gamma"), "gamma"),
    "a carriage's zero in space": ("3PUU", read_from("gamma"), "gamma"),
    "the zero of an upright carriage": ("6PUS", read_from("gamma"), "gamma"),
    "a turn about a crank's own axis": ("6RUS", moved("drive", "ry", "pitch"), "pitch"),
    "the height of a pulley": ("8cable", moved("universal_x", "z", "e"), "A_z|e"),
}


@pytest.mark.parametrize("case", REDUNDANT)
def test_what_cannot_be_told_apart_is_named(case: str) -> None:
    """A parameter too many in leg 1 is refused by name; without it the leg is identified."""
    name, change, what = REDUNDANT[case]
    machine = nominal(name)
    mechanism = replace(machine, legs=(change(machine.legs[0]), *machine.legs[1:]))
    plan = pincal.Plan(poses_of(name).copy())
    data = pincal.simulate(mechanism, mechanism, plan, EXACT).measurements
    with pytest.raises(pincal.ObservabilityError, match=rf"leg_1(?s:.*)({what})"):
        pincal.calibrate(mechanism, data, method="per-leg")
    C = pincal.identification_jacobian(mechanism, "leg_1", plan.poses)
    found = identifiability(C, mechanism.legs[0].parameter_names)
    assert found.rank == len(machine.legs[0].parameters)
    assert all(any(part in group for group in found.groups) for part in what.split("|"))


@pytest.mark.parametrize("name", [*NAMES, "8cable"])
def test_the_symmetry_found_is_that_of_the_definition(name: str) -> None:
    """The detected group is the generating one, and readings follow it (Eq. 5).

    3RPR has mirrors as well: its base and its platform are triangles turned against each other, so
    that the mirrors of the two are at other azimuths.
    """
    group = pincal.symmetry_group(nominal(name))
    expected = definition(name)["GROUP"]
    assert len(group.elements) == (6 if name == "3RPR" else len(expected))
    assert all(any(e.equals(one) for one in group.elements) for e in expected)
    assert equivariance(group, poses_of(name)) < 1e-11


def test_cable_robots_of_any_number_of_posts() -> None:
    """Two cables a post, the group D_2n; three posts give as many cables as freedoms."""
    posts = 3
    robot = definition("8cable")["mechanism"](posts)
    assert len(robot.legs) == 2 * posts
    assert pincal.symmetry_group(robot).name == f"D{2 * posts}"
    home = np.array([robot.platform.home])
    readings = pincal.inverse(robot, home + 0.02).readings
    np.testing.assert_allclose(pincal.forward(robot, readings, home).poses, home + 0.02, atol=1e-9)


def test_a_family_is_a_leg_and_a_group_in_under_60_lines() -> None:
    """The active wrist takes one file under 60 lines that uses pincal's public names only."""
    text = (ROBOTS / "6PUS.py").read_text()
    assert len(text.splitlines()) < 60
    imports = [line for line in text.splitlines() if line.startswith(("import", "from"))]
    assert {line.split()[1] for line in imports} == {"math", "pathlib", "pincal"}


@pytest.mark.parametrize("name", NAMES)
def test_reach_bars_nothing_that_a_leg_reaches(name: str) -> None:
    """What the shell of a driven rod or a strut excludes, the closed form does not reach."""
    mechanism = nominal(name)
    rng = np.random.default_rng(2)
    size = 1.5 * LegClosure(mechanism.legs[0], mechanism.platform).size
    poses = poses_around_home(mechanism, rng, 4000, size)
    matrices = mechanism.platform.transforms(poses).as_matrix()
    solution = pincal.inverse(mechanism, poses)
    for index, leg in enumerate(mechanism.legs):
        closure = LegClosure(leg, mechanism.platform)
        assert closed_form(closure) is not None
        q = solution.joints[leg.name]
        bounds = np.array([(j.lower, j.upper) for j in leg.moving if j.limited])
        limited = [i for i, joint in enumerate(leg.moving) if joint.limited]
        with np.errstate(invalid="ignore"):
            within = solution.reached[:, index] & (
                (q[:, limited] >= bounds[:, 0]) & (q[:, limited] <= bounds[:, 1])
            ).all(axis=1)
        inside = closed_form(closure).reach().holds(matrices)
        assert within.any()
        assert not inside.all()
        assert not (within & ~inside).any()


@pytest.mark.slow
def test_the_table_of_the_page_of_mechanisms_is_as_it_comes_now() -> None:
    """``python docs/mechanisms.py`` makes the table that is there."""
    docs = ROBOTS.parent / "docs"
    page = (docs / "mechanisms.md").read_text()
    assert runpy.run_path(str(docs / "mechanisms.py"))["written"](page) == page


def test_the_page_of_mechanisms_says_what_they_are() -> None:
    """Each mechanism has its section and picture."""
    page = (ROBOTS.parent / "docs" / "mechanisms.md").read_text()
    for name in bundled():
        assert f"\n## {name}\n\n![{name}](images/{name}.svg)\n" in page
