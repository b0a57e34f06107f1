"""One thread of BLAS while pincal computes: its matrices are small, threads wait for each other.

A fit of 144 rows takes four times as long with two threads of OpenBLAS as with one. Whoever calls
pincal has the number of threads that they had when the last call of it ends. The limit is the
process's: other threads see it meanwhile, and limits that they set meanwhile are lost.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache, wraps
from threading import Lock
from typing import Any, ParamSpec, TypeVar

from threadpoolctl import ThreadpoolController

P = ParamSpec("P")
R = TypeVar("R")
_lock = Lock()
_within: list[Any] = []  # an entry for each that is within; the first keeps what was


@cache
def _controller() -> ThreadpoolController:
    import scipy.linalg  # noqa: F401  brings a BLAS of its own, which is to be seen

    return ThreadpoolController()


@contextmanager
def one_thread() -> Iterator[None]:
    """Limit BLAS to one thread; the last of several that are within gives back what was."""
    with _lock:
        _within.append(None if _within else _controller().limit(limits=1, user_api="blas"))
    try:
        yield
    finally:
        with _lock:
            first = _within.pop()
            if first is not None:
                first.restore_original_limits()


def _begin_child() -> None:
    """Begin anew in a forked process, whose other threads are gone."""
    global _lock
    _lock = Lock()
    if _within and _within[0] is not None:
        _within[0].restore_original_limits()
    _within.clear()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_begin_child)


def on_one_thread(function: Callable[P, R]) -> Callable[P, R]:
    """Return a function that computes with one thread of BLAS."""

    @wraps(function)
    def run(*args: P.args, **kwargs: P.kwargs) -> R:
        with one_thread():
            return function(*args, **kwargs)

    return run
