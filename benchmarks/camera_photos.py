"""How accurate machines get by photos of a board: forecasts for docs/how_to/photos.md.

python benchmarks/camera_photos.py: minutes.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from pages import write_table
from scipy.spatial.transform import Rotation

import pincal
from pincal.instruments.board import Board

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
import arms

PIXEL = 0.3  # [px] what lens and board leave in photos of 12 megapixels
READING = 1e-6  # [m] or [rad]
PHOTOS = (20, 40, 80)
LENS = ((4000, 3000), 3600.0)  # 12 megapixels, 58 degrees wide
EYE_TILT = np.array([0.35, -0.25, 1.0])  # direction in which the camera stands off the board


def motion(T: np.ndarray, at: np.ndarray) -> dict[str, tuple[float, ...]]:
    """Return place and rotation vector of a frame that is turned as T."""
    turn = Rotation.from_matrix(T).as_rotvec()
    return {"at": tuple(at.tolist()), "rotation": tuple(turn.tolist())}


def scene(
    home: np.ndarray, board: Board, distance: float, in_hand: bool, unknown: bool
) -> pincal.Camera:
    """Return a camera that sees a board from a distance, one of them on the platform at home."""
    away = distance * EYE_TILT / np.linalg.norm(EYE_TILT)
    turn = np.eye(3) if not in_hand else np.diag([1.0, -1.0, -1.0])
    corner = turn @ np.array([*(-np.array(board.size) / 2), 0.0])
    lens = pincal.Lens(LENS[0], focal=LENS[1], distortion=(0.0,) * 5, unknown=unknown)
    if not in_hand:
        markers = pincal.Markers(board.points, **motion(turn, corner))
        R, t = home[:3, :3], home[:3, 3]
        at, towards = t + R @ away, t
        return pincal.Camera("eye", lens, markers, at=tuple(at), towards=tuple(towards))
    at = home[:3, 3] + home[:3, :3] @ (away + corner)
    markers = pincal.Markers(board.points, **motion(home[:3, :3] @ turn, at))
    return pincal.Camera("eye", lens, markers, True, at=(0.0,) * 3, towards=tuple(away))


def in_view(camera: pincal.Camera, poses: np.ndarray) -> np.ndarray:
    """Return at which poses, T_frame_platform, the whole board is in the image."""
    values = np.array([parameter.nominal for parameter in camera.parameters])
    pixels = camera.evaluate(poses, values, np.zeros((len(poses), len(camera.columns))))[0]
    pixels = pixels.reshape(len(poses), -1, 2)
    with np.errstate(invalid="ignore"):
        inside = (pixels > 0.0) & (pixels < np.array(LENS[0]) - 1.0)
    return inside.all(axis=(1, 2))


def machines() -> Iterator[tuple[str, pincal.Mechanism, np.ndarray, float, float]]:
    """Yield name, machine, poses that it reaches, side of a square and distance of the camera."""
    draw = np.random.default_rng(0)
    delta = pincal.new_mechanism("delta", rod=0.3)
    yield "delta, rods of 0.3 m", delta, pincal.sample_workspace(delta, 1000), 0.012, 0.45
    hexapod = pincal.new_mechanism("hexapod", base_radius=0.5)
    sizes = np.array([0.08, 0.08, 0.08, 0.2, 0.2, 0.2])
    poses = hexapod.platform.home + sizes * draw.uniform(-1.0, 1.0, (1000, 6))
    poses = poses[pincal.inverse(hexapod, poses).reached.all(axis=1)]
    yield "hexapod, 1 m across", hexapod, poses, 0.03, 0.9
    arm = arms.loaded("ur5")
    home = np.array([0.4, -1.4, 1.5, -1.6, -1.5, 0.3])
    readings = home + 0.8 * draw.uniform(-1.0, 1.0, (2000, 6))
    yield "UR5", arm, pincal.forward(arm, np.vstack((home, readings))).poses, 0.02, 0.6


def forecasts() -> Iterator[str]:
    """Yield the lines of the table."""
    counts = "".join(f" {count} photos |" for count in PHOTOS)
    yield f"| machine, board | camera | lens |{counts}"
    yield "|---|---|---|" + "---|" * len(PHOTOS)
    noise = pincal.Noise(0.0, 0.0, READING, pixel=PIXEL)
    for name, robot, poses, square, distance in machines():
        board = Board("board", "charuco", (8, 11), square)
        platform = robot.platform
        start = poses if robot.by_readings else np.vstack((platform.home, poses))
        matrices = platform.transforms(start).as_matrix()
        for in_hand in (False, True):
            for unknown in (True, False):
                camera = scene(matrices[0], board, distance, in_hand, unknown)
                good = start[in_view(camera, matrices)]
                setup = pincal.Setup(instruments=(camera,))
                cells = ""
                for count in PHOTOS:
                    columns = [*camera.columns]
                    plan = pincal.forecast(robot, good[:count], noise, columns, setup=setup)
                    cells += f" {1e3 * plan.platform_error(good[:200]).position:.3f} |"
                held = "on the platform" if in_hand else "in the room"
                known = "unknown" if unknown else "known"
                yield f"| {name}, squares of {1e3 * square:g} mm | {held} | {known} |{cells}"


if __name__ == "__main__":
    write_table("camera_photos", list(forecasts()))
