"""Was the tracker aligned with the machine? Changes of parameters that are one motion of a frame.

If measured poses are those of another frame than the base, the legs' base points take that up, and
the machine is blamed for where the tracker stood. Parameters of machines differ from their drawings
each in its own way: that so many of them move as one body would be chance.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtrc

from pincal.calibration.hypotheses.rule import RULE
from pincal.estimation.observability.drawings import plausible_changes
from pincal.estimation.observability.frames import frame_motions, unexplained
from pincal.estimation.observability.indices import NEGLIGIBLE
from pincal.finding import Finding
from pincal.kinematics.configurations import legs_at
from pincal.kinematics.legs.closure import largest_size
from pincal.model.measuring.measurements import Plan
from pincal.model.mechanism import Mechanism
from pincal.words.sentences import finding

Array = NDArray[np.float64]


def misaligned(
    mechanism: Mechanism, changes: Array, poses: Array, readings: Array
) -> tuple[Finding, ...]:
    """Return a finding if parameters moved as one body.

    Of fits in frames that were said to be known, without ties.

    Args:
        mechanism: The nominal mechanism.
        changes: Identified less nominal parameters of all legs, shape (n_params,).
        poses: Measured or estimated, shape (N, dof), [m] and [rad].
        readings: Measured, shape (N, n_readings), [rad] or [m].
    """
    rows = np.linspace(0, len(poses) - 1, min(RULE.rows_moved, len(poses))).astype(int)
    read = readings[rows] if mechanism.by_readings else None
    if not np.isfinite(poses[rows]).all() or (read is not None and np.isnan(read).any()):
        return ()
    legs = legs_at(mechanism, Plan(poses[rows], readings=read))
    gain = legs.gain
    if not len(gain) or not np.isfinite(gain).all() or not changes.any():
        return ()
    platform = mechanism.platform
    size = largest_size(mechanism.legs)
    motions = frame_motions(platform, platform.matrices(legs.poses))
    moved, scale = gain @ changes, plausible_changes(mechanism)
    n_base, space = motions.shape[2] - platform.dof, platform.space
    lengths = np.array([1.0 if unit == "m" else size for unit in platform.units])
    for frame, own in (("base", motions[:, :, :n_base]), ("platform", motions[:, :, n_base:])):
        chance, amounts = _as_one(gain, own, changes, scale)
        left = unexplained(platform, moved[:, :, None], own, size)[:, :, 0]
        share = 1.0 - ((left * lengths) ** 2).sum() / ((moved * lengths) ** 2).sum()
        if chance > RULE.chance or share < RULE.matters:
            continue
        turns = len(amounts) > space
        values: dict[str, Any] = {
            "frame": frame,
            "remedy": frame if "rad" in platform.units else "base",
            "share": float(share),
            "p_value": chance,
            "shift": float(np.linalg.norm(amounts[:space])),
            "turn": float(np.linalg.norm(amounts[space:])) if turns else None,
        }
        return (finding("frame-misaligned", **values),)
    return ()


def _as_one(gain: Array, motions: Array, changes: Array, scale: Array) -> tuple[float, Array]:
    """Return the probability of so much motion as one body by chance, and that motion.

    The share of the changes' squares, in parameters over their scale, that lies in the directions
    that move a frame has the F distribution if all directions are alike. 1 if parameters cannot
    move so, or some are held.

    Args:
        gain: What parameters do to the platform, shape (N, dof, n).
        motions: What unit motions of a frame do to it, shape (N, dof, k).
        changes: Of the parameters, shape (n,).
        scale: By how much they may differ, shape (n,).
    """
    A, b = gain.reshape(-1, gain.shape[2]) * scale, motions.reshape(-1, motions.shape[2])
    D = np.linalg.lstsq(A, b, rcond=1e-9)[0]
    misfit, sizes = np.linalg.norm(A @ D - b, axis=0), np.linalg.norm(b, axis=0)
    rigid = (misfit <= NEGLIGIBLE * sizes).all() and len(changes) > D.shape[1]
    if not rigid or not changes.all():
        return 1.0, np.zeros(D.shape[1])
    Q, R = np.linalg.qr(D)
    along, own = Q.T @ (changes / scale), changes / scale
    k, n = len(along), len(changes)
    inside, outside = along @ along, own @ own - along @ along
    amounts = np.linalg.lstsq(R, along, rcond=None)[0]
    return float(fdtrc(k, n - k, inside / k / (outside / (n - k)))), amounts
