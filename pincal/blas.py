"""One thread of BLAS while pincal computes: its matrices are small, threads wait for each other.

A fit of 144 rows takes four times as long with two threads of OpenBLAS as with one. Whoever calls
pincal keeps the number of threads that they have, before and after.
"""

from __future__ import annotations

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


def on_one_thread(function: Callable[P, R]) -> Callable[P, R]:
    """Return a function that computes with one thread of BLAS."""

    @wraps(function)
    def run(*args: P.args, **kwargs: P.kwargs) -> R:
        with one_thread():
            return function(*args, **kwargs)

    return run
