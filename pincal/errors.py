"""Errors that pincal raises on purpose: they share a root, and each is also a built-in error.

``docs/errors.md`` gives the causes and remedies of each.
"""

import re
from collections.abc import Iterator
from contextlib import contextmanager

_LONG_VALUE = re.compile(r"(?<!\w)(['\"])(?:(?!\1).){200,}\1|\S{300,}", re.DOTALL)


class PincalError(Exception):
    """Root of all errors raised on purpose; the text says the cause, the place and the remedy."""

    def __init__(self, message: str = "") -> None:
        """Make an error of a message, in which long values are shortened."""
        super().__init__(_LONG_VALUE.sub(lambda x: f"{x[0][:100]}…{x[0][-20:]}", message))


class MechanismError(PincalError, ValueError):
    """A mechanism, leg, URDF or mechanism.yaml that cannot be used."""


class MeasurementError(PincalError, ValueError):
    """A table of poses, readings or measurements that cannot be used."""


class MisfitError(MeasurementError):
    """Measurements that do not fit any mechanism similar to the nominal one."""


class ObservabilityError(PincalError, ValueError):
    """Poses that leave a parameter, or a combination of parameters, undetermined."""


class WorkspaceError(PincalError, ValueError):
    """A workspace that is empty, or cannot be computed or sampled as requested."""


class SymmetryError(PincalError, ValueError):
    """A symmetry that the mechanism does not have."""


class FileError(PincalError, OSError):
    """A file or folder that cannot be read, or must not be overwritten."""


@contextmanager
def explaining(failure: str, *kinds: type[Exception]) -> Iterator[None]:
    """Replace an OSError, or an error of further kinds, by a FileError that explains it."""
    try:
        yield
    except Exception as error:
        if isinstance(error, PincalError) or not isinstance(error, (OSError, *kinds)):
            raise
        raise FileError(f"{failure}: {getattr(error, 'strerror', None) or error}") from error


@contextmanager
def located(place: object, error_type: type[PincalError], within: object = None) -> Iterator[None]:
    """Put a place in front of the text of errors of a type, unless they name it or ``within``."""
    try:
        yield
    except error_type as error:
        text = str(error)
        if str(within or place) in text:
            raise
        raise error_type(f"{place}{'' if text.startswith(',') else ': '}{text}") from error
