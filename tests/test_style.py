"""The palette: one meaning a colour, apart and readable to everyone."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from colour_vision import VISIONS, contrast, difference, differences

import pincal
from pincal.files.mechanism_folders import bundled
from pincal.show import style
from studies.drawing import DOMAIN

ROLES = {
    "driven": style.ACTIVE,
    "nominal, before": style.NOMINAL,
    "identified, after": style.IDENTIFIED,
    "outlier": style.OUTLIER,
}


@pytest.mark.parametrize(
    ("first", "second", "expected"),
    [  # of Sharma, Wu and Dalal, Table 1: rows 1, 7, 10, 16, 17, 19, 25, 29, 34
        ((50, 2.6772, -79.7751), (50, 0, -82.7485), 2.0425),
        ((50, 0, 0), (50, -1, 2), 2.3669),
        ((50, 2.49, -0.001), (50, -2.49, 0.0010), 7.1792),
        ((50, 2.5, 0), (50, 0, -2.5), 4.3065),
        ((50, 2.5, 0), (73, 25, -18), 27.1492),
        ((50, 2.5, 0), (56, -27, -3), 31.9030),
        ((60.2574, -34.0099, 36.2677), (60.4626, -34.1751, 39.4387), 1.2644),
        ((22.7233, 20.0904, -46.6940), (23.0331, 14.9730, -42.5619), 2.0373),
        ((2.0776, 0.0795, -1.1350), (0.9033, -0.0636, -0.5514), 0.9082),
    ],
)
def test_differences_of_colours_are_those_published(
    first: tuple[float, ...], second: tuple[float, ...], expected: float
) -> None:
    """CIEDE2000 as its authors tabulate it, four digits, either way round."""
    assert difference(np.array(first), np.array(second)) == pytest.approx(expected, abs=1e-4)
    assert difference(np.array(second), np.array(first)) == pytest.approx(expected, abs=1e-4)


@pytest.mark.parametrize("vision", VISIONS)
def test_no_two_meanings_look_alike(vision: str) -> None:
    """Legs and roles differ by 9 or more (CIEDE2000), to all kinds of eyes; 1 can just be seen."""
    named = {**{f"leg {i}": c for i, c in enumerate(style.LEGS, 1)}, **ROLES}
    named |= {"fundamental domain": DOMAIN}
    apart = differences([*named.values()], vision)
    for (i, a), (j, b) in combinations(enumerate(named), 2):
        assert apart[i, j] > 9.0, (a, b, apart[i, j])


def test_graphics_and_text_stand_out() -> None:
    """Contrast on the ground: 3 of lines and marks, 4.5 of text (WCAG 2.2)."""
    for colour in (*style.LEGS, *ROLES.values()):
        assert contrast(colour, style.PAPER) >= 3.0, colour
    assert contrast(style.INK, style.PAPER) >= 4.5


def test_every_bundled_leg_has_a_colour_of_its_own() -> None:
    """There are as many colours as the bundled mechanism of most legs has legs, or more."""
    most = max(len(pincal.load_mechanism(name).legs) for name in bundled())
    assert most == 8
    assert len({style.leg_colour(i) for i in range(most)}) == most
