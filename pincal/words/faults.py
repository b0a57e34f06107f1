"""Sentences of measurements that cannot be right, and of hypotheses that would explain them.

What a hypothesis ``says`` follows 'if'; those that explain measurements alike are one sentence.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from pincal.finding import Finding
from pincal.words.numbers import percent
from pincal.words.wording import Wording, filled

_error = partial(Wording, severity="error")
FAULTS: dict[str, Wording] = {
    "readings-still": _error(
        "{% for name, value, unit, moved in readings %}{', ' if not loop.first}{name} reads the "
        "same in all rows ({value|g(6)} {unit}){% endfor %}, where readings of the nominal "
        "mechanism differ by {% for name, value, unit, moved in readings %}"
        "{', ' if not loop.first}{moved|g(2)} {unit}{% endfor %} over these poses",
        "Check the sensor, its cable and the log",
    ),
    "whole-turns": _error(
        "{leg}: {rows|length|counted('reading is', 'readings are')} off by whole turns, the first "
        "in data row {row}: {reading|g(6)} rad, where the nominal mechanism reads {nominal|g(6)} "
        "rad",
        "Count without the turns, or correct the nominal offset",
    ),
    "other-working-mode": _error(
        "readings and poses close the legs, but these bend the other way than in mechanism.yaml's "
        "home: {% for leg, passive, bent, total in legs %}{', ' if not loop.first}{leg} "
        "({passive|join(' and ')}, in {bent} of {total} rows){% endfor %}",
        "Correct 'home' there, or measure in its working mode",
    ),
    "not-this-mechanism": _error(
        "{leg}: the measurements miss the nominal mechanism by {(100 * gap)|f(1)} % of a leg's "
        "length (median), and no single fault in units, signs, order, zeros or frame explains it",
        "Check the units, the order and signs of the readings, the frame of the poses, and that "
        "this is the right mechanism. If it is known but roughly, say so (--rough)",
    ),
    "readings-do-not-follow": _error(
        "{leg}: the readings do not follow those of the nominal mechanism (machines near it leave "
        "{(100 * left)|g(2)} % of the leg's length where readings move it by "
        "{(100 * stroke)|g(2)} %)",
        "Check their order and signs, the signs and frame of the poses, and the mechanism",
    ),
    "rows-copied": _error(
        "data rows {first[0] + 1} and {first[1] + 1} are identical in all that was measured"
        "{' (and %d more such pairs)' % (pairs - 1) if pairs > 1}; measured twice, they would "
        "differ by noise",
        "Remove the copies",
    ),
    "noise-too-large": _error(
        "the noise of {what} is given as {'%g' % given} {unit}{% if what == 'position' %}, more "
        "than {(100 * most / size)|f(0)} % of a leg's length ({size|g} m){% else %}; expected less "
        "than {'%g' % most}{% endif %}",
        "It is in {'metres' if unit == 'm' else 'radians'}",
    ),
    "bad-rows": Wording(
        "data row {worst + 1} misses the nominal mechanism {times|g} times as far as rows usually "
        "do{% if rows|length > 1 %}, and {(rows|length - 1)|counted('more row')} so{% endif %}",
        "Look for a slip there first, or leave such rows out (--loss reject)",
    ),
    "frame-misaligned": Wording(
        "{(100 * share)|f(0)} % of what the nominal model is off by (in squares) is one motion of "
        "the {frame}'s frame, by {size_in_words(shift, turn)}, and parameters that differ each in "
        "its own way hardly move so ({p_value|chance})",
        "{% if remedy == 'base' %}Is the tracker's frame the base's (--unknown-frame)?{% else %}Is "
        "the target the platform's origin (--unknown-target)?{% endif %} Else where the frame lies "
        "is taken for errors of the machine",
    ),
}
_READINGS = "the readings{' of ' ~ legs|join(', ') if legs}"
_SIGN = "Change {}, or the sensor's 'direction' in mechanism.yaml"
_ORDER = "Correct the order of columns"
_FRAMED = "{' and the base is elsewhere in their frame' if unknown_frame}"


def _hypothesis(says: str, remedy: str) -> Wording:
    return _error(says + _FRAMED, remedy)


HYPOTHESES: dict[str, Wording] = {
    "sign-of-readings": _hypothesis(f"{_READINGS} have the other sign", _SIGN.format("their sign")),
    "sign-of-column": _hypothesis("{column} has the other sign", _SIGN.format("its sign")),
    "columns-exchanged": _hypothesis("{columns|join(' and ')} are exchanged", _ORDER),
    "legs-exchanged": _hypothesis(
        "legs are exchanged: {% for leg, column in order %}{' and ' if not loop.first}column "
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
        "{axis|join(' and ')} {'has the other sign' if axis|length == 1 else 'are exchanged'}"
        "{' and the orientations are right' if orientations_right else ', as in a left-handed "
        "frame'}",
        "Give the poses in the right-handed frame of the base",
    ),
    "sign-of-angle": _hypothesis("{column} has the other sign", "Change the sign of that angle"),
    "angles-exchanged": _hypothesis(
        "{% if order|length == 2 %}{order[0][0]} and {order[1][0]} are exchanged{% else %}columns "
        "of the orientation are exchanged: {% for name, column in order %}"
        "{', ' if not loop.first}{name} is below {column}{% endfor %}{% endif %}",
        _ORDER,
    ),
    "orientation-inverted": _hypothesis(
        "the orientations turn the other way (that of the base seen from the platform)",
        "Give the orientation of the platform in the base frame",
    ),
    "pose-inverted": _hypothesis(
        "the poses are those of the base in the platform's frame",
        "Give the poses of the platform in the base frame",
    ),
    "rows-shifted": _hypothesis(
        "the readings stand {shift|abs|counted('row')} {'below' if shift > 0 else 'above'} the "
        "poses they belong to",
        "Bring the logs of poses and readings into step",
    ),
    "reading-offset": _hypothesis(
        "the zeros of readings are off: {% for name, offset, unit in offsets %}"
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
    "unknown-frame": _error(
        "the poses are those in another frame than the base's",
        "Say that the base is elsewhere in that frame (--unknown-frame; in Python "
        "Setup(unknown_frame=True))",
    ),
}


_MISSED = (
    "{% if other_side > 0.5 %}{(100 * other_side)|f(0)} % of the poses lie on the other side of a "
    "singularity than mechanism.yaml's home; they would lie on its side, and miss "
    "{% elif given is none %}readings and measured positions cannot be brought together; they "
    "would miss {% else %}{questioned|join(', ')}: the measurements miss every mechanism near the "
    "nominal one by {given|percent} of a leg's length (median), but only {% endif %}"
)


def explanation(findings: Sequence[Finding]) -> str:
    """Return one sentence for hypotheses that explain measurements alike, and their remedies."""
    causes = [
        f"by {percent(finding.values['left'])} if {filled(HYPOTHESES[finding.code].says, finding)}"
        for finding in findings
    ]
    codes = [finding.code for finding in findings]
    codes += ["unknown-frame" for finding in findings if finding.values["unknown_frame"]]
    remedies = dict.fromkeys(HYPOTHESES[code].remedy for code in codes)
    return f"{filled(_MISSED, findings[0])}{', or '.join(causes)}. {'; or: '.join(remedies)}"
