"""What is said of rows of measurements: what they follow, which do not fit, held-out rows, runs.

Values are in SI; rows and parameters concerned are the finding's own ``rows`` and ``parameters``.
"""

from __future__ import annotations

from pincal.finding import Finding
from pincal.words.numbers import amount, chance, counted, listed
from pincal.words.wording import P_VALUE, Wording


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
    if found.values["lacking"]:
        return f"First model what residuals follow: that may be why; then look at {them}"
    return f"Look at {them}, or use a robust loss (--robust reject)"


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


def _moved(found: Finding) -> str:
    v, rows = found.values, found.rows
    return (
        f"the pose {v['pose']!r}, measured {len(rows)} times: {v['quantity']} moved by "
        f"{amount(v['size'], v['unit'])} from data row {rows[0] + 1} to {rows[-1] + 1} "
        f"({chance(v['p_value'])})"
    )


ROWS: dict[str, Wording] = {
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
        "Model it (pincal explain says which term pays) or remove its cause; measure in a mixed "
        "order",
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
    "reference-moved": Wording(
        "A pose moved that was measured again",
        {
            "pose": "its name in the column pose",
            "quantity": "the reading or measured quantity that moved",
            "size": "by how much, from the first time to the last [m or rad]",
            "unit": '"m" or "rad"',
            "p_value": "the probability of the most improbable of all such tests, by chance",
        },
        _moved,
        "What was measured of one pose, four times or more, moved with time, more than readings "
        "and noise explain. The finding's rows are those of the pose.",
        "Look for what warms up, a tracker or a base that moves; measure again when warm, or the "
        "run in parts, named in a column run",
    ),
    "outliers": Wording(
        "Outliers",
        {
            "total": "number of rows",
            "sigma": "residual of the worst row [standard deviations]",
            "quantity": "which of its residuals is largest, such as x or leg_1",
            "off": "size of that residual [standard deviations]",
            "lacking": "whether residuals follow what the model lacks, which may be why",
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
