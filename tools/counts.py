"""Measures of the source: how large each room is, and how well it can be read.

``python -m tools.counts`` prints them for the working tree, ``--against REVISION`` beside those of
a git revision, ``--list`` names what was counted. ``tests/test_budget.py`` holds their limits.

Measures of all Python files of ``pincal/``, a room being a folder directly below it:

- *vague names*: share of bindings whose name is in ``VAGUE``. A binding is a parameter, an
  assigned variable, a function or a class; ``self`` and ``cls`` do not count;
- *class names twice*: classes that share their name with another;
- *complex functions*: of a cyclomatic complexity (McCabe) above ``MOST_COMPLEX``;
- *long signatures*: functions of more than ``MOST_ARGUMENTS`` arguments, without ``self``;
- *imports inside functions*, of ``pincal`` itself;
- *page lines*: lines of JavaScript, CSS and templates.
"""

from __future__ import annotations

import argparse
import ast
import io
import subprocess
import sys
import tarfile
import tempfile
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

_WORDS = (
    "again all alone alike apart asked at away back beside both by each few found given here how "
    "into kept left many more most much now of off one ones other others out over own rest said "
    "same seen so some such that then there these thing things this those told up wanted what "
    "where which whole who whose why"
)
VAGUE = frozenset(_WORDS.split())
MOST_COMPLEX = 15
MOST_ARGUMENTS = 6
PAGES = (".js", ".css", ".html")
_BRANCHES = (
    ast.If,
    ast.IfExp,
    ast.For,
    ast.While,
    ast.ExceptHandler,
    ast.comprehension,
    ast.Assert,
)
_FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef)


@dataclass
class Counts:
    """Counts of one source tree."""

    rooms: dict[str, tuple[int, int]] = field(default_factory=dict)
    """Lines and files of each folder directly below ``pincal/``, ``""`` for ``pincal/`` itself."""
    folders: Counter[str] = field(default_factory=Counter)
    """Python files in each folder, without those of folders below it."""
    bindings: int = 0
    vague: Counter[str] = field(default_factory=Counter)
    """Bindings of each vague name."""
    classes: Counter[str] = field(default_factory=Counter)
    """Definitions of each class name."""
    dataclasses: int = 0
    complex_functions: list[str] = field(default_factory=list)
    long_signatures: list[str] = field(default_factory=list)
    inner_imports: list[str] = field(default_factory=list)
    page_lines: int = 0

    @property
    def lines(self) -> int:
        """Number of lines of Python."""
        return sum(lines for lines, _ in self.rooms.values())

    @property
    def files(self) -> int:
        """Number of Python files."""
        return sum(files for _, files in self.rooms.values())

    @property
    def vague_share(self) -> float:
        """Share of bindings that have a vague name."""
        return self.vague.total() / max(self.bindings, 1)

    @property
    def repeated_classes(self) -> list[str]:
        """Class names that are defined more than once."""
        return sorted(name for name, count in self.classes.items() if count > 1)

    def table(self) -> dict[str, str]:
        """Return what is printed, by name."""
        folder, size = max(self.folders.items(), key=lambda item: item[1], default=("", 0))
        rooms = {
            f"  {room or 'pincal'}": f"{lines:,} in {files}"
            for room, (lines, files) in sorted(self.rooms.items())
        }
        return {
            "lines in files": f"{self.lines:,} in {self.files}",
            **rooms,
            "page lines": f"{self.page_lines:,}",
            "largest folder": f"{size} ({folder})",
            "vague names": f"{self.vague_share:.1%} of {self.bindings:,}",
            "class names twice": f"{len(self.repeated_classes)}",
            "dataclasses": f"{self.dataclasses} of {self.classes.total()} classes",
            f"complexity above {MOST_COMPLEX}": f"{len(self.complex_functions)}",
            f"more than {MOST_ARGUMENTS} arguments": f"{len(self.long_signatures)}",
            "imports inside functions": f"{len(self.inner_imports)}",
        }


def count(root: Path) -> Counts:
    """Return the counts of a source tree.

    Args:
        root: Folder that holds ``pincal/``.
    """
    counts = Counts()
    for path in sorted((root / "pincal").rglob("*")):
        name = path.relative_to(root).as_posix()
        if path.suffix in PAGES:
            counts.page_lines += len(path.read_text(encoding="utf-8").splitlines())
        if path.suffix != ".py":
            continue
        text = path.read_text(encoding="utf-8")
        room = name.split("/")[1] if name.count("/") > 1 else ""
        lines, files = counts.rooms.get(room, (0, 0))
        counts.rooms[room] = lines + len(text.splitlines()), files + 1
        counts.folders[name.rpartition("/")[0]] += 1
        _count_module(ast.parse(text), name, counts)
    return counts


def _count_module(tree: ast.Module, name: str, counts: Counts) -> None:
    """Add the counts of one module."""
    for node in ast.walk(tree):
        if binding := _binding(node):
            counts.bindings += 1
            if (word := binding.strip("_").lower()) in VAGUE:
                counts.vague[word] += 1
        if isinstance(node, ast.ClassDef):
            counts.classes[node.name] += 1
            counts.dataclasses += any("dataclass" in ast.unparse(d) for d in node.decorator_list)
        if isinstance(node, _FUNCTIONS):
            place, within = f"{name}:{node.lineno} {node.name}", list(ast.walk(node))
            if (value := complexity(within)) > MOST_COMPLEX:
                counts.complex_functions.append(f"{place} ({value})")
            if (n_arguments := _argument_count(node)) > MOST_ARGUMENTS:
                counts.long_signatures.append(f"{place} ({n_arguments})")
            counts.inner_imports += [
                f"{name}:{inner.lineno} {inner.module}"
                for inner in within
                if isinstance(inner, ast.ImportFrom) and str(inner.module).startswith("pincal")
            ]


def complexity(nodes: Iterable[ast.AST]) -> int:
    """Return the cyclomatic complexity of all nodes of a function, inner functions included.

    Reference: T. J. McCabe, "A Complexity Measure", IEEE Trans. Software Eng. SE-2 (1976).
    """
    value = 1
    for node in nodes:
        if isinstance(node, _BRANCHES):
            value += 1 + len(node.ifs) if isinstance(node, ast.comprehension) else 1
        elif isinstance(node, ast.BoolOp):
            value += len(node.values) - 1
        elif isinstance(node, ast.Match):
            value += len(node.cases)
    return value


def _argument_count(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    """Return how many arguments a function has, without ``self``, ``cls``, ``*`` and ``**``."""
    arguments = function.args
    names = [item.arg for item in (*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs)]
    return len(names) - (names[:1] in (["self"], ["cls"]))


def _binding(node: ast.AST) -> str:
    """Return the name that a node binds: a variable, parameter, function or class; or nothing."""
    if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store) and node.id.strip("_"):
        return node.id
    if isinstance(node, ast.arg) and node.arg not in ("self", "cls"):
        return node.arg
    return node.name if isinstance(node, (*_FUNCTIONS, ast.ClassDef)) else ""


def count_revision(root: Path, revision: str) -> Counts:
    """Return the counts of a git revision; nothing is checked out.

    Args:
        root: Folder of the repository.
        revision: Anything that git understands.

    Raises:
        subprocess.CalledProcessError: git knows no such revision.
    """
    command = ["git", "-C", str(root), "archive", revision, "pincal"]
    archive = subprocess.run(command, check=True, stdout=subprocess.PIPE).stdout
    with tempfile.TemporaryDirectory() as folder, tarfile.open(fileobj=io.BytesIO(archive)) as tar:
        tar.extractall(folder, filter="data")
        return count(Path(folder))


def main(arguments: list[str] | None = None) -> int:
    """Print the table.

    Args:
        arguments: Of the command line.
    """
    parser = argparse.ArgumentParser(prog="python -m tools.counts", description="Count the source.")
    parser.add_argument("--against", metavar="REV", help="a git revision to stand beside")
    parser.add_argument("--list", action="store_true", help="name what was counted")
    options = parser.parse_args(arguments)
    root = Path(__file__).parents[1]
    counts = count(root)
    columns = {"now": counts.table()}
    if options.against:
        try:
            columns = {options.against: count_revision(root, options.against).table(), **columns}
        except subprocess.CalledProcessError:
            return 2  # git has printed the reason
    names = list(dict.fromkeys(name for column in columns.values() for name in column))
    rows = [("", *columns), *((n, *(c.get(n, "") for c in columns.values())) for n in names)]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for first, *cells in rows:
        print("  ".join([first.ljust(widths[0]), *map(str.rjust, cells, widths[1:])]).rstrip())
    if options.list:
        for head, items in (
            ("complex functions", counts.complex_functions),
            ("long signatures", counts.long_signatures),
            ("imports inside functions", counts.inner_imports),
            ("class names twice", counts.repeated_classes),
            ("vague names", [f"{name} ({n})" for name, n in counts.vague.most_common()]),
        ):
            print(f"\n{head}:", *items, sep="\n  ")
    return 0


if __name__ == "__main__":
    sys.exit(main())
