"""Was the tracker aligned with the machine? Changes of parameters that are one motion of a frame.

If measured poses are those of another frame than the base, the legs' base points take that up, and
the machine is blamed for where the tracker stood. Parameters of machines differ from their drawings
each in its own way: that so many of them move as one body would be chance.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.stats import f as f_law

from pincal.estimation.drawings import plausible_changes
from pincal.estimation.frames import beyond, frame_motions
from pincal.identification.result import CalibrationResult
from pincal.identification.task import Task
from pincal.kinematics.closure import largest_size
from pincal.kinematics.configurations import legs_at
from pincal.model.measurements import Plan

Array = NDArray[np.float64]
_CHANCE = 1e-5  # probability of so much motion as one body, below which it is none
_BODY = 1e-6  # relative misfit of changes of parameters that are a motion of a frame
_ROWS = 200  # enough to judge by
_MUCH = 0.25  # of the platform's error: less is not worth a warning


def misaligned(task: Task, result: CalibrationResult) -> tuple[str, ...]:
    """Return a warning if parameters moved as one body, in frames that were said to be known."""
    if not (task.setup.plain and result.converged and result.promises) or task.tied:
        return ()
    poses = task.data.poses if result.estimated_poses is None else result.estimated_poses
    rows = np.linspace(0, len(poses) - 1, min(_ROWS, len(poses))).astype(int)
    by_readings = task.mechanism.by_readings
    readings = task.data.readings[rows] if by_readings else None
    if not np.isfinite(poses[rows]).all() or (readings is not None and np.isnan(readings).any()):
        return ()
    legs = legs_at(task.mechanism, Plan(poses[rows], readings=readings))
    gain = legs.gain
    changes = np.array([p.identified - p.nominal for leg in result.legs for p in leg.parameters])
    if not len(gain) or not np.isfinite(gain).all() or not changes.any():
        return ()
    platform = task.mechanism.platform
    size = largest_size(task.mechanism.legs, platform)
    motions = frame_motions(platform, platform.transforms(legs.poses).as_matrix())
    moved = gain @ changes
    n_base, space = motions.shape[2] - platform.dof, platform.space
    base = ("base", "is the tracker's frame the base's (--unknown-frame)?")
    body = ("platform", "is the target the platform's origin (--unknown-target)?")
    scale = plausible_changes(task.mechanism)
    lengths = np.array([1.0 if unit == "m" else size for unit in platform.units])
    for own, (what, how) in (
        (motions[:, :, :n_base], base),
        (motions[:, :, n_base:], body if "rad" in platform.units else base),
    ):
        chance, amounts = _as_one(gain, own, changes, scale)
        if chance > _CHANCE:
            continue
        left = beyond(platform, moved[:, :, None], own, size)[:, :, 0]
        share = 1.0 - ((left * lengths) ** 2).sum() / ((moved * lengths) ** 2).sum()
        if share < _MUCH:
            continue
        shift = f"{1e3 * np.linalg.norm(amounts[:space]):.3g} mm"
        if len(amounts) > space:
            shift += f" and {1e3 * np.linalg.norm(amounts[space:]):.3g} mrad"
        return (
            f"{100 * share:.0f} % of what the nominal model is off by (in squares) is one motion "
            f"of the {what}'s frame, by {shift}, and parameters that differ each in its own way "
            f"hardly move so (p = {chance:.1g}): {how} Else where the frame lies is taken for "
            "errors of the machine",
        )
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
    rigid = (misfit <= _BODY * sizes).all() and len(changes) > D.shape[1]
    if not rigid or not changes.all():
        return 1.0, np.zeros(D.shape[1])
    Q, R = np.linalg.qr(D)
    along, own = Q.T @ (changes / scale), changes / scale
    k, n = len(along), len(changes)
    inside, outside = along @ along, own @ own - along @ along
    amounts = np.linalg.lstsq(R, along, rcond=None)[0]
    return float(f_law.sf(inside / k / (outside / (n - k)), k, n - k)), amounts
