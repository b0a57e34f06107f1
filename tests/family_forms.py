"""Closed forms of the families' legs in plain NumPy: the reference for their kinematics.

A form gives all joints of a leg at N platform points and orientations in one of its working
modes, from its parameters and from the element that carries leg 1 to it. Nothing here uses
pincal's kinematics.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from math import acos, pi, radians, sqrt

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import pincal

Array = NDArray[np.float64]
Form = Callable[[dict[str, float], Array, Array, Array, int], Array]


def turn(axis: str, angle: float) -> Array:
    """Return a rotation about x, y or z, shape (3, 3)."""
    return Rotation.from_euler(axis, angle).as_matrix()


def on_sphere(radius: float, polar_angle: float, azimuth: float) -> Array:
    """Return a point by its radius, angle from z and azimuth, shape (3,)."""
    s = np.sin(polar_angle)
    return radius * np.array([s * np.cos(azimuth), s * np.sin(azimuth), np.cos(polar_angle)])


def crank(l: float, L: float, g: Array, mode: int) -> Array:  # noqa: E741
    """Return a crank's angle about y, from x, whose rod of length L ends at g, shape (N, 3).

    E cos q + F sin q + G = 0 by the tangent of the half angle, as for the Delta robot.
    """
    E, F = -2 * l * g[:, 0], 2 * l * g[:, 2]
    G = (g**2).sum(axis=1) + l**2 - L**2
    with np.errstate(invalid="ignore"):
        return 2 * np.arctan((-F + mode * np.sqrt(E**2 + F**2 - G**2)) / (G - E))


def carriage(L: float, g: Array, mode: int) -> Array:
    """Return a carriage's way along x whose rod of length L ends at g, shape (N, 3)."""
    with np.errstate(invalid="ignore"):
        return g[:, 0] - mode * np.sqrt(L**2 - g[:, 1] ** 2 - g[:, 2] ** 2)


def universal_yz(w: Array) -> Array:
    """Return angles about y, then z, that turn x to unit vectors (N, 3), shape (N, 2)."""
    return np.stack((np.arctan2(-w[:, 2], w[:, 0]), np.arcsin(np.clip(w[:, 1], -1, 1))), axis=1)


def strut_form(p: dict[str, float], Q: Array, r: Array, R: Array, mode: int) -> Array:
    """3RPR: direction and length of the strut."""
    w = r + R @ on_sphere(p["ob"], pi / 2, p["beta_b"]) - on_sphere(p["OA"], pi / 2, p["beta"])
    swing = np.arctan2(w[:, 1], w[:, 0])
    return np.stack((swing, np.hypot(w[:, 0], w[:, 1])), axis=1)


def rail_form(p: dict[str, float], Q: Array, r: Array, R: Array, mode: int) -> Array:
    """3PRR: way of the carriage along its side of the triangle, direction of the rod."""
    w = r + R @ on_sphere(p["ob"], pi / 2, p["beta_b"]) - on_sphere(p["OA"], pi / 2, p["beta"])
    g = w @ Q @ turn("z", p["delta"])
    q = carriage(p["L"], g, mode)
    return np.stack((q, np.arctan2(g[:, 1], g[:, 0] - q)), axis=1)


def crank_form(frame: Array) -> Form:
    """Return the form of delta and 6RUS: crank about y in a frame, universal joint y-z."""

    def form(p: dict[str, float], Q: Array, r: Array, R: Array, mode: int) -> Array:
        if "ob" in p:
            A = on_sphere(p["OA"], p["alpha"], p["beta"])
            b = on_sphere(p["ob"], p["alpha_b"], p["beta_b"])
        else:
            A = np.add(on_sphere(p["OA"], pi / 2, p["beta"]), (0.0, 0.0, p["h"]))
            b = Q @ (0.06, 0.0, 0.0)
        g = (r + R @ b - A) @ local(Q, frame) @ turn("z", p["yaw"]) @ turn("x", p["roll"])
        q = crank(p["l"], p["L"], g, mode)
        c, s = np.cos(q), np.sin(q)
        w = np.stack((c * g[:, 0] - s * g[:, 2] - p["l"], g[:, 1], s * g[:, 0] + c * g[:, 2]))
        return np.column_stack((q, universal_yz(w.T / p["L"])))

    return form


def local(Q: Array, frame: Array) -> Array:
    """Return leg 1's frame carried by an element; under a reflection y turns over."""
    return Q @ frame @ np.diag([1.0, np.linalg.det(Q), 1.0])


DIAGONAL = acos(1 / sqrt(3))
INWARD = np.array([  # columns: to the centre, level, across
    [-sqrt(2 / 3), 0.0, 1 / sqrt(3)], [0.0, 1.0, 0.0], [-1 / sqrt(3), 0.0, -sqrt(2 / 3)],
])  # fmt: skip


def orthoglide_form(p: dict[str, float], Q: Array, r: Array, R: Array, mode: int) -> Array:
    """3PUU: way of the carriage, universal joint y-z."""
    b = Q @ on_sphere(0.05, DIAGONAL, 0.0)
    rail = local(Q, INWARD) @ turn("z", p["yaw"]) @ turn("y", p["pitch"])
    g = (r + b - on_sphere(p["OA"], p["alpha"], p["beta"])) @ rail
    q = carriage(p["L"], g, mode)
    with np.errstate(invalid="ignore"):
        w = np.column_stack((g[:, 0] - q, g[:, 1:])) / p["L"]
    return np.column_stack((q, universal_yz(w)))


def wrist_form(p: dict[str, float], Q: Array, r: Array, R: Array, mode: int) -> Array:
    """6PUS: height of the carriage, universal joint x-y."""
    rail = local(Q, np.eye(3)) @ turn("y", p["pitch"]) @ turn("x", p["roll"])
    b = on_sphere(p["ob"], p["alpha_b"], p["beta_b"])
    x, y, z = ((r + R @ b - on_sphere(p["OA"], p["alpha"], p["beta"])) @ rail).T
    with np.errstate(invalid="ignore"):
        up = mode * np.sqrt(p["L"] ** 2 - x**2 - y**2)
    return np.stack((z - up, np.arctan2(-y, up), np.arcsin(np.clip(x / p["L"], -1, 1))), axis=1)


@dataclass(frozen=True)
class Family:
    """A family with its closed form."""

    name: str
    form: Form
    modes: tuple[int, ...] = (1, -1)
    """Of which the first is that of the bundled mechanism."""


FAMILIES = (
    Family("3RPR", strut_form, (1,)),
    Family("3PRR", rail_form),
    Family("delta", crank_form(np.eye(3))),
    Family("6RUS", crank_form(turn("z", radians(10) + pi / 2))),
    Family("3PUU", orthoglide_form),
    Family("6PUS", wrist_form),
)


def joints(
    family: Family, mechanism: pincal.Mechanism, group: list[Array], poses: Array, mode: int
) -> list[Array]:
    """Return the joints of each leg at poses, shape (N, n_joints); NaN out of reach.

    Args:
        family: The family.
        mechanism: With its own parameters for each leg.
        group: For each leg, the matrix of the element that carries leg 1 to it.
        poses: Shape (N, dof).
        mode: Working mode of all legs.
    """
    T = mechanism.platform.transforms(poses).as_matrix()
    return [
        family.form(leg.nominal_by_name, Q, T[:, :3, 3], T[:, :3, :3], mode)
        for leg, Q in zip(mechanism.legs, group, strict=True)
    ]


@cache
def nominal(name: str) -> pincal.Mechanism:
    """Return a bundled mechanism."""
    return pincal.load_mechanism(name)


def random_geometry(
    family: Family, group: list[Array], rng: np.random.Generator, mode: int
) -> pincal.Mechanism:
    """Return the family with random parameters, each leg its own, at home in a working mode."""
    mechanism = nominal(family.name)
    home = np.array([mechanism.platform.home])
    while True:
        values = {
            leg.name: [v + rng.uniform(-0.1, 0.1) * (abs(v) or 1.0) for v in leg.nominal]
            for leg in mechanism.legs
        }
        found = mechanism.with_parameters(values)
        positions = joints(family, found, group, home, mode)
        if all(np.isfinite(q).all() for q in positions):
            legs = [leg.with_home(q[0]) for leg, q in zip(found.legs, positions, strict=True)]
            return replace(found, legs=tuple(legs))


def poses_around_home(
    mechanism: pincal.Mechanism, rng: np.random.Generator, count: int, size: float = 0.15
) -> Array:
    """Return random poses around home: positions within ``size`` [m], turns within 0.3 rad."""
    spread = np.array([size if unit == "m" else 0.3 for unit in mechanism.platform.units])
    twists = rng.uniform(-spread, spread, (count, len(spread)))
    return mechanism.platform.moved(np.tile(mechanism.platform.home, (count, 1)), twists)
