"""Sentences of findings about a calibration: its fit, its rows, its parameters, its freedoms.

One table for each kind, from code to ``Wording``; those of measurements that cannot be right are in
``faults``. What values mean: ``docs/errors.py``.
"""

from __future__ import annotations

from pincal.words.wording import Wording

_EXCESS = (
    "no accuracy can be promised: residuals are {excess|g} times as large as the noise given "
    "makes them"
)
_GIVE_NOISE = "Give the noise (--noise-position, --noise-orientation, --noise-reading)"
_SOURCE = "{'repeated rows show' if source == 'repeats' else 'given'}"
_CHI2 = "reduced χ² is {chi2|rounded(3)} where 1 is expected: the noise is "
_ASSUMED = "the uncertainties assume that noise"

RESULTS: dict[str, Wording] = {
    "not-converged": Wording(
        "The fit did not converge",
        "the fit did not converge: {message}",
        "The search for the parameters ended without an answer: there is no calibrated mechanism.",
        "Look at the units and at the working mode; give a better nominal mechanism, more poses, "
        "or a robust loss (--loss reject)",
        "error",
    ),
    "not-corrected": Wording(
        "The fit failed",
        _EXCESS + ", and hardly fell",
        "Parameters that fit no better than nominal ones correct nothing.",
        "Look at the warnings first",
        "error",
    ),
    "residuals-too-large": Wording(
        "No accuracy can be promised",
        _EXCESS,
        "Something is wrong with rows, noise or model, and the parameters follow it.",
        "Look at the warnings first",
        "error",
    ),
    "no-noise": Wording(
        "Measurements without noise",
        "residuals are rounding errors: nothing was measured like that",
        "Uncertainties and tests come from the size of residuals, and these have none. So it is "
        "with simulated data without noise.",
        "Say how well you will measure (--noise-position, --noise-orientation, --noise-reading)",
    ),
    "noise-estimated": Wording(
        "Noise estimated by group",
        "the noise was not given: it was estimated from the residuals, "
        "{noise_in_words(position, orientation, reading, units)}",
        "Variance components of positions, orientations and readings were estimated with the "
        "parameters: residuals cannot contradict the model.",
        f"{_GIVE_NOISE}, if it is known",
    ),
    "chi2-too-large": Wording(
        "Residuals larger than the noise",
        f"{_CHI2}larger than {_SOURCE}, or the model lacks something; {_ASSUMED}",
        "Residuals are larger than the noise given makes them: intervals are too narrow, and the "
        "model may lack something, such as play, bending, temperature, a wrong unit or frame.",
        "See what they follow (pincal explain), and look at outlying rows",
        unsaid="dof",
    ),
    "chi2-too-small": Wording(
        "Residuals smaller than the noise",
        f"{_CHI2}smaller than {_SOURCE}; {_ASSUMED}",
        "Residuals are smaller than the noise given makes them: intervals are too wide.",
        "Correct the noise, if it is known to be smaller",
        unsaid="dof",
    ),
    "noise-in-other-proportion": Wording(
        "Noise in another proportion",
        "the noise is not in the proportion given ({p_value|chance}): residuals show "
        "{% for name, ratio in ratios.items() %}{(100 * ratio)|f(0)} % of it in {name}"
        "{', ' if not loop.last}{% endfor %}",
        "Some measured quantities are noisier than given, others less (p below 0.01): weights and "
        "intervals are wrong though χ² may look right.",
        "Leave the noise out: it is then estimated by group",
    ),
    "curved": Wording(
        "Intervals of a curved problem",
        "within one standard error the problem is curved: the curved part of the residuals' change "
        "is {curvature|g(2)} of the straight one",
        "Standard errors come from a straight line through a curve, and joint intervals are too "
        "small where it bends by half or more.",
        "Measure more poses, or with less noise",
    ),
    "beyond-measured": Wording(
        "Outside the measured region",
        "{share|percent} of the workspace lies outside the measured region"
        "{% if undetermined < 1 %}: expect {size_in_words(position, orientation)} there, if the "
        "model holds as it does where it was measured{% endif %}"
        "{% if undetermined %}; {undetermined|percent} of that is not determined at all{% endif %}"
        ". No limit is promised there",
        "The measured region is where the platform is no more uncertain than at the most uncertain "
        "pose that was measured. Beyond, nothing measured shows what the model lacks: bending, "
        "clearance or a scale that parameters took up where it was measured.",
        "Measure there too (pincal select), or keep to the measured region",
        "info",
    ),
    "terms-chosen": Wording(
        "Terms were chosen by the same measurements",
        "{parameters|join(', ')} were added because they fit these measurements",
        "A wrong term takes up what residuals showed: they do not contradict it any more. No limit "
        "is promised until held-out rows vouch for it.",
        severity="info",
        general="Hold rows out (--folds, result.validated())",
    ),
    "promise-leaves-out": Wording(
        "What the promise leaves out",
        "the promise leaves out {what|of(UNCOVERED)|listed}: nothing was said of that",
        "Parameters take these up, so that residuals show them only if they are large.",
        severity="info",
        general="Terms of loads (--terms) take in weight, systematic: in the setup scale and "
        "temperature; a pose that is measured again and again shows what changes "
        "with time",
    ),
}
ROWS: dict[str, Wording] = {
    "model-lacks": Wording(
        "Residuals follow something",
        "{quantity}: residuals follow {TERMS[term][0]} ({p_value|chance}), and the model has "
        "nothing for that: {TERMS[term][1]}",
        "Residuals follow what the model lacks, more than chance explains (p below 0.01, all tests "
        "together): intervals and platform errors are too small by nobody knows how much.",
        "Model it (pincal explain says which term pays) or remove its cause; measure in a mixed "
        "order",
    ),
    "step": Wording(
        "A step",
        "{quantity} is off by {size|amount(unit)} from data row {row} on ({p_value|chance})",
        "A sensor, target or frame changed its place during the experiment. The finding's row is "
        "the first after it.",
        "Look for an encoder that slipped, or a target that was hit; leave the shorter part out",
    ),
    "reference-moved": Wording(
        "A pose moved that was measured again",
        "the pose '{pose}', measured {rows|length} times: {quantity} moved by {size|amount(unit)} "
        "from data row {row} to {rows[-1]} ({p_value|chance})",
        "What was measured of one pose, four times or more, moved with time, more than readings "
        "and noise explain. The finding's rows are those of the pose.",
        "Look for what warms up, a tracker or a base that moves; measure again when warm, or the "
        "run in parts, named in a column run",
    ),
    "outliers": Wording(
        "Outliers",
        "{rows|length} of {total} rows do{'es' if rows|length == 1} not fit the others, "
        "{'' if rows|length == 1 else 'the worst '}data row {row} by {sigma|f(1)} standard "
        "deviations ({quantity} off by {off|f(1)} σ)",
        "Rows miss by more than chance explains, however many there are (one sound calibration in "
        "a hundred has any). The finding's rows are those, the worst first.",
        "{'First model what residuals follow: that may be why; then look at ' ~ them if lacking "
        "else 'Look at ' ~ them ~ ', or use a robust loss (--loss reject)'}",
        general="Look at them: a slip, a lost beam, a wrong set. --loss reject leaves them out "
        "and lists them",
    ),
    "wrong-rows": Wording(
        "Few rows spoil the fit",
        "{% if rows|length == 1 %}data row {row} does not fit the others, by{% else %}"
        "{rows|length} data rows of {total}, {rows[:6]|listed}"
        "{% if rows|length > 6 %} and {rows|length - 6} more{% endif %}, do not fit the others, "
        "the first by{% endif %} {sigma|f(0)} standard deviations ({quantity} off by {off|f(0)} "
        "σ): reduced χ² is {chi2|g} with {them}, {without|g} without, and what follows is with",
        "Residuals are too large for the noise given, and a fit that rejects few rows has some "
        "as large as that noise: noise and model are right, these rows are not. Parameters are "
        "still those of all rows.",
        "Mend or remove {them}, or leave {them} out by --loss reject",
        general="Mend or remove these rows, or leave them out by --loss reject",
    ),
    "many-outliers": Wording(
        "Many rows do not fit",
        "{(100 * share)|f(0)} % of the rows do not fit the others, data row {row} least",
        "More than a tenth of the rows are outliers: rather the noise is larger than given, or the "
        "model lacks something, than that so many are wrong. The finding's rows are those.",
        "Correct the noise or the model before leaving rows out (--loss reject)",
    ),
    "held-out-worse": Wording(
        "Held-out rows miss by more than is expected",
        "held-out rows miss by {held_out|f(2)} standard deviations where {expected|f(2)} are "
        "expected ({p_value|chance}): the model follows its rows more closely than the machine",
        "Rows that a fit has not seen miss by more than is explained (p below 0.001).",
        "Measure more poses, or fix parameters",
    ),
}
PARAMETERS: dict[str, Wording] = {
    "tolerance-found": Wording(
        "Tolerances found with the parameters",
        "{% set kinds = {'m': 'lengths', 'rad': 'angles', '1': 'gains'}[unit] %}"
        "{% if size|finite %}{kinds} differ from the drawing by {size|amount(unit)}, standard "
        "deviation of {count} (95 %: {low|amount(unit)} "
        "{'to ' ~ high|amount(unit) if high|finite else 'or more'})"
        "{% else %}how far {kinds} are from the drawing is not said by {count} of them{% endif %}",
        "--tolerance auto: one variance component for each unit, found by restricted maximum "
        "likelihood, is the prior of the parameters of that unit.",
        "{% if not size|finite %}They are free; give their tolerance (--tolerance, --priors), if "
        "it is known{% elif not low %}Measurements do not separate them from the drawing"
        "{% endif %}",
        "info",
        "Where measurements do not say it, give the tolerance (--tolerance 0.5mm,5mrad)",
    ),
    "few-poses": Wording(
        "Few poses",
        "{legs|join(', ')}: {poses} poses for {unknowns} parameters",
        "So few equations that residuals are small whatever the machine is.",
        "Measure more: two or three times as many poses as parameters are advised",
    ),
    "weakly-determined": Wording(
        "Weakly determined parameters",
        "{% if parameters|length == 1 %}{parameter} is weakly determined, known{% else %}"
        "{parameters|length} parameters are weakly determined, {parameter}{% endif %} to ± "
        "{half|g(2)}{unit|si} only",
        "A standard error is larger than machines differ from their drawings: the number is noise. "
        "The finding's parameters are all of them.",
        "Measure poses that determine more"
        "{', hold it at nominal (leave out --strict)' if not held}, or say how well nominal "
        "values are known (--priors)",
        general="Measure poses that determine more (pincal select), hold what is undetermined "
        "(leave out --strict; --fixed), or say how well nominal values are known (--priors)",
    ),
    "undetermined-held": Wording(
        "Undetermined parameters were held",
        "these measurements do not determine everything: {groups|groups}{'; ' if groups and weak}"
        "{weak|listed ~ ' are weakly determined' if weak}",
        "What is named was held as near to nominal as can be: the machine is calibrated where it "
        "was measured; elsewhere it may be off.",
        "Held as near to nominal as can be, so that the machine is calibrated where it was "
        "measured only",
    ),
    "far-from-nominal": Wording(
        "A parameter moved far",
        "{parameter} moved by {'%+.3g' % change}{unit|si}, farther than a machine differs from its "
        "drawing",
        "A parameter moved by more than 5 % of the mechanism's size, or 0.05 rad or 1. If the "
        "drawing is known roughly only, say so (--rough).",
        "Check units, the order of the readings, and the frame of the measurements"
        "{' (' ~ options|of(UNUSED_OPTIONS)|join('; ') ~ ')' if options}",
        general="Check units, the order of the readings, and the frame and target of the "
        "measurements (--unknown-frame, --unknown-target)",
    ),
    "zeros-found": Wording(
        "Zeros of motors are far off",
        "zeros of readings are far from the drawing's: {% for id, change, unit in changes %}"
        "{loop|joint}{id} by {change|g}{unit|si or ' '}{% endfor %}",
        "Nothing but other zeros explains the measurements, and full poses give these in closed "
        "form: the search started there. The other parameters stay near the drawing.",
        "Nothing to do if the motors were zeroed anew; else look at the columns of these readings",
    ),
    "sign-changed": Wording(
        "A length changed its sign",
        "lengths changed their sign: {% for id, nominal, length in lengths %}{loop|joint}{id} from "
        "{nominal|g(4)} to {length|g(4)} m{% endfor %}",
        "The mirror image of a leg fits, or the search went astray: a length of the drawing cannot "
        "be negative.",
        "Correct the nominal values (zeros of motors first), or fix these lengths (--fixed)",
    ),
}
_NEAREST = "Of equal parameters, those nearest to nominal were taken."
FREEDOMS: dict[str, Wording] = {
    "gauge-base-frame": Wording(
        "Gauge freedom of the base frame",
        "the base frame: {freedoms|counted('freedom')}, since "
        "{% if unknown_frame %}the frame of the measurements is unknown{% else %}what was measured "
        "does not fix it{% endif %}",
        f"Moving the base frame with all base points changes nothing that is measured. {_NEAREST}",
        severity="info",
    ),
    "gauge-platform-frame": Wording(
        "Gauge freedom of the platform's frame",
        "the platform's frame: {freedoms|counted('freedom')}, since what was measured does not say "
        "how the platform's points lie in it",
        f"Moving the platform's frame in the platform changes nothing that is measured. {_NEAREST}",
        severity="info",
    ),
    "redundant-parameters": Wording(
        "Redundant parameters",
        "{count|counted('parameter is', 'parameters are')} redundant, whatever is measured: "
        "{groups|groups}",
        f"Some parameters do the same to the platform as others. {_NEAREST}",
        severity="info",
    ),
}
