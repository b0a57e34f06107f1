"""Writes errors.md: ``python docs/errors.py``.

Causes and remedies are the docstrings of the error classes; where an error comes from is read off
the ``Raises`` of every function and class that people call.
"""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import re
from collections import defaultdict
from pathlib import Path

import pincal
from pincal import errors, formats

PAGE = Path(__file__).with_suffix(".md")
_HEAD = """\
# Errors, what causes them, and what to do

<!-- made by errors.py -->

pincal raises these on purpose, and says what was wrong, where, what it expected and what to do.
On the command line they are one message and exit code 2, and nothing is written. In Python each is
a `PincalError` and the built-in error beside it. A calibration that does not converge raises
nothing: its result says so, and the exit code is 1. A `numpy.linalg.LinAlgError` comes of numbers
far too large or too small. Anything else that is raised is a defect of pincal's, or a wrong type in
a call.

"""
_ENTRY = re.compile(r"^    (\w+Error): (.*?)(?=^    \S|\Z)", re.MULTILINE | re.DOTALL)


def raised() -> dict[str, dict[str, str]]:
    """Return, for each class of error, the public functions that raise it and when."""
    found: dict[str, dict[str, str]] = defaultdict(dict)
    public = {name: getattr(pincal, name) for name in pincal.__all__}
    for module in pkgutil.iter_modules(formats.__path__, "pincal.formats."):
        imported = importlib.import_module(module.name)
        public |= {
            f"{module.name.removeprefix('pincal.')}.{name}": what
            for name, what in vars(imported).items()
            if getattr(what, "__module__", "") == module.name and not name.startswith("_")
        }
    for name in sorted(public, key=str.lower):
        for called, function in members(name, public[name]):
            section = (inspect.getdoc(function) or "").partition("Raises:\n")[2]
            for error, when in _ENTRY.findall(section.partition("\n\n")[0]):
                found[error][called] = " ".join(when.split())
    return found


def members(name: str, what: object) -> list[tuple[str, object]]:
    """Return a function, or a class and its own public methods, by the names they are called by."""
    if not inspect.isclass(what):
        return [(name, what)]
    own = [(key, value) for key, value in vars(what).items() if not key.startswith("_")]
    return [(name, what), *((f"{name}.{key}", value) for key, value in own)]


def section(kind: type[errors.PincalError], where: dict[str, str]) -> str:
    """Return what the page says of one class."""
    base = kind.__bases__[-1]
    text = re.sub(r"``(.*?)``", r"`\1`", inspect.getdoc(kind) or "")
    text = re.sub(r"^(Causes|What to do):", r"**\1**:", text, flags=re.MULTILINE)
    text = re.sub(r"docs/(\w+\.md)", r"[docs/\1](\1)", text)
    lines = [f"## {kind.__name__}\n", f"{text}\n"]
    if base is not Exception:
        lines += [f"In Python it is also a `{base.__name__}`.\n"]
    if where and kind is not errors.PincalError:
        lines += ["| raised by | if |", "|---|---|"]
        clean = {name: when.replace("``", "`").replace("|", "\\|") for name, when in where.items()}
        lines += [f"| `{name}` | {when} |" for name, when in clean.items()]
        lines += [""]
    return "\n".join(lines)


def page() -> str:
    """Return the page."""
    kinds = [
        kind
        for kind in vars(errors).values()
        if inspect.isclass(kind) and issubclass(kind, errors.PincalError)
    ]
    where = raised()
    return _HEAD + "\n".join(section(kind, where.get(kind.__name__, {})) for kind in kinds)


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
