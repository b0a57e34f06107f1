"""Every example runs as it stands, in an empty folder, and draws what it says."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

import pincal

EXAMPLES = sorted((Path(__file__).parents[1] / "examples").glob("*.py"))


@pytest.mark.slow
@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_example_runs(path: Path, tmp_path: Path) -> None:
    """It ends without error or warning and leaves a picture; it is under 60 lines.

    What the second one draws is the first picture of the README, but for a few pixels.
    """
    run = subprocess.run(
        [sys.executable, "-W", "error", str(path)], cwd=tmp_path, capture_output=True, text=True
    )
    assert run.returncode == 0, run.stderr
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
def test_readme_example_prints_what_the_readme_says(tmp_path: Path) -> None:
    """The Python block of the README gives the output printed below it."""
    blocks = (Path(__file__).parents[1] / "README.md").read_text().split("```")
    code = next(b.removeprefix("python\n") for b in blocks if b.startswith("python\n"))
    expected = blocks[blocks.index("python\n" + code) + 2].strip()
    run = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert run.stdout.strip() == expected
