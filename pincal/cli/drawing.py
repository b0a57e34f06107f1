"""The process that draws the report of ``pincal calibrate``, begun before all else is loaded."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from pincal.show.report.beside import Drawer, drawing_beside

_begun: list[Drawer] = []


@contextmanager
def ready_to_draw(typed: Sequence[str]) -> Iterator[None]:
    """Have a process ready inside, if what was typed behind ``pincal`` draws a report."""
    if list(typed[:1]) != ["calibrate"] or {"--no-report", "--help"} & set(typed):
        yield
        return
    with drawing_beside() as found:
        _begun[:] = [found] if found else []
        try:
            yield
        finally:
            _begun.clear()


def drawer() -> Drawer | None:
    """Return the process that is ready to draw a report; None if there is none, or it had one."""
    return _begun.pop() if _begun else None
