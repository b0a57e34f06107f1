"""How drawings look: colours, markers, sizes; one place for charts, pictures and pages."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

#: Of legs, and of sets of poses that serve them; all colours here are held apart for people who
#: lack a kind of cone by tests/test_style.py.
LEGS = (
    "#07a75a",
    "#0e11a3",
    "#ac5f71",
    "#7e7dfe",
    "#610f0a",
    "#1a5c4c",
    "#703e68",
    "#9f1042",
)
MARKERS = ("o", "^", "s", "D", "v", "P", "X")
HATCHES = ("", "//", "..", "xx", "\\\\", "++", "oo")
#: Joints in the exported URDFs.
ACTIVE, PASSIVE = "#d95e03", "#1f78b5"
#: Before and after: what nominal parameters say, and what identified ones do.
NOMINAL, IDENTIFIED = "#909090", "#4402fc"
#: Rows that do not fit.
OUTLIER = "#c8091c"
#: Positions of a fundamental domain, and those that follow from it.
DOMAIN, CARRIED = "#520856", "#d8c3da"
GROUND = "#d4d4d4"
#: Lengths, angles, axes and their names in drawings; poses for every leg.
DIMENSION = EVERY = "#222222"
#: Each colour as it is on a dark ground.
DARK = {
    "#07a75a": "#fdfd0c",
    "#0e11a3": "#b1b7fd",
    "#ac5f71": "#a35448",
    "#7e7dfe": "#04fff4",
    "#610f0a": "#efda81",
    "#1a5c4c": "#c0f3c6",
    "#703e68": "#b6b81e",
    "#9f1042": "#85a862",
    ACTIVE: ACTIVE,
    PASSIVE: PASSIVE,
    NOMINAL: "#707070",
    IDENTIFIED: "#9983f9",
    OUTLIER: "#fa7399",
    DOMAIN: "#3fc3b0",
    CARRIED: "#2f5b55",
    GROUND: "#3c4148",
    DIMENSION: "#e8e8e8",
}
#: Grounds of pages and drawings, and text on them.
PAPER, INK = ("#ffffff", "#16191d"), ("#222222", "#e8e8e8")
#: Colours of drawings that are other on dark ground: those of the palette, black and white.
DARK_OF = {**DARK, "#000000": INK[1], "#ffffff": PAPER[1], "#cccccc": "#40464e"}
#: Where a mechanism in space is seen from: slightly from above.
TOWARDS_VIEWER = (0.45, -0.85, 0.42)
#: Widths of figures in one column and across two, [mm].
COLUMN, PAGE_WIDTH = 80.0, 170.0


@dataclass(frozen=True)
class PageStyle:
    """Sizes of figures on pages."""

    width: float = PAGE_WIDTH / 25.4
    """Across a page, [inch]."""
    height: float = 9.5
    """At most, [inch]."""
    small: float = 0.065
    """Width of a letter of labels, [inch]."""
    line_small: float = 0.115
    """Height of a line of names along an axis, [inch]."""
    raster_from: int = 1500
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
    pieces: int = 12
    """Of a rod, at most."""
    name: float = 8.5
    """Height of a parameter's name, [point]."""
    letter: float = 0.58
    """Width of a letter of such a name, of its height."""
    room: float = 1.25
    """Of a figure, over what is left for the mechanism."""
    along: tuple[float, ...] = (0.5, 0.35, 0.65, 0.2, 0.8, 0.05, 0.95)
    """Where along a dimension its name is tried, by its length."""
    name_distances: tuple[float, ...] = (1.0, -1.0, 1.8, -1.8, 2.8, -2.8, 4.0, -4.0)
    """How far from it, in heights of the name."""
    arc: float = 0.055
    """Radius of the smallest angle drawn, of the scene's diagonal."""
    leg_distances: tuple[float, ...] = (11.0, 18.0, 26.0, 34.0)
    """How far from its foot a leg's name is tried, [point]."""
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
    return Look(*(values[index % len(values)] for values in (LEGS, MARKERS, HATCHES)))


def dark_variables() -> str:
    """Return the colours of figures on dark ground, as variables of CSS."""
    return " ".join(f"--c{light[1:]}: {dark};" for light, dark in DARK_OF.items())


def other_look(index: int) -> Look:
    """Return the look of a coordinate or a run by its number: no colour of a leg, but a marker."""
    return Look(DIMENSION, MARKERS[index % len(MARKERS)], HATCHES[index % len(HATCHES)])
