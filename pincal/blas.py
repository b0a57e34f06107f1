"""Limit of BLAS to one thread while pincal computes: with small matrices, threads only wait.

A fit of 144 rows takes four times as long with two threads of OpenBLAS as with one. The number of
threads is restored when the last concurrent call ends. The limit holds for the process: other
threads see it meanwhile, and limits that they set meanwhile are lost.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from threading import Lock
from typing import Any

from threadpoolctl import ThreadpoolController

_lock = Lock()
_within: list[Any] = []  # an entry for each running call; the first holds the former limits


@cache
def _controller() -> ThreadpoolController:
    import scipy.linalg  # noqa: F401  loads its own BLAS, which the controller must find

    return ThreadpoolController()


@contextmanager
def one_thread() -> Iterator[None]:
    """Limit BLAS to one thread, as context manager or decorator; the last call restores it."""
    with _lock:
        _within.append(None if _within else _controller().limit(limits=1, user_api="blas"))
    try:
        yield
    finally:
        with _lock:
            first = _within.pop()
            if first is not None:
                first.restore_original_limits()
