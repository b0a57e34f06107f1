"""Everything that people hold shows itself in notebooks: its numbers, and nothing as code."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from lxml import html

import pincal

NOISE = pincal.Noise(1e-4, 1e-4)
EVIL = "<script>Ω</script>"


@pytest.fixture(scope="module")
def mechanism() -> pincal.Mechanism:
    """A five-bar."""
    return pincal.load_mechanism("5R")


@pytest.fixture(scope="module")
def measured(mechanism: pincal.Mechanism) -> pincal.Measurements:
    """Two runs of forty rows, the first row without its x."""
    truth = pincal.disturb(mechanism, 2e-3, seed=1)
    shift = np.random.default_rng(2).uniform(-0.3, 0.3, (40, 2))
    plan = pincal.Plan(mechanism.platform.home + shift)
    data = pincal.simulate(mechanism, truth, plan, NOISE, 3).measurements
    poses = data.poses.copy()
    poses[0, 0] = np.nan
    return replace(data, poses=poses, runs=("a",) * 20 + ("b",) * 20)


def cells(shown: str) -> list[str]:
    """Return the texts of the cells of a fragment's tables."""
    root = html.fromstring(f"<div>{shown}</div>")
    assert not root.xpath("//script")
    return [cell.text_content().strip() for cell in root.xpath("//td|//th")]


def test_plans_and_measurements_show_their_first_rows(measured: pincal.Measurements) -> None:
    """Twelve rows, what was not measured empty, how many more there are; sets are text."""
    shown = measured._repr_html_()
    assert "and 28 more rows" in shown
    found = cells(shown)
    assert f"{measured.poses[1, 1]:.6g}" in found
    assert "nan" not in shown
    plan = pincal.Plan(measured.poses[1:3], (EVIL, "leg_2"))
    assert EVIL in cells(plan._repr_html_())


def test_selections_and_forecasts_show_what_they_give(mechanism: pincal.Mechanism) -> None:
    """Efficiency of each leg and poses; the standard error of each parameter."""
    candidates = pincal.sample_workspace(mechanism, 200, seed=0)
    selection = pincal.select_poses(mechanism, candidates, 8)
    found = cells(selection._repr_html_())
    assert f"{selection.legs[0].efficiency:.4f}" in found
    assert f"{selection.plan.poses[0, 0]:.6g}" in found
    forecast = pincal.forecast(mechanism, selection.plan, NOISE)
    found = cells(forecast._repr_html_())
    assert set(mechanism.legs[0].parameter_names) <= set(found)
    assert {"leg_1", "leg_2"} <= set(found)


def test_checks_show_what_they_found(
    mechanism: pincal.Mechanism, measured: pincal.Measurements
) -> None:
    """Held-out rows beside those of the fit; the spread of each parameter over runs."""
    result = pincal.calibrate(mechanism, measured, noise=NOISE)
    validation = result.validated(2).validation
    assert validation is not None
    found = cells(validation._repr_html_())
    assert {f"{validation.fit:.3g}", f"{validation.held_out:.3g}"} <= set(found)
    runs = result.compared().runs
    assert runs is not None
    found = cells(runs._repr_html_())
    assert {f"{runs.spread[0]:.3g}", runs.names[0]} <= set(found)
    axes = result.compared().plot.runs()
    first, second = axes.lines[0].get_ydata(), axes.lines[1].get_ydata()
    assert np.allclose(first, -second)
