"""Marks of single cases: those that take seconds, and whose property a quicker case guards too."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest


def some_slow(cases: Iterable[Any], *slow: Any) -> list[Any]:
    """Return the cases of a parametrization, those named marked as slow; a tuple is several values.

    Raises:
        ValueError: a case to be marked is none of them.
    """
    cases = list(cases)
    if unknown := [one for one in slow if one not in cases]:
        raise ValueError(f"no such cases: {unknown}")
    return [
        pytest.param(*(one if isinstance(one, tuple) else (one,)), marks=pytest.mark.slow)
        if one in slow
        else one
        for one in cases
    ]


def quick(count: int, cases: Iterable[Any]) -> list[Any]:
    """Return the cases of a parametrization, those behind the first ones marked as slow."""
    cases = list(cases)
    return some_slow(cases, *cases[count:])


def slow_or_fuzz(slow: Iterable[Any], fuzz: Iterable[Any]) -> list[Any]:
    """Return the cases of the slow run, then those of ``-m fuzz``; a tuple is several values."""
    marked = [(one, pytest.mark.slow) for one in slow] + [(one, pytest.mark.fuzz) for one in fuzz]
    return [
        pytest.param(*(one if isinstance(one, tuple) else (one,)), marks=mark)
        for one, mark in marked
    ]
