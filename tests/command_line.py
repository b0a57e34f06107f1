"""Runs the command line in process, as typed, and tells what it left behind."""

from __future__ import annotations

import io
import re
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path

import pytest

from pincal.cli.app import main


@dataclass(frozen=True)
class Outcome:
    """What a command left behind: its exit code and what it said."""

    code: int
    out: str
    err: str

    @property
    def trouble(self) -> str:
        """The last paragraph on stderr after lines that tell progress and notes, if an error."""
        lines = self.err.splitlines()
        starts = [i for i, line in enumerate(lines) if line.startswith("pincal: ")]
        assert len(starts) == 1, self.err
        before, text = lines[: starts[0]], lines[starts[0] :]
        said = (" …", " says what works")
        assert all(line.endswith(said) or ": columns not used: " in line for line in before)
        assert all(line.strip() for line in text), self.err
        return "\n".join(text)


def run(*arguments: object) -> Outcome:
    """Run pincal with the arguments, as typed; only ``SystemExit`` may leave it."""
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err), pytest.raises(SystemExit) as left:
        main([str(argument) for argument in arguments])
    return Outcome(int(left.value.code or 0), out.getvalue(), err.getvalue())


def done(*arguments: object) -> Outcome:
    """Run pincal with the arguments; it must succeed."""
    outcome = run(*arguments)
    assert outcome.code == 0, outcome.err
    return outcome


def unnamed(words: list[str], text: str) -> list[str]:
    """Return the words that a text does not hold, as whole words."""
    return [w for w in words if not re.search(rf"(?<!\w){re.escape(w)}(?!\w)", text)]


def undated(report: bytes) -> bytes:
    """Return a report without its date and the command that was typed."""
    return re.sub(rb"\d{4}-\d\d-\d\d \d\d:\d\d [+-]\d{4}|<pre>.*?</pre>", b"", report)


def contents(folder: Path) -> dict[str, bytes | None]:
    """Return the bytes of all files below a folder, None for folders, by relative path.

    Reports are undated.
    """
    return {
        str(p.relative_to(folder)): (undated if p.name == "report.html" else bytes)(p.read_bytes())
        if p.is_file()
        else None
        for p in folder.rglob("*")
    }
