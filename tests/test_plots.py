"""Plots of a result show the result's numbers, into axes that are given or new."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from arms import robot
from command_line import done, run
from lxml import etree
from marks import quick
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import pincal
from pincal.show.tables import parameters_table

NOISE = pincal.Noise(1e-4, 1e-4)


@pytest.fixture(scope="module")
def result() -> pincal.CalibrationResult:
    """Calibration of a 5R with one parameter fixed."""
    mechanism = pincal.load_mechanism("5R")
    truth = pincal.disturb(mechanism, 2e-3, seed=1)
    shift = np.random.default_rng(2).uniform(-0.3, 0.3, (30, 2))
    plan = pincal.Plan(mechanism.platform.home + shift)
    data = pincal.simulate(mechanism, truth, plan, NOISE, 3).measurements
    return pincal.calibrate(mechanism, data, noise=NOISE, fixed=["leg_1.k"])


def test_residuals_in_standard_deviations(result: pincal.CalibrationResult) -> None:
    """One series a leg, each residual over σ√(1−h) of its leverage h at its row."""
    axes = result.plot.residuals()
    for leg, line in zip(result.legs, axes.lines, strict=False):
        np.testing.assert_array_equal(line.get_xdata(), leg.rows + 1)
        spread = leg.sigma * np.sqrt(leg.redundancy)
        np.testing.assert_allclose(line.get_ydata(), leg.residuals / spread)
    assert axes.get_xlabel() == "data row"


def test_axes_that_are_given_are_drawn_into(result: pincal.CalibrationResult) -> None:
    """And returned; names that matplotlib would hide stay visible."""
    hidden = tuple(replace(leg, name=f"_{leg.name}") for leg in result.legs)
    figure = Figure()
    axes = figure.subplots()
    assert isinstance(axes, Axes)
    assert replace(result, legs=hidden).plot.residuals(axes) is axes
    assert result.plot.residuals(ax=axes) is axes


def test_command_draws_every_chart(result: pincal.CalibrationResult) -> None:
    """``pincal plot`` has a kind for each chart of ``result.plot``, and each says what it is."""
    kinds = {name for name in dir(result.plot) if not name.startswith("_")} - {"result"}
    (offered,) = re.findall(r"KIND +One of ([\w, ]+)\.", done("plot", "--help").out)
    assert kinds == set(offered.split(", "))
    assert all(getattr(result.plot, name).__doc__ for name in kinds)


#: Mechanism, noise, and how it is calibrated.
CASES = {
    "per-leg": ("5R", NOISE, {"method": "per-leg"}),
    "all-legs": ("5R", NOISE, {}),
    "noisy readings": ("5R", pincal.Noise(1e-4, 1e-4, 1e-4), {}),
    "arm": ("arm", NOISE, {}),
    "cables": ("4cable", pincal.Noise(0.0, 0.0, 1e-4), {"fixed": ["k"]}),
}
ARM = """
j1 | revolute | 0 0 1 | 0 0 0.1
j2 | revolute | 0 1 0 | 0 0 0.2
j3 | revolute | 1 0 0 | 0.4 0 0
j4 | revolute | 0 1 0 | 0.3 0 0.1
"""


@pytest.mark.parametrize("case", quick(3, CASES))
def test_every_kind_of_result_plots(case: str, tmp_path: Path) -> None:
    """Legs alone and together, exact and noisy readings, an arm, a machine without poses."""
    name, noise, options = CASES[case]
    if name == "arm":
        (tmp_path / "arm.urdf").write_text(robot(ARM), encoding="utf-8")
        mechanism = pincal.Mechanism.from_urdf(tmp_path / "arm.urdf", "l4")
        plan = pincal.sample_configurations(mechanism, 40, 0)
    else:
        mechanism = pincal.load_mechanism(name)
        shift = np.random.default_rng(2).uniform(-0.3, 0.3, (60, mechanism.platform.dof))
        plan = pincal.Plan(mechanism.platform.home + shift)
    truth = pincal.disturb(mechanism, 1e-3, seed=1)
    data = pincal.simulate(mechanism, truth, plan, noise, 3).measurements
    if name == "4cable":
        data = replace(data, poses=np.full_like(data.poses, np.nan))
    result = pincal.calibrate(mechanism, data, noise=noise, **options)
    shown = result.plot.residuals()
    white = np.concatenate([line.get_ydata() for line in shown.lines])
    assert 0.7 < np.sqrt(np.nanmean(white**2)) < 1.3
    assert np.isfinite(white).mean() > 0.9
    result.save(tmp_path / "result")
    lines = (tmp_path / "result/residuals.csv").read_text(encoding="utf-8").splitlines()
    assert lines[0] == "leg,row,quantity,unit,residual,sigma"
    residuals = np.array([float(line.split(",")[4]) for line in lines[1:]])
    assert (np.abs(residuals) > 1e-9).mean() > 0.95


def test_changes_move_the_platform_by_what_perturbed_machines_do(
    result: pincal.CalibrationResult,
) -> None:
    """The first row: what the platform is off by if that parameter alone is wrong by its change."""
    first, *others = parameters_table(result).rows
    longest, p = first[-1], result[first[0]]
    leg, _, own = p.id.rpartition(".")
    other = result.identified.leg(leg)
    moved = [v + p.change * (n == own) for n, v in other.nominal_by_name.items()]
    wrong = result.identified.with_parameters({leg: np.array(moved)})
    poses = pincal.sample_configurations(result.nominal, 300)
    off = pincal.accuracy(result.identified, wrong, poses).position
    assert longest == pytest.approx(off, rel=0.03)  # to first order
    assert len(others) + 1 == sum(p.high > p.low for leg in result.legs for p in leg.parameters)


def test_command_draws_across_a_page(result: pincal.CalibrationResult, tmp_path: Path) -> None:
    """A vector figure 170 mm wide, letters of 7 to 9 points; wrong kinds say which."""
    result.save(tmp_path / "result")
    done("plot", tmp_path / "result", "residuals", "-o", tmp_path / "r.svg")
    root = etree.parse(tmp_path / "r.svg").getroot()
    assert float(root.get("width").removesuffix("pt")) == pytest.approx(170 / 25.4 * 72, abs=0.5)
    styles = [text.get("style") for text in root.iter("{*}text")]
    sizes = {float(size) for one in styles for size in re.findall(r"([\d.]+)px", one)}
    assert sizes
    assert min(sizes) >= 7.0
    assert max(sizes) <= 9.0
    wrong = run("plot", tmp_path / "result", "nothing", "-o", tmp_path / "n.svg")
    assert wrong.code == 2
    assert "residuals" in wrong.err
    assert "Value error" not in wrong.err
    assert not (tmp_path / "n.svg").exists()
