"""Collects the ratios of a benchmark run and writes docs/benchmarks.md if asked to."""

from __future__ import annotations

import os
import platform
from collections.abc import Callable, Iterator
from importlib.metadata import version
from pathlib import Path
from time import perf_counter

import numpy as np
import pytest

DOCS = Path(__file__).parents[1] / "docs" / "benchmarks.md"


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add ``--docs``."""
    parser.addoption("--docs", action="store_true", help="write docs/benchmarks.md")


@pytest.fixture(scope="session")
def ratios(request: pytest.FixtureRequest) -> Iterator[Callable[[str, float, str], None]]:
    """Take a ratio's name, value and wanted bound; print them, and write them at the end."""
    rows: list[tuple[str, float, str]] = []

    def add(name: str, value: float, wanted: str) -> None:
        rows.append((name, value, wanted))
        print(f"\n{name}: {value:.3g} (wanted: {wanted})")

    yield add
    if request.config.getoption("--docs"):
        DOCS.write_text(_page(rows), encoding="utf-8")


def in_turn(*functions: Callable[[], object], runs: int = 9) -> list[float]:
    """Return the median times of functions run in turn, [s], after a warm-up of each."""
    times: list[list[float]] = [[] for _ in functions]
    for run in range(runs + 1):
        for function, own in zip(functions, times, strict=True):
            begin = perf_counter()
            function()
            if run:
                own.append(perf_counter() - begin)
    return [float(np.median(own)) for own in times]


def _page(rows: list[tuple[str, float, str]]) -> str:
    packages = ", ".join(f"{name} {version(name)}" for name in ("pin", "numpy", "scipy"))
    lines = [
        "# Benchmarks",
        "",
        "By `python -m pytest benchmarks/bench_*.py -n 0 --docs`: ratios of medians in one run, on",
        "the bundled 3-RRR and 6-UPS. What is wanted are aims.",
        f"Python {platform.python_version()}, {packages}, {os.cpu_count()} cores, "
        f"{platform.machine()}.",
        "",
        *(f"- {name}: {value:.3g}{aim and f' (wanted {aim})'}" for name, value, aim in rows),
        "",
    ]
    return "\n".join(lines)
