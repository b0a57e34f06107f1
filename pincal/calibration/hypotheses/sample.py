"""Measurements in the frame of the nominal machine: rows by which hypotheses are judged.

If the base is at an unknown place, forward kinematics of the readings says where the nominal
machine was, and the best rigid motion takes that to what was measured (Kabsch 1976). Orientations
that were not measured are those of forward kinematics.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from pincal.estimation.observability.gauge import frame_motions
from pincal.estimation.observability.indices import DIFFER, changes_of
from pincal.kinematics.batches import CHUNK, chunks, stacked
from pincal.kinematics.closing import home_mode, mode_sign
from pincal.kinematics.closure import LegClosure, largest_size, nominal_legs
from pincal.kinematics.derivatives import demands
from pincal.kinematics.forward import forward
from pincal.kinematics.nearest_closure import NEWTON, nearest_closure
from pincal.model.measurements import Measurements
from pincal.model.mechanism import Mechanism
from pincal.model.orientation import WAYS
from pincal.model.setup import ORIGIN, Setup
from pincal.types import Array, Index, Mask


@dataclass(frozen=True)
class Rule:
    """What measurements are questioned by, and what explains them."""

    questioned: float = 0.02
    """Misfit over the stroke that was measured, from which measurements are questioned."""
    each: float = 3.0
    """By which each fault that is put right divides the misfit."""
    equal: float = 2.0
    """Times the misfit that the best leaves: cannot be separated from it."""
    precise: float = 1e-4
    """Gaps that are none, of the leg's size."""
    still: float = 1e-3
    """Readings that differ by less hardly move, of a leg's size and [rad]."""
    follows: float = 0.5
    """What is left of readings that follow the nominal ones, of the stroke."""
    past: float = 0.1
    """Past half a turn from home that a joint may be read, [rad]: readings have their cut there."""
    round: float = 0.03
    """Share by which readings may miss a whole multiple of what they should be."""
    scales: tuple[float, ...] = (2.0, 4.0, 10.0, 100.0, 0.5, 0.25, 0.1, 0.01)
    """Times that readings may be too large, where poses do not say it."""
    slip: float = 10.0
    """Times the median that a row misses by, if fewer than one row in so many does."""
    shifts: tuple[int, ...] = (1, -1, 2, -2)
    """Rows by which logs of poses and readings are out of step."""
    chance: float = 1e-5
    """Probability of so much motion as one body by chance, above which it is none."""
    matters: float = 0.25
    """Of the platform's error: a motion of less is not worth a warning."""
    rows: int = 500
    """Enough to judge by."""
    rows_forward: int = 100
    """Enough, where forward kinematics is needed."""
    rows_framed: int = 40
    """Enough, where another frame is tried."""
    rows_moved: int = 200
    """Enough, where the motion of a body is looked for."""
    rows_zeros: int = 12
    """Enough, where zeros of motors are tried in an unknown frame."""
    zeros: int = 12
    """Of a motor that are tried at a time, over a turn first, then over a cell of the last."""
    alignments: int = 30
    """Steps by which frame and target are aligned together."""
    times: int = 3
    """That zeros are tried."""


RULE = Rule()


Rows = Index


@dataclass(frozen=True)
class Sample:
    """Some rows of measurements."""

    mechanism: Mechanism
    poses: Array
    """Coordinates, shape (N, dof); of orientations that were not measured, home's."""
    readings: Array
    """Shape (N, n_readings), [rad] or [m]; NaN where not measured."""
    log: Array
    """Readings of all rows of the measurements."""
    rows: Rows
    """Which of them these rows are, shape (N,)."""
    offset: Array
    """Of the target whose positions were measured, in the platform frame, shape (3,), [m]."""
    oriented: bool
    """Whether orientations were measured."""
    free: bool
    """Whether the base is at an unknown place in the frame of the measurements."""
    placed_target: bool
    """Whether the target's place on the platform is known."""
    ways: tuple[str, ...]
    """In which orientations may have been written, keys of ``WAYS``."""

    def matrices(self) -> Array:
        """Return poses as homogeneous matrices, shape (N, 4, 4)."""
        return self.mechanism.platform.matrices(self.poses)

    def moved(self, positions: Array, turns: Array) -> Array:
        """Return the coordinates of positions (N, 3) and rotation matrices (N, 3, 3)."""
        matrices = np.tile(np.eye(4), (len(positions), 1, 1))
        matrices[:, :3, 3], matrices[:, :3, :3] = positions, turns
        return self.mechanism.platform.from_matrices(matrices)

    def part(self, chosen: Rows) -> Sample:
        """Return some of the rows."""
        poses, readings, rows = self.poses[chosen], self.readings[chosen], self.rows[chosen]
        return replace(self, poses=poses, readings=readings, rows=rows)


def sample_of(mechanism: Mechanism, data: Measurements, setup: Setup) -> Sample | None:
    """Return rows to judge by; None if there are none, or only the target's place is unknown.

    Rows with complete poses; if there are none such, with positions and all readings.
    """
    target, platform = setup.targets[ORIGIN], mechanism.platform
    known = np.isfinite(data.poses)
    rows, oriented = np.flatnonzero(known.all(axis=1)), True
    if len(rows) < 2:
        whole = np.isfinite(data.readings).all(axis=1)
        rows = np.flatnonzero(known[:, : platform.units.count("m")].all(axis=1) & whole)
        oriented = False
    free = setup.unknown_frame
    if len(rows) < 2 or (target.unknown and np.any(target.offset) and not free):
        return None
    most = RULE.rows if oriented and not free else RULE.rows_forward
    rows = rows[:: -(-len(rows) // most)]
    poses = np.where(known[rows], data.poses[rows], platform.home)
    readings, offset = data.readings, np.array(target.offset, dtype=float)
    ways = _ways(data)
    known_target = not (free and target.unknown)
    return Sample(
        mechanism, poses, readings[rows], readings, rows, offset, oriented, free, known_target, ways
    )


def whole_sample(mechanism: Mechanism, data: Measurements, setup: Setup) -> Sample:
    """Return all rows, whatever was measured of them: to put them right, not to judge by."""
    poses = np.where(np.isfinite(data.poses), data.poses, mechanism.platform.home)
    offset, every = np.array(setup.targets[ORIGIN].offset, dtype=float), np.arange(len(data))
    turned = [unit == "rad" for unit in mechanism.platform.units]
    oriented = bool(np.isfinite(data.poses[:, turned]).all(axis=1).any())
    readings, free = data.readings, setup.unknown_frame
    ways = _ways(data)
    return Sample(mechanism, poses, readings, readings, every, offset, oriented, free, True, ways)


def _ways(data: Measurements) -> tuple[str, ...]:
    return (data.written,) if data.written else tuple(WAYS)


def placed(samples: Sequence[Sample]) -> list[tuple[Array, Rows] | None]:
    """Return poses ``T_base_platform``, shape (M, 4, 4), and their rows in the sample, (M,).

    None if readings and measurements cannot be brought together.

    Args:
        samples: The same rows of the same measurements, put right in several ways.
    """
    if not samples[0].free and samples[0].oriented:
        seen = [(sample, sample.matrices()) for sample in samples]
        return [(_on_platform(T, _target(one)), np.arange(len(T))) for one, T in seen]
    known = [np.flatnonzero(np.isfinite(sample.readings).all(axis=1)) for sample in samples]
    readings = np.concatenate(
        [sample.readings[own] for sample, own in zip(samples, known, strict=True)]
    )
    distinct, index = np.unique(readings, axis=0, return_inverse=True)
    with np.errstate(all="ignore"):
        found = forward(samples[0].mechanism, distinct)
    apart = np.split(index.ravel(), np.cumsum([len(own) for own in known])[:-1])
    return [
        _placed(sample, own, found.poses[rows], found.converged[rows])
        for sample, own, rows in zip(samples, known, apart, strict=True)
    ]


def _placed(
    sample: Sample, known: Rows, poses: Array, converged: Mask
) -> tuple[Array, Rows] | None:
    """Return poses and rows of a sample, given those that its known rows' readings lead to."""
    good = known[converged]
    if 2 * len(good) < len(known) or len(good) < 3:
        return None
    measured = sample.matrices()
    here = sample.mechanism.platform.matrices(poses[converged])
    F, X = _motion(sample, here, measured[good]) if sample.free else np.eye(4), _target(sample)
    if not sample.placed_target:
        F, X = _both_frames(sample, here, measured[good], F)
    back = np.linalg.inv(F)
    if sample.oriented:
        return _on_platform(back @ measured, X), np.arange(len(measured))
    here[:, :3, 3] = measured[good, :3, 3] @ back[:3, :3].T + back[:3, 3]
    X[:3, :3] = np.eye(3)  # orientations are the platform's
    return _on_platform(here, X), good


def _target(sample: Sample) -> Array:
    """Return ``T_platform_target`` of a target that is not turned, shape (4, 4)."""
    X = np.eye(4)
    X[:3, 3] = sample.offset
    return X


def _on_platform(targets: Array, X: Array) -> Array:
    """Return the platform's poses where those of its target are, shapes (N, 4, 4)."""
    turns = targets[:, :3, :3] @ X[:3, :3].T
    targets[:, :3, 3] -= turns @ X[:3, 3]
    targets[:, :3, :3] = turns
    return targets


def _both_frames(sample: Sample, here: Array, there: Array, F: Array) -> tuple[Array, Array]:
    """Return ``T_frame_base`` and ``T_platform_target`` that take ``here`` to ``there``.

    There = F here X in least squares of lengths, by Gauss–Newton from a frame near it: in turn,
    the two would come to rest but slowly where platforms turn little.

    Args:
        sample: Measurements of a target.
        here: The nominal machine's poses, shape (N, 4, 4).
        there: The target's where they were measured, shape (N, 4, 4).
        F: The frame for the target where it is said to be.
    """
    platform = sample.mechanism.platform
    size, plane = largest_size(sample.mechanism.legs), platform.space == 2
    back, X, R = np.linalg.inv(F), _target(sample), here[:, :3, :3]
    turned = range(3) if sample.oriented and "rad" in platform.units else ()
    free = [0, 1, 5, 6, 7, 11] if plane else list(range(12))
    free = free if turned else [k for k in free if k < 9]
    for _ in range(RULE.alignments):
        seen = back @ there
        errors = [here[:, :3, 3] + R @ X[:3, 3] - seen[:, :3, 3]]
        ones, none = np.tile(np.eye(3), (len(here), 1, 1)), np.zeros((len(here), 3, 3))
        columns = [np.concatenate((-ones, _cross(seen[:, :3, 3]), R, none), axis=2)]
        for k in turned:
            errors.append(size * (R @ X[:3, k] - seen[:, :3, k]))
            by_turn = -R @ _cross(X[None, :3, k])
            columns.append(
                np.concatenate((none, _cross(seen[:, :3, k]), none, by_turn), axis=2) * size
            )
        J = np.concatenate(columns).reshape(-1, 12)[:, free]
        step = np.zeros(12)
        step[free] = np.linalg.lstsq(J, -np.concatenate(errors).ravel(), rcond=1e-6)[0]
        moved = np.eye(4)
        moved[:3, :3], moved[:3, 3] = Rotation.from_rotvec(step[3:6]).as_matrix(), step[:3]
        back = moved @ back
        X[:3, 3] += step[6:9]
        X[:3, :3] = Rotation.from_rotvec(step[9:]).as_matrix() @ X[:3, :3]
        if np.abs(step).max() < RULE.precise * min(size, 1.0):
            break
    return np.linalg.inv(back), X


def _cross(vectors: Array) -> Array:
    """Return the matrices [v]× of vectors (N, 3), shape (N, 3, 3)."""
    return np.asarray(np.cross(np.eye(3), vectors[:, None, :]))


def _motion(sample: Sample, here: Array, there: Array) -> Array:
    """Return the rigid motion that takes the nominal machine's poses to the measured ones."""
    platform, count = sample.mechanism.platform, len(here)
    size = largest_size(sample.mechanism.legs)
    a = here[:, :3, 3] + here[:, :3, :3] @ sample.offset
    b = there[:, :3, 3]
    vectors = [(a - a.mean(axis=0), b - b.mean(axis=0))]
    if sample.oriented and "rad" in platform.units:
        vectors += [(size * here[:, :3, k], size * there[:, :3, k]) for k in range(3)]
    elif platform.space == 2:
        vectors.append((np.tile([0.0, 0.0, 1e3 * size], (count, 1)),) * 2)
    A, B = (np.concatenate(one) for one in zip(*vectors, strict=True))
    F = np.eye(4)
    U, _, Vt = np.linalg.svd(B.T @ A)
    F[:3, :3] = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    F[:3, 3] = b.mean(axis=0) - F[:3, :3] @ a.mean(axis=0)
    return F


_SEARCH = replace(NEWTON, steps=20)  # legs that close need fewer
_ROUNDS = 5  # of least squares on the way to the least sum of absolute values


@dataclass(frozen=True)
class LegFit:
    """How measurements fit a leg; lengths over the leg's size."""

    gap: float
    """Median closure residual at the nominal parameters; NaN with fewer than two rows."""
    left: Array
    """Closure residual at the parameters near nominal that fit best, of each row, (N,); NaN
    where there is no reading."""
    stroke: float
    """By how much readings move the leg's end over the rows: median."""
    bent: int
    """Rows that close the leg in another working mode than home's."""

    @property
    def rows(self) -> int:
        """Rows with a reading."""
        return int(np.isfinite(self.left).sum())

    @property
    def as_home(self) -> bool:
        """Whether most rows close the leg in home's working mode."""
        return 2 * self.bent <= self.rows

    @property
    def near(self) -> float:
        """What machines near nominal leave of the gaps; all, if machines do not differ so far."""
        return self.gap if not self.gap <= DIFFER else min(self.gap, float(np.nanmedian(self.left)))

    @property
    def misfit(self) -> float:
        """The leg's share in a hypothesis' score: what is left, or 1 in another working mode."""
        return max(self.near, RULE.precise) if self.as_home else max(1.0, self.gap)

    @property
    def questioned(self) -> bool:
        """Whether machines near nominal leave much of what was measured."""
        most = max(min(RULE.questioned * self.stroke, DIFFER), RULE.precise)
        return self.rows > 1 and not self.near <= most


@dataclass(frozen=True)
class LegMeasurements:
    """What was measured of one leg."""

    leg: int
    """Which, of the mechanism's."""
    matrices: Array
    """Poses ``T_base_platform``, shape (N, 4, 4)."""
    readings: Array
    """Shape (N, n_active), [rad] or [m]; NaN where not measured."""

    @property
    def whole(self) -> Mask:
        """Which rows have readings, shape (N,); none of a single one."""
        found = np.isfinite(self.readings).all(axis=1)
        return np.asarray(found & (found.sum() > 1))

    def known(self) -> LegMeasurements:
        """Return the rows with readings."""
        own = self.whole
        return replace(self, matrices=self.matrices[own], readings=self.readings[own])


def leg_fits(
    mechanism: Mechanism, given: Sequence[LegMeasurements], *, free: bool = False
) -> list[LegFit]:
    """Return how each of several sets of measurements fits its leg.

    Those of alike legs, as many rows each, are evaluated in one call.

    Args:
        mechanism: The mechanism.
        given: The sets.
        free: Whether the base was placed by alignment only, and may lie nearby.
    """
    known, legs = [one.known() for one in given], nominal_legs(mechanism)
    fits = [LegFit(np.nan, np.full(len(one.readings), np.nan), np.nan, 0) for one in given]
    groups: dict[tuple[object, int], list[int]] = {}
    for place, one in enumerate(known):
        if count := len(one.readings):
            groups.setdefault((legs[one.leg].form, count), []).append(place)
    for (_, count), group in groups.items():
        for chunk in chunks(len(group), max(1, CHUNK // count)):
            found = _fitted(legs, [known[place] for place in group[chunk]], free)
            for place, fit in zip(group[chunk], found, strict=True):
                left = fits[place].left
                left[given[place].whole] = fit.left
                fits[place] = replace(fit, left=left)
    return fits


def _fitted(
    legs: Sequence[LegClosure], sets: Sequence[LegMeasurements], free: bool
) -> list[LegFit]:
    """Return how sets of alike legs fit, all rows of which are known, as many in each set."""
    own, count = [legs[one.leg] for one in sets], len(sets[0].readings)
    leg, matrices = own[0].leg, stacked([one.matrices for one in sets])
    said = [one.readings for one in sets]
    # rows of one leg are rows of one call, whatever its form; alike legs stand below each other
    alone = len({one.leg for one in sets}) == 1
    called, known = (own[:1], [stacked(said)]) if alone else (own, said)

    def by_set(parts: Sequence[Array]) -> Array:
        whole: Array = stacked(parts)
        return whole.reshape(len(sets), count, *whole.shape[1:])

    with np.errstate(all="ignore"):  # units may be far off
        closed, _ = nearest_closure(called, matrices, known, newton=_SEARCH)
        missed = np.nan_to_num(np.linalg.norm(closed.constraint, axis=1), nan=np.inf)
        rows = demands(called, closed, known)
        sizes = np.array([one.size for one in own])
        changes = np.stack([changes_of(one.leg, one.size) for one in own])
        J = by_set([row.parameter for row in rows]) * changes[:, None, None]
        if free:
            platform = own[0].platform
            base = frame_motions(platform, matrices)[:, :, : -platform.dof]
            base = base.reshape(len(sets), count, *base.shape[1:])
            lengths = np.arange(base.shape[3]) < platform.space
            scales = DIFFER * np.where(lengths, sizes[:, None, None, None], 1.0)
            by_base = by_set([row.pose for row in rows]) @ (base * scales)
            J = np.concatenate((J, by_base), axis=3)
        lefts = _left(sizes, J, by_set([row.value for row in rows]))
        strokes = _stroke(by_set([row.reading for row in rows]), np.stack(said)) / sizes
        gaps = np.median(missed.reshape(len(sets), count), axis=1) / sizes
    modes = np.repeat([home_mode(one.leg, one.platform) for one in own], count)
    # joints that are all read bend as they do
    bent = (mode_sign(closed) * modes < 0.0) & bool(leg.passive)
    bends = bent.reshape(len(sets), count).sum(axis=1)
    found = zip(gaps.tolist(), lefts, strokes.tolist(), bends.tolist(), strict=True)
    return [LegFit(*one) for one in found]


def _left(sizes: Array, J: Array, value: Array) -> Array:
    """Return the gaps that parameters near nominal leave, over the legs' sizes, shape (P, N).

    To first order, of least absolute values (rows with a slip count little), parameters known as
    well as machines follow their drawings, and no farther from nominal than that.

    Args:
        sizes: Of the legs, shape (P,), [m].
        J: Change of the gaps by as much as each parameter may differ, shape (P, N, k, n), [m].
        value: The gaps in P sets of measurements, shape (P, N, k), [m].
    """
    parts, N, k, n = J.shape
    result = np.full((parts, N), 1.0)
    fine = np.isfinite(J).all(axis=(1, 2, 3)) & np.isfinite(value).all(axis=(1, 2))
    precise = RULE.precise * sizes[fine, None, None]
    J, value = J[fine] / precise[..., None], value[fine] / precise
    weights, usual = np.ones(value.shape[:2]), np.ones((len(value), 1))
    J, value = J.reshape(-1, N * k, n), value.reshape(-1, N * k)
    for _ in range(_ROUNDS):
        each = np.repeat(weights**2, k, axis=1)
        weighted = (J * each[:, :, None]).transpose(0, 2, 1)
        normal = weighted @ J + np.square(usual)[:, :, None] * np.eye(n)
        step = np.linalg.solve(normal, -weighted @ value[:, :, None])
        step /= np.maximum(np.abs(step).max(axis=1, initial=0.0, keepdims=True), 1.0)
        rest = (value + (J @ step)[:, :, 0]).reshape(-1, N, k)
        left = np.linalg.norm(rest, axis=2)
        usual = np.maximum(np.median(left, axis=1, keepdims=True), 1.0)
        weights = 1.0 / np.sqrt(np.maximum(left / usual, 1.0))
    result[fine] = RULE.precise * left
    return result


def _stroke(by_reading: Array, readings: Array) -> Array:
    """Return the median distance over which readings move the leg's end from the usual, [m].

    Args:
        by_reading: Of P sets of measurements, shape (P, N, k, n_active).
        readings: Shape (P, N, n_active).
    """
    moved = readings - np.median(readings, axis=1, keepdims=True)
    far = np.linalg.norm(by_reading * moved[:, :, None], axis=(2, 3))
    return np.asarray(np.median(far, axis=1))
