"""Where the frame of the measurements lies: the rigid motion that best takes points to points.

Points of the nominal machine, where its readings put it, onto where they were measured (Kabsch
1976), in turn with targets whose place on the platform is unknown.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pincal.errors import MeasurementError
from pincal.estimation.conditions.external import External
from pincal.estimation.linear import State
from pincal.estimation.problem import Problem
from pincal.model.measuring.measurements import Measurements
from pincal.model.measuring.setup import ORIGIN
from pincal.model.platform import Platform
from pincal.words.numbers import amount

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Alignment:
    """When frames are aligned, and when they are refused."""

    turns: int = 50
    """Of frame and offsets in turn, at most."""
    still: float = 1e-6
    """Of the extent of the poses: offsets move no more."""
    mirrored: float = 0.2
    """Of the misfit that is left, if the mirror image of a frame explains it."""
    misfit: float = 0.05
    """Of the extent of the measured points, from which a mirror is suspected."""
    refused: float = 0.3
    """Of it, from which nothing is identified."""


_BY = Alignment()


def aligned(problem: Problem, data: Measurements, state: State, good: Mask) -> External:
    """Return the external unknowns that take the targets to where they were measured.

    Frame and unknown offsets in turn, each by least squares with the others as they are.
    """
    seen, platform = problem.observation, problem.platform
    external, matrices = state.external, state.matrices
    R, r = matrices[:, :3, :3], matrices[:, :3, 3]
    measured = [_positions(platform, data, target) for target in seen.setup.targets]
    known = [good & np.isfinite(points).all(axis=1) for points in measured]
    frame, offsets = external.frame, external.offsets.copy()
    unknown = {index for index, _ in seen.external.offset_entries}
    for _ in range(_BY.turns if unknown else 1):
        if seen.external.frame_rows:
            here = np.concatenate([(r + R @ t)[own] for t, own in zip(offsets, known, strict=True)])
            there = np.concatenate([p[own] for p, own in zip(measured, known, strict=True)])
            frame = _kabsch(here, there, platform)
        before = offsets.copy()
        for index in unknown:
            own = known[index]
            if own.any():
                inside = (measured[index][own] - frame[:3, 3]) @ frame[:3, :3] - r[own]
                offsets[index] = (R[own].transpose(0, 2, 1) @ inside[:, :, None])[:, :, 0].mean(
                    axis=0
                )
        if np.abs(offsets - before).max(initial=0.0) <= _BY.still * max(np.ptp(r), 1e-300):
            break
    if seen.external.frame_rows:
        _check_frame(here, there, frame, platform)
    turn = external.turn
    turns = seen.orientations
    own = good & np.isfinite(turns).all(axis=(1, 2))
    if seen.external.turn_axes and own.any():
        each = R[own].transpose(0, 2, 1) @ frame[:3, :3].T @ turns[own]
        turn = Rotation.from_matrix(each).mean().as_matrix()
    return replace(external, frame=frame, offsets=offsets, turn=turn)


def _positions(platform: Platform, data: Measurements, target: str) -> Array:
    """Return measured positions of a target, shape (N, 3); NaN where not measured."""
    measured = np.zeros((len(data), 3))
    if target == ORIGIN:
        measured[:, : platform.lengths] = data.poses[:, : platform.lengths]
        return measured
    for axis, letter in enumerate("xyz"[: platform.space]):
        measured[:, axis] = data.extra.get(f"{target}_{letter}", np.nan)
    return measured


def _kabsch(here: Array, there: Array, platform: Platform) -> Array:
    """Return the rigid motion that takes points to others, homogeneous, shape (4, 4).

    Raises:
        MeasurementError: too few points, or points on a line.
    """
    if not len(here):
        raise MeasurementError(
            "the frame of the measurements is unknown and cannot be aligned: in no row with a "
            "measured position do the readings say where the nominal machine is. It needs as many "
            "readings as the platform has freedoms; check their units, order and signs"
        )
    least = platform.space
    for points in (here, there):
        spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
        if len(here) < least or not spread[least - 2] > 1e-3 * spread[0]:
            raise MeasurementError(
                f"the frame of the measurements is unknown and cannot be aligned: {len(here)} rows "
                "with a position that could show it, all "
                f"{'at one place' if least == 2 else 'on a line'} or too few; measure positions "
                "that span the workspace"
            )
    a, b = here - here.mean(axis=0), there - there.mean(axis=0)
    frame = np.eye(4)
    frame[:3, :3], _ = _rotation(a, b, platform, mirrored=False)
    frame[:3, 3] = there.mean(axis=0) - frame[:3, :3] @ here.mean(axis=0)
    return frame


def _check_frame(here: Array, there: Array, frame: Array, platform: Platform) -> None:
    """Raise if points do not fit after the best alignment.

    Raises:
        MeasurementError: they do not, or mirrored only.
    """
    a, b = here - here.mean(axis=0), there - there.mean(axis=0)
    extent = float(np.sqrt((b**2).sum(axis=1).mean()))
    misfit = float(np.sqrt(((a @ frame[:3, :3].T - b) ** 2).sum(axis=1).mean()))
    _, reflected = _rotation(a, b, platform, mirrored=True)
    if misfit > _BY.misfit * extent and reflected < _BY.mirrored * misfit:
        raise MeasurementError(
            "the positions look mirrored: in a right-handed frame they miss the nominal machine's "
            f"by {amount(misfit, 'm')} (rms), with one axis reversed by {amount(reflected, 'm')}. "
            "Check the signs and the order of the tracker's axes"
        )
    if misfit > _BY.refused * extent:
        raise MeasurementError(
            f"the measured positions miss the nominal machine's by {amount(misfit, 'm')} (rms) "
            f"after the best alignment, {100 * misfit / extent:.0f} % of their extent. Check the "
            "units, the order and signs of the readings, and that this is the right mechanism"
        )


def _rotation(a: Array, b: Array, platform: Platform, *, mirrored: bool) -> tuple[Array, float]:
    """Return the rotation (or reflection) that best takes a to b, and what it misses by, [m]."""
    n = platform.space
    U, _, Vt = np.linalg.svd(a[:, :n].T @ b[:, :n])
    R = np.eye(3)
    sign = np.eye(n)
    sign[-1, -1] = np.linalg.det(U @ Vt) * (-1.0 if mirrored else 1.0)
    R[:n, :n] = Vt.T @ sign @ U.T
    return R, float(np.sqrt(((a @ R.T - b) ** 2).sum(axis=1).mean()))
