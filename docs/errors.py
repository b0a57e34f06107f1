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
| a calibration that does not converge, or whose χ² contradicts the noise (`--accept`: 0) | 1 |
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

Scripts read `findings` in `result.json`, in `pincal calibrate --json` or at `result.findings`, with
`code`, `severity`, `values` (SI), `rows` and `parameters`; `result.warnings` are the sentences. An
empty list means: no problems found.

"""
#: Kinds of findings: title, what they are, and their wordings.
_KINDS: tuple[tuple[str, str, Mapping[str, Wording]], ...] = (
    ("The fit", "Whether it converged, its noise, χ² and intervals.", RESULTS),
    ("Rows", "What residuals follow, outliers, held-out rows, runs.", ROWS),
    ("Parameters", "Poses that are too few, values that moved far, ties.", PARAMETERS),
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
    return _HEAD + sections + "\n" + findings() + _COMMANDS


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
