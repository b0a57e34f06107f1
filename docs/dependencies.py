"""Writes the tables of dependencies.md, of what is installed: ``python docs/dependencies.py``.

It prints what these packages bring along, by licence.
"""

from __future__ import annotations

import re
import tomllib
from importlib import metadata
from itertools import groupby
from pathlib import Path

from packaging.requirements import Requirement

PAGE = Path(__file__).with_suffix(".md")
_BLOCK = re.compile(r"(<!-- made by dependencies\.py: (\w+) -->\n).*?(<!-- end -->)", re.DOTALL)
#: Why each package that pincal asks for is there.
WHY = {
    "pin": "Pinocchio: kinematics with their derivatives; reads URDF",
    "numpy": "arrays",
    "scipy": "least squares, transforms, k-d trees, Voronoi diagrams, graphs, distributions",
    "lazy_loader": "names of `pincal` imported when first used",
    "lxml": "reads URDF strictly and safely, with line numbers, so that it is written back bit for "
    "bit (yourdfpy repairs what is broken)",
    "cattrs": "results as plain data and back, bit for bit",
    "jinja2": "pages from templates that escape what files hold",
    "joblib": "many machines: processes whose answers come in order, or Dask",
    "yourdfpy": "second reader of URDF (tests); meshes for `pincal view`",
    "trimesh": "meshes (STL, DAE, OBJ)",
    "PyYAML": "mechanism files, scanned by libyaml",
    "typer": "command line",
    "rich": "tables and progress",
    "threadpoolctl": "one thread of BLAS for small matrices: two take up to four times as long",
    "matplotlib": "plots",
    "meshcat": "its viewer (three.js) in pages; its server and what that needs are never started",
    "openpyxl": "reads .xlsx files",
    "XlsxWriter": "writes .xlsx files in memory; openpyxl prints tracebacks on full disks",
    "mujoco": "extra `mujoco`: reads MJCF, its own format",
    "opencv-python-headless": "extra `camera`: markers in photos",
    "distributed": "extra `cluster`: Dask, the workers of `--scheduler`",
    "example-robot-data": "arms as URDFs with meshes",
    "hypothesis": "properties and fuzzed files",
    "pandas": "changes columns of tables in tests",
    "playwright": "drives Debian's Chromium; without one tests of the page skip",
    "pytest": "tests",
    "pytest-benchmark": "speeds",
    "pytest-xdist": "two processes",
    "sphinx": "the site, built strictly",
    "myst-parser": "pages in Markdown",
    "pydata-sphinx-theme": "the site's looks",
    "sphinx-gallery": "runs the examples; notebooks",
    "sphinx-copybutton": "copies commands",
    "sphinx-design": "cards",
    "nbclient": "runs notebooks",
    "ipykernel": "runs notebooks",
    "import-linter": "floors",
    "mypy": "types",
    "ruff": "style",
    "types-PyYAML": "types",
    "lxml-stubs": "types",
}
#: Licences by the words of classifiers, and of licence texts.
_CLASSIFIERS = {
    "MIT": "MIT",
    "BSD": "BSD",
    "Apache": "Apache-2.0",
    "Mozilla Public License 2": "MPL-2.0",
    "Python Software": "PSF-2.0",
    "ISC": "ISC",
}
_TEXTS = {
    "Permission is hereby granted, free of charge": "MIT",
    "Redistribution and use in source and binary forms": "BSD",
    "Qhull": "Qhull",
}


def asked(*groups: str) -> list[Requirement]:
    """Return what ``pyproject.toml`` asks for, itself or in the given extras."""
    text = (PAGE.parents[1] / "pyproject.toml").read_text(encoding="utf-8")
    project = tomllib.loads(text)["project"]
    extras = project["optional-dependencies"]
    lines = [line for group in groups for line in extras[group]] or project["dependencies"]
    return list({one.name: one for one in map(Requirement, lines)}.values())


def licence(name: str) -> str:
    """Return the licence of an installed package in short, as its metadata or its files say."""
    found = metadata.distribution(name)
    about = found.metadata
    stated = about.get("License-Expression") or (about.get("License") or "")
    if stated and stated != "UNKNOWN" and len(stated) < 80 and "\n" not in stated:
        first, *others = stated.split(" AND ")
        return first.removesuffix(" License") + (" and others" if others else "")
    for line in about.get_all("Classifier") or []:
        kind = line.removeprefix("License :: OSI Approved :: ")
        if kind != line and (known := [v for k, v in _CLASSIFIERS.items() if kind.startswith(k)]):
            return known[0]
    files = [f for f in found.files or [] if re.search("licen[cs]e|copying", f.name, re.IGNORECASE)]
    texts = " ".join([stated, *(f.read_text() for f in files)])
    return next((v for k, v in _TEXTS.items() if k in " ".join(texts.split())), "not stated")


def brought() -> dict[str, set[str]]:
    """Return what the packages that pincal asks for need in turn, and which need it."""
    needed: dict[str, set[str]] = {}
    named: set[tuple[str, str]] = set()
    waiting = [(one.name, extra) for one in asked() for extra in ("", *one.extras)]
    while waiting:
        name, extra = waiting.pop()
        for line in metadata.requires(name) or []:
            one = Requirement(line)
            if one.marker and not one.marker.evaluate({"extra": extra}):
                continue
            needed.setdefault(_plain(one.name), set()).add(name)
            new = {(one.name, e) for e in ("", *one.extras)} - named
            named |= new
            waiting += sorted(new)
    own = {_plain(one.name) for one in asked()}
    return {name: by for name, by in sorted(needed.items()) if name not in own}


def _plain(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def direct(*groups: str) -> str:
    """Return the table of what pincal asks for."""
    already = {one.name for one in asked()} if groups else set()
    rows = [
        f"- {one.name} ({licence(one.name)}): {WHY[one.name]}\n"
        for one in sorted(asked(*groups), key=lambda one: list(WHY).index(one.name))
        if one.name not in already
    ]
    return "".join(rows)


def indirect() -> str:
    """Return what these bring along, by licence."""
    names = sorted(brought(), key=licence)
    return "".join(f"- {kind}: {', '.join(group)}\n" for kind, group in groupby(names, licence))


TABLES = {"library": direct, "tools": lambda: direct("test", "docs", "dev")}


def written(page: str, *names: str) -> str:
    """Return the page with its tables, or some of them, made anew."""

    def made(match: re.Match[str]) -> str:
        table = TABLES[match[2]]() if match[2] in (names or TABLES) else None
        return match[0] if table is None else f"{match[1]}{table}{match[3]}"

    return _BLOCK.sub(made, page)


if __name__ == "__main__":
    PAGE.write_text(written(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
    print(indirect(), end="")
