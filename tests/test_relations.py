"""Distances between poses: a calliper on plotted marks calibrates, no pose being measured.

Readings are closed forms of a five-bar and a linear delta, distances those of points: nothing of
the data is computed by pincal.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import openpyxl
import pytest
from command_line import done, run
from differences import assert_observed
from known_machines import machine, shape_error
from scipy.optimize import least_squares

import pincal
from pincal.estimation.observation import Observation

Array = np.ndarray
MARKS, NOISE = 20, 5e-5


KINDS = ("5R", "linear_delta")


def _pairs(points: Array, noise: float, seed: int) -> list[tuple[int, int, float]]:
    """Return rows a and b, from 1, of all pairs of points, and their distances with noise."""
    rng = np.random.default_rng(seed)
    a, b = np.triu_indices(len(points), 1)
    apart = np.linalg.norm(points[a] - points[b], axis=1) + noise * rng.standard_normal(len(a))
    return [*zip((a + 1).tolist(), (b + 1).tolist(), apart.tolist(), strict=True)]


def _written(
    folder: Path, robot: pincal.Mechanism, readings: Array, pairs: list[tuple[int, int, float]]
) -> tuple[Path, Path]:
    """Return files of readings and of pairs."""
    rows, table = folder / "rows.csv", folder / "pairs.csv"
    nothing = np.full((len(readings), robot.platform.dof), np.nan)
    pincal.Measurements(poses=nothing, readings=readings).to_csv(rows, robot, force=True)
    lines = (f"{a},{b},{1e3 * apart!r}" for a, b, apart in pairs)
    table.write_text("\n".join(["row a,row b,distance [mm]", *lines]))
    return rows, table


def _measured(
    folder: Path, kind: str, noise: float, seed: int
) -> tuple[pincal.Mechanism, Array, pincal.Measurements, Array, Array]:
    """Return nominal machine, true parameters, measurements, and readings and points elsewhere."""
    robot, true, points, readings = machine(kind, seed)
    files = _written(folder, robot, readings[:MARKS], _pairs(points[:MARKS], noise, seed))
    data = pincal.Measurements.from_csv(files[0], robot, pairs=files[1], partial=True)
    return robot, true, data, readings[MARKS:], points[MARKS:]


@pytest.mark.parametrize("kind", KINDS)
def test_machine_is_found_by_distances_alone(kind: str, tmp_path: Path) -> None:
    """Exact distances of 20 marks: the machine goes elsewhere as the true one does, to 1e-9.

    But for where its base is; that is named.
    """
    robot, _, data, readings, points = _measured(tmp_path, kind, 0.0, 1)
    result = pincal.calibrate(robot, data, noise=pincal.Noise(1e-6))
    assert result.converged
    assert result.reduced_chi2 < 1e-12
    assert [free.code for free in result.gauge] == ["gauge-base-frame"]
    assert shape_error(robot, readings, points) > 1e-4
    assert shape_error(result.identified, readings, points) < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_errors_are_as_forecast(kind: str, tmp_path: Path) -> None:
    """Of 20 sets with 0.05 mm of noise: true errors of the platform within 1.3 of the forecast."""
    squares, forecasts, promised = [], [], []
    noise = pincal.Noise(NOISE)
    for seed in range(20):
        robot, _, data, readings, points = _measured(tmp_path, kind, NOISE, seed)
        result = pincal.calibrate(robot, data, noise=noise)
        assert result.converged
        squares.append(shape_error(result.identified, readings, points) ** 2)
        poses = pincal.forward(robot, data.readings).poses
        plan = pincal.Plan(poses, contacts=data.contacts)
        forecast = pincal.forecast(robot, plan, noise, (*data.extra, "row"))
        reached = pincal.forward(robot, readings)
        places = reached.poses[reached.converged]
        forecasts.append(forecast.platform_error(places).position ** 2)
        promised.append(result.expected_error(places).position ** 2)
    for expected in (forecasts, promised):
        assert 1 / 1.3 < np.sqrt(np.mean(squares) / np.mean(expected)) < 1.3


def test_derivatives_are_central_differences(tmp_path: Path) -> None:
    """Distances and heights of steps by the pose and by all that is outside, to 1e-7."""
    robot, _, points, readings = machine("linear_delta", 0)
    rows, table = _written(tmp_path, robot, readings[:6], _pairs(points[:6], 0.0, 0))
    lines = table.read_text().splitlines()
    steps = ["row a,row b,distance [mm],dz [mm],dx [mm]", *(f"{x},1.0,2.0" for x in lines[1:])]
    table.write_text("\n".join(steps))
    data = pincal.Measurements.from_csv(rows, robot, pairs=table, partial=True)
    targets = {"pen": pincal.Target((0.01, 0.02, -0.03), unknown=True)}
    setup = pincal.Setup(unknown_frame=True, targets=targets, mark="pen")
    observation = Observation(robot, data, setup.of_rows(data.contacts))
    outside, rng = observation.external, np.random.default_rng(0)
    values = outside.moved(outside.start, 0.1 * rng.standard_normal(len(outside)))
    matrices = robot.platform.matrices(points[:6])
    assert len({name[:2] for name in observation.setup.between_rows}) == 3
    assert_observed(observation, robot.platform, matrices, values)


def test_heights_of_steps_are_those_of_the_second_row(tmp_path: Path) -> None:
    """Columns dx, dy and dz say where exact points are: nothing is left of a fit.

    A pair whose rows are swapped is named.
    """
    robot, _, points, readings = machine("linear_delta", 3)
    rows, table = tmp_path / "rows.csv", tmp_path / "pairs.csv"
    _written(tmp_path, robot, readings[:MARKS], [])
    lines = ["row a,row b,dx [mm],dy [mm],dz [mm]"]
    for a, b, _ in _pairs(points[:MARKS], 0.0, 0)[::2]:
        cells = (1e3 * (points[b - 1] - points[a - 1])).tolist()
        lines.append(",".join(map(repr, (a, b, *cells))))
    table.write_text("\n".join(lines))
    data = pincal.Measurements.from_csv(rows, robot, pairs=table, partial=True)
    result = pincal.calibrate(robot, data, noise=pincal.Noise(1e-6))
    assert result.converged
    assert result.reduced_chi2 < 1e-12
    assert {part.name for part in result.observed} == {"dx", "dy", "dz"}
    first, second, rest = lines[9].split(",", 2)
    table.write_text("\n".join([*lines[:9], f"{second},{first},{rest}", *lines[10:]]))
    data = pincal.Measurements.from_csv(rows, robot, pairs=table, partial=True)
    with pytest.raises(
        pincal.MeasurementError, match=r"the dx from row 1 to row \d+ is .* rows swapped"
    ):
        pincal.calibrate(robot, data, noise=pincal.Noise(1e-6))


@pytest.mark.slow
def test_wrong_pairs_are_named(tmp_path: Path) -> None:
    """A pair typed twice, of one row, of no row, in inches: refused, by its rows.

    One that is 3 mm off is named by both of its rows, and left out by `--loss reject`. One of the
    only row to verify is named by the other row.
    """
    robot, _, points, readings = machine("linear_delta", 2)
    pairs = _pairs(points[:MARKS], NOISE, 2)
    a, b, apart = pairs[7]

    def calibrated(
        changed: list[tuple[int, int, float]], verified: str = "", **options: object
    ) -> pincal.CalibrationResult:
        rows, table = _written(tmp_path, robot, readings[:MARKS], changed)
        data = pincal.Measurements.from_csv(rows, robot, pairs=table, partial=True)
        data = replace(data, sets=(*[""] * (MARKS - 1), verified))
        return pincal.calibrate(robot, data, noise=pincal.Noise(NOISE), **options)

    for changed, message in (
        (
            [*pairs, (b, a, apart)],
            "line 192: the distance of rows 9 and 1 is the same as in line 9",
        ),
        ([*pairs, (4, 4, apart)], "line 192: row '4' is measured from itself"),
        ([*pairs, (4, 40, apart)], "line 192: row '40' is no row of"),
        ([(a, b, -apart), *pairs], "line 2: a distance is above 0"),
        ([], "a header but no rows"),
        ([*pairs[:7], (a, b, apart / 25.4), *pairs[8:]], "25.4 times as much; is it in inches?"),
    ):
        with pytest.raises(pincal.MeasurementError) as error:
            calibrated(changed)
        assert message in " ".join(str(error.value).split())
    off = [*pairs[:7], (a, b, apart + 3e-3), *pairs[8:]]
    (outlier,) = calibrated(off).outliers
    assert {f"row {outlier.row + 1}", outlier.quantity} in (
        {"row 1", "distance to row 9"},
        {"row 9", "distance to row 1"},
    )
    assert 0.9 < calibrated(off, loss="reject").reduced_chi2 < 1.2
    a, b, apart = pairs[MARKS - 2]
    assert (a, b) == (1, MARKS)
    off = [*pairs[: MARKS - 2], (a, b, apart + 3e-3), *pairs[MARKS - 1 :]]
    (remark,) = calibrated(off, "verify").validated().contradictions
    assert remark.code == "wrong-verification"
    assert remark.values["quantity"] == "distance to row 1"


@pytest.mark.parametrize("extended", [True, False])
def test_klippers_measurements_give_klippers_parameters(extended: bool, tmp_path: Path) -> None:
    """41 probed heights, 3 manual ones and 12 distances of a printer.cfg: Klipper's parameters.

    Its cost is Σ (z − height)² n / (½ N) + Σ (d − distance)² of N probed heights and n distances;
    without any, of heights alone, arms held (klippy/extras/delta_calibrate.py). Written out by its
    formulas, positions by three spheres, and minimised by SciPy: to 1e-6 mm.
    """
    rng, way = np.random.default_rng(0), 40.0 / 3200.0  # mm a step
    nominal = np.array([174.75, 210.0, 330.0, 297.05, 297.05, 297.05, 333.0, 333.0, 333.0])
    true = nominal + rng.normal(size=9) * [0.5, 0.2, 0.2, 0.5, 0.5, 0.5, 0.3, 0.3, 0.3]

    def spheres(p: Array) -> tuple[Array, Array, Array]:
        angles = np.radians([p[1], p[2], 90.0])
        towers = p[0] * np.column_stack((np.cos(angles), np.sin(angles)))
        return towers, p[3:6] + np.sqrt(p[6:] ** 2 - p[0] ** 2), p[6:]

    def steps(p: Array, points: Array) -> Array:
        towers, tops, arms = spheres(p)
        level = ((points[:, None, :2] - towers) ** 2).sum(axis=2)
        return np.round((tops - np.sqrt(arms**2 - level) - points[:, 2:]) / way, 3)

    def positions(p: Array, stable: Array) -> Array:
        towers, tops, arms = spheres(p)
        centres = np.concatenate(
            (np.tile(towers, (len(stable), 1, 1)), (tops - stable * way)[:, :, None]), axis=2
        )
        a, b, c = centres.transpose(1, 0, 2)
        ex = (b - a) / np.linalg.norm(b - a, axis=1)[:, None]
        i = (ex * (c - a)).sum(axis=1)
        ey = c - a - i[:, None] * ex
        ey /= np.linalg.norm(ey, axis=1)[:, None]
        d, j = np.linalg.norm(b - a, axis=1), (ey * (c - a)).sum(axis=1)
        x = (arms[0] ** 2 - arms[1] ** 2 + d**2) / (2 * d)
        y = (arms[0] ** 2 - arms[2] ** 2 + i**2 + j**2 - 2 * i * x) / (2 * j)
        z = np.cross(ex, ey) * -np.sqrt(arms[0] ** 2 - x**2 - y**2)[:, None]
        return a + x[:, None] * ex + y[:, None] * ey + z

    turn = np.arange(41) * np.pi * (3 - np.sqrt(5))
    r = 120 * np.sqrt(np.arange(41) / 40)
    bed = np.column_stack((r * np.cos(turn), r * np.sin(turn), np.zeros(41)))
    azimuths = np.radians(np.repeat([210, 270, 330, 30, 90, 150], 2))
    rays = np.column_stack((np.cos(azimuths), np.sin(azimuths), np.zeros(12)))
    ends = np.stack((4.5 * rays, np.where(np.arange(12) % 2, 69.5, 60.0)[:, None] * rays))
    manual = np.array([[30.0, 40.0, 5.0], [-50.0, 20.0, 0.0], [10.0, -60.0, 0.2]])
    stable, far = steps(true, np.vstack((manual, bed))), [steps(true, end) for end in ends]
    heights = np.append(manual[:, 2], np.zeros(41)) + 0.02 * rng.standard_normal(44)
    apart = np.linalg.norm(ends[1] - ends[0], axis=1) + 0.05 * rng.standard_normal(12)
    weight = np.sqrt(len(apart) / (0.5 * 41)) if extended else 1.0

    def missed(free: Array) -> Array:
        p = np.append(free, nominal[len(free) :])
        if not extended:
            return positions(p, stable)[:, 2] - heights
        first, second = (positions(p, end) for end in far)
        distances = np.linalg.norm(second - first, axis=1)
        return np.append(weight * (positions(p, stable)[:, 2] - heights), distances - apart)

    start = nominal if extended else nominal[:6]
    exactly = dict.fromkeys(("xtol", "ftol", "gtol"), 1e-15)
    best = np.append(
        least_squares(missed, start, x_scale="jac", **exactly).x, nominal[len(start) :]
    )
    lines = ["[printer]", "kinematics: delta", f"delta_radius: {nominal[0]}"]
    for name in "abc":
        lines += [f"[stepper_{name}]", "rotation_distance: 40", "microsteps: 16"]
        lines += ["arm_length: 333.0", "position_endstop: 297.05"]
    lines += ["#*# [delta_calibrate]"]
    triple = "{:.3f},{:.3f},{:.3f}".format
    for n, (height, at) in enumerate(zip(heights.tolist(), stable, strict=True)):
        name = f"manual_height{n}" if n < 3 else f"height{n - 3}"
        lines += [f"#*# {name} = {height!r}", f"#*# {name}_pos = {triple(*at)}"]
    for n, (distance, a, b) in enumerate(zip(apart.tolist() * extended, *far, strict=False)):
        lines += [f"#*# distance{n} = {distance!r}"]
        lines += [f"#*# distance{n}_pos1 = {triple(*a)}", f"#*# distance{n}_pos2 = {triple(*b)}"]
    (tmp_path / "printer.cfg").write_text("\n".join(lines))
    done("import", tmp_path / "printer.cfg", "-o", tmp_path / "kossel")
    robot = pincal.load_mechanism(tmp_path / "kossel")
    data = pincal.Measurements.from_csv(tmp_path / "kossel" / "probing.csv", robot, partial=True)
    sigma = np.full((len(data), 3), 5e-5 / weight)
    exact = {"distance_1": np.full(len(data), 5e-5)} if extended else {}
    known = replace(data, sigma_poses=sigma, sigma_extra=exact)
    fixed = [f"{robot.legs[2].name}.angle", *["arm"] * (not extended)]
    options = {"tied": ["radius"], "fixed": fixed}
    result = pincal.calibrate(robot, known, **options)
    assert result.converged
    by_leg = [leg.identified for leg in result.legs]  # radius, angle, arm, endstop of each
    angles = np.degrees([by_leg[0][1], by_leg[1][1]]) % 360.0
    lengths = 1e3 * np.array(
        [by_leg[0][0], *(leg[3] for leg in by_leg), *(leg[2] for leg in by_leg)]
    )
    np.testing.assert_allclose(lengths, np.delete(best, [1, 2]), rtol=0.0, atol=1e-6)
    np.testing.assert_allclose(angles, best[1:3], rtol=0.0, atol=1e-6)


@pytest.mark.slow
def test_distances_from_plan_to_report(tmp_path: Path) -> None:
    """A plan with distances is forecast, simulated, calibrated, explained and diagnosed.

    Half of its rows were not measured: what was measured from them is no more.
    """
    robot, noise = pincal.load_mechanism("5R"), ("--noise-position", "50um")
    robot.save(tmp_path / "bar")
    bar, plan, measured = tmp_path / "bar", tmp_path / "plan.csv", tmp_path / "measured.csv"
    done("select", bar, "--distances", 6, "--count", 24, *noise, "-o", plan)
    assert "distance_6_to" in plan.read_text().partition("\n")[0]
    forecast = " ".join(done("identifiability", bar, plan, *noise).out.split())
    assert "distance_4, …, row_y" in forecast
    done("simulate", bar, plan, *noise, "-o", measured)
    lines = measured.read_text().splitlines()
    assert not {"x [m]", "y [m]"} & set(lines[0].split(","))
    half = tmp_path / "half.csv"
    cells = [line.split(",") for line in lines]
    for row in cells[1::3]:
        row[:] = ["" if "[" in name else cell for name, cell in zip(cells[0], row, strict=True)]
    half.write_text("\n".join(map(",".join, cells)))
    for table in (measured, half):
        typed = ("calibrate", bar, table, *noise, "--folds", 2, "-o", tmp_path / "result")
        out = done(*typed, "--force").out
        assert "best-fit frames" in out
        assert "frames and scale" not in out
        assert "touched" not in out
        result = pincal.load_result(tmp_path / "result")
        assert [part.name for part in result.observed] == ["distance"]
        assert result.validation is not None
        assert not result.contradictions
    assert "works" in done("doctor", bar, measured, *noise).out
    assert "geometry" in done("explain", bar, measured, *noise, "--folds", 2).out


@pytest.mark.parametrize("ending", ["csv", "xlsx"])
def test_sheets_are_read_back_half_filled(ending: str, tmp_path: Path) -> None:
    """A sheet says what to drive to, with cells for what is measured; blank rows are skipped.

    Poses and readings that are written into it are the measurements, in its units.
    """
    robot, sheet = pincal.load_mechanism("5R"), tmp_path / f"sheet.{ending}"
    plan = tmp_path / "plan.csv"
    done("select", "5R", "--count", 6, "--sheet", sheet, "--units", "cm,deg", "-o", plan)
    chosen = pincal.Plan.from_csv(plan, robot)
    filled = 0.01 + np.arange(4.0 * 5).reshape(5, 4)
    if ending == "csv":
        head, *lines = sheet.read_text().splitlines()
        columns, rows = head.split(","), [line.split(",") for line in lines]
        for row, values in zip(rows, filled.tolist(), strict=False):
            row[-4:] = map(repr, values)
        sheet.write_text("\n".join([head, *map(",".join, rows)]))
    else:
        book = openpyxl.load_workbook(sheet)
        columns = [cell.value for cell in book.active[1]]
        for row, values in enumerate(filled.tolist(), start=2):
            for cell, value in zip(book.active[row][-4:], values, strict=True):
                assert cell.value is None
                assert cell.fill.fill_type == "solid"
                cell.value = value
        book.save(sheet)
    assert columns[-4:] == ["x [cm]", "y [cm]", "leg_1 [deg]", "leg_2 [deg]"]
    assert columns[2:6] == [f"planned_{name}" for name in columns[-4:]]
    data = pincal.Measurements.from_csv(sheet, robot)
    np.testing.assert_allclose(data.poses, 1e-2 * filled[:, :2])
    np.testing.assert_allclose(data.readings, np.radians(filled[:, 2:]))
    assert data.sets == chosen.sets[:5]


def test_distances_need_all_legs_at_once(tmp_path: Path) -> None:
    """Pairs beside measured poses are refused where each leg is alone, by what to leave out."""
    rows, table = tmp_path / "rows.csv", tmp_path / "pairs.csv"
    plan = pincal.Plan(pincal.sample_workspace("5R", 12, seed=0))
    pincal.simulate("5R", pincal.load_mechanism("5R"), plan).measurements.to_csv(rows, "5R")
    table.write_text("row a,row b,distance [mm]\n1,2,300\n")
    alone = run("calibrate", "5R", rows, "--pairs", table, "--method", "per-leg", "-o", "r")
    assert alone.code == 2
    assert "leave out --method per-leg" in alone.trouble
