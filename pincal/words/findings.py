"""Findings and their sentences, by code; ``docs/errors.md`` explains each code.

Sentences for faulty measurements begin with the cause. Hypotheses that would explain the
measurements equally well share one sentence.
"""

from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from typing import Any

from pincal.finding import Finding
from pincal.words.wording import Wording, filled

_GIVE_NOISE = "Give the noise (--noise-position, --noise-orientation, --noise-reading)"
_SOURCE = "{'repeated rows show' if source == 'repeats' else 'given'}"
_CHI2 = "reduced χ² is {chi2|rounded(3)} where 1 is expected: the noise is "
_ASSUMED = "the uncertainties assume that noise"
_info = partial(Wording, severity="info")

FINDINGS: dict[str, Wording] = {
    "no-noise": Wording(
        "residuals are mere rounding errors: real measurements have noise",
        _GIVE_NOISE,
        title="measurements without noise",
    ),
    "noise-estimated": Wording(
        "no noise was given; estimated from the residuals: "
        "{noise_in_words(position, orientation, reading, units, pixel|default(none))}",
        "Give the noise (--noise-reading{', --noise-position' if position}"
        "{', --noise-orientation' if orientation}{', --noise-pixel' if pixel|default(none)}) if it "
        "is known",
    ),
    "chi2-too-large": Wording(
        f"{_CHI2}larger than {_SOURCE}, or the model is incomplete; {_ASSUMED}",
        "Run pincal explain, and check outlying rows",
        title="residuals larger than the noise",
    ),
    "chi2-too-small": Wording(
        f"{_CHI2}smaller than {_SOURCE}; {_ASSUMED}",
        "Correct the noise if it is known to be smaller",
    ),
    "noise-in-other-proportion": Wording(
        "the proportions of the given noise are wrong ({p_value|chance}): residuals show "
        "{% for name, ratio in ratios.items() %}{loop|joint}{(100 * ratio)|f(0)} % of it in {name}"
        "{% endfor %}{', and ' ~ reading|amount(unit) ~ ' in readings, taken as exact' if reading}",
        "Leave the noise options out, so that it is estimated by group",
        title="noise in another proportion",
    ),
    "readings-exact": _info(
        "readings are taken as exact: if their noise is above {reading|amount(unit)}, ± of "
        "parameters are over a quarter too small, and {total|counted('row')} need not show it",
        "Give that noise (--noise-reading), leave all noise options out, or measure more poses",
    ),
    "terms-chosen": _info(
        "{parameters|join(', ')} were added because they fit these measurements",
        title="terms were chosen by the same measurements",
    ),
    "model-lacks": Wording(
        "{quantity}: residuals follow {TERMS[term][0]} ({p_value|chance}), which the model does "
        "not include; likely {TERMS[term][1]}",
        "Model it (pincal explain names the term), or remove the cause; measure in random order",
        title="residuals follow a pattern",
    ),
    "step": Wording(
        "{what|slipped(name)} is off by {size|amount(unit)} from data row {row} on "
        "({p_value|chance})",
        "Run pincal explain first; then {SLIPPED[what][1]}, and leave out the shorter part",
        title="a step",
    ),
    "rows-alike": Wording(
        "{quantity}: residuals of successive rows are correlated ({correlation|f(2)}, "
        "{p_value|chance}), and neither a step nor a steady drift explains it",
        "Look for slow changes (air, warming, a base that settles); wait longer between rows, and "
        "measure in random order",
        title="residuals correlated from row to row",
    ),
    "reference-moved": Wording(
        "the pose '{pose}', measured {rows|length} times, moved: {quantity} by {size|amount(unit)} "
        "from data row {row} to {rows[-1]} ({p_value|chance})",
        "Look for warming, or a tracker or base that moves; measure again when warm, or name the "
        "parts of the measurement in a column 'run'",
        title="a repeated pose moved",
    ),
    "outliers": Wording(
        "{rows|length} of {total} rows do{'es' if rows|length == 1} not fit the others: "
        "{'' if rows|length == 1 else 'worst '}data row {row}, by {sigma|f(1)} σ ({quantity} off "
        "by {off|f(1)} σ)",
        "{'First model what the residuals follow, which may be the cause; then check ' ~ them if "
        "lacking else 'Check ' ~ them ~ ', or leave ' ~ them ~ ' out (--loss reject)'}",
    ),
    "wrong-rows": Wording(
        "{% if rows|length == 1 %}data row {row} does not fit the others, by{% else %}"
        "{rows|length} data rows of {total}, {rows[:6]|listed}"
        "{% if rows|length > 6 %} and {rows|length - 6} more{% endif %}, do not fit the others, "
        "the first by{% endif %} {sigma|f(0)} σ ({quantity} off by {off|f(0)} σ): reduced χ² is "
        "{chi2|g} with {them} and {without|g} without; this result includes {them}",
        "Correct or remove {them}, or leave {them} out (--loss reject)",
        title="a few rows spoil the fit",
    ),
    "points-left-out": _info(
        "left out: {rows|length|counted('point')} in photos: {% for name in names[:6] %}"
        "{loop|joint}{name} of data row {rows[loop.index0]}{% endfor %}"
        "{% if rows|length > 6 %}, and {rows|length - 6} more{% endif %}",
    ),
    "many-outliers": Wording(
        "{(100 * share)|f(0)} % of the rows do not fit the others, worst data row {row}",
        "Correct the noise or the model before leaving rows out (--loss reject)",
        title="many rows do not fit",
    ),
    "held-out-worse": Wording(
        "{kind|default('held-out')} rows"
        "{' (fold ' ~ fold ~ ' of ' ~ folds ~ ')' if folds|default(1) > 1} miss by "
        "{held_out|f(2)} σ where {expected|f(2)} σ is expected ({p_value|chance}): the model fits "
        "its own rows better than the machine",
        "Measure more poses, or hold parameters (--fixed)",
        title="rows that were held out miss by more than expected",
    ),
    "wrong-verification": Wording(
        "{rows|length} of {total} verification rows do{'es' if rows|length == 1} not fit: "
        "{'' if rows|length == 1 else 'worst '}data row {row}, by {sigma|f(0)} σ ({quantity} off "
        "by {off|f(0)} σ){'; the others fit' if rows|length < total}",
        "Measure {them} again, or leave {them} out (--loss reject)",
        title="a verification row does not fit",
    ),
    "few-poses": Wording(
        "{legs|join(', ')}: only {poses|counted('pose')} for {unknowns} parameters",
        "Measure {2 * unknowns - poses} more: twice as many poses as parameters are advised",
        title="few poses",
    ),
    "weakly-determined": Wording(
        "{% if parameters|length == 1 %}{parameter} is weakly determined, known{% else %}"
        "{parameters|length} parameters are weakly determined, {parameter}{% endif %} only to ± "
        "{half|g(2)}{unit|si}",
        "Measure poses that determine it better"
        "{', hold it at nominal (leave out ' ~ option ~ ')' if option}, or give how well "
        "nominal values are known (--priors)",
    ),
    "undetermined-held": Wording(
        "these measurements do not determine all parameters: {groups|groups}"
        "{'; ' if groups and weak}{weak|named ~ ' are weakly determined' if weak}",
        "They were held near nominal; the calibration holds only where it was measured",
    ),
    "far-from-nominal": Wording(
        "{parameter} changed by {'%+.3g' % change}{unit|si}, more than a machine usually "
        "differs from its drawing",
        "Check units, the order of the readings, and the frame of the measurements"
        "{' (if unknown: --' ~ options|join(', --') ~ ')' if options}",
    ),
    "zeros-found": Wording(
        "reading zeros are far from nominal: {% for id, change, unit in changes %}"
        "{loop|joint}{id} by {change|g}{unit|si or ' '}{% endfor %}",
        "Expected if the motors were zeroed again; otherwise check the columns of these readings",
    ),
    "gauge-base-frame": _info(
        "the base frame ({freedoms|counted('freedom')}), since "
        "{% if unknown_frame %}the frame of the measurements is unknown{% else %}the measurements "
        "do not fix it{% endif %}",
    ),
    "gauge-platform-frame": _info(
        "the platform frame ({freedoms|counted('freedom')}), since the measurements do not show "
        "where the platform's points lie in it",
    ),
    "gauge-scale": _info(
        "the scale (1 freedom), since points touched at unknown places do not fix distances "
        "(give the places of two of them in the setup)",
    ),
    "redundant-parameters": _info(
        "{count|counted('parameter')} {'is' if count == 1 else 'are'} redundant whatever is "
        "measured: {groups|groups}",
    ),
}
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
    "rows-copied": Wording(
        "data rows {first[0] + 1} and {first[1] + 1} are identical"
        "{' (and %d more such pairs)' % (pairs - 1) if pairs > 1} and count once",
        "Repeated measurements would differ by noise: remove copies",
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
    "columns-coupled": _hypothesis(
        "{columns[0]} turns by its reading {'plus' if sign > 0 else 'less'} {columns[1]}",
        "Write that angle into its column (a parallelogram or a drive couples them)",
    ),
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
    "vector-is-angles": _hypothesis("rx, ry, rz are roll, pitch, yaw", "Name them so"),
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
#: Wordings of all codes.
WORDINGS: Mapping[str, Wording] = FINDINGS | FAULTS | HYPOTHESES


def finding(
    code: str, rows: Iterable[int] = (), parameters: Iterable[str] = (), **values: Any
) -> Finding:
    """Return the finding with a code; rows count from 0, values are in SI.

    Raises:
        KeyError: no finding has this code.
    """
    places = tuple(int(row) for row in rows)
    return Finding(code, WORDINGS[code].severity, values, places, tuple(parameters))


def causes(findings: Sequence[Finding]) -> str:
    """Return hypotheses that explain the measurements equally well, as parts of a sentence."""
    return ", or ".join(filled(HYPOTHESES[finding.code].says, finding) for finding in findings)


def explanation(findings: Sequence[Finding]) -> str:
    """Return one sentence for equally good hypotheses, followed by their remedies."""
    codes = [finding.code for finding in findings]
    codes += ["unknown-frame" for finding in findings if finding.values["unknown_frame"]]
    remedies = "; or: ".join(dict.fromkeys(HYPOTHESES[code].remedy for code in codes))
    return f"{causes(findings)}{filled(_MISSED, findings[0])}. {remedies}"


def sentence(finding: Finding) -> str:
    """Return a finding and its remedy in words, without a final full stop."""
    if finding.code in HYPOTHESES:
        return explanation([finding])
    wording = WORDINGS[finding.code]
    parts = (filled(words, finding) for words in (wording.says, wording.remedy))
    return ". ".join(filter(None, parts))


def sentences(findings: Iterable[Finding], *severities: str) -> list[str]:
    """Return the sentences of findings, or only of findings with the severities given.

    All hypotheses together make one sentence, since they explain the measurements equally well.
    """
    chosen = [finding for finding in findings if not severities or finding.severity in severities]
    hypotheses = [finding for finding in chosen if finding.code in HYPOTHESES]
    others = [sentence(finding) for finding in chosen if finding.code not in HYPOTHESES]
    return [explanation(hypotheses), *others] if hypotheses else others
