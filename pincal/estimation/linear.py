"""Values of all unknowns, the conditions there, and these as rows of ordinary least squares."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from pincal.estimation.blocks.external import External
from pincal.estimation.blocks.leg_condition import Met
from pincal.estimation.rows import WhiteRows
from pincal.kinematics.batches import chunks, over_rows
from pincal.kinematics.derivatives import Demand
from pincal.types import Array, Index

Follow = Callable[[Array, Array], tuple[Array, ...]]
"""Returns joints of each leg, near those after a step of all unknowns and twists of the poses."""


@dataclass(frozen=True)
class State:
    """Values of everything that is unknown."""

    parameters: Array
    """Of the legs, shape (n_params,)."""
    matrices: Array
    """Poses ``T_base_platform``, shape (N, 4, 4)."""
    joints: tuple[Array | None, ...]
    """Joint positions of each leg, deformations behind them, shape (N, n_joints [+ n_deformed]);
    None before the first evaluation."""
    external: External
    """Unknowns outside the mechanism."""

    def rows(self, chosen: Index) -> State:
        """Return the state at some poses."""
        joints = tuple(None if q is None else q[chosen] for q in self.joints)
        return replace(self, matrices=self.matrices[chosen], joints=joints)


@dataclass(frozen=True)
class Block:
    """Some rows of the conditions by some unknowns; others do not move them."""

    rows: slice
    columns: slice
    values: Array
    """Shape (N, k of the rows, n of the columns)."""


@dataclass(frozen=True)
class Stack:
    """Conditions at a state, before anything is eliminated: k rows at each of N poses."""

    state: State
    legs: tuple[Met, ...]
    """What each leg demands."""
    follow: Follow
    """How their joints follow a step."""
    value: Array
    """e, shape (N, k), [m] and [rad]."""
    blocks: tuple[Block, ...]
    """A, by all parameters and external unknowns: legs move their own rows only."""
    pose: Array
    """B, by the platform's twist, shape (N, k, dof); no columns where poses are as measured."""
    noise: Array
    """S, root of the noise, shape (N, k, s)."""

    @property
    def demands(self) -> list[Demand]:
        """What each leg demands."""
        return [one.demand for one in self.legs]

    @property
    def finite(self) -> bool:
        """Whether all derivatives by the unknowns exist."""
        return all(bool(np.isfinite(one.values).all()) for one in self.blocks)

    def parameter(self, poses: slice = slice(None)) -> Array:
        """Return A of some poses, shape (N, k, n)."""
        n = max(one.columns.stop for one in self.blocks)
        A = np.zeros((len(self.value[poses]), self.value.shape[1], n))
        for one in self.blocks:
            A[:, one.rows, one.columns] = one.values[poses]
        return A

    def after(self, step: Array) -> Array:
        """Return the conditions after a step of the unknowns (n,), to first order, (N, k)."""
        value = self.value.copy()
        for one in self.blocks:
            value[:, one.rows] += one.values @ step[one.columns]
        return value


@dataclass(frozen=True)
class Linear:
    """Conditions as rows of ordinary least squares: freed of the poses, and whitened."""

    stack: Stack
    white: WhiteRows
    value: Array
    """Residuals in standard deviations, shape (N, m)."""
    equations: Index
    """How many equations each pose gives, shape (N,)."""

    @property
    def jacobian(self) -> Array:
        """Derivatives of the residuals, shape (N, m, n); made anew each time."""
        return self.jacobian_of(slice(None))

    def jacobian_of(self, poses: slice) -> Array:
        """Return the derivatives of the residuals at some poses, shape (N, m, n)."""
        return (
            np.asarray(self.white.reduced[poses] @ self.stack.parameter(poses))
            / (self.white.scale[poses])
        )

    def parts(self) -> Iterator[slice]:
        """Return poses, so many at once as memory holds well."""
        return chunks(len(self.value))

    @cached_property
    def triangle(self) -> Array:
        """R of J = Q R over all poses, shape (n, n): the same columns but for a rotation."""
        R = np.zeros((0, 0))
        for poses in self.parts():
            J = self.jacobian_of(poses)
            R = joined(R, J.reshape(-1, J.shape[2]))
        return R

    @property
    def state(self) -> State:
        """Where this is."""
        return self.stack.state

    @property
    def squares(self) -> Array:
        """Sum of the squared residuals of each pose in standard deviations, shape (N,)."""
        return np.einsum("nm,nm->n", self.value, self.value)

    def frozen(self, other: Linear) -> Array:
        """Return the conditions at another state in the rows of this one, shape (N, m)."""
        return self.white(other.stack.value[:, :, None])[:, :, 0]

    @cached_property
    def noise(self) -> Array:
        """The least noise that explains the conditions, standard deviations, shape (N, s)."""
        return self.white.least_noise(self.stack.value)

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
    def of(cls, J: Array, beside: Array) -> Orthonormal:
        """Return that of rows of poses, (N, m, n), and of others such as priors', (k, n)."""
        flat = np.concatenate((J.reshape(-1, J.shape[2]), beside))
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
    both = np.concatenate((R, rows)) if R.size else rows
    return np.asarray(np.linalg.qr(both, mode="r"))
