"""A home must nearly close its legs, or it does not fix the side on which they bend."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from pincal.errors import MechanismError
from pincal.model.leg import Leg
from pincal.model.platform import Platform
from pincal.types import Array


def link_placements(leg: Leg, joints: Array) -> Array:
    """Return ``T_base_link`` of the link after each joint, shape (N, n_all_joints, 4, 4), [m].

    Args:
        leg: The leg; fixed joints count, the last link is the tip.
        joints: Positions of the moving joints, shape (N, n_joints), [rad] or [m]; where they
            are NaN, so are the links that they move.
    """
    positions = iter(np.asarray(joints, dtype=np.float64).T)
    T_base_link = np.broadcast_to(np.eye(4), (len(joints), 4, 4))
    placements = []
    for joint in leg.joints:
        T_base_link = T_base_link @ joint.placement.origin()
        if joint.kind != "fixed":
            T_base_link = T_base_link @ joint.motion(next(positions))
        placements.append(T_base_link)
    return np.stack(placements, axis=1)


ROUGH = 0.1
"""Of the size: what is drawn and misses by more is wrong, not rough."""


def check_home(leg: Leg, platform: Platform) -> None:
    """Raise MechanismError if a leg is open at home by more than a tenth of its size.

    Of an angle of more than a full turn it asks whether it is degrees.
    """
    gap, turn = _gap_and_turn(leg, platform)
    if max(gap, leg.size * turn) <= ROUGH * leg.size:
        return
    how = (
        f"its tip is {gap:.2g} m from the platform's point {leg.point.name!r}, the leg is "
        f"{leg.size:.2g} m long; expected a tenth of that at most"
        if gap >= leg.size * turn
        else f"its tip is turned by {turn:.2g} rad against the platform's frame "
        f"{leg.point.name!r}; expected {ROUGH:g} rad at most"
    )
    angles = [(f"{joint.name} of {leg.name}", joint.home) for joint in leg.moving if joint.turns]
    named = list(zip(platform.coordinates, platform.home, strict=True))[platform.lengths :]
    angles += [(f"{name} of the platform", value) for name, value in named]
    questions = [
        f". {name} is {value:g} at home: radians are expected; is this degrees "
        f"({np.radians(value):.6g} rad)?"
        for name, value in angles
        if abs(value) > 2 * np.pi
    ]
    raise MechanismError(
        f"{leg.name} does not close at home: {how}. Correct 'home' of {leg.name} or of the "
        f"platform{''.join(questions[:1])}"
    )


def home_gap(leg: Leg, platform: Platform) -> float:
    """Return by how much a leg is open at home, [m]; a turn of its frame counts times its size."""
    gap, turn = _gap_and_turn(leg, platform)
    return max(gap, leg.size * turn)


def _gap_and_turn(leg: Leg, platform: Platform) -> tuple[float, float]:
    """Return how far a leg's tip is from where it closes at home, [m], and turned, [rad].

    A leg that closes a point may be turned.
    """
    tip = link_placements(leg, leg.home[None])[0, -1]
    point = platform.home_pose.as_matrix()[0] @ leg.point.placement.origin()
    gap = float(np.linalg.norm((tip - point)[: platform.space, 3]))
    if leg.closes == "point":
        return gap, 0.0
    return gap, float(Rotation.from_matrix(point[:3, :3].T @ tip[:3, :3]).magnitude())
