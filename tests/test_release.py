"""What a release is made of agrees with itself: version, Pythons, dependencies, workflows."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

import pytest
import yaml

import pincal

ROOT = Path(__file__).parents[1]
#: Packages that conda-forge has by other names.
_CONDA = {
    "pin": "pinocchio",
    "lazy_loader": "lazy-loader",
    "XlsxWriter": "xlsxwriter",
    "matplotlib": "matplotlib-base",
    "meshcat": "meshcat-python",
    "PyYAML": "pyyaml",
}


def read(path: str) -> Any:
    """Return what a YAML file of the repository says."""
    return yaml.safe_load((ROOT / path).read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def project() -> dict[str, Any]:
    """What pyproject.toml says of the project."""
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    return dict(tomllib.loads(text)["project"])


def test_version_is_one(project: dict[str, Any]) -> None:
    """Package, citation, recipe and changelog say the same version; the changelog has kinds."""
    version = pincal.__version__
    assert project["dynamic"] == ["version"]  # read off the package
    assert read("CITATION.cff")["version"] == version
    assert read("packaging/conda/recipe.yaml")["context"]["version"] == version
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    sections = re.split(r"^## ", text, flags=re.MULTILINE)[1:]
    released = next(one for one in sections if one.startswith(version))
    kinds = re.findall(r"^### (.*)$", released, re.MULTILINE)
    assert {"Added", "Changed", "Fixed"} <= set(kinds)
    assert set(kinds) <= {"Added", "Changed", "Deprecated", "Removed", "Fixed", "Security"}
    assert len(kinds) == len(set(kinds))


def test_citation_names_what_the_package_is(project: dict[str, Any]) -> None:
    """The citation has the keys that its format requires, and the package's licence."""
    citation = read("CITATION.cff")
    assert {"cff-version", "message", "title", "authors"} <= set(citation)
    assert citation["license"] == project["license"]


def test_workflows_run_every_python_that_is_promised(project: dict[str, Any]) -> None:
    """The matrix of the tests has the Pythons of the classifiers, from the least that is asked."""
    told = [
        one.rpartition(" ")[2]
        for one in project["classifiers"]
        if re.fullmatch(r"Programming Language :: Python :: 3\.\d+", one)
    ]
    jobs = read(".github/workflows/tests.yml")["jobs"]
    assert jobs["quick"]["strategy"]["matrix"]["python"] == told
    assert project["requires-python"] == f">={told[0]}"
    steps = [step.get("run", "") for step in jobs["quick"]["steps"]]
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert all(step in readme for step in steps)
    assert ".ci/run" in [step.get("run") for step in jobs["all"]["steps"]]


def test_publishing_stores_no_token() -> None:
    """A tag alone publishes, by the identity of the workflow, what twine has checked."""
    text = (ROOT / ".github" / "workflows" / "publish.yml").read_text(encoding="utf-8")
    flow = yaml.safe_load(text)
    assert flow[True]["push"] == {"tags": ["v*"]}  # 'on' is true to YAML
    assert flow["jobs"]["publish"]["permissions"] == {"id-token": "write"}
    assert "password" not in text
    assert "twine check --strict" in text
    assert "cyclonedx-py environment" in text


def test_conda_recipe_asks_for_what_the_package_asks_for(project: dict[str, Any]) -> None:
    """Each dependency with its least version, by the name that conda-forge has for it."""
    run = read("packaging/conda/recipe.yaml")["requirements"]["run"]
    asked = [re.fullmatch(r"([\w-]+)(>=.*)", one) for one in project["dependencies"]]
    expected = {f"{_CONDA.get(one[1], one[1])} {one[2]}" for one in asked if one}
    assert len(expected) == len(project["dependencies"])
    assert {one for one in run if not one.startswith("python ")} == expected
