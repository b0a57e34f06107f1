"""Planes, lines, circles and spheres: what a probe, a gauge, a ring or a ball bar measures.

Readings are closed forms of a five-bar and a linear delta at points of features that are laid out
here: nothing of the data is computed by pincal.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import done
from differences import assert_observed
from known_machines import READINGS, disturbed, shape_error
from marks import quick
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import pincal
from pincal.estimation.observation import Observation

Array = NDArray[np.float64]
PLATES = "ABCD"


def _measured(
    kind: str, true: Array, points: Array, names: Array, gauges: Array | None = None
) -> pincal.Measurements:
    """Return readings at points that meet features of some names, gauges reading from the first."""
    robot = pincal.load_mechanism(kind)
    readings = READINGS[kind](robot, true, points)
    ok = np.isfinite(readings).all(axis=1)
    read = {} if gauges is None else {next(iter(GAUGE)): gauges[ok]}
    return pincal.Measurements(
        poses=np.full((int(ok.sum()), points.shape[1]), np.nan),
        readings=readings[ok],
        contacts={"plate": tuple(names[ok].tolist())},
        extra=read,
    )


GAUGE = {"plate_z": "m"}


def _plates(
    seed: int, noise: float = 0.0, rows: int = 24, gauge: bool = False
) -> tuple[pincal.Mechanism, Array, pincal.Measurements]:
    """Return a delta, true parameters, and readings at four tilted plates at several heights.

    A gauge reads up to 2 mm along their normals. Else the probe stops at the plate but for noise.
    """
    robot, true = disturbed("linear_delta", seed)
    rng, base = np.random.default_rng(seed), pincal.sample_workspace(robot, 400, seed=seed)
    points, off = [], 2e-3 * gauge * rng.uniform(-1.0, 1.0, len(PLATES) * rows)
    for share, deviations in zip((0.2, 0.4, 0.6, 0.8), off.reshape(-1, rows), strict=True):
        normal = np.append(rng.uniform(-0.1, 0.1, 2), 1.0)
        normal /= np.linalg.norm(normal)
        places = base[rng.permutation(len(base))[:rows]]
        places[:, 2] = np.quantile(base[:, 2], share) - places[:, :2] @ normal[:2] / normal[2]
        missed = deviations + noise * (not gauge) * rng.standard_normal(rows)
        points.append(places + missed[:, None] * normal)
    read = off + noise * rng.standard_normal(len(off)) if gauge else None
    names = np.repeat(list(PLATES), rows)
    return robot, true, _measured("linear_delta", true, np.concatenate(points), names, read)


def _plane(points: str = PLATES, **more: object) -> pincal.Setup:
    contact = pincal.Contact(dict.fromkeys(points), shape="plane", **more)
    return pincal.Setup(contacts={"plate": contact})


def _elsewhere(kind: str, true: Array, seed: int = 99) -> tuple[Array, Array]:
    """Return readings and points of a true machine over its workspace."""
    robot = pincal.load_mechanism(kind)
    points = pincal.sample_workspace(robot, 60, seed=seed)
    readings = READINGS[kind](robot, true, points)
    ok = np.isfinite(readings).all(axis=1)
    return readings[ok], points[ok]


@pytest.mark.parametrize("gauge", quick(1, [True, False]))
def test_machine_is_found_by_flatness_alone(gauge: bool) -> None:
    """Exact points on four plates at unknown places: the machine is the true one to 1e-9.

    But for where its base is, which is named. A gauge reads 2 mm to either side of them.
    """
    robot, true, data = _plates(1, gauge=gauge)
    result = pincal.calibrate(robot, data, setup=_plane(gauge=gauge), noise=pincal.Noise(1e-6))
    assert result.converged
    assert result.reduced_chi2 < 1e-12
    assert [free.code for free in result.gauge] == ["gauge-base-frame"]
    readings, points = _elsewhere("linear_delta", true)
    assert shape_error(robot, readings, points) > 1e-4
    assert shape_error(result.identified, readings, points) < 1e-9


def _on(shape: str, centre: Array, rng: np.random.Generator) -> Array:
    """Return 30 points of the plane within 0.12 m of a centre, on a line or a circle of 0.1 m."""
    along = rng.uniform(-np.pi, np.pi, 30)
    if shape == "circle":
        return centre + 0.1 * np.column_stack((np.cos(along), np.sin(along)))
    turn = rng.uniform(-0.4, 0.4)
    return centre + np.outer(0.035 * along, [np.cos(turn), np.sin(turn)])


@pytest.mark.parametrize(
    ("shape", "radius"), quick(1, [("circle", 0.1), ("circle", None), ("line", None)])
)
def test_planar_machine_is_found_by_rings_or_rulers(shape: str, radius: float | None) -> None:
    """A five-bar's pen along four circles or lines: it is the true one to 1e-9, frames aligned.

    A ring of known radius, or of one that is to be found, as are the places of all.
    """
    robot, true = disturbed("5R", 3)
    rng, middle = np.random.default_rng(0), pincal.sample_workspace(robot, 60, seed=4)
    centres = middle.mean(axis=0) + rng.uniform(-0.05, 0.05, (4, 2))
    points = np.concatenate([_on(shape, centre, rng) for centre in centres])
    data = _measured("5R", true, points, np.repeat(list(PLATES), 30))
    contact = pincal.Contact(dict.fromkeys(PLATES), shape=shape, radius=radius)
    setup = pincal.Setup(contacts={"plate": contact})
    result = pincal.calibrate(robot, data, setup=setup, noise=pincal.Noise(1e-8))
    assert result.converged
    assert result.reduced_chi2 < 1e-12
    codes = {free.code for free in result.gauge}
    assert "gauge-base-frame" in codes
    assert ("gauge-scale" in codes) == (radius is None)
    readings, points = _elsewhere("5R", true)
    grown = 1.0 if radius else _grown(result, readings, points)
    assert shape_error(robot, readings, points) > 1e-4
    assert shape_error(result.identified, readings, points / grown) < 1e-9


def _grown(result: pincal.CalibrationResult, readings: Array, points: Array) -> float:
    """Return how much larger points are than where readings take a machine."""
    solution = pincal.forward(result.identified, readings)
    ok = solution.converged
    return float(
        np.linalg.norm(points[ok].std(axis=0)) / np.linalg.norm(solution.poses[ok].std(axis=0))
    )


SPACE = {
    "plane": {"gauge": True, "axis": (0.3, -0.2, 1.0)},
    "line": {"axis": (0.5, 1.0, 0.2)},
    "circle": {"gauge": True, "radius": 0.2},
    "sphere": {},
}
PLANAR = {"line": {"axis": (1.0, 0.4, 0.0)}, "circle": {}}


@pytest.mark.parametrize(
    ("kind", "shape"), [*(("linear_delta", s) for s in SPACE), *(("5R", s) for s in PLANAR)]
)
def test_misses_and_their_derivatives(kind: str, shape: str) -> None:
    """Misses are distances from features laid out here; derivatives are differences, to 1e-7."""
    robot, rng = pincal.load_mechanism(kind), np.random.default_rng(5)
    points, space = pincal.sample_workspace(robot, 8, seed=1), robot.platform.space
    options = (SPACE if space == 3 else PLANAR)[shape]
    contact = pincal.Contact({"A": None, "B": (0.01, 0.02, 0.0)}, "pen", shape=shape, **options)
    targets = {"pen": pincal.Target((0.01, 0.02, 0.0), unknown=True)}
    setup = pincal.Setup(unknown_frame=True, targets=targets, contacts={"edge": contact})
    data = pincal.Measurements(
        poses=np.full(points.shape, np.nan),
        readings=np.zeros((8, len(robot.reading_names))),
        contacts={"edge": tuple("AB" * 4)},
        extra={name: np.zeros(8) for name in setup.read_lengths},
    )
    observation = Observation(robot, data, setup)
    outside = observation.external
    values = outside.moved(outside.start, 0.1 * rng.standard_normal(len(outside)))
    matrices = robot.platform.matrices(points)
    assert_observed(observation, robot.platform, matrices, values)
    seen = values.frame @ matrices
    tips = seen[:, :3, 3] + seen[:, :3, :3] @ values.offsets[1]
    placed = dict(zip(outside.names, outside.coordinates(values), strict=True))
    missed = dict(zip(observation.names, observation.residuals(matrices, values)[0].T, strict=True))
    axis = np.array(contact.axis or (0.0, 0.0, 1.0))
    z = axis / np.linalg.norm(axis)
    x = np.array([1.0, 0.0, 0.0]) if not z[:2].any() else np.cross([0.0, 0.0, 1.0], z)
    axes = np.column_stack((x / np.linalg.norm(x), np.cross(z, x / np.linalg.norm(x)), z))
    for name in "AB":
        place = np.array([placed.get(f"edge_{name}.{c}", 0.0) for c in "xyz"])
        place = axes @ place if name == "A" else np.array([0.01, 0.02, 0.0])
        turn = Rotation.from_euler("XY", [placed.get(f"edge_{name}.r{c}", 0.0) for c in "xy"])
        d = axes @ turn.as_matrix()[:, 2]  # its direction
        rays = tips[[i for i, met in enumerate("AB" * 4) if met == name]] - place
        height, across = rays @ d, np.linalg.norm(np.cross(rays, d), axis=1)
        radius = placed.get(f"edge_{name}.radius", contact.radius or 0.0)
        expected = {
            "plane": {"z": height},
            "line": {"xy": across},
            "circle": {"r": across - radius, "z": height},
            "sphere": {"r": np.linalg.norm(rays, axis=1) - radius},
        }[shape]
        for ways, lengths in expected.items():
            parts = [
                missed[f"edge_{w}"]["AB".index(name) :: 2] for w in ways if f"edge_{w}" in missed
            ]
            if parts:
                off = parts[0] if len(ways) == 1 else np.linalg.norm(parts, axis=0)
                np.testing.assert_allclose(off, lengths, rtol=0.0, atol=1e-14)


@pytest.mark.slow
@pytest.mark.parametrize("gauge", [False, True])
def test_errors_are_as_forecast(gauge: bool) -> None:
    """Of 20 sets with 5 µm of noise: true errors are the forecast and the promise, within 1.3."""
    squares, forecasts, promised = [], [], []
    for seed in range(20):
        robot, true, data = _plates(seed, 5e-6, gauge=gauge)
        setup, noise = _plane(gauge=gauge, noise=5e-6), pincal.Noise(1e-4)
        result = pincal.calibrate(robot, data, setup=setup, noise=noise)
        assert result.converged
        readings, points = _elsewhere("linear_delta", true)
        squares.append(shape_error(result.identified, readings, points) ** 2)
        plan = pincal.Plan(pincal.forward(robot, data.readings).poses, contacts=data.contacts)
        forecast = pincal.forecast(robot, plan, noise, tuple(setup.required), setup)
        places = pincal.forward(robot, readings).poses
        forecasts.append(forecast.platform_error(places).position ** 2)
        promised.append(result.expected_error(places).position ** 2)
    ratios = [np.sqrt(np.mean(squares) / np.mean(expected)) for expected in (forecasts, promised)]
    assert all(1 / 1.3 < ratio < 1.3 for ratio in ratios), ratios


@pytest.mark.slow
def test_a_point_of_another_plate_is_named() -> None:
    """Two of 96 rows with the name of another plate: these are named, and the fit without right."""
    robot, _, data = _plates(2, 1e-5)
    names = list(data.contacts["plate"])
    names[3], names[60] = "C", "A"
    wrong = replace(data, contacts={"plate": tuple(names)})
    noise = pincal.Noise(1e-5)
    result = pincal.calibrate(robot, wrong, setup=_plane(), noise=noise, loss="reject")
    assert result.converged
    assert sorted(outlier.row for outlier in result.outliers) == [3, 60]


def test_what_cannot_be_met_is_refused() -> None:
    """Too few rows, a gauge without its column, shapes that are none: said with the remedy."""
    robot, _, data = _plates(0)
    few = data.rows([row for row in range(len(data)) if row > 23 or row < 3])

    def trouble(data: pincal.Measurements, setup: pincal.Setup) -> str:
        with pytest.raises(pincal.MeasurementError) as error:
            pincal.calibrate(robot, data, setup=setup)
        return " ".join(str(error.value).split())

    assert "3 rows touch plate 'A'" in trouble(few, _plane())
    assert "at least 4 poses" in trouble(few, _plane())
    assert "no column 'plate_z', which a gauge reads" in trouble(data, _plane(gauge=True))
    assert "plate 'B' is no point" in trouble(data, _plane("ACD"))
    for options in (
        {"shape": "cone"},
        {"shape": "plane", "radius": 0.1},
        {"shape": "line", "gauge": True},
        {"shape": "circle", "radius": 0.0},
        {"axis": (0.0, 0.0, 1.0)},
        {"shape": "plane", "axis": (0.0, 0.0, 0.0)},
    ):
        with pytest.raises(pincal.MeasurementError):
            pincal.Contact({"A": None}, **options)
    five_bar, true = disturbed("5R", 0)
    on = _measured("5R", true, pincal.sample_workspace(five_bar, 20), np.full(20, "A"))
    with pytest.raises(pincal.MeasurementError, match="a planar machine meets no plane"):
        pincal.calibrate(five_bar, on, setup=_plane("A"))


SETUP = """pincal_setup: 1
contacts:
  plate:
    shape: plane
    points: {A: unknown, B: unknown, C: unknown, D: [0.0, 0.0, 0.1]}
    axis: [0.0, 0.0, 1.0]
    gauge: true
    noise: 5.0e-6
"""


@pytest.mark.slow
def test_plates_from_plan_to_report(tmp_path: Path) -> None:
    """A plan is chosen at plates, forecast, simulated, written into its sheet half, calibrated."""
    (tmp_path / "setup.yaml").write_text(SETUP)
    plan, sheet, measured = (tmp_path / f"{n}.csv" for n in ("plan", "sheet", "measured"))
    known = ("--setup", tmp_path / "setup.yaml", "--noise-position", "50um")
    known_plan = ("--count", 76, "--verify", 4, "-o", plan, "--sheet", sheet)
    done("select", "linear_delta", *known, *known_plan)
    header, *blank = [line.split(",") for line in sheet.read_text().splitlines()]
    assert header[-4:] == ["plate_z [mm]", *(f"leg_{n} [mm]" for n in (1, 2, 3))]
    assert {f"planned_{axis} [mm]" for axis in "xyz"} < {*header}
    assert {line[header.index("plate")] for line in blank} == {*PLATES}
    assert all(line[-4:] == [""] * 4 for line in blank)
    forecast = done("identifiability", "linear_delta", plan, *known)
    assert "measured: plate_z" in " ".join(forecast.out.split())
    done("simulate", "linear_delta", plan, *known, "-o", measured)
    head, *rows = [line.split(",") for line in measured.read_text().splitlines()]
    assert {"plate", "plate_z [m]", *(f"leg_{n} [m]" for n in (1, 2, 3))} < {*head}
    assert {"x [m]", "z [m]"}.isdisjoint(head)
    for line, row in zip(blank[:60], rows, strict=False):
        cells = dict(zip(head, row, strict=True))
        for place, name in enumerate(header[-4:], len(header) - 4):
            line[place] = repr(1e3 * float(cells[name.replace("[mm]", "[m]")]))
    sheet.write_text("\n".join(map(",".join, [header, *blank])))
    done("calibrate", "linear_delta", sheet, *known, "-o", tmp_path / "result")
    result = pincal.load_result(tmp_path / "result")
    assert result.options.setup == pincal.Setup.from_yaml(tmp_path / "setup.yaml")
    assert not result.contradictions
    assert result.validation is not None
    assert {part.name for part in result.observed} == {f"plate_{name}_z" for name in PLATES}
    assert 0.7 < result.reduced_chi2 < 1.3
    named = {part.id for part in result.external}
    assert named == {f"plate_{name}.{c}" for name in "ABC" for c in ("z", "rx", "ry")}
