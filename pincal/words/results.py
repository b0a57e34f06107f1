"""What is said of a calibration's result: noise, fit, parameters, outliers, held-out rows, runs.

Each code's ``values`` say what a finding of it holds, in SI; ids are those of parameters
(``leg_1.l``). Rows and parameters concerned are the finding's own ``rows`` and ``parameters``.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pincal.model.finding import Finding
from pincal.words.numbers import amount, counted, listed, size
from pincal.words.wording import Wording, groups_in_words

#: How each option is named that lets a calibration look for what its data leave open.
_OPTIONS = {
    "unknown-frame": "the base may be elsewhere in the frame of the measurements (--unknown-frame)",
    "unknown-target": "what was measured may not be the platform's origin (--unknown-target or "
    "--setup)",
}


def _noise_assumed(found: Finding) -> str:
    v = found.values
    groups = ["position [m]", *["orientation [rad]"] * v["turns"], *["readings"] * v["readings"]]
    exact = "" if v["readings"] else ", exact readings"
    return (
        f"the noise was not given: equal standard deviations of {listed(groups)}{exact} were "
        "assumed, and the scale was estimated from the residuals"
    )


def _noise_estimated(found: Finding) -> str:
    return f"the noise was not given: it was estimated from the residuals, {noise(found.values)}"


def noise(values: Mapping[str, Any]) -> str:
    """Return standard deviations of ``position``, ``orientation`` and ``reading``; 0 is exact."""
    parts = []
    if values["position"] is not None:
        parts.append(f"{amount(values['position'], 'm')} in position")
    if values["orientation"] is not None:
        parts.append(f"{amount(values['orientation'], 'rad')} in orientation")
    reading = values["reading"]
    if reading:
        parts.append(f"{1e3 * reading:.3g} mm or mrad in readings")
    return ", ".join(parts if reading else [*parts, "readings exact"])


def _chi2(found: Finding) -> str:
    v = found.values
    larger = found.code == "chi2-too-large"
    given = "repeated rows show" if v["source"] == "repeats" else "given"
    return (
        f"reduced χ² is {v['chi2']:.3g} where 1 is expected: the noise is "
        f"{'larger' if larger else 'smaller'} than {given}"
        f"{', or the model lacks something' if larger else ''}; the uncertainties assume that noise"
    )


_CHI2_VALUES = {
    "chi2": "reduced χ²",
    "dof": "degrees of freedom",
    "source": 'where the noise comes from: "given", "rows" or "repeats"',
}
_GIVE_NOISE = "Give the noise (--noise-position, --noise-orientation, --noise-reading)"


def _weak(found: Finding) -> str:
    v, count = found.values, len(found.parameters)
    which = f"{v['parameter']} is" if count == 1 else f"{count} parameters are"
    worst = "known" if count == 1 else f"{v['parameter']}"
    return f"{which} weakly determined, {worst} to ± {v['half']:.2g} {_si(v['unit'])} only".replace(
        "  ", " "
    )


def _weak_remedy(found: Finding) -> str:
    hold = "" if found.values["held"] else ", hold it at nominal (--hold-undetermined)"
    return f"Measure poses that determine more{hold}, or say how well nominal values are known " + (
        "(--prior)"
    )


def _si(unit: str) -> str:
    return "" if unit == "1" else unit


def _far(found: Finding) -> str:
    v = found.values
    by = f"{v['change']:+.3g} {_si(v['unit'])}".strip()
    return f"{v['parameter']} moved by {by}, farther than a machine differs from its drawing"


def _far_remedy(found: Finding) -> str:
    return (
        "Check units, the order of the readings, and the frame of the measurements"
        f"{options(found.values['options'])}"
    )


def options(left: tuple[str, ...]) -> str:
    """Return options that were not used and may help, in brackets; empty if there are none."""
    return f" ({'; '.join(_OPTIONS[one] for one in left)})" if left else ""


def _outliers(found: Finding) -> str:
    v, count = found.values, len(found.rows)
    which = "data row" if count == 1 else "the worst data row"
    return (
        f"{count} of {v['total']} rows do{'es' * (count == 1)} not fit the others, {which} "
        f"{found.rows[0] + 1} by {v['sigma']:.1f} standard deviations ({v['quantity']} off by "
        f"{v['off']:.1f} σ)"
    )


def _outliers_remedy(found: Finding) -> str:
    them = "it" if len(found.rows) == 1 else "them"
    return f"Look at {them}, or use a robust loss (--robust reject)"


def _few(found: Finding) -> str:
    v = found.values
    return f"{', '.join(v['legs'])}: {v['poses']} poses for {v['unknowns']} parameters"


def _held_out(found: Finding) -> str:
    v = found.values
    return (
        f"held-out rows miss by {v['held_out']:.2f} standard deviations where "
        f"{v['expected']:.2f} are expected (p = {v['p_value']:.1g}): the model follows its rows "
        "more closely than the machine"
    )


def _drift(found: Finding) -> str:
    v = found.values
    return (
        f"{v['leg']}: residuals follow the order of the rows (rank correlation "
        f"{v['correlation']:+.2f}, p = {v['p_value']:.1g}): drift, of temperature or of a "
        "reference, is likely"
    )


def _runs(found: Finding) -> str:
    v = found.values
    return (
        f"parameters differ between runs {v['ratio']:.1f} times as much as their standard errors "
        f"say (p = {v['p_value']:.1g}), {', '.join(found.parameters)} most: something changed "
        "between runs, or the noise is larger than given"
    )


def _tie(found: Finding) -> str:
    v = found.values
    return (
        f"{v['name']} is tied over the legs, and the measurements contradict that "
        f"(p = {v['p_value']:.2g})"
    )


def _one_body(found: Finding) -> str:
    v = found.values
    by = size(v["shift"], v["turn"])
    return (
        f"{100 * v['share']:.0f} % of what the nominal model is off by (in squares) is one motion "
        f"of the {v['frame']}'s frame, by {by}; parameters that differ each in its own way hardly "
        f"move so (p = {v['p_value']:.1g})"
    )


def _one_body_remedy(found: Finding) -> str:
    how = {
        "unknown-frame": "Is the tracker's frame the base's (--unknown-frame)?",
        "unknown-target": "Is the target the platform's origin (--unknown-target)?",
    }[found.values["option"]]
    return f"{how} Else where the frame lies is taken for errors of the machine"


def _unequal(found: Finding) -> str:
    v = found.values
    return (
        "equal noise was assumed in position [m] and orientation [rad], but misfits are "
        f"{v['position_ratio']:.2f} and {v['orientation_ratio']:.2f} times as large as it makes "
        "them"
    )


def _unequal_remedy(found: Finding) -> str:
    v = found.values
    return (
        f"Give it (--noise-position {v['position']:.2g} --noise-orientation "
        f"{v['orientation']:.2g} fit the residuals)"
    )


def _held(found: Finding) -> str:
    v = found.values
    parts = [groups_in_words(v["groups"])] if v["groups"] else []
    parts += [f"{listed(v['weak'])} are weakly determined"] if v["weak"] else []
    return f"these measurements do not determine everything: {'; '.join(parts)}"


def _unused(found: Finding) -> str:
    v = found.values
    return f"{v['unused']} of {v['total']} measured poses serve other legs only"


def _excess(found: Finding) -> str:
    more = (
        f"residuals are {found.values['excess']:.3g} times as large as the noise given makes them"
    )
    return f"no accuracy can be promised: {more}" + (
        "" if found.code == "residuals-too-large" else ", and hardly fell"
    )


_P = "probability of such a value, or a larger one, if the model is right"
RESULTS: dict[str, Wording] = {
    "not-converged": Wording(
        "The fit did not converge",
        {"message": "why the search ended"},
        lambda f: f"the fit did not converge: {f.values['message']}",
        "The search for the parameters ended without an answer: there is no calibrated mechanism.",
        "Look at the units and at the working mode; give a better nominal mechanism, more poses, "
        "or a robust loss (--robust reject)",
        "error",
    ),
    "not-corrected": Wording(
        "The fit failed",
        {"excess": "root of the reduced χ²"},
        _excess,
        "Parameters that fit no better than nominal ones correct nothing.",
        "",
        "error",
    ),
    "residuals-too-large": Wording(
        "No accuracy can be promised",
        {"excess": "root of the reduced χ²"},
        _excess,
        "Something is wrong with rows, noise or model, and the parameters follow it.",
        "",
        "error",
    ),
    "noise-assumed": Wording(
        "Noise not given",
        {
            "turns": "whether the platform has an orientation",
            "readings": "whether readings were taken as noisy",
        },
        _noise_assumed,
        "Residuals cannot contradict the model, and position is weighed against orientation by a "
        "guess.",
        f"{_GIVE_NOISE}, sigma_… columns, or rows measured repeatedly",
    ),
    "noise-estimated": Wording(
        "Noise estimated by group",
        {
            "position": "standard deviation [m]; None if no position was measured",
            "orientation": "standard deviation [rad]; None if no orientation was measured",
            "reading": "standard deviation [rad or m]; 0 if readings were taken as exact",
        },
        _noise_estimated,
        "Variance components of positions, orientations and readings were estimated with the "
        "parameters: residuals cannot contradict the model.",
        f"{_GIVE_NOISE}, if it is known",
    ),
    "unequal-noise": Wording(
        "Noise of position and orientation is not equal",
        {
            "position_ratio": "misfits of positions over those that the assumed noise makes",
            "orientation_ratio": "the same of orientations",
            "position": "standard deviation that fits the residuals [m]",
            "orientation": "standard deviation that fits the residuals [rad]",
        },
        _unequal,
        "The noise was not given, and residuals of positions and of orientations show two scales.",
        _unequal_remedy,
    ),
    "chi2-too-large": Wording(
        "Residuals larger than the noise",
        _CHI2_VALUES,
        _chi2,
        "Residuals are larger than the noise given makes them: intervals are too narrow, and the "
        "model may lack something, such as play, bending, temperature, a wrong unit or frame.",
        "Look at the residuals in the report for what they follow, and at outlying rows",
    ),
    "chi2-too-small": Wording(
        "Residuals smaller than the noise",
        _CHI2_VALUES,
        _chi2,
        "Residuals are smaller than the noise given makes them: intervals are too wide.",
        "Correct the noise, if it is known to be smaller",
    ),
    "outliers": Wording(
        "Outliers",
        {
            "total": "number of rows",
            "sigma": "residual of the worst row [standard deviations]",
            "quantity": "which of its residuals is largest, such as x or leg_1",
            "off": "size of that residual [standard deviations]",
        },
        _outliers,
        "Rows miss by more than one good row in a thousand does. The finding's rows are those, the "
        "worst first.",
        _outliers_remedy,
    ),
    "many-outliers": Wording(
        "Many rows do not fit",
        {"share": "share of the rows"},
        lambda f: f"{100 * f.values['share']:.0f} % of the rows do not fit",
        "More than a tenth of the rows are outliers: rather the noise is larger than given, or the "
        "model lacks something, than that so many are wrong.",
        "Correct the noise or the model before leaving rows out",
    ),
    "slips": Wording(
        "Few rows far from the nominal mechanism",
        {"times": "how many times as far as rows usually do the worst row misses"},
        lambda f: (
            f"data row {f.rows[0] + 1} misses the nominal mechanism {f.values['times']:.3g} times "
            f"as far as rows usually do"
            + (f", and {counted(len(f.rows) - 1, 'more row')} so" if len(f.rows) > 1 else "")
        ),
        "The fit failed, and few rows are far from where the others are. The finding's rows are "
        "those, the worst first.",
        "Look for a slip there first, or leave such rows out (--robust reject)",
    ),
    "few-poses": Wording(
        "Few poses",
        {
            "legs": "names of the legs",
            "poses": "number of poses of each",
            "unknowns": "number of parameters of each",
        },
        _few,
        "So few equations that residuals are small whatever the machine is.",
        "Measure more: two or three times as many poses as parameters are advised",
    ),
    "unused-poses": Wording(
        "Poses that serve one leg only",
        {"unused": "number of poses that do not serve every leg", "total": "number of poses"},
        _unused,
        "Each leg was identified by the poses of its set only.",
        "--poses all lets every leg use every pose",
        "info",
    ),
    "weakly-determined": Wording(
        "Weakly determined parameters",
        {
            "parameter": "id of the worst",
            "half": "half width of its 95 % interval [unit]",
            "unit": "its unit",
            "held": "whether undetermined directions were held already",
        },
        _weak,
        "A standard error is larger than machines differ from their drawings: the number is noise. "
        "The finding's parameters are all of them.",
        _weak_remedy,
    ),
    "undetermined-held": Wording(
        "Undetermined parameters were held",
        {
            "groups": "ids of parameters that move together, a tuple for each lost direction",
            "weak": "ids of parameters that are weakly determined and were held too",
        },
        _held,
        "What is named was held as near to nominal as can be: the machine is calibrated where it "
        "was measured; elsewhere it may be off.",
        "Held as near to nominal as can be, so that the machine is calibrated where it was "
        "measured only",
    ),
    "far-from-nominal": Wording(
        "A parameter moved far",
        {
            "parameter": "id",
            "change": "identified less nominal [unit]",
            "unit": "its unit",
            "options": 'options that were not used: of "unknown-frame", "unknown-target"',
        },
        _far,
        "A parameter moved by more than 5 % of the mechanism's size, or 0.05 rad or 1. If the "
        "drawing is known roughly only, say so (--rough).",
        _far_remedy,
    ),
    "moved-as-one-body": Wording(
        "Parameters moved as one body",
        {
            "frame": '"base" or "platform"',
            "share": "share of the squares of the nominal model's error",
            "shift": "translation of the frame [m]",
            "turn": "rotation of the frame [rad]; None for a platform that does not turn",
            "p_value": "probability of so much motion as one body by chance",
            "option": '"unknown-frame" or "unknown-target"',
        },
        _one_body,
        "More likely the tracker, or the target, was not aligned, than that the machine is such.",
        _one_body_remedy,
    ),
    "tie-contradicted": Wording(
        "A tie does not hold",
        {"name": "name of the tied parameters, or several with commas", "p_value": _P},
        _tie,
        "The legs differ in this parameter by more than their standard errors explain (1 %).",
        "Leave the tie out (--tie)",
    ),
    "held-out-worse": Wording(
        "Held-out rows miss by more than is expected",
        {
            "held_out": "root mean square residual of held-out rows [standard deviations]",
            "expected": "the same, as expected",
            "p_value": _P,
        },
        _held_out,
        "Rows that a fit has not seen miss by more than is explained (p below 0.001).",
        "Measure more poses, or fix parameters",
    ),
    "drift": Wording(
        "Residuals follow the order of the rows",
        {"leg": "name of the leg", "correlation": "rank correlation", "p_value": "its probability"},
        _drift,
        "Drift: of temperature, of a reference, of the tracker.",
        "Measure in another order, or again when warm; name runs in a column run",
    ),
    "runs-differ": Wording(
        "Runs differ",
        {"ratio": "spread over the runs, in predicted standard errors", "p_value": _P},
        _runs,
        "Runs, calibrated each alone, spread more than their standard errors say (p below 0.001). "
        "The finding's parameters are the three that differ most.",
        "Find what changed between runs",
    ),
}
