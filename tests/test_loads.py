"""Loads of joints by gravity: against Pinocchio, and against what energy says."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from arms import ARMS, loaded, urdf
from marks import quick
from measured import seen_from_elsewhere, workspace
from scipy.spatial.transform import Rotation

import pincal
from pincal import Load
from pincal.calibration.calibrate import prepared, started
from pincal.kinematics.configurations import home_of, planned_influences
from pincal.kinematics.influences import gravity_loads

PAYLOAD = Load(5.0, (0.02, 0.01, 0.07), (0.3, -1.0, -9.81))


def heavy(mechanism: pincal.Mechanism, seed: int = 0) -> pincal.Mechanism:
    """Return a mechanism whose links have masses of some kind, and whose platform does."""
    draw = np.random.default_rng(seed)

    def weighed(joint: pincal.Joint) -> pincal.Joint:
        centre = tuple(draw.uniform(-0.1, 0.1, 3).tolist())
        return replace(joint, mass=float(draw.uniform(0.2, 1.0)), centre=centre)

    legs = tuple(replace(leg, joints=tuple(map(weighed, leg.joints))) for leg in mechanism.legs)
    return replace(mechanism, legs=legs, load=PAYLOAD)


def energy(mechanism: pincal.Mechanism, readings: np.ndarray, guess: np.ndarray) -> np.ndarray:
    """Return the potential energy at readings, links placed one on the other, shape (N,) [J]."""
    solution = pincal.forward(mechanism, readings, guess)
    assert solution.converged.all()
    joints = pincal.inverse(mechanism, solution.poses).joints
    load, placed = mechanism.load, mechanism.platform.matrices(solution.poses)
    gravity = np.array(load.gravity)
    found = -load.mass * ((placed[:, :3, :3] @ load.centre + placed[:, :3, 3]) @ gravity)
    for leg in mechanism.legs:
        columns = iter(joints[leg.name].T)
        at = np.tile(np.eye(4), (len(readings), 1, 1))
        for joint in leg.joints:
            at = at @ joint.placement.origin()
            if joint.kind != "fixed":
                along = next(columns)[:, None] * np.array(joint.axis)
                move = np.tile(np.eye(4), (len(at), 1, 1))
                if joint.kind == "prismatic":
                    move[:, :3, 3] = along
                else:
                    move[:, :3, :3] = Rotation.from_rotvec(along).as_matrix()
                at = at @ move
            found -= joint.mass * ((at[:, :3, :3] @ joint.centre + at[:, :3, 3]) @ gravity)
    return found


@pytest.mark.parametrize("name", quick(2, ["3RRR", "3RPS", "delta", "5R", "3PRR", "6UPS"]))
def test_loads_are_what_the_height_loses_with_each_reading(name: str) -> None:
    machine = heavy(pincal.load_mechanism(name))
    if name == "3RPS":  # legs that guide the platform too
        readings = home_of(machine).readings + np.linspace(-0.02, 0.02, 12).reshape(4, 3)
        poses = pincal.forward(machine, readings).poses
    else:
        poses = workspace(name, 4)
        readings = pincal.inverse(machine, poses).readings
    signs = [s.direction for leg in machine.legs for s in leg.sensors]  # of readings over joints
    found = gravity_loads(machine, readings, machine.platform.matrices(poses))
    loads = np.column_stack([found[one] for one in machine.reading_names]) * signs
    step, by_energy = 1e-5, np.zeros_like(loads)
    for column, e in enumerate(step * np.eye(len(signs))):
        ends = [energy(machine, readings + side * e, poses) for side in (1, -1)]
        by_energy[:, column] = -(ends[0] - ends[1]) / (2 * step)
    np.testing.assert_allclose(loads, by_energy, atol=1e-7 * np.abs(loads).max())


@pytest.mark.parametrize("name", ["ur3", "ur5", "ur10", "xarm7"])
def test_loads_of_an_arm_are_those_of_pinocchio(name: str) -> None:
    file, base, tip = ARMS[name]
    load = Load(2.0, (0.01, 0.02, 0.05))
    machine = replace(loaded(name), load=load)
    model = pin.buildModelFromUrdf(str(urdf(file)))
    frame = model.frames[model.getFrameId(tip)]
    inertia = pin.Inertia(load.mass, np.array(load.centre), np.zeros((3, 3)))
    model.appendBodyToJoint(frame.parentJoint, inertia, frame.placement)
    low, high = np.array([(j.lower, j.upper) for j in machine.legs[0].moving]).T
    q = np.random.default_rng(0).uniform(low, high, (10, model.nq))
    wanted = [-pin.computeGeneralizedGravity(model, model.createData(), row) for row in q]
    poses = machine.platform.matrices(pincal.forward(machine, q).poses)
    base_at = _base(file, base)
    turned = replace(machine, load=replace(load, gravity=tuple(base_at.T @ load.gravity)))
    found = gravity_loads(turned, q, poses)
    loads = np.column_stack([found[one] for one in turned.reading_names])
    np.testing.assert_allclose(loads, wanted, atol=1e-9)


def _base(file: str, base: str) -> np.ndarray:
    """Return how a link stands in the root's frame at rest, shape (3, 3)."""
    model = pin.buildModelFromUrdf(str(urdf(file)))
    data = model.createData()
    pin.framesForwardKinematics(model, data, pin.neutral(model))
    return np.eye(3) if not base else np.array(data.oMf[model.getFrameId(base)].rotation)


def test_masses_are_read_from_a_urdf_and_written_again(tmp_path) -> None:
    machine = heavy(pincal.load_mechanism("5R"))
    machine.save(tmp_path / "heavy")
    again = pincal.load_mechanism(tmp_path / "heavy")
    assert again == machine
    assert again.legs[0].joints[0].mass > 0.0


@pytest.mark.parametrize("elsewhere", [False, True], ids=["in the base", "unknown frame"])
def test_loads_are_those_where_the_platform_is(*, elsewhere: bool) -> None:
    """A 3-RRR off by 2 mm and 2 mrad: loads within a tenth of its own, where it was measured.

    Its readings would take the machine as drawn elsewhere: near a type-2 singularity to a load
    three times the largest.
    """
    plain = replace(pincal.load_mechanism("3RRR"), load=Load(50.0, gravity=(0.0, -9.81, 0.0)))
    truth = pincal.disturb(plain, 2e-3, seed=3)
    poses = np.vstack((workspace("3RRR", 40), [0.41995, -0.11685, -0.26683]))

    def loads(machine: pincal.Mechanism, there: np.ndarray) -> np.ndarray:
        found = gravity_loads(machine, readings, machine.platform.matrices(there))
        return np.column_stack([found[leg] for leg in plain.leg_names])

    readings = pincal.inverse(truth, poses).readings
    own, drawn = loads(truth, poses), loads(plain, pincal.forward(plain, readings, poses).poses)
    assert np.abs(drawn - own).max() > 3.0 * np.abs(own).max()
    data = pincal.Measurements(poses=poses, readings=readings)
    data = seen_from_elsewhere(plain, data) if elsewhere else data
    given = {"setup": pincal.Setup(unknown_frame=elsewhere), "terms": "gravity"}
    asked = started(prepared(plain, data, noise=pincal.Noise(1e-5, 1e-5, 0.0), **given))
    found = asked.measurements.influences
    used = np.column_stack([found[f"load_{leg}"] for leg in plain.leg_names])
    assert np.abs(used - own).max() < 0.1 * np.abs(own).max()


def test_loads_of_links_alone_are_those_of_the_drawing(tmp_path: Path) -> None:
    """A delta moved by 1 mm, saved and read: rows are loaded as they were before, to the digit."""
    plain = replace(heavy(pincal.load_mechanism("delta")), load=None)
    poses = workspace("delta", 12)
    data = pincal.Measurements(poses=poses, readings=pincal.inverse(plain, poses).readings)
    nominal = started(prepared(plain, data, noise=pincal.Noise(1e-5), terms="gravity")).mechanism
    pincal.disturb(nominal, 1e-3, seed=0).save(tmp_path / "moved")
    before, after = (
        planned_influences(machine, data)
        for machine in (nominal, pincal.load_mechanism(tmp_path / "moved"))
    )
    assert np.abs(before).max() > 0.0
    np.testing.assert_array_equal(after, before)


@pytest.mark.slow
@pytest.mark.parametrize("known", ["masses of links", "measured loads"])
def test_gravity_needs_no_load_where_masses_or_loads_are_known(known: str, tmp_path) -> None:
    """Amplitudes that were simulated come back within five standard errors, and are saved.

    From masses of links alone, and from torques that were measured, of a machine without masses.
    """
    plain = pincal.load_mechanism("delta")
    weighing = replace(heavy(plain), load=None)
    poses, noise = workspace("delta", 60), pincal.Noise(2e-5, 0.0, 1e-6)
    nominal = pincal.Measurements(poses=poses, readings=pincal.inverse(plain, poses).readings)
    extended = started(prepared(weighing, nominal, noise=noise, terms="gravity")).mechanism
    assert len(extended.amplitudes) == 3
    truth = extended.with_parameters(dict.fromkeys(extended.amplitudes, 2e-3))
    data = pincal.simulate(extended, truth, pincal.Plan(poses), noise, seed=1).measurements
    loads = [f"load_{leg}" for leg in plain.leg_names]
    assert set(loads) <= set(data.influences)
    machine = plain if known == "measured loads" else weighing
    if machine is weighing:
        data = replace(data, influences={})
    result = pincal.calibrate(machine, data, noise=noise, terms="gravity")
    for id_ in result.identified.amplitudes:
        assert abs(result[id_].identified - 2e-3) < 5 * result[id_].std
    result.identified.save(tmp_path / "saved")
    again = pincal.load_mechanism(tmp_path / "saved")
    measured = {name: data.influences[name] for name in loads} if machine is plain else None
    reached = pincal.forward(again, data.readings, data.poses, influences=measured).poses
    assert np.abs(reached - data.poses).max() < 6 * 2e-5
    if machine is plain:  # nothing weighs on it: its term follows measured columns alone
        with pytest.raises(pincal.MeasurementError, match="data row 1: 'load_leg_1' is not known"):
            pincal.calibrate(again, replace(data, influences={}), noise=noise)
