"""The noise of the measurements: given, in columns, from repeated rows, or assumed.

A tracker measures a range and two angles, so its errors of x, y and z are correlated, the more the
farther away it stands.
"""

from collections import defaultdict
from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, Self

import numpy as np

from pincal.errors import MeasurementError
from pincal.model import ORIGIN, ROW, Measurements, Mechanism, Noise, Platform, Setup
from pincal.model.checks import ROUNDING
from pincal.model.measurements import SMALLEST_SIGMA
from pincal.model.relations import POLAR, Tracker
from pincal.types import Array, Index, Mask
from pincal.words.findings import finding, sentence

Freedoms = tuple[float, ...]
Source = Literal["given", "rows", "repeats", "estimated"]
_ENOUGH = 30  # repeated rows; fewer say less about the noise than the residuals do
_MARKED = 0.03  # noise of a marked point over the least noise of distances from it
_ASSUMED = 1e-4  # of the mechanism's size, and [rad]: where an estimate of the noise begins
_PLAUSIBLE = 0.02  # most noise of positions, over the mechanism's size, or [rad]
_ASSUMED_PIXEL = 0.5  # the same for pixels, [px]


@dataclass(frozen=True)
class RowNoise:
    """The noise of r quantities in N rows."""

    sigma: Array
    """Standard deviations, shape (N, r)."""
    correlation: Array | None = None
    """Symmetric roots of the correlation matrices, shape (N, r, r); None if uncorrelated."""

    @cached_property
    def roots(self) -> Array:
        """Roots S of the covariance matrices S Sᵀ, shape (N, r, r)."""
        correlation = np.eye(self.sigma.shape[1]) if self.correlation is None else self.correlation
        roots = self.sigma[:, :, None] * correlation
        roots.setflags(write=False)
        return roots

    def rows(self, chosen: Index | Mask) -> Self:
        """Return the noise of some rows."""
        correlation = None if self.correlation is None else self.correlation[chosen]
        return replace(self, sigma=self.sigma[chosen], correlation=correlation)


@dataclass(frozen=True)
class NoiseModel:
    """Standard deviations of the measurements, and where they come from."""

    noise: Noise
    """The noise of quantities without a standard deviation in their row."""
    poses: RowNoise
    """The noise of the platform's freedoms."""
    readings: Array
    """Standard deviations of the readings, shape (N, n_readings)."""
    source: Source
    freedoms: Freedoms = (np.inf,) * 4
    """Degrees of freedom with which the variances of positions, orientations, readings and pixels
    are known; infinite if given."""

    @property
    def known(self) -> bool:
        """Whether the scale of the noise is known."""
        return self.source != "estimated"


def noise_model(
    mechanism: Mechanism, data: Measurements, noise: Noise | None, setup: Setup
) -> NoiseModel:
    """Return the noise of measurements.

    Without ``noise`` and without columns of standard deviations, repeated rows give it if there
    are enough of them. Otherwise it is to be estimated, and the result is where that begins, with
    exact readings where poses were measured in full. Columns of pixels alone give proportions.

    Raises:
        MeasurementError: noise is given twice, or columns give it for readings only.
    """
    _check_tracker(mechanism, data, setup)
    full, rows = bool(np.isfinite(data.poses).all()), _has_sigmas(mechanism, data, noise, setup)
    source: Source = "given"
    freedoms: Freedoms = (np.inf,) * 4
    of_setup = setup.noises(mechanism.platform)
    of_rows = {*of_setup, *data.sigma_extra}
    touched = setup.contact_axes(mechanism.platform).items()
    if rows and any(of_rows.isdisjoint(axes) for name, axes in touched if name != ROW):
        raise MeasurementError(
            "columns of standard deviations are given, and nothing says by how much contacts miss; "
            "add 'noise' to each of them in the setup"
        )
    if rows:
        _check_sigmas(mechanism, data, setup)
        source, general = "rows", Noise(_ASSUMED, _ASSUMED, 0.0)
    elif noise is None and (setup.tracker or any(of_setup.values())):
        raise MeasurementError(
            "the setup says how well a tracker or a contact measures; give the noise of all else "
            "that was measured, 0 for what is exact (--noise-orientation, --noise-reading)"
        )
    elif noise is not None:
        general = noise
    elif not setup.pixels and (repeated := _noise_of_repeats(mechanism, data)) is not None:
        source, (general, freedoms) = "repeats", repeated
    else:
        source, general = "estimated", assumed_noise(mechanism, exact=full, sees=bool(setup.pixels))
        if data.sigma_extra:
            usual = np.sqrt(np.nanmean(np.square([*data.sigma_extra.values()])))
            general = replace(general, pixel=float(usual))
    platform = mechanism.platform
    poses = row_noise(platform.freedoms, platform.units, data, general, setup, platform)
    readings = data.sigma_readings
    readings = np.full(data.readings.shape, general.reading) if readings is None else readings
    return NoiseModel(general, poses, readings, source, freedoms)


def assumed_noise(mechanism: Mechanism, *, exact: bool, sees: bool = True) -> Noise:
    """Return the noise where an estimate begins, by the mechanism's size; pixels if cameras see."""
    size = max(leg.size for leg in mechanism.legs)
    metric = "m" in mechanism.reading_units
    reading = 0.0 if exact and not mechanism.redundant else _ASSUMED * (size if metric else 1.0)
    return Noise(_ASSUMED * size, _ASSUMED, reading, _ASSUMED_PIXEL * sees)


def _has_sigmas(
    mechanism: Mechanism, data: Measurements, noise: Noise | None, setup: Setup
) -> bool:
    """Return whether columns give standard deviations; columns of readings alone are refused.

    Columns of pixels may stand beside a noise that is given or estimated.
    """
    rows = data.sigma_poses is not None or bool(data.sigma_extra.keys() - setup.pixels)
    if data.sigma_readings is not None and np.isfinite(data.poses).all() and not rows:
        raise MeasurementError(
            "the measurements give standard deviations of readings but none of poses; add columns "
            + ", ".join(f"'sigma_{name}'" for name in mechanism.platform.coordinates)
        )
    if (rows or data.sigma_readings is not None) and noise is not None:
        raise MeasurementError(
            "the measurements have columns of standard deviations, and the noise is given as "
            "well; leave out one of them"
        )
    return rows or data.sigma_readings is not None


def _check_tracker(mechanism: Mechanism, data: Measurements, setup: Setup) -> None:
    """Raise if a tracker's noise is incomplete, or if positions have standard deviations, too."""
    if setup.tracker is None:
        return
    level = mechanism.platform.space == 2 and setup.tracker.at[2] == 0.0
    for name in POLAR[: 2 if level else 3]:
        if not getattr(setup.tracker, name):
            raise MeasurementError(
                f"nothing says how well the tracker measures the {name}; add {name!r} to the "
                "tracker in the setup"
            )
    sigma = np.full((0, 0), np.nan) if data.sigma_poses is None else data.sigma_poses
    if np.isfinite(sigma[:, : mechanism.platform.lengths]).any():
        raise MeasurementError(
            "positions have standard deviations of their own and those of a tracker's range and "
            "angles as well; leave out one of them"
        )


def _check_sigmas(mechanism: Mechanism, data: Measurements, setup: Setup) -> None:
    """Raise if some measured quantities lack a standard deviation, or have too small a one."""
    columns = [v for v in (data.sigma_poses, data.sigma_readings) if v is not None]
    sigmas = np.column_stack([*columns, *data.sigma_extra.values()])
    tiny = (sigmas > 0.0) & (sigmas < SMALLEST_SIGMA)
    if tiny.any():
        raise MeasurementError(
            f"data row {int(np.argmax(tiny.any(axis=1))) + 1}: a standard deviation is "
            f"{sigmas[tiny][0]:g}; expected {SMALLEST_SIGMA:g} or more, or 0 for what is exact"
        )
    platform = mechanism.platform
    measured = np.isfinite(data.poses)
    known = np.zeros_like(measured) if data.sigma_poses is None else np.isfinite(data.sigma_poses)
    if setup.tracker is not None:
        known[:, : platform.lengths] = True
    if platform.kind == "spatial":  # coordinates and freedoms of the orientation are not the same
        measured[:, 3:] = measured[:, 3:].any(axis=1, keepdims=True)
    missing = [
        name
        for name, column in zip(platform.freedoms, (measured & ~known).T, strict=True)
        if column.any()
    ]
    for name, values in data.extra.items():
        sigma = data.sigma_extra.get(name, np.full(len(data), np.nan))
        if name in setup.noises(platform) or (setup.tracker and name in setup.points(platform)):
            continue
        if (np.isfinite(values) & ~np.isfinite(sigma)).any():
            missing.append(name)
    if missing:
        raise MeasurementError(
            f"some columns of standard deviations are given, but none of {missing[0]!r}, which was "
            f"measured; add 'sigma_{missing[0]}' for each such row, or leave all of them out"
        )


def _noise_of_repeats(mechanism: Mechanism, data: Measurements) -> tuple[Noise, Freedoms] | None:
    """Return the noise within repeated rows and its degrees of freedom, or None if too few.

    Rows repeat each other if their column ``pose`` is the same or, without it, if all readings are
    equal to the last digit. Equal values say nothing about their noise: equal readings count as
    exact, and equal poses leave the noise to the residuals.
    """
    several = _repeated_rows(data)
    dof = sum(len(rows) - 1 for rows in several)
    if dof < _ENOUGH:
        return None
    platform, twists = mechanism.platform, []
    turns = np.array([unit == "rad" for unit in platform.units], dtype=bool)
    for rows in several:
        first = np.tile(data.poses[rows[0]], (len(rows), 1))
        twists.append(platform.twists_between(first, data.poses[rows]))
    position = _variance_within([twist[:, ~turns] for twist in twists])
    orientation = _variance_within([twist[:, turns] for twist in twists])
    reading = _variance_within([data.readings[rows] for rows in several])
    if not position > 0.0 or (turns.any() and not orientation > 0.0):
        return None
    noise = Noise(*(float(np.sqrt(value)) for value in (position, orientation, reading)))
    counts = ((~turns).sum(), turns.sum(), data.readings.shape[1] if reading else 0)
    p, o, r = (float(dof * n) if n else np.inf for n in counts)
    return noise, (p, o, r)


def _repeated_rows(data: Measurements) -> list[Index]:
    """Return groups of rows that repeat each other and are measured in full."""
    groups: dict[Hashable, list[int]] = defaultdict(list)
    complete = np.isfinite(data.poses).all(axis=1) & np.isfinite(data.readings).all(axis=1)
    for row in np.flatnonzero(complete).tolist():
        name = data.readings[row].tobytes() if data.places is None else data.places[row]
        if name:  # a row without a name repeats no other
            groups[None if data.runs is None else data.runs[row], name].append(row)
    return [np.array(rows) for rows in groups.values() if len(rows) > 1]


def _variance_within(groups: list[Array]) -> float:
    """Return the variance within groups of rows, (n, k) each; 0 if most rows are equal."""
    within = np.concatenate([rows - rows.mean(axis=0) for rows in groups])
    rounding = ROUNDING * max(float(np.abs(rows).max(initial=0.0)) for rows in groups)
    if not within.size or not np.median(np.abs(within)) > rounding:
        return 0.0
    dof = sum(len(rows) - 1 for rows in groups) * within.shape[1]
    return float((within**2).sum() / dof)


def row_noise(
    names: Sequence[str],
    units: Sequence[str],
    data: Measurements,
    noise: Noise,
    setup: Setup,
    platform: Platform,
) -> RowNoise:
    """Return the noise of quantities: by columns, by a tracker, else by their units.

    ``names`` are freedoms of the platform and columns of the setup.
    """
    sigmas = _sigmas_by_name(data, noise, setup, platform)
    none = np.full(len(data), np.nan)
    general = [noise.of_unit(unit) for unit in units]
    sigma = np.column_stack([np.empty((len(data), 0)), *(sigmas.get(n, none) for n in names)])
    sigma = np.where(np.isfinite(sigma), sigma, general)
    if setup.tracker is None:
        return RowNoise(sigma)
    place = {name: column for column, name in enumerate(names)}
    covariance = sigma[:, :, None] ** 2 * np.eye(len(names))
    for target in setup.targets:
        axes = "xyz"[: platform.space]
        parts = [axis if target == ORIGIN else f"{target}_{axis}" for axis in axes]
        if set(parts) <= set(place):
            columns = np.array([place[name] for name in parts])
            block = _of_tracker(setup.tracker, target_positions(platform, data, target), parts)
            rows = np.flatnonzero(np.isfinite(block).all(axis=(1, 2)))
            covariance[np.ix_(rows, columns, columns)] = block[rows]
    sigma = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    size = np.where(sigma > 0.0, sigma, 1.0)
    correlation = covariance / size[:, :, None] / size[:, None]
    correlation += np.where(sigma > 0.0, 0.0, 1.0)[:, :, None] * np.eye(len(names))  # exact
    values, eigenvectors = np.linalg.eigh(correlation)
    root = (eigenvectors * np.sqrt(values.clip(0.0))[:, None]) @ eigenvectors.transpose(0, 2, 1)
    return RowNoise(sigma, root)


def _sigmas_by_name(
    data: Measurements, noise: Noise, setup: Setup, platform: Platform
) -> dict[str, Array]:
    """Return the standard deviations of rows, (N,), for each quantity that has them.

    A small share of the noise of a distance between rows belongs to the marked point: exact points
    beside exact readings would leave rows without noise.
    """
    sigmas, none = dict(data.sigma_extra), np.full(len(data), np.nan)
    for name, size in setup.noises(platform).items():
        sigma = sigmas.get(name, none)
        sigmas[name] = np.where(np.isfinite(sigma), sigma, size)
    if data.sigma_poses is not None:
        sigmas |= dict(zip(platform.freedoms, data.sigma_poses.T, strict=True))
    if between := setup.between_rows:
        usual = np.full(len(data), noise.position)
        distances = {name: data.sigma_extra.get(name, usual) for name in between}
        marked = _MARKED * float(np.nanmin(np.concatenate([*distances.values(), [np.inf]])))
        axes = setup.contact_axes(platform).get(ROW, [])
        sigmas |= dict.fromkeys(axes, np.full(len(data), marked))
        for name, sigma in distances.items():
            sigmas[name] = np.sqrt(np.maximum(sigma**2 - marked**2, 0.0))
    return sigmas


def target_positions(platform: Platform, data: Measurements, target: str) -> Array:
    """Return measured positions of a target, (N, 3); NaN where not measured, z = 0 in the plane."""
    measured, none = np.zeros((3, len(data))), np.full(len(data), np.nan)
    columns = [*data.poses.T[: platform.lengths]] if target == ORIGIN else []
    columns = columns or [data.extra.get(f"{target}_{a}", none) for a in "xyz"[: platform.space]]
    measured[: len(columns)] = columns
    return measured.T


def _of_tracker(tracker: Tracker, points: Array, names: Sequence[str]) -> Array:
    """Return covariances (N, n, n) of n coordinates of points (N, 3) measured by a tracker."""
    n, measured = len(names), np.isfinite(points)[:, : len(names)]
    if (part := measured.any(axis=1) & ~measured.all(axis=1)).any():
        raise MeasurementError(
            f"data row {int(np.argmax(part)) + 1}: of {', '.join(names)} some are measured, some "
            "not; a tracker measures all of them (or give 'sigma_x' and the like instead of the "
            "tracker)"
        )
    x, y, z = ray = (points - tracker.at).T
    level, length = np.hypot(x, y), np.linalg.norm(ray, axis=0)
    above = level <= ROUNDING**0.5 * length
    if above.any():
        raise MeasurementError(
            f"data row {int(np.argmax(above)) + 1}: the point is on the vertical axis of the "
            "tracker, where an azimuth says nothing; say where the tracker is ('at' of the tracker)"
        )
    azimuth = np.arctan2(y, x)
    along = tracker.range * ray / np.where(length > 0.0, length, 1.0)
    turned = tracker.azimuth * np.array((-y, x, 0.0 * z))
    raised = tracker.elevation * np.array((-z * np.cos(azimuth), -z * np.sin(azimuth), level))
    root = np.stack((along.T, turned.T, raised.T), axis=2)
    return np.asarray(root @ root.transpose(0, 2, 1))[:, :n, :n]


def check_noise(mechanism: Mechanism, noise: Noise | None) -> None:
    """Raise if noise is above 2 % of a leg's size or 0.02 rad, or of no unit of the readings."""
    size, noise = mechanism.size, noise or Noise(0.0, 0.0)
    typed, units = getattr(noise.reading, "dimension", ""), mechanism.reading_units
    if units and typed not in ("", *units):
        right = {"m": "lengths: give it as 20um", "rad": "angles: give it as 0.01mrad"}[units[0]]
        raise MeasurementError(
            f"--noise-reading is in {typed}, but the readings of {mechanism.name!r} are {right}"
        )
    turns = "rad" in mechanism.platform.units
    for what, given, unit, most in (
        ("position", noise.position, "m", _PLAUSIBLE * size),
        ("orientation", noise.orientation, "rad", _PLAUSIBLE if turns else np.inf),
    ):
        if given > most:
            values = finding(
                "noise-too-large", what=what, given=given, unit=unit, most=most, size=size
            )
            raise MeasurementError(sentence(values))
