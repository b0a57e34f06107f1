"""What people fill from outside: an instrument, a term of a sensor, a platform kind."""

from __future__ import annotations

import inspect
import typing
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest
from differences import assert_derivative
from measured import validated
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import pincal
from pincal.estimation.observation import Observation
from pincal.estimation.problem import LegBlock
from pincal.estimation.unknowns import BlockRows, State
from pincal.kinematics.closing import sensor_law
from pincal.kinematics.closure import LegClosure

Array = NDArray[np.float64]
EXACT = pincal.Noise(position=0.0, orientation=0.0)


def _own(*parameters: tuple[str, str, float]) -> tuple[pincal.Parameter, ...]:
    return tuple(pincal.Parameter("station", *one) for one in parameters)


@dataclass(frozen=True)
class Station:
    """Reads range and bearing of the platform's origin from a place of unknown x and zero."""

    name: str = "station"
    columns: Mapping[str, str] = field(default_factory=lambda: {"range": "m", "bearing": "rad"})
    parameters: tuple[pincal.Parameter, ...] = _own(("x", "m", -0.5), ("zero", "rad", 0.0))

    def evaluate(self, poses: Array, values: Array, measured: Array) -> tuple[Array, Array, Array]:
        """Return range and bearing less what was read."""
        ray = poses[:, :3, 3] - (values[0], -0.7, 0.3)
        length, flat = np.linalg.norm(ray, axis=1), np.hypot(ray[:, 0], ray[:, 1])
        bearing = np.arctan2(ray[:, 1], ray[:, 0]) + values[1]
        value = np.column_stack((length, bearing)) - measured
        value[:, 1] = (value[:, 1] + np.pi) % (2 * np.pi) - np.pi
        by_pose, by_own = np.zeros((len(ray), 2, 6)), np.zeros((len(ray), 2, 2))
        by_pose[:, 0, :3] = ray / length[:, None]
        by_pose[:, 1, 0], by_pose[:, 1, 1] = -ray[:, 1] / flat**2, ray[:, 0] / flat**2
        by_own[:, :, 0], by_own[:, 1, 1] = -by_pose[:, :, 0], 1.0
        return value, by_pose, by_own


def _measured(
    name: str, frame: Array | None = None, count: int = 25
) -> tuple[pincal.Mechanism, pincal.Mechanism, pincal.Measurements]:
    """Return nominal and true mechanism, and exact measurements with those of a station."""
    robot = pincal.load_mechanism(name)
    truth = pincal.disturb(robot, 1e-3, seed=1)
    rng = np.random.default_rng(0)
    spread = np.array([0.06 if unit == "m" else 0.2 for unit in robot.platform.units])
    poses = robot.platform.home + spread * rng.uniform(-1.0, 1.0, (count, len(spread)))
    data = pincal.simulate(robot, truth, pincal.Plan(poses), EXACT).measurements
    matrices = robot.platform.transforms(data.poses).as_matrix()
    if frame is not None:
        matrices = frame @ matrices
        data = replace(data, poses=robot.platform.from_matrices(matrices))
    nothing = np.zeros((len(data), 2))
    read = Station().evaluate(matrices, np.array([-0.48, 0.02]), nothing)[0]
    extra = dict(zip(Station().columns, read.T, strict=True))
    return robot, truth, replace(data, extra=extra)


def _frame(robot: pincal.Mechanism) -> Array:
    frame = np.eye(4)
    turn = [0.0, 0.0, 0.3] if robot.platform.space == 2 else [0.1, -0.2, 0.3]
    frame[:3, :3] = Rotation.from_rotvec(turn).as_matrix()
    frame[:2, 3] = 0.1, 0.2
    return frame


@pytest.mark.parametrize("name", ["3RRR", "6UPS", "delta", "5R"])
@pytest.mark.parametrize("unknown_frame", [False, True])
def test_conditions_of_instruments_are_differentiated(name: str, unknown_frame: bool) -> None:
    """By pose, by the frame, by targets and by the instrument's own parameters."""
    robot, _, data = _measured(name, count=4)
    setup = pincal.Setup(
        unknown_frame=unknown_frame,
        targets={"platform": pincal.Target((0.01, 0.02, 0.0), unknown=True)},
        instruments=(Station(),),
    )
    seen = Observation(robot, data, setup)
    place = seen.external.start
    if unknown_frame:
        place = replace(place, frame=_frame(robot))
    matrices = robot.platform.transforms(data.poses).as_matrix()
    value, by_pose, by_external = seen.residuals(matrices, place)
    assert value[:, -2:].shape == (4, 2)
    assert_derivative(
        by_pose,
        lambda twist: seen.residuals(
            robot.platform.displaced(matrices, np.tile(twist, (4, 1))), place
        )[0],
    )
    assert_derivative(
        by_external,
        lambda step: seen.residuals(matrices, seen.external.moved(place, step))[0],
    )


@pytest.mark.parametrize("name", ["3RRR", "5R", "delta"])
@pytest.mark.parametrize("unknown_frame", [False, True])
def test_instruments_without_noise_give_the_truth(name: str, unknown_frame: bool) -> None:
    """What the machine does and what the instrument does not know are found to 1e-9."""
    frame = _frame(pincal.load_mechanism(name)) if unknown_frame else None
    robot, truth, data = _measured(name, frame)
    setup = pincal.Setup(unknown_frame=unknown_frame, instruments=(Station(),))
    result = pincal.calibrate(
        robot, data, setup=setup, noise=pincal.Noise(), rough=True, strict=True
    )
    assert result.converged
    assert result["station.x"].identified == pytest.approx(-0.48, abs=1e-9)
    assert result["station.zero"].identified == pytest.approx(0.02, abs=1e-9)
    if not unknown_frame:
        for leg, true in zip(result.identified.legs, truth.legs, strict=True):
            np.testing.assert_allclose(leg.nominal, true.nominal, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("name", ["3RRR", "5R", "delta"])
@pytest.mark.parametrize("unknown_frame", [False, True])
def test_instruments_may_be_far_from_where_they_are_said(name: str, unknown_frame: bool) -> None:
    """The search starts where the poses that everything else gives place them."""
    robot, _, data = _measured(name, _frame(pincal.load_mechanism(name)) if unknown_frame else None)
    far = Station(parameters=_own(("x", "m", -3.0), ("zero", "rad", 2.5)))
    setup = pincal.Setup(unknown_frame=unknown_frame, instruments=(far,))
    result = pincal.calibrate(robot, data, setup=setup, noise=pincal.Noise())
    assert result.converged
    assert result["station.x"].identified == pytest.approx(-0.48, abs=1e-8)
    assert result["station.zero"].identified == pytest.approx(0.02, abs=1e-8)


@pytest.mark.slow
def test_an_instrument_is_known_everywhere(tmp_path: Path) -> None:
    """In files, forecasts, validation, tables and reports."""
    robot, _, data = _measured("3RRR")
    setup = pincal.Setup(instruments=(Station(),))
    data.to_csv(tmp_path / "m.csv", robot, setup=setup)
    heads = (tmp_path / "m.csv").read_text().splitlines()[0].split(",")
    assert {"range [m]", "bearing [rad]"} <= set(heads)
    read = pincal.Measurements.from_csv(tmp_path / "m.csv", robot, setup)
    np.testing.assert_allclose(read.extra["bearing"], data.extra["bearing"])
    result = pincal.calibrate(robot, read, setup=setup, noise=pincal.Noise(1e-4, 1e-4, 0.0))
    assert [one.id for one in result.external] == ["station.x", "station.zero"]
    assert {"range", "bearing"} <= {one.name for one in result.observed}
    assert "station.zero" in result.report().html()
    with pytest.raises(pincal.MeasurementError, match="'station' is code"):
        result.save(tmp_path / "r")
    validation = validated(robot, read, setup=setup, noise=pincal.Noise(1e-4, 1e-4, 0.0))
    assert validation.findings is not None


def test_instruments_that_are_wrong_are_refused() -> None:
    """Each with what was expected."""
    robot, _, data = _measured("3RRR", count=6)
    with pytest.raises(pincal.MeasurementError, match=r"instruments of Setup: .* got \(3,\)"):
        pincal.Setup(instruments=(3,))  # type: ignore[arg-type]
    with pytest.raises(pincal.MeasurementError, match="names no target, contact or other"):
        pincal.Setup(instruments=(Station(), Station()))
    with pytest.raises(pincal.MeasurementError, match="expected m, rad or px"):
        pincal.Setup(instruments=(Station(columns={"range": "mm"}),))
    with pytest.raises(pincal.MeasurementError, match=r"expected 'other\.x'"):
        pincal.Setup(instruments=(Station(name="other"),))
    with pytest.raises(pincal.MeasurementError, match="means something else"):
        pincal.Setup(instruments=(Station(columns={"x": "m"}),)).columns(robot)
    leg = pincal.Setup(instruments=(Station(name="leg_1", parameters=()),))
    with pytest.raises(pincal.MeasurementError, match="like a leg"):
        leg.columns(robot)
    with pytest.raises(pincal.MeasurementError, match="all legs at once"):
        pincal.Options(method="per-leg", setup=pincal.Setup(instruments=(Station(),)))
    more = (*Station().parameters, pincal.Parameter("station", "y", "m", 0.0))
    setup = pincal.Setup(instruments=(Station(parameters=more),))
    with pytest.raises(pincal.MeasurementError, match=r"returned .* of the shapes .*\(6, 2, 3\)"):
        pincal.calibrate(robot, data, setup=setup)
    with pytest.raises(pincal.MeasurementError, match="no column 'range', which instrument"):
        pincal.calibrate(robot, replace(data, extra={}), setup=setup)


def _sine(psi: Array) -> Array:
    return np.sin(3.0 * psi)


def _sine_slope(psi: Array) -> Array:
    return 3.0 * np.cos(3.0 * psi)


def _with_terms(name: str) -> pincal.Mechanism:
    """Return a bundled mechanism of which each sensor has two terms."""
    robot = pincal.load_mechanism(name)
    legs = []
    for leg in robot.legs:
        sine = pincal.Term("a", _sine, _sine_slope, leg.reading_units[0])
        square = pincal.Term("b", np.square, lambda psi: 2.0 * psi, "1")
        sensor = replace(leg.sensors[0], terms=(sine, square))
        values = (*leg.parameters, ("a", 0.02), ("b", -0.01))
        legs.append(replace(leg, sensors=(sensor,), parameters=values))
    return replace(robot, legs=tuple(legs))


@pytest.mark.parametrize("name", ["3RRR", "5R", "6UPS", "delta"])
def test_terms_of_sensors_are_differentiated(name: str) -> None:
    """Demands by reading and by every parameter; readings and positions are each other's."""
    robot = _with_terms(name)
    leg = robot.legs[0]
    matrices = robot.platform.transforms([robot.platform.home]).as_matrix()
    psi = pincal.inverse(robot, [robot.platform.home]).readings[:, :1]
    law = sensor_law(LegClosure(leg, robot.platform))
    np.testing.assert_allclose(law.reading(law.position(psi)), psi, rtol=0.0, atol=1e-14)

    def demand(step: Array, readings: Array) -> BlockRows:
        row = np.arange(1)
        used, sigma = np.ones((1, 1), dtype=bool), np.zeros((1, 1))
        block = LegBlock((leg,), robot.platform, readings, {}, row, used, sigma)
        return block.evaluate(State(leg.nominal + step, matrices))

    n = len(leg.nominal)
    here = demand(np.zeros(n), psi)
    assert_derivative(here.by_parameter, lambda step: demand(step, psi).value, precision=1e-13)
    assert_derivative(
        here.by_measured, lambda step: demand(np.zeros(n), psi + step).value, precision=1e-13
    )


def test_terms_without_noise_are_found() -> None:
    """Inverse and forward kinematics, simulation and calibration know them."""
    robot = _with_terms("3RRR")
    truth = pincal.disturb(robot, 1e-3, seed=3)
    rng = np.random.default_rng(0)
    poses = robot.platform.home + [0.06, 0.06, 0.3] * rng.uniform(-1.0, 1.0, (40, 3))
    readings = pincal.inverse(truth, poses).readings
    np.testing.assert_allclose(pincal.forward(truth, readings, poses).poses, poses, atol=1e-10)
    data = pincal.simulate(robot, truth, pincal.Plan(poses), EXACT).measurements
    result = pincal.calibrate(robot, data, noise=pincal.Noise(), strict=True)
    for leg, true in zip(result.identified.legs, truth.legs, strict=True):
        np.testing.assert_allclose(leg.nominal, true.nominal, rtol=0.0, atol=1e-9)


def test_terms_turn_with_their_legs_and_are_not_saved(tmp_path: Path) -> None:
    """A leg that is carried by a mirror reads as the mirror image does."""
    robot = _with_terms("3RRR")
    with pytest.raises(pincal.MechanismError, match="'a' is code"):
        robot.save(tmp_path / "r")
    five = _with_terms("5R")
    turns = (pincal.cyclic(1)[0], pincal.Element.mirror(np.pi / 2))
    pair = pincal.generate("pair", five.legs[0], turns, five.platform, "Two legs, mirrored.")
    poses = five.platform.home + np.array([[0.01, 0.02], [-0.02, 0.01]])
    here, there = (pincal.inverse(pair, one).readings for one in (poses, poses * [-1.0, 1.0]))
    np.testing.assert_allclose(here, there[:, ::-1], rtol=0.0, atol=1e-12)
    assert len(pincal.symmetry_group(pair).elements) == 2


def test_public_names_are_there() -> None:
    """All that is public is found at the top, with types that resolve, and nothing else is."""
    for name in pincal.__all__:
        assert getattr(pincal, name).__name__ == name
        assert name in dir(pincal)
        if inspect.isfunction(getattr(pincal, name)):
            typing.get_type_hints(getattr(pincal, name))  # types that a tool can resolve
    with pytest.raises(AttributeError, match="nothing"):
        pincal.nothing  # noqa: B018


def test_coordinates_of_placements_are_checked() -> None:
    """A wrong number of values, or a coordinate that is none, is refused by name."""
    p = {"a": 0.3}
    with pytest.raises(pincal.MechanismError, match=r"takes 2 value\(s\), got \['a'\]"):
        pincal.Placement.of(p, polar="a")
    with pytest.raises(pincal.MechanismError, match="unknown coordinate: 'radius'"):
        pincal.Placement.of(p, radius="a")
