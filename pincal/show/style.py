"""How drawings look: colours, markers, sizes; one place for plots, pictures and pages."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

#: Okabe and Ito's colours, distinct in every common colour-blindness.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
MARKERS = ("o", "^", "s", "D", "v", "P", "X")
HATCHES = ("", "//", "..", "xx", "\\\\", "++", "oo")
#: Joints in the exported URDFs.
ACTIVE, PASSIVE = "#d95e03", "#1f78b5"
IDENTIFIED = "#7A33AD"
#: Positions of a fundamental domain, and those that follow from it.
DOMAIN, CARRIED = COLOURS[0], "#A9CBE8"
GROUND = "#D4D4D4"
#: Lengths, angles and their names in drawings.
DIMENSION = "#222222"
#: Where a mechanism in space is seen from: slightly from above.
TOWARDS_VIEWER = (0.45, -0.85, 0.28)
#: Axes x, y and z of a frame, and poses for every leg.
AXES, EVERY = ("#CC2626", "#1A8C1A", "#2640D9"), "#333333"


@dataclass(frozen=True)
class PageStyle:
    """Sizes of figures on pages."""

    width: float = 7.4
    """That of A4 between its margins, [inch]."""
    height: float = 9.5
    """At most, [inch]."""
    margins: Mapping[str, float] = field(
        default_factory=lambda: {"left": 0.65, "right": 0.1, "bottom": 0.45, "top": 0.25}
    )
    """Around a figure's panels, [inch]."""
    letter: float = 0.075
    """Width of a letter in a legend, [inch]."""
    line: float = 0.2
    """Height of a line of a legend, [inch]."""
    many: int = 1500
    """Points from which they are drawn as pixels: a vector picture stays small."""


@dataclass(frozen=True)
class PictureStyle:
    """Sizes in pictures of mechanisms."""

    width: float = 5.2
    """Of the figure, [inch]."""
    heights: tuple[float, float] = (1.8, 6.0)
    """Least and most of what is drawn, [inch]."""
    legend: float = 0.5
    """Height for the legend below, [inch]."""
    letters: int = 28
    """Of the longest name."""
    line: int = 75
    """Letters of a legend's line."""
    edge: float = 0.0025
    """Thickness of outlines, of the scene's diagonal."""
    dark: float = 0.55
    """Brightness of an outline, of its shape's."""
    piece: float = 10.0
    """Length of a rod's piece, of its radius."""
    pieces: int = 40
    """Of a rod, at most."""
    name: float = 8.5
    """Height of a parameter's name, [point]."""
    letter: float = 0.58
    """Width of a letter of such a name, of its height."""
    along: tuple[float, ...] = (0.5, 0.35, 0.65, 0.2, 0.8)
    """Where along a dimension its name is tried, by its length."""
    away: tuple[float, ...] = (1.0, -1.0, 1.8, -1.8)
    """How far from it, in heights of the name."""
    arc: float = 0.055
    """Radius of the smallest angle drawn, of the scene's diagonal."""
    values: int = 6
    """Of parameters, in a line, at most."""
    title: int = 100
    """Letters of a line of them."""


PAGE, PICTURE = PageStyle(), PictureStyle()


class Look(NamedTuple):
    """What distinguishes a leg or a set from the others, in colour and in black and white."""

    colour: str
    marker: str
    hatch: str


def look(index: int) -> Look:
    """Return the look of a leg or set by its number."""
    return Look(*(own[index % len(own)] for own in (COLOURS, MARKERS, HATCHES)))
