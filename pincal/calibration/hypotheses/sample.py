"""Measurements in the frame of the nominal machine: rows by which hypotheses are judged.

If the base is at an unknown place, forward kinematics of the readings says where the nominal
machine was, and the best rigid motion takes that to what was measured (Kabsch 1976). Orientations
that were not measured are those of forward kinematics.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pincal.calibration.hypotheses.rule import RULE
from pincal.kinematics.forward import forward
from pincal.kinematics.legs.closure import largest_size
from pincal.model.measuring.measurements import Measurements
from pincal.model.measuring.setup import ORIGIN, Setup
from pincal.model.mechanism import Mechanism
from pincal.model.orientation import WAYS

Array = NDArray[np.float64]
Rows = NDArray[np.intp]


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
        seen = [(one, one.matrices()) for one in samples]
        return [(_on_platform(T, _target(one)), np.arange(len(T))) for one, T in seen]
    known = [np.flatnonzero(np.isfinite(one.readings).all(axis=1)) for one in samples]
    readings = np.concatenate([one.readings[own] for one, own in zip(samples, known, strict=True)])
    distinct, index = np.unique(readings, axis=0, return_inverse=True)
    with np.errstate(all="ignore"):
        found = forward(samples[0].mechanism, distinct)
    apart = np.split(index.ravel(), np.cumsum([len(own) for own in known])[:-1])
    return [
        _placed(sample, own, found.poses[rows], found.converged[rows])
        for sample, own, rows in zip(samples, known, apart, strict=True)
    ]


def _placed(
    sample: Sample, known: Rows, poses: Array, converged: NDArray[np.bool_]
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
