"""What is said of a calibration's fit: noise, residuals, outliers, held-out rows, runs.

Each code's ``values`` say what a finding of it holds, in SI; rows
and parameters concerned are the finding's own ``rows`` and ``parameters``.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pincal.finding import Finding
from pincal.words.numbers import SMALL, amount, chance, counted, listed, number, rounded
from pincal.words.wording import P_VALUE, Wording


def _noise_estimated(found: Finding) -> str:
    return f"the noise was not given: it was estimated from the residuals, {noise(found.values)}"


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


def _chi2(found: Finding) -> str:
    v = found.values
    larger = found.code == "chi2-too-large"
    given = "repeated rows show" if v["source"] == "repeats" else "given"
    return (
        f"reduced χ² is {rounded(v['chi2'], 3)} where 1 is expected: the noise is "
        f"{'larger' if larger else 'smaller'} than {given}"
        f"{', or the model lacks something' if larger else ''}; the uncertainties assume that noise"
    )


_CHI2_VALUES = {
    "chi2": "reduced χ²",
    "dof": "degrees of freedom",
    "source": 'where the noise comes from: "given", "rows" or "repeats"',
}
_GIVE_NOISE = "Give the noise (--noise-position, --noise-orientation, --noise-reading)"


def _outliers(found: Finding) -> str:
    v, count = found.values, len(found.rows)
    which = "data row" if count == 1 else "the worst data row"
    return (
        f"{count} of {v['total']} rows do{'es' * (count == 1)} not fit the others, {which} "
        f"{found.rows[0] + 1} by {v['sigma']:.1f} standard deviations ({v['quantity']} off by "
        f"{v['off']:.1f} σ)"
    )


def _wrong_rows(found: Finding) -> str:
    v, rows = found.values, [row + 1 for row in found.rows]
    some = f"{counted(len(rows), 'data row')} of {v['total']}, {listed(rows[:6])}"
    some += f" and {len(rows) - 6} more" if len(rows) > 6 else ""
    which = f"data row {rows[0]} does" if len(rows) == 1 else f"{some}, do"
    return (
        f"{which} not fit the others, {'by' if len(rows) == 1 else 'the first by'} "
        f"{v['sigma']:.0f} standard deviations ({v['quantity']} off by {v['off']:.0f} σ): reduced "
        f"χ² is {v['chi2']:.3g} with {'it' if len(rows) == 1 else 'them'}, {v['without']:.3g} "
        "without, and what follows is with"
    )


def _wrong_rows_remedy(found: Finding) -> str:
    them = "it" if len(found.rows) == 1 else "them"
    return f"Mend or remove {them}, or leave {them} out by --robust reject"


def _outliers_remedy(found: Finding) -> str:
    them = "it" if len(found.rows) == 1 else "them"
    return f"Look at {them}, or use a robust loss (--robust reject)"


def _curved_remedy(found: Finding) -> str:
    measure = "Measure more poses, or with less noise"
    if found.values.get("intervals") == "profile":
        return f"{measure}; intervals are those of the profile, platform errors are too small"
    return f"Ask for intervals by the profile of the cost (--intervals profile). {measure}"


def _proportion(found: Finding) -> str:
    v = found.values
    parts = (f"{100 * ratio:.0f} % of it in {name}" for name, ratio in v["ratios"].items())
    return (
        f"the noise is not in the proportion given ({chance(v['p_value'])}): residuals "
        f"show {', '.join(parts)}"
    )


_TERMS = {
    "angle": ("its own value", "an eccentric disc, a gear or a lead that is not even is likely"),
    "pose": ("the pose", "legs or base that bend, or an error of the tracker over its volume"),
    "order": ("the order of the rows", "drift, of temperature or of a reference, is likely"),
    "approach": ("the side from which it was approached", "play or friction is likely"),
}


def _lacks(found: Finding) -> str:
    v = found.values
    what, cause = _TERMS[v["term"]]
    return (
        f"{v['quantity']}: residuals follow {what} ({chance(v['p_value'])}), and the model has "
        f"nothing for that: {cause}"
    )


def _step(found: Finding) -> str:
    v = found.values
    return (
        f"{v['quantity']} is off by {amount(v['size'], v['unit'])} from data row "
        f"{found.rows[0] + 1} on ({chance(v['p_value'])})"
    )


_EXCESS = (
    "no accuracy can be promised: residuals are {excess:.3g} times as large as the noise given "
    "makes them"
)
RESULTS: dict[str, Wording] = {
    "not-converged": Wording(
        "The fit did not converge",
        {"message": "why the search ended"},
        "the fit did not converge: {message}",
        "The search for the parameters ended without an answer: there is no calibrated mechanism.",
        "Look at the units and at the working mode; give a better nominal mechanism, more poses, "
        "or a robust loss (--robust reject)",
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
        "Look at the residuals in the report for what they follow, and at outlying rows",
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
    "model-lacks": Wording(
        "Residuals follow something",
        {
            "quantity": 'the reading or measured quantity that is off; "readings" is all of them, '
            '"lengths" those of the legs',
            "term": 'what its error follows: "angle", "pose", "order" or "approach"',
            "p_value": "the probability of the most improbable of all such tests, by chance",
        },
        _lacks,
        "Residuals follow what the model lacks, more than chance explains (p below 0.01, all tests "
        "together): intervals and platform errors are too small by nobody knows how much.",
        "Model it or remove its cause; measure in a mixed order",
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
        "known (--prior)",
    ),
    "step": Wording(
        "A step",
        {
            "quantity": "the reading or measured quantity that is off",
            "size": "by how much, after the step [m or rad]",
            "unit": '"m" or "rad"',
            "p_value": "the probability of such a step anywhere, by chance",
        },
        _step,
        "A sensor, target or frame changed its place during the experiment. The finding's row is "
        "the first after it.",
        "Look for an encoder that slipped, or a target that was hit; name runs in a column run, or "
        "leave the shorter part out",
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
        "Rows miss by more than chance explains, however many there are (one sound calibration in "
        "a hundred has any). The finding's rows are those, the worst first.",
        _outliers_remedy,
        general="Look at them: a slip, a lost beam, a wrong set. --robust reject leaves them out "
        "and lists them",
    ),
    "wrong-rows": Wording(
        "Few rows spoil the fit",
        {
            "total": "number of rows",
            "chi2": "reduced χ² with these rows",
            "without": "reduced χ² without them",
            "sigma": "residual of the worst row [standard deviations]",
            "quantity": "which of its residuals is largest, such as x or leg_1",
            "off": "size of that residual [standard deviations]",
        },
        _wrong_rows,
        "Residuals are too large for the noise given, and a fit that rejects few rows has some "
        "as large as that noise: noise and model are right, these rows are not. Parameters are "
        "still those of all rows.",
        _wrong_rows_remedy,
        general="Mend or remove these rows, or leave them out by --robust reject",
    ),
    "many-outliers": Wording(
        "Many rows do not fit",
        {"share": "share of the rows"},
        lambda f: (
            f"{100 * f.values['share']:.0f} % of the rows do not fit the others, data row "
            f"{f.rows[0] + 1} least"
        ),
        "More than a tenth of the rows are outliers: rather the noise is larger than given, or the "
        "model lacks something, than that so many are wrong. The finding's rows are those.",
        "Correct the noise or the model before leaving rows out (--robust reject)",
    ),
    "held-out-worse": Wording(
        "Held-out rows miss by more than is expected",
        {
            "held_out": "root mean square residual of held-out rows [standard deviations]",
            "expected": "the same, as expected",
            "p_value": P_VALUE,
        },
        "held-out rows miss by {held_out:.2f} standard deviations where {expected:.2f} are "
        "expected ({chance}): the model follows its rows more closely than the machine",
        "Rows that a fit has not seen miss by more than is explained (p below 0.001).",
        "Measure more poses, or fix parameters",
    ),
    "drift": Wording(
        "Residuals follow the order of the rows",
        {"leg": "name of the leg", "correlation": "rank correlation", "p_value": "its probability"},
        "{leg}: residuals follow the order of the rows (rank correlation {correlation:+.2f}, "
        "{chance}): drift, of temperature or of a reference, is likely",
        "Drift: of temperature, of a reference, of the tracker.",
        "Measure in another order, or again when warm; name runs in a column run",
    ),
    "runs-differ": Wording(
        "Runs differ",
        {"ratio": "spread over the runs, in predicted standard errors", "p_value": P_VALUE},
        "parameters differ between runs {ratio:.1f} times as much as their standard errors say "
        "({chance}), {parameters} most: something changed between runs, or the noise is "
        "larger than given",
        "Runs, calibrated each alone, spread more than their standard errors say (p below 0.001). "
        "The finding's parameters are the three that differ most.",
        "Find what changed between runs",
    ),
}
