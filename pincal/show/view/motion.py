"""What a page needs to move a mechanism by itself: the legs' chains, and how parts hang on them.

The nominal chains as their URDFs say them, origins and axes; the page closes them by Newton's
method from the joints of the nearest pose.
"""

from __future__ import annotations

import base64
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr

from pincal.kinematics.configurations import joints_at
from pincal.model.leg import Leg
from pincal.show.view.scene import Scene
from pincal.show.view.solids import parallelogram
from pincal.words.numbers import POSES, per_si

Array = NDArray[np.float64]
_MOST = 0.25  # of the scene's size: how far a slider goes
_TURN = 0.5  # and for angles, [rad]


def motion(scene: Scene) -> dict[str, Any]:
    """Return chains, platform points and the poses' joints, for JSON.

    ``jog``: what sliders move: ``"platform"``, or ``"joints"`` of an arm. ``free``: the platform's
    coordinates without a slider, which follow from the others where poses are on a surface.
    """
    mechanism, platform = scene.mechanism, scene.mechanism.platform
    arm = mechanism.by_readings and len(mechanism.legs) == 1
    solved = joints_at(mechanism, scene.plan).joints
    size = float(np.linalg.norm(np.ptp(scene.bounds(), axis=0)))
    moved = platform.twist_rows if arm or not mechanism.by_readings else independent(scene, size)
    if arm:
        sliders = [
            {"name": joint.name, "unit": _shown(unit)[0], "scale": _shown(unit)[1], "most": most}
            for joint in mechanism.legs[0].moving
            for unit, most in [("m", _MOST * size) if joint.kind == "prismatic" else ("rad", 1.0)]
        ]
    else:
        sliders = [
            {
                "name": name,
                "unit": _shown(unit)[0],
                "scale": _shown(unit)[1],
                "most": _MOST * size if unit == "m" else _TURN,
                "row": row,
            }
            for name, unit, row in zip(
                platform.freedoms, platform.units, platform.twist_rows, strict=True
            )
            if row in moved
        ]
    return {
        "jog": "joints" if arm else "platform",
        "sliders": sliders,
        "free": [row for row in platform.twist_rows if row not in moved],
        "rows": list(platform.closure_rows),
        "size": size,
        "legs": [_leg(leg) for leg in mechanism.legs],
        "points": [list(leg.point.placement.origin().ravel()) for leg in mechanism.legs],
        "joints": [_doubles(solved[leg.name]) for leg in mechanism.legs],
        "parts": [_hung(scene, part.path) for part in scene.body.parts],
    }


def independent(scene: Scene, size: float) -> tuple[int, ...]:
    """Return the twist's rows, of a platform on a surface of poses, from which the others follow.

    Those of largest pivots among the twists that the legs allow at the first pose.

    Args:
        scene: The mechanism at poses.
        size: Turns count with this length, [m].
    """
    mechanism, body = scene.mechanism, scene.body
    drawn = np.isfinite(body.placements).all(axis=(1, 2, 3))
    links = body.placements[int(np.argmax(drawn))]
    origin = links[body.part("platform/body"), :3, 3]
    held = []
    for leg, chain in zip(mechanism.legs, body.chains, strict=True):
        T, tip = links[list(chain)], links[chain[-1], :3, 3]
        columns = []
        for joint, T_base_link in zip(leg.joints, T, strict=True):
            if joint.kind != "fixed":
                axis = T_base_link[:3, :3] @ np.array(joint.axis)
                arm = np.cross(axis, tip - T_base_link[:3, 3])
                sliding = joint.kind == "prismatic"
                columns.append([*(axis if sliding else arm), *(0 * axis if sliding else axis)])
        r = tip - origin
        by_twist = np.block([[np.eye(3), -_skew(r)], [np.zeros((3, 3)), np.eye(3)]])
        rows = 6 if leg.closes == "frame" else 3
        U, s, _ = np.linalg.svd(np.array(columns).T[:rows])
        rank = int((s > 1e-9 * s[0]).sum())
        held.append(U[:, rank:].T @ by_twist[:rows])
    scaled = np.concatenate(held) / np.array([1.0, 1.0, 1.0, size, size, size])
    _, s, V = np.linalg.svd(scaled)
    allowed = V[int((s > 1e-9 * s[0]).sum()) :]
    _, _, order = qr(allowed, pivoting=True)
    return tuple(sorted(int(row) for row in order[: len(allowed)]))


def _skew(r: Array) -> Array:
    return np.array([[0.0, -r[2], r[1]], [r[2], 0.0, -r[0]], [-r[1], r[0], 0.0]])


def _shown(unit: str) -> tuple[str, float]:
    """Return the unit in which poses are shown, and its number in one SI unit."""
    return POSES[unit], per_si(unit, POSES)


def _doubles(values: Array) -> str:
    return base64.b64encode(np.ascontiguousarray(values, dtype="<f8").tobytes()).decode()


def _leg(leg: Leg) -> dict[str, Any]:
    """Return a leg's joints: origins as rows of 4 x 4, axes, kinds."""
    pair = parallelogram(leg)
    along = np.array(leg.joints[-1].placement.xyz)
    return {
        "closes": leg.closes,
        "joints": [
            {
                "T": list(joint.placement.origin().ravel()),
                "axis": list(joint.axis),
                "kind": joint.kind,
            }
            for joint in leg.joints
        ],
        "along": [] if pair is None else list(along / np.linalg.norm(along)),
    }


def _hung(scene: Scene, path: str) -> dict[str, Any]:
    """Return on what a part hangs: a link of a leg, its rod or cylinder, the platform, the base."""
    body, (owner, what) = scene.body, path.split("/")
    kind, _, number = what.partition(" ")
    if owner == "platform":
        legs = scene.mechanism.legs
        points = list(dict.fromkeys(leg.point.name for leg in legs))
        names = [leg.point.name for leg in legs]
        return {"on": "platform", "leg": names.index(points[int(number) - 1]) if number else -1}
    if not number:
        return {"on": "base"}
    leg, place = int(owner.split()[1]) - 1, int(number) - 1
    hung: dict[str, Any] = {"on": kind, "leg": leg, "place": place}
    if kind in ("rod", "cylinder"):
        axis = scene.mechanism.legs[leg].joints[place].axis
        _, _, (_, across, other) = np.linalg.svd([axis])
        barrel = [p.path for p in body.parts].count(f"{owner}/cylinder {number}")
        inside = 0.0
        if barrel:
            at = body.placements[:, body.part(f"{owner}/cylinder {number}"), :3, 2]
            inside = float(np.nanmax(np.linalg.norm(at, axis=1)))
        hung |= {"axis": list(axis), "across": [*across], "other": [*other], "inside": inside}
    return hung
