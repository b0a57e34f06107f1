"""Pages that are made of the code say what it says."""

from __future__ import annotations

import ast
import runpy
from importlib.metadata import PackageNotFoundError
from pathlib import Path
from typing import Any

import pytest

from pincal import errors

ROOT = Path(__file__).parents[1]
#: Licences that ask of users of pincal no more than to name the authors.
FREE = ("MIT", "BSD", "Apache", "PSF", "MPL", "ISC", "Zlib", "BSL", "Qhull", "HPND", "0BSD", "CC0")


@pytest.fixture(scope="module")
def dependencies() -> dict[str, Any]:
    """Names of the script that makes the tables of dependencies."""
    return runpy.run_path(str(ROOT / "docs" / "dependencies.py"))


def test_errors_page_is_what_the_code_says() -> None:
    """``python docs/errors.py`` makes the page that is there."""
    made = runpy.run_path(str(ROOT / "docs" / "errors.py"))["page"]()
    assert (ROOT / "docs" / "errors.md").read_text(encoding="utf-8") == made


def raised() -> set[str]:
    """Return the names of what the source raises by name."""
    return {
        node.exc.func.id
        for path in (ROOT / "pincal").rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Raise)
        and isinstance(node.exc, ast.Call)
        and isinstance(node.exc.func, ast.Name)
    }


def test_every_error_is_raised_and_explained() -> None:
    """Each class of error says its causes and remedies and is raised; wrong input raises no other.

    ``TypeError`` is for wrong calls, ``ValueError`` for what a reader turns into one of pincal's.
    """
    kinds = {
        name: kind
        for name, kind in vars(errors).items()
        if isinstance(kind, type) and issubclass(kind, Exception)
    }
    names = raised() - {"error_type"}  # a reader's argument
    assert names - set(kinds) <= {"TypeError", "ValueError", "SystemExit"}
    assert set(kinds) - names == {"PincalError"}
    for name in names & set(kinds):
        assert "Causes: " in str(kinds[name].__doc__)
        assert "What to do: " in str(kinds[name].__doc__)


def test_dependencies_page_is_what_is_installed(dependencies: dict[str, Any]) -> None:
    """The tables of what pincal asks for are those of pyproject.toml, each with why and licence.

    Of tools that are not installed, as in a run of the tests alone, only the names are known.
    """
    page = (ROOT / "docs" / "dependencies.md").read_text(encoding="utf-8")
    tools = [one.name for one in dependencies["asked"]("cluster", "test", "dev")]
    assert all(f"| {name} |" in page for name in tools)
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
