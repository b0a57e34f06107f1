"""Loop closure of one leg, with every derivative of it, at N poses.

Closure is a platform-point constraint in the rows that the mechanism can move in:
c(x, θ, p; φ) = p_tip(θ, p; φ) − (r + R b(φ)) = 0, with pose x, active joints θ,
passive joints p and parameters φ. A leg that closes a frame has rows for its turn as well:
the rotation vector from the platform's frame to the tip's, times the leg's size. Passive joints
are eliminated by projection on the left null space N of ∂c/∂p: Nᵀ c is what the leg demands of
pose, readings and parameters, whatever its passive joints do. The leg of a usual mechanism demands
one equation; one with fewer passive joints more, a serial arm six.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pincal.kinematics.chain import leg_chain, point_chain
from pincal.kinematics.forest import cross
from pincal.kinematics.rotations import inverse_left_jacobian, turn_between
from pincal.model.leg import Leg
from pincal.model.platform import Platform

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Closure:
    """Closure c of one leg and its derivatives at N configurations; m rows are kept."""

    gap: Array
    """c, shape (N, m), base frame, [m]."""
    active: Array
    """∂c/∂θ, shape (N, m, n_active)."""
    passive: Array
    """∂c/∂p, shape (N, m, n_passive)."""
    parameter: Array
    """∂c/∂φ at fixed joints, shape (N, m, n_params)."""
    pose: Array
    """∂c/∂x for the platform's freedoms as a twist at its origin, shape (N, m, dof)."""
    twists: tuple[Array, Array | None]
    """Tip twists (6, N) of the first active joint and of the next revolute joint, if any."""

    @cached_property
    def normal(self) -> Array:
        """Orthonormal left null space of ∂c/∂p, shape (N, m, m - n_passive)."""
        return left_null(self.passive)

    def project(self, matrix: Array) -> Array:
        """Return Nᵀ A for A of shape (N, m, k), shape (N, m - n_passive, k)."""
        return product(self.normal.transpose(0, 2, 1), matrix)

    @cached_property
    def constraint(self) -> Array:
        """Nᵀ c, shape (N, m - n_passive), [m]."""
        return self.project(self.gap[:, :, None])[:, :, 0]

    @cached_property
    def drive(self) -> Array:
        """Nᵀ ∂c/∂θ, shape (N, m - n_passive, n_active): less of rank at a type-1 singularity."""
        return self.project(self.active)

    @cached_property
    def lever(self) -> Array:
        """Speed of the next revolute axis after the first active joint per unit of its rate, (N,).

        At a planar dyad the length l; the tip's own speed where there is no such axis.
        """
        active, following = self.twists
        own = np.linalg.norm(self.active[:, :, 0], axis=1)
        if following is None:
            return own
        arm = cross(following[3:].T, following[:3].T)  # from the tip to the next axis
        speed = active[:3].T + cross(active[3:].T, arm)
        lever = np.linalg.norm(speed, axis=1)
        return np.where(lever > 1e-9 * own, lever, own)

    def active_step(self) -> Array:
        """Return the Newton step of the active joints that closes the leg, shape (N, n_active).

        Of least squares where the leg demands more than they can give, the shortest where less.
        """
        return -least_squares(self.drive, self.constraint[:, :, None])[:, :, 0]

    def passive_step(self, gap_change: Array | None = None) -> Array:
        """Return the Gauss-Newton step of the passive joints, shape (N, n_passive).

        Args:
            gap_change: Change of c by other steps taken at the same time, shape (N, m).
        """
        gap = self.gap if gap_change is None else self.gap + gap_change
        transposed = self.passive.transpose(0, 2, 1)
        normal = product(transposed, self.passive)
        return -solve(normal, product(transposed, gap[:, :, None]))[:, :, 0]


class LegClosure:
    """Evaluates the closure of one leg at given parameter values."""

    def __init__(self, leg: Leg, platform: Platform, parameters: Array | None = None) -> None:
        self.leg = leg
        self.platform = platform
        self.parameters = leg.nominal if parameters is None else np.asarray(parameters, float)
        self._rows = list(platform.closing(leg.closes))
        self._turns = leg.closes == "frame"
        self._chain = leg_chain(leg, platform.space == 3 or self._turns)
        point = point_chain(leg)
        b, db, turn = point.forest.frames(point.configurations(self.parameters, np.zeros((1, 0))))
        self._b, self._turn = b[0], turn[0]
        self._db = db[:, 0] @ point.from_parameters

    @property
    def size(self) -> float:
        """Length of the stretched leg, [m] (see ``Leg.size``)."""
        return self.leg.size

    @property
    def reach(self) -> float:
        """Largest distance of the platform's origin from the leg's base, [m]."""
        return self.leg.reach

    @property
    def by_name(self) -> dict[str, float]:
        """Parameter values by name."""
        return dict(zip(self.leg.parameter_names, self.parameters.tolist(), strict=True))

    def targets(self, matrices: Array) -> Array:
        """Return the platform point in the base frame, shape (N, 3), [m].

        Args:
            matrices: Poses ``T_base_platform``, shape (N, 4, 4).
        """
        return matrices[:, :3, 3] + matrices[:, :3, :3] @ self._b

    def tips(self, joints: Array) -> Array:
        """Return the tips of the leg in the base frame, shape (N, 3), [m]."""
        return self.joint_columns(joints)[0]

    def joint_columns(self, joints: Array) -> tuple[Array, Array]:
        """Return tips, shape (N, 3), and their twists by each joint, shape (6, N, n_joints)."""
        chain = self._chain
        tips, columns = chain.forest.columns(chain.configurations(self.parameters, joints))
        return tips, columns @ chain.from_joints

    def evaluate(self, joints: Array, matrices: Array) -> Closure:
        """Return closure and derivatives at joint positions (N, n_joints) and poses (N, 4, 4)."""
        chain, rows = self._chain, self._rows
        configurations = chain.configurations(self.parameters, joints)
        R = matrices[:, :3, :3]
        arm = R @ self._b
        if self._turns:
            tips, columns, turns = chain.forest.frames(configurations)
        else:
            tips, columns = chain.forest.columns(configurations)
        gap = tips - matrices[:, :3, 3] - arm
        pose = -point_velocity(arm, self.platform.twist_rows)
        own = [row for row in rows if row < 3]
        speed = np.stack([columns[row] for row in own], axis=1)  # (N, m, n)
        point = (R @ self._db[:3])[:, own] if self._db.any() or self._turns else None
        gap, pose = gap[:, own], pose[:, own]
        if self._turns:
            linear = (gap, pose, speed, point)
            gap, pose, speed, point = (
                np.concatenate(both, axis=1)
                for both in zip(linear, self._turning(turns, R, columns), strict=True)
            )
        moved = speed @ chain.from_joints
        parameter = speed @ chain.from_parameters
        if point is not None:
            parameter -= point
        return Closure(
            gap=gap,
            active=moved[:, :, self.leg.active],
            passive=moved[:, :, self.leg.passive],
            parameter=parameter,
            pose=pose,
            twists=self._drive_twists(columns),
        )

    def _turning(self, turns: Array, R: Array, columns: Array) -> tuple[Array, Array, Array, Array]:
        """Return the rows of the turn: gap, and its derivatives by pose, chain and platform point.

        Rotation vectors times the leg's size, so that all rows are lengths.
        """
        error = turn_between(turns, R @ self._turn)
        axes = [row - 3 for row in self._rows if row >= 3]
        spread = self.size * inverse_left_jacobian(error)
        back = spread.transpose(0, 2, 1)[:, axes]
        turned = np.equal.outer((3, 4, 5), self.platform.twist_rows).astype(float)
        return (
            self.size * error[:, axes],
            -(back @ turned),
            (spread @ columns[3:].transpose(1, 0, 2))[:, axes],
            back @ R @ self._db[3:],
        )

    def frame(self, joints: Array, gap: Array | None = None) -> Array:
        """Return where joints put the platform if the leg closes a frame in space, (N, 4, 4).

        Args:
            joints: Shape (N, n_joints).
            gap: What the closure is to be there, shape (N, 6); nothing if not given.
        """
        chain = self._chain
        tips, _, turns = chain.forest.frames(chain.configurations(self.parameters, joints))
        if gap is not None:
            tips = tips - gap[:, :3]
            turns = Rotation.from_rotvec(-gap[:, 3:] / self.size).as_matrix() @ turns
        matrices = np.tile(np.eye(4), (len(joints), 1, 1))
        matrices[:, :3, :3] = turns @ self._turn.T
        matrices[:, :3, 3] = tips - matrices[:, :3, :3] @ self._b
        return matrices

    def _drive_twists(self, columns: Array) -> tuple[Array, Array | None]:
        """Return the tip twists of the first active joint and of the next revolute joint."""
        moving, active = self.leg.moving, self.leg.active[0]
        entries = self._chain.joint_entries
        following = [i for i in range(active + 1, len(moving)) if moving[i].kind == "revolute"]
        turn = columns[:, :, entries[following[0]]] if following else None
        return columns[:, :, entries[active]], turn


def largest_size(legs: Iterable[Leg], platform: Platform) -> float:
    """Return the length of the longest stretched leg, [m]: the scale of a mechanism."""
    return max(LegClosure(leg, platform).size for leg in legs)


def point_velocity(arm: Array, twist_rows: tuple[int, ...]) -> Array:
    """Return the velocity of a platform point for unit platform twists, shape (N, 3, dof)."""
    columns = np.zeros((len(arm), 3, len(twist_rows)))
    for index, row in enumerate(twist_rows):
        if row < 3:
            columns[:, row, index] = 1.0
        else:  # e_i × arm
            i = row - 3
            j, k = (i + 1) % 3, (i + 2) % 3
            columns[:, j, index], columns[:, k, index] = -arm[:, k], arm[:, j]
    return columns


def product(a: Array, b: Array) -> Array:
    """Return the batched product of (N, i, j) and (N, j, k), quick where the sizes are tiny."""
    if a.shape[2] == 0:
        return np.zeros((len(a), a.shape[1], b.shape[2]))
    if a.shape[2] <= 3:
        total = a[:, :, 0, None] * b[:, None, 0, :]
        for j in range(1, a.shape[2]):
            total += a[:, :, j, None] * b[:, None, j, :]
        return total
    return a @ b


def solve(a: Array, b: Array) -> Array:
    """Return X of A X = B, shapes (N, k, k) and (N, k, j); NaN or infinite where A is singular."""
    if a.shape[1] == 0:
        return np.zeros_like(b)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        if a.shape[1] == 1:
            return b / a
        if a.shape[1] == 2:
            (p, q), (r, s) = a[:, 0].T, a[:, 1].T
            adjugate = np.stack((s, -q, -r, p), axis=1).reshape(-1, 2, 2)
            return product(adjugate, b) / (p * s - q * r)[:, None, None]
    singular = ~np.isfinite(a).all(axis=(1, 2)) | (np.linalg.det(a) == 0.0)
    safe = np.where(singular[:, None, None], np.eye(a.shape[1]), a)
    return np.where(singular[:, None, None], np.nan, np.linalg.solve(safe, b))


def least_squares(a: Array, b: Array) -> Array:
    """Return the shortest X of least |A X - B|, shapes (N, m, k) and (N, m, j) to (N, k, j)."""
    if a.shape[1] == a.shape[2]:
        return solve(a, b)
    transposed = a.transpose(0, 2, 1)
    if a.shape[1] > a.shape[2]:
        return solve(product(transposed, a), product(transposed, b))
    return product(transposed, solve(product(a, transposed), b))


def left_null(matrix: Array) -> Array:
    """Return orthonormal columns N with Nᵀ A = 0, shape (N, m, p) to (N, m, m - p).

    They follow A without a jump: det [A N] is positive.
    """
    count, m, p = matrix.shape
    if p == 0:
        return np.broadcast_to(np.eye(m), (count, m, m))
    if (m, p) in ((2, 1), (3, 2)):  # the vector across: no factorisation needed
        if m == 2:
            normal = np.stack((-matrix[:, 1, 0], matrix[:, 0, 0]), axis=1)
        else:
            normal = cross(matrix[:, :, 0], matrix[:, :, 1])
        with np.errstate(divide="ignore", invalid="ignore"):
            return (normal / np.linalg.norm(normal, axis=1)[:, None])[:, :, None]
    q, _ = np.linalg.qr(matrix, mode="complete")
    both = np.concatenate((matrix, q[:, :, p:]), axis=2)
    with np.errstate(invalid="ignore"):
        q[np.linalg.det(both) < 0.0, :, -1] *= -1.0
    return q[:, :, p:]
