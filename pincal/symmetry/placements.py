"""Placements on base and platform carried by an isometry, in the coordinates they are drawn in.

A point moves, and its coordinates are those of where it comes to lie. Inside a leg a reflection
turns geometry over by a local mirror.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pincal.errors import SymmetryError
from pincal.model.checks import ROUNDING
from pincal.model.placement import Coordinate, Placement, Value
from pincal.symmetry.elements import Isometry, wrapped

Array = NDArray[np.float64]
LOCAL_MIRROR = np.diag([1.0, -1.0, 1.0])
#: Signs of elementary coordinates under the local mirror.
_SIGNS = {"x": 1, "y": -1, "z": 1, "rx": -1, "ry": 1, "rz": -1}
#: Components of a point that a coordinate gives.
_GIVES = {"x": "x", "y": "y", "z": "z", "polar": "xy", "spherical": "xyz"}


def on_body(
    p: Placement,
    by: Isometry,
    rest: Array,
    kept: bool,
    values: tuple[dict[str, float], dict[str, float]],
    where: str,
) -> Placement:
    """Return a placement on base or platform after the body's isometry.

    Args:
        p: The placement.
        by: The isometry.
        rest: Its constant part, shape (4, 4).
        kept: Whether the frame's orientation is to stay as it is.
        values: Parameters before, and those after, which are set.
        where: What is said where it cannot be expressed.
    """
    old, new = values
    mirrored = np.linalg.det(by.Q) < 0.0
    moved = by.matrix @ p.displacement(old) @ rest
    if mirrored:
        moved[:3, :3] = moved[:3, :3] @ LOCAL_MIRROR
    coordinates = _move_point(p.coordinates, by, old, new, where)
    result = Placement(coordinates)
    whole = np.linalg.inv(result.displacement(new)) @ moved
    if not p.turns:  # exact
        whole[:3, :3] = moved[:3, :3]
    if kept:
        whole[:3, :3] = rest[:3, :3]
    if p.coordinates and not rest[:3, 3].any() and not _all_zero(coordinates, new):
        whole[:3, 3] = 0.0
    return result.at(new, whole)


def _all_zero(coordinates: tuple[Coordinate, ...], values: dict[str, float]) -> bool:
    """Return whether coordinates are corrections: all zero at nominal values."""
    return not any(step.amount(values) for c in coordinates for step in c.steps)


def _move_point(
    coordinates: tuple[Coordinate, ...],
    by: Isometry,
    old: dict[str, float],
    new: dict[str, float],
    where: str,
) -> tuple[Coordinate, ...]:
    """Return the coordinates of a point on base or platform after the body's isometry.

    Constants that come first, before turns or an azimuth, are the frame that the others are in.
    """
    first = _frame_size(coordinates)
    frame = Placement(coordinates[:first]).displacement(old)
    G = np.linalg.inv(frame) @ by.matrix @ frame if first else by.matrix
    vector = np.zeros(3)
    for c in coordinates[first:]:
        if c.turns and not (c.kind == "rz" and c is coordinates[-1]):
            raise SymmetryError(
                f"{where} cannot carry a placement on the base with a rotation ({c.kind}); "
                "give the point by polar, spherical or x, y, z, and a turn about z last, by rz"
            )
        if not c.turns:
            vector += Placement((c,)).displacement(old)[:3, 3]
    size = float(np.abs(vector).max(initial=0.0))
    moved = G[:3, :3] @ vector + (G[:3, 3] if size else 0.0)  # corrections stay zero
    moved[np.abs(moved) <= ROUNDING * (size + np.abs(G[:3, 3]).max())] = 0.0
    if np.abs(G[:2, 2]).max() > 0.0 or np.abs(G[2, :2]).max() > 0.0 or G[:3, 3].any():
        turn = None
    else:  # azimuths follow exactly, also of points on the axis
        turn = (float(np.arctan2(G[1, 0], G[0, 0])), 1.0 if np.linalg.det(G[:2, :2]) > 0 else -1.0)
    result, given = list(coordinates[:first]), set()
    for c in coordinates[first:]:
        before = [old[v] if isinstance(v, str) else v for v in c.values]
        if c.kind in ("x", "y", "z"):
            after = [float(moved["xyz".index(c.kind)])]
            given.add(c.kind)
        elif turn is not None:
            after = [*before[:-1], wrapped(turn[0] + turn[1] * before[-1])]
            if c.kind == "spherical" and G[2, 2] < 0.0:
                after[1] = np.pi - after[1]
            given |= set(_GIVES.get(c.kind, ""))
        elif c.turns:
            raise SymmetryError(f"{where} turns more than the coordinate {c.kind!r} can say")
        else:
            side = np.sign(before[0]) or 1.0
            across = side * moved
            radius = np.linalg.norm(moved[: 3 if c.kind == "spherical" else 2])
            azimuth = float(np.arctan2(across[1], across[0]))
            polar = float(np.arctan2(np.hypot(across[0], across[1]), across[2]))
            after = [float(side * radius), *([polar] if len(before) == 3 else []), azimuth]
            given |= set(_GIVES[c.kind])
        result.append(
            Coordinate(c.kind, tuple(_set(v, a, new) for v, a in zip(c.values, after, strict=True)))
        )
    if coordinates[first:]:
        for letter, component in zip("xyz", moved, strict=True):
            if component != 0.0 and letter not in given:
                raise SymmetryError(f"{where} needs a coordinate {letter!r} there")
    return tuple(result)


def _frame_size(coordinates: tuple[Coordinate, ...]) -> int:
    """Return how many coordinates that come first are a constant frame."""
    named = [any(isinstance(v, str) for v in c.values) for c in coordinates]
    first = named.index(True) if True in named else 0
    after = coordinates[first:]
    turned = any(c.turns for c in coordinates[:first])
    return first if turned or any(c.kind in ("polar", "spherical") for c in after) else 0


def mirror_coordinate(c: Coordinate, old: dict[str, float], new: dict[str, float]) -> Coordinate:
    """Return a coordinate inside the leg after the local mirror."""
    *kept, last = c.values
    if _SIGNS.get(c.kind, -1) > 0:  # polar and spherical: the azimuth turns over
        return c
    value = old[last] if isinstance(last, str) else last
    return Coordinate(c.kind, (*kept, _set(last, -value, new)))


def _set(value: Value, target: float, new: dict[str, float]) -> Value:
    """Return a constant at its target, or a parameter's name after setting its nominal value."""
    target += 0.0  # no negative zero
    if isinstance(value, str):
        new[value] = target
        return value
    return target
