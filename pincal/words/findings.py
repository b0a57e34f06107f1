"""Findings and their sentences, by code; ``docs/errors.md`` explains each code."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from pincal.finding import Finding
from pincal.words.faults import FAULTS, HYPOTHESES, explanation
from pincal.words.wording import Wording, filled

_EXCESS = "no accuracy can be stated: residuals are {excess|g} times as large as the noise given"
_FIRST = "See the other warnings first"
_GIVE_NOISE = "Give the noise (--noise-position, --noise-orientation, --noise-reading)"
_SOURCE = "{'repeated rows show' if source == 'repeats' else 'given'}"
_CHI2 = "reduced χ² is {chi2|rounded(3)} where 1 is expected: the noise is "
_ASSUMED = "the uncertainties assume that noise"

FINDINGS: dict[str, Wording] = {
    "not-converged": Wording(
        "the fit did not converge: {message}",
        "Check the units and the working mode; give a better nominal mechanism, more poses, or a "
        "robust loss (--loss reject)",
        "error",
    ),
    "not-corrected": Wording(_EXCESS + ", and hardly decreased", _FIRST, "error"),
    "residuals-too-large": Wording(_EXCESS, _FIRST, "error"),
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
        "{% for name, ratio in ratios.items() %}{(100 * ratio)|f(0)} % of it in {name}"
        "{', ' if not loop.last}{% endfor %}",
        "Leave the noise options out, so that it is estimated by group",
        title="noise in another proportion",
    ),
    "terms-chosen": Wording(
        "{parameters|join(', ')} were added because they fit these measurements",
        severity="info",
        title="terms were chosen by the same measurements",
    ),
    "model-lacks": Wording(
        "{quantity}: residuals follow {TERMS[term][0]} ({p_value|chance}), which the model does "
        "not include; likely {TERMS[term][1]}",
        "Model it (pincal explain names the term), or remove the cause; measure in random order",
        title="residuals follow a pattern",
    ),
    "step": Wording(
        "{SLIPPED[what][0] % {'name': name}} is off by {size|amount(unit)} from data row {row} on "
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
        "lacking else 'Check ' ~ them ~ ', or use a robust loss (--loss reject)'}",
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
    "points-left-out": Wording(
        "left out: {rows|length|counted('point')} in photos: {% for name in names[:6] %}"
        "{loop|joint}{name} of data row {rows[loop.index0]}{% endfor %}"
        "{% if rows|length > 6 %}, and {rows|length - 6} more{% endif %}",
        severity="info",
    ),
    "many-outliers": Wording(
        "{(100 * share)|f(0)} % of the rows do not fit the others, worst data row {row}",
        "Correct the noise or the model before leaving rows out (--loss reject)",
        title="many rows do not fit",
    ),
    "held-out-worse": Wording(
        "{kind|default('held-out')} rows miss by {held_out|f(2)} σ where {expected|f(2)} σ is "
        "expected ({p_value|chance}): the model fits its own rows better than the machine",
        "Measure more poses, or hold parameters (--fixed)",
        title="rows that were held out miss by more than expected",
    ),
    "wrong-verification": Wording(
        "{rows|length} of {total} verification rows do{'es' if rows|length == 1} not fit: "
        "{'' if rows|length == 1 else 'worst '}data row {row}, by {sigma|f(0)} σ ({quantity} off "
        "by {off|f(0)} σ); the others fit",
        "Measure {them} again, or leave {them} out (--loss reject)",
        title="a verification row does not fit",
    ),
    "tolerance-found": Wording(
        "{% set kinds = {'m': 'lengths', 'rad': 'angles', '1': 'gains'}[unit] %}"
        "{% if size|finite %}{kinds} differ from the drawing by {size|amount(unit)} (standard "
        "deviation of {count}; 95 %: {low|amount(unit)} "
        "{'to ' ~ high|amount(unit) if high|finite else 'or more'})"
        "{% else %}from {count} {kinds} no tolerance can be estimated{% endif %}",
        "{% if not size|finite %}They are free; give their tolerance (--tolerance, --priors) if "
        "it is known{% elif not low %}They may be as drawn{% endif %}",
        "info",
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
    "gauge-base-frame": Wording(
        "the base frame ({freedoms|counted('freedom')}), since "
        "{% if unknown_frame %}the frame of the measurements is unknown{% else %}the measurements "
        "do not fix it{% endif %}",
        severity="info",
    ),
    "gauge-platform-frame": Wording(
        "the platform frame ({freedoms|counted('freedom')}), since the measurements do not show "
        "where the platform's points lie in it",
        severity="info",
    ),
    "gauge-scale": Wording(
        "the scale (1 freedom), since points touched at unknown places do not fix distances "
        "(give the places of two of them in the setup)",
        severity="info",
    ),
    "redundant-parameters": Wording(
        "{count|counted('parameter')} {'is' if count == 1 else 'are'} redundant whatever is "
        "measured: {groups|groups}",
        severity="info",
    ),
}
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
