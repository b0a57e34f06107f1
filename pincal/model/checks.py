"""Checks of user input, called where objects are made, and descriptions of values in messages."""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache
from numbers import Integral, Real
from os import PathLike
from pathlib import Path
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np

from pincal.errors import PincalError
from pincal.types import Array, Point, Quantity

LARGEST = 1e12
"""Largest number of a mechanism, [m] or [rad]: larger ones are slips, their squares overflow."""
ROUNDING = 1e-12
"""Bound of rounding errors, relative to the numbers that went in, and of angles in [rad]."""
EXACT = 1e-9
"""Tolerance within which two lengths, relative to the size, or two unit vectors are equal."""
ALIKE = 1e-6
"""Tolerance, relative to the size, within which two places are the same although a file in between
cut their digits."""

ROWS = 30
"""Largest number of rows that a printed table or list shows; the rest are only counted."""
_WIDTH = 118  # of a line


def described(value: object) -> str:
    """Return an object's type, with its shape or a short value, for a message."""
    value = value.item() if isinstance(value, np.generic) else value
    if isinstance(value, np.ndarray):
        return f"an array of shape {value.shape} and type {value.dtype}"
    if value is None or isinstance(value, bool | int | float | str | tuple | list | dict):
        text = repr(value)
        return text if len(text) <= 60 else f"{text[:57]}…"
    return f"a {type(value).__name__}"


def one_line(kind: str, *parts: str) -> str:
    """Return ``Kind(part, part)`` on one line, without empty parts, cut where it is too long."""
    text = f"{kind}({', '.join(part for part in parts if part)})"
    return text if len(text) <= _WIDTH else f"{text[: _WIDTH - 2]}…)"


def triple(values: Iterable[float]) -> str:
    """Return numbers in parentheses, with four significant digits."""
    return f"({', '.join(f'{value:.4g}' for value in values)})"


def counted(count: int, singular: str) -> str:
    """Return a count with its noun: ``1 row``, ``2 rows``."""
    return f"{count} {singular}" + "s" * (count != 1)


def listed(names: Iterable[str], limit: int = 6) -> str:
    """Return names joined by commas, those in the middle left out if there are many."""
    names = tuple(names)
    if len(names) > limit:
        names = (*names[: limit - 2], "…", *names[-1:])
    return ", ".join(names) or "none"


def array_of(
    values: Any, shape: tuple[int | str, ...], name: str, error_type: type[PincalError]
) -> Array:
    """Return values as an array of float64, always a copy, which its owner may change.

    ``shape`` has numbers where the size is known, letters where it is free. Values that are no
    array of numbers of that shape raise an error of the given type, headed by ``name``.
    """
    expected = "(" + ", ".join(map(str, shape)) + (",)" if len(shape) == 1 else ")")
    try:
        array = np.asarray(values)
        if array.dtype.kind not in "fiub":
            raise ValueError
        array = array.astype(np.float64)
    except (TypeError, ValueError) as fault:
        raise error_type(
            f"{name}: expected numbers, an array of shape {expected}; got {described(values)}"
        ) from fault
    if array.ndim != len(shape) or any(
        isinstance(size, int) and size != given_size
        for size, given_size in zip(shape, array.shape, strict=True)
    ):
        raise error_type(f"{name}: expected shape {expected}; got shape {array.shape}")
    return array


def names_of(values: Any, count: int, label: str, error_type: type[PincalError]) -> tuple[str, ...]:
    """Return ``count`` names as a tuple; raise an error of the given type for anything else."""
    if isinstance(values, str) or not isinstance(values, Iterable):
        raise error_type(f"{label}: expected {count} names, one a row; got {described(values)}")
    names = tuple(values)
    if wrong := [name for name in names if not isinstance(name, str)]:
        raise error_type(f"{label}: expected names; got {described(wrong[0])} among them")
    if len(names) != count:
        raise error_type(f"{label}: expected {count} names, one a row; got {len(names)}")
    return names


def number_of(value: Any, name: str, error_type: type[PincalError]) -> float:
    """Return a number as float or Quantity; raise an error of the given type for others."""
    if isinstance(value, Quantity):
        return value
    if isinstance(value, bool) or not isinstance(value, Real):
        raise error_type(f"{name}: expected a number; got {described(value)}")
    return float(value)


def finite_rows(rows: Array, noun: str, error_type: type[PincalError]) -> Array:
    """Return rows (N, k); raise an error of the given type if a number is not finite or too large.

    Squares of numbers beyond ``LARGEST`` overflow.
    """
    usable = np.abs(rows) <= LARGEST
    if not usable.all():
        row = int(np.argmin(usable.all(axis=1)))
        raise error_type(f"{noun} {row + 1} has a number that is not finite, or above {LARGEST:g}")
    return rows


def choice_of(value: Any, choices: Iterable[str], name: str, error_type: type[PincalError]) -> Any:
    """Return a value that is one of some texts; raise an error of the given type for others."""
    if not isinstance(value, str) or value not in choices:
        raise error_type(
            f"unknown {name}: {described(value)}; expected one of {', '.join(choices)}"
        )
    return value


def count_of(
    value: Any, name: str, error_type: type[PincalError], least: int = 0, most: int = 10**6
) -> int:
    """Return a whole number from ``least`` to ``most``; or raise an error of the given type."""
    if isinstance(value, bool) or not isinstance(value, Integral):
        raise error_type(f"{name}: expected a whole number; got {described(value)}")
    if not least <= int(value) <= most:
        raise error_type(f"{name} is {described(value)}; expected {least} to {most:,}")
    return int(value)


def generator_of(seed: Any, error_type: type[PincalError]) -> np.random.Generator:
    """Return the random generator of a seed; a generator is returned as it is."""
    try:
        return np.random.default_rng(seed)
    except (TypeError, ValueError) as fault:
        raise error_type(
            f"seed: expected a whole number of 0 or more, or a generator; got {described(seed)}"
        ) from fault


def must_be(
    value: Any, kind: Any, name: str, error_type: type[PincalError], expected: str = ""
) -> Any:
    """Return the value if it is of a type, or one of types; or raise an error of the given type.

    The message says what was ``expected``, by default the names of the types.
    """
    if not isinstance(value, kind):
        special = {type(None): "None", np.ndarray: "an array", Callable: "a function"}
        kinds = kind if isinstance(kind, tuple) else (kind,)
        words = {k: f"a{'n' * (k.__name__[0] in 'AEIOU')} {k.__name__}" for k in kinds} | special
        expected = expected or " or ".join(words[k] for k in kinds)
        raise error_type(f"{name}: expected {expected}; got {described(value)}")
    return value


def check_kinds(values: Mapping[str, Any], owner: Any, error_type: type[PincalError]) -> None:
    """Raise an error of the given type unless values are as a class or function annotates them."""
    for name, kind in _hints(owner).items():
        if name in values and not _is_of(values[name], kind):
            expected = re.sub(r"(\w+\.)+(?=\w)|<class '|'>", "", str(kind))  # no names of modules
            label = f"{name} of {owner.__name__}: expected {expected}"
            raise error_type(f"{label}; got {described(values[name])}")


_hints = cache(get_type_hints)
_KINDS: dict[Any, Any] = {float: Real, int: Integral, Path: PathLike, Any: object}


def _is_of(value: Any, kind: Any) -> bool:
    """Return whether a value is of an annotated kind; lists and other series count as tuples."""
    origin, inner = get_origin(kind), get_args(kind)
    value = value.item() if isinstance(value, np.generic | np.ndarray) and not value.ndim else value
    if origin is Literal:
        return isinstance(value, str | Real) and value in inner
    if origin in (Union, type(int | str)):
        return any(_is_of(value, each) for each in inner)
    if origin is Mapping and isinstance(value, Mapping):
        return all(all(map(_is_of, pair, inner)) for pair in value.items())
    if origin not in (tuple, Sequence):
        return origin is np.ndarray or isinstance(value, _KINDS.get(origin or kind, origin or kind))
    return _are_of(value, inner, origin is Sequence or inner[-1] is Ellipsis)


def _are_of(values: Any, kinds: tuple[Any, ...], alike: bool) -> bool:
    """Return whether a series is of annotated kinds, the first for all if they are alike."""
    if not isinstance(values, tuple | list | np.ndarray):
        return isinstance(values, Iterable) and not isinstance(values, str | bytes | Mapping)
    kinds = kinds[:1] * len(values) if alike else kinds
    return len(kinds) == len(values) and all(map(_is_of, values, kinds))


def wrapped(angles: Array) -> Array:
    """Return angles wrapped to [-pi, pi), up to rounding at its ends, [rad]."""
    turn = 2 * np.pi
    with np.errstate(invalid="ignore"):
        return np.asarray(angles - turn * np.floor((angles + np.pi) / turn))  # no slow remainder


def check_sizes(
    owner: object, names: Iterable[str], label: str, error_type: type[PincalError]
) -> None:
    """Convert fields of an object to numbers; raise an error unless each is finite and >= 0."""
    for name in names:
        value = number_of(getattr(owner, name), f"the {label} {name}", error_type)
        object.__setattr__(owner, name, value)
        if not 0.0 <= value < np.inf:
            raise error_type(f"the {label} {name} is {value:g}; expected 0 or more")


def set_point(owner: object, name: str, label: str, error_type: type[PincalError]) -> None:
    """Convert a field of an object to three floats; or raise an error of the given type."""
    point = array_of(getattr(owner, name), (3,), label, error_type)
    object.__setattr__(owner, name, tuple(point.tolist()))


def named_points(values: Any, label: str, error_type: type[PincalError]) -> dict[str, Point | None]:
    """Return points by name, None for an unknown point; or raise an error of the given type."""
    points = dict(must_be(values, Mapping, f"points of {label}", error_type))
    if not points:
        raise error_type(f"{label}: no points; name those that it has")
    for name, point in points.items():
        context = f"point {must_be(name, str, 'the name of a point', error_type)!r} of {label}"
        if point is not None:
            points[name] = tuple(array_of(point, (3,), context, error_type).tolist())
    return points
