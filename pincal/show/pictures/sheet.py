"""A calibration as a drawing: a leg with its dimensions, and beneath it every parameter's values.

One page of A4. Colours say by how much a parameter changed over its ±; lines link those that are
weakly determined together.
"""

from __future__ import annotations

from collections.abc import Sequence
from textwrap import wrap

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from pincal.calibration.leg_result import IdentifiedParameter, LegResult
from pincal.calibration.result import CalibrationResult
from pincal.kinematics.configurations import home_of
from pincal.model.mechanism import Mechanism
from pincal.show.pictures.dimensions import symbol
from pincal.show.pictures.figure import draw_leg
from pincal.show.pictures.files import drawing
from pincal.show.pictures.parts import wrapped
from pincal.show.style import IDENTIFIED, INK, NOMINAL, PAGE_WIDTH
from pincal.show.summary import noise_sizes, noise_source
from pincal.show.view.scene import scene
from pincal.words.numbers import measured, minus
from pincal.words.wording import clean

#: A4 in a printer's margins, [inch].
_SIZE = (PAGE_WIDTH / 25.4, 257.0 / 25.4)
_LEGS = 3  # columns of a table, at most
_LINE = 0.165  # height of a line of a table, [inch]
_NOMINAL = 0.345  # where the column of nominal values ends, of the width
_LABEL = 30  # letters of a line of a label, its symbol among them
#: Changes over ± from which a colour is used, with what it says.
LEVELS = (
    (0.0, NOMINAL, "changed by less than its ±"),
    (1.0, "#7352e8", "by 1 to 5 times its ±"),
    (5.0, IDENTIFIED, "by more than 5 times its ±"),
)


def colour_of(p: IdentifiedParameter) -> str:
    """Return the colour of a parameter by its change over half its 95 % interval."""
    if not np.isfinite(p.half) or p.half <= 0.0:
        return INK[0]
    return [colour for least, colour, _ in LEVELS if abs(p.change) >= least * p.half][-1]


def kinds_of_legs(result: CalibrationResult) -> list[list[LegResult]]:
    """Return the legs of a result, those with the same parameters together."""
    kinds: dict[tuple[str, ...], list[LegResult]] = {}
    for leg in result.legs:
        kinds.setdefault(tuple(p.name for p in leg.parameters), []).append(leg)
    return list(kinds.values())


def sheet(result: CalibrationResult, name: str = "", date: str = "") -> Figure:
    """Return the drawing of a leg, and a table of the parameters of all legs like it.

    Args:
        result: The calibration.
        name: Of the leg; the first if not given.
        date: When it is drawn, if that is to be said.

    Raises:
        MechanismError: no such leg.
    """
    mechanism = result.nominal
    leg = mechanism.leg(name or mechanism.leg_names[0]).name
    legs = next(kind for kind in kinds_of_legs(result) if leg in [block.name for block in kind])
    blocks = [legs[i : i + _LEGS] for i in range(0, len(legs), _LEGS)]
    lines = sum(_lines(block, mechanism) for block in blocks)
    table = min(_LINE * lines / _SIZE[1], 0.7)
    with drawing():
        figure = Figure(figsize=_SIZE)
        draw_dimensioned(figure.add_axes((0.02, table + 0.06, 0.96, 0.88 - table)), result, leg)
        figure.text(0.02, 0.975, f"{clean(mechanism.name)}: {clean(leg)}", size=9, weight="bold")
        about = "one of these legs; values of all below" if len(legs) > 1 else "values below"
        figure.text(0.98, 0.975, about, size=8, ha="right")
        below = figure.add_axes((0.02, 0.06, 0.96, table))
        _table(below, result, blocks, lines)
        keys = [Line2D([], [], color=colour, lw=3, label=text) for _, colour, text in LEVELS]
        keys.append(Line2D([], [], color=INK[0], lw=3, label="held fixed"))
        figure.legend(handles=keys, loc="lower center", ncols=4, frameon=False, fontsize=7)
        doubt = f" Residuals are {result.excess:.3g} times as large: no ± can be relied on."
        foot = (
            f"±: half of the 95 % interval. Noise: {noise_source(result)}, {noise_sizes(result)}."
            f"{'' if result.explained else doubt} ◆ zero on the drawing."
            + (f" Drawn {date}." if date else "")
        )
        foot = wrapped(foot, 0.96 * _SIZE[0])
        figure.text(0.02, 0.045, foot, size=7, va="center")
    return figure


def draw_dimensioned(axes: Axes, result: CalibrationResult, leg: str) -> Axes:
    """Draw a leg of the nominal mechanism with dimensions in the colours of their changes."""
    leg_result = next(leg_result for leg_result in result.legs if leg_result.name == leg)
    colours = {p.name: colour_of(p) for p in leg_result.parameters}
    mechanism = result.nominal
    return draw_leg(axes, scene(mechanism, home_of(mechanism)), leg, colours)


def _table(
    axes: Axes, result: CalibrationResult, blocks: Sequence[Sequence[LegResult]], lines: float
) -> None:
    """Write nominal and identified values, ±, in blocks of legs; link weak pairs of one leg."""
    axes.set(xlim=(0.0, 1.0), ylim=(lines, 0.0))
    axes.set_axis_off()
    line = 0.6
    for legs in blocks:
        places = [_NOMINAL + (0.985 - _NOMINAL) * (i + 1) / len(legs) for i in range(len(legs))]
        head = [
            (0.0, "left", "parameter"),
            (_NOMINAL, "right", "nominal"),
        ]
        head += [(place, "right", clean(leg.name)) for place, leg in zip(places, legs, strict=True)]
        for place, side, text in head:
            axes.text(place, line, text, size=7.5, weight="bold", ha=side, va="center")
        axes.plot((0.0, 1.0), (line + 0.55,) * 2, color=INK[0], lw=0.6)
        line += 1.1
        rows = {}
        for p in legs[0].parameters:
            rows[p.name] = line
            _row(axes, line, p.name, (legs, places), result.nominal)
            line += _height(legs, p.name, result.nominal)
        for leg, place in zip(legs, places, strict=True):
            _links(axes, result, leg, (rows, place + 0.006))
        line += 1.0


def _same_nominal(legs: Sequence[LegResult], name: str) -> bool:
    """Return whether a parameter has one nominal value in all legs."""
    return len({p.nominal for leg in legs for p in leg.parameters if p.name == name}) == 1


def _label(mechanism: Mechanism, leg: str, name: str) -> list[str]:
    """Return the lines of a parameter's label, two at most."""
    letters = len(name) if r"\mathit" in symbol(name) else 2  # Greek ones are one letter
    indent = " " * (letters + 4)  # the symbol, and what the column of values needs
    text = clean(mechanism.label(leg, name))
    lines = wrap(text, _LABEL, initial_indent=indent, max_lines=2, placeholder="…")
    return [line.strip() for line in lines]


def _height(legs: Sequence[LegResult], name: str, mechanism: Mechanism) -> float:
    """Return how many lines a parameter takes."""
    return (
        1.0 if _same_nominal(legs, name) and len(_label(mechanism, legs[0].name, name)) < 2 else 1.8
    )


def _lines(legs: Sequence[LegResult], mechanism: Mechanism) -> float:
    """Return how many lines a block takes."""
    return 2.2 + sum(_height(legs, p.name, mechanism) for p in legs[0].parameters)


def _row(
    axes: Axes,
    line: float,
    name: str,
    columns: tuple[Sequence[LegResult], Sequence[float]],
    mechanism: Mechanism,
) -> None:
    """Write a parameter of several legs: nominal values, then identified ones at places."""
    legs, places = columns
    identified = [next(p for p in leg.parameters if p.name == name) for leg in legs]
    first, *further = _label(mechanism, legs[0].name, name) or [""]
    heading = symbol(name) + f"  {first}".replace("$", r"\$") * bool(first)
    axes.text(0.0, line, heading, size=7, va="center", parse_math=True)
    for text in further:
        axes.text(0.027, line + 0.8, text, size=7, va="center")
    same = _same_nominal(legs, name)
    nominal = measured(identified[0].nominal, 0.0, identified[0].unit) if same else "beneath"
    axes.text(_NOMINAL, line, minus(nominal), size=7, ha="right", va="center")
    for p, place in zip(identified, places, strict=True):
        if not same:
            nominal = f"nominal {minus(measured(p.nominal, 0.0, p.unit))}"
            axes.text(place, line + 0.8, nominal, size=7, ha="right", va="center")
        shown = colour_of(p) if colour_of(p) != NOMINAL else "#6B6B6B"  # text needs more contrast
        axes.text(place, line, minus(p.text), size=7, ha="right", va="center", color=shown)


def _links(
    axes: Axes,
    result: CalibrationResult,
    leg: LegResult,
    column: tuple[dict[str, float], float],
) -> None:
    """Draw a bracket from one parameter of a leg to another whose error goes with its own."""
    rows, right = column
    ids = {p.id: p.name for p in leg.parameters}
    pairs = [pair for pair in result.weak if pair.first in ids and pair.second in ids][:3]
    for depth, pair in enumerate(pairs):
        end = right + 0.004 * (depth + 1)
        first, second = rows[ids[pair.first]], rows[ids[pair.second]]
        x, y = (right, end, end, right), (first, first, second, second)
        axes.plot(x, y, color=INK[0], lw=0.7, clip_on=False)
