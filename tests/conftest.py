"""Fixtures: bundled mechanisms, and what it costs to make only once."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # the processes of pytest-xdist have the cores

import numpy as np
import pytest
from numpy.typing import NDArray

import pincal
from pincal.workspace import sampling
from pincal.workspace.component import HomeComponent

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # in the background of a shell
    signal.signal(signal.SIGINT, signal.default_int_handler)  # commands are to be interrupted

Array = NDArray[np.float64]
Explore = Callable[..., tuple[Array, Array, HomeComponent]]
KINDS = ["3RRR", "5R"]
#: Tests among the longest, seconds each, whose property a quicker one guards too.
SLOW = (Path(__file__).parent / "slow.txt").read_text(encoding="utf-8").splitlines()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the tests of ``slow.txt`` as slow."""
    for item in items:
        if item.nodeid in SLOW:
            item.add_marker(pytest.mark.slow)


@pytest.fixture(scope="session", autouse=True)
def explored() -> Iterator[Explore]:
    """Explore a workspace once: again, with the generator in the same state, it is the same.

    Tests of exploring itself take it from here.
    """
    explore, found = sampling._explore, {}

    def remembered(
        mechanism: pincal.Mechanism, rng: np.random.Generator, least: pincal.Margins | None
    ) -> tuple[Array, Array, HomeComponent]:
        key = mechanism, least, str(rng.bit_generator.state)
        if key not in found:
            found[key] = explore(mechanism, rng, least), rng.bit_generator.state
        answer, rng.bit_generator.state = found[key]
        return answer

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sampling, "_explore", remembered)
        yield explore


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
    return {
        name: pincal.sample_workspace(pincal.load_mechanism(name), 30_000, seed=0) for name in KINDS
    }


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
