"""Two real arms of seven joints seen by a laser tracker, and an independent fit by SciPy.

The data (public, of ctu-vras/multirobot-calibration) are looked for beside the project, or where
``PINCAL_DATA`` says. The fit uses NumPy and SciPy alone.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

import pincal
from pincal.formats.arm import arm

Array = NDArray[np.float64]
DATA = Path(os.environ.get("PINCAL_DATA", Path(__file__).parents[2] / "shared" / "data"))
SIDES = ("left", "right")
NAMES = ("E", "S", "L", "U", "R", "B", "T")
#: Nominal Denavit-Hartenberg table, Rz(θ + q) Tz(d) Tx(a) Rx(α): a [m], d [m], α, θ [rad]. The
#: first angle α is that of the left arm, and the opposite of the right one.
TABLE = [
    (0.0, -0.263, np.radians(-15.0), -np.pi / 2),
    (0.15, 1.4159, -np.pi / 2, 0.0),
    (0.614, 0.0, np.pi, -np.pi / 2),
    (0.2, 0.0, -np.pi / 2, 0.0),
    (0.0, -0.64, np.pi / 2, 0.0),
    (0.03, 0.0, np.pi / 2, -np.pi / 2),
    (0.0, 0.2, 0.0, 0.0),
    (0.05, 0.25, 0.0, 0.0),
]


def data_file(side: str) -> Path:
    """Return where the measurements of an arm are, if they are there."""
    return DATA / f"motoman_{side}" / "measurements.csv"


def table_of(side: str) -> list[tuple[float, float, float, float]]:
    """Return the nominal table of an arm."""
    (a, d, alpha, theta), *rest = TABLE
    return [(a, d, alpha if side == "left" else -alpha, theta), *rest]


def link(a: float, d: float, alpha: float, theta: float) -> Array:
    """Return one row's transform, shape (4, 4)."""
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_euler("ZX", [theta, alpha]).as_matrix()
    matrix[:3, 3] = a * np.cos(theta), a * np.sin(theta), d
    return matrix


def _placement(matrix: Array) -> pincal.Placement:
    x, y, z = matrix[:3, 3].tolist()
    roll, pitch, yaw = Rotation.from_matrix(matrix[:3, :3]).as_euler("xyz").tolist()
    return pincal.Placement(xyz=(x, y, z), rpy=(roll, pitch, yaw))


@cache
def mechanism(side: str) -> pincal.Mechanism:
    """Return the arm of the nominal table; each joint turns about z before its row."""
    table, joints, before = table_of(side), [], np.eye(4)
    for name, row in zip(NAMES, table, strict=False):
        joints.append(
            pincal.Joint(f"q_{name}", "revolute", _placement(before), lower=-np.inf, upper=np.inf)
        )
        before = link(*row)
    joints.append(pincal.Joint("reflector", "fixed", _placement(before @ link(*table[7]))))
    return arm("motoman", tuple(joints))


@cache
def measurements(side: str) -> pincal.Measurements:
    """Return positions of the reflector in the tracker's frame, and readings."""
    table = np.genfromtxt(
        data_file(side), delimiter=",", names=True, deletechars="", encoding="utf-8"
    )
    columns = {name: table[name] for name in table.dtype.names or ()}

    def starting(start: str) -> Array:
        return next(values for name, values in columns.items() if name.startswith(start))

    readings = np.column_stack([starting(f"q_{name}") for name in NAMES])
    poses = np.full((len(readings), 6), np.nan)
    poses[:, :3] = np.column_stack([starting(axis) for axis in "xyz"])
    return pincal.Measurements(poses=poses, readings=readings)


def split(side: str, seed: int) -> tuple[Array, Array]:
    """Return rows to fit, 70 %, and rows held out."""
    count = len(measurements(side))
    order = np.random.default_rng(seed).permutation(count)
    cut = int(0.7 * count)
    return np.sort(order[:cut]), np.sort(order[cut:])


def aligned(points: Array, goal: Array) -> tuple[Rotation, Array]:
    """Return the turn and the shift that bring points onto a goal best (Kabsch)."""
    middles = points.mean(axis=0), goal.mean(axis=0)
    turn, _ = Rotation.align_vectors(goal - middles[1], points - middles[0])
    return turn, middles[1] - turn.apply(middles[0])


# The independent fit: NumPy and SciPy alone


def positions(side: str, readings: Array, moved: Array) -> tuple[Array, Array]:
    """Return the reflector's positions in the base frame, (N, 3), and derivatives, (N, 3, 48).

    Args:
        side: Which arm.
        readings: Joint angles, shape (N, 7), [rad].
        moved: Displacements before each joint and at the tool, (8, 6): a translation [m] and a
            rotation vector [rad].
    """
    frame, columns = np.tile(np.eye(4), (len(readings), 1, 1)), []
    for row, values in enumerate(table_of(side)):
        foot = frame[:, :3, :3]
        turn = np.eye(4)
        turn[:3, :3] = Rotation.from_rotvec(moved[row, 3:]).as_matrix()
        turn[:3, 3] = moved[row, :3]
        frame = frame @ turn
        axes = foot @ _left(moved[row, 3:])  # a change of the rotation vector turns about these
        columns.append((foot, axes, frame[:, :3, 3]))
        if row < 7:
            joint = np.tile(np.eye(4), (len(readings), 1, 1))
            angles = readings[:, row, None] * [0.0, 0.0, 1.0]
            joint[:, :3, :3] = Rotation.from_rotvec(angles).as_matrix()
            frame = frame @ joint
        frame = frame @ link(*values)
    point = frame[:, :3, 3]
    parts = []
    for foot, axes, centre in columns:
        arms = (point - centre)[:, :, None]
        parts += [foot, np.cross(axes, arms, axis=1)]
    return point, np.concatenate(parts, axis=2)


def _left(v: Array) -> Array:
    """Return the left Jacobian of a rotation vector, by its series, shape (3, 3)."""
    cross = np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
    term = result = np.eye(3)
    for order in range(2, 20):
        term = term @ cross / order
        result = result + term
    return result


@dataclass(frozen=True)
class Reference:
    """An independent fit."""

    held_out: float
    """Root mean square distance at rows held out, [m]."""
    fitted: float
    """The same at the rows fitted."""
    registered: float
    """The same at rows held out, rigid registration alone."""
    rank: int
    under_weight: float
    """The same at rows held out, each joint giving way as a weight at the reflector turns it."""


@cache
def reference(side: str, seed: int) -> Reference:
    """Return SciPy's Levenberg-Marquardt fit of all displacements, from the nominal arm.

    The tracker's place is a rigid alignment of the rows fitted, and then the first joint's own
    displacement takes it up.
    """
    data, (fit, verification) = measurements(side), split(side, seed)
    readings, goal = data.readings, data.poses[:, :3]
    nominal = np.zeros((8, 6))
    turn, shift = aligned(goal[fit], positions(side, readings[fit], nominal)[0])
    goal = turn.apply(np.array(goal)) + shift

    def residuals(values: Array, rows: Array = fit) -> Array:
        return (positions(side, readings[rows], values.reshape(8, 6))[0] - goal[rows]).ravel()

    def jacobian(values: Array) -> Array:
        return positions(side, readings[fit], values.reshape(8, 6))[1].reshape(-1, 48)

    found = least_squares(residuals, nominal.ravel(), jacobian, method="lm")

    def rms(values: Array, rows: Array) -> float:
        return float(np.sqrt((residuals(values, rows) ** 2).sum() / len(rows)))

    def weighed(rows: Array) -> Array:
        """Return derivatives by displacements, and by what each joint gives way to a weight."""
        J = positions(side, readings[rows], found.x.reshape(8, 6))[1]
        turns = J[:, :, 5:42:6]  # about each joint's axis; the weight's torque by virtual work
        return np.concatenate((J, turns * turns[:, 2:3]), axis=2).reshape(3 * len(rows), -1)

    J = found.jac / np.maximum(np.linalg.norm(found.jac, axis=0), 1e-12)
    rank = int((np.linalg.svd(J, compute_uv=False) > 1e-6).sum())
    seen = weighed(fit)
    lengths = np.maximum(np.linalg.norm(seen, axis=0), 1e-12)
    step = np.linalg.lstsq(seen / lengths, -residuals(found.x, fit), rcond=1e-6)[0] / lengths
    left = residuals(found.x, verification) + weighed(verification) @ step
    return Reference(
        held_out=rms(found.x, verification),
        fitted=rms(found.x, fit),
        registered=rms(nominal.ravel(), verification),
        rank=rank,
        under_weight=float(np.sqrt((left**2).sum() / len(verification))),
    )
