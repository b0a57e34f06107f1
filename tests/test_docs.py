"""Pages that are made of the code say what it says."""

from __future__ import annotations

import ast
import csv
import inspect
import re
import runpy
import shlex
from functools import cache
from importlib.metadata import PackageNotFoundError
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_words import values_of
from typer.main import get_command

import pincal
from pincal.cli.app import app
from pincal.model.platform import WAYS
from pincal.words.findings import WORDINGS
from pincal.words.numbers import UNITS
from studies.__main__ import main

ROOT = Path(__file__).parents[1]
#: Licences that ask of users of pincal no more than to name the authors.
FREE = ("MIT", "BSD", "Apache", "PSF", "MPL", "ISC", "Zlib", "BSL", "Qhull", "HPND", "0BSD", "CC0")


@pytest.fixture(scope="module")
def dependencies() -> dict[str, Any]:
    """Names of the script that makes the tables of dependencies."""
    return runpy.run_path(str(ROOT / "docs" / "dependencies.py"))


@pytest.mark.fuzz
@pytest.mark.parametrize("name", ["5R", "3RRR", "6UPS"])
def test_studies_on_the_pages_are_as_they_come_now(name: str, tmp_path: Path) -> None:
    """Text and tables of the pages are those that the command writes, to the byte; minutes each."""
    assert main([name, "-o", str(tmp_path / name)]) == 0
    page = ROOT / "docs/studies" / name
    files = [Path("study.md"), *(path.relative_to(page) for path in page.glob("tables/*"))]
    assert len(list((tmp_path / name / "tables").iterdir())) == len(files) - 1
    stale = [f for f in files if (tmp_path / name / f).read_bytes() != (page / f).read_bytes()]
    assert not stale


def kinds_of_errors(kind: type = pincal.PincalError) -> list[type]:
    """Return a class of errors, and all those of it."""
    return [kind, *(deeper for sub in kind.__subclasses__() for deeper in kinds_of_errors(sub))]


def test_errors_page_has_each_error() -> None:
    """Each class has a section with its docstring, causes, a remedy, and which built-in it is."""
    text = (ROOT / "docs" / "errors.md").read_text(encoding="utf-8")
    sections = dict(re.findall(r"^## (\w+)\n(.*?)(?=^## |\Z)", text, re.MULTILINE | re.DOTALL))
    for kind in kinds_of_errors():
        page = sections[kind.__name__]
        assert (inspect.getdoc(kind) or "") in page
        assert all(f"**{part}**: " in page for part in ("Causes", "What to do"))
        base = kind.__bases__[-1]
        assert base is Exception or f"also a `{base.__name__}`" in page


def test_every_page_is_linked() -> None:
    """From the README every page is found by links between pages; every link leads somewhere."""
    seen, left = set(), [ROOT / "README.md"]
    while left:
        page = left.pop()
        seen.add(page)
        for target in re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", page.read_text(encoding="utf-8")):
            if "reference/made" in target:
                continue
            linked = (page.parent / target).resolve()
            assert linked.exists(), f"{page}: {target}"
            if linked.suffix == ".md" and linked not in seen:
                left.append(linked)
    made = ("_build", "gallery", "made", "api")  # by the build of the site
    pages = {one for one in (ROOT / "docs").rglob("*.md") if not set(made) & set(one.parts)}
    assert pages <= seen


@pytest.mark.slow
def test_measuring_page_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its Python runs as it stands, in an empty folder, and finds what it says."""
    text = (ROOT / "docs" / "measuring.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    monkeypatch.chdir(tmp_path)
    exec(compile(code, "measuring.md", "exec"), {"__name__": "__main__"})
    assert re.search(r"4cable: \d", capsys.readouterr().out)
    table = (tmp_path / "lines.csv").read_text(encoding="utf-8").splitlines()
    assert len(table) == 61
    assert table[9].startswith(",,,")  # the ninth row has no position


def test_measuring_page_names_columns_and_units() -> None:
    """All columns that are read and all units, and what cables alone do not tell."""
    text = (ROOT / "docs" / "measuring.md").read_text(encoding="utf-8")
    columns = [
        "set",
        "pose",
        "run",
        "sigma_x",
        *(name for names, _ in WAYS.values() for name in names),
    ]
    assert all(re.search(rf"`{name}( \[|`)", text) for name in columns)
    assert all(f"`{unit}`" in text for unit in UNITS if unit.isalpha() and unit.isascii())
    robot = pincal.load_mechanism("4cable")
    lengths = np.random.default_rng(0).uniform(-0.1, 0.1, (60, 4))
    data = pincal.Measurements(poses=np.full((60, 3), np.nan), readings=lengths)
    with pytest.raises(pincal.ObservabilityError, match=r"line_A\.k.*together"):
        pincal.calibrate(robot, data, noise=pincal.Noise(reading=1e-3), rough=True, strict=True)


@cache
def nodes_of_the_source() -> tuple[ast.AST, ...]:
    """Return the syntax of all modules, node by node."""
    return tuple(
        node
        for path in (ROOT / "pincal").rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
    )


def made() -> set[str]:
    """Return the codes of findings that the source makes, each with the values of its code."""
    calls = [
        node
        for node in nodes_of_the_source()
        if isinstance(node, ast.Call)
        and isinstance(node.func, ast.Name)
        and node.func.id in ("finding", "Hypothesis")
        and isinstance(node.args[0] if node.args else None, ast.Constant)
    ]
    for call in calls:
        if call.func.id == "finding":
            names = {keyword.arg for keyword in call.keywords} - {"rows", "parameters"}
            expected = values_of(call.args[0].value)
            assert names - {None} <= expected if None in names else names == expected
    return {call.args[0].value for call in calls}


def table_of(name: str) -> dict[str, list[str]]:
    """Return the rows of a table of the page of errors, which shows it, by their first cells."""
    page = (ROOT / "docs" / "errors.md").read_text(encoding="utf-8")
    assert f":file: tables/{name}.csv\n" in page
    text = (ROOT / "docs" / "tables" / f"{name}.csv").read_text(encoding="utf-8")
    return {first: row for first, *row in list(csv.reader(text.replace("`", "").splitlines()))[1:]}


def test_every_finding_is_explained() -> None:
    """The page has each code with severity, meaning and remedy, and what each value of it is.

    What the source finds has a code.
    """
    rows, values = (table_of(name) for name in ("findings", "finding_values"))
    assert set(rows) == set(WORDINGS)
    assert set(values) == set[str]().union(*map(values_of, WORDINGS))
    assert all(map(any, values.values()))
    for code, one in WORDINGS.items():
        _, severity, means, advice = rows[code]
        assert severity == one.severity
        assert means.endswith(".")
        assert advice == f"{one.remedy}." if one.remedy and "{" not in one.remedy else advice
    elsewhere = {"chi2-too-large", "chi2-too-small", "unknown-frame"}  # codes made by choice
    elsewhere |= {"photos-shifted", "photos-turned", "board-mirrored", "boards-exchanged"}
    elsewhere |= {"board-scale"}
    constants = (node for node in nodes_of_the_source() if isinstance(node, ast.Constant))
    assert elsewhere <= {node.value for node in constants if isinstance(node.value, str)}
    assert made() - {"nothing"} == set(WORDINGS) - elsewhere
    robot = pincal.load_mechanism("5R")
    plan = pincal.Plan(np.array([[0.1 * i - 0.3, 1.1 + 0.02 * (i % 3)] for i in range(8)]))
    truth = pincal.disturb(robot, 2e-3, seed=1)
    result = pincal.calibrate(robot, pincal.simulate(robot, truth, plan, seed=1).measurements)
    assert result.warnings
    assert {one.code for one in result.findings} <= set(WORDINGS)


def raised() -> set[str]:
    """Return the names of what the source raises; of functions that make errors, of these."""
    nodes = nodes_of_the_source()
    makers = {
        node.name: node.returns.id
        for node in nodes
        if isinstance(node, ast.FunctionDef)
        and isinstance(node.returns, ast.Name)
        and node.returns.id.endswith("Error")
    }
    return {
        makers.get(node.exc.func.id, node.exc.func.id)
        for node in nodes
        if isinstance(node, ast.Raise)
        and isinstance(node.exc, ast.Call)
        and isinstance(node.exc.func, ast.Name)
    }


def test_every_error_is_raised() -> None:
    """Each class of error is raised; wrong input raises no other.

    ``TypeError`` and ``AttributeError`` are for wrong calls, ``ValueError`` and
    ``FileExistsError`` for what a reader or a writer turns into one of pincal's.
    """
    kinds = {kind.__name__ for kind in kinds_of_errors()}
    # a reader's argument; and what makes MisfitError, ObservabilityError, or returns what it got
    names = raised() - {"error_type", "explained_error"}
    assert names - kinds <= {
        *("TypeError", "ValueError", "AttributeError", "SystemExit", "FileExistsError")
    }
    assert kinds <= names


def test_dependencies_page_is_what_is_installed(dependencies: dict[str, Any]) -> None:
    """The tables of what pincal asks for are those of pyproject.toml, each with why and licence.

    Of tools that are not installed, as in a run of the tests alone, only the names are known.
    """
    page = (ROOT / "docs" / "dependencies.md").read_text(encoding="utf-8")
    tools = [one.name for one in dependencies["asked"]("test", "dev")]
    assert all(f"\n- {name} (" in page for name in tools)
    try:
        made = dependencies["written"](page, "library", "tools")
    except PackageNotFoundError:
        made = dependencies["written"](page, "library")
    assert made == page


def test_no_licence_binds_users(dependencies: dict[str, Any]) -> None:
    """All that comes along is licensed permissively, as its metadata or files state."""
    asked = [one.name for one in dependencies["asked"]()]
    licences = {
        name: dependencies["licence"](name) for name in (*asked, *dependencies["brought"]())
    }
    assert len(licences) > 40
    bound = {name: text for name, text in licences.items() if not text.startswith(FREE)}
    assert not bound


@pytest.mark.parametrize(
    "page",
    sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/*.md"), *ROOT.glob("docs/[hcr]*/*.md")]),
    ids=lambda one: one.name,
)
def test_commands_that_pages_show_exist(page: Path) -> None:
    """Every ``pincal`` line of a block names a command, and options that its help shows."""
    group = get_command(app)
    fenced = re.compile(r"^```(\w*)\n(.*?)^```", re.DOTALL | re.MULTILINE)
    found = fenced.findall(page.read_text(encoding="utf-8"))
    blocks = [text for kind, text in found if kind in ("", "console")]
    for line in "".join(blocks).replace("\\\n", " ").splitlines():
        typed = shlex.split(line.removeprefix("$ "), comments=True) if "pincal " in line else []
        for start in (i + 1 for i, word in enumerate(typed) if word == "pincal"):
            own = group.get_command(None, typed[start])  # type: ignore[attr-defined]
            assert own is not None, line
            shown = {
                name for one in own.params if not getattr(one, "hidden", 0) for name in one.opts
            }
            options = {word for word in typed[start:] if re.match("--?[a-z]", word)}
            assert options <= shown, line


@pytest.mark.parametrize("page", ["CONTRIBUTING.md", "docs/glossary.md", "docs/testing.md"])
def test_files_that_pages_name_are_there(page: str) -> None:
    """Every module and folder of the repository that a page sends its reader to exists."""
    text = (ROOT / page).read_text(encoding="utf-8")
    named = set(re.findall(r"`((?:pincal|tests|tools)/[\w/.]*)`", text))
    assert named
    assert not {name for name in named if not (ROOT / name).exists()}
