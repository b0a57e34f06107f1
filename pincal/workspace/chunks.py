"""Chunks of work run in this process, on all cores, or on a Dask cluster: each once.

Results are kept by the number of their chunk. A chunk that a dying worker takes with it
is run again by another one, and counts once however often it was run.
"""

from __future__ import annotations

import itertools
import socket
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, TypeAlias
from urllib.parse import urlsplit

import numpy as np

from pincal.errors import WorkspaceError
from pincal.model.checks import described

Chunk: TypeAlias = tuple[int, int]
Task: TypeAlias = Callable[[int, int], bytes]


@dataclass(frozen=True)
class Cluster:
    """How a cluster is waited for."""

    wait: float = 5.0
    """For a scheduler to answer, [s]."""
    patience: float = 10.0
    """Until workers are looked for, [s]."""
    ahead: int = 4
    """Chunks handed to each core at a time."""


_CLUSTER = Cluster()


def check_jobs(jobs: object) -> None:
    """Raise if something is no number of processes.

    Raises:
        WorkspaceError: it is not.
    """
    if not isinstance(jobs, int | np.integer) or jobs == 0 or jobs < -1:
        raise WorkspaceError(f"{described(jobs)} jobs; expected at least 1, or -1 for one a core")


def run(
    task: Task, chunks: list[Chunk], jobs: int = 1, scheduler: str | None = None
) -> Iterator[tuple[Chunk, bytes]]:
    """Yield each chunk with its result, in the order in which they are done.

    Args:
        task: Called with the ends of a chunk; can be pickled.
        chunks: First number and the one after the last, for each chunk.
        jobs: Processes on this machine; -1 for one a core.
        scheduler: Address of a Dask scheduler, such as ``tcp://host:8786``, to run there.

    Raises:
        WorkspaceError: a wrong number of jobs, the scheduler cannot be reached, has no
            workers, or a chunk fails there.
    """
    check_jobs(jobs)
    if scheduler is not None:
        yield from _on_cluster(task, chunks, scheduler)
    elif jobs == 1 or len(chunks) == 1:
        for chunk in chunks:
            yield chunk, task(*chunk)
    else:
        import joblib  # slow to import, and needed here only

        parallel = joblib.Parallel(n_jobs=jobs, return_as="generator_unordered")
        yield from parallel(joblib.delayed(_numbered)(task, chunk) for chunk in chunks)


def _numbered(task: Task, chunk: Chunk) -> tuple[Chunk, bytes]:
    return chunk, task(*chunk)


def _on_cluster(task: Task, chunks: list[Chunk], scheduler: str) -> Iterator[tuple[Chunk, bytes]]:
    try:
        import distributed
    except ImportError as error:
        raise WorkspaceError(
            "a Dask cluster needs the package distributed: python -m pip install 'pincal[cluster]'"
        ) from error
    _reach(scheduler)
    try:
        client: Any = distributed.Client(  # type: ignore[no-untyped-call]
            scheduler, timeout=_CLUSTER.wait
        )
    except (OSError, ValueError, TypeError, TimeoutError) as error:
        raise WorkspaceError(f"no Dask scheduler answers at {scheduler}: {error}") from error
    with client:
        cores = sum(client.nthreads().values())
        if not cores:
            raise WorkspaceError(
                f"the Dask scheduler at {scheduler} has no workers; start some with 'dask worker "
                f"{scheduler} --nthreads 1 --nworkers 2'"
            )
        yield from _collect(client, distributed.wait, task, chunks, _CLUSTER.ahead * cores)


def _reach(scheduler: str) -> None:
    """Raise if nothing listens at an address: a client that waits in vain is slow to give up."""
    try:
        parts = urlsplit(scheduler if "://" in scheduler else f"tcp://{scheduler}")
        if not parts.hostname or not parts.port:
            raise ValueError("not an address")
        socket.create_connection((parts.hostname, parts.port), _CLUSTER.wait).close()
    except (OSError, ValueError) as error:
        raise WorkspaceError(
            f"no Dask scheduler answers at {scheduler}: {error}. Start one with 'dask scheduler' "
            "and give its address, such as tcp://host:8786"
        ) from error


def _collect(
    client: Any, wait: Any, task: Task, chunks: list[Chunk], ahead: int
) -> Iterator[tuple[Chunk, bytes]]:
    """Yield results as they come, with so many chunks handed out at a time.

    Raises:
        WorkspaceError: a chunk fails, or all workers are gone.
    """
    waiting = iter(chunks)
    pending: set[Any] = set()
    while True:
        more = itertools.islice(waiting, ahead - len(pending))
        pending |= {client.submit(_numbered, task, chunk, pure=False) for chunk in more}
        if not pending:
            return
        try:
            done = wait(pending, timeout=_CLUSTER.patience, return_when="FIRST_COMPLETED").done
        except TimeoutError:
            if not client.nthreads():
                raise WorkspaceError("all workers of the Dask cluster are gone") from None
            continue
        for future in done:
            try:
                result = future.result()
            except Exception as error:  # whatever a worker raised
                raise WorkspaceError(
                    f"a chunk of work failed on the cluster: {type(error).__name__}: {error}. "
                    "Workers need the same version of pincal, and memory enough"
                ) from error
            yield result
        pending -= done
