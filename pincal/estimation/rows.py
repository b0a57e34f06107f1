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

Many rows with independent noise, such as the points of a photograph, are whitened first. With
B = Q R of these rows, Qᵀ e depends on the pose and joins the other rows. What is left,
(1 − Q Qᵀ) e, does not depend on it. The cost is linear in the number of rows.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from pincal.errors import MeasurementError
from pincal.kinematics.batches import block_diagonal, product, solve
from pincal.model.checks import ROUNDING
from pincal.types import Array, Index


class SplitRows(NamedTuple):
    """Rows with independent noise, split into dof that depend on the pose and what is left.

    Indices come in pairs: of all other rows or noise columns, then of the independent ones.
    """

    rows: tuple[Index, Index]
    columns: tuple[Index, Index]
    sigma: Array
    """Standard deviations, shape (N, j)."""
    range: Array
    """Orthonormal basis Q of the range of their B, shape (N, j, dof)."""

    def __call__(self, rows: Array) -> tuple[Array, Array]:
        """Return the rows that depend on the pose, and what is left, from rows (N, k, n)."""
        single = rows[:, self.rows[1]] / self.sigma[:, :, None]
        along = self.range.transpose(0, 2, 1) @ single
        return np.concatenate((rows[:, self.rows[0]], along), axis=1), single - self.range @ along


@dataclass(frozen=True)
class WhiteRows:
    """The map that eliminates N poses from their rows and whitens these, and the way back."""

    reduced: Array
    """V⁻¹Nᵀ of L = V D, shape (N, m, k), m = k - dof."""
    scale: Array
    """D, by which the rows are divided at the end, shape (N, m, 1)."""
    range: Array
    """Orthonormal basis Q of the range of B, shape (N, k, dof)."""
    triangle: Array
    """R of B = Q R, shape (N, dof, dof)."""
    root: Array
    """S, shape (N, k, s). Where rows were split, these five fields are of the other rows."""
    split: SplitRows | None = None

    def __call__(self, rows: Array) -> Array:
        """Return rows with the pose eliminated and whitened, shape (N, m, n), from (N, k, n)."""
        if self.split is None:
            return np.asarray(self.reduced @ rows) / self.scale
        joined, free = self.split(rows)
        return np.concatenate((self.reduced @ joined / self.scale, free), axis=1)

    @property
    def whitener(self) -> Array:
        """L⁻¹Nᵀ, shape (N, m, k)."""
        return self.reduced / self.scale

    @cached_property
    def noise(self) -> Array:
        """S of all rows, shape (N, k, s)."""
        if self.split is None:
            return self.root
        (rows, single_rows), (columns, single) = self.split.rows, self.split.columns
        n_rows, n_columns = len(rows) + len(single_rows), len(columns) + len(single)
        noise = np.zeros((len(self.root), n_rows, n_columns))
        noise[:, rows[:, None], columns] = self.root[:, : len(rows), : len(columns)]
        noise[:, single_rows, single] = self.split.sigma
        return noise

    @cached_property
    def by_noise(self) -> Array:
        """W = L⁻¹NᵀS, the derivative of white rows by the noise, (N, m, s): W Wᵀ keeps these."""
        return self(self.noise)

    @cached_property
    def back(self) -> Array:
        """S Wᵀ, the conditions that belong to white rows, shape (N, k, m)."""
        return np.asarray(self.noise @ self.by_noise.transpose(0, 2, 1))

    def pose_step(self, rows: Array) -> Array:
        """Return the pose steps, (N, dof), that explain rows (N, k) with the least noise."""
        return self.poses_by(rows[:, :, None])[:, :, 0]

    def poses_by(self, rows: Array) -> Array:
        """Return the pose steps of several sets of rows at once, (N, k, n) to (N, dof, n).

        δx = −R⁻¹ Qᵀ (e − S Wᵀ L⁻¹Nᵀe).
        """
        joined = rows if self.split is None else self.split(rows)[0]
        W = self.reduced @ self.root / self.scale
        noise = W.transpose(0, 2, 1) @ (self.reduced @ joined / self.scale)
        residual = joined - self.root @ noise
        return -solve(self.triangle, self.range.transpose(0, 2, 1) @ residual)


def split_rows(
    pose: Array, noise: Array, sigma: Array, rows: tuple[Index, Index], columns: tuple[Index, Index]
) -> WhiteRows:
    """Return the same as ``white_rows`` for rows some of which have independent noise.

    ``pose`` is B of all rows, (N, k, dof), ``noise`` S of the other rows, (N, i, s), and ``sigma``
    the standard deviations of the independent ones, above zero, (N, j), j ≥ dof. Indices of rows
    and of columns of noise are those of the other rows, then of the independent ones.
    """
    basis, triangle = np.linalg.qr(pose[:, rows[1]] / sigma[:, :, None])
    unit = np.broadcast_to(np.eye(pose.shape[2]), triangle.shape)
    joined = white_rows(
        np.concatenate((pose[:, rows[0]], triangle), axis=1), block_diagonal((noise, unit))
    )
    return replace(joined, split=SplitRows(rows, columns, sigma, basis))


def white_rows(pose: Array, noise: Array) -> WhiteRows:
    """Return the map that eliminates N poses from their rows and whitens these.

    ``pose`` is B, shape (N, k, dof), without columns where poses are known, and ``noise`` is S,
    shape (N, k, s). The map is NaN where B or S is not finite (out of reach).

    Raises:
        MeasurementError: some pose has more exact conditions than freedoms.
    """
    columns = np.concatenate((pose, noise), axis=2)
    finite = np.asarray(np.isfinite(columns).all(axis=(1, 2)))
    if not finite.all():
        rows = white_rows(pose[finite], noise[finite])
        parts = (rows.reduced, rows.scale, rows.range, rows.triangle, rows.root)
        at_all_poses = [np.full((len(finite), *part.shape[1:]), np.nan) for part in parts]
        for values, part in zip(at_all_poses, parts, strict=True):
            values[finite] = part
        reduced, scale, basis, triangle, root = at_all_poses
        return WhiteRows(reduced, scale, basis, triangle, root)
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
    L = np.zeros((count, m, m))  # fewer noise columns than rows leave rows without noise
    if m and s:
        R = np.asarray(np.linalg.qr(rows.transpose(0, 2, 1), mode="r"))
        L[:, :, : min(m, s)] = R.transpose(0, 2, 1)
    return L
