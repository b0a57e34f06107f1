"""Fixtures: bundled mechanisms, and what it costs to make only once."""

from __future__ import annotations

import os
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # the processes of pytest-xdist have the cores

import numpy as np
import pytest
from numpy.typing import NDArray

import pincal

KINDS = ["3RRR", "5R"]
#: Tests among the longest, seconds each, whose property a quicker one guards too.
SLOW = (Path(__file__).parent / "slow.txt").read_text(encoding="utf-8").splitlines()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the tests of ``slow.txt`` as slow."""
    for item in items:
        if item.nodeid in SLOW:
            item.add_marker(pytest.mark.slow)


@pytest.fixture(params=KINDS)
def kind(request: pytest.FixtureRequest) -> str:
    """Name of a bundled mechanism."""
    return str(request.param)


@pytest.fixture
def mechanism(kind: str) -> pincal.Mechanism:
    """Bundled mechanism."""
    return pincal.load_mechanism(kind)


@pytest.fixture(scope="session")
def candidates() -> dict[str, NDArray[np.float64]]:
    """30,000 workspace poses of each bundled mechanism, default margins."""
    return {
        name: pincal.sample_workspace(pincal.load_mechanism(name), 30_000, seed=0) for name in KINDS
    }


@pytest.fixture(scope="session")
def selections(
    candidates: dict[str, NDArray[np.float64]],
) -> dict[str, pincal.Selection]:
    """Symmetric selection of 24 (3-RRR) and 18 (5R) poses a leg."""
    counts = {"3RRR": 24, "5R": 18}
    return {
        name: pincal.select_poses(pincal.load_mechanism(name), candidates[name], count)
        for name, count in counts.items()
    }
