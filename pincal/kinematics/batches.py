"""Small matrices and rotations of N poses at once, of shape (N, …).

They are fastest where memory runs along the poses (``.T`` of arrays of shape (…, N)): NumPy then
does one long loop instead of N short ones.
"""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from pincal.types import Array

CHUNK = 6000  # poses at once, whose matrices stay in the cache
_SERIES = float(np.finfo(float).eps) ** 0.25  # fourth root of rounding errors, [rad]


def chunks(count: int) -> Iterator[slice]:
    """Yield slices of at most ``CHUNK`` rows that cover ``count`` rows in order."""
    for begin in range(0, count, CHUNK):
        yield slice(begin, min(begin + CHUNK, count))


def stacked(parts: Sequence[Any]) -> Any:
    """Return the arrays stacked along the first axis; a single one as it is."""
    return parts[0] if len(parts) == 1 else np.concatenate(parts)


def parted(rows: Any, count: int) -> Any:
    """Return a view of rows in ``count`` equal parts, shape (count, N, …)."""
    return rows.reshape(count, len(rows) // count, *rows.shape[1:])


def repeated(matrices: Array, times: int) -> Array:
    """Return matrices (N, i, j) stacked several times, with memory along the poses."""
    if times == 1:
        return matrices
    return np.tile(matrices.transpose(1, 2, 0), times).transpose(2, 0, 1)


def product(a: Array, b: Array) -> Array:
    """Return the product of (N, i, j) and (N, j, k), fast where i, j and k are tiny."""
    inner = a.shape[2]
    if inner == 0:
        return np.zeros((len(a), a.shape[1], b.shape[2]))
    if inner > 3 and b.strides[0] != b.itemsize:  # memory does not run along the poses
        return a @ b
    total = a[:, :, 0, None] * b[:, None, 0, :]
    for j in range(1, inner):
        total += a[:, :, j, None] * b[:, None, j, :]
    return total


def solve(a: Array, b: Array) -> Array:
    """Return X of A X = B, shapes (N, k, k) and (N, k, j); NaN or infinite where A is singular."""
    if a.shape[1] == 0:
        return np.zeros_like(b)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        if a.shape[1] == 1:
            return b / a
        if a.shape[1] == 2:
            (p, q), (r, s) = a.transpose(1, 2, 0)
            adjugate = np.array((s, -q, -r, p)).reshape(2, 2, -1).transpose(2, 0, 1)
            return product(adjugate, b) / (p * s - q * r)[:, None, None]
    if np.isfinite(a).all():
        with suppress(np.linalg.LinAlgError):  # rarely is one exactly singular
            return np.asarray(np.linalg.solve(a, b), np.float64)
    finite = np.isfinite(a).all(axis=(1, 2), keepdims=True)
    safe = np.where(finite, a, np.eye(a.shape[1]))
    solvable = finite & (np.linalg.det(safe) != 0.0)[:, None, None]
    safe = np.where(solvable, safe, np.eye(a.shape[1]))
    return np.where(solvable, np.linalg.solve(safe, b), np.nan)


def least_squares(a: Array, b: Array) -> Array:
    """Return the least-norm X of least |A X - B|, shapes (N, m, k) and (N, m, j) to (N, k, j)."""
    if a.shape[1] == a.shape[2]:
        return solve(a, b)
    transposed = a.transpose(0, 2, 1)
    if a.shape[1] > a.shape[2]:
        return solve(product(transposed, a), product(transposed, b))
    return product(transposed, solve(product(a, transposed), b))


def left_null(matrix: Array) -> Array:
    """Return orthonormal columns N with Nᵀ A = 0, (N, m, p) to (N, m, m - p); det [A N] > 0."""
    count, m, p = matrix.shape
    if p == 0:
        return np.broadcast_to(np.eye(m), (count, m, m))
    if (m, p) in ((2, 1), (3, 2)):  # a cross product: no factorisation needed
        if m == 2:
            normal = np.array((-matrix[:, 1, 0], matrix[:, 0, 0])).T
        else:
            normal = cross(matrix[:, :, 0], matrix[:, :, 1])
        with np.errstate(divide="ignore", invalid="ignore"):
            return (normal / lengths(normal)[:, None])[:, :, None]
    q, _ = np.linalg.qr(matrix, mode="complete")
    square = np.concatenate((matrix, q[:, :, p:]), axis=2)
    with np.errstate(invalid="ignore"):
        q[np.linalg.det(square) < 0.0, :, -1] *= -1.0
    return q[:, :, p:]


def over_rows(a: Array, b: Array) -> Array:
    """Return Σ aᵀ b over all rows, (N, m, i) and (N, m, j) to (i, j), as one matrix product."""
    rows = a.shape[0] * a.shape[1]  # -1 fails for a held leg without columns
    return np.asarray(a.reshape(rows, a.shape[2]).T @ b.reshape(rows, b.shape[2]))


def lengths(vectors: Array) -> Array:
    """Return |v|, shape (N,), of vectors (N, k); NumPy's norm is several times slower."""
    return np.sqrt(np.einsum("nk,nk->n", vectors, vectors))


def block_diagonal(parts: Sequence[Array]) -> Array:
    """Return block diagonal matrices, shape (N, Σk, Σn), of blocks of shape (N, k, n)."""
    rows, columns = (np.cumsum([0, *(part.shape[axis] for part in parts)]) for axis in (1, 2))
    diagonal = np.zeros((len(parts[0]), rows[-1], columns[-1]))
    for part, row, column in zip(parts, rows, columns, strict=False):
        diagonal[:, row : row + part.shape[1], column : column + part.shape[2]] = part
    return diagonal


def turned(matrices: Array, vectors: Array) -> Array:
    """Return R v, shape (3, k, N), for poses (N, 4, 4) and vectors (3, k, N or 1)."""
    every = np.broadcast_to(vectors, (*vectors.shape[:2], len(matrices)))
    return np.einsum("nij,jkn->ikn", matrices[:, :3, :3], every)


def cross(a: Array, b: Array) -> Array:
    """Return a × b for shapes (N, 3); NumPy's cross is several times slower."""
    (x, y, z), (u, v, w) = a.T, b.T
    products = np.empty((3, *np.broadcast_shapes(x.shape, u.shape)))
    np.subtract(y * w, z * v, out=products[0])
    np.subtract(z * u, x * w, out=products[1])
    np.subtract(x * v, y * u, out=products[2])
    return products.T


def point_velocity(arm: Array, twist_rows: tuple[int, ...]) -> Array:
    """Return the velocity of a platform point for unit platform twists, shape (N, 3, dof).

    ``arm`` is from the platform's origin to the point, (N, 3), [m]; ``twist_rows`` are the
    platform's freedoms among the six rows of a twist.
    """
    columns = np.zeros((3, len(twist_rows), len(arm)))
    for index, row in enumerate(twist_rows):
        if row < 3:
            columns[row, index] = 1.0
        else:  # e_i × arm
            i = row - 3
            j, k = (i + 1) % 3, (i + 2) % 3
            columns[j, index], columns[k, index] = -arm[:, k], arm[:, j]
    return columns.transpose(2, 0, 1)


def turn_between(first: Array, second: Array) -> Array:
    """Return the rotation vectors e = log(R₁ R₂ᵀ) of matrices (N, 3, 3), shape (N, 3), [rad].

    A turn ω of R₁ changes e by J⁻¹(e) ω, one of R₂ by −J⁻¹(e)ᵀ ω, J⁻¹ the inverse left Jacobian.
    """
    # by R − Rᵀ, which is fast; by SciPy beyond a quarter turn, where R − Rᵀ gets small again
    turns = first @ second.transpose(0, 2, 1)
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = turns.transpose(1, 2, 0)
    sines = 0.5 * np.array((zy - yz, xz - zx, yx - xy))
    sine, cosine = np.sqrt((sines * sines).sum(axis=0)), 0.5 * (xx + yy + zz - 1.0)
    vectors = (sines * (np.arctan2(sine, cosine) / np.where(sine > 0.0, sine, 1.0))).T
    if (far := cosine < 0.0).any():
        vectors[far] = Rotation.from_matrix(turns[far]).as_rotvec()
    return vectors


def motion_of_points(
    first: Array, second: Array, space: int, sign: float = 1.0, weights: Array | None = None
) -> Array:
    """Return the motion (or reflection, sign −1) from points to others by least squares, (4, 4).

    The points, shape (n, 3), have optional weights (n,) and turn about their centres (Kabsch 1976),
    in the plane normal to z if space is 2.
    """
    weights = np.ones(len(first)) if weights is None else weights
    before, after = (weights @ points / weights.sum() for points in (first, second))
    M = (second - after).T @ ((first - before) * weights[:, None])
    U, _, Vt = np.linalg.svd(M[:space, :space])
    flip, motion = np.ones(space), np.eye(4)
    flip[-1] = sign * np.sign(np.linalg.det(U @ Vt))
    motion[:space, :space] = (U * flip) @ Vt
    motion[:3, 3] = after - motion[:3, :3] @ before
    return motion


def inverse_left_jacobian(vectors: Array) -> Array:
    """Return 1 − S/2 + f S² of rotation vectors v, (N, 3, 3), S = [v]ₓ, S² = v vᵀ − |v|² 1."""
    squares = (vectors * vectors).sum(axis=1)
    angles = np.sqrt(squares)
    small = angles < _SERIES
    safe = np.where(small, 1.0, angles)
    factor = np.where(small, 1 / 12, 1 / safe**2 - (1 + np.cos(safe)) / (2 * safe * np.sin(safe)))
    x, y, z = 0.5 * vectors.T
    outer = vectors.T[:, None] * vectors.T * factor
    diagonal = 1.0 - factor * squares
    rows = ((diagonal, z, -y), (-z, diagonal, x), (y, -x, diagonal))
    return (outer + np.array(rows)).transpose(2, 0, 1)
