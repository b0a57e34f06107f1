"""Terms of sensors: found without noise, known to all kinematics, kept in folders and tables."""

from __future__ import annotations

import shlex
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from arms import loaded
from command_line import done, run
from measured import workspace

import pincal
from pincal import Load, MeasurementError, MechanismError
from pincal.calibration.calibrate import prepared
from pincal.calibration.calibration import Calibration
from pincal.calibration.terms.candidates import with_terms
from pincal.calibration.terms.kinds import parse_terms
from pincal.estimation.unknowns import BlockRows, State
from pincal.kinematics.configurations import planned_influences
from pincal.kinematics.influences import influences_of, sides
from pincal.words.findings import finding

EXACT = pincal.Noise(1e-7, 1e-7, 1e-7)
FORMS = {
    "sine": pincal.Term("a", pincal.Harmonic(3, "sine")),
    "cosine": pincal.Term("a", pincal.Harmonic(5, "cosine", period=1.5)),
    "power": pincal.Term("a", pincal.Power(2, 0.5, 0.1)),
    "temperature": pincal.Term("a", pincal.Share(10.0, 20.0), of="temperature"),
    "time": pincal.Term("a", pincal.Power(2, 100.0, 50.0), of="time"),
    "backlash": pincal.Term("a", pincal.Share(), of="approach"),
    "gravity": pincal.Term("a", pincal.Share(300.0), of="load"),
}


def extended(mechanism: pincal.Mechanism, *terms: pincal.Term) -> pincal.Mechanism:
    """Return a mechanism each of whose sensors has terms, at zero, and something that weighs."""

    def leg(one: pincal.Leg) -> pincal.Leg:
        sensors, more = [], []
        for index, sensor in enumerate(one.sensors):
            own = [replace(term, parameter=f"{term.parameter}_{index}") for term in terms]
            sensors.append(replace(sensor, terms=tuple(own)))
            more += [(term.parameter, 0.0) for term in own]
        return replace(one, sensors=tuple(sensors), parameters=(*one.parameters, *more))

    load = Load(20.0, (0.01, 0.02, 0.1), (1.0, -2.0, -9.81))
    return replace(mechanism, legs=tuple(map(leg, mechanism.legs)), load=load)


def truth_of(mechanism: pincal.Mechanism, size: float = 3e-4) -> pincal.Mechanism:
    """Return a machine whose terms have amplitudes of a size, [rad] or [m]."""
    true = pincal.disturb(mechanism, 1e-3, seed=1)
    ids = [one.id for one in true.parameters if one.name.startswith("a_")]
    draw = np.random.default_rng(2)
    return true.with_parameters({name: float(size * draw.uniform(0.5, 1.0)) for name in ids})


def measured(
    mechanism: pincal.Mechanism, truth: pincal.Mechanism, noise: pincal.Noise, count: int = 60
) -> pincal.Measurements:
    """Return simulated measurements, with all influences."""
    draw = np.random.default_rng(3)
    poses = workspace(mechanism.name, count, 4)
    influences = {
        "temperature": draw.uniform(15.0, 30.0, len(poses)),
        "time": np.sort(draw.uniform(0.0, 100.0, len(poses))),
    }
    plan = pincal.Plan(poses, influences=influences)
    return pincal.simulate(mechanism, truth, plan, noise, seed=5).measurements


def largest_error(result: pincal.CalibrationResult, truth: pincal.Mechanism) -> float:
    """Return how far an identified parameter is from the true one, at most."""
    return max(
        abs(p.identified - truth.parameters[p.id].nominal)
        for leg in result.legs
        for p in leg.parameters
    )


#: Every form in the plane, what weighs in space; the others in space are slow.
MACHINES = [
    *(("3RRR", form) for form in FORMS if form != "gravity"),
    ("6UPS", "gravity"),
    *(pytest.param("6UPS", form, marks=pytest.mark.slow) for form in FORMS if form != "gravity"),
]


@pytest.mark.parametrize(("name", "form"), MACHINES)
def test_without_noise_amplitudes_are_found(name: str, form: str) -> None:
    machine = extended(pincal.load_mechanism(name), FORMS[form])
    truth = truth_of(machine)
    data = measured(machine, truth, pincal.Noise(0.0, 0.0, 0.0), 40)
    result = pincal.calibrate(machine, data, noise=EXACT)
    assert largest_error(result, truth) < 1e-9


@pytest.mark.parametrize(("name", "form"), MACHINES)
def test_forward_and_inverse_agree_with_terms(name: str, form: str) -> None:
    machine = truth_of(extended(pincal.load_mechanism(name), FORMS[form]))
    data = measured(machine, machine, pincal.Noise(0.0, 0.0, 0.0), 8)
    influences = planned_influences(machine, data)
    there = pincal.forward(machine, data.readings, data.poses, influences)
    np.testing.assert_allclose(there.poses, data.poses, atol=1e-11)
    back = pincal.inverse(machine, data.poses, influences)
    np.testing.assert_allclose(back.readings, data.readings, atol=1e-12)
    if machine.influences:
        at_rest = pincal.inverse(machine, data.poses)
        followed = form == "gravity"  # from the pose itself
        assert (np.abs(at_rest.readings - data.readings).max() < 1e-12) == followed


@pytest.mark.parametrize("form", FORMS)
def test_derivatives_by_amplitudes_are_differences(form: str) -> None:
    machine = truth_of(extended(pincal.load_mechanism("3RRR"), FORMS[form]), 1e-2)
    data = measured(machine, machine, pincal.Noise(0.0, 0.0, 0.0), 6)
    legs = Calibration(machine, data).leg_block([0], np.arange(len(data)))
    matrices = machine.platform.matrices(data.poses)
    values = machine.legs[0].nominal

    def demand(values: np.ndarray, by: float = 0.0) -> BlockRows:
        moved = replace(legs, readings=legs.readings + by)
        return moved.evaluate(State(values, matrices))

    exact = demand(values)
    h = 1e-6
    for column in range(len(values)):
        step = h * np.eye(len(values))[column]
        ends = [demand(values + side * step).value for side in (1.0, -1.0)]
        np.testing.assert_allclose(
            exact.by_parameter[:, :, column], (ends[0] - ends[1]) / (2 * h), atol=1e-7
        )
    ends = [demand(values, by=side * h).value for side in (1.0, -1.0)]
    np.testing.assert_allclose(exact.by_measured[:, :, 0], (ends[0] - ends[1]) / (2 * h), atol=1e-7)


def test_gravity_bends_an_arm_and_is_identified() -> None:
    arm = replace(loaded("ur5"), load=Load(5.0, (0.0, 0.0, 0.05)))
    draw = np.random.default_rng(0)
    readings = draw.uniform(-1.2, 1.2, (60, 6))
    plan = pincal.Plan(pincal.forward(arm, readings).poses, readings=readings)
    nominal = pincal.Measurements(poses=plan.poses, readings=readings)
    pairs = parse_terms(["shoulder_lift_joint=gravity", "elbow_joint=gravity"], arm)
    bent, ids = with_terms(arm, nominal, pairs)
    names = [name for own in ids.values() for name in own]
    truth = bent.with_parameters(dict.fromkeys(names, 3e-4))
    noise = pincal.Noise(2e-5, 2e-5, 0.0)
    data = pincal.simulate(bent, truth, plan, noise, seed=1).measurements
    given = {"noise": noise}
    result = pincal.calibrate(bent, data, **given)
    for name in names:
        p = result[name]
        assert abs(p.identified - 3e-4) < 4.0 * p.std < 1.5e-4
    assert pincal.calibrate(arm, data, **given).reduced_chi2 > 3.0 * result.reduced_chi2


@pytest.mark.slow
def test_a_weight_that_nobody_said_is_taken_up_by_amplitudes(tmp_path: Path) -> None:
    """Of a machine that sags under 7 kg, 1 kg and amplitudes seven times as large do the same."""
    plain = pincal.load_mechanism("linear_delta")
    machine = replace(extended(plain, FORMS["gravity"]), load=Load(7.0))
    truth = truth_of(machine)
    data = measured(machine, truth, pincal.Noise(0.0, 0.0, 0.0), 30)
    unaware = replace(data, influences={})
    result = pincal.calibrate(plain, unaware, noise=EXACT, terms=["gravity"])
    assert result.identified.load is not None
    assert result.identified.load.mass == 1.0
    assert "weight" in result.expected_error().uncovered  # links may weigh, too
    kept = pincal.load_mechanism(result.identified.save(tmp_path / "kept")).load
    assert kept is not None
    assert kept.assumed
    told = replace(plain, load=Load(1.0))
    same = pincal.calibrate(told, unaware, noise=EXACT, terms=["gravity"])
    assert "weight" not in same.expected_error().uncovered  # 1 kg that somebody said
    readings = pincal.inverse(truth, data.poses[:5]).readings
    reached = pincal.forward(result.identified, readings, data.poses[:5]).poses
    np.testing.assert_allclose(reached, data.poses[:5], atol=1e-9)
    noise, kinds = pincal.Noise(1e-5, 1e-5, 1e-5), ["polynomial", "gravity"]
    first = pincal.explain(plain, unaware, noise=noise, folds=2, terms=kinds)
    assert first.candidates[0].kind == "gravity"
    assert "1 kg" in str(first)


def test_loads_are_those_of_the_drawing_before_and_after_calibration() -> None:
    machine = extended(pincal.load_mechanism("6UPS"), FORMS["gravity"])
    poses = workspace(machine.name, 5)
    readings = pincal.inverse(machine.drawing, poses).readings
    loads = influences_of(machine, pincal.Plan(poses, readings=readings))
    assert np.isnan(loads).all()  # followed from readings, where kinematics asks
    moved = pincal.disturb(machine, 1e-2, seed=2)
    again = pincal.disturb(moved, 1e-2, seed=3)
    assert again.drawing.parameters == machine.drawing.parameters


@pytest.mark.parametrize("form", FORMS)
def test_a_folder_holds_terms(tmp_path: Path, form: str) -> None:
    machine = truth_of(extended(pincal.load_mechanism("3RRR"), FORMS[form]))
    machine.save(tmp_path / "m")
    assert pincal.load_mechanism(tmp_path / "m") == machine


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("{sine: 2, cosine: 3}", "expected one of sine, cosine, power, per, or 'of' alone"),
        ("{}", "expected one of sine"),
        ("{sine: -1}", "a harmonic's order is -1.0; expected a number above 0"),
        ("{sine: 2, range: 3}", "'range' does not go with 'sine'; expected period"),
        ("{power: 2}", "'power' needs 'range' beside it"),
        ("{power: 1, range: 1}", "expected 2 to 20"),
        ("{of: temperature, per: 0}", "expected a number other than 0"),
        ("{of: x}", "which is another column of tables"),
        ("{of: 'temperature [K]'}", "which cannot head a column of a table"),
        ("{of: sigma_x}", "which cannot head a column of a table"),
        ("{of: warmth, per: 2, sine: 2}", "got sine and per"),
        ("{pover: 2}", "pover"),
    ],
)
def test_wrong_terms_of_a_file_are_named(tmp_path: Path, text: str, words: str) -> None:
    machine = extended(pincal.load_mechanism("3RRR"), FORMS["sine"])
    replace(machine, load=None).save(tmp_path / "m")
    path = tmp_path / "m" / "mechanism.yaml"
    path.write_text(path.read_text().replace("a_0: {sine: 3}", f"a_0: {text}", 1))
    with pytest.raises(MechanismError, match=r"mechanism\.yaml") as error:
        pincal.load_mechanism(tmp_path / "m")
    assert words in str(error.value)


@pytest.mark.parametrize(
    ("term", "words"),
    [
        (pincal.Term("L", pincal.Harmonic(3, "sine")), "also a parameter of a placement"),
        (pincal.Term("k", pincal.Harmonic(3, "sine")), "also a parameter of a placement or sensor"),
        (pincal.Term("grow", pincal.Harmonic(3, "sine")), "[m], is also that of another term"),
    ],
)
def test_an_amplitude_is_of_one_thing(term: pincal.Term, words: str) -> None:
    """No term takes a length or a gain as its amplitude, or one in another unit."""
    leg = pincal.load_mechanism("3RRR").legs[0]
    own = (("l", pincal.Term("grow", pincal.Share(), of="warmth")),)
    parameters = (*leg.parameters, ("grow", 0.0))
    with pytest.raises(MechanismError) as error:
        replace(
            leg,
            sensors=(replace(leg.sensors[0], terms=(term,)),),
            terms=own,
            parameters=parameters,
        )
    assert words in str(error.value)


def test_numbers_of_numpy_are_saved(tmp_path: Path) -> None:
    """What arrays gave is written as any number."""
    machine = pincal.load_mechanism("5R")
    leg = machine.legs[0]
    sensor = replace(leg.sensors[0], gain=np.float64(0.5), offset=np.float64(0.1))
    sensor = replace(sensor, counts_per_unit=np.float64(4000.0))
    kept = tuple(one for one in leg.parameters if one[0] not in ("k", "gamma"))
    own = replace(machine, legs=(replace(leg, sensors=(sensor,), parameters=kept), machine.legs[1]))
    own.save(tmp_path / "m")
    assert pincal.load_mechanism(tmp_path / "m") == own


def test_columns_of_influences_are_read_and_written(tmp_path: Path) -> None:
    machine = extended(
        pincal.load_mechanism("3RRR"),
        FORMS["temperature"],
        replace(FORMS["backlash"], parameter="b"),
    )
    data = measured(machine, machine, EXACT, 12)
    data.to_csv(tmp_path / "d.csv", machine)
    again = pincal.Measurements.from_csv(tmp_path / "d.csv", machine)
    for name in machine.influences:
        np.testing.assert_array_equal(again.influences[name], data.influences[name])
    path = tmp_path / "d.csv"
    path.write_text(path.read_text().replace("temperature", "warmth"))
    with pytest.raises(MeasurementError, match="no column 'temperature', on which terms"):
        pincal.Measurements.from_csv(path, machine)


def test_sides_follow_the_order_of_rows() -> None:
    readings = np.array([0.0, 1.0, 1.0, 0.5, 0.7, 0.7])
    np.testing.assert_array_equal(sides(readings), [np.nan, 1, 1, -1, 1, 1])
    runs = ("a", "a", "a", "b", "b", "b")
    np.testing.assert_array_equal(sides(readings, runs), [np.nan, 1, 1, np.nan, 1, 1])


def test_sides_do_not_depend_on_how_finely_rows_follow_a_motion() -> None:
    """A logged sweep has the sides of a coarse one, noise far below its range or not."""
    t = np.linspace(0.0, 4.0 * np.pi, 6001)
    fine = np.sin(t) + 1e-4 * np.random.default_rng(0).standard_normal(len(t))
    turning = np.abs(np.cos(t)) < 0.1  # the side changes where it has gone back far enough
    assert (sides(fine) == np.sign(np.cos(t)))[~turning][1:].all()
    np.testing.assert_array_equal(sides(np.linspace(0.0, 1.0, 5000))[10:], 1.0)


def test_rows_keep_their_side_where_others_are_left_out() -> None:
    machine = extended(pincal.load_mechanism("3RRR"), FORMS["backlash"])
    data = measured(machine, machine, EXACT, 20)
    whole = prepared(machine, replace(data, influences={}))
    part = whole.rows(np.arange(0, len(data), 3))
    np.testing.assert_array_equal(part.influences, whole.influences[::3])


def test_an_influence_that_nothing_depends_on_is_refused() -> None:
    machine = pincal.load_mechanism("3RRR")
    home = np.array([machine.platform.home])
    with pytest.raises(MeasurementError, match="no term of '3RRR' depends on 'temperature'"):
        pincal.inverse(machine, home, {"temperature": 20.0})


def test_a_machine_at_its_reference_needs_no_influences() -> None:
    plain = pincal.load_mechanism("3RRR")
    machine = truth_of(extended(plain, FORMS["temperature"]))
    bare = machine.drawing.with_parameters(
        {p.id: p.nominal for p in machine.parameters if not p.name.startswith("a_")}
    )
    poses = workspace(plain.name, 5)
    np.testing.assert_array_equal(
        pincal.inverse(machine, poses).readings, pincal.inverse(bare, poses).readings
    )
    warm = pincal.inverse(machine, poses, {"temperature": 30.0}).readings
    amplitudes = [machine.parameters[f"{leg.name}.a_0"].nominal for leg in machine.legs]
    gains = [machine.parameters[f"{leg.name}.k"].nominal for leg in machine.legs]
    cold = pincal.inverse(machine, poses).readings
    np.testing.assert_allclose(warm - cold, -np.divide(amplitudes, gains) + 0 * cold, atol=1e-12)


def _with_a_warm_leg(plain: pincal.Mechanism) -> tuple[pincal.Measurements, pincal.Mechanism]:
    """Return measurements of a 3-RRR whose third motor follows the temperature; and the machine."""
    draw = np.random.default_rng(0)
    poses = plain.platform.home + [0.15, 0.15, 0.4] * draw.uniform(-1.0, 1.0, (80, 3))
    influences = {"temperature": draw.uniform(18.0, 30.0, len(poses))}
    nominal = pincal.Measurements(
        poses=poses, readings=pincal.inverse(plain, poses).readings, influences=influences
    )
    machine, _ = with_terms(
        pincal.disturb(plain, 1e-3, seed=1), nominal, parse_terms(["leg_3=temperature"], plain)
    )
    machine = machine.with_parameters({"leg_3.temperature": 1.5e-4})
    noise = pincal.Noise(2e-5, 2e-5, 2e-5)
    plan = pincal.Plan(poses, influences=influences)
    return pincal.simulate(plain, machine, plan, noise, seed=3).measurements, machine


NOISE = ("--noise-position", "20um", "--noise-orientation", 2e-5, "--noise-reading", 2e-5)


@pytest.mark.slow
def test_the_term_that_is_there_is_named_first_and_pays(tmp_path: Path) -> None:
    data, machine = _with_a_warm_leg(pincal.load_mechanism("3RRR"))
    data.to_csv(tmp_path / "d.csv", machine)
    out = done("explain", "3RRR", tmp_path / "d.csv", *NOISE, "--folds", 2).out
    assert "leg_3 follows temperature" in out
    assert "these terms help" in out
    command = next(line for line in out.splitlines() if "pincal calibrate" in line)
    assert "--terms leg_3=temperature -o RESULT" in command
    words = shlex.split(command)[1:-1]
    outcome = done(*words, tmp_path / "r", "--folds", 0, "--no-report")
    assert "columns not used" not in outcome.err
    found = pincal.load_result(tmp_path / "r")
    assert found["leg_3.temperature"].identified == pytest.approx(1.5e-4, abs=2e-5)
    again = pincal.load_mechanism(tmp_path / "r")
    assert again.influences == ("temperature",)


@pytest.mark.slow
def test_auto_takes_what_pays() -> None:
    plain = pincal.load_mechanism("3RRR")
    data, _ = _with_a_warm_leg(plain)
    noise = pincal.Noise(2e-5, 2e-5, 2e-5)
    said: list[str] = []
    result = pincal.calibrate(plain, data, noise=noise, terms="auto", folds=3, progress=said.append)
    assert "models on held-out rows, fold 3 of 3" in said
    names = {p.id for leg in result.legs for p in leg.parameters}
    assert names - {p.id for p in plain.parameters} == {"leg_3.temperature"}
    assert not result.promises  # a term that these rows chose, until held-out rows vouch for it
    assert "terms-chosen" in [one.code for one in result.contradictions]
    assert result.validated(folds=3).promises


def plain_rows(count: int) -> tuple[pincal.Mechanism, pincal.Noise, pincal.Measurements]:
    """Return a 3-RRR, the noise, and measurements of a machine like it, without terms."""
    plain, noise = pincal.load_mechanism("3RRR"), pincal.Noise(2e-5, 2e-5, 2e-5)
    truth, poses = pincal.disturb(plain, 1e-3, seed=1), workspace("3RRR", count, 1)
    return plain, noise, pincal.simulate(plain, truth, poses, noise, seed=2).measurements


def test_a_machine_without_terms_needs_none() -> None:
    plain, noise, data = plain_rows(60)
    found = pincal.explain(plain, data, noise=noise)
    assert found.verdict == "geometry"
    assert min(one.corrected for one in found.candidates) > 0.01
    assert "by chance" not in str(found)
    values = {"term": "order", "quantity": "readings", "p_value": 2e-3}
    pattern = finding("model-lacks", **values)
    by_chance = replace(found, result=replace(found.result, findings=(pattern,)))
    assert "1 in 100 sets of sound measurements shows a pattern by chance" in " ".join(
        str(by_chance).split()
    )


@pytest.mark.slow
def test_a_machine_as_drawn_is_left_alone() -> None:
    plain = pincal.load_mechanism("3RRR")
    noise = pincal.Noise(1e-3, 1e-3, 0.0)
    data = pincal.simulate(plain, plain, workspace(plain.name, 15, 1), noise, seed=2)
    found = pincal.explain(plain, data.measurements, noise=noise)
    assert found.verdict == "as drawn"


def test_a_column_that_is_not_there_is_named(tmp_path: Path) -> None:
    data, machine = _with_a_warm_leg(pincal.load_mechanism("3RRR"))
    data.to_csv(tmp_path / "d.csv", machine)
    for term, words in (
        ("humidity", "no column 'humidity' for terms to depend on"),
        ("harmonics:x", "expected harmonics:1,2"),
        ("period:7", "(periods in a turn, up to 100,000), period:5mm"),
        ("leg_1=period:5mm", "'5mm': expected a number, with one of rad, mrad, deg"),
        ("gravity", "measure columns load_leg_1 …, or give them in mechanism.yaml"),
    ):
        outcome = run("explain", "3RRR", tmp_path / "d.csv", "--terms", term)
        assert outcome.code == 2
        assert words in " ".join(outcome.trouble.split())
    with pytest.raises(MeasurementError, match="give the period, such as leg_1=period:5mm"):
        pincal.calibrate("3RRR", data, terms=["leg_1=period"])


@pytest.mark.slow
def test_a_column_with_a_blank_cell_is_not_tried_and_that_is_said(tmp_path: Path) -> None:
    data, machine = _with_a_warm_leg(pincal.load_mechanism("3RRR"))
    data.to_csv(tmp_path / "d.csv", machine)
    lines = (tmp_path / "d.csv").read_text().splitlines()
    place = lines[0].split(",").index("temperature")
    cells = lines[4].split(",")
    cells[place] = ""
    (tmp_path / "d.csv").write_text("\n".join([*lines[:4], ",".join(cells), *lines[5:]]))
    outcome = done("explain", "3RRR", tmp_path / "d.csv", *NOISE, "--folds", 2)
    assert "line 5: not a number, so no term is tried with column 'temperature'" in outcome.err
    assert "temperature" not in outcome.out


def test_folds_that_leave_geometry_undetermined_are_left_out() -> None:
    """Rows of one fold alone tell leg 3 apart; without them there is nothing to compare there."""
    plain, noise, data = plain_rows(40)
    readings = data.readings.copy()
    readings[np.arange(40) % 4 != 0, 2] = np.nan  # fold 1 of 4 has all of the third reading
    few = replace(data, readings=readings)
    strict = {"noise": noise, "folds": 4, "terms": "backlash", "strict": True}
    found = pincal.explain(plain, few, **strict)
    assert [fold for fold, _ in found.lost] == [0]
    assert all(np.isfinite(one.held_out) for one in found.models)
    assert "fold 1 is not compared" in str(found)
    readings[4:, 2] = np.nan
    poses_of_few = replace(few, readings=readings)
    with pytest.raises(pincal.ObservabilityError):  # all rows together do not determine it
        pincal.explain(plain, poses_of_few, **strict)


def test_models_that_cannot_be_compared_are_said_to_be() -> None:
    plain, noise, data = plain_rows(9)
    found = pincal.explain(plain, data, noise=noise, folds=2, terms="backlash", strict=True)
    assert found.verdict == "not compared"
    assert found.terms == ()
    assert "models cannot be compared" in str(found)


def test_folds_are_those_asked_for() -> None:
    plain = pincal.load_mechanism("3RRR")
    data, _ = _with_a_warm_leg(plain)
    said: list[str] = []
    noise = pincal.Noise(2e-5, 2e-5, 2e-5)
    more = {"noise": noise, "terms": "leg_1=backlash", "progress": said.append}
    pincal.explain(plain, data, folds=2, **more)
    assert "models on held-out rows, fold 2 of 2" in said
    with pytest.raises(MeasurementError, match="at least two folds"):
        pincal.explain(plain, data, folds=1)


def test_a_joint_about_the_vertical_has_no_term_of_gravity() -> None:
    """Its load is a rounding error, which would be scaled to a column of chance."""
    arm = replace(loaded("ur5"), load=Load(5.0, (0.03, 0.0, 0.05)))
    readings = np.random.default_rng(0).uniform(-1.2, 1.2, (20, 6))
    data = pincal.Measurements(poses=pincal.forward(arm, readings).poses, readings=readings)
    _, ids = with_terms(arm, data, parse_terms(["gravity"], arm))
    pan, *others, every = ids.values()
    assert pan == ()
    assert all(len(own) == 1 for own in others)
    assert every == tuple(id_ for own in others for id_ in own)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: pincal.Power(2.5, 1.0), "a power: expected a whole number; got 2.5"),
        (lambda: pincal.Power(2, 1.0, np.nan), "a power's centre is nan; expected a finite number"),
        (lambda: pincal.Share(1.0, np.nan), "reference is nan; expected a finite number"),
        (lambda: pincal.Share(np.inf), "is inf; expected a finite number"),
        (lambda: pincal.Harmonic(np.nan, "sine"), "order is nan; expected a number above 0"),
    ],
)
def test_numbers_of_a_form_are_finite(make: Callable[[], object], words: str) -> None:
    with pytest.raises(MechanismError, match=words):
        make()
