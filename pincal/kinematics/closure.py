"""Loop closure of one leg, with every derivative of it, at N poses.

Closure is a platform-point constraint in the rows that the mechanism can move in:
c(x, θ, p; φ) = p_tip(θ, p; φ) − (r + R b(φ)) = 0, with pose x, active joints θ,
passive joints p and parameters φ. A leg that closes a frame also has rows of its orientation:
the rotation vector from the platform's frame to the tip's, times the leg's size. Passive joints
are eliminated by projection on the left null space N of ∂c/∂p: Nᵀ c is the leg's condition on
pose, readings and parameters, one equation for a usual leg, six for a serial arm. The rows of the
ends of a tree are stacked; a loop within a leg is an end that meets another frame of the leg.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np

from pincal.errors import MechanismError
from pincal.kinematics.batches import (
    inverse_left_jacobian,
    left_null,
    parted,
    point_velocity,
    product,
    solve,
    turn_between,
    turned,
)
from pincal.kinematics.chain import Chain, PlatformPoint, leg_chain, motion, platform_point
from pincal.kinematics.forest import Motion
from pincal.model import Leg, Mechanism, Platform
from pincal.model.checks import array_of
from pincal.model.sensor import SensorLaw, law_of_deformations
from pincal.types import Array


@dataclass(frozen=True)
class Closure:
    """Closure c of legs of one form, and its derivatives, at N configurations, in m rows.

    Each is computed when it is asked for. A row of Nᵀc is a force on the tip; its derivative by a
    parameter is the power of that force, so that ∂c/∂φ itself need not be computed.
    """

    leg: LegClosure
    """The first of the legs."""
    matrices: Array
    """Poses, shape (N, 4, 4)."""
    motion: Motion
    """Motion of the tip by the leg's joints, then by its parameters."""
    point: PlatformPoint

    @cached_property
    def arm(self) -> Array:
        """R b, from the platform's origin to the platform point, base axes, shape (3, N), [m]."""
        return turned(self.matrices, self.point.arm)[:, 0]

    @cached_property
    def turning(self) -> tuple[Array, Array, Array] | None:
        """The r rows of c for the orientation of a leg that closes a frame, (N, r), [m].

        Then their derivatives by rotations of the tip and of the platform, (N, r, 3) each.
        """
        if not self.leg.turns:
            return None
        error = turn_between(self.motion.turns, self.matrices[:, :3, :3] @ self.point.turn)
        by_turn, size, axes = inverse_left_jacobian(error), self.leg.size, self.leg.axes
        by_platform = -by_turn.transpose(0, 2, 1)
        return size * error[:, axes], size * by_turn[:, axes], size * by_platform[:, axes]

    @cached_property
    def gap(self) -> Array:
        """c, shape (N, m), base frame, [m]; rotation vectors are multiplied by the leg's size."""
        m = self.leg.linear
        gap = self.motion.tips[:m].T - self.matrices[:, :m, 3] - self.arm[:m].T
        return gap if self.turning is None else np.hstack((gap, self.turning[0]))

    @cached_property
    def by_joints(self) -> Array:
        """∂c/∂(θ, p) of all joints in order, shape (N, m, n_joints)."""
        return self._rows(self.motion.twists_at_tip(slice(self.leg.count)))

    @cached_property
    def active(self) -> Array:
        """∂c/∂θ, shape (N, m, n_active)."""
        return self.by_joints[:, :, self.leg.leg.active]

    @cached_property
    def passive(self) -> Array:
        """∂c/∂p, shape (N, m, n_passive)."""
        return self.by_joints[:, :, self.leg.leg.passive]

    @cached_property
    def parameter(self) -> Array:
        """∂c/∂φ at fixed joints, shape (N, m, n_params)."""
        rows = self._rows(self.motion.twists_at_tip(slice(self.leg.count, None)))
        if len(placing := self.point.parameters):
            m, twists = self.leg.linear, self.point.twists
            rows[:, :m, placing] -= turned(self.matrices, twists[:3])[:m].transpose(2, 0, 1)
            if self.turning is not None:
                by_point = turned(self.matrices, twists[3:]).transpose(2, 0, 1)
                rows[:, m:, placing] += self.turning[2] @ by_point
        return rows

    @cached_property
    def pose(self) -> Array:
        """∂c/∂x for the platform's freedoms as a twist at its origin, shape (N, m, dof)."""
        twist_rows = self.leg.platform.twist_rows
        pose = -point_velocity(self.arm.T, twist_rows)[:, : self.leg.linear]
        if self.turning is None:
            return pose
        turns = np.equal.outer((3, 4, 5), twist_rows).astype(float)
        return np.concatenate((pose, self.turning[2] @ turns), axis=1)

    @cached_property
    def normal(self) -> Array:
        """Orthonormal left null space of ∂c/∂p, shape (N, m, m - n_passive)."""
        return left_null(self.passive)

    def project(self, matrix: Array) -> Array:
        """Return Nᵀ A for A of shape (N, m, k), shape (N, m - n_passive, k)."""
        if not self.passive.shape[2]:
            return matrix
        return product(self.normal.transpose(0, 2, 1), matrix)

    @cached_property
    def constraint(self) -> Array:
        """Nᵀ c, shape (N, m - n_passive), [m]."""
        return self.project(self.gap[:, :, None])[:, :, 0]

    @cached_property
    def drive(self) -> Array:
        """Nᵀ ∂c/∂θ, shape (N, m - n_passive, n_active); it loses rank at a type-1 singularity."""
        return self.project(self.active)

    @cached_property
    def constraint_by_pose(self) -> Array:
        """Nᵀ ∂c/∂x, shape (N, m - n_passive, dof)."""
        return self.project(self.pose)

    @cached_property
    def constraint_by_parameter(self) -> Array:
        """Nᵀ ∂c/∂φ at fixed joints, shape (N, m - n_passive, n_params)."""
        if self.leg.projects or not self.passive.shape[2]:
            return self.project(self.parameter)
        placing, forces = self.point.parameters, self.normal.transpose(2, 1, 0)
        power = np.empty((len(forces), len(self.leg.parameters), len(self.normal)))
        for row, force in zip(power, forces, strict=True):
            row[:] = self.motion.power(force, self.leg.count)
            if len(placing):
                in_platform = np.einsum("nij,in->jn", self.matrices[:, : len(force), :3], force)
                row[placing] -= np.einsum("jkn,jn->kn", self.point.twists[:3], in_platform)
        return power.transpose(2, 0, 1)

    def passive_step(self, gap_change: Array | None = None) -> Array:
        """Return the Gauss-Newton step of passive joints, (N, n_passive), c changed by (N, m)."""
        gap = self.gap if gap_change is None else self.gap + gap_change
        transposed = self.passive.transpose(0, 2, 1)
        normal = product(transposed, self.passive)
        return -solve(normal, product(transposed, gap[:, :, None]))[:, :, 0]

    def _rows(self, twists: Array) -> Array:
        """Return the closure's derivatives (N, m, k) by twists of the tip (3 or 6, k, N)."""
        rows = twists[: self.leg.linear].transpose(2, 0, 1)
        if self.turning is None:
            return rows
        turns = np.ascontiguousarray(twists[3:].transpose(2, 0, 1))
        return np.concatenate((rows, self.turning[1] @ turns), axis=1)


class Loop(NamedTuple):
    """Closure of an end that meets a frame of its own leg, in this frame: see ``Closure``."""

    leg: LegClosure
    """Closure of that end."""
    gap: Array
    by_joints: Array
    parameter: Array
    pose: Array
    """∂c/∂x, which is zero, shape (N, m, dof)."""


def _loop(end: LegClosure, joints: Array) -> Loop:
    """Return the closure of a loop, by the twist of its tip relative to the frame at the tip."""
    tip, frame = (c.motion(end.parameters, end.along(joints, c)) for c in end.chains)
    to_frame = frame.turns.transpose(0, 2, 1)
    gap = np.einsum("nij,jn->ni", to_frame, tip.tips - frame.tips)
    n, k = len(end.leg.moving), len(end.parameters)
    twists, at_tip = np.zeros((6, n + k, len(joints))), replace(frame, tips=tip.tips)
    for moved, chain, sign in zip((tip, at_tip), end.chains, (1, -1), strict=True):
        twists[:, [*chain.columns, *range(n, n + k)]] += sign * moved.twists()
    slopes, angular = (to_frame @ part.transpose(2, 0, 1) for part in np.split(twists, 2))
    if end.axes:
        error = turn_between(to_frame @ tip.turns, np.eye(3)[None])
        gap = np.hstack((gap, end.size * error))
        turns = end.size * inverse_left_jacobian(error) @ angular
        slopes = np.concatenate((slopes, turns), axis=1)
    gap, slopes = gap[:, end.rows], slopes[:, end.rows]
    pose = np.zeros((*gap.shape, end.platform.dof))
    return Loop(end, gap, slopes[:, :, end.columns], slopes[:, :, n:], pose)


@dataclass(frozen=True)
class TreeClosure(Closure):
    """Stacked closures of a leg with several ends at N configurations."""

    parts: tuple[Closure | Loop, ...]

    @cached_property
    def gap(self) -> Array:
        """Closures c of all ends, shape (N, m)."""
        return np.hstack([part.gap for part in self.parts])

    @cached_property
    def by_joints(self) -> Array:
        """∂c/∂(θ, p) of all joints in order, shape (N, m, n_joints)."""
        rows = []
        for part in self.parts:
            of_end = np.zeros((*part.gap.shape, len(self.leg.leg.moving)))
            of_end[:, :, part.leg.columns] = part.by_joints
            rows.append(of_end)
        return np.concatenate(rows, axis=1)

    @cached_property
    def parameter(self) -> Array:
        """∂c/∂φ at fixed joints, shape (N, m, n_params)."""
        return np.concatenate([part.parameter for part in self.parts], axis=1)

    @cached_property
    def pose(self) -> Array:
        """∂c/∂x, shape (N, m, dof)."""
        return np.concatenate([part.pose for part in self.parts], axis=1)


class LegClosure:
    """Closure of one leg, or of one of its ends, at parameter values; hashable."""

    def __init__(
        self, leg: Leg, platform: Platform, parameters: Array | None = None, end: int | None = None
    ) -> None:
        self.leg = leg
        self.platform = platform
        values, n = leg.nominal if parameters is None else parameters, len(leg.parameters)
        self.parameters = array_of(values, (n,), f"parameters of {leg.name}", MechanismError)
        self.end, met = end or 0, leg.every_end[end or 0]
        self.rows = list(platform.closing(met))
        self.axes = [row - 3 for row in self.rows if row >= 3]
        self.linear = len(self.rows) - len(self.axes)
        """Number of rows without those of the orientation."""
        self.turns = met.closes == "frame"
        spatial = platform.space == 3 or self.turns or met.point is None
        self.chains = [leg_chain(leg, spatial, name) for name in met.frames]
        self.chain, self.ends = self.chains[0], tuple[LegClosure, ...]()
        self.columns = sorted({column for chain in self.chains for column in chain.columns})
        self.count = len(self.columns)
        """Number of joints that move the end."""
        if leg.ends and end is None:
            ends = range(len(leg.every_end))
            self.ends = tuple(LegClosure(leg, platform, self.parameters, i) for i in ends)
        self.projects = self.turns or bool(self.ends)
        """Whether derivatives of Nᵀc are projections of those of c."""
        self._key = (leg, platform, self.parameters.tobytes())
        self._hash = hash(self._key)

    def __eq__(self, closure: object) -> bool:
        return isinstance(closure, LegClosure) and self._key == closure._key

    def __hash__(self) -> int:
        return self._hash

    @property
    def size(self) -> float:
        """Length of the stretched leg, [m] (see ``Leg.size``)."""
        return self.leg.size

    @property
    def by_name(self) -> dict[str, float]:
        """Parameter values by name."""
        return dict(zip(self.leg.parameter_names, self.parameters.tolist(), strict=True))

    def targets(self, matrices: Array) -> Array:
        """Return the platform point in the base frame at poses (N, 4, 4), shape (N, 3), [m]."""
        arm = self.point_at(self.leg.home[None]).arm
        return matrices[:, :3, 3] + turned(matrices, arm)[:, 0].T

    @cached_property
    def deformations(self) -> SensorLaw:
        """Deformations of the parameters."""
        return law_of_deformations(self.leg, self.by_name)

    def deformed(self, joints: Array, influences: Array | None = None) -> Array:
        """Return joint positions followed by deformations, (N, n_joints + n_deformed).

        ``influences`` of the leg, shape (N, n_influences), are by default at their reference.
        """
        if not self.leg.deformed:
            return joints
        known = np.zeros((len(joints), len(self.leg.deformed)))
        known = known if influences is None else np.hstack((known, influences))
        return np.concatenate((joints, self.deformations.position(known)), axis=1)

    def point_at(self, joints: Array) -> PlatformPoint:
        """Return the platform point at joint positions, with deformations or without."""
        deformations = joints[:, len(self.leg.moving) :]
        return platform_point(self.leg, self.end, self.parameters, deformations)

    def motion(self, joints: Array) -> Motion:
        """Return the leg's tip and its motion: see ``evaluate``."""
        return self.chain.motion(self.parameters, self.along(joints, self.chain))

    def along(self, joints: Array, chain: Chain) -> Array:
        """Return the joint positions and deformations that belong to a chain of the leg."""
        n = len(self.leg.moving)
        if len(chain.columns) == n:
            return joints
        return joints[:, [*chain.columns, *range(n, joints.shape[1])]]

    def tips(self, joints: Array) -> Array:
        """Return the tips of the leg in the base frame, shape (N, 3), [m]."""
        tips = self.motion(joints).tips
        return np.concatenate((tips, np.zeros((3 - len(tips), tips.shape[1])))).T

    def evaluate(self, joints: Array, matrices: Array) -> Closure:
        """Return the closure at joints (see ``deformed``) and poses (N, 4, 4)."""
        return evaluate((self,), joints, matrices)

    @cached_property
    def form(self) -> tuple[object, ...]:
        """Key that is equal for legs of one form, which are evaluated in one call."""
        leg, placing = self.leg, self.point_at(self.leg.home[None]).parameters
        if leg.deformed or self.projects:
            return (object(),)
        sizes = (len(leg.parameters), len(leg.sensors), len(leg.influences), *placing.tolist())
        return (*self.chain.form, self.platform, *sizes, *leg.active, "passive", *leg.passive)

    def frame(self, joints: Array) -> Array:
        """Return the platform's poses by joints of a leg that closes a frame, (N, 4, 4)."""
        moved, point = self.motion(joints), self.point_at(joints)
        matrices = np.tile(np.eye(4), (len(joints), 1, 1))
        matrices[:, :3, :3] = moved.turns @ point.turn.transpose(0, 2, 1)
        matrices[:, :3, 3] = moved.tips.T - turned(matrices, point.arm)[:, 0].T
        return matrices


def evaluate(legs: Sequence[LegClosure], joints: Array, matrices: Array) -> Closure:
    """Return the closure of L legs of one form, with N rows each, leg by leg.

    Joints have shape (L N, n_joints …), poses (L N, 4, 4): see ``LegClosure.evaluate``.
    """
    if legs[0].ends:
        main, *ends = legs[0].ends
        met = evaluate((main,), joints, matrices)
        others = (
            _loop(end, joints) if end.chains[1:] else evaluate((end,), joints, matrices)
            for end in ends
        )
        return TreeClosure(legs[0], matrices, met.motion, met.point, (met, *others))
    along, begun = legs[0].along(joints, legs[0].chain), [c.chain.begin(c.parameters) for c in legs]
    moved = motion([leg.chain for leg in legs], begun, along)
    points, count = [leg.point_at(joints) for leg in legs], len(joints) // len(legs)
    if len(legs) == 1:
        return Closure(legs[0], matrices, moved, points[0])
    parts = zip(*((point.arm, point.twists) for point in points), strict=True)  # undeformed
    arm, twists = (np.repeat(np.concatenate(part, axis=2), count, axis=2) for part in parts)
    return Closure(legs[0], matrices, moved, points[0]._replace(arm=arm, twists=twists))


def each(function: Callable[..., Array], legs: Sequence[LegClosure], *columns: Array) -> Array:
    """Return a function's values for L legs of one form and their rows, stacked leg by leg."""
    if len(legs) == 1:
        return function(legs[0], *columns)
    parts = zip(legs, *(parted(column, len(legs)) for column in columns), strict=True)
    return np.concatenate([function(leg, *rows) for leg, *rows in parts])


def joint_range(leg: Leg) -> tuple[Array, Array]:
    """Return the ends of the joints' ranges, (n_joints,) each: limits, or a turn about home."""
    free = np.array([not joint.limited for joint in leg.moving])
    low, high = np.array([(joint.lower, joint.upper) for joint in leg.moving]).reshape(-1, 2).T
    return np.where(free, leg.home - np.pi, low), np.where(free, leg.home + np.pi, high)


@lru_cache(maxsize=64)
def nominal_legs(mechanism: Mechanism) -> tuple[LegClosure, ...]:
    """Return the closures of all legs at their nominal parameters."""
    return tuple(LegClosure(leg, mechanism.platform) for leg in mechanism.legs)
