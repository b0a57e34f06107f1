"""Photos of boards, rendered: perspective, distortion, blur, noise, 12 bits; and where points are.

Each pixel is the mean of the pattern over its area; rays and pixels are OpenCV's.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path

import cv2
import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation

from pincal.instruments.board import Board

_SAMPLES = 6  # a pixel, along each side
_UNITS = 240  # a square's side, in which markers of 0.7 have whole bits
_RIM = 160  # of the same units, white around the board


@dataclass(frozen=True)
class Pinhole:
    """A lens as OpenCV has it."""

    size: tuple[int, int] = (640, 480)
    focal: float = 800.0
    centre: tuple[float, float] = (325.0, 233.0)
    distortion: tuple[float, ...] = (-0.12, 0.05, 0.0008, -0.0005, 0.0)

    @property
    def K(self) -> np.ndarray:
        """Camera matrix, shape (3, 3)."""
        (u, v), f = self.centre, self.focal
        return np.array([[f, 0, u], [0, f, v], [0, 0, 1.0]])

    def pixels(self, points: np.ndarray) -> np.ndarray:
        """Return pixels of points in the camera's axes, (n, 3) to (n, 2)."""
        zero = np.zeros(3)
        seen = cv2.projectPoints(points, zero, zero, self.K, np.array(self.distortion))
        return np.asarray(seen[0][:, 0])

    def rays(self, pixels: np.ndarray) -> np.ndarray:
        """Return directions with depth 1 of pixels, (n, 2) to (n, 2)."""
        stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 20, 1e-10)
        distortion = np.array(self.distortion)
        found = cv2.undistortPoints(pixels, self.K, distortion, None, None, None, stop)
        return np.asarray(found[:, 0])


@cache
def texture(board: Board) -> np.ndarray:
    """Return the board's grey values, ``_UNITS`` a square, row 0 at its top, within its rims."""
    columns, rows = board.squares
    picture = np.ones((rows * _UNITS, columns * _UNITS))
    for x, y, width, height in np.rint(board.black * _UNITS / board.square).astype(int):
        top = rows * _UNITS - y - height
        picture[top : top + height, x : x + width] = 0.0
    pattern = np.pad(0.08 + 0.8 * picture, _RIM, constant_values=0.88)
    return np.pad(pattern, 1, constant_values=0.75).astype(np.float32)


def photograph(
    board: Board,
    T_camera_board: np.ndarray,
    lens: Pinhole,
    *,
    blur: float = 0.7,
    noise: float = 0.004,
    seed: int = 0,
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Return a photo in 12 bits, and the pixels of the board's points that are in it.

    Args:
        board: The board, as it was printed (its scale included).
        T_camera_board: Where it is in the camera's axes, shape (4, 4).
        lens: The lens.
        blur: Standard deviation of the blur, [px].
        noise: Of grey values, of white.
        seed: Of noise.
    """
    R, t = T_camera_board[:3, :3], T_camera_board[:3, 3]
    picture = _rendered(board, T_camera_board.tobytes(), lens, blur)
    shot = np.sqrt(0.3 + 0.7 * picture) * noise
    picture = picture + shot * np.random.default_rng(seed).standard_normal(picture.shape)
    grey = np.clip(np.rint(picture * 4095), 0, 4095).astype(np.uint16)
    truth = lens.pixels(np.array(list(board.points.values())) @ R.T + t)
    inside = ((truth > 0) & (truth < np.array(lens.size) - 1)).all(axis=1)
    named = zip(board.points, truth, inside, strict=True)
    return grey, {name: pixel for name, pixel, ok in named if ok}


@lru_cache(maxsize=32)
def _rendered(board: Board, T_camera_board: bytes, lens: Pinhole, blur: float) -> np.ndarray:
    """Return the grey values of a photo without noise, of which others differ by noise alone."""
    T = np.frombuffer(T_camera_board).reshape(4, 4)
    R, t = T[:3, :3], T[:3, 3]
    width, height = lens.size
    picture = np.full((height, width), 0.75)  # a wall behind
    size = np.array(board.size) * board.scale
    edge = 0.02 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])  # the board's white rim
    outline = size * [[0, 0], [1, 0], [1, 1], [0, 1]] + edge
    seen = lens.pixels(np.column_stack((outline, np.zeros(4))) @ R.T + t)
    low = np.clip(np.floor(seen.min(axis=0)).astype(int) - 3, 0, np.array(lens.size) - 1)
    high = np.clip(np.ceil(seen.max(axis=0)).astype(int) + 3, low + 1, lens.size)
    u, v = np.meshgrid(np.arange(low[0], high[0]), np.arange(low[1], high[1]))
    pixels = np.column_stack((u.ravel(), v.ravel())).astype(float)
    rays = lens.rays(pixels).reshape(*u.shape, 2)
    by_v, by_u = (slope.reshape(-1, 2).T for slope in np.gradient(rays, axis=(0, 1)))
    x, y = rays.reshape(-1, 2).T
    H = np.linalg.inv(np.column_stack((R[:, 0], R[:, 1], t)))  # of rays to the board
    per_metre = _UNITS / board.square / np.array(board.scale)
    total = np.zeros(u.shape)
    for du, dv in np.ndindex(_SAMPLES, _SAMPLES):
        step = (np.array([du, dv]) + 0.5) / _SAMPLES - 0.5
        sx = x + by_u[0] * step[0] + by_v[0] * step[1]
        sy = y + by_u[1] * step[0] + by_v[1] * step[1]
        a, b, c = (row[0] * sx + row[1] * sy + row[2] for row in H)
        column, row = a / c * per_metre[0], board.squares[1] * _UNITS - b / c * per_metre[1]
        maps = [(m + _RIM + 0.5).reshape(u.shape).astype(np.float32) for m in (column, row)]
        total += cv2.remap(texture(board), *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    picture[low[1] : high[1], low[0] : high[0]] = total / _SAMPLES**2
    return gaussian_filter(picture, blur) if blur else picture


def facing(board: Board, distance: float, tilt: tuple[float, float, float]) -> np.ndarray:
    """Return T_camera_board of a board whose middle is on the axis, turned by a rotation vector."""
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec(tilt).as_matrix() @ np.diag([1.0, -1.0, -1.0])
    T[:3, 3] = [0, 0, distance] - T[:3, :3] @ [board.size[0] / 2, board.size[1] / 2, 0]
    return T


def save(path: Path, grey: np.ndarray) -> Path:
    """Write a photo in 12 bits, or 8 bits if it is a JPEG."""
    if path.suffix == ".jpg":
        grey = np.rint(grey / 4095 * 255).astype(np.uint8)
    assert cv2.imwrite(str(path), grey)
    return path
