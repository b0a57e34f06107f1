"""How drawings look: colours, markers, sizes; one place for charts, pictures and pages."""

from __future__ import annotations

#: Of legs, and of sets of poses that serve them; all colours here are held apart for people who
#: lack a kind of cone by tests/test_style.py.
LEGS = ("#07a75a", "#0e11a3", "#ac5f71", "#7e7dfe", "#610f0a", "#1a5c4c", "#703e68", "#9f1042")
MARKERS = ("o", "^", "s", "D", "v", "P", "X")
#: What drives: motors, cylinders, winches.
ACTIVE = "#d95e03"
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
#: Widths of figures in one column and across two, [mm].
COLUMN, PAGE_WIDTH = 80.0, 170.0
RASTER_FROM = 1500  # points from which they are drawn as pixels: a vector picture stays small


def leg_colour(index: int) -> str:
    """Return the colour of a leg, or of a set, by its number."""
    return LEGS[index % len(LEGS)]
