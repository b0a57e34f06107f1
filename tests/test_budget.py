"""The source stays small and plain: limits that only go down, unless a commit says what pays."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))
from tools.counts import count, count_revision, main  # noqa: E402

LINES = {
    "": 262,
    "architectures": 616,
    "calibration": 6_708,
    "cli": 2_672,
    "design": 2_536,
    "estimation": 4_293,
    "files": 3_256,
    "formats": 4_311,
    "instruments": 1_544,
    "kinematics": 3_457,
    "model": 3_567,
    "show": 3_910,
    "symmetry": 1_190,
    "words": 952,
    "workspace": 1_445,
}
"""Most lines of each room; a room that is not listed may have none."""
MOST = {
    "files": 175,
    "page lines": 887,
    "largest folder": 16,
    "vague names": 0.01,
    "class names twice": 0,
    "dataclasses": 128,
    "complex functions": 0,
    "long signatures": 0,
    "imports inside functions": 0,
}


def test_source_is_within_its_budget() -> None:
    """No room has more lines than its budget, no measure of the source is above its limit.

    What was counted: ``tools.counts --list``.
    """
    counts = count(ROOT)
    rooms = {room: lines for room, (lines, _) in counts.rooms.items()}
    assert {room: lines for room, lines in rooms.items() if lines > LINES.get(room, 0)} == {}
    measured = {
        "files": counts.files,
        "page lines": counts.page_lines,
        "largest folder": max(counts.folders.values()),
        "vague names": counts.vague_share,
        "class names twice": len(counts.repeated_classes),
        "dataclasses": counts.dataclasses,
        "complex functions": len(counts.complex_functions),
        "long signatures": len(counts.long_signatures),
        "imports inside functions": len(counts.inner_imports),
    }
    assert {name: value for name, value in measured.items() if value > MOST[name]} == {}


MODULE = '''"""A module."""


class Thing:
    """A thing: a class with a vague name."""

    size: float = 2.0

    def plain(self, a, b, /, c, *d, e=1, f=2, g=3, **h):
        """Has six arguments, and branches twice: complexity 3."""
        from pincal.top import name

        return [own for own in a if own]

    def complicated(self, a, b, c, d, e, f, g):
        """Has seven arguments and complexity 16."""
        if a and b and c and d and e and f and g and a and b and c and d and e and f and g and a:
            return 1
        return 2
'''


def test_counts_of_a_tree_counted_by_hand(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every measure is that of a small tree counted by hand; the same of a git revision."""
    for name, text in (
        ("pincal/__init__.py", '"""A tree."""\n'),
        ("pincal/room/module.py", MODULE),
        ("pincal/room/below/other.py", "@dataclass\nclass Thing:\n    found = 1\n"),
        ("pincal/room/page.css", "a {}\nb {}\n"),
    ):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    counts = count(tmp_path)
    assert counts.rooms == {"": (1, 1), "room": (len(MODULE.splitlines()) + 3, 2)}
    assert counts.folders == {"pincal": 1, "pincal/room": 1, "pincal/room/below": 1}
    assert (counts.bindings, dict(counts.vague)) == (22, {"thing": 2, "own": 1, "found": 1})
    assert (counts.repeated_classes, counts.dataclasses, counts.page_lines) == (["Thing"], 1, 2)
    assert counts.long_signatures == ["pincal/room/module.py:15 complicated (7)"]
    assert counts.complex_functions == ["pincal/room/module.py:15 complicated (16)"]
    assert counts.inner_imports == ["pincal/room/module.py:11 pincal.top"]
    for command in (
        ["init", "-q"],
        ["add", "-A"],
        ["-c", "user.name=a", "-c", "user.email=a@b", "commit", "-qm", "A tree"],
    ):
        subprocess.run(["git", *command], cwd=tmp_path, check=True)
    assert count_revision(tmp_path, "HEAD").table() == counts.table()
    monkeypatch.setattr("tools.counts.count", lambda _: counts)
    assert main(["--list"]) == 0
    assert "\n  thing (2)\n" in capsys.readouterr().out
