"""The noise of what was measured in each row: standard deviations, and what goes together.

A tracker measures a range and two angles: errors of x, y and z are correlated, the more so the
farther it is. Columns ``cov_x_y`` say any covariance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pincal.errors import MeasurementError
from pincal.model.checks import ROUNDING
from pincal.model.measurements import Measurements, Noise
from pincal.model.orientation import SINGLE_ANGLES
from pincal.model.platform import Platform
from pincal.model.setup import ORIGIN, POLAR, Setup, Tracker
from pincal.types import Array, Index, Mask


@dataclass(frozen=True)
class RowNoise:
    """The noise of r quantities in N rows."""

    sigma: Array
    """Standard deviations, shape (N, r)."""
    correlation: Array | None = None
    """Symmetric roots of the correlation matrices, shape (N, r, r); None if there are none."""

    @cached_property
    def roots(self) -> Array:
        """Roots S of the covariance matrices S Sᵀ, shape (N, r, r)."""
        correlation = np.eye(self.sigma.shape[1]) if self.correlation is None else self.correlation
        roots = self.sigma[:, :, None] * correlation
        roots.setflags(write=False)
        return roots

    def rows(self, chosen: Index | Mask) -> RowNoise:
        """Return that of some rows."""
        correlation = self.correlation
        return RowNoise(self.sigma[chosen], None if correlation is None else correlation[chosen])


def row_noise(
    names: Sequence[str],
    units: Sequence[str],
    data: Measurements,
    noise: Noise,
    setup: Setup,
    platform: Platform,
) -> RowNoise:
    """Return the noise of quantities: each row's own, a tracker's, else that of the unit.

    Names are freedoms of the platform, columns of the setup, and single angles.

    Raises:
        MeasurementError: covariances that no errors have; a tracker and points measured in part.
    """
    sigmas = _sigmas_by_name(names, data, setup, platform)
    none = np.full(len(data), np.nan)
    general = [noise.position if unit == "m" else noise.orientation for unit in units]
    sigma = np.column_stack([np.empty((len(data), 0)), *(sigmas.get(n, none) for n in names)])
    sigma = np.where(np.isfinite(sigma), sigma, general)
    if setup.tracker is None and not data.covariances:
        return RowNoise(sigma)
    place = {name: column for column, name in enumerate(names)}
    covariance = sigma[:, :, None] ** 2 * np.eye(len(names))
    if setup.tracker is not None:
        for columns, points in _targets(place, data, setup, platform):
            block = _of_tracker(setup.tracker, points, data)[:, : len(columns), : len(columns)]
            rows = np.flatnonzero(np.isfinite(block).all(axis=(1, 2)))
            covariance[np.ix_(rows, columns, columns)] = block[rows]
    for pair, values in data.covariances.items():
        first, second = pair.split(",")
        if {first, second} <= set(place):
            pair_sigmas = (sigmas.get(name, none) for name in (first, second))
            known = np.isfinite([values, *pair_sigmas]).all(axis=0)
            covariance[known, place[first], place[second]] = values[known]
            covariance[known, place[second], place[first]] = values[known]
    return _rooted(covariance, data)


def _sigmas_by_name(
    names: Sequence[str], data: Measurements, setup: Setup, platform: Platform
) -> dict[str, Array]:
    """Return standard deviations of single rows by quantity, each of shape (N,), NaN for none.

    Single angles of a spatial platform have the mean of those of its turns.
    """
    sigmas = {name: v for name, v in data.sigma_extra.items() if name not in setup.polar}
    if data.sigma_poses is None:
        return sigmas
    by_freedom = dict(zip(platform.freedoms, data.sigma_poses.T, strict=True))
    if platform.turns < 3:
        return sigmas | by_freedom
    turns = [name for name in platform.coordinates[platform.lengths :] if name in names]
    middle = np.sqrt((data.sigma_poses[:, platform.lengths :] ** 2).mean(axis=1))
    return dict.fromkeys((*turns, *SINGLE_ANGLES), middle) | sigmas | by_freedom


def _targets(
    place: dict[str, int], data: Measurements, setup: Setup, platform: Platform
) -> list[tuple[Index, Array]]:
    """Return columns of targets' positions and the points, (N, 3), z zero in the plane.

    Raises:
        MeasurementError: a point that was measured in part.
    """
    targets = []
    for target in setup.targets:
        axes = "xyz"[: platform.space]
        names = [axis if target == ORIGIN else f"{target}_{axis}" for axis in axes]
        if not all(name in place for name in names):
            continue
        points = np.zeros((len(data), 3))
        for axis, name in enumerate(names):
            points[:, axis] = data.poses[:, axis] if target == ORIGIN else data.extra[name]
        measured = np.isfinite(points[:, : len(axes)])
        if (part := measured.any(axis=1) & ~measured.all(axis=1)).any():
            raise MeasurementError(
                f"data row {int(np.argmax(part)) + 1}: of {', '.join(names)} some are measured, "
                "some not; a tracker measures all of them (or give 'sigma_x' and the like instead "
                "of the tracker)"
            )
        targets.append((np.array([place[name] for name in names]), points))
    return targets


def _of_tracker(tracker: Tracker, points: Array, data: Measurements) -> Array:
    """Return covariances of points measured by a tracker, (N, 3) to (N, 3, 3).

    Raises:
        MeasurementError: a point straight above or below the tracker.
    """
    ray = points - tracker.at
    above = np.hypot(ray[:, 0], ray[:, 1]) <= ROUNDING**0.5 * np.linalg.norm(ray, axis=1)
    if above.any():
        raise MeasurementError(
            f"data row {int(np.argmax(above)) + 1}: the point is on the vertical axis of the "
            "tracker, where an azimuth says nothing; say where the tracker is ('at' of the tracker)"
        )
    polar = [data.sigma_extra.get(name, np.full(len(data), np.nan)) for name in POLAR]
    general = np.array([tracker.range, tracker.azimuth, tracker.elevation])[:, None]
    root = tracker.by_polar(points) * np.where(np.isfinite(polar), polar, general).T[:, None]
    return np.asarray(root @ root.transpose(0, 2, 1))


def _rooted(covariance: Array, data: Measurements) -> RowNoise:
    """Return standard deviations and roots of correlations, of covariances (N, r, r).

    Raises:
        MeasurementError: a row whose matrix is none of any errors.
    """
    sigma = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    size = np.where(sigma > 0.0, sigma, 1.0)
    correlation = covariance / size[:, :, None] / size[:, None]
    exact = np.where(sigma > 0.0, 0.0, 1.0)
    values, axes = np.linalg.eigh(correlation + exact[:, :, None] * np.eye(sigma.shape[1]))
    low = values.min(axis=1, initial=0.0)
    correlated = np.abs(covariance).sum(axis=2) > np.diagonal(covariance, axis1=1, axis2=2)
    low = np.where((correlated & (sigma == 0.0)).any(axis=1), -1.0, low)  # what is exact has none
    if (low < -(ROUNDING**0.5)).any():
        row = int(np.argmin(low))
        raise MeasurementError(
            f"data {data.place(row)}: its covariances are larger than its standard deviations "
            "allow (a correlation above 1); expected covariances of which the squares are below "
            "the product of both variances"
        )
    root = (axes * np.sqrt(values.clip(0.0))[:, None]) @ axes.transpose(0, 2, 1)
    return RowNoise(sigma, root)
