"""Writes errors.md: ``python docs/errors.py``.

Causes and remedies are the docstrings of the error classes; findings are the wordings of
``pincal.words``. Which function raises what is said by ``Raises`` in the reference.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Mapping
from pathlib import Path

from pincal import errors
from pincal.words.faults import FAULTS, HYPOTHESES
from pincal.words.findings import FREEDOMS, PARAMETERS, RESULTS, ROWS
from pincal.words.wording import Wording

PAGE = Path(__file__).with_suffix(".md")
_HEAD = """\
# Errors and warnings, what causes them, and what to do

<!-- made by errors.py -->

| on the command line | exit code |
|---|---|
| an error below: one message (what, where, what was expected, what to do); nothing is written | 2 |
| a wrong option: `Usage: …`, `Try 'pincal COMMAND -h' for help.`, `Error: …` | 2 |
| a calibration that does not converge, or whose χ² contradicts the noise | 1 |
| rows without a solution in `pincal inverse` and `forward`; each has its reason | 1 |
| warnings | 0 |

In Python each error is a `PincalError` and a built-in error; the [reference](reference/made/api)
says under *Raises* which function raises it when. A calibration that does not converge raises
nothing: its result says so. `numpy.linalg.LinAlgError` comes of numbers far too large or small. Any
other exception is a defect of pincal, or a wrong type in a call.

"""
_FOUND = """\
## Findings

A finding has a code, a severity and values. A **warning** is a line `warning: …` on stderr, also
with `--quiet`; files are written, but do not take the result as it is. An **error** ends the
calibration with exit code 2, or replaces the accuracy in the report. An **info** is in the summary.

Scripts read `findings` in `result.json` or at `result.findings`, with
`code`, `severity`, `values` (SI), `rows` and `parameters`; `result.warnings` are the sentences. An
empty list means: no problems found.

"""
#: Kinds of findings: title, what they are, and their wordings.
_KINDS: tuple[tuple[str, str, Mapping[str, Wording]], ...] = (
    ("The fit", "Whether it converged, its noise, χ² and intervals.", RESULTS),
    ("Rows", "What residuals follow, outliers, held-out rows.", ROWS),
    ("Parameters", "Poses that are too few, values that moved far.", PARAMETERS),
    ("Gauge freedoms", "Fixed by choice; `result.gauge`.", FREEDOMS),
    ("Measurements", "Cannot be right, whatever the parameters.", FAULTS),
    (
        "Hypotheses",
        "Faults that would explain measurements of no mechanism near the nominal one. Those "
        "that explain them alike share a sentence.",
        HYPOTHESES,
    ),
)
_FOUND_HEAD = "| code | severity | what | it means | what to do |\n|---|---|---|---|---|"
_VALUES = """
## Values of findings

SI; ids are those of parameters (`leg_1.l`), rows are counted from 0, units are `m`, `rad` or `1`.

| value | what it is |
|---|---|
"""
#: What the values of findings are, by name.
VALUES = {
    "axis": '"x", "y" or "z" with the other sign, or "xy", "xz", "yz" exchanged',
    "change": "identified less nominal [unit]",
    "changes": "parameter's id, identified less nominal, and unit, of each",
    "chi2": "reduced χ²",
    "column": "name of a reading or an angle",
    "columns": "names of two readings",
    "count": "number of parameters",
    "curvature": "curved part of the residuals over the straight one, at one standard error",
    "dof": "degrees of freedom",
    "excess": "root of the reduced χ²",
    "expected": "root mean square residual expected [standard deviations]",
    "factors": "name, how many times too large, and unit of each reading",
    "first": "rows of the first pair",
    "frame": '"base" or "platform"',
    "freedoms": "how many",
    "gap": "median misfit, in lengths of the leg",
    "given": "noise given [unit]; of hypotheses the misfit as measured, in lengths of a leg "
    "(median), None where nothing fits together",
    "groups": "ids of parameters that move together, a tuple for each lost direction",
    "half": "half width of the 95 % interval [unit]",
    "held": "whether undetermined directions were held already",
    "held_out": "root mean square residual of held-out rows [standard deviations]",
    "high": "upper end of a 95 % interval; infinite where there is none",
    "lacking": "whether residuals follow what the model lacks, which may be why",
    "left": "misfit that a hypothesis or machines near the nominal one leave, in lengths of a leg",
    "leg": "name of a leg",
    "legs": "names of the legs concerned, empty for all; of other-working-mode name, passive "
    "joints, rows bent the other way, and rows, of each",
    "lengths": "parameter's id, nominal and identified value [m], of each",
    "low": "lower end of a 95 % interval; 0 where the drawing may be exact",
    "message": "why the search ended",
    "most": "the largest noise that is taken [unit]",
    "nominal": "what the reading should be [rad]",
    "off": "largest residual of the worst row [standard deviations]",
    "offsets": "name, offset [unit] and unit of each reading",
    "options": 'options that were not used: of "unknown-frame", "unknown-target"',
    "order": "legs, or columns of the orientation, with the columns that fit them",
    "orientation": "standard deviation, or error to expect [rad]; None without orientations",
    "orientations_right": "whether the orientations are right",
    "other_side": "share of the poses on the other side of a singularity than home",
    "p_value": "probability of such a value, or a larger one, if the model is right; the least of "
    "several tests, their number taken in",
    "pairs": "number of pairs",
    "parameter": "id of the parameter",
    "pose": "its name in the column pose",
    "poses": "number of poses of each leg",
    "position": "standard deviation, or root mean square error to expect [m]; None if no position "
    "was measured, NaN where nothing is determined",
    "quantity": 'the reading or measured quantity that is off, such as x or leg_1; "readings" is '
    'all of them, "lengths" those of the legs',
    "questioned": "names of the legs that do not fit as measured",
    "ratios": "standard deviations seen over those given, of positions, orientations, readings",
    "reading": "the first reading that is off [rad]; standard deviation of readings, 0 if exact",
    "readings": "name, value, unit, and by how much the nominal one differs, of each",
    "remedy": 'whose place to leave open: "base" or "platform"',
    "share": "of the rows, of the workspace that lies outside, or of the nominal model's squared "
    "error",
    "shift": "translation of the frame [m]; number of rows by which readings stand below",
    "sigma": "residual of the worst row [standard deviations]",
    "size": "of a step, or of a leg [m or rad]; standard deviation of differences from the drawing "
    "[unit], infinite where the measurements do not say it",
    "source": 'where the noise comes from: "given", "rows" or "repeats"',
    "stroke": "by how much readings move the leg, in its lengths",
    "term": 'what residuals follow: "angle", "pose", "order" or "approach"',
    "times": "how many times as far as usual the worst row misses",
    "total": "number of rows or poses",
    "turn": "rotation of the frame [rad]; None for a platform that does not turn",
    "undetermined": "share of the outside where what was held moves the platform",
    "unit": "unit of the values",
    "units": 'units of the readings; of the code unit each kind ("positions", "orientations" or '
    '"readings"), SI unit, unit as written',
    "unknown_frame": "whether the frame of the measurements is unknown",
    "unknowns": "number of parameters of each leg",
    "weak": "ids of parameters that are weakly determined and were held too",
    "what": "the noise that is meant; codes of what no promise covers, in ``UNCOVERED``",
    "without": "reduced χ² without the wrong rows",
    "worst": "the worst row",
}
_COMMANDS = """
## Warnings of other commands

`pincal view` and `pincal picture`: rows hold no whole pose; show the result, which holds the
estimated poses, beside the table. `pincal import` and `pincal export`: a file has no place for
something; read what was left out.
"""


def section(kind: type[errors.PincalError]) -> str:
    """Return what the page says of one class."""
    base = kind.__bases__[-1]
    told = (inspect.getdoc(kind) or "").partition("\n\nExample:")[0]
    text = re.sub(r"``(.*?)``", r"`\1`", told)
    text = re.sub(r"^(Causes|What to do):", r"**\1**:", text, flags=re.MULTILINE)
    text = re.sub(r"docs/(\w+\.md)", r"[docs/\1](\1)", text)
    lines = [f"## {kind.__name__}\n", f"{text}\n"]
    if base is not Exception:
        lines += [f"In Python it is also a `{base.__name__}`.\n"]
    return "\n".join(lines)


def findings() -> str:
    """Return what the page says of findings: a table for each kind, a row for each code."""
    lines = []
    for title, text, wordings in _KINDS:
        lines += [f"### {title}\n", f"{text}\n", _FOUND_HEAD]
        lines += [
            f"| `{code}` | {one.severity} | {one.title} | {_clean(one.means)} | {_remedy(one)} |"
            for code, one in wordings.items()
        ]
        lines += [""]
    return _FOUND + "\n".join(lines)


def _remedy(wording: Wording) -> str:
    """Return what to do, all that it may be where that depends on the values."""
    return _clean(f"{wording.advice}.") if wording.advice else "–"


def _clean(text: str) -> str:
    """Return text with its options as code."""
    return re.sub(r"(?<![\w`-])--[a-z]+(?:-[a-z]+)*(?: reject| all)?", r"`\g<0>`", text)


def page() -> str:
    """Return the page."""
    kinds = [
        kind
        for kind in vars(errors).values()
        if inspect.isclass(kind) and issubclass(kind, errors.PincalError)
    ]
    sections = "\n".join(section(kind) for kind in kinds)
    values = "".join(f"| `{name}` | {text} |\n" for name, text in VALUES.items())
    return _HEAD + sections + "\n" + findings() + _VALUES + values + _COMMANDS


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
