"""Chunks of work: each counts once, whatever happens to the workers."""

from __future__ import annotations

import os
import signal
import socket
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from marks import some_slow

import pincal
from pincal.workspace.chunks import run

CHUNKS = [(i, i + 10) for i in range(0, 400, 10)]


@dataclass(frozen=True)
class Slow:
    """A task that takes long enough to be interrupted."""

    seconds: float = 0.0

    def __call__(self, begin: int, end: int) -> bytes:
        """Return the numbers of the chunk."""
        time.sleep(self.seconds)
        return np.arange(begin, end).tobytes()


@dataclass(frozen=True)
class Failing:
    """A task that fails in the middle."""

    def __call__(self, begin: int, end: int) -> bytes:
        """Raise in one chunk."""
        if begin <= 200 < end:
            raise ZeroDivisionError("on purpose")
        return b""


def complete(results: list[tuple[tuple[int, int], bytes]]) -> bool:
    """Return whether every chunk came once, with its own result."""
    once = Counter(chunk for chunk, _ in results) == Counter(CHUNKS)
    return once and all(
        np.array_equal(np.frombuffer(found, dtype=np.int64), np.arange(*chunk))
        for chunk, found in results
    )


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    """A cluster of two worker processes on this machine."""
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=":0"
    ) as local:
        yield local


@pytest.mark.parametrize("jobs", some_slow([1, 2, -1], 2))
def test_every_chunk_counts_once(jobs: int) -> None:
    """In this process and in several."""
    assert complete(list(run(Slow(), CHUNKS, jobs)))


@pytest.mark.slow
def test_every_chunk_counts_once_on_a_cluster(cluster: Any) -> None:
    """On two workers."""
    assert complete(list(run(Slow(), CHUNKS, scheduler=cluster.scheduler_address)))


@pytest.mark.slow
def test_a_killed_worker_loses_and_doubles_nothing(cluster: Any) -> None:
    """What a worker held when it was killed is run again, and counts once."""
    results = []
    for found in run(Slow(0.05), CHUNKS, scheduler=cluster.scheduler_address):
        results.append(found)
        if len(results) == 5:
            os.kill(next(iter(cluster.workers.values())).pid, signal.SIGKILL)
    assert complete(results)


@pytest.mark.slow
def test_a_workspace_on_a_cluster_is_the_same(
    cluster: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With a worker killed on the way, to the last position."""
    monkeypatch.setattr("pincal.workspace.region._CHUNK", 1 << 13)
    mechanism = pincal.load_mechanism("6UPS")
    grid = pincal.Grid.of("radius=0.1:1.5:0.1", "bearing [deg]=0:360:10", "z=1.6:2.2:0.2")
    turns = pincal.Orientations.of(mechanism.platform, "tilt=0:0.3:0.15", "torsion=-0.2,0,0.2")
    arguments = (mechanism, "total-orientation", grid, turns)
    here = pincal.compute_workspace(*arguments)
    killed: list[int] = []

    def kill_one(done: int) -> None:
        if not killed:
            killed.append(next(iter(cluster.workers.values())).pid)
            os.kill(killed[0], signal.SIGKILL)

    address = cluster.scheduler_address
    there = pincal.compute_workspace(*arguments, scheduler=address, progress=kill_one)
    assert killed
    assert 0 < here.count < grid.size
    np.testing.assert_array_equal(there.inside, here.inside)


@pytest.mark.slow
def test_a_task_that_fails_says_so(cluster: Any) -> None:
    """With the error of the worker, and what may be the cause."""
    with pytest.raises(pincal.WorkspaceError, match="ZeroDivisionError: on purpose"):
        list(run(Failing(), CHUNKS, scheduler=cluster.scheduler_address))
    with pytest.raises(ZeroDivisionError):
        list(run(Failing(), CHUNKS, jobs=2))


def test_a_scheduler_that_is_not_there_is_named() -> None:
    """At once, with what to do."""
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]  # bound, but nobody listens
        for address in (f"tcp://127.0.0.1:{port}", "tcp://no.such.host.invalid:8786", "nowhere"):
            with pytest.raises(pincal.WorkspaceError, match="dask scheduler") as error:
                list(run(Slow(), CHUNKS, scheduler=address))
            assert address in str(error.value)


@pytest.mark.parametrize("jobs", [0, -2])
def test_wrong_numbers_of_jobs_are_refused(jobs: int) -> None:
    """At least one, or one a core."""
    with pytest.raises(pincal.WorkspaceError, match="expected at least 1"):
        list(run(Slow(), CHUNKS, jobs))


@pytest.mark.slow
def test_a_cluster_without_workers_is_refused() -> None:
    """No waiting for ever."""
    distributed = pytest.importorskip("distributed")
    with (
        distributed.LocalCluster(
            n_workers=0, processes=True, threads_per_worker=1, dashboard_address=":0"
        ) as empty,
        pytest.raises(pincal.WorkspaceError, match="has no workers"),
    ):
        list(run(Slow(), CHUNKS, scheduler=empty.scheduler_address))
