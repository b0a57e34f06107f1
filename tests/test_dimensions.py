"""Parameters drawn as dimensions are what they say: lengths, angles, strokes, at their places."""

from __future__ import annotations

from pathlib import Path as FilePath

import numpy as np
import pytest
from command_line import run
from matplotlib.path import Path
from neighbours import skeleton

import pincal
from pincal.kinematics.closure import nominal_legs
from pincal.kinematics.configurations import joints_at
from pincal.show.dimensions import Dimension, dimensions_of, symbol

KINDS = ["5R", "3RRR", "3PRR", "3RPR", "6UPS", "delta", "linear_delta", "8cable", "4cable", "6RUS"]


def drawn(mechanism: pincal.Mechanism, leg: pincal.Leg) -> tuple[list[Dimension], np.ndarray]:
    """Return the dimensions of a leg at home, and its joints."""
    home = [mechanism.platform.home]
    joints = joints_at(mechanism, home).joints[leg.name][0]
    T = mechanism.platform.matrices(np.array(home))[0]
    (closure,) = (one for one in nominal_legs(mechanism) if one.leg == leg)
    return dimensions_of(closure, joints, T, 0.05 * leg.size), joints


def turned(one: Dimension) -> float:
    """Return the angle that an arc sweeps, [rad]: by its chords, of equal length."""
    assert one.corner is not None
    arms = one.line - one.corner
    radius = np.linalg.norm(arms, axis=1)
    np.testing.assert_allclose(radius, radius[0])
    chords = np.linalg.norm(np.diff(arms, axis=0), axis=1)
    return float(2.0 * np.arcsin(np.clip(chords / (2.0 * radius[0]), 0.0, 1.0)).sum())


@pytest.mark.parametrize("kind", KINDS)
def test_every_parameter_is_drawn_as_large_as_it_is(kind: str) -> None:
    """Each parameter of each leg once: a line as long, or an arc as wide, as its value."""
    mechanism = pincal.load_mechanism(kind)
    for leg in mechanism.legs:
        found, _ = drawn(mechanism, leg)
        names = [one.name for one in found if one.name]
        assert sorted(names) == sorted(leg.parameter_names)
        for one in found:
            if one.kind == "length":
                value = leg.nominal_by_name[one.name]
                length = np.linalg.norm(one.line[-1] - one.line[0])
                assert length == pytest.approx(abs(value), abs=1e-12)
            elif one.kind == "angle":
                assert turned(one) == pytest.approx(abs(leg.nominal_by_name[one.name]), abs=1e-9)
            else:
                swept = turned(one) if one.corner is not None else np.ptp(one.line, axis=0)
                gain, offset = leg.sensors[0].constants(leg.nominal_by_name)
                joint = leg.sensors[0].form == "joint"
                per = abs(gain) if joint else 1.0 / abs(gain)
                place = mechanism.reading_columns[mechanism.leg_names.index(leg.name)]
                read = pincal.inverse(mechanism, [mechanism.platform.home]).readings[0, place][0]
                size = (
                    per * abs(read)
                    if one.kind == "reading"
                    else abs(offset) / (1.0 if joint else abs(gain))
                )
                assert np.linalg.norm(swept) == pytest.approx(size, abs=1e-9)


@pytest.mark.parametrize("kind", ["5R", "3RRR", "3PRR"])
def test_links_are_measured_from_joint_to_joint(kind: str) -> None:
    """Lengths of links begin and end where Pinocchio has the joints of the exported URDF."""
    mechanism = pincal.load_mechanism(kind)
    for leg in mechanism.legs:
        found, joints = drawn(mechanism, leg)
        places = skeleton(leg, joints)
        (last,) = (one for one in found if one.name == "L")
        np.testing.assert_allclose(last.line, places[-2:], atol=1e-9)


def test_names_are_symbols() -> None:
    """Greek names become letters, what follows an underscore an index; others stay as they are."""
    assert symbol("beta_b") == r"$\beta_{b}$"
    assert symbol("OA") == r"$\mathit{OA}$"
    assert symbol("a$b") == r"a\$b"


def test_the_command_draws_them(tmp_path: FilePath) -> None:
    """``--dimensions`` names legs; the picture has their symbols, and their values above."""
    path = tmp_path / "p.svg"
    assert run("picture", "3RRR", "-o", path, "--dimensions", "leg_1").code == 0
    text = path.read_text("utf-8")
    assert "1500 mm" in text
    assert "−150°" in text
    outcome = run("picture", "3RRR", "-o", tmp_path / "q.svg", "--dimensions", "leg_9")
    assert outcome.code == 2
    assert "leg_9" in outcome.err


@pytest.mark.parametrize("kind", ["3RPS", "6PUS"])
def test_dimensions_are_in_the_picture(kind: str) -> None:
    """The arc of an angle that goes beyond all parts of the machine is not cut off."""
    mechanism = pincal.load_mechanism(kind)
    axes = pincal.picture(mechanism, dimensions="leg_1").figure().axes[0]
    (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
    paths = [patch.get_path() for patch in axes.patches]
    arrows = [np.array(path.vertices)[path.codes != Path.CLOSEPOLY] for path in paths]
    assert arrows
    for at in [*arrows, *(np.array(line.get_xydata()) for line in axes.lines)]:
        assert left <= at[:, 0].min() < at[:, 0].max() + 1e-9 <= right
        assert low <= at[:, 1].min() < at[:, 1].max() + 1e-9 <= high
