"""Notebooks of the gallery are the examples, and run; needs the extra ``docs``."""

from __future__ import annotations

import ast
import json
import runpy
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("sphinx_gallery")
pytest.importorskip("nbclient")

ROOT = Path(__file__).parents[1]
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
GALLERY = runpy.run_path(str(ROOT / "docs" / "build_steps" / "gallery.py"))


def notebook(path: Path, folder: Path) -> Any:
    """Return the notebook that the site's build makes of an example."""
    from sphinx_gallery.gen_gallery import DEFAULT_GALLERY_CONF
    from sphinx_gallery.notebook import jupyter_notebook, save_notebook
    from sphinx_gallery.py_source_parser import split_code_and_text_blocks

    staged = folder / path.name
    staged.write_text(GALLERY["titled"](path.read_text(encoding="utf-8")), encoding="utf-8")
    _, blocks = split_code_and_text_blocks(str(staged))
    made = jupyter_notebook(blocks, DEFAULT_GALLERY_CONF, str(folder))
    save_notebook(made, staged.with_suffix(".ipynb"))
    return json.loads(staged.with_suffix(".ipynb").read_text(encoding="utf-8"))


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda one: one.stem)
def test_notebook_is_the_example(path: Path, tmp_path: Path) -> None:
    """Its code is that of the script, statement by statement, and its text begins with a title."""
    cells = notebook(path, tmp_path)["cells"]
    code = "\n".join("".join(one["source"]) for one in cells if one["cell_type"] == "code")
    script = ast.parse(path.read_text(encoding="utf-8"))
    assert ast.dump(ast.parse(code)) == ast.dump(ast.Module(script.body[1:], []))
    text = "".join(next(one for one in cells if one["cell_type"] == "markdown")["source"])
    assert text.lstrip().startswith("# ")


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # of tornado's and zmq's own event loops
def test_notebooks_run(tmp_path: Path) -> None:
    """In a kernel, as Jupyter runs them: quick ones one after another, each draws a picture."""
    import nbformat
    from nbclient import NotebookClient

    for path in [one for one in EXAMPLES if one.stem[:2] in ("01", "11")]:
        made = nbformat.reads(json.dumps(notebook(path, tmp_path)), as_version=4)
        NotebookClient(
            made, timeout=120, kernel_name="python3", resources={"metadata": {"path": tmp_path}}
        ).execute()
    assert len(list(tmp_path.glob("*.png"))) == 2
