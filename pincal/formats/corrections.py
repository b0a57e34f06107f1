"""Corrections for controllers that know another machine: without its terms, or the nominal one.

Such a controller takes its own machine to a pose by readings ψ_own; the machine that stands there
needs ψ, so that it lacks ψ − ψ_own. Or it is sent to another pose x', at which its own readings are
ψ. On a grid x' is x moved by a twist that is multilinear between nodes; nodes are fitted to
corrections at poses all over the workspace, so that those out of reach serve the cells they border.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import solve
from scipy.sparse import coo_array

from pincal.errors import MechanismError
from pincal.files.columns import Columns, columns_of, reading_columns, reason_column
from pincal.files.mechanism_folders import GivenMechanism, as_mechanism
from pincal.kinematics.configurations import as_plan, inverse, joints_at
from pincal.kinematics.forward import forward
from pincal.kinematics.influences import own_influences
from pincal.model.checks import ROUNDING
from pincal.model.measurements import Plan
from pincal.model.mechanism import Mechanism
from pincal.model.platform import Platform
from pincal.types import Array

CORRECTION, COMMAND = "correction_", "command_"
_SMOOTH = 1e-6  # of a pose's weight: squares of second differences along the grid


@dataclass(frozen=True, repr=False)
class Corrections:
    """What takes the whole machine to N poses by a controller that knows the plain one.

    Example:
        >>> import pincal
        >>> pincal.corrections("5R", [[0.0, 1.1]]).readings.tolist()  # no terms: nothing to add
        [[0.0, 0.0]]
    """

    plan: Plan
    """The poses; and the readings of the plain machine, where poses do not determine them."""
    readings: Array
    """What to add to readings of the plain machine, shape (N, n_readings), [rad] or [m]; NaN where
    there is none."""
    commands: Array | None
    """Poses to command instead, shape (N, dof), [m] and [rad]; NaN where there is none. None if
    the legs demand more than there are freedoms: no pose has just these readings then."""
    reasons: tuple[str, ...]
    """Why a row has no correction or command; empty strings where it has both."""

    def __repr__(self) -> str:
        return f"Corrections: {self.reasons.count('')} of {len(self.reasons)} poses"


def corrections(
    mechanism: GivenMechanism, planned: Plan | Array, controller: GivenMechanism | None = None
) -> Corrections:
    """Return what a controller lacks at poses that knows another mechanism.

    Args:
        mechanism: The mechanism, at its nominal parameters.
        planned: N poses, shape (N, dof), [m] and [rad]; or a plan with columns of influences, NaN
            or none at their reference, and with the controller's readings if poses follow these.
        controller: The mechanism that the controller knows; the first without its terms if not
            given.

    Raises:
        MechanismError: poses or readings of a wrong shape, or not finite; a homed sensor and a
            home pose out of its leg's reach.
    """
    mechanism = as_mechanism(mechanism)
    plain = mechanism.without_terms if controller is None else as_mechanism(controller)
    plan = as_plan(mechanism, planned)
    safe = poses = plan.poses
    reasons_plain: tuple[str, ...] = ("",) * len(plan)
    if plan.readings is not None:
        plain_poses = forward(plain, plan.readings, poses)
        poses, reasons_plain = plain_poses.poses, plain_poses.reasons
        safe = np.where(np.isfinite(poses), poses, mechanism.platform.home)
    started = joints_at(plain, Plan(safe, readings=plan.readings))
    influences = own_influences(mechanism, plan.influences)
    reached = inverse(mechanism, safe, influences, started.joints)
    reasons = [reason or reached.reason(row) for row, reason in enumerate(reasons_plain)]
    has_readings = np.array([not reason for reason in reasons], dtype=bool)
    commands = None if mechanism.redundant else np.full(poses.shape, np.nan)
    if commands is not None:
        commanded = forward(plain, reached.readings[has_readings], safe[has_readings])
        commands[has_readings] = commanded.poses
        for row, reason in zip(np.flatnonzero(has_readings), commanded.reasons, strict=True):
            reasons[row] = reason
    readings = started.readings if mechanism.by_readings else None
    return Corrections(
        Plan(poses, readings=readings, influences=influences),
        np.where(has_readings[:, None], reached.readings - started.readings, np.nan),
        commands,
        tuple(reasons),
    )


@dataclass(frozen=True)
class CorrectionGrid:
    """Twists by which poses are moved before they are commanded, on a grid of twists from home."""

    platform: Platform
    low: Array
    """Ends of the grid, twists from home, shape (dof,), [m] and [rad]; beyond, its border holds."""
    high: Array
    twists: Array
    """At the nodes, k of each coordinate, the last one fastest, shape (k^dof, dof)."""

    @cached_property
    def count(self) -> int:
        """Number of nodes along each coordinate."""
        return round(len(self.twists) ** (1.0 / self.platform.dof))

    @property
    def nodes(self) -> Array:
        """Poses of the nodes, coordinates of shape (k^dof, dof)."""
        axes = np.linspace(self.low, self.high, self.count).T
        twists = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))
        return self.platform.moved(np.tile(self.platform.home, (len(twists), 1)), twists)

    def corners(self, poses: Array) -> coo_array:
        """Return weights of the nodes around poses (N, dof), shape (N, k^dof)."""
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
        """Return what to command in place of poses, coordinates of shape (N, dof)."""
        return self.platform.moved(poses, self.corners(poses) @ self.twists)


def correction_grid(
    mechanism: Mechanism, controller: Mechanism, plan: Plan, most_nodes: int
) -> CorrectionGrid:
    """Return a grid of at most so many nodes, fitted to corrections at a plan's poses.

    Nodes that no pose is near continue the others: second differences along the grid are small.

    Raises:
        MechanismError: more legs than freedoms, so that no pose has just the readings of another
            machine; or no pose in reach.
    """
    platform, lacking = mechanism.platform, corrections(mechanism, plan, controller)
    if lacking.commands is None:
        raise MechanismError(
            f"{mechanism.name!r} has more legs than freedoms: other readings are no other pose; "
            "use the kinematics of 'pincal deploy', or readings by 'pincal inverse'"
        )
    known = np.isfinite(lacking.commands).all(axis=1)
    if not known.any():
        raise MechanismError(f"no pose to correct for {mechanism.name!r}: {lacking.reasons[0]}")
    poses, commands = lacking.plan.poses[known], lacking.commands[known]
    offsets = platform.twists_between(np.tile(platform.home, (len(poses), 1)), poses)
    count = max(2, int(most_nodes ** (1.0 / platform.dof) + ROUNDING))
    nothing = np.zeros((count**platform.dof, platform.dof))
    grid = CorrectionGrid(platform, offsets.min(axis=0), offsets.max(axis=0), nothing)
    corners = grid.corners(poses).tocsr()
    normal, step = (corners.T @ corners).toarray(), np.diff(np.eye(count), 2, axis=0)
    for before in range(platform.dof):
        sides = np.eye(count**before), np.eye(count ** (platform.dof - 1 - before))
        normal += _SMOOTH * np.kron(np.kron(sides[0], step.T @ step), sides[1])
    normal += 1e-4 * _SMOOTH * np.eye(len(normal))
    twists = solve(normal, corners.T @ platform.twists_between(poses, commands), assume_a="pos")
    return replace(grid, twists=twists)


def grid_columns(mechanism: Mechanism, grid: CorrectionGrid) -> Columns:
    """Return poses of the nodes, ``command_x [m]`` and ``correction_x [m]``, as columns."""
    nodes, freedoms = grid.nodes, zip(grid.platform.freedoms, grid.platform.units, strict=True)
    moved = grid.platform.moved(nodes, grid.twists)
    columns, commands = (
        columns_of(mechanism, Plan(poses), "rotation-vector") for poses in (nodes, moved)
    )
    columns |= {f"{COMMAND}{header}": values for header, values in commands.items()}
    headed = zip(freedoms, grid.twists.T, strict=True)
    return columns | {f"{CORRECTION}{name} [{unit}]": values for (name, unit), values in headed}


def correction_columns(
    mechanism: Mechanism, lacking: Corrections, orientation: str = "tilt-torsion"
) -> Columns:
    """Return poses, ``correction_leg_1 [rad]``, ``command_x [m]``, reasons, as columns."""
    columns = columns_of(mechanism, lacking.plan, orientation)
    columns |= reading_columns(mechanism, lacking.readings, CORRECTION)
    if lacking.commands is not None:
        commands = columns_of(mechanism, Plan(lacking.commands), orientation)
        columns |= {f"{COMMAND}{header}": values for header, values in commands.items()}
    return columns | reason_column(lacking.reasons)
