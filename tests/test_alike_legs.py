"""Legs of one form, evaluated in one call: what each alone demands, whatever its parameters."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from marks import some_slow
from measured import workspace

import pincal
from pincal.calibration.calibration import Calibration
from pincal.estimation.unknowns import State
from pincal.kinematics.batches import CHUNK
from pincal.kinematics.closing import by_leg, close, close_legs, grouped
from pincal.kinematics.closure import LegClosure
from pincal.kinematics.derivatives import leg_demands_at

FORMS = {"5R": 1, "3RRR": 1, "3RPR": 1, "3PRR": 2, "6UPS": 1, "6RUS": 1, "8cable": 1, "delta": 1}
"""How many forms the legs of a machine have: those of the 3-PRR slide to either side."""


@pytest.mark.parametrize("name", some_slow(FORMS, "3RRR", "3RPR", "6RUS", "8cable", "delta"))
def test_alike_legs_demand_what_each_alone_does(name: str) -> None:
    """Values, derivatives and joints; at noisy readings of another one."""
    robot = pincal.load_mechanism(name)
    truth, poses = pincal.disturb(robot, 2e-3, seed=4), workspace(name, 7)
    noise = pincal.Noise(1e-3, 1e-3, 1e-3)
    data = pincal.simulate(robot, truth, pincal.Plan(poses), noise, 5).measurements
    calibration, rows = Calibration(robot, data), np.arange(len(data))
    values = [leg.nominal for leg in pincal.disturb(robot, 1e-3, seed=6).legs]
    matrices = robot.platform.transforms(data.poses).as_matrix()
    groups: dict[object, list[int]] = {}
    for place, leg in enumerate(robot.legs):
        groups.setdefault(LegClosure(leg, robot.platform).form, []).append(place)
    assert len(groups) == FORMS[name]
    for places in groups.values():
        block = calibration.leg_block(places, rows)
        parameters = np.concatenate([values[place] for place in places])
        together = block.evaluate(State(parameters, matrices))
        for index, place in enumerate(places):
            alone = calibration.leg_block([place], rows).evaluate(State(values[place], matrices))
            of_leg, columns, readings = (
                sizes[index] for sizes in (block.leg_rows, block.columns, block.reading_columns)
            )
            parts = {
                "value": together.value[:, of_leg],
                "by_pose": together.by_pose[:, of_leg],
                "by_parameter": together.by_parameter[:, of_leg, columns],
                "by_measured": together.by_measured[:, of_leg, readings],
            }
            for part, values_of_leg in parts.items():
                wanted = getattr(alone, part)
                largest = np.abs(wanted).max()
                # the search ends where passive joints are right to 1e-8, and values to its square
                atol = 1e-14 if part == "value" else 1e-7 * largest
                np.testing.assert_allclose(
                    values_of_leg,
                    wanted,
                    rtol=0.0,
                    atol=atol,
                    err_msg=part,
                )
            np.testing.assert_allclose(together.joints[index], alone.joints[0], rtol=0.0, atol=1e-7)


def test_no_rows_demand_nothing() -> None:
    """Legs that are asked at no pose answer with no rows."""
    robot = pincal.load_mechanism("3RRR")
    data = pincal.Measurements(np.zeros((1, 3)), readings=np.zeros((1, 3)))
    calibration = Calibration(robot, data)
    nominal = np.concatenate([leg.nominal for leg in robot.legs])
    block = calibration.leg_block(range(3), np.arange(0))
    rows = block.evaluate(State(nominal, np.empty((0, 4, 4))))
    assert rows.value.shape == (0, 3)


def test_each_leg_is_measured_by_its_own_size() -> None:
    """Beside a leg a hundred times as long, one that does not reach comes as near as it does alone.

    How far is far, when steps are worked out with curvature, is a matter of the leg's own size.
    """
    plain = pincal.load_mechanism("3RRR")
    robot = plain.with_parameters({f"leg_1.{name}": 150.0 for name in ("l", "L")})
    rng = np.random.default_rng(1)
    poses = rng.uniform(-4.0, 4.0, (20, 3))
    data = pincal.Measurements(poses, readings=rng.uniform(-1.0, 1.0, (20, 3)))
    calibration, rows = Calibration(plain, data), np.arange(20)
    legs = (robot.legs[0], plain.legs[1])
    forms = [LegClosure(leg, plain.platform).form for leg in legs]
    assert forms[0] == forms[1]
    values = [leg.nominal for leg in legs]
    matrices = robot.platform.transforms(poses).as_matrix()
    start = tuple(rng.uniform(-3.0, 3.0, (20, 2)) for _ in legs)
    block = replace(calibration.leg_block(range(2), rows), legs=legs)
    together = block.evaluate(State(np.concatenate(values), matrices, start))
    alone = calibration.leg_block([1], rows).evaluate(State(values[1], matrices, start[1:]))
    value, expected = together.value[:, 1:], alone.value
    np.testing.assert_allclose(value, expected, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(together.joints[1], alone.joints[0], rtol=0.0, atol=1e-6)


@pytest.mark.parametrize("name", some_slow(FORMS, "3RPR", "6RUS", "8cable", "delta"))
def test_alike_legs_close_as_each_alone_does(name: str) -> None:
    """Joints, reach and derivatives; also where some legs reach a pose and others do not."""
    robot = pincal.load_mechanism(name)
    rng, size = np.random.default_rng(8), max(leg.size for leg in robot.legs)
    near = workspace(name, 20)
    shift = np.where(np.array(robot.platform.units) == "m", 0.4 * size, 0.3)
    poses = np.concatenate((near, near + shift * rng.standard_normal(near.shape)))
    matrices = robot.platform.matrices(poses)
    legs = [LegClosure(leg, robot.platform) for leg in pincal.disturb(robot, 1e-3, seed=6).legs]
    closed = close_legs(legs, matrices)
    assert len(closed) == FORMS[name]
    reached = np.stack(by_leg(closed, lambda one: one.reached), axis=1)
    slides = any(joint.kind == "prismatic" for joint in robot.legs[0].moving[1:])  # reach far
    assert reached.any()
    assert slides or not reached.all()
    joints = by_leg(closed, lambda one: one.joints)
    rows = by_leg(closed, lambda one: one.closure.constraint_by_parameter)
    for index, leg in enumerate(legs):
        alone = close((leg,), matrices)
        np.testing.assert_array_equal(reached[:, index], alone.reached)
        np.testing.assert_allclose(joints[index], alone.joints, rtol=0.0, atol=1e-12)
        own = alone.closure.constraint_by_parameter[alone.reached]
        largest = np.abs(own).max(initial=0.0)
        there = rows[index][alone.reached]
        np.testing.assert_allclose(there, own, rtol=0.0, atol=1e-11 * largest)


def test_legs_demand_at_poses_of_their_own() -> None:
    """As many of each or not, in one chunk or several: what each demands when it is asked alone."""
    robot = pincal.load_mechanism("3RRR")
    legs = [LegClosure(leg, robot.platform) for leg in robot.legs]
    every = robot.platform.matrices(workspace("3RRR", 60, 2))
    many = np.tile(every, (CHUNK // len(every) + 1, 1, 1))
    for placed in ([every[:5], every[5:10], every[10:15]], [every[:9], every[9:13], many]):
        found = leg_demands_at(legs, placed)
        for leg, own, one in zip(legs, placed, found, strict=True):
            (alone,) = leg_demands_at((leg,), (own,))
            for part, values in one._asdict().items():
                assert len(values) == len(own)
                wanted = getattr(alone, part)
                np.testing.assert_allclose(values, wanted, rtol=0.0, atol=1e-13, err_msg=part)


def test_legs_that_deform_are_like_no_other() -> None:
    """Not even an equal one: their influences differ."""
    plain = pincal.load_mechanism("3RRR")
    term = pincal.Term("grown", pincal.Share(10.0, 20.0), of="temperature")
    legs = (
        replace(leg, terms=(("L", term),), parameters=(*leg.parameters, ("grown", 0.0)))
        for leg in plain.legs
    )
    robot = replace(plain, legs=tuple(legs))
    forms = [LegClosure(robot.legs[0], robot.platform).form for _ in range(2)]
    assert grouped(forms, 1) == [[0], [1]]
    forms = [LegClosure(leg, robot.platform).form for leg in robot.legs]
    assert grouped(forms, 1) == [[0], [1], [2]]
