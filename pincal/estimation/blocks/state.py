"""Values of everything that is unknown: parameters of legs, poses, and what is outside a mechanism.

Outside are the base frame in the frame of the measurements, T_frame_base; offsets of targets in the
platform frame; where an unknown target carries an orientation, how that is turned against the
platform's; and the parameters of instruments.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import Rotation

from pincal.kinematics.batches import inverse_left_jacobian
from pincal.model.platform import Platform
from pincal.model.setup import ORIGIN, Setup
from pincal.types import Array, Index

Entry = tuple[slice, slice, Array]
"""Rows, columns and derivatives, shape (N, rows, columns); other columns do not move these rows."""


@dataclass(frozen=True)
class External:
    """Values of the unknowns outside the mechanism."""

    frame: Array = field(default_factory=lambda: np.eye(4))
    """T_frame_base, shape (4, 4); the identity where poses are those in the base frame."""
    offsets: Array = field(default_factory=lambda: np.zeros((1, 3)))
    """Positions of the targets in the platform frame, shape (n_targets, 3), [m]."""
    turn: Array = field(default_factory=lambda: np.eye(3))
    """R_platform_target of the measured orientation, shape (3, 3)."""
    instruments: Array = field(default_factory=lambda: np.zeros(0))
    """Parameters of the instruments, in their order, shape (n_own,)."""


@dataclass(frozen=True)
class State:
    """Values of everything that is unknown."""

    parameters: Array
    """Of the legs, shape (n_params,)."""
    matrices: Array
    """Poses ``T_base_platform``, shape (N, 4, 4)."""
    joints: tuple[Array, ...] = ()
    """Joint positions of each leg, deformations behind them, shape (N, n_joints [+ n_deformed]);
    none before the first evaluation."""
    external: External = field(default_factory=External)
    """Unknowns outside the mechanism."""

    def rows(self, chosen: Index) -> State:
        """Return the state at some poses."""
        joints = tuple(positions[chosen] for positions in self.joints)
        return replace(self, matrices=self.matrices[chosen], joints=joints)


@dataclass(frozen=True)
class BlockRows:
    """Residuals of one block at a state: k rows at each of N poses; zero where none is active."""

    value: Array
    """Residuals, shape (N, k), [m] and [rad]."""
    by_pose: Array
    """Derivatives by the platform's twist, (N, k, dof); no columns where poses are as measured."""
    by_parameter: tuple[Entry, ...]
    """Derivatives by the block's unknowns, those of each of its legs in rows of their own."""
    noise_root: Array
    """S, root of the noise, shape (N, k, s)."""


class ExternalUnknowns:
    """Which of the external values are unknown, in which order, and how steps move them."""

    def __init__(self, platform: Platform, setup: Setup, oriented: bool) -> None:
        """Say what is unknown of a setup in which orientations are measured or not."""
        self.setup = setup
        rows = (0, 1, 5) if platform.space == 2 else (0, 1, 2, 3, 4, 5)
        turned = oriented and setup.targets[ORIGIN].unknown
        self.frame_rows = rows if setup.unknown_frame else ()
        self.offset_entries = tuple(
            (index, axis)
            for index, target in enumerate(setup.targets.values())
            for axis in range(platform.space * target.unknown)
        )
        self.turn_axes = tuple(row - 3 for row in rows[platform.space :]) if turned else ()
        targets, twists = list(setup.targets), ("x", "y", "z", "rx", "ry", "rz")
        own = [parameter for instrument in setup.instruments for parameter in instrument.parameters]
        geometric = (
            *(f"tracker.{twists[row]}" for row in self.frame_rows),
            *(f"{owner(targets[index])}.{'xyz'[axis]}" for index, axis in self.offset_entries),
            *(f"{owner(ORIGIN)}.{twists[3 + axis]}" for axis in self.turn_axes),
        )
        units = ("rad" if name[-2] == "r" else "m" for name in geometric)
        self.names = (*geometric, *(parameter.id for parameter in own))
        """Ids of the unknowns."""
        self.units = (*units, *(parameter.unit for parameter in own))
        self.turn_columns = slice(len(geometric) - len(self.turn_axes), len(geometric))
        self.own_columns = slice(len(geometric), len(self.names))
        """Parameters of the instruments among the unknowns."""
        offsets = np.array([target.offset for target in setup.targets.values()], dtype=float)
        nominal = np.array([parameter.nominal for parameter in own], dtype=float)
        self.start = External(np.eye(4), offsets, np.eye(3), nominal)
        """The values of the setup; the base frame is that of the measurements."""

    def __len__(self) -> int:
        return len(self.names)

    def moved(self, values: External, step: Array) -> External:
        """Return values after a step, shape (n,): twists of the frame about its own origin."""
        n_frame = len(self.frame_rows)
        twist, turn = np.zeros(6), np.zeros(3)
        twist[list(self.frame_rows)] = step[:n_frame]
        turn[list(self.turn_axes)] = step[self.turn_columns]
        frame, offsets = values.frame.copy(), values.offsets.copy()
        frame[:3, 3] += twist[:3]
        frame[:3, :3] = Rotation.from_rotvec(twist[3:]).as_matrix() @ frame[:3, :3]
        for (index, axis), change in zip(self.offset_entries, step[n_frame:], strict=False):
            offsets[index, axis] += change
        return replace(
            values,
            frame=frame,
            offsets=offsets,
            turn=Rotation.from_rotvec(turn).as_matrix() @ values.turn,
            instruments=values.instruments + step[self.own_columns],
        )

    def coordinates(self, values: External) -> Array:
        """Return the unknowns as numbers, shape (n,), [m] and, rotation vectors, [rad]."""
        twist = np.concatenate(
            (values.frame[:3, 3], Rotation.from_matrix(values.frame[:3, :3]).as_rotvec())
        )
        turn = Rotation.from_matrix(values.turn).as_rotvec()
        offsets = [values.offsets[entry] for entry in self.offset_entries]
        angles = turn[list(self.turn_axes)]
        return np.array([*twist[list(self.frame_rows)], *offsets, *angles, *values.instruments])

    def coordinates_by_step(self, values: External) -> Array:
        """Return the derivative of the coordinates by steps, shape (n, n): see ``moved``."""
        frame = Rotation.from_matrix(values.frame[:3, :3]).as_rotvec()
        turn = Rotation.from_matrix(values.turn).as_rotvec()
        of_frame, of_turn = inverse_left_jacobian(np.array([frame, turn]))
        D = np.eye(len(self))
        turns = [i for i, row in enumerate(self.frame_rows) if row >= 3]
        axes = [row - 3 for row in self.frame_rows if row >= 3]
        D[np.ix_(turns, turns)] = of_frame[np.ix_(axes, axes)]
        D[self.turn_columns, self.turn_columns] = of_turn[np.ix_(self.turn_axes, self.turn_axes)]
        return D


def owner(target: str) -> str:
    """Return the owner of a target's coordinates: ``target`` of the platform's own."""
    return "target" if target == ORIGIN else target
