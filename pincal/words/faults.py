"""Sentences for faulty measurements, and for hypotheses that would explain the faults.

Sentences begin with the cause; hypotheses that explain measurements equally well share one.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from pincal.finding import Finding
from pincal.words.wording import Wording, filled

_error = partial(Wording, severity="error")
_BY_PHOTOS = (
    ": corrected for that, the machine as drawn misses the points by {missed|amount('m')} (median) "
    "instead of {given|amount('m')}"
)
FAULTS: dict[str, Wording] = {
    "readings-still": _error(
        "{% for name, value, unit, moved in readings %}{', ' if not loop.first}{name} reads the "
        "same in all rows ({value|g(6)} {unit}){% endfor %}, but should vary by "
        "{% for name, value, unit, moved in readings %}"
        "{', ' if not loop.first}{moved|g(2)} {unit}{% endfor %} over these poses",
        "Check the sensor, its cable and the log",
    ),
    "whole-turns": _error(
        "{leg}: {rows|length|counted('reading')} {'is' if rows|length == 1 else 'are'} off by "
        "whole turns, the first in data row {row}: {reading|g(6)} rad in place of "
        "{nominal|g(6)} rad",
        "Remove the whole turns, or correct the nominal offset",
    ),
    "other-working-mode": _error(
        "readings and poses fit if these legs bend the other way than at home in mechanism.yaml: "
        "{% for leg, passive, bent, total in legs %}{', ' if not loop.first}{leg} "
        "({passive|join(' and ')}, in {bent} of {total} rows){% endfor %}",
        "Correct 'home', or measure in the working mode of 'home'",
    ),
    "not-this-mechanism": _error(
        "{leg}: the measurements miss the nominal mechanism by {(100 * gap)|f(1)} % of a leg's "
        "length (median), and no single fault in units, signs, order, zeros or frame explains it",
        "Check these, and that this is the right mechanism; if its dimensions are only roughly "
        "known, add --rough",
    ),
    "readings-do-not-follow": _error(
        "{leg}: the readings do not follow the poses (mechanisms near the nominal one miss them by "
        "{(100 * left)|g(2)} % of the leg's length; the stroke is {(100 * stroke)|g(2)} %)",
        "Check the order and signs of readings, the signs and frame of poses, and the mechanism",
    ),
    "rows-copied": _error(
        "data rows {first[0] + 1} and {first[1] + 1} are identical"
        "{' (and %d more such pairs)' % (pairs - 1) if pairs > 1}; repeated measurements would "
        "differ by noise",
        "Remove the copies",
    ),
    "noise-too-large": _error(
        "the noise given for the {what} is {'%g' % given} {unit}{% if what == 'position' %}, more "
        "than {(100 * most / size)|f(0)} % of a leg's length ({size|g} m){% else %}; expected less "
        "than {'%g' % most}{% endif %}",
        "Give it in {'metres' if unit == 'm' else 'radians'}, or with its unit (0.1m{unit})",
    ),
    "bad-rows": Wording(
        "data row {worst + 1} misses the nominal mechanism by {times|g} times the median"
        "{% if rows|length > 1 %}, {(rows|length - 1)|counted('more row')} by over 10 times"
        "{% endif %}",
        "Check that row for a typing error first, or leave such rows out (--loss reject)",
    ),
    "photos-shifted": _error(
        "the photos are {shift|abs|counted('row')} {'above' if shift > 0 else 'below'} their "
        f"readings{_BY_PHOTOS}",
        "Correct the rows of the corners, or their order: a photo is missing or superfluous",
    ),
    "photos-turned": _error(
        f"the photos are turned by {{turn}}°{_BY_PHOTOS}",
        "Detect points in the camera's original photos: a program turned these by their EXIF data",
    ),
    "board-mirrored": _error(
        f"board '{{board}}' is a mirror image of what it should be{_BY_PHOTOS}",
        "Print it again, or mirror x of its points; do not mirror photos",
    ),
    "board-behind": Wording(
        "board '{board}' is seen from behind: the print or its points in the setup are mirrored, "
        "which does not change the fit of a flat board",
        "Print it again, or mirror x of its points; do not mirror photos",
    ),
    "boards-exchanged": _error(
        f"boards '{{boards[0]}}' and '{{boards[1]}}' are swapped{_BY_PHOTOS}",
        "Swap them in the setup",
    ),
    "board-scale": Wording(
        "judged by the machine as drawn, board '{board}' is {(100 * scale - 100)|abs|g} % "
        "{'larger' if scale > 1 else 'smaller'} than the setup says"
        f"{{' (an inch for 25 mm?)' if (scale - 1.016)|abs < 0.002}}{_BY_PHOTOS}",
        "Measure its bar and set the board's scale accordingly: all lengths depend on it",
    ),
}
_READINGS = "the readings{' of ' ~ legs|join(', ') if legs}"
_SIGN = "Change {}, or the sensor's 'direction' in mechanism.yaml"
_ORDER = "Correct the order of the columns"
_FRAMED = "{' and the poses are in another frame than the base' if unknown_frame}"


def _hypothesis(says: str, remedy: str) -> Wording:
    return _error(says + _FRAMED, remedy)


HYPOTHESES: dict[str, Wording] = {
    "sign-of-readings": _hypothesis(
        f"{_READINGS} have the opposite sign", _SIGN.format("their sign")
    ),
    "sign-of-column": _hypothesis("{column} has the opposite sign", _SIGN.format("its sign")),
    "columns-exchanged": _hypothesis("{columns|join(' and ')} are swapped", _ORDER),
    "legs-exchanged": _hypothesis(
        "legs are swapped: {% for leg, column in order %}{' and ' if not loop.first}column "
        "{column} fits {leg}{% endfor %}",
        _ORDER,
    ),
    "unit": _hypothesis(
        "{% for kind, unit, written in units %}{' and ' if not loop.first}"
        f"{{% if kind == 'readings' %}}{_READINGS}{{% else %}}the {{kind}}{{% endif %}}"
        " are {UNDER[written]}{% endfor %}",
        "Correct the units in the headers",
    ),
    "left-handed-frame": _hypothesis(
        "{axis|join(' and ')} {'has the opposite sign' if axis|length == 1 else 'are swapped'}"
        "{' and the orientations are right' if orientations_right else ', as in a left-handed "
        "frame'}",
        "Give the poses in the right-handed frame of the base",
    ),
    "sign-of-angle": _hypothesis("{column} has the opposite sign", "Change the sign of that angle"),
    "angles-exchanged": _hypothesis(
        "{% if order|length == 2 %}{order[0][0]} and {order[1][0]} are swapped{% else %}columns "
        "of the orientation are swapped: {% for name, column in order %}"
        "{', ' if not loop.first}{name} is in column {column}{% endfor %}{% endif %}",
        _ORDER,
    ),
    "orientation-inverted": _hypothesis(
        "the orientations are inverted (those of the base in the platform's frame)",
        "Give orientations of the platform in the base frame",
    ),
    "pose-inverted": _hypothesis(
        "the poses are inverted (those of the base in the platform's frame)",
        "Give the poses of the platform in the base frame",
    ),
    "rows-shifted": _hypothesis(
        "the readings are {shift|abs|counted('row')} {'below' if shift > 0 else 'above'} their "
        "poses",
        "Align the logs of poses and readings",
    ),
    "reading-offset": _hypothesis(
        "the reading zeros are off: {% for name, offset, unit in offsets %}"
        "{', ' if not loop.first}{name} by about {offset|g(2)} {unit}{% endfor %}",
        "Set the sensor's zero, or correct its nominal offset",
    ),
    "scale-of-readings": _hypothesis(
        "{% if factors|map(attribute=1)|unique|list|length == 1 %}"
        f"{_READINGS} are {{factors[0][1]|times_off}}"
        "{% else %}the readings of {% for name, factor, unit in factors %}"
        "{', those of ' if not loop.first}{name} are {factor|times_off}{% endfor %}{% endif %}",
        "Correct the scale of the readings (counts_per_unit or gain of the sensor in "
        "mechanism.yaml)",
    ),
    "slip": _hypothesis("the {quantity} alone is wrong", "Measure it again"),
    "unknown-frame": _error(
        "the poses are in another frame than the base's",
        "Give --unknown-frame (in Python Setup(unknown_frame=True))",
    ),
}


_MISSED = (
    ": corrected for that, the measurements fit the mechanism to {left|percent} of a "
    "leg's length (median); as they are, {% if other_side > 0.5 %}{other_side|percent} of the "
    "poses lie across a singularity from home{% elif given is none %}readings and poses do not fit "
    "at all{% else %}they miss it by {given|percent}{% endif %}"
)


def causes(findings: Sequence[Finding]) -> str:
    """Return hypotheses that explain the measurements equally well, as parts of a sentence."""
    return ", or ".join(filled(HYPOTHESES[finding.code].says, finding) for finding in findings)


def explanation(findings: Sequence[Finding]) -> str:
    """Return one sentence for equally good hypotheses, followed by their remedies."""
    codes = [finding.code for finding in findings]
    codes += ["unknown-frame" for finding in findings if finding.values["unknown_frame"]]
    remedies = "; or: ".join(dict.fromkeys(HYPOTHESES[code].remedy for code in codes))
    return f"{causes(findings)}{filled(_MISSED, findings[0])}. {remedies}"
