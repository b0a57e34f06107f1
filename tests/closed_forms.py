"""Closed forms of the planar dyad leg in plain NumPy: the reference for everything else.

Nothing here uses pincal's kinematics; mechanisms with random geometry are built from the
same numbers.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from differences import differentiated
from numpy.typing import NDArray

import pincal

Array = NDArray[np.float64]


def base_point(kind: str, p: dict[str, float]) -> complex:
    """Return the base point of a leg as a complex number, [m]."""
    if kind == "5R":
        return complex(p["A_x"], p["A_y"])
    return p["OA"] * np.exp(1j * p["beta"])


def platform_point(kind: str, p: dict[str, float], poses: Array) -> NDArray[np.complex128]:
    """Return the platform point of a leg in the base frame, shape (N,), [m]."""
    r = poses[:, 0] + 1j * poses[:, 1]
    return r if kind == "5R" else r + p["ob"] * np.exp(1j * (poses[:, 2] + p["beta_b"]))


def angles(kind: str, p: dict[str, float], poses: Array, mode: int) -> tuple[Array, Array]:
    """Return shoulder and elbow angles by the cosine law; NaN out of reach.

    The elbow angle's sine has the sign of ``mode``.
    """
    w = platform_point(kind, p, poses) - base_point(kind, p)
    cos = (np.abs(w) ** 2 - p["l"] ** 2 - p["L"] ** 2) / (2 * p["l"] * p["L"])
    with np.errstate(invalid="ignore"):
        elbow = mode * np.arccos(cos)
    return np.angle(w) - np.angle(p["l"] + p["L"] * np.exp(1j * elbow)), elbow


def reading(kind: str, leg: int, p: dict[str, float], shoulder: Array) -> Array:
    """Return sensor readings: 5R paper Eq. 9, 3-RRR paper Eq. 6."""
    if kind == "5R":
        return p["k"] * (shoulder if leg == 0 else np.pi - shoulder) + p["gamma"]
    return (shoulder - p["gamma"]) / p["k"]


def shoulder_of(kind: str, leg: int, p: dict[str, float], psi: Array) -> Array:
    """Return shoulder angles of sensor readings."""
    if kind == "5R":
        turn = (psi - p["gamma"]) / p["k"]
        return turn if leg == 0 else np.pi - turn
    return p["k"] * psi + p["gamma"]


def closure(kind: str, leg: int, p: dict[str, float], poses: Array, psi: Array) -> Array:
    """Return the distance of the platform point from the elbow, less L: (N,), [m]."""
    elbow = base_point(kind, p) + p["l"] * np.exp(1j * shoulder_of(kind, leg, p, psi))
    return np.abs(platform_point(kind, p, poses) - elbow) - p["L"]


def jacobian(
    kind: str, leg: int, p: dict[str, float], poses: Array, mode: int, turn: Array
) -> Array:
    """Return ∂reading/∂parameter by central differences of the closed form, shape (N, n).

    ``turn`` are shoulder angles that say which turn the shoulder is in, shape (N,).
    """

    def read(move: Array) -> Array:
        q = dict(zip(p, np.array([*p.values()]) + move, strict=True))
        return reading(kind, leg, q, turn + near(angles(kind, q, poses, mode)[0], turn))

    return differentiated(read, len(p), 1e-5)  # near singular poses too


def near(value: Array, reference: Array) -> Array:
    """Return the difference of angles, [rad] in [-pi, pi)."""
    return (value - reference + np.pi) % (2 * np.pi) - np.pi


def random_mechanism(kind: str, rng: np.random.Generator, mode: int) -> pincal.Mechanism:
    """Return a bundled mechanism with random geometry in a working mode, closed at home.

    Each leg has its own numbers; no symmetry is left. ``mode`` is the sign of the first
    leg's elbow sine (and of the others' in the 3-RRR; the 5R's second leg bends the other way).
    """
    mechanism = pincal.load_mechanism(kind)
    while True:
        home = np.array(mechanism.platform.home) + rng.uniform(-0.05, 0.05, mechanism.platform.dof)
        legs = []
        for index, leg in enumerate(mechanism.legs):
            p = leg.nominal_by_name
            p = {name: v + rng.uniform(-0.1, 0.1) * (abs(v) or 1.0) for name, v in p.items()}
            bend = mode if kind == "3RRR" or index == 0 else -mode
            shoulder, elbow = angles(kind, p, home[None], bend)
            # shoulder joint of the file counts from x; home in the branch of the bundled one
            turn = leg.home[0] + near(shoulder, leg.home[0])
            legs.append(leg.with_parameters(p).with_home([turn[0], elbow[0]]))
        if all(np.isfinite(leg.home).all() and abs(np.sin(leg.home[1])) > 0.3 for leg in legs):
            platform = replace(mechanism.platform, home=tuple(home))
            return replace(mechanism, legs=tuple(legs), platform=platform)


def bends(kind: str, mode: int) -> list[int]:
    """Return the sign of each leg's elbow sine in a working mode, as ``random_mechanism``."""
    return [mode, -mode] if kind == "5R" else [mode] * 3


def poses_near_home(mechanism: pincal.Mechanism, rng: np.random.Generator, count: int) -> Array:
    """Return random poses around home, some of them out of reach."""
    spread = np.array([0.5 if unit == "m" else 0.6 for unit in mechanism.platform.units])
    home = np.array(mechanism.platform.home)
    return home + rng.uniform(-spread, spread, (count, mechanism.platform.dof))
