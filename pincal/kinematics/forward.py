"""Forward kinematics: poses of readings, by Newton's method on the pose and all passive joints.

Passive joints are eliminated leg by leg, so each step solves one small system for the platform's
twist, by least squares of the gaps [m] if there are more equations than freedoms. Rows that do not
converge are searched again, with readings that move from home in steps, or from sampled poses.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.spatial import KDTree

from pincal.blas import one_thread
from pincal.errors import MechanismError
from pincal.files.mechanism_folders import GivenMechanism, as_mechanism
from pincal.kinematics.batches import chunks, least_squares, lengths, product, repeated, stacked
from pincal.kinematics.closed_forms import is_line
from pincal.kinematics.closing import (
    by_leg,
    close_legs,
    grouped,
    in_home_modes,
    sensor_law,
    start_joints,
    started,
)
from pincal.kinematics.closure import Closure, LegClosure, evaluate, joint_range, nominal_legs
from pincal.kinematics.influences import Influences, gravity_loads, influence_columns
from pincal.kinematics.singularity import platform_margin
from pincal.model import LOAD, Mechanism, Poses
from pincal.model.checks import ROUNDING, array_of, finite_rows
from pincal.model.consistency import ROUGH
from pincal.types import Array, Index, Mask


class MovingLegs:
    """Legs of one form, their indices, and their joints, which follow the platform's steps."""

    def __init__(
        self,
        places: list[int],
        every: Sequence[LegClosure],
        known: Sequence[Array],
        matrices: Array,
    ) -> None:
        """Take the legs of some indices, with passive joints that nearly close them at poses.

        ``known`` has each leg's readings, then influences, shape (N, n_active [+ n_influences]);
        poses have shape (N, 4, 4).
        """
        self.places, self.legs = places, [every[place] for place in places]
        rows = stacked([known[place] for place in places])
        joints = started(self.legs, repeated(matrices, len(places)), rows)
        self.joints = joints.reshape(len(places), len(matrices), -1)

    def closed(self, matrices: Array, joints: Array) -> Closure:
        """Return the legs' closures at poses, (N, 4, 4), stacked leg by leg."""
        flat = joints.reshape(-1, joints.shape[2])
        return evaluate(self.legs, flat, repeated(matrices, len(self.legs)))

    def in_mode(self, closure: Closure) -> Mask:
        """Return the mask of closures in the legs' working modes, shape (L, N)."""
        return in_home_modes(self.legs, closure).reshape(len(self.legs), -1)

    def at(self, matrices: Array, rows: Index) -> Closure:
        """Return the closures at rows; driven lines that a step turned over start anew."""
        closure = self.closed(matrices[rows], self.joints[:, rows])
        turned_over = ~self.in_mode(closure)
        lines = [i for i, leg in enumerate(self.legs) if turned_over[i].any() and is_line(leg)]
        for i in lines:
            lost, passive = rows[turned_over[i]], self.legs[i].leg.passive
            start = start_joints(self.legs[i], matrices[lost])[0]
            self.joints[i, lost[:, None], passive] = start[:, passive]
        return self.closed(matrices[rows], self.joints[:, rows]) if lines else closure

    def follow(self, closure: Closure, rows: Index, twists: Array) -> Array:
        """Move passive joints at rows by twists of the platform, (n, dof); return steps, (n,)."""
        every = np.tile(twists, (len(self.legs), 1))[:, :, None]
        step = closure.passive_step(product(closure.pose, every)[:, :, 0])
        step = step.reshape(len(self.legs), len(rows), -1)
        self.joints[:, rows[:, None], self.legs[0].leg.passive] += step
        return np.asarray(np.abs(step).max(axis=(0, 2), initial=0.0))


_WAY = 8  # steps on the way from home
_SAMPLES, _TRIES = 1000, 16  # poses about home, and those by whose nearest readings searches begin
_STEPS, _LARGEST = 40, 0.2  # largest number of Newton steps; largest step, over the size and [rad]
_SMALL = 1e-9  # step after which only rounding errors remain
_CLOSED = 1e-8  # gap of a closed leg, over its size
_TOLD = 1e-6  # least gap that the solution's text mentions, [m]
LOADS = 20
"""Largest number of iterations between loads and the configuration that they bend."""


@dataclass(frozen=True, repr=False)
class ForwardSolution:
    """Forward kinematics of N rows of readings."""

    poses: Array
    """Platform coordinates, shape (N, dof), [m] and [rad]; NaN where not found."""
    converged: Mask
    """Mask of rows, shape (N,), whose pose has the least gaps, in the modes of home. All legs are
    closed then if they have no more equations than the platform has freedoms."""
    gap: Array
    """Remaining gap of each leg, shape (N, n_legs), [m]; NaN where not found. It is a rounding
    error, or below a tenth of the size if more equations than freedoms contradict each other."""
    reasons: tuple[str, ...]
    """Reason why a row has no pose, length N; empty if it has one."""

    def __repr__(self) -> str:
        gap = np.max(self.gap, initial=0.0, where=np.isfinite(self.gap))
        apart = f"; readings contradict, legs stay up to {gap:.3g} m open" * bool(gap > _TOLD)
        count = np.count_nonzero(self.converged)
        return f"ForwardSolution: {count} of {len(self.poses)} poses{apart}"

    def __str__(self) -> str:
        """Return a page with the number of rows without a pose, by reason."""
        counts = Counter(reason for reason in self.reasons if reason)
        return "\n".join([repr(self), *(f"  {n}: {reason}" for reason, n in counts.most_common())])


@one_thread()
def forward(
    mechanism: GivenMechanism,
    readings: Array,
    guess: Poses | None = None,
    influences: Influences | None = None,
) -> ForwardSolution:
    """Return the poses of sensor readings, in the assembly mode of home.

    Without a guess the search starts at home, then follows readings from home, and then starts at
    sampled poses, so that far from home another pose in home's modes may be found. If there are
    more equations than freedoms and readings are not exact, no pose closes all legs: the pose has
    the least sum of squared gaps, and ``gap`` tells how much readings contradict. If drives leave
    freedoms open, a guess is needed, and the pose is near it.

    Args:
        mechanism: The mechanism, at its nominal parameters.
        readings: Sensor readings, shape (N, n_readings), [rad] or [m], legs in order.
        guess: N poses near the solutions, the only start of the search.
        influences: Influence quantities of terms, by column: see ``inverse``.

    Raises:
        MechanismError: readings or guess have a wrong shape, or are not finite; the leg of a homed
            sensor does not reach the home pose.
        MeasurementError: no term depends on an influence, or it has a wrong shape.
    """
    mechanism = as_mechanism(mechanism)
    names = mechanism.reading_names
    label = f"readings ({', '.join(names)})"
    readings = array_of(readings, ("N", len(names)), label, MechanismError)
    finite_rows(readings, "reading", MechanismError)
    platform, tolerance = mechanism.platform, ROUNDING * max(1.0, mechanism.size)
    homes = np.tile(platform.home, (len(readings), 1))
    start = platform.matrices(homes if guess is None else guess)
    if len(start) != len(readings):
        raise MechanismError(f"{len(readings)} readings, but {len(start)} guesses")
    columns = influence_columns(mechanism, influences, len(readings))
    if guess is None and (idle := platform.dof - mechanism.constraints) > 0:
        reason = f"the drives leave {idle} of the platform's {platform.dof} freedoms open"
        shapes = [(len(start), n) for n in (platform.dof, len(mechanism.legs))]
        nowhere, gap = (np.full(shape, np.nan) for shape in shapes)
        return ForwardSolution(nowhere, np.zeros(len(start), bool), gap, (reason,) * len(start))
    solution = _forward(mechanism, readings, start, columns)
    if guess is None:
        solution = _on_the_way(mechanism, readings, columns, solution)
    for _ in range(LOADS):  # loads follow from the pose, and move it little
        ok, before = solution.converged[:, None], solution.poses
        loaded = with_loads(mechanism, columns, np.where(ok, readings, np.nan), before)
        if loaded is columns:
            break
        near = np.where(ok, before, platform.from_matrices(start))
        solution = _forward(mechanism, readings, platform.matrices(near), loaded)
        if not (np.abs(solution.poses - before) > tolerance).any():
            break
    return solution


def _on_the_way(
    mechanism: Mechanism, readings: Array, columns: Array, solution: ForwardSolution
) -> ForwardSolution:
    """Return a solution whose missing rows were searched again: from home on, then all about."""
    lost = np.flatnonzero(~solution.converged)
    if not len(lost):
        return solution
    home, near = reading_range(mechanism)[2], np.tile(mechanism.platform.home, (len(lost), 1))
    for share in np.linspace(0.0, 1.0, _WAY + 1)[1:]:
        stage, guess = home + share * (readings[lost] - home), mechanism.platform.matrices(near)
        reached = _forward(mechanism, stage, guess, columns[lost])
        near = np.where(reached.converged[:, None], reached.poses, near)
    reasons = np.array(solution.reasons, dtype=object)
    reasons[lost] = reached.reasons
    solution.poses[lost], solution.gap[lost] = reached.poses, reached.gap
    starts, tree = _starts(mechanism)
    for place in range(1, 1 + min(_TRIES, len(starts))):
        lost = np.flatnonzero(reasons != "")
        near = starts[tree.query(readings[lost], [place])[1][:, 0]]
        reached = _forward(mechanism, readings[lost], near, columns[lost])
        ok, won = reached.converged, lost[reached.converged]
        solution.poses[won], solution.gap[won] = reached.poses[ok], reached.gap[ok]
        reasons[won] = ""
    return replace(solution, converged=reasons == "", reasons=tuple(reasons))


@lru_cache(maxsize=8)
def _starts(mechanism: Mechanism) -> tuple[Array, KDTree]:
    """Return poses about home, (N, 4, 4), that legs reach in their modes; a tree of readings."""
    platform, legs = mechanism.platform, nominal_legs(mechanism)
    ends = [np.pi if unit == "rad" else mechanism.size for unit in platform.units]
    twists = np.random.default_rng(0).uniform(-1.0, 1.0, (_SAMPLES, platform.dof)) * ends
    poses = platform.displaced(platform.home_pose[[0] * _SAMPLES].as_matrix(), twists)
    groups = close_legs(legs, poses)
    joints = by_leg(groups, lambda legs: np.where(legs.reached[:, None], legs.joints, np.nan))
    pairs = zip(legs, joints, strict=True)
    readings = [sensor_law(leg).reading(of_leg[:, leg.leg.active]) for leg, of_leg in pairs]
    reached = np.isfinite(np.hstack(readings)).all(axis=1) & (mechanism.constraints == platform.dof)
    return poses[reached], KDTree(np.hstack(readings)[reached])


def reading_range(mechanism: Mechanism) -> tuple[Array, Array, Array]:
    """Return readings at the limits of active joints, least and largest, and at home, (n,) each."""
    ends = []
    for closure in nominal_legs(mechanism):
        leg = closure.leg
        joints = np.array([*joint_range(leg), leg.home])[:, leg.active]
        ends.append(sensor_law(closure).reading(joints))
    low, high, home = np.concatenate(ends, axis=1)
    return np.minimum(low, high), np.maximum(low, high), home


def _forward(
    mechanism: Mechanism, readings: Array, guess: Array, columns: Array
) -> ForwardSolution:
    """Return forward kinematics at given influences, shape (N, n_influences)."""
    legs, platform = nominal_legs(mechanism), mechanism.platform
    known = [mechanism.known(leg, readings, columns) for leg in range(len(legs))]
    poses = np.full((len(readings), platform.dof), np.nan)
    gap = np.full((len(readings), len(legs)), np.nan)
    reasons = np.full(len(readings), "", dtype=object)
    for rows in chunks(len(readings)):
        at_rows = [columns_of_leg[rows] for columns_of_leg in known]
        matrices, reasons[rows], gaps = _solve(mechanism, legs, at_rows, guess[rows])
        solved = reasons[rows] == ""
        poses[rows][solved] = platform.from_matrices(matrices[solved])
        gap[rows][solved] = gaps[solved]
    return ForwardSolution(poses, reasons == "", gap, tuple(reasons))


def with_loads(
    mechanism: Mechanism, influences: Array, readings: Array, poses: Array | None = None
) -> Array:
    """Return influences, (N, n_influences), whose unknown loads are computed: see ``loads_at``."""
    if not mechanism.weighs:
        return influences
    places = [mechanism.influences.index(name) for name in mechanism.loaded]
    if not np.isnan(influences[:, places]).any():
        return influences
    loads, completed = loads_at(mechanism, readings, poses), influences.copy()
    for name, place in zip(mechanism.loaded, places, strict=True):
        column = completed[:, place]
        completed[:, place] = np.where(np.isnan(column), loads[name], column)
    return completed


def loads_at(mechanism: Mechanism, readings: Array, poses: Array | None = None) -> dict[str, Array]:
    """Return the loads of joints and links by column, (N,) each; NaN where a reading is missing.

    They are those of the machine as drawn, so that they do not depend on identified parameters, at
    poses (N, dof) in the base frame. Unknown poses follow from readings, (N, n_readings), or are
    home. The poses of an arm always follow from readings.
    """
    drawing, known = mechanism.drawing, np.isfinite(readings).all(axis=1)
    legs = nominal_legs(drawing)
    matrices = placed_by_arm(legs, [drawing.known(i, readings[known]) for i in range(len(legs))])
    if matrices is None:
        nowhere = np.full((len(readings), drawing.platform.dof), np.nan)
        coordinates = nowhere if poses is None else poses.copy()
        lost = known & ~np.isfinite(coordinates).all(axis=1)
        if lost.any():
            search = forward(drawing, readings[lost])
            near = np.where(search.converged[:, None], search.poses, drawing.platform.home)
            coordinates[lost] = near
        matrices = drawing.platform.matrices(coordinates[known])
    loads = {}
    for name, values in gravity_loads(drawing, readings[known], matrices).items():
        loads[f"{LOAD}_{name}"] = column = np.full(len(readings), np.nan)
        column[known] = values
    return loads


def _solve(
    mechanism: Mechanism, legs: Sequence[LegClosure], known: Sequence[Array], guess: Array
) -> tuple[Array, list[str], Array]:
    """Return poses (N, 4, 4), reasons, and gaps (N, n_legs), at readings in one chunk."""
    matrices = placed_by_arm(legs, known)
    matrices = guess.copy() if matrices is None else matrices
    by_form = grouped([leg.form for leg in legs], len(matrices))
    groups = [MovingLegs(places, legs, known, matrices) for places in by_form]
    platform, moving = mechanism.platform, np.ones(len(matrices), dtype=bool)
    turns = np.array([unit == "rad" for unit in platform.units], dtype=bool)
    for _ in range(_STEPS):
        rows = np.flatnonzero(moving)
        if not len(rows):
            break
        closures = [group.at(matrices, rows) for group in groups]
        twist = _platform_step(groups, closures)
        length = np.maximum(lengths(twist[:, ~turns]) / mechanism.size, lengths(twist[:, turns]))
        with np.errstate(divide="ignore", invalid="ignore"):
            twist = np.minimum(1.0, _LARGEST / length)[:, None] * twist
        moved = length
        for group, closure in zip(groups, closures, strict=True):
            moved = np.maximum(moved, group.follow(closure, rows, twist))
        finite = np.isfinite(moved)
        good = rows[finite]
        matrices[good] = platform.displaced(matrices[good], twist[finite])
        moving[rows] = finite & (moved > _SMALL)
    return matrices, *_reasons(mechanism, groups, matrices, moving)


def placed_by_arm(legs: Sequence[LegClosure], known: Sequence[Array]) -> Array | None:
    """Return poses (N, 4, 4) by a leg whose every joint is read; None if there is no such leg."""
    for leg, rows in zip(legs, known, strict=True):
        if leg.leg.is_arm:
            home = np.broadcast_to(leg.platform.home_pose.as_matrix(), (len(rows), 4, 4))
            return leg.frame(started((leg,), home, rows))
    return None


def _platform_step(groups: Sequence[MovingLegs], closures: Sequence[Closure]) -> Array:
    """Return the twist that closes all legs to first order, shape (N, dof)."""
    closed = [(group.places, closure) for group, closure in zip(groups, closures, strict=True)]
    lines = np.concatenate(by_leg(closed, lambda legs: legs.constraint_by_pose), axis=1)
    gaps = np.concatenate(by_leg(closed, lambda legs: legs.constraint), axis=1)
    return -least_squares(lines, gaps[:, :, None])[:, :, 0]


def _reasons(
    mechanism: Mechanism, groups: Sequence[MovingLegs], matrices: Array, moving: Mask
) -> tuple[list[str], Array]:
    """Return the reason why each row has no pose, empty if it has one, and the legs' gaps."""
    finite: Mask = np.asarray(np.isfinite(matrices).all(axis=(1, 2)))
    for group in groups:
        finite &= np.isfinite(group.joints).all(axis=(0, 2))
    closed = []
    for group in groups:
        homes = np.stack([leg.deformed(leg.leg.home[None]) for leg in group.legs])
        joints = np.where(finite[:, None], group.joints, homes)
        closed.append((group.places, group.closed(matrices, joints)))
    twist = _platform_step(groups, [closure for _, closure in closed])
    lines = by_leg(closed, lambda legs: legs.constraint_by_pose)
    gaps = np.stack(by_leg(closed, lambda legs: lengths(legs.gap)), axis=1)
    closes = finite & ~moving & (gaps.max(axis=1) <= ROUGH * mechanism.size)
    in_mode = platform_margin(mechanism, lines) > 0.0
    for group, (_, closure) in zip(groups, closed, strict=True):
        count, sizes = len(group.legs), np.array([[leg.size] for leg in group.legs])
        moved = product(closure.constraint_by_pose, np.tile(twist, (count, 1))[:, :, None])
        # readings contradict each other by the part that neither twists nor passive joints close
        contradiction = product(closure.normal, closure.constraint[:, :, None] + moved)[:, :, 0]
        closable = np.abs(closure.gap - contradiction).max(axis=1).reshape(count, -1)
        closes &= (closable <= _CLOSED * sizes).all(axis=0)
        in_mode &= group.in_mode(closure).all(axis=0)
    reasons = np.where(in_mode, "", "left the working or assembly mode of home")
    return np.where(closes, reasons, "no pose found that closes all legs").tolist(), gaps
