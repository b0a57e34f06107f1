"""A wrong scale of the measuring instrument: said before measuring, where no residual shows it."""

from __future__ import annotations

from dataclasses import replace

import pytest
from command_line import done
from measured import EXACT, NOISE, machine, workspace

import pincal
from pincal.design.forecast import SCALE, scale_effect
from pincal.model.setup import Systematic
from pincal.show.forecasts import scale_lines


@pytest.mark.parametrize("kind", ["3RRR", "6UPS"])
def test_a_wrong_scale_does_what_is_said(kind: str) -> None:
    """Exact data, all lengths 100 µm/m too long: residuals stay, the platform goes astray."""
    mechanism, _, data = machine(kind, 40, EXACT, sigma=1e-6)
    space, over = mechanism.platform.space, workspace(kind, 30, 7)
    found = pincal.forecast(mechanism, data.poses, NOISE)
    effect = scale_effect(found, pincal.Plan(data.poses), over, NOISE, pincal.Setup())
    assert effect is not None
    error, seen = effect
    poses = data.poses.copy()
    poses[:, :space] *= 1.0 + SCALE
    wrong = replace(data, poses=poses)
    ends = [pincal.calibrate(mechanism, one, noise=NOISE) for one in (data, wrong)]
    assert abs(ends[1].reduced_chi2 - ends[0].reduced_chi2) < 1e-6
    assert seen < 1e-6
    off = pincal.accuracy(ends[1].identified, ends[0].identified, over)
    assert off.position == pytest.approx(error.position, rel=1e-3)


def test_only_lengths_have_a_scale() -> None:
    """Where orientations alone are measured nothing is said; a scale that is known counts."""
    mechanism, poses = pincal.load_mechanism("3RRR"), pincal.Plan(workspace("3RRR", 40))
    setup = pincal.Setup(systematic=Systematic(scale=2e-5))
    found = pincal.forecast(mechanism, poses, NOISE)
    effect = scale_effect(found, poses, poses, NOISE, setup)
    assert effect is not None
    assert "taken into what is promised" in scale_lines(effect, known=True)[0]
    turned = replace(found, measured=("phi",))
    assert scale_effect(turned, poses, poses, NOISE, setup) is None


def test_the_command_says_so() -> None:
    """``pincal identifiability`` names it, and what to do."""
    said = " ".join(done("identifiability", "3RRR").out.split())
    assert "100 µm/m too long" in said
    assert "no residual shows it" in said
    assert "Say how well the scale is known" in said
