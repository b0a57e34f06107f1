"""Values of all unknowns, the conditions there, and these as rows of ordinary least squares."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from pincal.errors import MeasurementError
from pincal.estimation.blocks.external import External
from pincal.estimation.rows import NoNoiseError, WhiteRows, white_rows
from pincal.kinematics.batches import chunks, over_rows
from pincal.kinematics.derivatives import Demand
from pincal.types import Array, Index, Mask

Follow = Callable[[Array, Array], tuple[Array, ...]]
"""Returns joints of each leg, near those after a step of all unknowns and twists of the poses."""
Entry = tuple[slice, slice, Array]
"""Rows, columns and derivatives, shape (N, rows, columns); other columns do not move these rows."""
NO_NOISE = (
    "some measurements carry no noise at all; give standard deviations above zero for what is "
    "measured, and for readings (--noise-reading) where there are more of them than freedoms"
)


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


@dataclass(frozen=True)
class Linear:
    """Conditions of all blocks at a state, also freed of the poses and whitened."""

    state: State
    """Values of the unknowns, joints where the legs close best."""
    demands: tuple[Demand, ...]
    """What each leg demands."""
    follow: Follow
    """Returns the legs' joints after a step."""
    conditions: Array
    """Residuals e of all blocks, shape (N, k), [m] and [rad]."""
    entries: tuple[Entry, ...]
    """A: derivatives by all parameters and external unknowns."""
    by_pose: Array
    """B: derivatives by the platform's twist, shape (N, k, dof)."""
    noise_root: Array
    """S: root of the noise, shape (N, k, s)."""
    active: Mask
    """Rows that something was measured of, shape (N, k)."""
    equations: Index
    """How many equations each pose gives, shape (N,)."""

    @property
    def finite(self) -> bool:
        """Whether all derivatives by the unknowns exist."""
        return all(bool(np.isfinite(values).all()) for _, _, values in self.entries)

    def by_parameter(self, poses: slice = slice(None)) -> Array:
        """Return A of some poses, shape (N, k, n)."""
        n = max(columns.stop for _, columns, _ in self.entries)
        A = np.zeros((len(self.conditions[poses]), self.conditions.shape[1], n))
        for rows, columns, values in self.entries:
            A[:, rows, columns] = values[poses]
        return A

    def after(self, step: Array) -> Array:
        """Return the conditions after a step of the unknowns (n,), to first order, (N, k)."""
        conditions = self.conditions.copy()
        for rows, columns, values in self.entries:
            conditions[:, rows] += values @ step[columns]
        return conditions

    @cached_property
    def white(self) -> WhiteRows:
        """What frees the rows of the poses and whitens them.

        Rows that nothing was measured of have noise of their own, so that they say nothing.

        Raises:
            MeasurementError: conditions without noise.
        """
        noise, idle = self.noise_root, ~self.active
        if idle.any():
            size = float(np.median(np.abs(noise[noise != 0.0]))) if noise.any() else 1.0
            idle_noise = np.where(idle[:, :, None], size * np.eye(idle.shape[1]), 0.0)
            noise = np.concatenate((noise, idle_noise[:, :, idle.any(axis=0)]), axis=2)
        try:
            return white_rows(self.by_pose, noise)
        except NoNoiseError as error:
            raise MeasurementError(NO_NOISE) from error

    def whitened(self, conditions: Array) -> Array:
        """Return conditions of shape (N, k), as those at another state, in these rows, (N, m)."""
        return self.white(conditions[:, :, None])[:, :, 0]

    @cached_property
    def residuals(self) -> Array:
        """Residuals in standard deviations, freed of the poses, shape (N, m)."""
        return self.whitened(self.conditions)

    @property
    def jacobian(self) -> Array:
        """Derivatives of the residuals, shape (N, m, n); made anew each time."""
        return self.jacobian_of(slice(None))

    def jacobian_of(self, poses: slice) -> Array:
        """Return the derivatives of the residuals at some poses, shape (N, m, n)."""
        freed = self.white.reduced[poses] @ self.by_parameter(poses)
        return np.asarray(freed) / self.white.scale[poses]

    def parts(self) -> Iterator[slice]:
        """Return poses, so many at once as memory holds well."""
        return chunks(len(self.conditions))

    @cached_property
    def triangle(self) -> Array:
        """R of J = Q R over all poses, shape (n, n): the same columns but for a rotation."""
        R = np.zeros((0, 0))
        for poses in self.parts():
            J = self.jacobian_of(poses)
            R = joined(R, J.reshape(-1, J.shape[2]))
        return R

    @property
    def squares(self) -> Array:
        """Sum of the squared residuals of each pose in standard deviations, shape (N,)."""
        return np.einsum("nm,nm->n", self.residuals, self.residuals)

    @cached_property
    def noise(self) -> Array:
        """The least noise that explains the conditions, standard deviations, shape (N, s)."""
        return self.white.least_noise(self.conditions)

    @cached_property
    def noise_by_parameter(self) -> Array:
        """Its derivative, shape (N, s, n): rows that do not turn from state to state."""
        return -(self.white.by_noise.transpose(0, 2, 1) @ self.jacobian)


@dataclass(frozen=True)
class Orthonormal:
    """What makes columns of rows orthonormal: J = Q R, columns of J of unit length before."""

    lengths: Array
    """Of the columns of J, shape (n,)."""
    R: Array
    """Shape (n, n)."""

    @classmethod
    def of(cls, J: Array, prior: Array) -> Orthonormal:
        """Return that of rows of poses, (N, m, n), and of others such as priors', (k, n)."""
        flat = np.concatenate((J.reshape(-1, J.shape[2]), prior))
        lengths = np.linalg.norm(flat, axis=0)
        return cls(lengths, np.asarray(np.linalg.qr(flat / lengths, mode="r")))

    def __call__(self, rows: Array) -> Array:
        """Return Q of rows, of the same shape (…, n)."""
        scaled = (rows / self.lengths).swapaxes(-1, -2)
        return np.asarray(np.linalg.solve(self.R.T, scaled)).swapaxes(-1, -2)


def left_over(Q: Array, r: Array, prior: Array, held: Array) -> tuple[Array, Array]:
    """Return what orthonormal columns do not take up: of rows, (N, m), and of priors, (k,).

    Args:
        Q: Rows of the columns, shape (N, m, n).
        r: Residuals there, shape (N, m).
        prior: Rows of the columns that are the priors', shape (k, n): these are measurements, too.
        held: Residuals of the priors, shape (k,).
    """
    taken = over_rows(Q, r[:, :, None])[:, 0] + held @ prior
    return r - Q @ taken, held - prior @ taken


def joined(R: Array, rows: Array) -> Array:
    """Return R of the QR of rows below the R of others, empty where there are none yet."""
    stacked = np.concatenate((R, rows)) if R.size else rows
    return np.asarray(np.linalg.qr(stacked, mode="r"))
