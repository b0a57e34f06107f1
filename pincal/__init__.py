"""Kinematic calibration of parallel robots, on Pinocchio.

Which poses to measure, what the kinematic parameters are, and how sure that is. The names are in
``__init__.pyi``; each is imported when it is first used.
"""

from typing import Any

from lazy_loader import attach_stub

__version__ = "0.2.0"
_named, _names, __all__ = attach_stub(__name__, __file__)


def __getattr__(name: str) -> Any:
    if name in __all__ or name.startswith("__"):
        return _named(name)
    from pincal.old_names import old_name

    return old_name(name)


def __dir__() -> list[str]:
    return sorted({*globals(), *_names()})
