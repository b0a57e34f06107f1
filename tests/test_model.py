"""What people hold: parameters by id, objects that check what they are made of, tables."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import done
from scipy.spatial.transform import Rotation

import pincal
from pincal import MeasurementError, MechanismError
from pincal.files.columns import reading_columns, write_plan
from pincal.files.measurements import read_measurements, read_poses, read_readings
from pincal.files.mechanism_folders import as_mechanism, bundled

THREE = pincal.load_mechanism("3RRR")
POSES, READINGS = np.zeros((4, 3)), np.ones((4, 3))


def test_parameters_are_found_by_place_and_by_id() -> None:
    """In order, by id, with units; values are the legs' nominal values one after the other."""
    found = THREE.parameters
    assert found.ids[:2] == ("leg_1.l", "leg_1.L")
    assert found["leg_2.l"] == pincal.Parameter("leg_2", "l", "m", THREE.leg("leg_2").nominal[0])
    assert found["leg_1.beta"].unit == "rad"
    assert "leg_3.l" in found
    assert "leg_4.l" not in found
    assert found[0] in found
    assert len(found[:8]) == 8
    np.testing.assert_array_equal(found.values, np.concatenate(list(THREE.nominal.values())))
    assert not found.values.flags.writeable


def test_parameters_are_set_by_id() -> None:
    """By id, by leg and name, or by leg and all in order is the same; the rest stays."""
    by_id = THREE.with_parameters({"leg_1.l": 0.7, "leg_3.k": 1.1, "leg_1.ob": 0.5})
    assert by_id == THREE.with_parameters({"leg_1": {"l": 0.7, "ob": 0.5}, "leg_3": {"k": 1.1}})
    assert by_id.parameters["leg_1.l"].nominal == 0.7
    mixed = THREE.with_parameters({"leg_1.l": 0.7, "leg_1": {"ob": 0.5}, "leg_3": {"k": 1.1}})
    assert mixed == by_id
    assert by_id.with_parameters(THREE.nominal) == THREE


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"leg_1.ll": 1.0}, r"no parameter 'leg_1.ll'; did you mean 'leg_1.l'"),
        ({"l": 1.0}, r"no parameter 'l'; did you mean 'leg_1.l' or 'leg_2.l' or 'leg_3.l'\?"),
        ({"wholly other.thing": 1.0}, r"no parameter 'wholly other.thing'; ids are leg_1.l, "),
        ({"leg_9": [1.0]}, r"unknown leg of '3RRR': 'leg_9'"),
        ({"leg_1": {"q": 1.0}}, r"leg_1 has no parameter 'q'"),
        ({"leg_1": [1.0]}, r"leg_1: expected shape \(8,\); got shape \(1,\)"),
        ({"leg_1": 1.0}, r"leg_1: expected shape \(8,\); got shape \(\)"),
        ({"leg_1.l": "long"}, r"leg_1.l: expected a number; got 'long'"),
        ({"leg_1.l": float("nan")}, r"leg_1: a nominal parameter is not a finite number"),
        ([1.0, 2.0], r"parameters: expected a Mapping; got \[1.0, 2.0\]"),
    ],
)
def test_wrong_parameters_are_refused(values: object, said: str) -> None:
    """The message names what was given and what may be meant."""
    with pytest.raises(MechanismError, match=said):
        THREE.with_parameters(values)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"poses": np.zeros(3)}, r"poses: expected shape \(N, dof\); got shape \(3,\)"),
        (
            {"poses": "poses.csv"},
            r"poses: expected numbers, an array of shape \(N, dof\); got 'poses.csv'",
        ),
        ({"poses": None}, r"poses: expected numbers, an array of shape \(N, dof\); got None"),
        (
            {"poses": [[1, 2, 3], [4, 5]]},
            r"poses: expected numbers, .* got \[\[1, 2, 3\], \[4, 5\]\]",
        ),
        ({"poses": np.zeros((4, 3), complex)}, r"poses: expected numbers, .* type complex128"),
        ({"readings": np.ones((3, 3))}, r"readings: expected shape \(4, n_readings\); got .*3, 3"),
        (
            {"readings": None},
            r"readings: expected numbers, an array of shape \(N, n_readings\); got None",
        ),
        ({"sigma_poses": 1e-4}, r"sigma_poses: expected shape \(4, 3\); got shape \(\)"),
        ({"sigma_readings": np.ones((4, 2))}, r"sigma_readings: .* \(4, 3\); got shape \(4, 2\)"),
        ({"sets": "all"}, r"sets: expected 4 names, one a row; got 'all'"),
        ({"sets": ["all"]}, r"sets: expected 4 names, one a row; got 1"),
        ({"runs": [1, 2, 3, 4]}, r"runs: expected names; got 1 among them"),
        ({"extra": {"wire": np.ones(3)}}, r"extra 'wire': expected shape \(4,\); got shape \(3,\)"),
        ({"extra": [1.0]}, r"extra: expected a Mapping; got \[1.0\]"),
    ],
)
def test_measurements_say_what_they_expect(change: dict[str, object], said: str) -> None:
    """Wrong types and shapes are refused with both, where the object is made."""
    with pytest.raises(MeasurementError, match=said):
        pincal.Measurements(**{"poses": POSES, "readings": READINGS} | change)


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: pincal.Noise("1e-4"), "noise of position: expected a number; got '1e-4'"),
        (lambda: pincal.Noise(-1.0), "noise of position is -1.0; expected a standard deviation"),
        (
            lambda: pincal.Target("x"),
            r"offset of a target: expected numbers, an array of shape \(3,\)",
        ),
        (lambda: pincal.Target((1.0, 2.0)), r"offset of a target: .* \(3,\); got shape \(2,\)"),
        (
            lambda: pincal.Setup(targets=[]),
            r"targets of Setup: expected Mapping\[str, Target\]; got \[\]",
        ),
        (
            lambda: pincal.Setup(targets={"a": (0, 0, 0)}),
            r"targets of Setup: .* Target\]; got {'a': \(0, 0, 0\)}",
        ),
        (lambda: pincal.Setup("frame"), "unknown_frame of Setup: expected bool; got 'frame'"),
        (
            lambda: pincal.Setup(distances={"w": 3}),
            r"distances of Setup: .* Distance\]; got {'w': 3}",
        ),
    ],
)
def test_noise_and_setup_say_what_they_expect(make: object, said: str) -> None:
    """Wrong types are refused where the object is made."""
    with pytest.raises(MeasurementError, match=said):
        make()


def test_numbers_of_numpy_and_series_of_any_kind_are_taken() -> None:
    """Switches and numbers of NumPy, arrays without axes, and instruments from a generator."""
    assert pincal.Options(rough=np.bool_(True)).rough
    assert pincal.Sensor("a", gain=np.array(2.0), direction=np.int64(-1)).direction == -1
    assert pincal.Lens(np.array([640, 480]), np.array(600.0)).size == (640, 480)
    assert pincal.Setup(instruments=(camera for camera in ())).instruments == ()


def test_arrays_are_float64_and_copies() -> None:
    """Lists and integers become arrays of the object's own, which SciPy takes."""
    own = POSES.copy()
    data = pincal.Measurements(own, list("abcd"), readings=READINGS.astype(int).tolist())
    assert data.readings.dtype == data.poses.dtype == np.float64
    assert data.sets == ("a", "b", "c", "d")
    assert Rotation.identity().apply(data.poses).shape == (4, 3)
    again = replace(data)
    own[0, 0] = data.readings[0, 0] = 5.0
    assert data.poses[0, 0] == 0.0
    assert again.readings[0, 0] != 5.0
    assert len(data) == len(pincal.Plan(own)) == 4


def measured(kind: str) -> tuple[pincal.Mechanism, pincal.Measurements]:
    """Return a mechanism and numbers of any meaning for all that its measurements may hold."""
    mechanism, rng = pincal.load_mechanism(kind), np.random.default_rng(0)
    shapes = (5, mechanism.platform.dof), (5, len(mechanism.reading_names))
    poses, readings = map(rng.random, shapes)
    return mechanism, pincal.Measurements(
        poses,
        readings=readings,
        sets=("all", "leg_1", "leg_2", "all", ""),
        sigma_poses=1e-4 * poses,
        sigma_readings=1e-5 * readings,
        extra={"wire": rng.random(5)},
        sigma_extra={"wire": rng.random(5)},
        runs=("a", "a", "b", "b", "b"),
        places=("1", "2", "3", "4", "5"),
    )


@pytest.mark.parametrize("kind", ["5R", "3RRR", "6UPS"])
def test_tables_hold_measurements_and_plans(kind: str, tmp_path: Path) -> None:
    """A CSV file that is written has units in its headers, and is read to the same bits."""
    mechanism, data = measured(kind)
    setup = pincal.Setup(distances={"wire": pincal.Distance((0.0, 0.0, 1.0))})
    data.to_csv(tmp_path / "m.csv", mechanism)
    heads = (tmp_path / "m.csv").read_text().splitlines()[0].split(",")
    assert {"x [m]", "sigma_leg_1 [rad]", "wire [m]", "run"} - set(heads) <= (
        {"sigma_leg_1 [rad]"} if kind == "6UPS" else set()
    )
    read = pincal.Measurements.from_csv(tmp_path / "m.csv", mechanism, setup)
    np.testing.assert_array_equal(read.readings, data.readings)
    read.to_csv(tmp_path / "again.csv", mechanism)
    assert (tmp_path / "again.csv").read_text() == (tmp_path / "m.csv").read_text()
    plan = pincal.Plan.from_csv(tmp_path / "m.csv", mechanism)
    plan.to_csv(tmp_path / "p.csv", mechanism)
    np.testing.assert_array_equal(
        pincal.Plan.from_csv(tmp_path / "p.csv", mechanism).poses, plan.poses
    )
    with pytest.raises(MeasurementError, match=r"poses of '.*': expected shape \(N, \d\); got"):
        data.to_csv(tmp_path / "o.csv", pincal.load_mechanism("3RRR" if kind == "5R" else "5R"))


def test_replace_checks_too() -> None:
    """Changed copies are made by ``dataclasses.replace``, with the same checks."""
    data = pincal.Measurements(POSES, readings=READINGS)
    assert replace(data, poses=POSES + 1.0).poses[0, 0] == 1.0
    with pytest.raises(MeasurementError, match="poses"):
        replace(data, poses=3.0)


FREEDOMS = [
    ("x",),
    ("x", "y"),
    ("x", "y", "rx"),
    ("x", "y", "z", "rz"),
    ("x", "y", "z", "ry"),
    ("rx", "ry", "rz"),
    ("x", "rx", "ry", "rz"),
    ("x", "y", "z", "rx", "ry", "rz"),
]


@pytest.mark.parametrize("freedoms", FREEDOMS, ids="".join)
def test_coordinates_of_any_kind_are_its_poses(freedoms: tuple[str, ...]) -> None:
    """To transforms and back; a small twist moves a pose along its own freedoms and no others."""
    platform = pincal.Platform("own", (0.0,) * len(freedoms), freedoms)
    rng = np.random.default_rng(0)
    poses = rng.uniform(0.1, 1.0, (50, platform.dof))
    np.testing.assert_allclose(platform.coordinates_of(platform.transforms(poses)), poses)
    twists = 1e-6 * rng.standard_normal(poses.shape)
    moved = platform.moved(poses, twists)
    np.testing.assert_allclose(platform.twists_between(poses, moved), twists, atol=1e-11)
    a, b = (platform.transforms(p).as_matrix() for p in (poses, moved))
    full = np.zeros((50, 6))
    full[:, list(platform.twist_rows)] = twists
    turn = ((b - a)[:, :3, :3] @ a[:, :3, :3].transpose(0, 2, 1))[:, [2, 0, 1], [1, 2, 0]]
    np.testing.assert_allclose((b - a)[:, :3, 3], full[:, :3], atol=1e-15)
    np.testing.assert_allclose(turn, full[:, 3:], atol=1e-11)
    assert len(platform.units) == len(platform.bounds) == len(platform.freedoms) == platform.dof


@pytest.mark.parametrize(
    ("freedoms", "said"),
    [
        (("x", "rx", "ry"), "turns about two axes include turns about the third"),
        (("x", "z"), "moves along x, along x and y, or along x, y and z"),
        (("rz", "x"), "expected some of x, y, z, rx, ry, rz, in this order"),
        (("x", "x"), "expected some of"),
        ("xyz", "expected 3 names, one a row; got 'xyz'"),
        ((1, 2), "expected names; got 1"),
        (3, "freedoms of a 'own' platform: expected a Sequence; got 3"),
    ],
)
def test_kinds_that_cannot_be_are_refused(freedoms: object, said: str) -> None:
    """The message says which freedoms go together."""
    with pytest.raises(MechanismError, match=said):
        pincal.Platform("own", (0.0,), freedoms)
    with pytest.raises(MechanismError, match="unknown platform kind 'own'; expected one of point"):
        pincal.Platform("own", (0.0,))
    with pytest.raises(MechanismError, match="the kind 'planar' has other freedoms"):
        pincal.Platform("planar", (0.0,), ("x",))
    with pytest.raises(MechanismError, match="a platform's kind: expected a str"):
        pincal.Platform(3, (0.0,))


def four_cranks() -> pincal.Mechanism:
    """Return the mechanism of the example, whose platform kind pincal does not have."""
    path = Path(__file__).parents[1] / "examples" / "12_platform_kind.py"
    space: dict[str, pincal.Mechanism] = {}
    exec(path.read_text().partition("print(robot)")[0], space)
    return space["robot"]


def test_a_kind_of_ones_own_is_identified_and_kept(tmp_path: Path) -> None:
    """Saved and loaded alike, and found to 1e-9 without noise."""
    robot = four_cranks()
    assert pincal.load_mechanism(robot.save(tmp_path / "own")) == robot
    low, high = np.array([[-0.1, -0.1, -0.52, -0.3], [0.1, 0.1, -0.4, 0.3]])
    plan = pincal.Plan(np.random.default_rng(0).uniform(low, high, (40, 4)))
    truth = pincal.disturb(robot, 1e-3, seed=1)
    data = pincal.simulate(robot, truth, plan, pincal.Noise(0.0, 0.0, 0.0)).measurements
    data.to_csv(tmp_path / "m.csv", robot)
    again = pincal.Measurements.from_csv(tmp_path / "m.csv", robot)
    result = pincal.calibrate(robot, again, noise=pincal.Noise(1e-5, 1e-5, 0.0))
    found = result.identified.parameters.values
    np.testing.assert_allclose(found, truth.parameters.values, atol=1e-9)


def wrist() -> pincal.Mechanism:
    """Return three struts that turn a platform about the base's origin."""
    legs = []
    for number, turn in enumerate(2 * np.pi / 3 * np.arange(3), start=1):
        foot = np.array([0.2 * np.cos(turn), 0.2 * np.sin(turn), -0.3])
        end = np.array([0.15 * np.cos(turn + 0.5), 0.15 * np.sin(turn + 0.5), 0.05])
        x, y, z = rod = end - foot
        length, values = float(np.linalg.norm(rod)), {"A_x": float(foot[0]), "gamma": 0.0}
        placed = pincal.Placement.of(values, x="A_x", y=float(foot[1]), z=float(foot[2]))
        joints = (
            pincal.Joint("ux", "revolute", placed, (1.0, 0.0, 0.0), home=float(np.arctan2(-y, z))),
            pincal.Joint("uy", "revolute", axis=(0.0, 1.0, 0.0), home=float(np.arcsin(x / length))),
            pincal.Joint("slide", "prismatic", lower=0.1, upper=1.0, home=length),
            pincal.Joint("tip", "fixed"),
        )
        point = pincal.Joint(f"b_{number}", "fixed", pincal.Placement((), tuple(end.tolist())))
        sensor = pincal.Sensor("slide", offset="gamma")
        legs.append(pincal.Leg(f"leg_{number}", joints, (sensor,), tuple(values.items()), point))
    platform = pincal.Platform("wrist", (0.0, 0.0, 0.0), ("rx", "ry", "rz"))
    return pincal.Mechanism("wrist", platform, tuple(legs))


def test_a_platform_that_only_turns_is_calibrated(tmp_path: Path) -> None:
    """Found to 1e-9 without noise; the verdict is in angles, and there is no position in it."""
    robot = wrist()
    rng = np.random.default_rng(0)
    plan = pincal.Plan(rng.uniform((-3.0, 0.0, -0.3), (3.0, 0.3, 0.3), (30, 3)))
    truth = pincal.disturb(robot, 1e-3, seed=1)
    data = pincal.simulate(robot, truth, plan, pincal.Noise(0.0, 0.0, 0.0)).measurements
    noise = pincal.Noise(0.0, 1e-4, 1e-5)
    found = pincal.calibrate(robot, data, noise=noise).identified.parameters.values
    np.testing.assert_allclose(found, truth.parameters.values, atol=1e-9)
    robot.save(tmp_path / "wrist")
    noisy = pincal.simulate(robot, truth, plan, noise).measurements
    noisy.to_csv(tmp_path / "m.csv", robot)
    options = ("--noise-orientation", 1e-4, "--noise-reading", 1e-5, "--no-report")
    told = done("calibrate", tmp_path / "wrist", tmp_path / "m.csv", *options, "-o", tmp_path / "r")
    assert re.search(r"wrist: [\d.]+ → [\d.]+ mrad", told.out + told.err)


@pytest.mark.parametrize(
    "call",
    [
        lambda: pincal.load_mechanism(3),
        lambda: pincal.load_mechanism(None),
        lambda: pincal.Mechanism.from_urdf(3, "tool"),
        lambda: pincal.Measurements.from_csv(None, THREE),
        lambda: pincal.Measurements.from_csv("m.csv", 3),
        lambda: pincal.Plan.from_csv([1.0], THREE),
        lambda: pincal.Plan.from_csv("p.csv", None),
        lambda: read_readings(3, THREE),
        lambda: pincal.Setup.from_yaml(None),
        lambda: write_plan(POSES, "m.csv", THREE),
        lambda: write_plan(pincal.Plan(POSES), "m.csv", None),
        lambda: write_plan(pincal.Plan(POSES), "p.csv", 3),
        lambda: write_plan(pincal.Plan(POSES), None, THREE),
        lambda: reading_columns(THREE, None),
        lambda: reading_columns(3, READINGS),
        lambda: THREE.save(None),
        lambda: as_mechanism(3.0),
        lambda: read_poses("3RRR".split, THREE),
        lambda: read_measurements(None, THREE),
        lambda: read_measurements(POSES, THREE),
        lambda: pincal.forecast(THREE, POSES, setup={"frame": "unknown"}),
    ],
)
def test_wrong_types_at_the_door_are_named(call: Callable[[], object]) -> None:
    """A PincalError says what was expected and what was got."""
    with pytest.raises(pincal.PincalError, match=r"expected .*; got |expected .* got "):
        call()


def test_what_is_handed_over_is_taken_in_every_form(tmp_path: Path) -> None:
    """A mechanism by name or folder, a plan as poses or transforms, measurements as a table."""
    assert as_mechanism("3RRR") == as_mechanism(bundled()["3RRR"]) == as_mechanism(THREE)
    mechanism, data = measured("3RRR")
    data.to_csv(tmp_path / "m.csv", mechanism)
    for given in (data, str(tmp_path / "m.csv"), tmp_path / "m.csv"):
        read = read_measurements(given, mechanism)
        np.testing.assert_array_equal(read.readings, data.readings)
        np.testing.assert_array_equal(read_poses(given, mechanism).poses, data.poses)
    transforms = mechanism.platform.transforms(data.poses)
    np.testing.assert_allclose(read_poses(transforms, mechanism).poses, data.poses)
    np.testing.assert_array_equal(read_poses(data.poses.tolist(), mechanism).poses, data.poses)
    with pytest.raises(MeasurementError, match=r"poses of '5R': expected shape \(N, 2\); got"):
        read_measurements(data, pincal.load_mechanism("5R"))


@pytest.mark.parametrize("kind", [*bundled()])
def test_what_people_hold_shows_itself_on_a_line(kind: str) -> None:
    """Reprs are one line under 120 characters, a mechanism printed is a page."""
    mechanism = pincal.load_mechanism(kind)
    legs = mechanism.legs
    joints = [joint for leg in legs for joint in (*leg.joints, leg.point)]
    held = [mechanism, mechanism.platform, mechanism.parameters, *legs, *joints]
    held += [joint.placement for joint in joints] + [one for leg in legs for one in leg.sensors]
    poses, readings = np.full((9, mechanism.platform.dof), np.nan), np.zeros((9, len(legs)))
    wires = {f"w{i}": range(9) for i in range(99)}
    data = pincal.Measurements(poses, readings=readings, extra=wires)
    targets = {f"target_{i}": pincal.Target((0.1, 0.0, 0.0), True) for i in range(30)}
    held += [data, pincal.Plan(poses), pincal.Noise(), pincal.Setup(True, targets)]
    for one in held:
        assert len(repr(one)) < 120, repr(one)
        assert "\n" not in repr(one)
    lines = str(mechanism).splitlines()
    assert len(lines) <= 60
    assert max(map(len, lines)) <= 120
    for name in legs[0].parameter_names:
        assert any(name in line.split() for line in lines)


ROBOT = pincal.load_mechanism("8cable")
LENS = pincal.Lens((640, 480))
POINTS = {"a": (0.0, 0.0, 0.0)}


@pytest.mark.parametrize(
    "make",
    [
        lambda odd: replace(ROBOT, platform=odd),
        lambda odd: replace(ROBOT, legs=(odd,)),
        lambda odd: replace(ROBOT.legs[0], joints=odd),
        lambda odd: replace(ROBOT.legs[0], parameters=odd),
        lambda odd: replace(ROBOT.legs[0].sensors[0], counts_per_unit=odd),
        lambda odd: pincal.Harmonic(1.0, odd),
        lambda odd: pincal.Contact(POINTS, shape=odd),
        lambda odd: pincal.Camera("camera", LENS, odd),
        lambda odd: pincal.Lens((640, 480), distortion=odd),
        lambda odd: pincal.Options(rough=odd),
        lambda odd: pincal.Options(terms=(odd,)),
        lambda odd: pincal.Setup(contacts={"c": odd}),
        lambda odd: pincal.generate("name", odd, pincal.cyclic(3), ROBOT.platform),
        lambda odd: pincal.over_pulley(ROBOT.legs[0], 0.03, axis=odd),
        lambda odd: pincal.deploy("5R", "folder", units=odd),
        lambda odd: pincal.free_of_collision(odd, ["joint"], np.zeros((1, 1))),
        lambda odd: pincal.Mechanism.from_urdf("arm.urdf", odd),
        lambda odd: pincal.sample_workspace("5R", 3, least=odd),
        lambda odd: pincal.select("5R", distances=odd),
        lambda odd: pincal.load_result(odd),
    ],
)
@pytest.mark.parametrize("odd", [object(), ROBOT, np.zeros((2, 3)), [[]], {1: 2}, float("inf")])
def test_arguments_of_a_wrong_kind_are_refused_where_they_are_given(
    make: Callable[[object], object], odd: object
) -> None:
    """Classes and functions say what they expect of an argument and what they got, in words."""
    with pytest.raises(pincal.PincalError) as refused:
        make(odd)
    assert len(str(refused.value)) < 400
