"""Where the frame of the measurements lies: the rigid motion that best takes points to points.

Points of the nominal machine, where its readings put it, onto where they were measured (Kabsch
1976), in turn with targets whose place on the platform is unknown. Rows with a gross error are
found by the alignment of least absolute distances, and left out.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from pincal.errors import MeasurementError
from pincal.estimation.problem import Problem
from pincal.estimation.unknowns import External, State
from pincal.model.measurements import Measurements
from pincal.model.platform import Platform
from pincal.model.setup import ORIGIN
from pincal.types import Array, Mask
from pincal.words.numbers import amount

_TURNS = 50  # turns of frame and offsets, at most
_STILL = 1e-6  # share of the poses' extent below which offsets no longer move
_MISFIT = 0.05  # share of the measured points' extent from which a mirror is suspected
_MIRRORED = 0.2  # share of the misfit that is left if the mirror image explains it
_REFUSED = 0.3  # share of the extent from which nothing is identified
_GROSS = 10.0  # times the usual miss from which a row says nothing of frame and target


def aligned(
    problem: Problem,
    data: Measurements,
    state: State,
    placed: Mask,
    *,
    however_far: bool = False,
) -> tuple[External, Mask]:
    """Return the external unknowns that take the targets to where they were measured.

    Frame and unknown offsets in turn, each by least squares with the others as they are, of the
    rows that agree: see ``_agreeing``.

    Args:
        problem: The problem.
        data: The measurements.
        state: The nominal machine, poses where its readings put it.
        placed: Which poses the readings give, shape (N,).
        however_far: Whether points may miss each other by much, or look mirrored.

    Returns:
        The unknowns, and which rows agree with the others on them, shape (N,).

    Raises:
        MeasurementError: frames that cannot be aligned, or only mirrored.
    """
    observation, platform = problem.observation, problem.platform
    measured = np.stack(
        [_positions(platform, data, target) for target in observation.setup.targets]
    )
    known = placed & np.isfinite(measured).all(axis=2)
    agreeing = known & _agreeing(problem, state, measured, known)
    frame, offsets, _ = _in_turn(problem, state, measured, agreeing.astype(float))
    if observation.setup.unknown_frame and not however_far:
        reached = (state.matrices[None, :, :3, :3] @ offsets[:, None, :, None])[..., 0]
        reached += state.matrices[:, :3, 3]
        _check_frame(reached[agreeing], measured[agreeing], frame, platform)
    turn, turns = state.external.turn, observation.orientations
    turned = placed & np.isfinite(turns).all(axis=(1, 2))
    if observation.external.turned and turned.any():
        R = state.matrices[turned, :3, :3]
        rotations = Rotation.from_matrix(R.transpose(0, 2, 1) @ frame[:3, :3].T @ turns[turned])
        angles = (rotations.mean().inv() * rotations).magnitude()
        rotations = rotations[angles <= np.maximum(_GROSS * np.median(angles), _MISFIT)]
        turn = rotations.mean().as_matrix()
    agrees = np.asarray(~(known & ~agreeing).any(axis=0))
    return replace(state.external, frame=frame, offsets=offsets, turn=turn), agrees


def _agreeing(problem: Problem, state: State, measured: Array, known: Mask) -> Mask:
    """Return which positions agree with most others on frame and offsets, shape (n_targets, N).

    They miss the alignment of least absolute values by no gross multiple of the usual. Where that
    alignment begins, a position far from the others weighs no more than they do.
    """
    points = measured[known]
    if not len(points):
        return known
    far = np.linalg.norm(measured - np.median(points, axis=0), axis=2)
    extent = max(float(np.median(far[known])), 1e-300)
    weights = np.where(known, extent / np.maximum(far, extent), 0.0)
    missed = _in_turn(problem, state, measured, weights, absolute=True)[2]
    usual = float(np.median(missed[known]))
    return known & (missed <= max(_GROSS * usual, _MISFIT * extent))


def _in_turn(
    problem: Problem, state: State, measured: Array, weights: Array, *, absolute: bool = False
) -> tuple[Array, Array, Array]:
    """Return frame (4, 4), offsets (n_targets, 3) and distances missed (n_targets, N), in [m].

    Args:
        problem: The problem.
        state: The nominal machine.
        measured: Positions of the targets, shape (n_targets, N, 3).
        weights: Of their squares, shape (n_targets, N); 0 where not measured.
        absolute: Whether distances are summed instead, by weights that follow them.
    """
    setup, platform = problem.observation.setup, problem.platform
    R, r = state.matrices[:, :3, :3], state.matrices[:, :3, 3]
    frame, offsets = state.external.frame, state.external.offsets.copy()
    unknown = {i for i, target in enumerate(setup.targets.values()) if target.unknown}
    still = _STILL * max(np.ptp(r), 1e-300)
    known = weights > 0.0
    for _ in range(_TURNS if unknown or absolute else 1):
        before = offsets.copy()
        if setup.unknown_frame:
            reached = r + (R @ offsets[:, None, :, None])[..., 0]
            frame = _kabsch(reached[known], measured[known], weights[known], platform)
        inside = (measured - frame[:3, 3]) @ frame[:3, :3] - r
        for index in unknown:
            if (rows := known[index]).any():
                in_platform = (R[rows].transpose(0, 2, 1) @ inside[index, rows, :, None])[:, :, 0]
                offsets[index] = np.average(in_platform, axis=0, weights=weights[index, rows])
        missed = np.linalg.norm(inside - (R @ offsets[:, None, :, None])[..., 0], axis=2)
        if absolute:
            usual = max(float(np.median(missed[known])), 1e-300)
            weights = np.where(known, usual / np.maximum(missed, usual), 0.0)
        elif np.abs(offsets - before).max(initial=0.0) <= still:
            break
    return frame, offsets, missed


def _positions(platform: Platform, data: Measurements, target: str) -> Array:
    """Return measured positions of a target, shape (N, 3); NaN where not measured."""
    measured = np.zeros((len(data), 3))
    if target == ORIGIN:
        measured[:, : platform.lengths] = data.poses[:, : platform.lengths]
        return measured
    for axis, letter in enumerate("xyz"[: platform.space]):
        measured[:, axis] = data.extra.get(f"{target}_{letter}", np.nan)
    return measured


def _kabsch(nominal: Array, measured: Array, weights: Array, platform: Platform) -> Array:
    """Return the rigid motion that takes points to others, homogeneous, shape (4, 4).

    Raises:
        MeasurementError: too few points, or points on a line.
    """
    if not len(nominal):
        raise MeasurementError(
            "the frame of the measurements is unknown and cannot be aligned: in no row with a "
            "measured position do the readings say where the nominal machine is. It needs as many "
            "readings as the platform has freedoms; check their units, order and signs"
        )
    least = platform.space
    for points in (nominal, measured):
        spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
        if len(nominal) < least or not spread[least - 2] > 1e-3 * spread[0]:
            raise MeasurementError(
                "the frame of the measurements is unknown and cannot be aligned: "
                f"{len(nominal)} rows with a position that could show it, all "
                f"{'at one place' if least == 2 else 'on a line'} or too few; measure positions "
                "that span the workspace"
            )
    middle_here, middle_there = (
        np.average(p, axis=0, weights=weights) for p in (nominal, measured)
    )
    a, b = nominal - middle_here, measured - middle_there
    frame = np.eye(4)
    frame[:3, :3], _ = _rotation(a * weights[:, None], b, platform, mirrored=False)
    frame[:3, 3] = middle_there - frame[:3, :3] @ middle_here
    return frame


def _check_frame(nominal: Array, measured: Array, frame: Array, platform: Platform) -> None:
    """Raise if points do not fit after the best alignment.

    Raises:
        MeasurementError: they do not, or mirrored only.
    """
    a, b = nominal - nominal.mean(axis=0), measured - measured.mean(axis=0)
    extent = float(np.sqrt((b**2).sum(axis=1).mean()))
    misfit = float(np.sqrt(((a @ frame[:3, :3].T - b) ** 2).sum(axis=1).mean()))
    _, reflected = _rotation(a, b, platform, mirrored=True)
    if misfit > _MISFIT * extent and reflected < _MIRRORED * misfit:
        raise MeasurementError(
            "the positions look mirrored: in a right-handed frame they miss the nominal machine's "
            f"by {amount(misfit, 'm')} (rms), with one axis reversed by {amount(reflected, 'm')}. "
            "Check the signs and the order of the tracker's axes"
        )
    if misfit > _REFUSED * extent:
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
