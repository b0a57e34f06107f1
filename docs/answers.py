"""Runs what pages show, and writes what it answers: ``python docs/answers.py [PAGE …]``.

On a page that says ``<!-- run by answers.py -->`` all blocks are run from top to bottom, in one
folder that is empty at first:

- ``console``: lines that begin with ``$ pincal`` are commands; what they print stands below them.
  A command must end well, or as the comment behind it says: ``# exit code 1``.
- ``python``: all of a page are one program. What a block prints is the ``text`` block after it.
- ``<!-- program: programs/NAME.py -->`` is a part of that program which the page does not show.
- a block after ``<!-- file: NAME -->`` is written to that file.
- ``<!-- keep: PATTERN -->`` before a block keeps the messages of its answers in which the pattern
  is found; what was left out is an ellipsis.

A picture that was written and that the page shows is copied to ``docs/images``.
"""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing
from itertools import groupby
from pathlib import Path
from tempfile import TemporaryDirectory

DOCS = Path(__file__).parent
MARK = "<!-- run by answers.py -->"
_BLOCK = re.compile(
    r"(?P<head>(?:<!-- (?P<how>file|keep): (?P<what>[^\n]*?) -->\n)?```(?P<kind>\w+)\n)"
    r"(?P<body>.*?)(?P<tail>^```$)|^<!-- program: (?P<file>[^\n]*?) -->$",
    re.DOTALL | re.MULTILINE,
)
_WIDTH = 100  # at which commands wrap what they say
_END = "end of block"  # printed where one block of Python ends
_DRIVER = f"""
import sys
space = {{"__name__": "__main__"}}
for line in sys.stdin:
    exec(eval(line), space)
    print({_END!r}, flush=True)
"""


def pages() -> list[Path]:
    """Return the pages whose blocks are run."""
    found = sorted(path for path in DOCS.rglob("*.md") if "_build" not in path.parts)
    return [path for path in found if MARK in path.read_text(encoding="utf-8")]


def environment() -> dict[str, str]:
    """Return what commands and programs find around them: warnings are errors."""
    own = {"NO_COLOR": "1", "PYTHONPATH": str(DOCS.parent), "PYTHONWARNINGS": "error"}
    return {**os.environ, **own, "PYTHONIOENCODING": "utf-8"}


def run(line: list[str], folder: Path) -> tuple[int, str]:
    """Return the exit code of a command, and what it prints, without colours."""
    out, err = subprocess.PIPE, subprocess.STDOUT
    done = subprocess.run(line, cwd=folder, env=environment(), stdout=out, stderr=err, check=False)
    return done.returncode, done.stdout.decode("utf-8")


def kept(text: str, pattern: str | None) -> str:
    """Return the messages of an answer in which a pattern is found, others as one ellipsis."""
    lines = [one.rstrip() for one in text.strip("\n").splitlines()]
    if pattern is None:
        return "\n".join(lines)
    messages: list[str] = []
    last = ""
    for line in lines:
        wrapped = line and len(last) + 1 + len(line.split()[0]) > _WIDTH
        messages[-1:] = [f"{messages[-1]}\n{line}"] if wrapped else [*messages[-1:], line]
        last = line
    found = groupby(messages, lambda one: bool(re.search(pattern, one)))
    return "\n".join("\n".join(own) if wanted else "…" for wanted, own in found)


class Program:
    """A page's Python, run block by block in one process."""

    def __init__(self, folder: Path) -> None:
        self._run = subprocess.Popen(
            [sys.executable, "-c", _DRIVER],
            cwd=folder,
            env=environment(),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            encoding="utf-8",
        )

    def answer(self, code: str) -> str:
        """Return what a block prints.

        Raises:
            SystemExit: it failed.
        """
        assert self._run.stdin is not None
        assert self._run.stdout is not None
        self._run.stdin.write(f"{code!r}\n")
        self._run.stdin.flush()
        said = ""
        for line in self._run.stdout:
            if line.strip() == _END:
                return said
            said += line
        raise SystemExit(said)

    def close(self) -> None:
        """Let the process end."""
        self._run.communicate()


def answered(commands: list[str], folder: Path, pattern: str | None) -> str:
    """Return a console block: commands and what they print.

    Raises:
        SystemExit: a command ended with another exit code than it should.
    """
    parts = []
    for one in commands:
        typed = shlex.split(one.removeprefix("$ ").replace("\\\n", " "), comments=True)
        code, said = run([sys.executable, "-m", *typed], folder)
        expected = re.search(r"# .*exit code (\d+)", one)
        if code != int(expected[1] if expected else 0):
            raise SystemExit(f"{one}\n{said}\nexit code {code} was not expected")
        said = kept(said, pattern)
        parts.append(f"{one}\n{said}\n" if said else f"{one}\n")
    return "\n".join(parts).replace("\n\n$ ", "\n$ ") if pattern else "\n".join(parts)


def filled(text: str, folder: Path) -> str:
    """Return a page with what its blocks answer, run in a folder."""
    with closing(Program(folder)) as program:
        return "".join(_filled(text, folder, program))


def _filled(text: str, folder: Path, program: Program) -> Iterator[str]:
    """Yield the parts of a page, from top to bottom."""
    at, said = 0, ""
    for one in _BLOCK.finditer(text):
        if one["file"]:
            said = program.answer((DOCS / one["file"]).read_text(encoding="utf-8"))
            continue
        pattern = one["what"] if one["how"] == "keep" else None
        body = one["body"]
        if one["how"] == "file":
            (folder / one["what"]).write_text(body, encoding="utf-8")
        elif one["kind"] == "console":
            commands = re.findall(r"^\$ (?:.*\\\n)*.*$", body, re.MULTILINE)
            body = answered(commands, folder, pattern)
        elif one["kind"] == "python":
            said = program.answer(body)
        elif one["kind"] == "text" and said:
            body, said = kept(said, pattern) + "\n", ""
        yield text[at : one.start("body")] + body
        at = one.end("body")
    yield text[at:]


def main(chosen: list[str]) -> None:
    """Write the chosen pages, or all, and their pictures."""
    for page in [Path(one).resolve() for one in chosen] or pages():
        with TemporaryDirectory() as name:
            text = page.read_text(encoding="utf-8")
            page.write_text(filled(text, Path(name)), encoding="utf-8")
            for shown in re.findall(r"images/([\w.]+)\)", text):
                if (Path(name) / shown).exists():
                    shutil.copy(Path(name) / shown, DOCS / "images" / shown)


if __name__ == "__main__":
    main(sys.argv[1:])
