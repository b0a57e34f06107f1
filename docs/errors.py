"""Writes errors.md: ``python docs/errors.py``.

Causes and remedies are the docstrings of the error classes; where an error comes from is read off
the ``Raises`` of every function and class that people call, and which commands call it off the
modules of the command line. Findings are those of ``pincal.words.sentences.WORDINGS``.
"""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import re
import sys
from collections import defaultdict
from collections.abc import Mapping
from pathlib import Path

import pincal
from pincal import errors, formats
from pincal.calibration.result_files import read_result
from pincal.calibration.runs import compare_runs
from pincal.cli.app import app
from pincal.files.measurement_writing import write_plan
from pincal.files.measurements import read_measurements, read_poses
from pincal.files.yaml import read_setup
from pincal.formats.arm import load_arm
from pincal.show.report.report import report
from pincal.words.findings import FAULTS, FREEDOMS, ROWS
from pincal.words.hypotheses import HYPOTHESES
from pincal.words.parameters import PARAMETERS
from pincal.words.results import RESULTS
from pincal.words.wording import Wording
from pincal.workspace.criteria import in_workspace

PAGE = Path(__file__).with_suffix(".md")
_HEAD = """\
# Errors and warnings, what causes them, and what to do

<!-- made by errors.py -->

pincal raises these on purpose, and says what was wrong, where, what it expected and what to do.
On the command line they are one message and exit code 2, and nothing is written. In Python each is
a `PincalError` and the built-in error beside it. A calibration that does not converge raises
nothing: its result says so, and the exit code is 1; `pincal inverse` and `forward` end with 1 if
some rows have no solution, whose reason they write. A `numpy.linalg.LinAlgError` comes of numbers
far too large or too small. Anything else that is raised is a defect of pincal's, or a wrong type in
a call.

Options that do not exist or cannot be read end with exit code 2 too, in three lines: `Usage: …`,
`Try 'pincal COMMAND -h' for help.`, and `Error: …`, which says which option it is.

"""
_FOUND = """\
## Findings

What a calibration finds beside its numbers has a code, a severity and values. **Of a warning the
exit code stays 0**, and files are written: the result is an answer, but not to be taken as it is.
Only a χ² that contradicts the noise given (`chi2-too-large` and what follows from it) makes it 1,
unless `--accept` is said.
On the command line it is a line that begins with `warning:` on stderr, also with `--quiet`; in the
report warnings come first. An error among the findings ends a calibration with exit code 2, or
is said in the report in place of an accuracy. An info is said in the summary.

Scripts look at `findings` in `result.json` and in what `pincal calibrate --json` prints, or in
Python at `result.findings`, where each has `code`, `severity`, `values` (in SI), `rows` and
`parameters`; `result.warnings` holds the sentences. An empty list is a calibration that nothing
speaks against.

"""
#: Kinds of findings: title, what they are, and their wordings.
_KINDS: tuple[tuple[str, str, Mapping[str, Wording]], ...] = (
    ("The fit", "Whether it converged, its noise, χ² and intervals.", RESULTS),
    ("Rows", "What residuals follow, outliers, held-out rows, runs.", ROWS),
    ("Parameters", "Poses that are too few, values that moved far, ties.", PARAMETERS),
    ("Gauge freedoms", "What was fixed by choice; `result.gauge`.", FREEDOMS),
    ("Measurements", "What cannot be right, whatever the mechanism's parameters.", FAULTS),
    (
        "Hypotheses",
        "What may explain measurements that no mechanism near the nominal one gives. Several that "
        "explain them alike are one sentence.",
        HYPOTHESES,
    ),
)
_FOUND_HEAD = "| code | severity | what | it means | what to do |\n|---|---|---|---|---|"
_COMMANDS = """\
## Warnings of other commands

`pincal view` and `pincal picture` say that rows hold no whole pose, where poses were measured in
part: show the result, which holds the estimated ones, beside the table. `pincal import` and
`pincal export` say what a file has no place for: read what was left out; nothing if it is known.

"""
_ENTRY = re.compile(r"^    (\w+Error): (.*?)(?=^    \S|\Z)", re.MULTILINE | re.DOTALL)
#: Methods, and the functions that commands call in their place.
_BEHIND = {
    "CalibrationResult.report": [report],
    "Measurements.from_csv": [read_measurements],
    "Mechanism.from_urdf": [load_arm],
    "Plan.from_csv": [read_poses],
    "Plan.to_csv": [write_plan],
    "Setup.from_yaml": [read_setup],
}
_MOST = 6  # commands that are named one by one


def commands() -> dict[str, list[object]]:
    """Return, for each command, what its module and the modules that it leans on have imported."""
    found = {}
    for one in app.registered_commands:
        found[str(one.name)] = used(str(one.callback.__module__), set())
    return found


def used(module: str, seen: set[str]) -> list[object]:
    """Return what a module of the command line, and those that it imports from, have in hand."""
    seen.add(module)
    own = list(vars(sys.modules[module]).values())
    others = {getattr(one, "__module__", None) or "" for one in own}
    leaning = [one for one in others if one.startswith("pincal.cli.") and one not in seen]
    return own + [one for other in sorted(leaning) for one in used(other, seen)]


def public() -> dict[str, object]:
    """Return what people call from Python, and of the readers of formats what commands call."""
    found = {name: getattr(pincal, name) for name in pincal.__all__}
    at_top = [load_arm, *found.values()]  # it is Mechanism.from_urdf there
    for one in (compare_runs, in_workspace, read_result):
        found[f"{one.__module__.removeprefix('pincal.')}.{one.__name__}"] = one
    reached = [one for own in commands().values() for one in own]
    for module in pkgutil.walk_packages(formats.__path__, "pincal.formats."):
        imported = importlib.import_module(module.name)
        found |= {
            f"{module.name.removeprefix('pincal.')}.{name}": what
            for name, what in vars(imported).items()
            if getattr(what, "__module__", "") == module.name
            and inspect.isfunction(what)
            and not any(what is one for one in at_top)
            and any(what is one for one in reached)
        }
    return found


def raised() -> dict[str, list[tuple[str, str, str]]]:
    """Return, for each class of error, commands, the function that raises it, and when.

    In the order of the commands; what no command calls comes last.
    """
    found: dict[str, list[tuple[tuple[int, str], tuple[str, str, str]]]] = defaultdict(list)
    reach = commands()
    for name, what in public().items():
        for called, function in members(name, what):
            behind = _BEHIND.get(called, [what])
            by = [
                command
                for command, own in reach.items()
                if name == command or any(one is any_of for one in own for any_of in behind)
            ]
            place = list(reach).index(by[0]) if by else len(reach)
            said = ", ".join(f"`pincal {command}`" for command in by)
            if len(by) > _MOST:
                place, said = -1, "most commands"
            section = (inspect.getdoc(function) or "").partition("Raises:\n")[2]
            for error, when in _ENTRY.findall(section.partition("\n\n")[0]):
                row = (said, called, " ".join(when.split()))
                found[error].append(((place, called.lower()), row))
    return {error: [row for _, row in sorted(rows)] for error, rows in found.items()}


def members(name: str, what: object) -> list[tuple[str, object]]:
    """Return a function, or a class and its own public methods, by the names they are called by."""
    if not inspect.isclass(what):
        return [(name, what)]
    own = [(key, value) for key, value in vars(what).items() if not key.startswith("_")]
    return [(name, what), *((f"{name}.{key}", value) for key, value in own)]


def section(kind: type[errors.PincalError], where: list[tuple[str, str, str]]) -> str:
    """Return what the page says of one class."""
    base = kind.__bases__[-1]
    told = (inspect.getdoc(kind) or "").partition("\n\nExample:")[0]
    text = re.sub(r"``(.*?)``", r"`\1`", told)
    text = re.sub(r"^(Causes|What to do):", r"**\1**:", text, flags=re.MULTILINE)
    text = re.sub(r"docs/(\w+\.md)", r"[docs/\1](\1)", text)
    lines = [f"## {kind.__name__}\n", f"{text}\n"]
    if base is not Exception:
        lines += [f"In Python it is also a `{base.__name__}`.\n"]
    if where and kind is not errors.PincalError:
        lines += ["| on the command line | in Python | if |", "|---|---|---|"]
        for said, called, when in where:
            clean = when.replace("``", "`").replace("|", "\\|")
            lines += [f"| {said or '–'} | `{called}` | {clean} |"]
        lines += [""]
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
    where = raised()
    sections = [section(kind, where.get(kind.__name__, [])) for kind in kinds]
    return _HEAD + "\n".join([findings() + _COMMANDS, *sections])


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
