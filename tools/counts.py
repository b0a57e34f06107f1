"""Counts of a source tree: ``python -m tools.counts``, or beside a revision with ``--against REV``.

What is counted, in all Python files of the package ``pincal/`` without the papers' studies, which
stand in ``studies/`` or ``pincal/studies/`` and have rows of their own:

- *largest folder*: most Python files in one folder, without those of its own folders;
- *functions of more than six arguments*: of any kind, without ``self``, ``cls``, ``*`` and ``**``;
- *hand-set numeric constants*: names that a module or a class sets to numbers and nothing else,
  such as ``_NEAR = 1e-6``, ``SIZES = (3, 4)`` or ``1 << 12``; not booleans, 0 and 1 alone, and
  defaults of dataclass fields, which are arguments;
- *public names*: those in ``pincal.__all__``;
- *words to leave*: uses of ``WORDS`` in file names, names, comments and texts, parts of names too
  (``is_told``); a form of a word is another word (``tells`` is not ``tell``).
"""

from __future__ import annotations

import argparse
import ast
import io
import re
import subprocess
import sys
import tarfile
import tempfile
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

WORDS = (
    *("told", "hardly told", "tell", "hollow", "accused", "doubtful", "stands", "eased", "shaken"),
    *("beyond", "settled", "in words", "trust", "cautions", "consistent", "exactness"),
    "contradiction",
)
MOST_ARGUMENTS = 6
_WORD = re.compile(
    r"(?<![^\W_])(" + "|".join(sorted(WORDS, key=len, reverse=True)) + r")(?![^\W_])", re.IGNORECASE
)


@dataclass
class Counts:
    """Counts of one source tree."""

    files: int = 0
    lines: int = 0
    folders: Counter[str] = field(default_factory=Counter)
    """Python files in each folder."""
    long: list[str] = field(default_factory=list)
    """Functions of more than six arguments, ``file:line name (n)``."""
    constants: list[str] = field(default_factory=list)
    """Hand-set numeric constants, ``file:line name``."""
    words: Counter[str] = field(default_factory=Counter)
    """Uses of each word to leave."""
    studies: tuple[int, int] = (0, 0)
    """Files and lines of the studies."""
    public: int = 0
    """Names in ``pincal.__all__``."""

    def table(self) -> dict[str, str]:
        """Return what is printed, by name."""
        folder, most = max(self.folders.items(), key=lambda one: one[1], default=("", 0))
        return {
            "files": f"{self.files:,}",
            "lines": f"{self.lines:,}",
            "lines a file, mean": f"{self.lines / max(self.files, 1):.0f}",
            "largest folder": f"{most} ({folder})",
            f"functions of more than {MOST_ARGUMENTS} arguments": f"{len(self.long)}",
            "hand-set numeric constants": f"{len(self.constants)}",
            "public names": f"{self.public}",
            "words to leave": f"{self.words.total()}",
            "studies: files": f"{self.studies[0]:,}",
            "studies: lines": f"{self.studies[1]:,}",
        }


def count(root: Path) -> Counts:
    """Return the counts of a source tree.

    Args:
        root: Folder that holds ``pincal/``.
    """
    found, studies = Counts(), []
    for path in sorted([*root.glob("pincal/**/*.py"), *root.glob("studies/**/*.py")]):
        name, text = path.relative_to(root).as_posix(), path.read_text(encoding="utf-8")
        n_lines = len(text.splitlines())
        if name.startswith(("studies/", "pincal/studies/")):
            studies.append(n_lines)
            continue
        found.files += 1
        found.lines += n_lines
        found.folders[name.rpartition("/")[0]] += 1
        found.words.update(word.lower() for word in _WORD.findall(f"{name}\n{text}"))
        tree = ast.parse(text)
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                if (n := _arguments(node)) > MOST_ARGUMENTS:
                    found.long.append(f"{name}:{node.lineno} {node.name} ({n})")
            elif isinstance(node, ast.Module | ast.ClassDef):
                found.constants += [f"{name}:{line} {own}" for line, own in _constants(node)]
        if name == "pincal/__init__.py":
            stub = path.with_suffix(".pyi")
            named = ast.parse(stub.read_text(encoding="utf-8")) if stub.exists() else tree
            found.public = len(_public(named))
    found.studies = len(studies), sum(studies)
    return found


def _arguments(node: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    """Return how many arguments a function has, without ``self``, ``cls``, ``*`` and ``**``."""
    own = node.args
    names = [one.arg for one in (*own.posonlyargs, *own.args, *own.kwonlyargs)]
    return len(names) - (names[:1] in (["self"], ["cls"]))


def _constants(node: ast.Module | ast.ClassDef) -> Iterator[tuple[int, str]]:
    """Yield line and name of the numeric constants that a module or a class sets itself."""
    for one in node.body:
        if isinstance(one, ast.Assign):
            targets = one.targets
        elif isinstance(one, ast.AnnAssign) and one.value and isinstance(node, ast.Module):
            targets = [one.target]
        else:
            continue
        value = one.value
        if value is not None and _numeric(value) and ast.unparse(value) not in ("0", "1"):
            own = [n for t in targets for n in (t.elts if isinstance(t, ast.Tuple) else [t])]
            yield from ((one.lineno, name.id) for name in own if isinstance(name, ast.Name))


def _numeric(value: ast.expr) -> bool:
    """Return whether an expression is made of numbers only."""
    if isinstance(value, ast.Constant):
        return isinstance(value.value, int | float | complex) and not isinstance(value.value, bool)
    if isinstance(value, ast.UnaryOp):
        return _numeric(value.operand)
    if isinstance(value, ast.BinOp):
        return _numeric(value.left) and _numeric(value.right)
    if isinstance(value, ast.Tuple | ast.List):
        return bool(value.elts) and all(map(_numeric, value.elts))
    return False


def _public(tree: ast.Module) -> list[str]:
    """Return the names in ``__all__``."""
    for node in tree.body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__":
            return list(ast.literal_eval(node.value))
    return []


def count_revision(root: Path, revision: str) -> Counts:
    """Return the counts of a git revision; nothing is checked out.

    Args:
        root: Folder of the repository.
        revision: Anything that git understands.

    Raises:
        subprocess.CalledProcessError: git knows no such revision.
    """
    command = ["git", "-C", str(root), "archive", revision]
    archive = subprocess.run(command, check=True, stdout=subprocess.PIPE).stdout
    with tempfile.TemporaryDirectory() as folder, tarfile.open(fileobj=io.BytesIO(archive)) as tar:
        wanted = [one for one in tar.getmembers() if one.name.endswith(".py") and one.isfile()]
        tar.extractall(folder, wanted, filter="data")
        return count(Path(folder))


def main(arguments: list[str] | None = None) -> int:
    """Print the table.

    Args:
        arguments: Of the command line.
    """
    parser = argparse.ArgumentParser(prog="python -m tools.counts", description="Count the source.")
    parser.add_argument("--against", metavar="REV", help="a git revision to stand beside")
    parser.add_argument("--list", action="store_true", help="name what was counted")
    asked = parser.parse_args(arguments)
    root = Path(__file__).parents[1]
    here = count(root)
    columns = {"now": here.table()}
    if asked.against:
        try:
            columns = {asked.against: count_revision(root, asked.against).table(), **columns}
        except subprocess.CalledProcessError:
            return 2  # git has said why
    names = list(here.table())
    wide = [max(map(len, (head, *own.values()))) for head, own in columns.items()]
    first = max(map(len, names))
    for name, *cells in [
        ("", *columns),
        *((name, *(own[name] for own in columns.values())) for name in names),
    ]:
        print("  ".join([name.ljust(first), *map(str.rjust, cells, wide)]).rstrip())
    if asked.list:
        words = [f"{word} ({n})" for word, n in here.words.most_common()]
        for head, own in (
            ("arguments", here.long),
            ("constants", here.constants),
            ("words", words),
        ):
            print(f"\n{head}:", *own, sep="\n  ")
    return 0


if __name__ == "__main__":
    sys.exit(main())
