"""All legs closed at poses, alike ones in one call where poses are few; in chunks where many."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pincal.kinematics.batches import Matrices, matrix_chunks, repeated, stacked
from pincal.kinematics.legs.closing import ClosedLegs, close_alike
from pincal.kinematics.legs.closure import LegClosure, nominal_legs
from pincal.model.mechanism import Mechanism

Array = NDArray[np.float64]
_FEW = 8192  # rows of all legs: those of more are quicker leg by leg, near the processor


@dataclass(frozen=True)
class ClosedGroup:
    """Some of all legs, closed in one call."""

    places: list[int]
    """Of the legs, among all."""
    closed: ClosedLegs


def close_legs(
    legs: Sequence[LegClosure],
    matrices: Array,
    influences: Sequence[Array | None] | None = None,
    near: Sequence[Array] | None = None,
) -> list[ClosedGroup]:
    """Return all legs closed at the same poses, alike ones in one call where poses are few.

    Args:
        legs: The legs at their parameter values.
        matrices: Poses ``T_base_platform``, shape (N, 4, 4).
        influences: Of each leg, shape (N, n_influences); at their reference if not given.
        near: Of each leg, positions of its moving joints near those that close it, shape
            (N, n_joints); found in its working mode if not given.
    """
    found = []
    for places in grouped([leg.form for leg in legs], len(matrices)):
        own = [legs[place] for place in places]
        there = repeated(matrices, len(own))
        at = None if influences is None else influences[places[0]]  # what deforms is alone
        start = None if near is None else stacked([near[place] for place in places])
        found.append(ClosedGroup(places, close_alike(own, there, at, start)))
    return found


def grouped(forms: Sequence[object], rows: int) -> list[list[int]]:
    """Return the places of legs that are best evaluated in one call: alike ones, rows being few.

    Args:
        forms: Of the legs: see ``LegClosure.form``.
        rows: Of each leg.
    """
    groups: dict[object, list[int]] = {}
    for place, form in enumerate(forms):
        groups.setdefault(form if len(forms) * rows <= _FEW else place, []).append(place)
    return list(groups.values())


def by_leg(closed: Sequence[ClosedGroup], value: Callable[[ClosedLegs], Any]) -> list[Any]:
    """Return values of all legs in order, shape (N, …) each, from those of each call."""
    return in_order([one.places for one in closed], [value(one.closed) for one in closed])


def in_order(places: Sequence[Sequence[int]], values: Sequence[Any]) -> list[Any]:
    """Return values of all legs in order, shape (N, …) each.

    Args:
        places: Of the legs of each group, among all.
        values: Of each group, shape (L N, …), rows of each leg below those of the one before.
    """
    found: dict[int, Any] = {}
    for group, own in zip(places, values, strict=True):
        found |= zip(group, np.split(own, len(group)), strict=True)
    return [found[place] for place in sorted(found)]


def close_chunks(
    mechanism: Mechanism,
    placed: Matrices,
    influences: Array | None = None,
    near: Mapping[str, Array] | None = None,
) -> Iterator[tuple[slice, list[ClosedGroup]]]:
    """Yield the closed legs of poses in chunks of bounded memory, and their rows.

    Args:
        mechanism: The mechanism, at its nominal parameters.
        placed: N poses, ``PoseMatrices`` or matrices (N, 4, 4).
        influences: Of all legs, shape (N, n_influences); at their reference if not given.
        near: By leg, positions of its moving joints near those that close it, found if not given.
    """
    legs = nominal_legs(mechanism)
    for rows, matrices in matrix_chunks(placed):
        own = start = None
        if influences is not None:
            own = [mechanism.influences_at(i, influences[rows]) for i in range(len(legs))]
        if near is not None:
            start = [near[leg.leg.name][rows] for leg in legs]
        yield rows, close_legs(legs, matrices, own, start)
