"""Inverse kinematics of data sheets, from the dimensions alone: nothing of pincal's is used."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]
THIRDS = np.radians([0.0, 120.0, 240.0])
FROM_LEFT = np.radians([-150.0, -30.0, 90.0])


def ring(radius: float, azimuths: Array) -> Array:
    """Return points on a circle, shape (n, 3)."""
    return radius * np.stack((np.cos(azimuths), np.sin(azimuths), 0.0 * azimuths), axis=1)


def wrapped(angles: Array) -> Array:
    return np.pi - (np.pi - angles) % (2 * np.pi)


def spatial(poses: Array, points: Array) -> Array:
    """Return platform points at poses (azimuth, tilt, torsion), shape (N, n, 3)."""
    azimuth, tilt, torsion = poses[:, 3:].T
    turns = Rotation.from_euler("ZYZ", np.stack((azimuth, tilt, torsion - azimuth), axis=1))
    return poses[:, None, :3] + np.einsum("nij,pj->npi", turns.as_matrix(), points)


def planar(poses: Array, points: Array) -> Array:
    """Return platform points at poses in the plane, shape (N, n, 2)."""
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    turns = np.stack((np.stack((c, -s), axis=1), np.stack((s, c), axis=1)), axis=1)
    return poses[:, None, :2] + np.einsum("nij,pj->npi", turns, points[:, :2])


def hexapod(d: dict[str, Any], poses: Array) -> Array:
    a, p = d["base_half_angle"], d["platform_half_angle"]
    base = np.concatenate([[k - a, k + a] for k in THIRDS])
    platform = np.concatenate([[k + np.pi / 3 - p, k + np.pi / 3 + p] for k in THIRDS])
    base = np.roll(base, -1)  # leg 1 is at +a
    tips = spatial(poses, ring(d["platform_radius"], platform))
    return np.linalg.norm(tips - ring(d["base_radius"], base), axis=2) - d["zero_length"]


def delta(d: dict[str, Any], poses: Array) -> Array:
    """Return how far arms are below the horizontal: elbows outward."""
    c, s = np.cos(THIRDS), np.sin(THIRDS)
    out = poses[:, :1] * c + poses[:, 1:2] * s + d["platform_radius"] - d["base_radius"]
    across = poses[:, 1:2] * c - poses[:, :1] * s
    down = -poses[:, 2:]
    rhs = (out**2 + across**2 + down**2 + d["arm"] ** 2 - d["rod"] ** 2) / (2 * d["arm"])
    return np.arctan2(down, out) - np.arccos(rhs / np.hypot(out, down))


def linear_delta(d: dict[str, Any], poses: Array) -> Array:
    """Return the ways of the carriages down from their endstops."""
    towers = ring(d["delta_radius"], FROM_LEFT)[:, :2]
    away = np.linalg.norm(poses[:, None, :2] - towers, axis=2)
    height = poses[:, 2:] + np.sqrt(d["rod"] ** 2 - away**2)
    stop = d["endstop_height"] + np.sqrt(d["rod"] ** 2 - d["delta_radius"] ** 2)
    return stop - height


def shoulder(to: Array, first: float, second: float) -> Array:
    """Return the angle of the first of two links to a point, bent to the left of the way."""
    away = np.linalg.norm(to, axis=-1)
    inner = (first**2 + away**2 - second**2) / (2 * first * away)
    return np.arctan2(to[..., 1], to[..., 0]) + np.arccos(inner)


def five_bar(d: dict[str, Any], poses: Array) -> Array:
    """Return motors' angles, that of the right one from −x and clockwise."""
    motor, links = (
        np.array([-d["motor_distance"] / 2, 0.0]),
        (d["driving_link"], d["conducted_link"]),
    )
    sides = [poses * (sign, 1.0) - motor for sign in (1.0, -1.0)]
    return np.stack([shoulder(to, *links) for to in sides], axis=1)


def three_rrr(d: dict[str, Any], poses: Array) -> Array:
    """Return motors' angles from the way to the middle."""
    tips = planar(poses, ring(d["platform_radius"], FROM_LEFT))
    to = tips - ring(d["base_radius"], FROM_LEFT)[:, :2]
    return wrapped(shoulder(to, d["proximal"], d["distal"]) - FROM_LEFT - np.pi)


def drawn_in(tips: Array, home: Array, anchors: Array) -> Array:
    """Return how much longer cables are than at home."""
    return np.linalg.norm(tips - anchors, axis=2) - np.linalg.norm(home - anchors, axis=2)


def cable_4(d: dict[str, Any], poses: Array) -> Array:
    """Return lengths of cables, from the lower left anchor on; upper ones go to lower corners."""
    w, h = d["frame_width"] / 2, d["frame_height"] / 2
    u, v = d["platform_width"] / 2, d["platform_height"] / 2
    v = v if d["cables"] == "straight" else -v
    anchors = np.array([(-w, -h), (w, -h), (w, h), (-w, h)])
    corners = np.array([(-u, -v), (u, -v), (u, v), (-u, v)])
    return drawn_in(planar(poses, corners), corners[None], anchors)


def cable_8(d: dict[str, Any], poses: Array) -> Array:
    """Return lengths of cables, the upper ones first, from the post at (+, +) on."""
    posts = np.array([(1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)])
    frame = np.array([d["frame_length"], d["frame_width"]]) / 2
    box = np.array([d["platform_length"], d["platform_width"], d["platform_height"]]) / 2
    turn = 1 if d["cables"] == "turned" else 0
    below = 1.0 if d["cables"] == "straight" else -1.0
    anchors, corners = [], []
    for z, side, by in ((d["upper"], 1.0, -turn), (d["lower"], -1.0, turn)):
        anchors += [(*xy, z) for xy in posts * frame]
        corners += [(*xy, below * side) * box for xy in np.roll(posts, by, axis=0)]
    home = np.array([[0.0, 0.0, d["height"], 0.0, 0.0, 0.0]])
    points = np.array(corners)
    return drawn_in(spatial(poses, points), spatial(home, points), np.array(anchors))


FORMS: dict[str, Callable[[dict[str, Any], Array], Array]] = {
    "hexapod": hexapod,
    "delta": delta,
    "linear-delta": linear_delta,
    "five-bar": five_bar,
    "3-RRR": three_rrr,
    "cable-4": cable_4,
    "cable-8": cable_8,
}
