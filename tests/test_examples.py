"""Every example runs as it stands, in an empty folder, and draws what it says."""

from __future__ import annotations

import ast
import runpy
from pathlib import Path

import numpy as np
import pytest
from matplotlib import rc_context, rcdefaults
from matplotlib.image import imread

import pincal

EXAMPLES = sorted((Path(__file__).parents[1] / "examples").glob("*.py"))


@pytest.mark.slow
@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_example_runs(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It ends without error or warning and leaves a picture; it is under 60 lines.

    What the second one draws is the first picture of the README, but for a few pixels.
    """
    monkeypatch.chdir(tmp_path)
    with rc_context():
        rcdefaults()
        runpy.run_path(str(path), run_name="__main__")
    assert list(tmp_path.glob("*.png"))
    assert len(path.read_text().splitlines()) < 60
    if path.stem.startswith("02"):
        made = imread(tmp_path / "02_poses.png")
        shown = imread(path.parents[1] / "docs" / "images" / "selected_poses.png")
        assert made.shape == shown.shape
        assert (np.abs(made - shown) > 0.1).any(axis=2).mean() < 2e-3


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_example_uses_the_public_api_alone(path: Path) -> None:
    """It imports pincal's top, where every name is in ``__all__``."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            assert not any(one.name.startswith("pincal.") for one in node.names)
        elif isinstance(node, ast.ImportFrom) and str(node.module).startswith("pincal"):
            assert node.module == "pincal"
            assert {one.name for one in node.names} <= set(pincal.__all__)
        elif isinstance(node, ast.Attribute) and ast.unparse(node.value) == "pincal":
            assert node.attr in pincal.__all__


@pytest.mark.slow
def test_readme_example_prints_what_the_readme_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The Python block of the README gives the output printed below it."""
    blocks = (Path(__file__).parents[1] / "README.md").read_text().split("```")
    code = next(b.removeprefix("python\n") for b in blocks if b.startswith("python\n"))
    expected = blocks[blocks.index("python\n" + code) + 2].strip()
    monkeypatch.chdir(tmp_path)
    exec(compile(code, "README.md", "exec"), {"__name__": "__main__"})
    assert capsys.readouterr().out.strip() == expected
