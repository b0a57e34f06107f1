"""The gallery: examples of the repository, staged in a folder of their own and run there."""

from __future__ import annotations

import ast
import shutil
from pathlib import Path
from typing import Any

STAGED = Path("_build") / "examples"
_HEAD = """\
Gallery
=======

Each of these is one file under 60 lines that uses the public names alone. They were run when this
site was built; what they print and draw is theirs. Below each one are links to it as a script and
as a notebook. They are also in the folder ``examples`` of the repository.

"""


def titled(source: str) -> str:
    """Return an example whose docstring begins with a title in reStructuredText."""
    tree = ast.parse(source)
    text = ast.get_docstring(tree) or ""
    title, _, rest = text.partition("\n")
    title = title.rstrip(".")
    rest_of_file = "\n".join(source.splitlines()[tree.body[0].end_lineno or 0 :])
    return f'"""{title}\n{"=" * len(title)}\n{rest}\n"""\n{rest_of_file}\n'


def stage(docs: Path) -> None:
    """Copy the examples to where Sphinx-Gallery runs them; what they write stays there."""
    folder = docs / STAGED
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    (folder / "GALLERY_HEADER.rst").write_text(_HEAD, encoding="utf-8")
    for path in sorted((docs.parent / "examples").glob("*.py")):
        text = titled(path.read_text(encoding="utf-8"))
        (folder / path.name).write_text(text, encoding="utf-8")


def pictures(_: Any, variables: dict[str, Any], settings: dict[str, Any], **__: Any) -> str:
    """Return the pictures that an example has written, moved to the gallery."""
    from sphinx_gallery.scrapers import figure_rst

    names = variables["image_path_iterator"]
    moved = []
    for path, place in zip(
        sorted(Path(variables["src_file"]).parent.glob("*.png")), names, strict=False
    ):
        shutil.move(path, place)
        moved.append(place)
    return str(figure_rst(moved, settings["src_dir"]))


def settings(docs: Path) -> dict[str, Any]:
    """Return the configuration of Sphinx-Gallery."""
    return {
        "examples_dirs": str(docs / STAGED),
        "gallery_dirs": "gallery",
        "filename_pattern": r"\.py$",
        "image_scrapers": ("build_steps.gallery.pictures",),
        "backreferences_dir": "gallery/backreferences",
        "doc_module": ("pincal",),
        "abort_on_example_error": True,
        "show_memory": False,
        "show_signature": False,
        "remove_config_comments": True,
        "min_reported_time": 1e9,
        "write_computation_times": False,
        "copyfile_regex": "",
        "within_subsection_order": "FileNameSortKey",
        "plot_gallery": "True",
    }
