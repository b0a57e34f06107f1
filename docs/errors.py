"""Writes errors.md: ``python docs/errors.py``.

Causes and remedies are the docstrings of the error classes; where an error comes from is read off
the ``Raises`` of every function and class that people call, and which commands call it off the
modules of the command line. Warnings are listed here; a test holds them against the source.
"""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import re
import sys
from collections import defaultdict
from pathlib import Path

import pincal
from pincal import errors, formats
from pincal.cli.app import app

PAGE = Path(__file__).with_suffix(".md")
_HEAD = """\
# Errors and warnings, what causes them, and what to do

<!-- made by errors.py -->

pincal raises these on purpose, and says what was wrong, where, what it expected and what to do.
On the command line they are one message and exit code 2, and nothing is written. In Python each is
a `PincalError` and the built-in error beside it. A calibration that does not converge raises
nothing: its result says so, and the exit code is 1. A `numpy.linalg.LinAlgError` comes of numbers
far too large or too small. Anything else that is raised is a defect of pincal's, or a wrong type in
a call.

Options that do not exist or cannot be read end with exit code 2 too, in three lines: `Usage: …`,
`Try 'pincal COMMAND -h' for help.`, and `Error: …`, which says which option it is.

"""
_WARNED = """\
## Warnings

What was found is an answer, but not to be taken as it stands. **The exit code stays 0**, and files
are written. On the command line a warning is a line that begins with `warning:` on stderr, also
with `--quiet`; in the report the warnings stand first. Scripts should look at `warnings` in
`result.json`, in what `pincal calibrate --json` prints, or in Python at `result.warnings`: an empty
list is a calibration that nothing speaks against.

"""
#: What a warning says in all cases, what it means, and what to do.
WARNINGS: dict[str, tuple[tuple[str, str, str], ...]] = {
    "`pincal calibrate`": (
        (
            "the noise was not given",
            "Equal noise was assumed, and its scale taken from the residuals: so residuals cannot "
            "contradict the model, and position is weighed against orientation by a guess.",
            "Give `--noise-position`, `--noise-orientation`, `--noise-reading`, `sigma_…` columns, "
            "or rows measured repeatedly.",
        ),
        (
            "where 1 is expected: the noise is",
            "Reduced χ²: residuals are larger (or smaller) than the noise given makes them. If "
            "larger, intervals are too narrow, and the model may lack something: play, bending, "
            "temperature, a wrong unit or frame.",
            "Correct the noise, if you know that it is other; look at the residuals in the report "
            "for what they follow; look at outlying rows.",
        ),
        (
            "farther than a machine differs from its drawing",
            "A parameter moved by more than 5 % of the mechanism's size, or 0.05 rad or 1.",
            "Check the frame and target of the measurements (`--unknown-frame`, "
            "`--unknown-target`), units, the order of readings; if the drawing is known roughly "
            "only, say so (`--rough`).",
        ),
        (
            "misses the nominal mechanism",
            "The fit failed, and few rows are far from where the others are; in its place, or "
            "beside it, may stand what explains all rows: a sign, a unit, exchanged legs, a frame.",
            "Correct the file, or leave such rows out (`--robust reject`). No accuracy is promised "
            "before.",
        ),
        (
            "of what the nominal model is off by",
            "Parameters moved so that the machine moved as one body: more likely the tracker, or "
            "the target, was not aligned, than that the machine is such.",
            "`--unknown-frame`, `--unknown-target`; or align and measure again.",
        ),
        (
            "equal noise was assumed in position",
            "The noise was not given, and residuals of positions and of orientations tell two "
            "scales.",
            "Give the two that the warning names, if they are what the instrument has.",
        ),
        (
            "hardly told",
            "A standard error is larger than machines differ from their drawings: the number is "
            "noise.",
            "Measure poses that tell more (`pincal select`), hold it (`--method latent "
            "--hold-undetermined`, `--fix`), or say how well it is known (`--prior`).",
        ),
        (
            "do not tell everything",
            "With `--hold-undetermined`: what is named was held as near to nominal as can be. The "
            "machine is calibrated where it was measured; elsewhere it may be off.",
            "Measure elsewhere too, or use it only there.",
        ),
        (
            "not fit the others",
            "Rows miss by more than one good row in a thousand does; the worst is named.",
            "Look at them: a slip, a lost beam, a wrong set. `--robust reject` leaves them out and "
            "lists them.",
        ),
        (
            "of the rows do not fit",
            "More than a tenth of the rows do: rather the noise is larger than given, or the model "
            "lacks something.",
            "Correct the noise or the model before leaving rows out.",
        ),
        (
            "is tied over the legs, and the measurements contradict",
            "The legs differ in this parameter by more than their standard errors explain (1 %).",
            "Leave the tie out.",
        ),
        (
            "times as many poses as parameters are advised",
            "So few equations that residuals are small whatever the machine is.",
            "Measure more poses, or let every pose serve every leg (`--poses all`).",
        ),
        (
            "held-out rows miss by",
            "Rows that a fit has not seen miss by more than is explained (p below 0.001): it "
            "follows its own rows more closely than the machine.",
            "Measure more poses, or fix parameters.",
        ),
        (
            "residuals follow the order of the rows",
            "Drift: of temperature, of a reference, of the tracker.",
            "Measure in another order, or again when warm; name runs in a column `run`.",
        ),
        (
            "parameters differ between runs",
            "Runs, calibrated each alone, spread more than their standard errors say (p below "
            "0.001).",
            "Find what changed between runs; else the noise is larger than given.",
        ),
    ),
    "`pincal view`, `pincal picture`": (
        (
            "rows hold no whole pose",
            "Poses measured in part cannot be drawn.",
            "Show the result of `--method latent`, which estimates them, beside the table.",
        ),
    ),
    "`pincal import`, `pincal export`": (
        (
            "",
            "What the file holds and a mechanism does not, or the other way round.",
            "Read what was left out; nothing if it is known.",
        ),
    ),
}
_ENTRY = re.compile(r"^    (\w+Error): (.*?)(?=^    \S|\Z)", re.MULTILINE | re.DOTALL)
_MOST = 6  # commands that are named one by one


def commands() -> dict[str, list[object]]:
    """Return, for each command, what its module and the modules that it leans on have imported."""
    found = {}
    for command in app.registered_commands:
        name = command.name or getattr(command.callback, "__name__", "")
        found[name] = used(getattr(command.callback, "__module__", ""), set())
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
    reached = [one for own in commands().values() for one in own]
    for module in pkgutil.walk_packages(formats.__path__, "pincal.formats."):
        imported = importlib.import_module(module.name)
        found |= {
            f"{module.name.removeprefix('pincal.')}.{name}": what
            for name, what in vars(imported).items()
            if getattr(what, "__module__", "") == module.name
            and inspect.isfunction(what)
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
        by = [
            command
            for command, own in reach.items()
            if name == command or any(what is one for one in own)
        ]
        place = list(reach).index(by[0]) if by else len(reach)
        said = ", ".join(f"`pincal {command}`" for command in by)
        if len(by) > _MOST:
            place, said = -1, "most commands"
        for called, function in members(name, what):
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
    text = re.sub(r"``(.*?)``", r"`\1`", inspect.getdoc(kind) or "")
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


def warnings() -> str:
    """Return what the page says of warnings."""
    lines = []
    for where, rows in WARNINGS.items():
        lines += [f"Of {where}:\n", "| it says | it means | what to do |", "|---|---|---|"]
        lines += [
            f"| {f'… {words} …' if words else 'what a file has no place for'} | {means} | {do} |"
            for words, means, do in rows
        ]
        lines += [""]
    return _WARNED + "\n".join(lines)


def page() -> str:
    """Return the page."""
    kinds = [
        kind
        for kind in vars(errors).values()
        if inspect.isclass(kind) and issubclass(kind, errors.PincalError)
    ]
    where = raised()
    sections = [section(kind, where.get(kind.__name__, [])) for kind in kinds]
    return _HEAD + "\n".join([warnings(), *sections])


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
