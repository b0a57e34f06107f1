"""How drawings look: colours, markers, sizes; one place for charts, pictures and pages."""

from __future__ import annotations

from typing import NamedTuple

#: Of legs, and of sets of poses that serve them; all colours here are held apart for people who
#: lack a kind of cone by tests/test_style.py.
LEGS = ("#07a75a", "#0e11a3", "#ac5f71", "#7e7dfe", "#610f0a", "#1a5c4c", "#703e68", "#9f1042")
MARKERS = ("o", "^", "s", "D", "v", "P", "X")
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
#: Where a mechanism in space is seen from: slightly from above.
TOWARDS_VIEWER = (0.45, -0.85, 0.42)
#: Widths of figures in one column and across two, [mm].
COLUMN, PAGE_WIDTH = 80.0, 170.0
RASTER_FROM = 1500  # points from which they are drawn as pixels: a vector picture stays small


class Look(NamedTuple):
    """What distinguishes a leg or a set from the others, in colour and in black and white."""

    colour: str
    marker: str


def look(index: int) -> Look:
    """Return the look of a leg or set by its number."""
    return Look(*(values[index % len(values)] for values in (LEGS, MARKERS)))
