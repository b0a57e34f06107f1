"""One thread of BLAS while pincal computes: its matrices are small, threads wait for each other.

A fit of 144 rows takes four times as long with two threads of OpenBLAS as with one. Whoever calls
pincal has the number of threads that they had when the last call of it ends. The limit is the
process's: other threads see it meanwhile, and limits that they set meanwhile are lost.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from threading import Lock
from typing import Any

from threadpoolctl import ThreadpoolController

_lock = Lock()
_within: list[Any] = []  # an entry for each that is within; the first keeps what was


@cache
def _controller() -> ThreadpoolController:
    import scipy.linalg  # noqa: F401  brings a BLAS of its own, which is to be seen

    return ThreadpoolController()


@contextmanager
def one_thread() -> Iterator[None]:
    """Limit BLAS to one thread, also as decorator; the last that is within gives back what was."""
    with _lock:
        _within.append(None if _within else _controller().limit(limits=1, user_api="blas"))
    try:
        yield
    finally:
        with _lock:
            first = _within.pop()
            if first is not None:
                first.restore_original_limits()
