"""Where a search begins: poses and frames by least squares at the nominal parameters.

Every condition counts as a length: the start asks only for geometry. Where readings fix poses,
they are followed from home to those measured, so that the assembly mode stays that of home; then
the rigid motion that takes the targets there to where they were measured.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.spatial import KDTree

from pincal.errors import MeasurementError
from pincal.estimation.alignment import aligned
from pincal.estimation.covariances import RowNoise
from pincal.estimation.problem import Linear, Problem, spread
from pincal.estimation.solver import search, solve_poses
from pincal.estimation.system import System
from pincal.estimation.unknowns import External, State
from pincal.kinematics.closing import home_mode, mode_sign
from pincal.kinematics.closure import LegClosure, Newton, largest_size
from pincal.kinematics.forward import placed_by_arm
from pincal.kinematics.inverse import inverse
from pincal.kinematics.nearest_closure import nearest_closure
from pincal.kinematics.singularity import platform_margin
from pincal.model.measurements import Measurements
from pincal.model.mechanism import Mechanism
from pincal.model.setup import ORIGIN, Setup
from pincal.types import Array, Index, Mask
from pincal.words.numbers import amount

_NEWTON = Newton(steps=60, small=1e-7, largest=0.2)

_USUAL = 3.0  # times the median gap, up to which readings leave what contradicting ones do
_DRIVE_STEPS = 5  # steps from the readings at home to those measured
_CLOSES = 1e-3  # share of a leg's size: a gap that contradicting readings leave
_TILTED = 1e-3  # tilt [rad] of a platform that is not upright
_CONTRADICTS = 0.03  # share of the mechanism's size, median over rows: nothing is identified


def align_start(
    mechanism: Mechanism, problem: Problem, data: Measurements, parameters: Array
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
    observation, platform = problem.observation, problem.platform
    external = observation.external.start
    outside = observation.external
    complete = np.isfinite(data.poses).all() and len(observation.setup.targets) == 1
    redundant = mechanism.redundant
    if not len(outside) and (complete or redundant):
        state = placed(problem, data, parameters, external)
        return state if complete else poses_at_rest(problem, state)
    legs = [LegClosure(leg, platform) for leg in mechanism.legs]
    arm_matrices = placed_by_arm(legs, problem.leg_block.known)
    home = np.tile(platform.home_pose.as_matrix(), (len(data), 1, 1))
    state = State(parameters, home if arm_matrices is None else arm_matrices, external=external)
    for share in np.linspace(0.0, 1.0, _DRIVE_STEPS + 1)[1:] if arm_matrices is None else ():
        state = poses_at_rest(_driven(mechanism, problem, share), state)
    good = _well(mechanism, problem, state)
    agrees = np.ones(len(data), dtype=bool)
    if len(outside):
        values, agrees = aligned(problem, data, state, good)
        state = replace(state, external=values)
    guess = placed(problem, data, parameters, state.external)
    matrices = np.where(good[:, None, None], state.matrices, guess.matrices)
    known = agrees & np.isfinite(data.poses[:, : platform.lengths]).all(axis=1)
    arms = (matrices - guess.matrices)[:, :3, :3] @ state.external.offsets[0]
    matrices[known, :3, 3] = (guess.matrices[:, :3, 3] - arms)[known]
    state = replace(state, matrices=matrices, joints=())
    return poses_at_rest(problem, instruments_started(problem, state))


def instruments_started(problem: Problem, state: State) -> State:
    """Return the state with the instruments' own parameters at least squares.

    At the poses that everything else gives; as it is where that does not fix them.

    Args:
        problem: The problem.
        state: Poses near those at rest.
    """
    from scipy.optimize import least_squares  # slow to load: when needed

    observation = problem.observation
    columns = [name for instrument in observation.setup.instruments for name in instrument.columns]
    without_instruments = replace(
        problem, observation=observation.only([n for n in observation.names if n not in columns])
    )
    if not len(state.external.instruments) or (without_instruments.equations < 0).any():
        return state
    matrices = poses_at_rest(without_instruments, state).matrices
    instruments = observation.only(columns)
    sigma = np.where(
        instruments.measured & (problem.observation.sigma > 0.0), problem.observation.sigma, 1.0
    )

    def rows(values: Array) -> tuple[Array, Array]:
        value, _, by_external = instruments.residuals(
            matrices, replace(state.external, instruments=values)
        )
        by_own = by_external[:, :, -len(values) :] / sigma[:, :, None]
        return (value / sigma).ravel(), by_own.reshape(-1, len(values))

    solution = least_squares(
        lambda values: rows(values)[0],
        state.external.instruments,
        jac=lambda values: rows(values)[1],
        x_scale="jac",
    )
    return replace(state, external=replace(state.external, instruments=solution.x))


def _well(mechanism: Mechanism, problem: Problem, state: State) -> Mask:
    """Return which poses close all legs, in the working and assembly modes of home, shape (N,)."""
    legs = [LegClosure(leg, mechanism.platform) for leg in mechanism.legs]
    closures = [
        nearest_closure((leg,), state.matrices, (known,), (joints,))[0]
        for leg, known, joints in zip(
            legs, problem.leg_block.known, state.joints or (None,) * len(legs), strict=True
        )
    ]
    redundant = mechanism.redundant  # of which the type-2 margin has no sign
    known = _leg_equations(problem) >= mechanism.platform.dof  # readings alone give the pose
    lines = [closure.constraint_by_pose for closure in closures]
    good = known & (redundant | (platform_margin(mechanism, lines) > 0.0))
    missed = np.zeros(len(good))
    for leg, closure, serves in zip(legs, closures, problem.leg_block.used.T, strict=True):
        missed = np.fmax(missed, np.where(serves, np.abs(closure.gap).max(axis=1) / leg.size, 0.0))
        good &= ~serves | (mode_sign(closure) == home_mode(leg.leg, leg.platform))
    usual = _USUAL * np.median(missed[known]) if redundant and known.any() else 0.0
    return good & (missed <= max(_CLOSES, usual))


def placed(problem: Problem, data: Measurements, parameters: Array, external: External) -> State:
    """Return poses as measured, what was not measured as at home; orientations in full or not.

    Args:
        problem: The problem.
        data: The measurements.
        parameters: Of all legs, shape (n_params,).
        external: Values of the external unknowns.
    """
    platform = problem.platform
    partly = np.where(np.isfinite(data.poses), data.poses, platform.home)
    if "tilt" in platform.coordinates:  # upright, tilt has no direction in which to grow
        partly[:, platform.coordinates.index("tilt")] += _TILTED
    matrices = platform.matrices(partly).copy()
    turns = problem.observation.orientations
    known = np.isfinite(turns).all(axis=(1, 2))
    F = external.frame[:3, :3]
    matrices[known, :3, :3] = F.T @ turns[known] @ external.turn.T
    measured = np.full((len(data), 3), np.nan)
    measured[:, : platform.lengths] = data.poses[:, : platform.lengths]
    if platform.space == 2:
        measured[:, 2] = 0.0
    positions = (measured - external.frame[:3, 3]) @ F - matrices[:, :3, :3] @ external.offsets[0]
    matrices[:, :3, 3] = np.where(np.isfinite(positions), positions, matrices[:, :3, 3])
    return State(parameters, matrices, external=external)


def _driven(mechanism: Mechanism, problem: Problem, share: float) -> Problem:
    """Return the problem of readings alone that are on the way from home to those measured."""
    home = inverse(mechanism, np.array([mechanism.platform.home])).readings[0]
    legs = problem.leg_block
    legs = legs.corrected((1.0 - share) * (home - legs.readings))
    return replace(problem, leg_block=legs, observation=problem.observation.only(()))


def _leg_equations(problem: Problem) -> Index:
    """Return how many equations the legs give at each pose, shape (N,)."""
    return problem.leg_block.active.sum(axis=1)


def _as_lengths(problem: Problem, linear: Linear) -> tuple[Array, Array]:
    """Return conditions as lengths [m], shape (N, k), and derivatives by poses, (N, k, dof)."""
    size = largest_size(problem.legs)
    angles = np.array([unit == "rad" for unit in problem.observation.units], dtype=bool)
    scale = np.ones(linear.conditions.shape[1])
    scale[len(scale) - len(angles) :] = np.where(angles, size, 1.0)
    return linear.conditions * scale, linear.by_pose * scale[:, None]


def poses_at_rest(problem: Problem, state: State) -> State:
    """Return the state with each pose at its least squares, parameters and frames as they are.

    Each pose has a damping of its own (Levenberg–Marquardt). Poses that find no place remain
    where they came to; the search that follows moves them on.
    """
    platform = problem.platform
    size = largest_size(problem.legs)
    scale = np.array([size if unit == "m" else 1.0 for unit in platform.units])
    linear = problem.evaluate(state)
    value, pose = _as_lengths(problem, linear)
    state, cost = linear.state, np.einsum("nk,nk->n", value, value)
    damping = np.full(len(cost), 1e-6)
    open_ = np.ones(len(cost), dtype=bool)
    for _ in range(_NEWTON.steps):
        B = pose * scale
        square = B.transpose(0, 2, 1) @ B
        diagonal = np.einsum("nii->ni", square)
        least = 1e-12 * diagonal.max(axis=1, keepdims=True)
        diagonal += damping[:, None] * (diagonal + np.where(least > 0.0, least, 1.0))
        step = -np.linalg.solve(square, B.transpose(0, 2, 1) @ value[:, :, None])[:, :, 0]
        longest = np.abs(step).max(axis=1)
        step *= np.minimum(1.0, _NEWTON.largest / np.maximum(longest, 1e-300))[:, None]
        step[~open_] = 0.0
        moved = platform.displaced(state.matrices, np.asarray(step * scale))
        linear = problem.evaluate(replace(state, matrices=moved))
        new_value, new_pose = _as_lengths(problem, linear)
        new_cost = np.einsum("nk,nk->n", new_value, new_value)
        better = open_ & (new_cost <= cost)
        state = State(
            state.parameters,
            np.where(better[:, None, None], moved, state.matrices),
            tuple(
                np.where(better[:, None], new, old)
                for new, old in zip(linear.state.joints, state.joints, strict=True)
            ),
            state.external,
        )
        value = np.where(better[:, None], new_value, value)
        pose = np.where(better[:, None, None], new_pose, pose)
        cost = np.where(better, new_cost, cost)
        damping = np.clip(np.where(better, 0.1 * damping, 10.0 * damping), 1e-9, 1e9)
        open_ &= (longest > _NEWTON.small) & (damping < 1e9)
        if not open_.any():
            break
    return state


def check_start(problem: Problem, state: State) -> None:
    """Raise if readings and what was measured cannot both be the nominal mechanism's.

    At poses of least squares, by what legs and measured lengths miss together.

    Raises:
        MeasurementError: by how much they miss.
    """
    state = poses_at_rest(problem, state)
    size = largest_size(problem.legs)
    linear = problem.evaluate(state)
    n_legs = problem.leg_block.n_rows
    lengths = [unit == "m" for unit in problem.observation.units]
    missed = linear.conditions[:, [*range(n_legs), *(n_legs + np.flatnonzero(lengths))]]
    worst = float(np.median(np.linalg.norm(missed, axis=1)))
    if worst > _CONTRADICTS * size:
        raise MeasurementError(
            f"readings and measured positions contradict each other by {amount(worst, 'm')} in the "
            f"nominal mechanism (median over the rows, {100 * worst / size:.0f} % of a leg's "
            "length). Check the units, the order and signs of the readings, and the frame"
            f"{left_out(problem.observation.setup)}. If the mechanism is known but roughly, say so "
            "(--rough)"
        )


def left_out(setup: Setup) -> str:
    """Return which options that free frame and target a setup leaves out, as a remark."""
    options = {
        "if the base is elsewhere in it: --unknown-frame": setup.unknown_frame,
        "if the target is not the platform's origin: --unknown-target or --setup": (
            setup.targets[ORIGIN].unknown
        ),
    }
    missing = "; ".join(words for words, chosen in options.items() if not chosen)
    return f" ({missing})" if missing else ""


_UNEVEN = 100.0  # ratio of noise up to which valleys are wide enough
_GROSS = 100.0  # times as far off as usual at the start: rows left out of the easier problem
_EASY_ROWS = 2000  # rows that suffice to begin near the optimum
_EASY_NEAR = 0.1  # standard deviations of a residual at which the easier problem is left
_EASY_EVALUATIONS = 50


def near_start(
    system: System, first: Linear, progress: Callable[[str], None] | None = None
) -> tuple[Linear, int]:
    """Return where the search begins, near an easier optimum if that is better; and evaluations.

    That of the evened problem, without gross errors, and of least squares: a loss bends the cost
    far from its optimum.

    Args:
        system: What is minimised.
        first: The conditions at the start, poses solved.
        progress: Called with what is being done.
    """
    problem, count = system.problem, len(first.conditions)
    sound = first.squares <= _GROSS**2 * np.median(first.squares)
    easier = _evened(problem, first) or (problem if system.loss or not sound.all() else None)
    if easier is None:
        return first, 0
    rows, start = spread(count, _EASY_ROWS), problem.start(first.state.parameters)
    if len(rows) < count:
        easier, start = easier.at(rows), start.rows(rows)
    begin, solved = solve_poses(easier, easier.evaluate(start))
    taking_part = sound if system.kept is None else system.kept & sound
    easy = replace(system, problem=easier, kept=taking_part[rows], loss=None)
    easy_result = search(
        easy, begin, progress, enough=_EASY_NEAR, max_evaluations=_EASY_EVALUATIONS
    )
    state, evaluations = easy_result.last.state, solved + easy_result.evaluations
    if len(rows) < count:
        state = replace(problem.start(state.parameters), external=state.external)
    state = _among_similar(problem, state, sound)
    try:
        with np.errstate(all="ignore"):
            near, solved = solve_poses(problem, problem.evaluate(state))
            costs = [system.cost_at(linear) for linear in (first, near)]
    except MeasurementError:
        return first, evaluations
    better = np.isfinite(costs[1]) and not costs[1] > costs[0]
    return (near if better else first), evaluations + solved


def _evened(problem: Problem, linear: Linear) -> Problem | None:
    """Return the problem with every quantity at least as uncertain as is typical.

    Its optimum is nearby and has no narrow valleys: where readings are exact, a pose near a
    singularity of the nominal machine goes far astray. None where nothing changes, or where an
    arm carries the platform.
    """
    if not problem.latent or any(leg.is_arm for leg in problem.legs):
        return None
    legs, observation = problem.leg_block, problem.observation
    lengths = np.array([unit == "m" for unit in observation.units], dtype=bool)
    size = max(leg.size for leg in problem.legs)
    of_legs = np.linalg.norm(linear.noise_root[:, : legs.n_rows], axis=2)
    observed = (observation.sigma * np.where(lengths, 1.0, size))[observation.measured]
    noisy = [values[values > 0.0] for values in (observed, of_legs) if (values > 0.0).any()]
    if not noisy:
        return None
    typical = float(np.median(noisy[0]))
    sigma = np.maximum(observation.sigma, np.where(lengths, typical, typical / size))
    slopes = [
        np.median(np.linalg.norm(demand.reading, axis=1), axis=0) for demand in linear.demands
    ]
    floors = typical / np.maximum(np.concatenate(slopes), 1e-300)
    readings = np.maximum(legs.sigma, np.where(np.isfinite(floors), floors, 0.0))
    even = (sigma <= _UNEVEN * observation.sigma) | ~observation.measured
    if even.all() and (readings <= _UNEVEN * legs.sigma).all():
        return None
    return replace(
        problem,
        leg_block=replace(legs, sigma=readings),
        observation=observation.with_noise(RowNoise(sigma, observation.noise.correlation)),
    )


def _among_similar(problem: Problem, state: State, sound: Mask) -> State:
    """Return a state whose rows that are far off start where the readings are most alike.

    What was measured there may lead to another assembly mode.
    """
    if not problem.latent or sound.all():
        return state
    readings = problem.leg_block.readings
    readings = readings / np.maximum(np.ptp(readings, axis=0), 1e-300)
    rows, sound_rows = np.arange(len(sound)), np.flatnonzero(sound)
    rows[~sound] = sound_rows[KDTree(readings[sound_rows]).query(readings[~sound])[1]]
    return state.rows(rows)
