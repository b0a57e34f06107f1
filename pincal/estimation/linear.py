"""Values of all unknowns, the conditions there, and these as rows of ordinary least squares."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pincal.estimation.conditions.external import External
from pincal.estimation.rows import WhiteRows
from pincal.kinematics.derivatives import Demand

Array = NDArray[np.float64]
Index = NDArray[np.intp]


@dataclass(frozen=True)
class State:
    """Values of everything that is unknown."""

    parameters: Array
    """Of the legs, shape (n_params,)."""
    matrices: Array
    """Poses ``T_base_platform``, shape (N, 4, 4)."""
    joints: tuple[Array | None, ...]
    """Joint positions of each leg, shape (N, n_joints); None before the first evaluation."""
    external: External
    """Unknowns outside the mechanism."""

    def rows(self, chosen: Index) -> State:
        """Return the state at some poses."""
        joints = tuple(None if q is None else q[chosen] for q in self.joints)
        return replace(self, matrices=self.matrices[chosen], joints=joints)


@dataclass(frozen=True)
class Stack:
    """Conditions at a state, before anything is eliminated: k rows at each of N poses."""

    state: State
    demands: list[Demand]
    """Of each leg."""
    value: Array
    """e, shape (N, k), [m] and [rad]."""
    parameter: Array
    """A, by all parameters and external unknowns, shape (N, k, n)."""
    pose: Array
    """B, by the platform's twist, shape (N, k, dof); no columns where poses are as measured."""
    noise: Array
    """S, root of the noise, shape (N, k, s)."""


@dataclass(frozen=True)
class Linear:
    """Conditions as rows of ordinary least squares: freed of the poses, and whitened."""

    stack: Stack
    white: WhiteRows
    value: Array
    """Residuals in standard deviations, shape (N, m)."""
    jacobian: Array
    """Their derivatives, shape (N, m, n)."""
    equations: Index
    """How many equations each pose gives, shape (N,)."""

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
