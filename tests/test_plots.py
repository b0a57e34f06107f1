"""Plots of a result show the result's numbers, into axes that are given or new."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from arms import robot
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import pincal
from pincal.show.plots import Plots

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
    """One series a leg, each residual over its standard deviation at its row."""
    axes = result.plot.residuals()
    for leg, line in zip(result.legs, axes.lines, strict=False):
        np.testing.assert_array_equal(line.get_xdata(), leg.rows + 1)
        np.testing.assert_allclose(line.get_ydata(), leg.residuals / leg.sigma)
    assert axes.get_xlabel() == "data row"


def test_changes_over_their_uncertainty(result: pincal.CalibrationResult) -> None:
    """A bar for each parameter that was identified, none for one that was fixed."""
    axes = result.plot.parameters()
    for leg, bars in zip(result.legs, axes.containers, strict=True):
        free = [p for p in leg.parameters if p.given != "fixed"]
        heights = [2 * (p.identified - p.nominal) / (p.high - p.low) for p in free]
        np.testing.assert_allclose([bar.get_height() for bar in bars], heights)
    assert len(axes.containers[0]) == len(axes.containers[1]) - 1


def test_correlations(result: pincal.CalibrationResult) -> None:
    """The image holds the correlations of all that was identified, its axes the ids."""
    axes = result.plot.correlation()
    (image,) = axes.images
    free = np.diagonal(result.covariance) > 0.0
    own = result.covariance[np.ix_(free, free)]
    std = np.sqrt(np.diagonal(own))
    np.testing.assert_allclose(image.get_array(), own / np.outer(std, std))
    names = [label.get_text() for label in axes.get_xticklabels()]
    assert len(names) == free.sum()
    assert names[0].startswith("leg_1.")
    assert "leg_1.k" not in names


def test_expected_errors_over_the_workspace(
    result: pincal.CalibrationResult, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A pixel's value is the expected error there; without a workspace it is refused."""
    axes = result.plot.error_map()
    image = axes.images[0]
    values, (left, right, low, high) = image.get_array(), image.get_extent()
    place = tuple(np.argwhere(np.isfinite(values.filled(np.nan)))[40])
    x = left + (right - left) * (place[1] + 0.5) / values.shape[1]
    y = low + (high - low) * (place[0] + 0.5) / values.shape[0]
    expected = result.expected_error(np.array([[x, y]]))
    assert values[place] == pytest.approx(1e3 * expected.position, rel=1e-6)

    def fail(*_: object) -> None:
        raise pincal.WorkspaceError("none")

    monkeypatch.setattr("pincal.show.workspace_errors.sample_configurations", fail)
    with pytest.raises(pincal.WorkspaceError, match="no workspace"):
        result.plot.error_map()


@pytest.mark.parametrize("draw", [Plots.residuals, Plots.parameters, Plots.correlation])
def test_axes_that_are_given_are_drawn_into(draw: object, result: pincal.CalibrationResult) -> None:
    """And returned; names that matplotlib would hide stay visible."""
    hidden = tuple(replace(leg, name=f"_{leg.name}") for leg in result.legs)
    figure = Figure()
    axes = figure.subplots()
    assert isinstance(axes, Axes)
    assert draw(replace(result, legs=hidden).plot, axes) is axes  # type: ignore[operator]
    by_name = getattr(result.plot, draw.__name__)  # type: ignore[attr-defined]
    assert by_name(axes) is axes


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


@pytest.mark.parametrize("case", CASES)
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
    white = np.concatenate([line.get_ydata() for line in shown.lines[:-3]])
    assert 0.1 < np.sqrt(np.mean(white**2)) < 1.5
    bars = [bar for one in result.plot.parameters().containers for bar in one]
    assert len(bars) == sum(p.high > p.low for leg in result.legs for p in leg.parameters)
    (image,) = result.plot.correlation().images
    assert np.abs(image.get_array()).max() <= 1.0 + 1e-9
    if mechanism.by_readings:
        with pytest.raises(pincal.WorkspaceError, match="no workspace"):
            result.plot.error_map()
    else:
        values = result.plot.error_map().images[0].get_array().compressed()
        assert ((values > 0.0) & np.isfinite(values)).any()
    assert "all legs" in str(result) or options == {"method": "per-leg"}
    result.save(tmp_path / "result")
    lines = (tmp_path / "result/residuals.csv").read_text(encoding="utf-8").splitlines()
    assert lines[0] == "leg,row,quantity,unit,residual,sigma"
    residuals = np.array([float(line.split(",")[4]) for line in lines[1:]])
    assert (np.abs(residuals) > 1e-9).mean() > 0.95
