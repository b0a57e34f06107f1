"""Residuals over the images of cameras: where points were seen, and how far they are off."""

from __future__ import annotations

import runpy
from base64 import b64decode
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.colors import Normalize
from matplotlib.quiver import Quiver
from measured import machine

import pincal

EXAMPLE = Path(__file__).parents[1] / "examples" / "23_camera_images.py"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Return what the example holds: two cameras, three marks, one of them mistaken once."""
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path_factory.mktemp("images"))
        return runpy.run_path(str(EXAMPLE))


@pytest.mark.slow
def test_arrows_lead_from_what_was_seen_to_what_is_predicted(made: dict[str, Any]) -> None:
    """In pixels, all magnified by one factor; the mistaken mark is the longest and the darkest."""
    result, data = made["result"], made["data"]
    axes = result.plot.images()
    front, side = (one for one in axes.collections if isinstance(one, Quiver))
    seen = np.concatenate([data.extra[f"front_{m}_u"] for m in "abc"])
    np.testing.assert_allclose(front.XY[:, 0], seen)
    own = {one.name: one.residuals for one in result.observed}
    off = np.concatenate([own[f"front_{m}_u"] for m in "abc"])
    factor = front.U / off
    np.testing.assert_allclose(factor, factor[0])
    worst = int(np.hypot(side.U, side.V).argmax())
    assert worst == 50 + 8  # mark b, row 9
    assert side.get_array().argmax() == worst
    assert side.U[worst] / factor[0] == pytest.approx(-3.0, rel=0.4)  # predicted less seen
    assert isinstance(side.norm, Normalize)
    assert any("px of residual" in text.get_text() for text in axes.texts)


@pytest.mark.slow
def test_points_are_listed_in_pixels_and_at_their_distance(made: dict[str, Any]) -> None:
    """Root mean squares and medians of what each is off, the worst first; all of a camera above."""
    result = made["result"]
    (table,) = (
        t for t in result.tables() if t.title.startswith("Residuals of points seen by cameras")
    )
    rows = {(row[0], row[1]): [cell.value for cell in row[3:]] for row in table.rows}
    assert [*rows][:4:3] == [("front", "all"), ("front", "c")]
    assert [*rows][5] == ("side", "b")  # of which one was mistaken
    off = {g.name: g.residuals for g in result.observed}
    sizes = np.hypot(off["side_b_u"], off["side_b_v"])
    pixels = [np.sqrt((sizes**2).mean()), np.median(sizes)]
    np.testing.assert_allclose(rows["side", "b"][:2], pixels)
    away = 2.52 / 1506  # metres of a pixel, about
    np.testing.assert_allclose(rows["side", "b"][2:], np.multiply(pixels, away), rtol=0.25)
    lanes = [text.get_text() for text in result.plot.residuals().get_yticklabels()]
    assert lanes[-2:] == ["front", "side"]


@pytest.mark.slow
def test_marks_that_a_camera_did_not_see_have_no_arrow(made: dict[str, Any]) -> None:
    """Rows in which either column is missing are left out; the other camera keeps all."""
    data, result = made["data"], made["result"]
    column = data.extra["front_a_v"].copy()
    column[:20] = np.nan
    other = replace(data, extra=dict(data.extra) | {"front_a_v": column})
    axes = pincal.calibrate("6UPS", other, result.options).plot.images()
    front, side = (one for one in axes.collections if isinstance(one, Quiver))
    assert len(front.XY) == 130
    assert len(side.XY) == 150


@pytest.mark.slow
def test_the_report_shows_them(made: dict[str, Any]) -> None:
    """A figure with its caption, and none where no camera measured."""
    page = made["result"].report(date="").html()
    figure = page.partition('id="figure-images"')[2].partition("base64,")[2].partition('"')[0]
    assert "front: 150 points" in b64decode(figure).decode()


def test_without_a_camera_there_are_no_images() -> None:
    """A result that no camera measured says so."""
    mechanism, _, data = machine("3RRR")
    result = pincal.calibrate(mechanism, data, noise=pincal.Noise(1e-4, 1e-4))
    with pytest.raises(pincal.MeasurementError, match="no camera measured"):
        result.plot.images()
