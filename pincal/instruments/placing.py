"""The pose of a camera from the rays along which it sees points that a machine moves.

With T_i the nominal poses, p_m points in the frame of the platform (or the room, if the platform
holds the camera and T_i are inverse poses), and e = R d rays turned into the camera's holder's
axes, R_i p_m + t_i − t is along e. For a given rotation R of the camera that is linear in its
position t and the points, so only the rotation is searched, from the 24 of a cube (variable
projection). No point and no pose of a board in a photograph needs to be known.

Hand–eye calibration is given for comparison: it takes the nominal machine as exact.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import RigidTransform, Rotation

from pincal.instruments.board import cv2
from pincal.types import Array

_POINTS, _POSES = 8, 40  # most points and poses in the search of a rotation
_BEST = 3  # number of rotations of the cube that are refined
_DRAWS = 4  # number of random sets of poses, since some may hold gross errors
_GROSS = 5.0  # times the median angle, from which a ray is left out
_ROUNDS = 3
_STILL = 1e-6  # motion of the platform over its distance, below which it stands still


def placed_by_rays(T: Array, rays: Array, points: Array | None) -> tuple[Array, Array] | None:
    """Return the position and rotation vector of a camera, (6,), and the points, (M, 3).

    Points that were seen once at most are NaN. The result is None if too little was seen, or if the
    machine's positions do not change.

    Args:
        T: Poses of what carries the points, shape (N, 4, 4).
        rays: Unit vectors in axes of the camera, shape (N, M, 3); NaN where not seen.
        points: Where the points are in the frame that moves, shape (M, 3), if known.
    """
    counts = np.isfinite(rays[..., 0])
    often = np.argsort(-counts.sum(axis=0), kind="stable")[:_POINTS]
    rows = np.flatnonzero(counts[:, often].sum(axis=1))
    extent = np.ptp(T[rows, :3, 3], axis=0) if len(rows) else np.zeros(3)
    if len(rows) < 4 or not extent.max() > _STILL:
        return None
    draw, candidates = np.random.default_rng(0), []
    known = None if points is None else points[often]
    for _ in range(_DRAWS if len(rows) > _POSES // 4 else 1):
        drawn = draw.choice(rows, min(_POSES, max(4, len(rows) // 2)), replace=False)
        part = _Rays(T[drawn], rays[np.ix_(drawn, often)], known)
        cube = Rotation.create_group("O").as_rotvec()
        order = np.argsort([part.cost(turn) for turn in cube])[:_BEST]
        candidates += [part.sought(cube[place]) for place in order]
    bundle = _Rays(T[rows], rays[np.ix_(rows, often)], known)
    turn = min(candidates, key=bundle.cost)
    for _ in range(_ROUNDS):
        bundle = bundle.without(turn)
        turn = bundle.sought(turn)
    place = np.concatenate((bundle.solution(turn)[0], turn))
    if points is not None:
        return place, points
    found = _Rays(T, rays, None).solution(turn, place[:3])[1]
    return place, np.where(counts.sum(axis=0)[:, None] > 1, found, np.nan)


class _Rays:
    """Rays to points at poses, and their distances from the points for a camera's rotation."""

    def __init__(self, T: Array, rays: Array, points: Array | None) -> None:
        self.T, self.points = T, points
        self.seen = np.isfinite(rays[..., 0])
        self.rays = np.where(self.seen[:, :, None], rays, 0.0)

    def solution(self, turn: Array, place: Array | None = None) -> tuple[Array, Array, Array]:
        """Return the camera's position, the points (M, 3), and the misses of rays (N, M, 3).

        Position and points that are not known are found by least squares.
        """
        R, t, e = self.T[:, :3, :3], self.T[:, :3, 3], self.rays @ _matrix(turn).T
        across = np.eye(3) - e[..., :, None] * e[..., None, :]  # projectors across the rays
        A = np.where(self.seen[:, :, None, None], across, 0.0)
        AR, RT, m = A @ R[:, None], R.transpose(0, 2, 1)[:, None], np.arange(1, A.shape[1] + 1)
        x, normal = np.full((len(m) + 1, 3), np.nan), np.zeros((len(m) + 1, 3, len(m) + 1, 3))
        x[0], x[1:] = (np.nan if known is None else known for known in (place, self.points))
        A_t, coupled = (A @ t[:, None, :, None])[..., 0], AR.sum(axis=0)
        right = np.vstack((A_t.sum(axis=(0, 1)), -(RT @ A_t[..., None]).sum(axis=0)[..., 0]))
        normal[0, :, 0], normal[m, :, m] = A.sum(axis=(0, 1)), (RT @ AR).sum(axis=0)
        normal[0, :, m], normal[m, :, 0] = -coupled, -coupled.transpose(0, 2, 1)
        free, square = np.isnan(x).ravel(), normal.reshape(x.size, x.size)
        right_free = (right.ravel() - square @ np.nan_to_num(x).ravel())[free]
        x[np.isnan(x)] = np.linalg.lstsq(square[np.ix_(free, free)], right_free, rcond=1e-9)[0]
        y = (R @ x[1:].T).transpose(0, 2, 1) + (t - x[0])[:, None]
        return x[0], x[1:], (A @ y[..., None])[..., 0]

    def cost(self, turn: Array) -> float:
        """Return the median distance of rays from their points; infinite if most are behind."""
        place, points, missed = self.solution(turn)
        e = self.rays @ _matrix(turn).T
        y = (self.T[:, :3, :3] @ points.T).transpose(0, 2, 1) + (self.T[:, :3, 3] - place)[:, None]
        ahead = np.einsum("nmi,nmi->nm", e, y)[self.seen] > 0.0
        if ahead.mean() < 0.5:
            return np.inf
        return float(np.median(np.linalg.norm(missed, axis=2)[self.seen]))

    def sought(self, turn: Array) -> Array:
        """Return the rotation vector near a given one that minimises the misses of rays."""
        misses = least_squares(
            lambda step: self.solution(_after(step, turn))[2].ravel(), np.zeros(3), max_nfev=15
        )
        return _after(misses.x, turn)

    def without(self, turn: Array) -> _Rays:
        """Return the rays without those that miss their points by far more than most."""
        missed = np.linalg.norm(self.solution(turn)[2], axis=2)
        usual = np.median(missed[self.seen])
        good = self.seen & (missed <= _GROSS * usual)
        return _Rays(self.T, np.where(good[:, :, None], self.rays, np.nan), self.points)


def board_in_camera(points: Array, rays: Array) -> Array | None:
    """Return T_camera_board of points (M, 3) from unit rays to them; None if there are too few."""
    ahead = np.isfinite(rays[:, 2]) & (rays[:, 2] > 0.0)
    if ahead.sum() < 4:
        return None
    plane = rays[ahead, :2] / rays[ahead, 2:]
    solved, turn, shift = cv2.solvePnP(points[ahead], plane, np.eye(3), None)
    if not solved:
        return None
    rotation = Rotation.from_rotvec(turn[:, 0])
    return RigidTransform.from_components(shift[:, 0], rotation).as_matrix()


def by_hand_eye(T: Array, boards: Array) -> tuple[Array, Array]:
    """Return T_holder_camera and T_carrier_board, (4, 4), with the machine's poses as exact.

    They solve T T_carrier_board = T_holder_camera T_camera_board for the rotations first, of which
    vec R_holder_camera is the sum of (R_camera_board ⊗ R) vec R_carrier_board (M. Shah 2013, like
    OpenCV's ``calibrateRobotWorldHandEye``).

    Args:
        T: Poses of what carries the board, in the frame of what holds the camera, (N, 4, 4).
        boards: T_camera_board, shape (N, 4, 4).
    """
    R, S = T[:, :3, :3], boards[:, :3, :3]
    K = sum(np.kron(S_i, R_i) for S_i, R_i in zip(S, R, strict=True))
    U, _, Vt = np.linalg.svd(K)
    ends = np.tile(np.eye(4), (2, 1, 1))
    for end, vector in zip(ends, (U[:, 0], Vt[0]), strict=True):
        M = vector.reshape(3, 3)  # transposed: of the inverse
        P, _, Q = np.linalg.svd(M * np.sign(np.linalg.det(M)))
        end[:3, :3] = P @ Q
    A = np.concatenate((np.broadcast_to(-np.eye(3), S.shape), S), axis=2).reshape(-1, 6)
    b = (T[:, :3, 3] @ ends[0, :3, :3].T - boards[:, :3, 3]).ravel()
    ends[:, :3, 3] = np.linalg.lstsq(A, b, rcond=None)[0].reshape(2, 3)
    camera, board = np.linalg.inv(ends)
    return camera, board


def _matrix(turn: Array) -> Array:
    return Rotation.from_rotvec(turn).as_matrix()


def _after(step: Array, turn: Array) -> Array:
    """Return the rotation vector of a turn followed by a small one."""
    return (Rotation.from_rotvec(step) * Rotation.from_rotvec(turn)).as_rotvec()
