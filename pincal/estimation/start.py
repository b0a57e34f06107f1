"""Where a search begins: poses and frames by least squares at the nominal parameters.

Every condition counts as a length: the start is a matter of geometry alone. Where readings fix the
poses, these are followed from the readings at home to the measured ones, which keeps the assembly
mode of home. Then follows the rigid motion from the targets at these poses to the measured targets
(Kabsch 1976), in turn with the places of unknown targets on the platform. Rows with a gross error
are recognised by an alignment of least absolute distances, and left out.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import chain

import numpy as np
from scipy.spatial.transform import Rotation

from pincal.errors import MeasurementError, MisfitError
from pincal.estimation.noise import target_positions
from pincal.estimation.observation import Observation
from pincal.estimation.problem import Linear, Problem
from pincal.estimation.unknowns import External, State
from pincal.kinematics.batches import lengths, motion_of_points
from pincal.kinematics.closing import home_mode, mode_sign
from pincal.kinematics.closure import nominal_legs
from pincal.kinematics.configurations import inverse
from pincal.kinematics.derivatives import nearest_closure
from pincal.kinematics.forward import placed_by_arm
from pincal.kinematics.singularity import platform_margin
from pincal.model import ORIGIN, Measurements, Mechanism
from pincal.types import Array, Mask
from pincal.words.numbers import amount

_STEPS, _LARGEST, _SMALL = 60, 0.2, 1e-7  # largest number of steps, longest and last step
_USUAL = 3.0  # gap over the median gap, up to which redundant readings agree
_DRIVE_STEPS = 5  # steps from the readings at home to the measured ones
_CLOSES = 1e-3  # gap over a leg's size, up to which a leg closes
_CONTRADICTS = 0.03  # median misfit over the mechanism's size, above which nothing is identified
_TURNS = 50  # largest number of alternations of frame and offsets
_MOST = 100  # largest number of evaluations to place what instruments alone see
_STILL = 1e-6  # change of offsets over the poses' extent that is negligible
_MISFIT = 0.05  # misfit over the extent of the measured points, up to which a row agrees
_GROSS = 10.0  # misfit over the median misfit, above which a row is left out


def align_start(
    mechanism: Mechanism, problem: Problem, data: Measurements, parameters: Array
) -> State:
    """Return poses and external unknowns from which the search may start.

    ``parameters`` are the nominal values of all legs, shape (n_params,).
    """
    observation, platform = problem.observation, problem.platform
    external, outside = observation.external.start, observation.external
    complete = np.isfinite(data.poses).all() and len(observation.setup.targets) == 1
    if not len(outside) and (complete or mechanism.redundant):
        state = State(parameters, placed(observation, data, external), external=external)
        return state if complete else poses_at_rest(problem.evaluate(state)).state
    arm_matrices = placed_by_arm(nominal_legs(mechanism), problem.leg_block.known)
    home = np.tile(platform.home_pose.as_matrix(), (len(data), 1, 1))
    state = State(parameters, home if arm_matrices is None else arm_matrices, external=external)
    if arm_matrices is None:
        block, readings = problem.leg_block, inverse(mechanism, np.array([platform.home])).readings
        for share in np.linspace(0.0, 1.0, _DRIVE_STEPS + 1)[1:]:
            driven = replace(block, readings=readings + share * (block.readings - readings))
            way = replace(problem, leg_block=driven, observation=observation.only(()))
            state = poses_at_rest(way.evaluate(state)).state
    good, agrees = _closes_as_home(mechanism, problem, state), np.ones(len(data), dtype=bool)
    if len(outside):
        values, agrees = aligned(observation, data, state, good)
        state = replace(state, external=values)
    guess = placed(observation, data, state.external)
    matrices = np.where(good[:, None, None], state.matrices, guess)
    known = agrees & np.isfinite(data.poses[:, : platform.lengths]).all(axis=1)
    arms = (matrices - guess)[:, :3, :3] @ state.external.offsets[0]
    matrices[known, :3, 3] = (guess[:, :3, 3] - arms)[known]
    state = replace(state, matrices=matrices, joints=())
    return poses_at_rest(problem.evaluate(_outside_started(problem, state))).state


def _outside_started(problem: Problem, state: State) -> State:
    """Return the state with the unknowns that only instruments and contacts see at least squares.

    They are placed if the poses are fixed without them; touched features where most rows agree.
    """
    from scipy.optimize import least_squares  # slow to load: when needed

    observation, external = problem.observation, state.external
    outside, contacts = observation.external, observation.setup.contact_axes(problem.platform)
    columns = [name for device in observation.setup.instruments for name in device.columns]
    columns += chain(*contacts.values())
    dependent = {*columns, *observation.setup.between_rows}  # quantities that need touched features
    independent = observation.only([name for name in observation.names if name not in dependent])
    without = replace(problem, observation=independent)
    if not columns or (without.equations < 0).any():
        return state
    at_rest, dependent_rows = poses_at_rest(without.evaluate(state)), observation.only(columns)
    matrices = at_rest.state.matrices
    external = outside.begun(external, matrices, observation.conditions)
    external = dependent_rows.at_touch(matrices, external)
    by_others = independent.residuals(matrices, external)[2]
    _, by_pose, by_these = dependent_rows.residuals(matrices, external)
    theirs = by_these.any(axis=(0, 1)) & ~by_others.any(axis=(0, 1)) & (outside.free >= 6)
    by_free = np.eye(len(outside))[:, theirs]
    if not theirs.any():
        return state

    arms, usual = _length_factors(problem, dependent_rows.units, by_pose), _CLOSES * problem.size
    roughly = np.flatnonzero(theirs & np.isfinite(outside.priors))
    by_prior = usual / outside.priors[roughly, None] * by_free[roughly]
    nominal = outside.coordinates(outside.start)[roughly]

    @lru_cache(maxsize=1)  # slopes are asked for where residuals were evaluated last
    def rows_at(*values: float) -> tuple[Array, Array]:
        moved = outside.moved(external, by_free @ values)
        value, _, by_outside = dependent_rows.residuals(matrices, moved)
        far = (outside.coordinates(moved)[roughly] - nominal) / outside.priors[roughly]
        J = (arms[:, None] * by_outside[:, :, theirs]).reshape(-1, by_free.shape[1])
        return np.append(arms * value, usual * far), np.concatenate((J, by_prior))

    values = np.zeros(by_free.shape[1])
    if not np.isfinite(rows_at(*values)[0]).all():  # behind a camera
        return state
    missed, slopes = (lambda x: rows_at(*x)[0]), (lambda x: rows_at(*x)[1])
    settings = {"x_scale": "jac", "f_scale": usual, "max_nfev": _MOST}
    for loss in ("linear", "soft_l1") if contacts or dependent_rows.setup.pixels else ("linear",):
        values = least_squares(missed, values, slopes, loss=loss, **settings).x
    return replace(state, external=outside.moved(external, by_free @ values))


def _closes_as_home(mechanism: Mechanism, problem: Problem, state: State) -> Mask:
    """Return which poses close all legs in the working and assembly modes of home, shape (N,)."""
    block, redundant, legs = problem.leg_block, mechanism.redundant, nominal_legs(mechanism)
    joints = state.joints or [None] * len(legs)
    closures = [
        nearest_closure((leg,), state.matrices, known, of_leg)[0]
        for leg, known, of_leg in zip(legs, block.known, joints, strict=True)
    ]
    known = block.active.sum(axis=1) >= mechanism.platform.dof  # readings alone give the pose
    lines = [closure.constraint_by_pose for closure in closures]
    # the type-2 margin of a redundant mechanism has no sign
    good = known & (redundant | (platform_margin(mechanism, lines) > 0.0))
    missed = np.zeros(len(good))
    for leg, closure, serves in zip(legs, closures, block.used.T, strict=True):
        missed = np.fmax(missed, np.where(serves, np.abs(closure.gap).max(axis=1) / leg.size, 0.0))
        good &= ~serves | (mode_sign(closure) == home_mode(leg.leg, leg.platform))
    usual = _USUAL * np.median(missed[known]) if redundant and known.any() else 0.0
    return good & (missed <= max(_CLOSES, usual))


def placed(
    observation: Observation, data: Measurements, external: External, near: Array | None = None
) -> Array:
    """Return poses as measured, in the base frame, shape (N, 4, 4).

    Coordinates that were not measured are those of ``near``, shape (N, dof), or home. An
    orientation is taken as a whole.
    """
    platform, turns = observation.platform, observation.orientations
    partly = np.where(np.isfinite(data.poses), data.poses, platform.home if near is None else near)
    matrices = platform.matrices(partly).copy()
    known = np.isfinite(turns).all(axis=(1, 2))
    F = external.frame[:3, :3]
    matrices[known, :3, :3] = F.T @ turns[known] @ external.turn.T
    measured = np.full((len(data), 3), np.nan)
    measured[:, : platform.lengths] = data.poses[:, : platform.lengths]
    if platform.space == 2:
        measured[:, 2] = 0.0
    positions = (measured - external.frame[:3, 3]) @ F - matrices[:, :3, :3] @ external.offsets[0]
    matrices[:, :3, 3] = np.where(np.isfinite(positions), positions, matrices[:, :3, 3])
    return matrices


def poses_at_rest(linear: Linear) -> Linear:
    """Return the conditions with each pose at least squares, parameters and frames held fixed.

    Each pose has its own damping (Levenberg–Marquardt). Poses that do not converge stay where they
    ended; the search that follows moves them on.
    """
    problem, platform, size = linear.problem, linear.problem.platform, linear.problem.size
    scale = np.array([size if unit == "m" else 1.0 for unit in platform.units])
    arms = _length_factors(problem, problem.units, linear.by_pose)
    damping, open_ = np.full(len(linear.conditions), 1e-6), np.ones(len(linear.conditions), bool)
    for _ in range(_STEPS):
        B, value = linear.by_pose * arms[:, None] * scale, linear.conditions * arms
        square = B.transpose(0, 2, 1) @ B
        diagonal = np.einsum("nii->ni", square)
        least = 1e-12 * diagonal.max(axis=1, keepdims=True)
        diagonal += damping[:, None] * (diagonal + np.where(least > 0.0, least, 1.0))
        step = -np.linalg.solve(square, B.transpose(0, 2, 1) @ value[:, :, None])[:, :, 0]
        longest = np.abs(step).max(axis=1)
        open_ &= (longest > _SMALL) & (damping < 1e9)
        if not open_.any():
            break
        step *= np.minimum(1.0, _LARGEST / np.maximum(longest, 1e-300))[:, None]
        step[~open_] = 0.0
        matrices = platform.displaced(linear.state.matrices, step * scale)
        trial = problem.evaluate(replace(linear.state, matrices=matrices))
        better = open_ & (lengths(trial.conditions * arms) <= lengths(value))
        linear = linear.with_poses(better, trial)
        damping = np.clip(np.where(better, 0.1 * damping, 10.0 * damping), 1e-9, 1e9)
    return linear


def _length_factors(problem: Problem, units: Sequence[str], by_pose: Array) -> Array:
    """Return factors, shape (k,), that turn residuals into lengths (pixels: by a pose's effect)."""
    arms = np.array([problem.size if unit == "rad" else 1.0 for unit in units])
    pixels = np.array([unit == "px" for unit in units], dtype=bool)
    moved = np.linalg.norm(by_pose[:, pixels, :3], axis=2)
    if (moved := moved[moved > 0.0]).size:
        arms[pixels] = 1.0 / np.median(moved)
    return arms


def check_start(problem: Problem, state: State) -> None:
    """Raise if readings and measured positions contradict each other in the nominal mechanism.

    They do by the misfit of legs and measured lengths at poses of least squares.

    Raises:
        MeasurementError: the misfit is too large; the message says how large.
        MisfitError: so it is, wherever frame and target are.
    """
    linear = poses_at_rest(problem.evaluate(state))
    size, setup = problem.size, problem.observation.setup
    worst = float(np.median(lengths(linear.conditions[:, np.array(problem.units) == "m"])))
    if worst > _CONTRADICTS * size:
        known = not setup.targets[ORIGIN].unknown and len(setup.targets) == 1
        hints = ["if the base is elsewhere in it: --unknown-frame"] * (not setup.unknown_frame)
        hints += ["if the target is not the platform's origin: --unknown-target or --setup"] * known
        unused = "; ".join(hints)
        raise (MeasurementError if unused else MisfitError)(
            f"readings and measured positions contradict each other by {amount(worst, 'm')} in the "
            f"nominal mechanism (median over the rows, {100 * worst / size:.0f} % of a leg's "
            "length). Check the units, the order and signs of the readings, and the frame"
            f"{f' ({unused})' if unused else ''}. If the mechanism is known but roughly, say so "
            "(--rough)"
        )


def aligned(
    observation: Observation, data: Measurements, state: State, reached: Mask
) -> tuple[External, Mask]:
    """Return the external unknowns that take the targets to where they were measured.

    Also return which rows agree on them, shape (N,). Frame and unknown offsets are found in turn by
    least squares, from the rows that agree with most other rows. ``state`` is the nominal machine
    at the poses of its readings, which determine the ``reached`` ones, shape (N,).
    """
    platform, targets = observation.platform, observation.setup.targets
    measured = np.stack([target_positions(platform, data, name) for name in targets])
    for name, _, rows in observation.touches():  # a known point is a position
        _, point, contact = observation.setup.touched[name]
        if contact.points[point] is not None and contact.shape == "point":
            measured[list(targets).index(contact.target), rows] = contact.points[point]
    known = agreeing = reached & np.isfinite(measured).all(axis=2)
    if known.any():  # rows agree that an alignment of least absolute distances does not miss
        far = np.linalg.norm(measured - np.median(measured[known], axis=0), axis=2)
        extent = max(float(np.median(far[known])), 1e-300)
        weights = np.where(known, extent / np.maximum(far, extent), 0.0)  # far points weigh less
        missed = _frame_and_offsets(observation, state, measured, weights, absolute=True)[-1]
        usual = float(np.median(missed[known]))
        agreeing = known & (missed <= max(_GROSS * usual, _MISFIT * extent))
    frame, offsets, _ = _frame_and_offsets(observation, state, measured, agreeing.astype(float))
    turn, turns = state.external.turn, observation.orientations
    turned = reached & np.isfinite(turns).all(axis=(1, 2))
    if observation.external.turned and turned.any():
        R = state.matrices[turned, :3, :3]
        rotations = Rotation.from_matrix(R.transpose(0, 2, 1) @ frame[:3, :3].T @ turns[turned])
        angles = (rotations.mean().inv() * rotations).magnitude()
        rotations = rotations[angles <= np.maximum(_GROSS * np.median(angles), _MISFIT)]
        turn = rotations.mean().as_matrix()
    agrees = np.asarray(~(known & ~agreeing).any(axis=0))
    return replace(state.external, frame=frame, offsets=offsets, turn=turn), agrees


def _frame_and_offsets(
    observation: Observation,
    state: State,
    measured: Array,
    weights: Array,
    *,
    absolute: bool = False,
) -> tuple[Array, Array, Array]:
    """Return frame (4, 4), offsets (n_targets, 3) and misfits (n_targets, N), [m].

    Weights, shape (n_targets, N), multiply squares, and are 0 where a target was not measured; with
    ``absolute`` they are where the reweighting for least absolute distances begins.
    """
    setup, platform = observation.setup, observation.platform
    R, r = state.matrices[:, :3, :3], state.matrices[:, :3, 3]
    frame, offsets = state.external.frame, state.external.offsets.copy()
    unknown = {i for i, target in enumerate(setup.targets.values()) if target.unknown}
    still, known = _STILL * max(np.ptp(r), 1e-300), weights > 0.0
    points = r + (R @ offsets[:, None, :, None])[..., 0]
    if setup.unknown_frame:
        _check_alignable(points[known], measured[known], platform.space)
    for _ in range(_TURNS if unknown or absolute else 1):
        before = offsets.copy()
        if setup.unknown_frame:
            pair = points[known], measured[known]
            frame = motion_of_points(*pair, platform.space, weights=weights[known])
        inside = (measured - frame[:3, 3]) @ frame[:3, :3]
        for index in unknown:
            if (rows := known[index]).any():
                arms = (inside[index, rows] - r[rows])[:, :, None]
                in_platform = (R[rows].transpose(0, 2, 1) @ arms)[:, :, 0]
                offsets[index] = np.average(in_platform, axis=0, weights=weights[index, rows])
        points = r + (R @ offsets[:, None, :, None])[..., 0]
        missed = np.linalg.norm(inside - points, axis=2)
        if absolute:
            usual = max(float(np.median(missed[known])), 1e-300)
            weights = np.where(known, usual / np.maximum(missed, usual), 0.0)
        elif np.abs(offsets - before).max(initial=0.0) <= still:
            break
    return frame, offsets, missed


def _check_alignable(nominal: Array, measured: Array, least: int) -> None:
    """Raise an error if points, (n, 3), show no frame in space of ``least`` dimensions."""
    if not len(nominal):
        raise MeasurementError(
            "the frame of the measurements is unknown and cannot be aligned: in no row with a "
            "measured position (a platform that only turns has none) do the readings say where the "
            "nominal machine is. It needs as many readings as freedoms; check their units, order "
            "and signs. Points that are touched at unknown places have no frame: leave it out"
        )
    for points in (nominal, measured):
        spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
        if len(nominal) < least or not spread[least - 2] > 1e-3 * spread[0]:
            raise MeasurementError(
                "the frame of the measurements is unknown and cannot be aligned: "
                f"{len(nominal)} rows with a position that could show it, all "
                f"{'at one place' if least == 2 else 'on a line'} or too few; measure positions "
                "that span the workspace (a tip in sockets is a contact of the setup)"
            )
