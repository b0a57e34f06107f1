"""Fixtures: bundled mechanisms, and what it costs to make only once."""

from __future__ import annotations

import gc
import os
import shutil
import signal
import sys
from collections.abc import Iterator
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # the processes of pytest-xdist have the cores
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # processes that tests start compile nothing again

import numpy as np
import pytest
from measured import workspace
from numpy.typing import NDArray

import pincal

sys.dont_write_bytecode = False
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # in the background of a shell
    signal.signal(signal.SIGINT, signal.default_int_handler)  # commands are to be interrupted

Array = NDArray[np.float64]
KINDS = ["3RRR", "5R"]
LONGEST = {"test_camera", "test_many", "test_motoman", "test_photographed", "test_pulleys"}
LONGEST |= {"test_studies", "test_surplus", "test_trust"}


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the modules that have the longest tests: no core waits for one at the end."""
    items.sort(key=lambda item: item.path.stem not in LONGEST)


def pytest_collection_finish() -> None:
    """Leave what was imported and collected out of garbage collection, and collect less often."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(50_000, 20, 20)


@pytest.fixture(params=KINDS)
def kind(request: pytest.FixtureRequest) -> str:
    """Name of a bundled mechanism."""
    return str(request.param)


@pytest.fixture
def mechanism(kind: str) -> pincal.Mechanism:
    """Bundled mechanism."""
    return pincal.load_mechanism(kind)


@pytest.fixture(scope="session")
def candidates() -> dict[str, Array]:
    """30,000 workspace poses of each bundled mechanism, default margins."""
    return {name: workspace(name, 30_000) for name in KINDS}


@pytest.fixture(scope="session")
def selections(
    candidates: dict[str, Array],
) -> dict[str, pincal.Selection]:
    """Symmetric selection of 24 (3-RRR) and 18 (5R) poses a leg."""
    counts = {"3RRR": 24, "5R": 18}
    return {
        name: pincal.select_poses(pincal.load_mechanism(name), candidates[name], count)
        for name, count in counts.items()
    }


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Chromium, without a window, drawing in software."""
    sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    path = shutil.which("chromium") or shutil.which("chromium-browser")
    if path is None:
        pytest.skip("no chromium on this machine (apt-get install chromium)")
    options = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    options += ["--no-sandbox"] if os.geteuid() == 0 else []
    with sync_api.sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=path, args=options)
        yield chromium
        chromium.close()
