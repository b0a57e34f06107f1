"""What is said of a code, as templates; text that pages can hold; templates of pages.

A sentence is written as it is read, with Jinja expressions in braces: ``{size|amount(unit)}``, of a
finding's values, its ``rows`` (counted from 1), ``row`` (the first), ``them`` (``it`` for one row)
and ``parameters``, and of the filters below.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from math import isfinite
from typing import Any

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined, Template

from pincal.finding import Finding, Severity
from pincal.model.checks import counted
from pincal.words.numbers import SMALL, amount, chance, listed, number, percent, rounded

#: Groups of parameters in a sentence; result.json has all.
LISTED = 4
#: Names in a message, rows of a long table.
NAMED = 12


@dataclass(frozen=True)
class Wording:
    """All that is said of one code."""

    says: str
    """Template of what was found, in one sentence without capital and full stop."""
    remedy: str = ""
    """Template of what to do about it, in a sentence without full stop."""
    severity: Severity = "warning"
    title: str = ""
    """In few words, how it contradicts the model or its noise, so that no limit is promised."""


def filled(words: str, finding: Finding) -> str:
    """Return a template with the values of a finding."""
    rows = [row + 1 for row in finding.rows]
    them = "it" if len(rows) == 1 else "them"
    names = {"rows": rows, "row": rows[0] if rows else None, "them": them}
    return _template(words).render(names, parameters=finding.parameters, **finding.values)


@cache
def _template(words: str) -> Template:
    return sentence_templates().from_string(words)


def group_in_words(group: tuple[str, ...]) -> str:
    """Return which parameters move together, by ids; one that is alone has no effect."""
    return f"{named(group)} move together" if group[1:] else f"{group[0]} has no effect"


def named(words: Sequence[object]) -> str:
    """Return words in a sentence, and how many more there are than can be read."""
    return listed(words if len(words) <= NAMED else [*words[:NAMED], f"{len(words) - NAMED} more"])


def groups_in_words(groups: Sequence[tuple[str, ...]]) -> str:
    """Return which parameters move together, a few groups and how many more there are."""
    parts = list(map(group_in_words, groups))
    if len(parts) > LISTED + 1:
        parts[LISTED:] = [f"and {len(parts) - LISTED} more"]
    return "; ".join(parts)


def noise_in_words(
    position: float | None,
    orientation: float | None,
    reading: float,
    units: Sequence[str],
    pixel: float | None = None,
) -> str:
    """Return standard deviations of what was measured, readings in [units]; 0 is exact."""
    parts = [] if position is None else [f"{amount(position, 'm')} in position"]
    parts += [] if orientation is None else [f"{amount(orientation, 'rad')} in orientation"]
    parts += [] if pixel is None else [f"{amount(pixel, 'px')} in images"]
    read = listed((SMALL[unit] for unit in units), "or")
    parts.append(f"{number(reading, units[0])} {read} in readings" if reading else "readings exact")
    return ", ".join(parts)


_UNPRINTABLE = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def clean(text: str) -> str:
    """Return text without characters that no page can hold."""
    return _UNPRINTABLE.sub("\ufffd", text)


def rendered(template: str, **values: Any) -> str:
    """Return a template of ``pincal/words`` or ``pincal/show/pages`` with values."""
    return _pages().get_template(template).render(**values)


_FILTERS = {
    "amount": amount,
    "chance": chance,
    "counted": counted,
    "f": lambda value, digits: f"{value:.{digits}f}",
    "finite": isfinite,
    "g": lambda value, digits=3: f"{value:.{digits}g}",
    "groups": groups_in_words,
    "listed": listed,
    "named": named,
    "joint": lambda loop: "" if loop.first else " and " if loop.last else ", ",
    "number": number,
    "percent": percent,
    "rounded": rounded,
    "si": lambda unit: "" if unit == "1" else f" {unit}",
    "times_off": lambda factor: (
        f"{rounded(max(factor, 1 / factor), 3)} times too {'large' if factor > 1 else 'small'}"
    ),
}


#: What a promise may leave out.
UNCOVERED = {"weight": "bending", "scale": "instrument scale", "time": "drift"}
NOISE_SOURCES = {
    "given": "as given",
    "repeats": "from rows that were measured repeatedly",
    "estimated": "estimated from the residuals, since none was given",
}
#: What a mechanic looks at, by kind of term; other kinds are columns.
CAUSES = {
    "harmonics": "an eccentric gear, encoder or screw",
    "period": "the pitch of a screw, or an eccentric gear with this ratio",
    "polynomial": "the pitch of a screw or belt, layers of cable on a drum, or a wrong table",
    "pulley": "the cable runs over a pulley that the model lacks",
    "backlash": "play, or friction that winds up the drive, by direction of approach",
    "gravity": "a gear, bearing or link that bends under weight (1 kg if unknown)",
}
#: Words for codes in values of findings.
_NAMES = {
    "TERMS": {
        "angle": (
            "the reading itself",
            "an eccentric encoder disc, an uneven gear or lead screw",
        ),
        "pose": ("the pose", "legs or a base that bend, or errors of the tracker over its volume"),
        "order": ("the order of the rows", "drift of temperature or of a reference"),
        "approach": ("the direction of approach", "backlash or friction"),
    },
    "UNDER": {
        "mm": "in mm under a metre header (1000 times too large)",
        "m": "in metres under a mm header (1000 times too small)",
        "in": "in inches under a mm header (25.4 times too small)",
        "deg": "in degrees under a radian header (57.3 times too large)",
        "rad": "in radians under a degree header (57.3 times too small)",
    },
}


@cache
def sentence_templates() -> Environment:
    """Return the environment of sentences."""
    environment = Environment(
        variable_start_string="{", variable_end_string="}", undefined=StrictUndefined
    )
    environment.filters |= _FILTERS
    environment.globals |= _NAMES | {"noise_in_words": noise_in_words}
    return environment


@cache
def _pages() -> Environment:
    environment = Environment(
        loader=ChoiceLoader(
            [PackageLoader("pincal.words", ""), PackageLoader("pincal.show", "pages")]
        ),
        autoescape=True,
        keep_trailing_newline=True,
        finalize=lambda value: (
            value
            if not isinstance(value, str) or hasattr(value, "__html__")
            else clean(value).replace("≤ ", "≤\xa0")  # kept in one line
        ),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= _FILTERS
    return environment
