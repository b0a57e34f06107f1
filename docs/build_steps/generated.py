"""Pages that are made of the code at every build: commands, names, a view."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from typer.main import get_command

import pincal
from build_steps.names import GROUPS, RETURNED
from pincal.cli.app import app

FOLDER = Path("reference") / "made"
VIEW = FOLDER / "view"


def write(docs: Path) -> None:
    """Write all of them, those alone that changed, so that Sphinx reads no more than it must."""
    folder = docs / FOLDER
    (docs / VIEW).mkdir(parents=True, exist_ok=True)
    pages = {
        "commands.md": commands(),
        "api.rst": names(),
        "contributing.md": from_the_top(docs.parent / "CONTRIBUTING.md"),
        "changelog.md": from_the_top(docs.parent / "CHANGELOG.md"),
        "view/live.html": pincal.view("6UPS", identified=pincal.disturb("6UPS", 1e-3)).html(),
    }
    for name, text in pages.items():
        path = folder / name
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


def from_the_top(path: Path) -> str:
    """Return a page of the repository's top folder with its links as they are from here."""
    text = path.read_text(encoding="utf-8").replace("](docs/", "](../../")
    text = text.replace("](CONTRIBUTING.md)", "](contributing.md)")
    text = text.replace("](CHANGELOG.md)", "](changelog.md)")
    return text.replace("](examples)", "](../../gallery/index.rst)")


def _code(text: str) -> str:
    """Return text with its options as code, safe within a Markdown table."""
    marked = re.sub(r"(?<![\w`-])--?[a-z][a-z-]*", r"`\g<0>`", text)
    return marked.replace("|", "\\|").replace("<", "&lt;").replace("*", "\\*").replace("_", "\\_")


def _row(cells: Iterable[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _default(one: Any) -> str:
    if one.default is None or one.default is False or one.required or one.default == ():
        return ""
    return f"`{one.default}`"


def command(name: str, found: Any) -> str:
    """Return the section of one command: its help, its arguments, its options with defaults."""
    shown = [one for one in found.params if not getattr(one, "hidden", False)]
    arguments = [one for one in shown if one.param_type_name == "argument"]
    options = [one for one in shown if one.param_type_name == "option"]
    typed = " ".join(f"{one.metavar or one.name.upper()}" for one in arguments)
    paragraphs = [_code(" ".join(one.split())) for one in (found.help or "").split("\n\n")]
    line = " ".join(f"pincal {name} {typed} [OPTIONS]".split())
    lines = [f"## {name}", "", "```text", line]
    lines += ["```", "", *(line for one in paragraphs for line in (one, ""))]
    if arguments:
        lines += ["| argument | what |", "|---|---|"]
        lines += [_row((f"`{one.metavar}`", _code(one.help or ""))) for one in arguments] + [""]
    if options:
        lines += [":::{dropdown} Options", "| option | what | default |"]
        lines += ["|---|---|---|"]
        for one in options:
            spelled = ", ".join(f"`{opt}`" for opt in (*one.opts, *one.secondary_opts))
            takes = "" if one.is_flag or not one.metavar else f" `{one.metavar}`"
            cells = (spelled + takes.replace("|", "\\|"), _code(one.help or ""), _default(one))
            lines += [_row(cells)]
        lines += [":::", ""]
    return "\n".join(lines)


def commands() -> str:
    """Return the page of the command line."""
    group = get_command(app)
    lines = [
        "# Command line",
        "",
        "Made of the commands themselves, as `pincal COMMAND --help` shows them. `MECH` is the",
        "name of a bundled mechanism or a folder. Exit codes: 0 done; 1 a fit that did not",
        "converge or that χ² or held-out rows contradict, or rows without a solution; 2 wrong",
        "input, and then nothing was written.",
        "",
    ]
    listed = list(group.commands)  # type: ignore[attr-defined]
    lines += [", ".join(f"[{name}](#{name})" for name in listed) + ".", ""]
    return "\n".join(
        lines + [command(name, group.get_command(None, name)) for name in listed]  # type: ignore[attr-defined]
    )


def names() -> str:
    """Return the page of all public names, and of what functions return."""
    lines = ["API", "===", "", "All names of ``pincal``, by what they are for. "]
    lines += ["Lengths are in m, angles in rad; poses have shape (N, dof).", ""]
    missing = set(pincal.__all__) ^ {name for own in GROUPS.values() for name in own.split()}
    if missing:
        raise ValueError(f"docs/build_steps/names.py lacks, or has too many: {sorted(missing)}")
    for title, own in GROUPS.items():
        lines += [title, "-" * len(title), "", ".. autosummary::", "   :toctree: ../api", ""]
        lines += [*(f"   pincal.{name}" for name in own.split()), ""]
    title = "What functions return"
    lines += [title, "-" * len(title), "", "These come out of calls; nobody imports them.", ""]
    lines += [".. autosummary::", "   :toctree: ../api", ""]
    return "\n".join([*lines, *(f"   {name}" for name in RETURNED.split()), ""])
