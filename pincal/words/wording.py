"""Templates of sentences and pages, and text without characters that pages cannot hold.

A sentence is a Jinja template with expressions in braces, such as ``{size|amount(unit)}``. Names in
it are the finding's values, its ``rows`` (counted from 1), ``row`` (the first), ``them`` (``it``
for one row) and ``parameters``; filters are listed below.
"""

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from math import isfinite
from typing import Any

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined

from pincal.finding import Finding, Severity
from pincal.model.checks import counted
from pincal.words.numbers import SMALL, amount, chance, listed, number, percent, rounded

#: Most groups of parameters in a sentence; result.json has all.
LISTED = 4
#: Most names in a message, and rows of a long table.
NAMED = 12


@dataclass(frozen=True)
class Wording:
    """Sentence, remedy, severity and title of a finding's code."""

    says: str
    """Template of the finding: one sentence without capital and full stop."""
    remedy: str = ""
    """Template of the remedy: a sentence without full stop."""
    severity: Severity = "warning"
    title: str = ""
    """Short name of a finding that contradicts the model or its noise, so that no limit holds."""


def filled(words: str, finding: Finding) -> str:
    """Fill a template with the values of a finding."""
    rows = [row + 1 for row in finding.rows]
    them = "it" if len(rows) == 1 else "them"
    names = {"rows": rows, "row": rows[0] if rows else None, "them": them}
    return _template(words).render(names, parameters=finding.parameters, **finding.values)


def group_in_words(group: tuple[str, ...]) -> str:
    """Name parameters, by id, that only move together; a single parameter has no effect."""
    return f"{named(group)} move together" if group[1:] else f"{group[0]} has no effect"


def named(words: Sequence[object]) -> str:
    """Return words as an enumeration; after the first ``NAMED`` only how many more there are.

    More than ``2 NAMED`` parameters are counted by leg or instrument, the part of their id before
    ``.``.
    """
    owners = Counter(str(word).partition(".")[0] for word in words)
    if 2 * NAMED < len(words) > len(owners):
        words = [f"{counted(count, 'parameter')} of {owner}" for owner, count in owners.items()]
    return listed(words if len(words) <= NAMED else [*words[:NAMED], f"{len(words) - NAMED} more"])


def groups_in_words(groups: Sequence[tuple[str, ...]]) -> str:
    """Describe at most ``LISTED`` groups of parameters, and say how many more there are."""
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
    """Return standard deviations in words; readings have [units], and 0 means exact readings."""
    parts = [] if position is None else [f"{amount(position, 'm')} in position"]
    parts += [] if orientation is None else [f"{amount(orientation, 'rad')} in orientation"]
    parts += [] if pixel is None else [f"{amount(pixel, 'px')} in images"]
    read = listed((SMALL[unit] for unit in units), "or")
    parts.append(f"{number(reading, units[0])} {read} in readings" if reading else "readings exact")
    return ", ".join(parts)


_UNPRINTABLE = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def clean(text: str) -> str:
    """Replace characters that no page can hold."""
    return _UNPRINTABLE.sub("\ufffd", text)


def rendered(template: str, **values: Any) -> str:
    """Render a template of ``pincal/words`` or ``pincal/show/pages`` with values."""
    return _pages().get_template(template).render(**values)


def slipped(what: str, name: str) -> str:
    """Return what slipped as the subject of a sentence; ``SLIPPED`` has its kinds."""
    return SLIPPED[what][0].format(name=name)


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
    "slipped": slipped,
    "si": lambda unit: "" if unit == "1" else f" {unit}",
    "times_off": lambda factor: (
        f"{rounded(max(factor, 1 / factor), 3)} times too {'large' if factor > 1 else 'small'}"
    ),
}


#: Names of effects that a limit of the error may not cover.
UNCOVERED = {
    "freedom": "motion that the drives leave open",
    "weight": "bending",
    "scale": "instrument scale",
    "time": "drift",
}
NOISE_SOURCES = {
    "given": "as given",
    "repeats": "from rows that were measured repeatedly",
    "estimated": "estimated from the residuals, since none was given",
}
#: Likely mechanical causes by kind of term; other kinds are columns of the measurements.
CAUSES = {
    "harmonics": "an eccentric gear, encoder or screw",
    "period": "the pitch of a screw, or an eccentric gear with this ratio",
    "polynomial": "the pitch of a screw or belt, layers of cable on a drum, or a wrong table",
    "pulley": "the cable runs over a pulley that the model lacks",
    "backlash": "play, or friction that winds up the drive, by direction of approach",
    "gravity": "a gear, bearing or link that bends under weight (taken as 1 kg if unknown)",
}
#: Subject and remedy of a slip, by what slipped.
SLIPPED = {
    "frame": (
        "the frame of the measurements, or the robot's base,",
        "look for a tracker, a tripod or a base that was moved",
    ),
    "target": ("the target '{name}' on the platform", "look for a target or tool that was hit"),
    "orientation": (
        "the orientation measured on the platform",
        "look for a target or tool that was turned",
    ),
    "reading": (
        "the reading of {name}",
        "look for an encoder that slipped, or a belt that jumped a tooth",
    ),
    "camera": ("what camera {name} sees", "look for a camera that was hit"),
    "quantity": ("{name}", "look for an encoder that slipped or a target that was hit"),
}
#: Names for codes in the values of findings.
_NAMES = {
    "TERMS": {
        "angle": ("the reading itself", "an eccentric encoder disc, an uneven gear or lead screw"),
        "pose": ("the pose", "legs or a base that bend, or errors of the tracker over its volume"),
        "order": ("the order of the rows", "drift of temperature or of a reference"),
        "approach": ("the direction of approach", "backlash or friction"),
    },
    "SLIPPED": SLIPPED,
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
    """Return the Jinja environment of sentences: expressions in single braces, no escaping."""
    environment = Environment(
        variable_start_string="{", variable_end_string="}", undefined=StrictUndefined
    )
    environment.filters |= _FILTERS
    environment.globals |= _NAMES | {"noise_in_words": noise_in_words}
    return environment


_template = cache(lambda words: sentence_templates().from_string(words))


@cache
def _pages() -> Environment:
    environment = Environment(
        loader=ChoiceLoader(
            [PackageLoader("pincal.words", ""), PackageLoader("pincal.show", "pages")]
        ),
        autoescape=lambda name: not str(name).endswith(".md"),
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
