"""Terms of parameters: links that grow, stretch and bend, in kinematics and identification."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from arms import loaded
from command_line import done
from measured import validated, workspace
from test_loads import energy, heavy

import pincal
from pincal import (
    Joint,
    Load,
    MeasurementError,
    MechanismError,
    SymmetryError,
    cyclic,
    sample_workspace,
)
from pincal.calibration.calibrate import prepared, started
from pincal.calibration.fits import fitted
from pincal.calibration.terms.candidates import with_terms
from pincal.calibration.terms.kinds import every_pair, parse_terms
from pincal.calibration.terms.screen import screen
from pincal.estimation.unknowns import BlockRows, State
from pincal.kinematics.configurations import planned_influences
from pincal.kinematics.influences import gravity_loads
from pincal.model.placement import Coordinate
from pincal.symmetry.carry import canonical, carry

NONE = pincal.Noise(0.0, 0.0, 0.0)
EXACT = pincal.Noise(1e-7, 1e-7, 1e-7)
WARM = pincal.Share(10.0, 20.0)
LOAD = Load(10.0, (0.01, 0.02, 0.05), (1.0, -9.0, -3.0))
DEFORMED = {
    "5R": ("l", "L"),
    "3RRR": ("L", "ob"),  # the platform grows too
    "6UPS": ("OA", "alpha_b"),
    "ur5": ("elbow_x", "wrist_2_rx", "tool_x"),
}


def deforming(mechanism: pincal.Mechanism, names: tuple[str, ...], of: str) -> pincal.Mechanism:
    """Return a mechanism whose parameters of these names follow an influence, amplitudes zero."""
    basis = pincal.Share(100.0) if of == "load" else WARM

    def leg(one: pincal.Leg) -> pincal.Leg:
        terms = tuple((name, pincal.Term(f"a_{name}", basis, of=of)) for name in names)
        more = tuple((f"a_{name}", 0.0) for name in names)
        return replace(one, terms=terms, parameters=(*one.parameters, *more))

    return replace(mechanism, legs=tuple(map(leg, mechanism.legs)), load=LOAD)


def machine_of(name: str, of: str = "temperature") -> tuple[pincal.Mechanism, pincal.Mechanism]:
    """Return a mechanism, and a machine of it that deforms by some 0.2 mm and mrad."""
    plain = loaded(name) if name == "ur5" else pincal.load_mechanism(name)
    nominal = deforming(plain, DEFORMED[name], of)
    true = pincal.disturb(nominal, 1e-3, seed=1)
    sizes = np.random.default_rng(0).uniform(1e-4, 2e-4, len(true.amplitudes))
    return nominal, true.with_parameters(
        dict(zip(sorted(true.amplitudes), sizes.tolist(), strict=True))
    )


def plan_of(mechanism: pincal.Mechanism, count: int) -> pincal.Plan:
    """Return configurations to be measured, and temperatures."""
    draw = np.random.default_rng(1)
    if not mechanism.by_readings:
        poses = workspace(mechanism.name, count)
        return pincal.Plan(poses, influences={"temperature": draw.uniform(15, 35, len(poses))})
    readings = draw.uniform(-1.2, 1.2, (count, len(mechanism.reading_names)))
    poses = pincal.forward(mechanism.drawing, readings).poses
    warm = {"temperature": draw.uniform(15.0, 35.0, count)}
    return pincal.Plan(poses, readings=readings, influences=warm)


def at_row(machine: pincal.Mechanism, warm: float) -> pincal.Mechanism:
    """Return the machine without terms whose lengths and angles are those of a temperature."""
    values = {one.id: one.nominal for one in machine.at_reference.parameters}
    for leg in machine.legs:
        for name, term in leg.terms:
            amplitude = machine.parameters[f"{leg.name}.{term.parameter}"].nominal
            values[f"{leg.name}.{name}"] += amplitude * (warm - 20.0) / 10.0
    return machine.at_reference.with_parameters(values)


@pytest.mark.parametrize("name", ["5R", "3RRR", "6UPS"])
def test_each_row_is_a_machine_with_the_parameters_of_that_row(name: str) -> None:
    """Inverse and forward kinematics at a temperature are those of the machine grown by hand."""
    _, machine = machine_of(name)
    plan = plan_of(machine, 4)
    warm = plan.influences["temperature"]
    there = pincal.inverse(machine, plan.poses, {"temperature": warm})
    back = pincal.forward(machine, there.readings, plan.poses, {"temperature": warm})
    for row, degrees in enumerate(warm.tolist()):
        grown = pincal.inverse(at_row(machine, degrees), plan.poses[row : row + 1])
        np.testing.assert_allclose(there.readings[row], grown.readings[0], atol=1e-12)
    np.testing.assert_allclose(back.poses, plan.poses, atol=1e-10)


def test_an_arm_grows_row_by_row() -> None:
    """An arm's pose at a temperature is that of the arm grown by hand."""
    _, machine = machine_of("ur5")
    plan = plan_of(machine, 4)
    found = pincal.forward(machine, plan.readings, influences=plan.influences).poses
    for row, degrees in enumerate(plan.influences["temperature"].tolist()):
        grown = pincal.forward(at_row(machine, degrees), plan.readings[row : row + 1]).poses[0]
        np.testing.assert_allclose(found[row], grown, atol=1e-12)


def test_at_its_reference_a_machine_is_the_one_without_terms() -> None:
    """Without influences nothing deforms, and readings are those without terms."""
    _, machine = machine_of("3RRR")
    poses = plan_of(machine, 5).poses
    rest = pincal.inverse(machine, poses).readings
    wanted = pincal.inverse(machine.at_reference, poses).readings
    np.testing.assert_allclose(rest, wanted, rtol=0.0, atol=1e-14)
    assert not machine.at_reference.influences
    assert not machine.drawing.amplitudes


@pytest.mark.parametrize("name", ["3RRR", pytest.param("6UPS", marks=pytest.mark.slow)])
def test_links_that_bend_under_load_go_there_and_back(name: str) -> None:
    """Inverse then forward kinematics comes back where lengths and angles follow their loads."""
    _, machine = machine_of(name, "load")
    poses = plan_of(machine, 5).poses
    there = pincal.inverse(machine, poses)
    assert (
        np.abs(there.readings - pincal.inverse(machine.at_reference, poses).readings).max() > 1e-6
    )
    back = pincal.forward(machine, there.readings, poses)
    np.testing.assert_allclose(back.poses, poses, atol=1e-10)


@pytest.mark.parametrize(
    ("name", "of"),
    [("3RRR", "temperature"), ("6UPS", "load"), ("ur5", "temperature"), ("ur5", "load")],
)
def test_derivatives_are_differences(name: str, of: str) -> None:
    """What a leg demands changes with parameters and amplitudes as its derivatives say."""
    _, machine = machine_of(name, of)
    plan = plan_of(machine, 3)
    readings = plan.readings
    if readings is None:
        readings = pincal.inverse(machine, plan.poses, planned_influences(machine, plan)).readings
    data = pincal.Measurements(
        poses=plan.poses, readings=readings + 1e-4, influences=plan.influences
    )
    legs = prepared(machine, data).leg_block([0], np.arange(len(data)))
    matrices, values, h = machine.platform.matrices(data.poses), machine.legs[0].nominal, 1e-6

    def demand(values: np.ndarray) -> BlockRows:
        return legs.evaluate(State(values, matrices))

    exact = demand(values)
    for column, step in enumerate(h * np.eye(len(values))):
        ends = [demand(values + side * step).value for side in (1.0, -1.0)]
        np.testing.assert_allclose(
            exact.by_parameter[:, :, column], (ends[0] - ends[1]) / (2 * h), atol=2e-8
        )


def recovered(name: str, of: str, count: int = 40, **options: Any) -> None:
    """Assert that measurements without noise give back parameters and amplitudes to 1e-9.

    Of an arm those that deform: its axes have no origins of their own, others are as drawn.
    """
    nominal, truth = machine_of(name, of)
    fixed: list[str] = []
    if name == "ur5":
        free = {f"{leg.name}.{one}" for leg in nominal.legs for one in leg.deformed}
        free |= nominal.amplitudes
        fixed = [one for one in nominal.parameters.ids if one not in free]
        truth = nominal.with_parameters({one: truth.parameters[one].nominal for one in free})
    data = pincal.simulate(nominal, truth, plan_of(nominal, count), NONE, seed=2).measurements
    result = pincal.calibrate(nominal, data, noise=EXACT, fixed=fixed, **options)
    off = [result[p.id].identified - p.nominal for p in truth.parameters]
    assert np.abs(off).max() < 1e-9


@pytest.mark.parametrize("name", ["5R", "3RRR"])
def test_without_noise_amplitudes_are_found(name: str) -> None:
    """Lengths that grow are identified exactly where nothing is noisy."""
    recovered(name, "temperature")


def test_each_leg_alone_finds_them_too() -> None:
    """Poses taken as measured."""
    recovered("5R", "temperature", options=pincal.Options(method="per-leg"))


@pytest.mark.slow
def test_held_out_rows_are_predicted_at_their_temperatures() -> None:
    """Rows held out miss as those of a machine without terms do; blind to the columns, more."""
    nominal, true = machine_of("3RRR")
    noise = pincal.Noise(2e-5, 2e-5, 2e-5)
    data = pincal.simulate(nominal, true, plan_of(nominal, 60), noise, seed=0).measurements
    held = validated(nominal, data, noise=noise)
    assert held.p_value > 0.01
    blind = validated(pincal.load_mechanism("3RRR"), data, noise=noise)
    assert blind.targets[0].rms > 2.0 * held.targets[0].rms


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "of"),
    [("6UPS", "temperature"), ("ur5", "temperature"), ("6UPS", "load"), ("ur5", "load")],
)
def test_without_noise_amplitudes_of_large_machines_are_found(name: str, of: str) -> None:
    """The same of a hexapod and an arm, warm and under load."""
    recovered(name, of, 60)


@pytest.mark.parametrize(
    "name",
    ["5R", "3RRR", *(pytest.param(one, marks=pytest.mark.slow) for one in ("6UPS", "delta"))],
)
def test_loads_of_lengths_are_what_the_height_loses_with_them(name: str) -> None:
    """A length's load is −∂V/∂p, active joints held, platform and passive joints following."""
    machine = heavy(pincal.load_mechanism(name))
    poses = sample_workspace(machine, 3, seed=1)
    readings = pincal.inverse(machine, poses).readings
    loads = gravity_loads(machine, readings, machine.platform.matrices(poses))
    largest, step = max(np.abs(one).max() for one in loads.values()), 1e-5
    for one in machine.legs[0].placed:
        id_ = f"leg_1.{one}"
        ends = []
        for side in (1.0, -1.0):
            value = machine.parameters[id_].nominal + side * step
            ends.append(energy(machine.with_parameters({id_: value}), readings, poses))
        by_energy = -(ends[0] - ends[1]) / (2 * step)
        np.testing.assert_allclose(loads[id_], by_energy, atol=1e-6 * largest)


def test_a_weight_between_two_rods_pulls_them_as_a_truss() -> None:
    """Rods of a 5R that carry a weight have the tensions of two forces in balance with it."""
    weight = Load(4.0, (0.0, 0.0, 0.0), (0.0, -9.81, 0.0))
    machine = replace(pincal.load_mechanism("5R"), load=weight)
    poses = sample_workspace(machine, 5, seed=3)
    solution = pincal.inverse(machine, poses)
    loads = gravity_loads(machine, solution.readings, machine.platform.matrices(poses))
    rods = []
    for leg in machine.legs:  # from the elbow to the platform
        p, (shoulder, elbow) = leg.nominal_by_name, solution.joints[leg.name].T
        turn = np.stack((np.cos(shoulder + elbow), np.sin(shoulder + elbow)), axis=1)
        arm = p["l"] * np.stack((np.cos(shoulder), np.sin(shoulder)), axis=1)
        np.testing.assert_allclose(
            [p["A_x"], p["A_y"]] + arm + p["L"] * turn, poses, atol=1e-9
        )  # else the axes are others
        rods.append(turn)
    pulls = np.linalg.solve(np.stack(rods, axis=2), np.tile([[0.0], [-4.0 * 9.81]], (5, 1, 1)))
    for index, leg in enumerate(machine.legs):
        np.testing.assert_allclose(loads[f"{leg.name}.L"], pulls[:, index, 0], atol=1e-9)


def one_link(compliance: float) -> pincal.Mechanism:
    """Return an arm of one joint about −y: a beam of 2 m with 3 kg that bends at its root."""
    beam, free = pincal.Share(), pincal.Platform("spatial", (2.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    joints = (
        Joint("shoulder", "revolute", axis=(0.0, -1.0, 0.0)),
        Joint(
            "end",
            "fixed",
            pincal.Placement((Coordinate("ry", ("root",)), Coordinate("x", ("l",))), (2.0, 0, 0)),
        ),
    )
    leg = pincal.Leg(
        "arm",
        joints,
        (pincal.Sensor("shoulder"),),
        (("root", 0.0), ("l", 2.0), ("give", compliance), ("pull", 1e-6)),
        Joint("flange", "fixed"),
        closes="frame",
        terms=(
            ("root", pincal.Term("give", beam, of="load", unit="rad/(N m)")),
            ("l", pincal.Term("pull", beam, of="load", unit="m/N")),
        ),
    )
    return pincal.Mechanism("beam", free, (leg,), load=Load(3.0))


def test_a_beam_bends_and_stretches_as_its_weight_says() -> None:
    """One link at θ: torque m g l cos θ about +y at its root, force −m g sin θ along it."""
    machine, weight = one_link(1e-5), 3.0 * 9.81
    angles = np.linspace(-1.0, 1.0, 5)[:, None]
    drawn = pincal.forward(machine.drawing, angles).poses
    loads = gravity_loads(machine, angles, machine.platform.matrices(drawn))
    theta = angles[:, 0]
    np.testing.assert_allclose(loads["arm.root"], weight * 2.0 * np.cos(theta), atol=1e-12)
    np.testing.assert_allclose(loads["arm.l"], -weight * np.sin(theta), atol=1e-12)
    bent = theta - 1e-5 * weight * 2.0 * np.cos(theta)
    long = 2.0 - 1e-6 * weight * np.sin(theta)
    found = pincal.forward(machine, angles).poses
    np.testing.assert_allclose(found[:, 0], long * np.cos(bent), atol=1e-12)
    np.testing.assert_allclose(found[:, 2], long * np.sin(bent), atol=1e-12)


def test_a_folder_holds_terms_of_parameters(tmp_path: Path) -> None:
    """What is written to a folder is read again, and a measured load's column has its place."""
    for of in ("temperature", "load"):
        _, machine = machine_of("3RRR", of)
        machine.save(tmp_path / of)
        assert pincal.load_mechanism(tmp_path / of) == machine
    assert "load_leg_1.L" in machine.influences


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("k: {a: {of: warmth}}", "give the term to the sensor"),
        ("z: {a: {of: warmth}}", "no placement has such a parameter; expected one of OA, beta"),
        ("L: {a: {sine: 2}}", "depends on a reading; a parameter's term depends on an influence"),
        ("L: {a: {of: approach}}", "which only joints have"),
        ("L: {l: {of: warmth}}", "its amplitude is also a parameter of a placement"),
        ("L: {a: {of: warmth, per: 0}}", "parameter 'L', term 'a': an influence's share"),
        ("L: {b: {of: warmth}}", "'b' is used in a placement or a sensor but has no nominal"),
        ("L: {of: warmth}", "legs"),
    ],
)
def test_wrong_terms_of_parameters_are_named(tmp_path: Path, text: str, words: str) -> None:
    """A term that cannot be is refused with the leg, the parameter, and what to do."""
    _, machine = machine_of("3RRR")
    replace(machine, load=None).save(tmp_path / "m")
    path = tmp_path / "m" / "mechanism.yaml"
    own = path.read_text().replace("a_L", "a").replace("a_ob", "a2")
    start = own.index("  terms:\n    L:")
    end = own.index("- name", start)
    path.write_text(
        f"{own[:start]}  terms:\n    {text}\n    ob: {{a2: {{of: warmth}}}}\n{own[end:]}"
    )
    with pytest.raises(MechanismError, match=r"mechanism\.yaml") as error:
        pincal.load_mechanism(tmp_path / "m")
    assert words in str(error.value)


def test_a_leg_that_deforms_is_not_carried() -> None:
    """What grows in one direction may grow in another one where the leg is carried to."""
    leg = deforming(pincal.load_mechanism("5R"), ("A_x",), "temperature").legs[0]
    with pytest.raises(SymmetryError, match=r"A_x have terms, which the rotation .* may change"):
        carry(leg, cyclic(3)[1])


def test_a_load_turns_over_with_its_joint() -> None:
    """A leg whose axes are turned to the positive side reads the same under the same weight."""
    plain = pincal.load_mechanism("3RRR")
    bends = pincal.Term("sag", pincal.Share(10.0), of="load")

    def turned(leg: pincal.Leg) -> pincal.Leg:
        first = replace(leg.joints[0], axis=(0.0, 0.0, -1.0), home=-leg.joints[0].home)
        sensor = replace(leg.sensors[0], terms=(bends,))
        own = (*leg.parameters, ("sag", 1e-3))
        return replace(leg, joints=(first, *leg.joints[1:]), sensors=(sensor,), parameters=own)

    machine = replace(plain, legs=tuple(map(turned, plain.legs)), load=LOAD)
    other = replace(machine, legs=tuple(map(canonical, machine.legs)))
    poses = workspace(plain.name, 4)
    there, again = (pincal.inverse(one, poses).readings for one in (machine, other))
    np.testing.assert_allclose(again, there, atol=1e-11)
    assert np.abs(there - pincal.inverse(machine.at_reference, poses).readings).max() > 1e-4


def test_results_keep_terms_of_parameters(tmp_path: Path) -> None:
    """A result saved and loaded has the terms, and its machine reaches poses at temperatures."""
    nominal, truth = machine_of("5R")
    noise = pincal.Noise(1e-5, 1e-5, 1e-5)
    data = pincal.simulate(nominal, truth, plan_of(nominal, 30), noise, seed=2).measurements
    result = pincal.calibrate(nominal, data, noise=noise)
    result.save(tmp_path / "r")
    again = pincal.load_result(tmp_path / "r")
    assert again.identified == result.identified
    assert again.identified.influences == ("temperature",)
    for one in nominal.amplitudes:
        assert abs(result[one].identified - truth.parameters[one].nominal) < 4.0 * result[one].std


NOISE = pincal.Noise(2e-5, 2e-5, 2e-5)


@pytest.mark.parametrize(("place", "size"), [("growth", 6e-4), ("leg_2.l", 3e-4)])
def test_what_grows_is_named_first_and_identified(place: str, size: float) -> None:
    """A screen names all lengths that grow as one, or the one that does, and it is identified."""
    plain = pincal.load_mechanism("3RRR")
    draw = np.random.default_rng(0)
    poses = plain.platform.home + [0.15, 0.15, 0.4] * draw.uniform(-1.0, 1.0, (80, 3))
    warm = {"temperature": draw.uniform(18.0, 30.0, len(poses))}
    nominal = pincal.Measurements(
        poses=poses, readings=pincal.inverse(plain, poses).readings, influences=warm
    )
    text = f"{place}=temperature"
    truth, ids = with_terms(
        pincal.disturb(plain, 1e-3, seed=1), nominal, parse_terms([text], plain)
    )
    names = [name for own in ids.values() for name in own]
    truth = truth.with_parameters(dict.fromkeys(names, size))
    plan = pincal.Plan(poses, influences=warm)
    data = pincal.simulate(plain, truth, plan, NOISE, seed=3).measurements
    found = screen(fitted(started(prepared(plain, data, noise=NOISE))), every_pair(plain, data))
    assert (found[0].reading, str(found[0].kind)) == (place, "temperature")
    assert found[0].corrected < 1e-6
    result = pincal.calibrate(plain, data, noise=NOISE, terms=(text,))
    for name in names:
        assert abs(result[name].identified - size) < 4.0 * result[name].std < 0.5 * size
    assert len({result[name].identified for name in names}) == 1


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("leg_1.l=harmonics", "harmonics is for readings; lengths and angles can follow a column"),
        ("growth=gravity", "gravity loads each length differently"),
        ("leg_1.z=temperature", "its lengths and angles are leg_1.OA"),
    ],
)
def test_a_place_that_cannot_have_a_term_is_refused(text: str, words: str) -> None:
    """What is asked of a length must be what a length can follow."""
    with pytest.raises(MeasurementError) as error:
        parse_terms([text], pincal.load_mechanism("3RRR"))
    assert words in str(error.value)


def test_check_says_by_which_columns_amplitudes_are_seen(tmp_path: Path) -> None:
    """Amplitudes of what follows a column are not called without effect; the rest is observable."""
    nominal = machine_of("3RRR")[0]
    nominal.save(tmp_path / "m")
    own = len(pincal.load_mechanism("3RRR").legs[0].parameters)
    said = " ".join(done("check", tmp_path / "m").out.split())
    assert "has no effect" not in said
    assert "by columns temperature" in said
    assert f"{own} of {own} parameters observable" in said
