"""Rows freed of the pose and whitened: generalised least squares, exact conditions, reach."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import null_space

import pincal
from pincal.estimation.rows import white_rows

SIZES = [(5, 2, 4, 6), (7, 3, 4, 7), (4, 0, 3, 5), (3, 2, 1, 3), (12, 6, 6, 18), (2, 0, 2, 2)]


def conditions(
    k: int, dof: int, n: int, s: int, seed: int = 0
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return e, A, B and S of eight poses; noise of sizes that differ."""
    rng = np.random.default_rng([k, dof, n, s, seed])
    e, A, B = (rng.normal(size=(8, k, size)) for size in (1, n, dof))
    return e[:, :, 0], A, B, rng.normal(size=(8, k, s)) * 10.0 ** rng.uniform(-1, 1, s)


@pytest.mark.parametrize("size", SIZES)
def test_rows_are_white_and_free_of_the_pose(size: tuple[int, int, int, int]) -> None:
    """W Wᵀ = 1, and the poses' columns are gone."""
    _, _, B, S = conditions(*size)
    white = white_rows(B, S)
    identity = np.broadcast_to(np.eye(size[0] - size[1]), (8, *2 * (size[0] - size[1],)))
    np.testing.assert_allclose(
        white.by_noise @ white.by_noise.transpose(0, 2, 1), identity, atol=1e-11
    )
    scale = np.abs(white.whitener).max()
    np.testing.assert_allclose(white(B) / scale, 0.0, atol=1e-14)


@pytest.mark.parametrize("size", SIZES)
def test_information_is_that_of_the_null_space(size: tuple[int, int, int, int]) -> None:
    """Aᵀ N (Nᵀ S Sᵀ N)⁻¹ Nᵀ A, with SciPy's null space of Bᵀ."""
    _, A, B, S = conditions(*size)
    J = white_rows(B, S)(A)
    for found, a, b, s in zip(J, A, B, S, strict=True):
        N = null_space(b.T) if b.shape[1] else np.eye(len(b))
        Q, R = np.linalg.qr((N.T @ s).T)
        half = np.linalg.solve(R.T, N.T @ a)
        assert Q.shape[1] == found.shape[0]
        scale = (half**2).sum()
        np.testing.assert_allclose(found.T @ found / scale, half.T @ half / scale, atol=1e-12)


@pytest.mark.parametrize("size", SIZES)
def test_estimates_are_those_of_generalised_least_squares(
    size: tuple[int, int, int, int],
) -> None:
    """Parameters and poses together, every pose unknown, weights (S Sᵀ)⁻¹, by dense algebra."""
    k, dof, n, _ = size
    e, A, B, S = conditions(*size)
    white = white_rows(B, S)
    J, r = white(A).reshape(-1, n), white(e[:, :, None]).reshape(-1)
    step = -np.linalg.lstsq(J, r, rcond=None)[0]
    poses = white.pose_step(e + A @ step)

    whole = np.zeros((8 * k, n + 8 * dof))
    whole[:, :n] = A.reshape(-1, n)
    for row in range(8):
        whole[row * k : (row + 1) * k, n + row * dof : n + (row + 1) * dof] = B[row]
        U, sizes, _ = np.linalg.svd(S[row], full_matrices=False)  # (S Sᵀ)^(-1/2) = U Σ⁻¹ Uᵀ
        root = (U / sizes) @ U.T
        part = slice(row * k, (row + 1) * k)
        whole[part], e[row] = root @ whole[part], root @ e[row]
    scale = np.linalg.norm(whole, axis=0)
    expected = -np.linalg.lstsq(whole / scale, e.reshape(-1), rcond=None)[0] / scale
    np.testing.assert_allclose(step, expected[:n], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(poses.reshape(-1), expected[n:], rtol=1e-8, atol=1e-11)


@pytest.mark.parametrize("size", SIZES)
def test_poses_and_least_noise_explain_the_rows(size: tuple[int, int, int, int]) -> None:
    """E + B δx + S ν = 0, with |ν| the length of the white rows: no shorter noise does."""
    e, A, B, S = conditions(*size)
    white = white_rows(B, S)
    noise = -(white.by_noise.transpose(0, 2, 1) @ white(e[:, :, None]))[:, :, 0]
    pose = white.pose_step(e)
    left = e + (B @ pose[:, :, None] + S @ noise[:, :, None])[:, :, 0]
    np.testing.assert_allclose(left, 0.0, atol=1e-10)
    length = np.linalg.norm(white(e[:, :, None])[:, :, 0], axis=1)
    np.testing.assert_allclose(np.linalg.norm(noise, axis=1), length, rtol=1e-10)
    several = white.poses_by(A)
    assert several.shape == (8, size[1], size[2])
    np.testing.assert_allclose(several[:, :, 0], white.pose_step(A[:, :, 0]), atol=1e-12)


def test_exact_conditions_are_the_limit_of_small_variances() -> None:
    """Two of five quantities exact: as with standard deviations of 1e-9 of the others'."""
    e, A, B, S = conditions(5, 2, 4, 5)
    S = S / np.linalg.norm(S, axis=1, keepdims=True)
    found = []
    for size in (0.0, 1e-9):
        noise = S.copy()
        noise[:, :, :2] *= size
        white = white_rows(B, noise)
        J = white(A)
        found.append((J.transpose(0, 2, 1) @ J, white.pose_step(e)))
    for exact, limit in zip(*found, strict=True):
        np.testing.assert_allclose(exact, limit, rtol=1e-7, atol=1e-9)


def test_more_exact_conditions_than_freedoms_contradict() -> None:
    """Three rows without noise for two freedoms; noise that the poses take up counts as none."""
    _, _, B, S = conditions(5, 2, 4, 5)
    exact = S.copy()
    exact[3, 2:] = 0.0
    with pytest.raises(pincal.MeasurementError):
        white_rows(B, exact)
    exact[3, 2] = 1e-9 * S[3, 2]
    assert np.isfinite(white_rows(B, exact).by_noise).all()
    with pytest.raises(pincal.MeasurementError):
        white_rows(B, B @ np.ones((8, 2, 6)))
    with pytest.raises(pincal.MeasurementError):
        white_rows(B, S[:, :, :2])
    with pytest.raises(pincal.MeasurementError):
        white_rows(B[:, :, :0], np.zeros((8, 5, 0)))


@pytest.mark.parametrize("sigma", [1e-9, 1.0, 1e6])
def test_rows_of_noise_alone_change_nothing(sigma: float) -> None:
    """What was not measured: the same information, the same poses."""
    e, A, B, S = conditions(5, 2, 4, 6)
    more_e, more_A, more_B = (
        np.concatenate((one, np.zeros((8, 1, *one.shape[2:]))), axis=1) for one in (e, A, B)
    )
    more_S = np.zeros((8, 6, 7))
    more_S[:, :5, :6], more_S[:, 5, 6] = S, sigma
    one, other = white_rows(B, S), white_rows(more_B, more_S)
    expected, found = one(A), other(more_A)
    expected, found = (J.transpose(0, 2, 1) @ J for J in (expected, found))
    np.testing.assert_allclose(found, expected, rtol=1e-10, atol=1e-10 * np.abs(expected).max())
    np.testing.assert_allclose(other.pose_step(more_e), one.pose_step(e), rtol=1e-9, atol=1e-12)


def test_poses_out_of_reach_stay_nan() -> None:
    """The others' rows are those that they have alone; no poses at all are no rows."""
    e, A, B, S = conditions(5, 2, 4, 6)
    lost = np.array([1, 6])
    broken_B, broken_S = B.copy(), S.copy()
    broken_B[1], broken_S[6, 2, 3] = np.nan, np.nan
    white, whole = white_rows(broken_B, broken_S), white_rows(B, S)
    kept = np.setdiff1d(np.arange(8), lost)
    np.testing.assert_array_equal(white(A)[kept], whole(A)[kept])
    np.testing.assert_allclose(white.pose_step(e)[kept], whole.pose_step(e)[kept], rtol=1e-12)
    assert np.isnan(white(A)[lost]).all()
    assert np.isnan(white.pose_step(e)[lost]).all()
    assert white_rows(B[:0], S[:0])(A[:0]).shape == (0, 3, 4)


def test_sizes_of_noise_do_not_matter() -> None:
    """Standard deviations of 1e-50: rows are 1e50 times as long, no power under- or overflows."""
    _, A, B, S = conditions(9, 2, 4, 9)
    one, small = white_rows(B, S)(A), white_rows(B, 1e-50 * S)(A)
    np.testing.assert_allclose(1e-50 * small, one, rtol=1e-9)
    single = white_rows(B[:, :3], S[:, :3])(A[:, :3])
    np.testing.assert_allclose(
        1e-50 * white_rows(B[:, :3], 1e-50 * S[:, :3])(A[:, :3]), single, rtol=1e-12
    )
