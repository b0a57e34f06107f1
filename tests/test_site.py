"""What the site shows is true: names have examples, pages answer what they say, links lead on."""

from __future__ import annotations

import ast
import doctest
import inspect
import io
import re
import runpy
from contextlib import chdir, redirect_stderr, redirect_stdout
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.image import imread

import pincal
from pincal.cli.app import app, main

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
ANSWERS: dict[str, Any] = runpy.run_path(str(DOCS / "answers.py"))
RUN = ANSWERS["pages"]()
GROUPS: dict[str, str] = runpy.run_path(str(DOCS / "build_steps" / "names.py"))["GROUPS"]


def used_in_examples() -> set[str]:
    """Return the public names that the gallery's programs use."""
    return {
        node.attr
        for path in (ROOT / "examples").glob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Attribute) and ast.unparse(node.value) == "pincal"
    } | {
        alias.name
        for path in (ROOT / "examples").glob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.ImportFrom) and node.module == "pincal"
        for alias in node.names
    }


EXAMPLES = used_in_examples()
ERRORS_PAGE = (DOCS / "errors.md").read_text("utf-8")
ERRORS = dict(re.findall(r"^## (\w+)\n(?:(?!^## ).)*?```pycon\n(.*?)```", ERRORS_PAGE, re.M | re.S))


@pytest.mark.parametrize("name", pincal.__all__)
def test_public_name_is_explained_and_has_an_example(name: str) -> None:
    """It has a docstring of its own, and an example there, in the gallery or on the errors' page.

    A function's docstring has a line for each of its arguments.
    """
    what = getattr(pincal, name)
    text = inspect.getdoc(what) or ""
    assert len(text.split()) >= 3
    assert text.splitlines()[0].rstrip().endswith((".", ":"))
    assert ">>>" in text or name in EXAMPLES or name in ERRORS
    if inspect.isfunction(what):
        told = text.partition("Args:\n")[2] or text
        taken = inspect.signature(what).parameters
        assert not [one for one in taken if not re.search(rf"\b{one}\b", told)]


def test_help_names_types_as_they_are_written() -> None:
    """Signatures of public functions and methods say Poses and Array, not what these stand for."""
    for name in pincal.__all__:
        public = getattr(pincal, name)
        methods = vars(public).values() if inspect.isclass(public) else ()
        for function in filter(inspect.isfunction, (public, *methods)):
            assert "numpy.ndarray" not in str(inspect.signature(function)), (name, function)


def test_public_names_are_on_the_page_once() -> None:
    """The reference lists every public name, in one group."""
    listed = [name for own in GROUPS.values() for name in own.split()]
    assert sorted(listed) == sorted(pincal.__all__)


@pytest.mark.parametrize(
    "name", [one for one in pincal.__all__ if ">>>" in (getattr(pincal, one).__doc__ or "")]
)
def test_docstring_example_is_true(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What a docstring shows as answer is what comes."""
    monkeypatch.chdir(tmp_path)
    run_example(name, inspect.getdoc(getattr(pincal, name)) or "", {})


@pytest.mark.parametrize("name", ERRORS)
def test_example_of_an_error_is_true(name: str) -> None:
    """What raises it, on the page of errors, raises it with this message."""
    assert issubclass(getattr(pincal, name), pincal.PincalError)
    run_example(name, ERRORS[name], {"pincal": pincal})


def run_example(name: str, text: str, known: dict[str, Any]) -> None:
    """Run what a text shows as typed; the answers must be those that it shows."""
    example = doctest.DocTestParser().get_doctest(text, known, name, None, None)
    said: list[str] = []
    doctest.DocTestRunner(verbose=False).run(example, out=said.append)
    assert not said, "".join(said)


def test_pages_that_show_programs_are_run() -> None:
    """Start, how-tos and concepts with a console or program are run by answers.py."""
    own = [DOCS / "start.md", *(DOCS / "how_to").glob("*.md"), *(DOCS / "concepts").glob("*.md")]
    shown = {page for page in own if re.search("```(console|python)", page.read_text("utf-8"))}
    assert shown
    assert shown <= set(RUN)


def answer(line: list[str], folder: Path) -> tuple[int, str]:
    """Return the exit code of a command that is run in this process, and what it prints."""
    said = io.StringIO()
    with (
        chdir(folder),
        redirect_stdout(said),
        redirect_stderr(said),
        pytest.raises(SystemExit) as left,
    ):
        main(line[line.index("pincal") + 1 :])
    return int(left.value.code or 0), said.getvalue()


@pytest.mark.slow
@pytest.mark.parametrize("page", RUN, ids=lambda one: one.stem)
def test_page_answers_what_it_says(
    page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """``python docs/answers.py`` makes the page that is there, but for digits; so do its files.

    Its commands and programs are run in this process, and draw no reports: these are
    tests/test_report.py's.
    """

    class Program:
        """A page's Python, run here."""

        def __init__(self, folder: Path) -> None:
            self.folder, self.space = folder, {"__name__": "__main__"}

        def answer(self, code: str) -> str:
            said = io.StringIO()
            with chdir(self.folder), redirect_stdout(said):
                exec(compile(code, page.name, "exec"), self.space)
            return said.getvalue()

        def close(self) -> None:
            self.space.clear()

    monkeypatch.setitem(ANSWERS["filled"].__globals__, "run", answer)
    monkeypatch.setitem(ANSWERS["filled"].__globals__, "Program", Program)
    monkeypatch.setenv("NO_COLOR", "1")
    monkeypatch.setattr("pincal.show.report.Report.html", lambda _: "<html></html>\n")
    text = page.read_text(encoding="utf-8")
    again = ANSWERS["filled"](text, tmp_path)

    def words(of: str) -> list[str]:
        return re.sub(r"[-+]?\d[\d.]*(e-?\d+)?", "#", of).split()

    assert words(again) == words(text)
    for shown in re.findall(r"images/((?:start|concept)_[\w.]+)\)", text):
        assert (tmp_path / shown).exists()
        if shown.endswith(".png"):  # the same but for a few pixels
            made, there = imread(tmp_path / shown), imread(DOCS / "images" / shown)
            assert made.shape == there.shape
            assert (np.abs(made - there) > 0.1).any(axis=2).mean() < 0.02


def test_a_page_whose_command_fails_is_not_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its exit code must be 0, or what the comment behind the command says."""
    monkeypatch.setitem(ANSWERS["filled"].__globals__, "run", answer)
    page = "```console\n$ pincal check 9RRR{}\n```\n"
    with pytest.raises(SystemExit, match="exit code 2 was not expected"):
        ANSWERS["filled"](page.format(""), tmp_path)
    again = ANSWERS["filled"](page.format("  # exit code 2"), tmp_path)
    assert "no mechanism '9RRR'" in again


def test_programs_of_other_pages_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Those of the pages on printers and mechanisms, beside the files that they name.

    The others' are run by tests/test_docs.py and tests/test_new.py.
    """
    monkeypatch.chdir(tmp_path)
    config = re.findall("```ini\n(.*?)```", (DOCS / "how_to/delta_printer.md").read_text(), re.S)
    (tmp_path / "printer.cfg").write_text(config[0])
    files = metadata.files("example-robot-data") or []
    urdf = next(Path(str(one.locate())) for one in files if one.name == "ur10_robot.urdf")
    (tmp_path / "ur10_robot.urdf").write_text(urdf.read_text(encoding="utf-8"))
    for page, made in {"printers": None, "mechanisms": "ur10/mechanism.yaml"}.items():
        text = (DOCS / f"{page}.md").read_text(encoding="utf-8")
        for code in re.findall(r"```python\n(.*?)```", text, re.DOTALL):
            exec(compile(code, page, "exec"), {"pincal": pincal})
        assert made is None or (tmp_path / made).exists()
    shown = {one for one in DOCS.glob("*.md") if "```python" in one.read_text("utf-8")}
    run = {"printers", "mechanisms", "measuring", "your_mechanism"}
    assert {one.stem for one in shown} <= run | {one.stem for one in RUN}


def test_every_page_is_in_a_table_of_contents() -> None:
    """Every page of the site stands in a toctree, and every toctree's page is there or is made."""
    listed: set[Path] = {DOCS / "index.md"}
    for page in (one for one in DOCS.rglob("*.md") if "_build" not in one.parts):
        for tree in re.findall(r"```\{toctree\}\n(.*?)```", page.read_text("utf-8"), re.DOTALL):
            for line in tree.splitlines():
                name = re.sub(r".*<(.*)>", r"\1", line.strip())
                if name and not name.startswith(":"):
                    listed.add((page.parent / f"{name}.md").resolve())
    made = ("reference/made", "reference/api", "gallery", "_build")
    pages = {one for one in DOCS.rglob("*.md") if not str(one.relative_to(DOCS)).startswith(made)}
    assert pages <= listed
    missing = {
        one for one in listed - pages if "made" not in one.parts and "gallery" not in one.parts
    }
    assert not missing


def test_start_page_and_readme_agree_on_commands() -> None:
    """Commands that the index of the site's pages names are commands."""
    text = (DOCS / "index.md").read_text(encoding="utf-8")
    commands = {command.name for command in app.registered_commands}
    assert set(re.findall(r"pincal (demo)\b", text)) <= commands
