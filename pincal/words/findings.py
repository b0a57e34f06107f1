"""Wordings of findings about measurements: faults, gauge freedoms, rows that do not fit.

``FAULTS`` of measurements that no hypothesis explains, ``FREEDOMS`` that no measurement determines,
``ROWS`` and what their residuals follow.
"""

from __future__ import annotations

from pincal.finding import Finding
from pincal.words.numbers import amount, chance, counted, listed, size
from pincal.words.wording import P_VALUE, Wording, groups_in_words


def _still(finding: Finding) -> str:
    constant = (
        f"{name} reads the same in all rows ({value:.6g} {unit})"
        for name, value, unit, _ in finding.values["readings"]
    )
    moves = (f"{moved:.2g} {unit}" for _, _, unit, moved in finding.values["readings"])
    return (
        f"{', '.join(constant)}, where readings of the nominal mechanism differ by "
        f"{', '.join(moves)} over these poses"
    )


def _turns(finding: Finding) -> str:
    v, count = finding.values, len(finding.rows)
    return (
        f"{v['leg']}: {counted(count, 'reading is', 'readings are')} off by whole turns, the first "
        f"in data row {finding.rows[0] + 1}: {v['reading']:.6g} rad, where the nominal mechanism "
        f"reads {v['nominal']:.6g} rad"
    )


def _bent(finding: Finding) -> str:
    bent_legs = (
        f"{leg} ({' and '.join(passive)}, in {bent} of {rows} rows)"
        for leg, passive, bent, rows in finding.values["legs"]
    )
    return (
        "readings and poses close the legs, but these bend the other way than in mechanism.yaml's "
        f"home: {', '.join(bent_legs)}"
    )


def _other_mechanism(finding: Finding) -> str:
    return (
        f"{finding.values['leg']}: the measurements miss the nominal mechanism by "
        f"{100 * finding.values['gap']:.1f} % of a leg's length (median), and no single fault in "
        "units, signs, order, zeros or frame explains it"
    )


def _unrelated_readings(finding: Finding) -> str:
    v = finding.values
    return (
        f"{v['leg']}: the readings do not follow those of the nominal mechanism (machines near it "
        f"leave {100 * v['left']:.2g} % of the leg's length where readings move it by "
        f"{100 * v['stroke']:.2g} %)"
    )


def _copies(finding: Finding) -> str:
    (first, second), pairs = finding.values["first"], finding.values["pairs"]
    further = f" (and {pairs - 1} more such pairs)" if pairs > 1 else ""
    return (
        f"data rows {first + 1} and {second + 1} are identical in all that was measured{further}; "
        "measured twice, they would differ by noise"
    )


def _large(finding: Finding) -> str:
    v = finding.values
    if v["what"] == "position":
        return (
            f"the noise of position is given as {v['given']:g} m, more than "
            f"{100 * v['most'] / v['size']:.0f} % of a leg's length ({v['size']:.3g} m)"
        )
    return f"the noise of orientation is given as {v['given']:g} rad; expected less than " + (
        f"{v['most']:g}"
    )


def _slips(finding: Finding) -> str:
    v, count = finding.values, len(finding.rows) - 1
    further = f", and {counted(count, 'more row')} so" if count else ""
    return (
        f"data row {v['worst'] + 1} misses the nominal mechanism {v['times']:.3g} times as far as "
        f"rows usually do{further}"
    )


def _one_body(finding: Finding) -> str:
    v = finding.values
    return (
        f"{100 * v['share']:.0f} % of what the nominal model is off by (in squares) is one motion "
        f"of the {v['frame']}'s frame, by {size(v['shift'], v['turn'])}, and parameters that "
        f"differ each in its own way hardly move so ({chance(v['p_value'])})"
    )


def _one_body_remedy(finding: Finding) -> str:
    question = {
        "base": "Is the tracker's frame the base's (--unknown-frame)?",
        "platform": "Is the target the platform's origin (--unknown-target)?",
    }[finding.values["remedy"]]
    return f"{question} Else where the frame lies is taken for errors of the machine"


FAULTS: dict[str, Wording] = {
    "readings-still": Wording(
        "A sensor does not move",
        {"readings": "name, value, unit, and by how much the nominal one differs, of each"},
        _still,
        "A sensor gave one number while the poses moved it.",
        "Check the sensor, its cable and the log",
        "error",
    ),
    "whole-turns": Wording(
        "Readings off by whole turns",
        {"leg": "name", "reading": "the first such [rad]", "nominal": "what it should be [rad]"},
        _turns,
        "A counter lost a turn, or counts on where others begin again. The finding's rows are all "
        "of them.",
        "Count without the turns, or correct the nominal offset",
        "error",
    ),
    "other-working-mode": Wording(
        "Another working mode",
        {"legs": "name, passive joints, rows bent the other way, and rows, of each leg"},
        _bent,
        "Readings and poses have several solutions; the machine was measured in another one.",
        "Correct 'home' there, or measure in its working mode",
        "error",
    ),
    "not-this-mechanism": Wording(
        "Measurements of another mechanism",
        {"leg": "name of the worst", "gap": "median misfit, in lengths of the leg"},
        _other_mechanism,
        "Poses and readings are those of a machine unlike the nominal one.",
        "Check the units, the order and signs of the readings, the frame of the poses, and that "
        "this is the right mechanism. If it is known but roughly, say so (--rough)",
        "error",
    ),
    "readings-do-not-follow": Wording(
        "Readings do not follow the poses",
        {
            "leg": "name",
            "left": "misfit that machines near the nominal one leave, in lengths of the leg",
            "stroke": "by how much readings move the leg, in its lengths",
        },
        _unrelated_readings,
        "The poses say nothing of what the readings say, in a workspace too small to see why.",
        "Check their order and signs, the signs and frame of the poses, and the mechanism",
        "error",
    ),
    "rows-copied": Wording(
        "Copied rows",
        {"first": "rows of the first pair, counted from 0", "pairs": "how many pairs"},
        _copies,
        "A copy counts as a measurement, and makes intervals too narrow.",
        "Remove the copies",
        "error",
    ),
    "noise-too-large": Wording(
        "Noise far too large",
        {
            "what": '"position" or "orientation"',
            "given": "standard deviation given [unit]",
            "unit": '"m" or "rad"',
            "most": "the largest that is taken [unit]",
            "size": "length of a leg [m]",
        },
        _large,
        "So large a noise is a slip in a unit.",
        lambda f: f"It is in {'metres' if f.values['unit'] == 'm' else 'radians'}",
        "error",
        general="Give it in metres and radians",
    ),
    "bad-rows": Wording(
        "Few rows far from the nominal mechanism",
        {"worst": "row, counted from 0", "times": "how many times as far as usual it misses"},
        _slips,
        "The fit failed, and few rows are far from where the others are. The finding's rows are "
        "those.",
        "Look for a slip there first, or leave such rows out (--loss reject)",
    ),
    "frame-misaligned": Wording(
        "Parameters moved as one body",
        {
            "frame": '"base" or "platform"',
            "remedy": 'whose place to leave open: "base" or "platform"',
            "share": "share of the squares of the nominal model's error",
            "shift": "translation of the frame [m]",
            "turn": "rotation of the frame [rad]; None for a platform that does not turn",
            "p_value": "probability of so much motion as one body by chance",
        },
        _one_body,
        "More likely the tracker, or the target, was not aligned, than that the machine is such.",
        _one_body_remedy,
        general="Leave that frame open (--unknown-frame, --unknown-target), or align and measure "
        "again",
    ),
}


def _base(finding: Finding) -> str:
    reason = (
        "the frame of the measurements is unknown"
        if finding.values["unknown_frame"]
        else "what was measured does not fix it"
    )
    return f"the base frame: {_freedoms(finding)}, since {reason}"


def _freedoms(finding: Finding) -> str:
    return counted(int(finding.values["freedoms"]), "freedom")


def _redundant(finding: Finding) -> str:
    v = finding.values
    are = "parameter is" if v["count"] == 1 else "parameters are"
    return f"{v['count']} {are} redundant, whatever is measured: {groups_in_words(v['groups'])}"


_CHOICE = "Of equal parameters, those nearest to nominal were taken."
FREEDOMS: dict[str, Wording] = {
    "gauge-base-frame": Wording(
        "Gauge freedom of the base frame",
        {
            "freedoms": "how many",
            "unknown_frame": "whether the frame of the measurements is unknown",
        },
        _base,
        f"Moving the base frame with all base points changes nothing that is measured. {_CHOICE}",
        "",
        "info",
    ),
    "gauge-platform-frame": Wording(
        "Gauge freedom of the platform's frame",
        {"freedoms": "how many"},
        lambda f: (
            f"the platform's frame: {_freedoms(f)}, since what was measured does not say how the "
            "platform's points lie in it"
        ),
        f"Moving the platform's frame in the platform changes nothing that is measured. {_CHOICE}",
        "",
        "info",
    ),
    "redundant-parameters": Wording(
        "Redundant parameters",
        {"count": "how many are not needed", "groups": "ids of parameters that move together"},
        _redundant,
        f"Some parameters do the same to the platform as others. {_CHOICE}",
        "",
        "info",
    ),
}


def _outliers(finding: Finding) -> str:
    v, count = finding.values, len(finding.rows)
    row = "data row" if count == 1 else "the worst data row"
    return (
        f"{count} of {v['total']} rows do{'es' * (count == 1)} not fit the others, {row} "
        f"{finding.rows[0] + 1} by {v['sigma']:.1f} standard deviations ({v['quantity']} off by "
        f"{v['off']:.1f} σ)"
    )


def _wrong_rows(finding: Finding) -> str:
    v, rows = finding.values, [row + 1 for row in finding.rows]
    listed_rows = f"{counted(len(rows), 'data row')} of {v['total']}, {listed(rows[:6])}"
    listed_rows += f" and {len(rows) - 6} more" if len(rows) > 6 else ""
    subject = f"data row {rows[0]} does" if len(rows) == 1 else f"{listed_rows}, do"
    return (
        f"{subject} not fit the others, {'by' if len(rows) == 1 else 'the first by'} "
        f"{v['sigma']:.0f} standard deviations ({v['quantity']} off by {v['off']:.0f} σ): reduced "
        f"χ² is {v['chi2']:.3g} with {'it' if len(rows) == 1 else 'them'}, {v['without']:.3g} "
        "without, and what follows is with"
    )


def _wrong_rows_remedy(finding: Finding) -> str:
    them = "it" if len(finding.rows) == 1 else "them"
    return f"Mend or remove {them}, or leave {them} out by --loss reject"


def _outliers_remedy(finding: Finding) -> str:
    them = "it" if len(finding.rows) == 1 else "them"
    if finding.values["lacking"]:
        return f"First model what residuals follow: that may be why; then look at {them}"
    return f"Look at {them}, or use a robust loss (--loss reject)"


_TERMS = {
    "angle": ("its own value", "an eccentric disc, a gear or a lead that is not even is likely"),
    "pose": ("the pose", "legs or base that bend, or an error of the tracker over its volume"),
    "order": ("the order of the rows", "drift, of temperature or of a reference, is likely"),
    "approach": ("the side from which it was approached", "play or friction is likely"),
}


def _lacks(finding: Finding) -> str:
    v = finding.values
    course, cause = _TERMS[v["term"]]
    return (
        f"{v['quantity']}: residuals follow {course} ({chance(v['p_value'])}), and the model has "
        f"nothing for that: {cause}"
    )


def _step(finding: Finding) -> str:
    v = finding.values
    return (
        f"{v['quantity']} is off by {amount(v['size'], v['unit'])} from data row "
        f"{finding.rows[0] + 1} on ({chance(v['p_value'])})"
    )


def _moved(finding: Finding) -> str:
    v, rows = finding.values, finding.rows
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
        general="Look at them: a slip, a lost beam, a wrong set. --loss reject leaves them out "
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
        general="Mend or remove these rows, or leave them out by --loss reject",
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
        "Correct the noise or the model before leaving rows out (--loss reject)",
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
