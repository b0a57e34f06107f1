"""Errors that pincal raises on purpose: one root, each also the natural built-in.

``docs/errors.md`` says of each what causes it and what to do.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager

_LONG_VALUE = re.compile(r"(?<!\w)(['\"])(?:(?!\1).){200,}\1|\S{300,}", re.DOTALL)


class PincalError(Exception):
    """Root of every error raised on purpose; its text says what, where, expected, what to do."""

    def __init__(self, message: str = "") -> None:
        """Take a message, long values in it cut out."""
        super().__init__(_LONG_VALUE.sub(lambda x: f"{x[0][:100]}…{x[0][-20:]}", message))


class MechanismError(PincalError, ValueError):
    """A mechanism, leg, URDF or mechanism.yaml that cannot be used."""


class MeasurementError(PincalError, ValueError):
    """A table of poses, readings or measurements that cannot be used."""


class MisfitError(MeasurementError):
    """Measurements that no mechanism like the nominal one can have made."""


class ObservabilityError(PincalError, ValueError):
    """Poses that leave a parameter, or a combination of parameters, undetermined."""


class WorkspaceError(PincalError, ValueError):
    """A workspace that is empty or cannot be sampled as asked."""


class SymmetryError(PincalError, ValueError):
    """A symmetry that the mechanism does not have."""


class FileError(PincalError, OSError):
    """A file or folder that cannot be read, or must not be overwritten."""


@contextmanager
def explaining(failure: str, *kinds: type[Exception]) -> Iterator[None]:
    """Say, by a FileError, what an error of the system meant, or one of further kinds."""
    try:
        yield
    except Exception as error:
        if isinstance(error, PincalError) or not isinstance(error, (OSError, *kinds)):
            raise
        raise FileError(f"{failure}: {getattr(error, 'strerror', None) or error}") from error


@contextmanager
def located(place: object, error_type: type[PincalError], within: object = None) -> Iterator[None]:
    """Put a place in front of errors of a kind, unless they name it, or what it is within."""
    try:
        yield
    except error_type as error:
        text = str(error)
        if str(within or place) in text:
            raise
        raise error_type(f"{place}{'' if text.startswith(',') else ': '}{text}") from error
