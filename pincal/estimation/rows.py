"""Conditions of one pose become rows of ordinary least squares: freed of the pose, and whitened.

Gauss–Helmert model. At pose n the conditions e(x, m; φ) = 0 are, to first order,

        e  +  A δφ  +  B δx  +  S ν  =  0,        ν of unit variance,

        ┌ e ┐   ┌ A         ┐   ┌ B ┐   ┌ S           ┐
        │ e │ + │    A      │ + │ B │ + │    S        │    one block row a leg,
        │ ⋮ │   │      ⋱    │   │ ⋮ │   │      ⋱      │
        └ e ┘   └         A ┘   └ B ┘   └           S ┘    one for what was measured.

The left null space N of B frees the rows of the pose, L Lᵀ = (NᵀS)(NᵀS)ᵀ whitens them: what is
left is L⁻¹Nᵀe with the Jacobian L⁻¹NᵀA. A measured quantity of variance zero is exact; one that
was not measured is a row with noise only.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pincal.errors import MeasurementError
from pincal.kinematics.batches import product, solve
from pincal.model.checks import ROUNDING
from pincal.types import Array


@dataclass(frozen=True)
class WhiteRows:
    """Rows of N poses, freed of them and whitened, and the way back to the poses."""

    reduced: Array
    """V⁻¹Nᵀ of L = V D, shape (N, m, k), m = k - dof."""
    scale: Array
    """D, by which rows are divided last, shape (N, m, 1)."""
    range: Array
    """Orthonormal basis Q of the range of B, shape (N, k, dof)."""
    triangle: Array
    """R of B = Q R, shape (N, dof, dof)."""
    noise: Array
    """S, shape (N, k, s)."""

    def __call__(self, rows: Array) -> Array:
        """Return rows freed of the pose and whitened, shape (N, m, n), from shape (N, k, n)."""
        return np.asarray(self.reduced @ rows) / self.scale

    @property
    def whitener(self) -> Array:
        """L⁻¹Nᵀ, shape (N, m, k)."""
        return self.reduced / self.scale

    @cached_property
    def by_noise(self) -> Array:
        """W = L⁻¹NᵀS, how white rows follow the noise, shape (N, m, s): W Wᵀ = 1."""
        return self(self.noise)

    @cached_property
    def back(self) -> Array:
        """S Wᵀ (W Wᵀ)⁻¹, how conditions follow their rows, shape (N, k, m)."""
        W = self.by_noise
        by_rows = np.linalg.solve(W @ W.transpose(0, 2, 1), W @ self.noise.transpose(0, 2, 1))
        return np.asarray(by_rows.transpose(0, 2, 1))

    def pose_step(self, rows: Array) -> Array:
        """Return the step of the poses that explains rows (N, k) with the least noise, (N, dof)."""
        return self.poses_by(rows[:, :, None])[:, :, 0]

    def poses_by(self, rows: Array) -> Array:
        """Return the poses' steps for several rows at once, (N, k, n) to (N, dof, n).

        δx = −R⁻¹ Qᵀ (e − S Wᵀ L⁻¹Nᵀe).
        """
        noise = self.by_noise.transpose(0, 2, 1) @ self(rows)
        residual = rows - self.noise @ noise
        return -solve(self.triangle, self.range.transpose(0, 2, 1) @ residual)


def white_rows(pose: Array, noise: Array) -> WhiteRows:
    """Return what frees the rows of N poses of these and whitens them.

    Args:
        pose: B, derivatives by the pose, shape (N, k, dof); no columns where poses are known.
        noise: S, root of the noise of what was measured, shape (N, k, s).

    Returns:
        NaN at poses where B or S is not finite: those out of reach.

    Raises:
        MeasurementError: more exact conditions than the pose has freedoms, at some pose.
    """
    columns = np.concatenate((pose, noise), axis=2)
    finite = np.asarray(np.isfinite(columns).all(axis=(1, 2)))
    if not finite.all():
        rows = white_rows(pose[finite], noise[finite])
        spread = dict[str, Array]()
        for name, part in vars(rows).items():
            spread[name] = np.full((len(finite), *part.shape[1:]), np.nan)
            spread[name][finite] = part
        return WhiteRows(**spread)
    dof = pose.shape[2]
    Q, R = np.linalg.qr(pose, mode="complete")  # B = Q R, Q square
    N = Q[:, :, dof:].transpose(0, 2, 1)
    L = _root(product(N, noise))
    size = np.abs(np.einsum("nmm->nm", L))
    bound = product(np.abs(N), np.abs(noise)).sum(axis=2)  # of what may have cancelled
    if not (size > ROUNDING * bound).all():
        raise MeasurementError(
            "some measurements carry no noise at all; give standard deviations above zero for what "
            "is measured, and for readings (--noise-reading) where there are more of them than "
            "freedoms, or positions are measured in part"
        )
    V = L / size[:, None]  # of unit diagonal: its determinant does not underflow
    return WhiteRows(solve(V, N), size[:, :, None], Q[:, :, :dof], R[:, :dof], noise)


def _root(rows: Array) -> Array:
    """Return a triangular L with L Lᵀ = A Aᵀ of rows A, shapes (N, m, s) and (N, m, m)."""
    count, m, s = rows.shape
    if m == 1:
        return np.sqrt(rows @ rows.transpose(0, 2, 1))
    L = np.zeros((count, m, m))  # fewer kinds of noise than rows: some of these have none
    if m and s:
        R = np.asarray(np.linalg.qr(rows.transpose(0, 2, 1), mode="r"))
        L[:, :, : min(m, s)] = R.transpose(0, 2, 1)
    return L
