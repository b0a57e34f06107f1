"""Plausibility of measurements: every fault is named, healthy measurements pass in silence."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from itertools import product
from typing import Any

import numpy as np
import pytest
from marks import quick
from measured import check_plausible, put
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import pincal
from pincal.calibration.calibration import Calibration
from pincal.calibration.hypotheses import plausibility
from pincal.calibration.hypotheses.judging import Case
from pincal.estimation.noise import check_noise
from pincal.kinematics.closing import close
from pincal.kinematics.closure import LegClosure
from pincal.model.platform import columns_of, rotation_of
from pincal.workspace.criteria import in_workspace

Array = NDArray[np.float64]
Fault = Callable[[pincal.Mechanism, pincal.Measurements], pincal.Measurements]
EVERY = ["5R", "3RRR", "6UPS"]
TURNING = ["3RRR", "6UPS"]
DEGREE = np.pi / 180
BOXES = {
    "5R": ([-0.9, 0.6], [0.9, 1.6]),
    "3RRR": ([-0.5, -0.35, -0.3], [0.5, 0.5, 0.6]),
    "6UPS": ([-0.6, -0.6, 1.5, -np.pi, 0.0, -0.6], [0.6, 0.6, 2.0, np.pi, 0.6, 0.6]),
}


@cache
def nominal(kind: str) -> pincal.Mechanism:
    """Return a bundled mechanism."""
    return pincal.load_mechanism(kind)


@cache
def workspace(kind: str) -> Array:
    """Return poses of the workspace, in a box around home."""
    poses = np.random.default_rng(0).uniform(*BOXES[kind], (2000, len(BOXES[kind][0])))
    return poses[in_workspace(nominal(kind), poses)]


def measured(
    kind: str, seed: int, disturbance: float = 2e-3, noise: float = 1e-4, count: int = 36
) -> pincal.Measurements:
    """Return healthy measurements of a disturbed mechanism."""
    mechanism = nominal(kind)
    rng = np.random.default_rng(seed)
    poses = rng.choice(workspace(kind), count, replace=False)
    readings = pincal.inverse(pincal.disturb(mechanism, disturbance, rng), poses).readings
    reached = np.isfinite(readings).all(axis=1)
    seen = mechanism.platform.moved(poses, noise * rng.standard_normal(poses.shape))
    return pincal.Measurements(seen[reached], readings=readings[reached])


def scaled(length: float = 1.0, angle: float = 1.0, *readings: float) -> Fault:
    """Return what scales positions, orientations, and the readings of all legs or of each."""

    def fault(mechanism: pincal.Mechanism, data: pincal.Measurements) -> pincal.Measurements:
        by = [length if unit == "m" else angle for unit in mechanism.platform.units]
        factors = np.array(readings or (1.0,))
        return replace(data, poses=data.poses * by, readings=data.readings * factors)

    return fault


def seen(position: Array, turn: Callable[[Array], Array]) -> Fault:
    """Return what maps positions and rotation matrices."""

    def fault(mechanism: pincal.Mechanism, data: pincal.Measurements) -> pincal.Measurements:
        matrices = mechanism.platform.transforms(data.poses).as_matrix().copy()
        matrices[:, :3, 3] = matrices[:, :3, 3] @ position.T
        matrices[:, :3, :3] = turn(matrices[:, :3, :3])
        return replace(data, poses=mechanism.platform.from_matrices(matrices))

    return fault


def mirrored(*rows: list[float]) -> Fault:
    """Return what gives poses in a left-handed frame."""
    Q = np.array(rows)
    return seen(Q, lambda R: Q @ R @ Q.T)


def base_in_platform(mechanism: pincal.Mechanism, data: pincal.Measurements) -> pincal.Measurements:
    """Return measurements whose poses are inverted."""
    inverted = mechanism.platform.transforms(data.poses).inv().as_matrix()
    return replace(data, poses=mechanism.platform.from_matrices(inverted))


def angles(way: str, *order: int) -> Fault:
    """Return what writes the columns of orientations in another order."""

    def fault(mechanism: pincal.Mechanism, data: pincal.Measurements) -> pincal.Measurements:
        matrices = mechanism.platform.transforms(data.poses).as_matrix()
        right = columns_of(way, Rotation.from_matrix(matrices[:, :3, :3]))
        turns = rotation_of(way, right[:, order]).as_matrix()
        return replace(seen(np.eye(3), lambda _: turns)(mechanism, data), written=way)

    return fault


def roll_pitch_yaw(mechanism: pincal.Mechanism, data: pincal.Measurements) -> pincal.Measurements:
    """Return measurements whose roll, pitch and yaw were taken for a rotation vector."""
    right = Rotation.from_matrix(mechanism.platform.matrices(data.poses)[:, :3, :3])
    turns = rotation_of("rotation-vector", right.as_euler("xyz")).as_matrix()
    return replace(seen(np.eye(3), lambda _: turns)(mechanism, data), written="rotation-vector")


def column(index: int, factor: float) -> Fault:
    """Return what scales the readings of one leg."""

    def fault(_: pincal.Mechanism, data: pincal.Measurements) -> pincal.Measurements:
        readings = data.readings.copy()
        readings[:, index] *= factor
        return replace(data, readings=readings)

    return fault


def order(*columns: int) -> Fault:
    """Return what puts the first columns of readings in another order."""

    def fault(_: pincal.Mechanism, data: pincal.Measurements) -> pincal.Measurements:
        rest = range(len(columns), data.readings.shape[1])
        return replace(data, readings=data.readings[:, [*columns, *rest]])

    return fault


LARGE, SMALL = "times too large)", "times too small)"
IN_MM = f"in mm under a metre header (1000 {LARGE}"
IN_M = f"in metres under a mm header (1000 {SMALL}"
IN_INCHES = f"in inches under a mm header (25.4 {SMALL}"
IN_DEGREES = f"in degrees under a radian header (57.3 {LARGE}"
IN_RADIANS = f"in radians under a degree header (57.3 {SMALL}"
X, Y, Z = "x has the opposite sign", "y has the opposite sign", "z has the opposite sign"
LEFT, RIGHT = ", as in a left-handed frame", " and the orientations are right"
SWAPPED = "legs are swapped: column leg_2 fits leg_1 and column leg_1 fits leg_2"
TURNED = [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]
#: For each fault: mechanisms, what makes it, and what must be named, all of it and nothing else.
FAULTS: dict[str, tuple[list[str], Fault, list[str]]] = {
    "positions-mm": (EVERY, scaled(1e3), [f"the positions are {IN_MM}"]),
    "positions-m": (EVERY, scaled(1e-3), [f"the positions are {IN_M}"]),
    "positions-in": (EVERY, scaled(1 / 25.4), [f"the positions are {IN_INCHES}"]),
    "orientations-deg": (TURNING, scaled(1.0, 1 / DEGREE), [f"the orientations are {IN_DEGREES}"]),
    "orientations-rad": (TURNING, scaled(1.0, DEGREE), [f"the orientations are {IN_RADIANS}"]),
    "readings-deg": (["5R", "3RRR"], scaled(1, 1, 1 / DEGREE), [f"the readings are {IN_DEGREES}"]),
    "readings-rad": (["5R", "3RRR"], scaled(1, 1, DEGREE), [f"the readings are {IN_RADIANS}"]),
    "readings-mm": (["6UPS"], scaled(1, 1, 1e3), [f"the readings are {IN_MM}"]),
    "readings-m": (["6UPS"], scaled(1, 1, 1e-3), [f"the readings are {IN_M}"]),
    "one-leg-deg": (
        ["5R", "3RRR"],
        column(1, 1 / DEGREE),
        [f"the readings of leg_2 are {IN_DEGREES}"],
    ),
    "one-leg-mm": (["6UPS"], column(4, 1e3), [f"the readings of leg_5 are {IN_MM}"]),
    "angles-deg": (
        ["3RRR"],
        scaled(1, 1 / DEGREE, 1 / DEGREE),
        [f"the orientations are {IN_DEGREES} and the readings are {IN_DEGREES}"],
    ),
    "lengths-mm": (
        ["6UPS"],
        scaled(1e3, 1, 1e3),
        [f"the positions are {IN_MM} and the readings are {IN_MM}"],
    ),
    "all-mm-deg": (
        ["6UPS"],
        scaled(1e3, 1 / DEGREE, 1e3),
        [
            f"the positions are {IN_MM} and the orientations are {IN_DEGREES} and the readings "
            f"are {IN_MM}"
        ],
    ),
    "sign-of-all": (EVERY, scaled(1, 1, -1), ["the readings have the opposite sign"]),
    "sign-of-leg-1": (EVERY, column(0, -1), ["the readings of leg_1 have the opposite sign"]),
    "sign-of-leg-2": (EVERY, column(1, -1), ["the readings of leg_2 have the opposite sign"]),
    # A symmetric machine cannot tell a mirrored frame from legs in mirrored order.
    "legs-1-2": (TURNING, order(1, 0), [SWAPPED]),
    "legs-1-2-5R": (["5R"], order(1, 0), [X + LEFT, SWAPPED]),
    "legs-cycle": (
        TURNING,
        order(1, 2, 0),
        [
            "legs are swapped: column leg_3 fits leg_1 and column leg_1 fits leg_2 and column "
            "leg_2 fits leg_3"
        ],
    ),
    "mirror-x": (TURNING, mirrored([-1, 0, 0], [0, 1, 0], [0, 0, 1]), [X + LEFT]),
    "mirror-x-5R": (["5R"], mirrored([-1, 0, 0], [0, 1, 0], [0, 0, 1]), [X + LEFT, SWAPPED]),
    "mirror-y": (["5R", "3RRR"], mirrored([1, 0, 0], [0, -1, 0], [0, 0, 1]), [Y + LEFT]),
    "mirror-y-6UPS": (
        ["6UPS"],
        mirrored([1, 0, 0], [0, -1, 0], [0, 0, 1]),
        [
            Y + LEFT,
            "legs are swapped: "
            + " and ".join(f"column leg_{7 - i} fits leg_{i}" for i in range(1, 7)),
        ],
    ),
    "mirror-z": (["6UPS"], mirrored([1, 0, 0], [0, 1, 0], [0, 0, -1]), [Z + LEFT]),
    "x-y-exchanged": (
        EVERY,
        mirrored([0, 1, 0], [1, 0, 0], [0, 0, 1]),
        ["x and y are swapped" + LEFT],
    ),
    "x-z-exchanged": (
        ["6UPS"],
        mirrored([0, 0, 1], [0, 1, 0], [1, 0, 0]),
        ["x and z are swapped" + LEFT],
    ),
    "only-y-z-exchanged": (
        ["6UPS"],
        seen(np.eye(3)[[0, 2, 1]], lambda R: R),
        ["y and z are swapped" + RIGHT],
    ),
    "yaw-roll": (["6UPS"], angles("zyx", 2, 1, 0), ["yaw and roll are swapped"]),
    "roll-pitch-yaw": (["6UPS"], roll_pitch_yaw, ["rx, ry, rz are roll, pitch, yaw"]),
    "scalar-last": (
        ["6UPS"],
        angles("quaternion", 1, 2, 3, 0),
        [
            "columns of the orientation are swapped: qw is in column qz, qx is in column qw, "
            "qy is in column qx, qz is in column qy"
        ],
    ),
    "scale-of-all": (EVERY, scaled(1, 1, 10), ["the readings are 10 times too large"]),
    "scale-of-one": (EVERY, column(1, 0.25), ["the readings of leg_2 are 4 times too small"]),
    "only-x": (TURNING, seen(np.array(TURNED), lambda R: R), [X + RIGHT]),
    "only-z": (["6UPS"], seen(np.diag([1.0, 1.0, -1.0]), lambda R: R), [Z + RIGHT]),
    "inverse-rotation": (
        TURNING,
        seen(np.eye(3), lambda R: R.transpose(0, 2, 1)),
        ["the orientations are inverted (those of the base in the platform's frame)"],
    ),
    "inverse-pose": (
        TURNING,
        base_in_platform,
        ["the poses are inverted (those of the base in the platform's frame)"],
    ),
}


def named(message: str) -> list[str]:
    """Return the suspects that a message names."""
    return message.partition(": corrected for that, ")[0].split(", or ")


#: A fault of each sort, tried in every run with the first of its mechanisms.
QUICK = {"readings-deg", "positions-in", "sign-of-leg-1", "legs-1-2", "mirror-x", "scalar-last"}
QUICK |= {"scale-of-one", "only-x", "inverse-rotation", "inverse-pose"}


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        pytest.param(
            name,
            kind,
            marks=[] if name in QUICK and kind == kinds[0] else [pytest.mark.slow],
        )
        for name, (kinds, *_) in FAULTS.items()
        for kind in kinds
    ],
)
def test_a_fault_is_named_and_nothing_else(name: str, kind: str) -> None:
    """Each fault alone raises and is named, with those that no measurement can tell from it."""
    _, fault, words = FAULTS[name]
    mechanism = nominal(kind)
    with pytest.raises(pincal.MeasurementError) as caught:
        check_plausible(mechanism, fault(mechanism, measured(kind, 3)))
    assert named(str(caught.value)) == words
    assert re.search(r"\d %.*\d %", str(caught.value))


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "count"), [("5R", 80), ("3RRR", 80), ("6UPS", 40)])
def test_healthy_measurements_pass(kind: str, count: int) -> None:
    """200 healthy sets of measurements in all, of machines 2e-3 and 5e-3 off, raise nothing."""
    mechanism = nominal(kind)
    for seed in range(count):
        check_plausible(mechanism, measured(kind, seed, (2e-3, 5e-3)[seed % 2], count=24))


def near_home(kind: str, seed: int, noise: float = 2e-5) -> pincal.Measurements:
    """Return healthy measurements within 30 mm and 30 mrad of home, of a machine 2e-3 off."""
    mechanism = nominal(kind)
    rng = np.random.default_rng(seed)
    home = np.tile(mechanism.platform.home, (72, 1))
    poses = mechanism.platform.moved(home, rng.uniform(-0.03, 0.03, home.shape))
    readings = pincal.inverse(pincal.disturb(mechanism, 2e-3, rng), poses).readings
    seen = mechanism.platform.moved(poses, noise * rng.standard_normal(poses.shape))
    return pincal.Measurements(seen, readings=readings)


def other_sign(index: int) -> Fault:
    """Return what changes the sign of one coordinate of the poses."""

    def fault(_: pincal.Mechanism, data: pincal.Measurements) -> pincal.Measurements:
        poses = data.poses.copy()
        poses[:, index] *= -1.0
        return replace(data, poses=poses)

    return fault


def late(rows: int) -> Fault:
    """Return what moves readings down by rows against their poses."""

    def fault(_: pincal.Mechanism, data: pincal.Measurements) -> pincal.Measurements:
        return replace(data, readings=np.roll(data.readings, rows, axis=0))

    return fault


BACKWARDS = "the orientations are inverted (those of the base in the platform's frame)"


#: Over the workspace those that FAULTS has not; near home these too.
ANYWHERE: list[tuple[str, Fault, str]] = [
    ("6UPS", other_sign(3), "azimuth has the opposite sign"),
    ("5R", late(1), "the readings are 1 row below their poses"),
    ("6UPS", other_sign(5), "torsion has the opposite sign"),
    ("3RRR", late(-1), "the readings are 1 row above their poses"),
    ("6UPS", late(2), "the readings are 2 rows below their poses"),
    ("6UPS", late(-2), "the readings are 2 rows above their poses"),
]
NEAR_HOME: list[tuple[str, Fault, str]] = [
    ("3RRR", other_sign(0), X + RIGHT),
    ("3RRR", order(1, 0), SWAPPED),
    ("6UPS", other_sign(0), X + RIGHT),
    ("6UPS", order(1, 0), SWAPPED),
    ("3RRR", other_sign(2), BACKWARDS),
    *ANYWHERE,
]


@pytest.mark.parametrize(
    ("data", "kind", "fault", "words"),
    quick(1, [(near_home, *case) for case in NEAR_HOME] + [(measured, *case) for case in ANYWHERE]),
)
def test_faults_are_named_however_short_the_motion(
    data: Callable[[str, int], pincal.Measurements], kind: str, fault: Fault, words: str
) -> None:
    """Over the workspace and within 30 mm of home, where faults leave gaps below 0.1 % of a leg."""
    with pytest.raises(pincal.MeasurementError) as caught:
        check_plausible(nominal(kind), fault(nominal(kind), data(kind, 4)))
    assert words in named(str(caught.value))
    assert len(named(str(caught.value))) <= 3


@pytest.mark.parametrize(
    ("noise", "kind"),
    quick(3, product([1e-4, 1e-3], EVERY)),
)
def test_healthy_measurements_near_home_pass(kind: str, noise: float) -> None:
    """Within 30 mm of home too, with noise up to a tenth of the motion."""
    for seed in range(4 if noise == 1e-3 else 10):  # more noise, more work
        check_plausible(nominal(kind), near_home(kind, seed, noise))


@pytest.mark.parametrize("legs", [[0], [0, 1]])
@pytest.mark.parametrize("kind", EVERY)
def test_readings_that_stand_still_are_named(kind: str, legs: list[int]) -> None:
    """A reading that is the same in all rows, over the workspace or near home: leg and value."""
    for data in (measured(kind, 4), near_home(kind, 4)):
        data = put(data, "readings", np.s_[:, legs], data.readings[0, legs])
        with pytest.raises(pincal.MeasurementError, match="reads the same in all rows") as caught:
            check_plausible(nominal(kind), data)
        assert str(caught.value).count("reads the same") == len(legs)
        assert f"{data.readings[0, 0]:.6g}" in str(caught.value)


@pytest.mark.parametrize("kind", EVERY)
def test_no_suspect_is_tried_where_the_gaps_are_small(
    kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Measurements of a machine 1e-3 off cost no search."""
    monkeypatch.delattr(plausibility, "_stages")
    check_plausible(nominal(kind), measured(kind, 0, 1e-3))


@pytest.mark.parametrize("legs", [(0,), (1,), (0, 1)])
@pytest.mark.parametrize("kind", quick(1, ["3RRR", "5R"]))
def test_a_home_bent_to_the_other_side_is_named(kind: str, legs: tuple[int, ...]) -> None:
    """A nominal mechanism with elbows bent the other way than the machine's: legs and elbow."""
    mechanism = nominal(kind)
    changed = list(mechanism.legs)
    for index in legs:
        leg = mechanism.legs[index].with_home(mechanism.legs[index].home * [1, -1])
        home = close(
            (LegClosure(leg, mechanism.platform),), mechanism.platform.home_pose.as_matrix()
        )
        changed[index] = leg.with_home(home.joints[0])
    wrong = replace(mechanism, legs=tuple(changed))
    with pytest.raises(pincal.MeasurementError, match="bend the other way than at home") as caught:
        check_plausible(wrong, measured(kind, 5))
    blamed = re.findall(r"(leg_\d) \(elbow, in (\d+) of (\d+) rows\)", str(caught.value))
    assert [name for name, *_ in blamed] == [mechanism.leg_names[i] for i in legs]
    assert all(int(bent) > 0.9 * int(rows) for _, bent, rows in blamed)


@pytest.mark.parametrize("kind", ["5R", "3RRR"])
def test_whole_turns_are_named(kind: str) -> None:
    """A reading that is a whole turn off raises, with its leg and row."""
    data = measured(kind, 18)
    data = put(data, "readings", np.s_[4, 1], data.readings[4, 1] + (2 * np.pi))
    with pytest.raises(
        pincal.MeasurementError, match=r"leg_2: 1 reading is .* first in data row 5"
    ):
        check_plausible(nominal(kind), data)


@pytest.mark.parametrize("kind", quick(1, EVERY))
def test_measurements_of_another_machine_are_refused(kind: str) -> None:
    """Readings that belong to other poses raise instead of fitting nonsense; nobody is blamed."""
    mechanism, data = nominal(kind), measured(kind, 15)
    random = np.random.default_rng(0).permutation(data.readings) + 0.3
    with pytest.raises(pincal.MeasurementError, match=r"no single fault .* Check these"):
        check_plausible(mechanism, replace(data, readings=random))


def test_legs_that_are_interchangeable_are_not_said_to_be_exchanged() -> None:
    """Of twin legs with the same readings, columns may come in any order; the fault is named."""
    mechanism = nominal("5R")
    twin = replace(mechanism.legs[1], name="leg_3")
    three = replace(mechanism, legs=(*mechanism.legs, twin))
    data = measured("5R", 6, noise=1e-3)
    twins = np.column_stack((data.readings, data.readings[:, 1] + 1e-4))[:, [0, 2, 1]]
    check_plausible(three, replace(data, readings=twins))
    with pytest.raises(pincal.MeasurementError) as caught:
        check_plausible(three, replace(data, readings=twins * [-1, 1, 1]))
    assert named(str(caught.value)) == ["the readings of leg_1 have the opposite sign"]


@pytest.mark.parametrize("kind", quick(1, EVERY))
def test_rows_not_measured_in_full_are_left_out(kind: str) -> None:
    """Partial poses and missing readings raise nothing and hide no fault; one whole row is none."""
    mechanism, data = nominal(kind), measured(kind, 7)
    data = put(data, "poses", np.s_[::3, 0], np.nan)
    data = put(data, "readings", np.s_[1::3, 0], np.nan)
    check_plausible(mechanism, data)
    wrong = replace(data, readings=-data.readings)
    with pytest.raises(pincal.MeasurementError, match=r"^the readings have the opposite sign"):
        check_plausible(mechanism, wrong)
    wrong = put(wrong, "poses", np.s_[2:, 1], np.nan)  # row 1 lacks its x already
    check_plausible(mechanism, wrong)


@pytest.mark.parametrize("kind", quick(1, EVERY))
def test_a_leg_without_readings_is_not_judged(kind: str) -> None:
    """Of a leg with one reading nothing is said, whatever is wrong with it or another leg."""
    mechanism, data = nominal(kind), measured(kind, 8)
    data = put(data, "readings", np.s_[1:, 0], np.nan)
    check_plausible(
        mechanism, replace(data, readings=data.readings * [-1, *[1] * (data.readings.shape[1] - 1)])
    )
    with pytest.raises(pincal.MeasurementError) as caught:
        check_plausible(mechanism, column(1, -1)(mechanism, data))
    assert named(str(caught.value)) == ["the readings of leg_2 have the opposite sign"]


@pytest.mark.parametrize("kind", EVERY)
def test_copied_rows_count_once(kind: str) -> None:
    """A row that is equal to another in all that was measured is named, and changes nothing."""
    mechanism, data, noise = nominal(kind), measured(kind, 9), pincal.Noise(1e-4, 1e-4)
    rows = [*range(len(data)), 6]
    copied = pincal.Measurements(data.poses[rows], readings=data.readings[rows])
    alone, result = (pincal.calibrate(mechanism, d, noise=noise) for d in (data, copied))
    (remark,) = (remark for remark in result.findings if remark.code == "rows-copied")
    assert remark.rows == (6, len(data))
    assert result.degrees_of_freedom == alone.degrees_of_freedom
    for leg, other in zip(alone.legs, result.legs, strict=True):
        np.testing.assert_allclose(other.std, leg.std, rtol=1e-9)


def copies(mechanism: pincal.Mechanism, data: pincal.Measurements) -> list[tuple[int, int]]:
    """Return pairs of equal rows."""
    return Calibration(mechanism, data).copies


def test_repeated_measurements_are_no_copies() -> None:
    """Equal readings with other poses, some of them equal by chance, are repeats.

    A point measured five times, written with a digit for its noise, comes out equal at times.
    """
    mechanism, data = nominal("5R"), measured("5R", 10, noise=0.0)
    poses, readings = (np.repeat(values, 5, axis=0) for values in (data.poses, data.readings))
    shaken = np.round(poses + 1e-4 * np.random.default_rng(0).standard_normal(poses.shape), 4)
    assert len(np.unique(shaken, axis=0)) < len(shaken)
    assert not copies(mechanism, pincal.Measurements(shaken, readings=readings))
    unseen = shaken.copy()
    unseen[1:] = np.nan  # photos that show no board: nothing is repeated there
    still = readings[:1].repeat(len(unseen), axis=0)
    assert not copies(mechanism, pincal.Measurements(unseen, readings=still))
    twice = np.repeat(np.arange(len(data)), 2)
    same = pincal.Measurements(data.poses[twice], readings=data.readings[twice])
    assert len(copies(mechanism, same)) == len(data)


@pytest.mark.parametrize(
    ("method", "poses", "counts"),
    [("per-leg", "own", False), ("per-leg", "all", True), ("all-legs", "own", True)],
)
def test_copies_for_several_legs_count_once(method: Any, poses: Any, counts: bool) -> None:
    """Rows copied to each leg's set are named where every row serves every leg, and count once.

    Twice, they would make standard errors √2 times too small.
    """
    mechanism, data, noise = nominal("5R"), measured("5R", 10), pincal.Noise(1e-4, 1e-4)
    rows = np.tile(np.arange(len(data)), 2)
    sets = tuple(np.repeat(mechanism.leg_names, len(data)))
    copied = pincal.Measurements(data.poses[rows], sets, readings=data.readings[rows])
    alone = pincal.calibrate(mechanism, data, noise=noise, method=method, poses=poses)
    both = pincal.calibrate(mechanism, copied, noise=noise, method=method, poses=poses)
    assert ("rows-copied" in {remark.code for remark in both.findings}) == counts
    for one, other in zip(alone.legs, both.legs, strict=True):
        np.testing.assert_allclose(one.std, other.std, rtol=1e-9)


@pytest.mark.parametrize("kind", EVERY)
def test_one_pose_measured_often_is_plausible(kind: str) -> None:
    """Readings that differ by noise only follow nothing, and need not: that is no fault."""
    data = measured(kind, 12)
    poses = np.repeat(data.poses[:1], 20, axis=0)
    shaken = poses + 1e-5 * np.random.default_rng(0).standard_normal(poses.shape)
    check_plausible(
        nominal(kind), pincal.Measurements(shaken, readings=np.repeat(data.readings[:1], 20, 0))
    )


@pytest.mark.parametrize("kind", EVERY)
def test_noise_in_the_wrong_unit_is_refused(kind: str) -> None:
    """Noise of 0.1 (meant as mm) raises and says that it is in metres; 2 degrees, in radians."""
    mechanism = nominal(kind)
    check_noise(mechanism, pincal.Noise(1e-3, 1e-3))
    with pytest.raises(pincal.MeasurementError, match="in metres"):
        check_noise(mechanism, pincal.Noise(0.1, 1e-4))
    if "rad" in mechanism.platform.units:
        with pytest.raises(pincal.MeasurementError, match="in radians"):
            check_noise(mechanism, pincal.Noise(1e-4, 2.0))


def test_calibration_asks_first() -> None:
    """A calibration raises before it fits, for measurements and for noise."""
    mechanism, data = nominal("3RRR"), measured("3RRR", 11)
    with pytest.raises(pincal.MeasurementError, match="noise given for the position"):
        pincal.calibrate(mechanism, data, noise=pincal.Noise(0.1, 1e-4))
    with pytest.raises(pincal.MeasurementError, match="the readings have the opposite sign"):
        pincal.calibrate(mechanism, replace(data, readings=-data.readings))


def test_readings_at_their_cut_are_sound() -> None:
    """A joint half a turn from home is read on either side: neither is a turn off."""
    mechanism, data = nominal("5R"), measured("5R", 3)
    leg = mechanism.legs[0]
    turned = data.readings.copy()
    turned[4, 0] += 2 * np.pi
    homes = float(turned[4, 0]) - np.pi  # home so that the reading is at the cut
    joints = tuple(
        replace(one, home=homes) if one.name == "shoulder" else one for one in leg.joints
    )
    near = replace(mechanism, legs=(replace(leg, joints=joints), *mechanism.legs[1:]))
    case = Case.of(near, replace(data, readings=turned), False, pincal.Target())
    assert plausibility._turns(case) == ()
    case = Case.of(mechanism, replace(data, readings=turned), False, pincal.Target())
    assert [one.code for one in plausibility._turns(case)] == ["whole-turns"]
