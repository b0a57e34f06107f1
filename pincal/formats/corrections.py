"""Correction grids for controllers that know other parameters than the machine's, such as nominal.

To reach x, such a controller is commanded x', the pose that its parameters give for the readings
with which the real machine reaches x. On the grid, x' is x moved by a twist that is multilinear
between nodes. The nodes are fitted to poses all over the workspace, so that nodes out of reach
serve the cells they border.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import solve
from scipy.sparse import coo_array, eye_array, kron

from pincal.errors import MechanismError
from pincal.files.columns import Columns, columns_of
from pincal.kinematics.configurations import inverse
from pincal.kinematics.forward import forward
from pincal.model import Mechanism, Plan, Platform
from pincal.model.checks import ROUNDING
from pincal.types import Array

_SMOOTH = 1e-6  # weight of squared second differences along the grid, relative to a pose's


@dataclass(frozen=True)
class CorrectionGrid:
    """Twists by which poses are moved before they are commanded, on a grid of twists from home."""

    platform: Platform
    low: Array
    """Lower end, a twist from home, shape (dof,), [m], [rad]; beyond, the border's twist holds."""
    high: Array
    twists: Array
    """Twists at the nodes, k per coordinate, the last one fastest, shape (k^dof, dof)."""

    @cached_property
    def count(self) -> int:
        """Number of nodes along each coordinate."""
        return round(len(self.twists) ** (1.0 / self.platform.dof))

    @property
    def nodes(self) -> Array:
        """Poses of the nodes, coordinates, shape (k^dof, dof)."""
        axes = np.linspace(self.low, self.high, self.count).T
        twists = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))
        return self.platform.moved(np.tile(self.platform.home, (len(twists), 1)), twists)

    def corners(self, poses: Array) -> coo_array:
        """Return the weights of the nodes around poses (N, dof), a sparse matrix (N, k^dof)."""
        home = np.tile(self.platform.home, (len(poses), 1))
        place = (self.platform.twists_between(home, poses) - self.low) / (self.high - self.low)
        place = np.clip(place, 0.0, 1.0) * (self.count - 1)
        cells = np.minimum(place.astype(int), self.count - 2)
        nodes, weights = np.zeros((1, len(poses)), dtype=int), np.ones((1, len(poses)))
        for cell, share in zip(cells.T, (place - cells).T, strict=True):
            nodes = np.concatenate((nodes * self.count + cell, nodes * self.count + cell + 1))
            weights = np.concatenate((weights * (1.0 - share), weights * share))
        rows = np.broadcast_to(np.arange(len(poses)), nodes.shape)
        size = len(poses), self.count**self.platform.dof
        return coo_array((weights.ravel(), (rows.ravel(), nodes.ravel())), size)

    def commands(self, poses: Array) -> Array:
        """Return the poses to command in place of poses, coordinates, shape (N, dof)."""
        return self.platform.moved(poses, self.corners(poses) @ self.twists)


def correction_grid(
    mechanism: Mechanism, controller: Mechanism, poses: Array, most_nodes: int
) -> CorrectionGrid:
    """Return the grid fitted to the commands that take the machine to poses (N, dof).

    It has at most ``most_nodes`` nodes. Those that no pose is near continue the others smoothly.

    Raises:
        MechanismError: the machine has more legs than freedoms, so that its readings fit no pose of
            the controller's; or no pose is in reach.
    """
    platform = mechanism.platform
    if mechanism.redundant:
        raise MechanismError(
            f"{mechanism.name!r} has more legs than freedoms, so its readings fit no pose of other "
            "geometry; use the kinematics of 'pincal deploy', or readings of 'pincal inverse'"
        )
    needed = inverse(mechanism, poses)
    reached = needed.reached.all(axis=1)
    sent = forward(controller, needed.readings[reached], poses[reached])
    if not sent.converged.any():
        reason = needed.reason(0) or sent.reasons[0]
        raise MechanismError(f"no pose to correct for {mechanism.name!r}: {reason}")
    poses, commands = poses[reached][sent.converged], sent.poses[sent.converged]
    offsets = platform.twists_between(np.tile(platform.home, (len(poses), 1)), poses)
    count = max(2, int(most_nodes ** (1.0 / platform.dof) + ROUNDING))
    nothing = np.zeros((count**platform.dof, platform.dof))
    grid = CorrectionGrid(platform, offsets.min(axis=0), offsets.max(axis=0), nothing)
    corners = grid.corners(poses).tocsr()
    normal, step = corners.T @ corners, np.diff(np.eye(count), 2, axis=0)
    for before in range(platform.dof):
        sides = eye_array(count**before), eye_array(count ** (platform.dof - 1 - before))
        normal += _SMOOTH * kron(kron(sides[0], step.T @ step), sides[1], "csr")
    normal = (normal + 1e-4 * _SMOOTH * eye_array(len(nothing))).toarray()
    twists = solve(normal, corners.T @ platform.twists_between(poses, commands), assume_a="pos")
    return replace(grid, twists=twists)


def grid_columns(mechanism: Mechanism, grid: CorrectionGrid) -> Columns:
    """Return the nodes' poses, commands ``command_x [m]`` and twists ``correction_x [m]``."""
    nodes, freedoms = grid.nodes, zip(grid.platform.freedoms, grid.platform.units, strict=True)
    moved = grid.platform.moved(nodes, grid.twists)
    columns, commands = (
        columns_of(mechanism, Plan(poses), "rotation-vector") for poses in (nodes, moved)
    )
    columns |= {f"command_{header}": values for header, values in commands.items()}
    headed = zip(freedoms, grid.twists.T, strict=True)
    return columns | {f"correction_{name} [{unit}]": values for (name, unit), values in headed}
