"""Chunks of work run in this process, on all cores, or on a Dask cluster: each once.

Results are kept by the number of their chunk. A chunk that a dying worker takes with it
is run again by another one, and counts once however often it was run.
"""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterator
from typing import TypeAlias
from urllib.parse import urlsplit

import numpy as np

from pincal.errors import WorkspaceError
from pincal.model.checks import described

Chunk: TypeAlias = tuple[int, int]
Task: TypeAlias = Callable[[int, int], bytes]
_WAIT = 5.0  # for a scheduler to answer, [s]


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
    try:
        parts = urlsplit(scheduler if "://" in scheduler else f"tcp://{scheduler}")
        if not parts.hostname or not parts.port:
            raise ValueError("not an address")
        # a client that waits in vain is slow to give up
        socket.create_connection((parts.hostname, parts.port), _WAIT).close()
        client = distributed.Client(scheduler, timeout=_WAIT)  # type: ignore[no-untyped-call]
    except (OSError, ValueError, TypeError) as error:
        raise WorkspaceError(
            f"no Dask scheduler answers at {scheduler}: {error}. Start one with 'dask scheduler' "
            "and give its address, such as tcp://host:8786"
        ) from error
    with client:
        if not client.nthreads():  # type: ignore[no-untyped-call]
            raise WorkspaceError(
                f"the Dask scheduler at {scheduler} has no workers; start some with 'dask worker "
                f"{scheduler} --nthreads 1 --nworkers 2'"
            )
        futures = client.map(_numbered, [task] * len(chunks), chunks, pure=False)
        for future in distributed.as_completed(futures):  # type: ignore[no-untyped-call]
            try:
                result = future.result()
            except Exception as error:  # whatever a worker raised
                raise WorkspaceError(
                    f"a chunk of work failed on the cluster: {type(error).__name__}: {error}. "
                    "Workers need the same version of pincal, and memory enough"
                ) from error
            yield result
