"""What is said of a calibration's fit: convergence, noise, χ², intervals, and what is promised.

Each code's ``values`` say what a finding of it holds, in SI; rows
and parameters concerned are the finding's own ``rows`` and ``parameters``.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from pincal.finding import Finding
from pincal.words.numbers import (
    SMALL,
    amount,
    chance,
    counted,
    listed,
    number,
    percent,
    rounded,
    size,
)
from pincal.words.wording import P_VALUE, Wording


def _noise_estimated(finding: Finding) -> str:
    return f"the noise was not given: it was estimated from the residuals, {noise(finding.values)}"


def noise(values: Mapping[str, Any]) -> str:
    """Return standard deviations of ``position``, ``orientation`` and ``reading``; 0 is exact.

    ``units`` are those of the readings, or what they may be where legs differ.
    """
    parts = []
    if values["position"] is not None:
        parts.append(f"{amount(values['position'], 'm')} in position")
    if values["orientation"] is not None:
        parts.append(f"{amount(values['orientation'], 'rad')} in orientation")
    reading = values["reading"]
    if reading:
        units = listed((SMALL[unit] for unit in values["units"]), "or")
        parts.append(f"{number(reading, values['units'][0])} {units} in readings")
    return ", ".join(parts if reading else [*parts, "readings exact"])


def systematic(values: Mapping[str, float]) -> str:
    """Return what is off by the same in all rows: ``relative``, ``target``, ``share`` of errors."""
    parts = []
    if values["relative"]:
        parts.append(f"{1e6 * values['relative']:.3g} µm/m of all lengths")
    if values["target"]:
        parts.append(f"{amount(values['target'], 'm')} of each known target")
    return (
        f"every ± holds what more rows do not make smaller, {listed(parts)}: "
        f"{100 * values['share']:.2g} % of the platform's expected mean square error of position"
    )


def missed(values: Mapping[str, Any]) -> str:
    """Return how far a target is missed at held-out rows: the values of a ``Missed``."""
    unit, quantity = values["unit"], {"m": "position", "rad": "orientation"}[values["unit"]]
    low, high = values["rms_ends"]
    ends = f" (95 %: {number(low, unit)} to {number(high, unit)})" if np.isfinite(high) else ""
    return (
        f"{quantity} of {values['target']!r} is missed by {amount(values['rms'], unit)}{ends} held "
        f"out, root mean square of {counted(values['poses'], 'pose')}, by "
        f"{number(values['mean'], unit)} on average and {number(values['largest'], unit)} at most; "
        f"by {number(values['fit'], unit)} in the fit"
    )


def _chi2(finding: Finding) -> str:
    v = finding.values
    larger = finding.code == "chi2-too-large"
    source = "repeated rows show" if v["source"] == "repeats" else "given"
    return (
        f"reduced χ² is {rounded(v['chi2'], 3)} where 1 is expected: the noise is "
        f"{'larger' if larger else 'smaller'} than {source}"
        f"{', or the model lacks something' if larger else ''}; the uncertainties assume that noise"
    )


_CHI2_VALUES = {
    "chi2": "reduced χ²",
    "dof": "degrees of freedom",
    "source": 'where the noise comes from: "given", "rows" or "repeats"',
}
_GIVE_NOISE = "Give the noise (--noise-position, --noise-orientation, --noise-reading)"


def _curved_remedy(finding: Finding) -> str:
    measure = "Measure more poses, or with less noise"
    if finding.values.get("intervals") == "profile":
        return f"{measure}; intervals are those of the profile, platform errors are too small"
    return f"Ask for intervals by the profile of the cost (--intervals profile). {measure}"


def _proportion(finding: Finding) -> str:
    v = finding.values
    parts = (f"{100 * ratio:.0f} % of it in {name}" for name, ratio in v["ratios"].items())
    return (
        f"the noise is not in the proportion given ({chance(v['p_value'])}): residuals "
        f"show {', '.join(parts)}"
    )


_EXCESS = (
    "no accuracy can be promised: residuals are {excess:.3g} times as large as the noise given "
    "makes them"
)
#: What a promise may leave out.
UNCOVERED = {
    "weight": "bending under weight",
    "scale": "a wrong scale or temperature",
    "time": "what slips or warms during the run",
}


def region_words(share: float, *, sampled: bool) -> str:
    """Return over which poses means are taken: the measured ones, or a share of the workspace."""
    if not sampled:
        return "over the measured poses"
    if share == 1.0:
        return "over the workspace"
    return f"over the measured region, {percent(share)} of the workspace"


def _beyond(finding: Finding) -> str:
    v = finding.values
    text = f"{percent(v['share'])} of the workspace lies outside the measured region"
    if v["undetermined"] < 1.0:
        text += f": expect {size(v['position'], v['orientation'])} there, if the model holds "
        text += "as it does where it was measured"
    if v["undetermined"]:
        text += f"; {percent(v['undetermined'])} of that is not determined at all"
    return f"{text}. No limit is promised there"


RESULTS: dict[str, Wording] = {
    "not-converged": Wording(
        "The fit did not converge",
        {"message": "why the search ended"},
        "the fit did not converge: {message}",
        "The search for the parameters ended without an answer: there is no calibrated mechanism.",
        "Look at the units and at the working mode; give a better nominal mechanism, more poses, "
        "or a robust loss (--loss reject)",
        "error",
    ),
    "not-corrected": Wording(
        "The fit failed",
        {"excess": "root of the reduced χ²"},
        _EXCESS + ", and hardly fell",
        "Parameters that fit no better than nominal ones correct nothing.",
        "Look at the warnings first",
        "error",
    ),
    "residuals-too-large": Wording(
        "No accuracy can be promised",
        {"excess": "root of the reduced χ²"},
        _EXCESS,
        "Something is wrong with rows, noise or model, and the parameters follow it.",
        "Look at the warnings first",
        "error",
    ),
    "no-noise": Wording(
        "Measurements without noise",
        {},
        "residuals are rounding errors: nothing was measured like that",
        "Uncertainties and tests come from the size of residuals, and these have none. So it is "
        "with simulated data without noise.",
        "Say how well you will measure (--noise-position, --noise-orientation, --noise-reading)",
    ),
    "noise-estimated": Wording(
        "Noise estimated by group",
        {
            "position": "standard deviation [m]; None if no position was measured",
            "orientation": "standard deviation [rad]; None if no orientation was measured",
            "reading": "standard deviation [units]; 0 if readings were taken as exact",
            "units": "units of the readings",
        },
        _noise_estimated,
        "Variance components of positions, orientations and readings were estimated with the "
        "parameters: residuals cannot contradict the model.",
        f"{_GIVE_NOISE}, if it is known",
    ),
    "chi2-too-large": Wording(
        "Residuals larger than the noise",
        _CHI2_VALUES,
        _chi2,
        "Residuals are larger than the noise given makes them: intervals are too narrow, and the "
        "model may lack something, such as play, bending, temperature, a wrong unit or frame.",
        "See what they follow (pincal explain), and look at outlying rows",
    ),
    "chi2-too-small": Wording(
        "Residuals smaller than the noise",
        _CHI2_VALUES,
        _chi2,
        "Residuals are smaller than the noise given makes them: intervals are too wide.",
        "Correct the noise, if it is known to be smaller",
    ),
    "noise-in-other-proportion": Wording(
        "Noise in another proportion",
        {
            "ratios": "standard deviations seen over those given, by positions, orientations, "
            "readings",
            "p_value": P_VALUE,
        },
        _proportion,
        "Some measured quantities are noisier than given, others less (p below 0.01): weights and "
        "intervals are wrong though χ² may look right.",
        "Leave the noise out: it is then estimated by group",
    ),
    "curved": Wording(
        "Intervals of a curved problem",
        {
            "curvature": "curved part of the residuals over the straight one, at one standard "
            "error",
            "intervals": 'which there are: "wald" or "profile"',
        },
        lambda f: (
            "within one standard error the problem is curved: the curved part of the "
            f"residuals' change is {f.values['curvature']:.2g} of the straight one"
        ),
        "Standard errors come from a straight line through a curve, and joint intervals are too "
        "small where it bends by half or more.",
        _curved_remedy,
        general="Measure more poses, or with less noise. The interval of each parameter holds "
        "where it is taken from the profile of the cost (--intervals profile)",
    ),
    "interval-open": Wording(
        "Intervals without an end",
        {},
        "the 95 % intervals of {parameters} have no end on one side or both: with it held farther "
        "and farther off, the others fitted, the measurements are explained as well",
        "The profile of the cost (--intervals profile) does not rise enough within a hundred half "
        "widths, or ends where the machine cannot reach the measured poses.",
        "Measure poses that determine more (pincal select), or say how well nominal values are "
        "known (--priors)",
    ),
    "beyond-measured": Wording(
        "Outside the measured region",
        {
            "share": "of the workspace that lies outside",
            "position": "root mean square to expect there [m]; NaN where nothing is determined",
            "orientation": "the same [rad]; None of a platform that does not turn",
            "undetermined": "share of it where what was held moves the platform",
        },
        _beyond,
        "The measured region is where the platform is no more uncertain than at the most uncertain "
        "pose that was measured. Beyond, nothing measured shows what the model lacks: bending, "
        "clearance or a scale that parameters took up where it was measured.",
        "Measure there too (pincal select), or keep to the measured region",
        "info",
    ),
    "terms-chosen": Wording(
        "Terms were chosen by the same measurements",
        {},
        "{parameters} were added because they fit these measurements",
        "A wrong term takes up what residuals showed: they do not contradict it any more. No limit "
        "is promised until held-out rows vouch for it.",
        "",
        "info",
        general="Hold rows out (--folds, result.validated())",
    ),
    "promise-leaves-out": Wording(
        "What the promise leaves out",
        {"what": f"codes of {listed(UNCOVERED)}"},
        lambda finding: (
            f"the promise leaves out {listed(UNCOVERED[code] for code in finding.values['what'])}: "
            "nothing was said of that"
        ),
        "Parameters take these up, so that residuals show them only if they are large.",
        "",
        "info",
        general="Terms of loads (--terms) take in weight, `systematic:` in the setup scale and "
        "temperature; a pose that is measured again and again, or several runs, shows what changes "
        "with time",
    ),
}
