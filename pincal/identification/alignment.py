"""Where a search with unknown poses and frames starts.

Poses of the readings by least squares at the nominal parameters (forward kinematics that
measurements may help, and that more legs than freedoms do not disturb); then the rigid
motion that takes the targets there to where they were measured (Kabsch 1976).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pincal.errors import MeasurementError
from pincal.estimation.external import External
from pincal.identification.latent import LatentPoses
from pincal.identification.problem import State
from pincal.kinematics.closure import LegClosure, largest_size
from pincal.kinematics.forward import placed_by_arm
from pincal.kinematics.held import held
from pincal.kinematics.singularity import platform_margin
from pincal.kinematics.starts import home_mode, mode_sign
from pincal.model.measurements import Measurements
from pincal.model.mechanism import Mechanism
from pincal.model.platform import Platform
from pincal.model.setup import ORIGIN

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
_STEPS = 60
_LARGEST_STEP = 0.2  # of the mechanism's size, and [rad]
_USUAL = 3.0  # times the median gap that contradicting readings leave
_TURNS = 50  # of frame and offsets in turn
_STILL = 1e-6  # of the extent of the poses: offsets move no more
_WAY = 5  # steps from the readings at home to those measured
_CLOSES = 1e-3  # of a leg's size, a gap that is left when readings contradict each other
_TILTED = 1e-3  # [rad]
_SETTLED = 1e-7  # of the mechanism's size, and [rad]
_MIRRORED = 0.2  # of the misfit that is left, if the mirror image of a frame explains it
_MISFIT = 0.05  # of the extent of the measured points, from which a mirror is suspected
_REFUSED = 0.3  # from which nothing is identified


def align(
    mechanism: Mechanism, problem: LatentPoses, data: Measurements, parameters: Array
) -> State:
    """Return poses and external unknowns from which the search may start.

    Args:
        mechanism: The nominal mechanism.
        problem: The problem.
        data: The measurements.
        parameters: Nominal parameters of all legs, shape (n_params,).

    Raises:
        MeasurementError: frames that cannot be aligned, or only mirrored.
    """
    problem = problem.eased()
    seen, platform = problem.observation, problem.residuals[0].platform
    external = seen.external.start
    outside = seen.external
    whole = np.isfinite(data.poses).all() and len(seen.setup.targets) == 1
    redundant = mechanism.redundant
    if not len(outside) and (whole or redundant):
        state = placed(problem, data, parameters, external)
        return state if whole else settle(problem, state)
    legs = [LegClosure(leg, platform) for leg in mechanism.legs]
    there = placed_by_arm(mechanism, legs, problem.readings)
    home = np.tile(platform.home_pose.as_matrix(), (len(data), 1, 1))
    joints = (None,) * len(problem.legs)
    state = State(parameters, home if there is None else there, joints, external)
    for share in np.linspace(0.0, 1.0, _WAY + 1)[1:] if there is None else ():
        state = settle(problem.driven(mechanism, share), state)  # from home to where readings say
    good = _well(mechanism, problem, state)
    if len(outside):
        state = replace(state, external=_aligned(problem, data, state, good))
    guess = placed(problem, data, parameters, state.external)
    matrices = np.where(good[:, None, None], state.matrices, guess.matrices)
    told = np.isfinite(data.poses[:, : platform.space]).all(axis=1)
    arms = (matrices - guess.matrices)[:, :3, :3] @ state.external.offsets[0]
    matrices[told, :3, 3] = (guess.matrices[:, :3, 3] - arms)[told]
    return settle(problem, replace(state, matrices=matrices, joints=(None,) * len(problem.legs)))


def _well(mechanism: Mechanism, problem: LatentPoses, state: State) -> Mask:
    """Return which poses close all legs, in the working and assembly modes of home, shape (N,)."""
    legs = [LegClosure(leg, mechanism.platform) for leg in mechanism.legs]
    closures = [
        held(leg, state.matrices, one.readings, joints)[0]
        for leg, one, joints in zip(legs, problem.residuals, state.joints, strict=True)
    ]
    redundant = mechanism.redundant  # of which the type-2 margin has no sign
    told = problem.told(observed=False) >= mechanism.platform.dof  # readings alone give the pose
    good = told & (redundant | (platform_margin(mechanism, closures) > 0.0))
    missed = np.zeros(len(good))
    for leg, closure, own in zip(legs, closures, problem.used.T, strict=True):
        missed = np.fmax(missed, np.where(own, np.abs(closure.gap).max(axis=1) / leg.size, 0.0))
        good &= ~own | (mode_sign(closure) == home_mode(leg.leg, leg.platform))
    usual = _USUAL * np.median(missed[told]) if redundant and told.any() else 0.0
    return good & (missed <= max(_CLOSES, usual))


def placed(
    problem: LatentPoses, data: Measurements, parameters: Array, external: External
) -> State:
    """Return poses as measured, what was not measured as at home; orientations in full or not.

    Args:
        problem: The problem.
        data: The measurements.
        parameters: Of all legs, shape (n_params,).
        external: Values of the external unknowns.
    """
    platform = problem.residuals[0].platform
    partly = np.where(np.isfinite(data.poses), data.poses, platform.home)
    if "tilt" in platform.coordinates:  # upright, tilt has no direction in which to grow
        partly[:, platform.coordinates.index("tilt")] += _TILTED
    matrices = platform.transforms(partly).as_matrix().copy()
    turns = problem.observation.orientations
    told = np.isfinite(turns).all(axis=(1, 2))
    F = external.frame[:3, :3]
    matrices[told, :3, :3] = F.T @ turns[told] @ external.turn.T
    measured = np.full((len(data), 3), np.nan)
    measured[:, : platform.space] = data.poses[:, : platform.space]
    if platform.space == 2:
        measured[:, 2] = 0.0
    there = (measured - external.frame[:3, 3]) @ F - matrices[:, :3, :3] @ external.offsets[0]
    matrices[:, :3, 3] = np.where(np.isfinite(there), there, matrices[:, :3, 3])
    joints = (None,) * len(problem.legs)
    return State(parameters, matrices, joints, external)


def settle(problem: LatentPoses, state: State) -> State:
    """Return the state with each pose at its least squares, parameters and frames as they are.

    Each pose has a damping of its own (Levenberg-Marquardt). Poses that find no place stay
    where they came to; the search that follows moves them on.
    """
    platform = problem.residuals[0].platform
    linear = np.array([unit == "m" for unit in platform.units])
    size = largest_size(problem.legs, platform)
    scale = np.where(linear, size, 1.0)
    rows, plain = problem.rows(state)
    state, cost = plain.state, np.einsum("nk,nk->n", rows.value, rows.value)
    damping = np.full(len(cost), 1e-6)
    open_ = np.ones(len(cost), dtype=bool)
    for _ in range(_STEPS):
        B = rows.pose * scale
        square = B.transpose(0, 2, 1) @ B
        diagonal = np.einsum("nii->ni", square)
        least = 1e-12 * diagonal.max(axis=1, keepdims=True)
        diagonal += damping[:, None] * (diagonal + np.where(least > 0.0, least, 1.0))
        step = -np.linalg.solve(square, B.transpose(0, 2, 1) @ rows.value[:, :, None])[:, :, 0]
        longest = np.abs(step).max(axis=1)
        step *= np.minimum(1.0, _LARGEST_STEP / np.maximum(longest, 1e-300))[:, None]
        step[~open_] = 0.0
        moved = replace(
            state, matrices=platform.displaced(state.matrices, np.asarray(step * scale))
        )
        new_rows, plain = problem.rows(moved)
        new_cost = np.einsum("nk,nk->n", new_rows.value, new_rows.value)
        better = open_ & (new_cost <= cost)
        state = State(
            state.parameters,
            np.where(better[:, None, None], moved.matrices, state.matrices),
            tuple(
                new if old is None or new is None else np.where(better[:, None], new, old)
                for new, old in zip(plain.state.joints, state.joints, strict=True)
            ),
            state.external,
        )
        rows = replace(
            rows,
            value=np.where(better[:, None], new_rows.value, rows.value),
            pose=np.where(better[:, None, None], new_rows.pose, rows.pose),
        )
        cost = np.where(better, new_cost, cost)
        damping = np.clip(np.where(better, 0.1 * damping, 10.0 * damping), 1e-9, 1e9)
        open_ &= (longest > _SETTLED) & (damping < 1e9)
        if not open_.any():
            break
    return state


def _aligned(problem: LatentPoses, data: Measurements, state: State, good: Mask) -> External:
    """Return the external unknowns that take the targets to where they were measured.

    Frame and unknown offsets in turn, each by least squares with the others as they are.
    """
    seen, platform = problem.observation, problem.residuals[0].platform
    external, matrices = state.external, state.matrices
    R, r = matrices[:, :3, :3], matrices[:, :3, 3]
    measured = [_positions(platform, data, target) for target in seen.setup.targets]
    told = [good & np.isfinite(points).all(axis=1) for points in measured]
    frame, offsets = external.frame, external.offsets.copy()
    unknown = {index for index, _ in seen.external.offset_entries}
    for _ in range(_TURNS if unknown else 1):
        if seen.external.frame_rows:
            here = np.concatenate([(r + R @ t)[own] for t, own in zip(offsets, told, strict=True)])
            there = np.concatenate([p[own] for p, own in zip(measured, told, strict=True)])
            frame = _kabsch(here, there, platform)
        before = offsets.copy()
        for index in unknown:
            own = told[index]
            if own.any():
                inside = (measured[index][own] - frame[:3, 3]) @ frame[:3, :3] - r[own]
                offsets[index] = (R[own].transpose(0, 2, 1) @ inside[:, :, None])[:, :, 0].mean(
                    axis=0
                )
        if np.abs(offsets - before).max(initial=0.0) <= _STILL * max(np.ptp(r), 1e-300):
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
    for axis, letter in enumerate("xyz"[: platform.space]):
        name = f"{target}_{letter}"
        measured[:, axis] = (
            data.poses[:, axis] if target == ORIGIN else data.extra.get(name, np.nan)
        )
    return measured


def _kabsch(here: Array, there: Array, platform: Platform) -> Array:
    """Return the rigid motion that takes points to others, homogeneous, shape (4, 4).

    Raises:
        MeasurementError: too few points, or points on a line.
    """
    if not len(here):
        raise MeasurementError(
            "the frame of the measurements is unknown and cannot be aligned: in no row with a "
            "measured position do the readings tell where the nominal machine is. It needs as many "
            "readings as the platform has freedoms; check their units, order and signs"
        )
    least = platform.space
    for points in (here, there):
        spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
        if len(here) < least or not spread[least - 2] > 1e-3 * spread[0]:
            raise MeasurementError(
                f"the frame of the measurements is unknown and cannot be aligned: {len(here)} rows "
                "with a position from which to tell it, all "
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
    if misfit > _MISFIT * extent and reflected < _MIRRORED * misfit:
        raise MeasurementError(
            "the positions look mirrored: in a right-handed frame they miss the nominal machine's "
            f"by {1e3 * misfit:.3g} mm (rms), with one axis reversed by {1e3 * reflected:.3g} mm. "
            "Check the signs and the order of the tracker's axes"
        )
    if misfit > _REFUSED * extent:
        raise MeasurementError(
            f"the measured positions miss the nominal machine's by {1e3 * misfit:.3g} mm (rms) "
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
