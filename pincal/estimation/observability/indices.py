"""How well rows of an identification Jacobian determine the parameters.

Observability indices from singular values, the diagonal of R in C = Q R, and rank, with
the groups of parameters that are not identifiable one by one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import qr, svd

from pincal.estimation.problem import Problem
from pincal.estimation.relations import at_touch, touching
from pincal.estimation.rows import white_rows
from pincal.estimation.unknowns import Unknowns
from pincal.kinematics.batches import block_diagonal
from pincal.kinematics.configurations import Legs, legs_at, nearby
from pincal.model.checks import ROUNDING
from pincal.model.leg import Leg
from pincal.model.measurements import Plan
from pincal.model.mechanism import Mechanism
from pincal.types import Array
from pincal.words.wording import group_in_words

RANK_TOLERANCE = 1e-9
"""Of the largest singular value, columns of unit length, below which a direction is lost."""
NEGLIGIBLE = 1e-6
"""Of a direction, below which a parameter, or a motion, takes no part in it."""


@dataclass(frozen=True)
class Indices:
    """Observability indices of a set of poses (Sun and Hollerbach 2008), from singular values s."""

    O1: float
    """(s₁ … sₙ)^(1/n) / √m for m rows (Borm and Menq)."""
    O1_per_parameter: float
    """(s₁ … sₙ)^(1/n) / n, as the papers print it (3-RRR paper, Eq. 13)."""
    O2: float
    """sₙ / s₁."""


def indices(C: Array) -> Indices:
    """Return the observability indices of an identification Jacobian, shape (m, n).

    Singular values carry the units of the columns; compare sets of poses with them, not
    mechanisms.

    Args:
        C: The identification Jacobian, shape (m, n).

    Example:
        >>> import numpy as np, pincal
        >>> found = pincal.indices(np.diag([4.0, 1.0]))
        >>> round(float(found.O2), 6)  # least over greatest singular value
        0.25
    """
    m, n = C.shape
    s = np.linalg.svd(C, compute_uv=False)
    if m < n or s[-1] == 0.0:
        return Indices(0.0, 0.0, 0.0)
    mean = float(np.exp(np.log(s).mean()))
    return Indices(mean / np.sqrt(m), mean / n, float(s[-1] / s[0]))


def r_diagonal(C: Array) -> Array:
    """Return |R_ii| of C = Q R, shape (n,): the observability of each parameter (Eq. 9).

    A parameter's value says what it adds to those before it; zero is not observable.
    """
    entries = np.abs(np.diagonal(np.linalg.qr(C, mode="r")))
    return np.pad(entries, (0, C.shape[1] - len(entries)))


def scaled_axes(J: Array) -> tuple[Array, Array, Array]:
    """Return lengths of columns, singular values and right axes of J, columns of unit length.

    Shapes (n,), (min(m, n),) and (n, n), axes in rows; the length of a column of zeros counts as 1.
    """
    lengths = np.linalg.norm(J, axis=0)
    lengths[lengths == 0.0] = 1.0
    triangle = np.linalg.qr(J / lengths, mode="r")
    _, s, axes = svd(triangle, lapack_driver="gesvd")  # divide and conquer may not converge
    return lengths, s, axes


@dataclass(frozen=True)
class Identifiability:
    """Rank of an identification Jacobian, and the parameters that it does not determine."""

    rank: int
    n_params: int
    condition: float
    """Condition number, columns scaled to unit length; of what is determined where rank is lost."""
    groups: tuple[tuple[str, ...], ...]
    """Ids of parameters that move together, one group for each lost rank."""

    @property
    def complete(self) -> bool:
        """Whether every parameter is determined."""
        return self.rank == self.n_params

    def describe(self) -> str:
        """Return what is not determined: ``leg_2.l and leg_2.L move together``."""
        return "; ".join(map(group_in_words, self.groups))

    def __str__(self) -> str:
        start = f"rank {self.rank} of {self.n_params}, condition {self.condition:.3g}"
        return "\n".join((start, *map(group_in_words, self.groups)))


def identifiability(C: Array, names: Sequence[str]) -> Identifiability:
    """Return rank and undetermined combinations of an identification Jacobian, shape (m, n)."""
    n = C.shape[1]
    if not n:
        return Identifiability(0, 0, 1.0, ())
    if not len(C):
        return Identifiability(0, n, np.inf, tuple((name,) for name in names))
    lengths = np.linalg.norm(C, axis=0)
    nonzero = lengths > ROUNDING * lengths.max()
    scaled = np.where(nonzero, C / np.where(nonzero, lengths, 1.0), 0.0)
    s = np.linalg.svd(scaled, compute_uv=False)
    rank = int((s > RANK_TOLERANCE * s[0]).sum()) if s[0] > 0.0 else 0
    if rank == n:
        return Identifiability(rank, n, float(s[0] / s[-1]), ())
    _, R, order = qr(scaled, mode="economic", pivoting=True)
    pivots, lost = order[:rank], order[rank:]
    weights = np.linalg.solve(R[:rank, :rank], R[:rank, rank:])  # lost columns from the kept
    members = [
        sorted({int(index), *pivots[np.abs(column) > NEGLIGIBLE].tolist()})
        for column, index in zip(weights.T, lost, strict=True)
    ]
    members.sort(key=lambda group: (len(group), group))  # that of the pivots follows rounding
    groups = tuple(tuple(names[i] for i in group) for group in members)
    return Identifiability(rank, n, float(s[0] / s[rank - 1]) if rank else np.inf, groups)


GENERIC = 200  # configurations, at least


def jacobian_near(
    mechanism: Mechanism, problem: Problem, unknowns: Unknowns, *, generic: bool
) -> tuple[Legs, Array]:
    """Return what legs do at the start's poses or readings, or at generic ones about them.

    And what the free unknowns do to all that is measured there, over the mechanism's size, poses
    eliminated, rows of priors below: shape (m, n_free). At generic ones everything is measured in
    every row that is measured in some row.
    """
    start, block = problem.start(unknowns.start), problem.leg_block
    contacts, chosen = problem.observation.setup.contacts, np.arange(len(start.matrices))
    if generic:  # the same ones in whatever order rows were measured
        chosen = np.lexsort((*start.matrices[:, :3, 3].T, *block.readings.T))
        chosen = chosen if contacts else chosen[:GENERIC]  # every point is touched
    plan = Plan(
        mechanism.platform.from_matrices(start.matrices[chosen]),
        readings=block.readings[chosen] if mechanism.by_readings else None,
        influences={name: values[chosen] for name, values in block.influences.items()},
    )
    values = (start.parameters[columns] for columns in block.columns)
    started = mechanism.with_parameters(dict(zip(mechanism.leg_names, values, strict=True)))
    size = problem.size
    plan = nearby(started, plan, GENERIC, size) if generic else plan
    observation = problem.observation.anywhere() if generic else problem.observation
    every = chosen[np.arange(len(plan)) % len(chosen)]
    if contacts:  # frames and scale do not show where they touch exactly
        plan = touching(observation.at(every), started, plan, start.external)
    legs = legs_at(started, plan)
    rows = every[legs.reached]
    matrices, observation = mechanism.platform.matrices(legs.poses), observation.at(rows)
    nearest = at_touch(observation, matrices, start.external)
    _, seen_pose, by_external = observation.residuals(matrices, nearest)
    per = np.array([1.0 / size if unit == "m" else 1.0 for unit in observation.units])[:, None]
    # ┌ A          0        ┐  legs            ┌ B ┐
    # └ 0  by external      ┘  what is seen    └ B ┘
    pose = np.concatenate((legs.pose / size, seen_pose * per), axis=1)
    parameter = block_diagonal((legs.parameter / size, by_external * per))
    unit_noise = np.broadcast_to(np.eye(pose.shape[1]), (len(pose), *2 * pose.shape[1:2]))
    free = white_rows(pose, unit_noise)(parameter)
    return legs, unknowns.free_rows(free[np.isfinite(free).all(axis=(1, 2))])


def lost_directions(J: Array) -> tuple[Array, Array]:
    """Return unobservable directions of a Jacobian, and the lengths of its columns.

    Rows v of shape (n_lost, n), in columns of unit length: unknowns may move along v / lengths; and
    v · lengths is what that leaves as it is in the changes nearest to none, each measured by what
    it alone does.
    """
    lengths, s, axes = scaled_axes(J)
    return axes[int((s > RANK_TOLERANCE * s[0]).sum()) :], lengths


DIFFER = 0.05
"""Of a mechanism's size, of a gain, and [rad]: by more no machine differs from its drawing."""


def plausible_changes(mechanism: Mechanism, legs: Sequence[Leg] | None = None) -> Array:
    """Return by how much parameters of legs may differ from their drawing, shape (n_params,).

    In the parameters' order and units; of all legs if none are given.
    """
    return np.concatenate([changes_of(leg, mechanism.size) for leg in legs or mechanism.legs])


def nearest_to_nominal(mechanism: Mechanism, directions: Array) -> Array:
    """Return what moves parameters along directions to those nearest to nominal, shape (n, n).

    Each change is measured by how much machines differ: P = I − G (W G)⁺ W, W = 1 / these, G the
    directions of all legs' parameters, shape (n, k).
    """
    scales = plausible_changes(mechanism)
    amounts = np.linalg.pinv(directions / scales[:, None]) / scales
    return np.asarray(np.eye(len(scales)) - directions @ amounts)


def changes_of(leg: Leg, size: float) -> Array:
    """Return by how much a leg's parameters may differ, shape (n_params,).

    Lengths by a share of ``size``, gains of themselves, angles of a radian, numbers of 1.
    """
    gains = {sensor.gain for sensor in leg.sensors}
    scales = [
        (abs(value) or 1.0) if name in gains else size if leg.units[name] == "m" else 1.0
        for name, value in leg.parameters
    ]
    return DIFFER * np.array(scales)
