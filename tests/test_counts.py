"""The counts of the source are those of a small tree that was counted by hand."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
INIT = '''"""A tree."""
__all__ = ["one", "two"]
'''
MODULE = '''"""Told once; as is_told, and tells is another word."""
_NEAR = 1e-6
_SHIFT: int = 1 << 12
LOW, HIGH = -1.0, 2.0
FIRST, FLAG, NAME, MADE = 0, True, "1", max(1, 2)
ZERO = 0


class Thing:
    """A thing."""

    SIZES = (3, 4)
    field: float = 2.0

    def six(self, a, b, /, c, *rest, d=1, e=2, f=3, **more):
        """Has six."""

    def seven(self, a, b, c, d, e, f, g=7):
        """Has seven."""
'''


def test_a_small_tree(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Files, lines, folders, arguments, constants, public names and words; as a revision too."""
    monkeypatch.syspath_prepend(ROOT)
    from tools.counts import count, count_revision, main

    for name, text in (
        ("pincal/__init__.py", INIT),
        ("pincal/deep/module.py", MODULE),
        ("pincal/deep/trust.py", ""),
        ("studies/one.py", "A = 1\nTOLD = 2\n"),
    ):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    found = count(tmp_path)
    assert (found.files, found.lines, found.public) == (3, 21, 2)
    assert (found.folders, found.studies) == ({"pincal": 1, "pincal/deep": 2}, (1, 2))
    assert found.long == ["pincal/deep/module.py:18 seven (7)"]
    names = [one.split()[-1] for one in found.constants]
    assert names == ["_NEAR", "_SHIFT", "LOW", "HIGH", "SIZES"]
    assert found.words == {"told": 2, "trust": 1}
    for command in (
        ["init", "-q"],
        ["add", "-A"],
        ["-c", "user.name=a", "-c", "user.email=a@b", "commit", "-qm", "A tree"],
    ):
        subprocess.run(["git", *command], cwd=tmp_path, check=True)
    assert count_revision(tmp_path, "HEAD").table() == found.table()
    assert main(["--list"]) == 0
    assert "public names" in capsys.readouterr().out
