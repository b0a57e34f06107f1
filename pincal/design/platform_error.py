"""Error of the platform's pose that follows from the covariance of the parameters.

With e of all legs, δx = −(∂e/∂x)⁻¹ (∂e/∂φ) δφ: uncertain single parameters may still determine the
pose well together. Where frames are not measured, the error is taken after their best fit.
"""

from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.special import chdtri

from pincal.blas import one_thread
from pincal.estimation.observability.gauge import frame_motions, unexplained
from pincal.estimation.observability.identifiable import NEGLIGIBLE
from pincal.estimation.observation import Observation
from pincal.estimation.unknowns import External
from pincal.kinematics.batches import least_squares
from pincal.kinematics.configurations import Legs, legs_at
from pincal.model import Mechanism, Plan
from pincal.types import Array, Mask
from pincal.words.numbers import amount

Seen = Callable[[Array, Array], tuple[Array, Array, tuple[str, ...]]]
"""Function that projects twists of the platform, (N, dof, k), at poses, (N, dof), on r measured
quantities: (N, r, k). It also returns their motion by unknown frames, (N, r, m), and their units;
positions of several targets are divided by the square root of the number of targets."""
CONFIDENCE, DRAWS = 0.95, 10_000
SAMPLES = 1000
"""Number of configurations of the workspace over which errors are stated."""
_ROUNDING = 1e-6  # relative rounding error of a motion, and of the uncertainty of a pose


class Unidentified(NamedTuple):
    """Directions that were held at nominal, as the measurements do not determine them."""

    directions: Array
    """Columns of shape (n, n_lost), as long as parameters may differ from nominal."""
    nominal: Mechanism
    """The mechanism at which the directions were computed."""
    measured: Plan | None = None
    """Poses at which the whole platform was measured: smaller motions than there are harmless."""


@dataclass(frozen=True, repr=False, eq=False)
class PlatformError:
    """Expected errors of the platform: root mean squares over poses, and pose by pose.

    They are infinite where unidentified parameters move the platform.
    """

    std: Array
    """Standard error of each freedom at each planned pose, shape (N, dof), twists in base axes,
    [m] and [rad]; NaN out of reach, infinite where not determined."""
    units: tuple[str, ...]
    """Unit of each freedom, ``"m"`` or ``"rad"``."""
    weights: Array
    """Eigenvalues of the mean squares of position and orientation, shape (2, n)."""
    degrees_of_freedom: float | None = None
    """Degrees of freedom of the noise, if its scale was estimated; None if it is known."""
    unnoticed: float = 1.0
    """Factor on the limit for errors that residuals cannot show, by χ² at 95 %."""
    hidden: tuple[float, float] = (0.0, 0.0)
    """RMS errors of the machine up to that scale, in addition to noise, [m] and [rad]."""
    promised: bool = True
    """Whether a limit holds: False if something contradicts the model or its noise."""
    outside: Array = field(default_factory=lambda: np.zeros(0))
    """Uncertainty of each pose over the largest one of measured poses, (N,): above 1 outside the
    measured region, NaN out of reach; empty where no poses were measured."""
    uncovered: tuple[str, ...] = ()
    """Effects that no limit covers, such as ``"weight"`` or ``"time"`` (see ``UNCOVERED``)."""

    @cached_property
    def sizes(self) -> Array:
        """Standard errors of position [m] and orientation [rad] at each pose, shape (N, 2)."""
        return sizes(self.units, self.std)

    @cached_property
    def position(self) -> float:
        """RMS error of position over the poses that all legs reach, [m]."""
        return root_mean_squares(self.sizes, infinite=True)[0]

    @cached_property
    def orientation(self) -> float:
        """RMS error of orientation, [rad]; zero for a platform without orientation."""
        return root_mean_squares(self.sizes, infinite=True)[1]

    @property
    def poses(self) -> int:
        """Number of poses that all legs reach."""
        return int((~np.isnan(self.std).any(axis=1)).sum())

    @cached_property
    def determined(self) -> Mask:
        """Mask of the planned poses that are reached and fully determined, shape (N,)."""
        return np.asarray(np.isfinite(self.std).all(axis=1))

    @cached_property
    def within(self) -> Mask:
        """Mask of the poses that are reached, determined and in the measured region, (N,)."""
        return self.determined & ~(self.outside > 1.0) if self.outside.size else self.determined

    @cached_property
    def limit(self) -> tuple[float, float]:
        """Limits that the RMS errors of 95 of 100 such calibrations keep, [m] and [rad].

        For errors δ of covariance C, the mean square δᵀ M δ is a sum of squares of normal numbers,
        weighted by the eigenvalues of MC. It is sampled, with the scale of the noise if that was
        estimated. Limits are infinite if none is promised or a pose is outside the measured region.
        """
        if not self.promised or (self.outside > 1.0).any():
            return np.inf, np.inf
        if not self.determined.any():
            return np.nan, np.nan
        rng = np.random.default_rng(0)
        squares = rng.standard_normal((DRAWS, self.weights.shape[1])) ** 2
        if self.degrees_of_freedom is not None:
            dof = max(self.degrees_of_freedom, 1)
            squares *= dof / rng.chisquare(dof, (DRAWS, 1))
        of_parameters = np.sqrt(np.quantile(squares @ self.weights.T, CONFIDENCE, axis=0))
        position, orientation = np.hypot(self.unnoticed * of_parameters, self.hidden).tolist()
        return position, orientation

    def __repr__(self) -> str:
        limit = "no limit: something contradicts the model or its noise"
        if (self.outside > 1.0).any():
            limit = "no limit outside the measured region"
        elif self.promised:
            limit = f"95 %: below {self._shown(*self.limit)}"
        expected = self._shown(self.position, self.orientation)
        return f"PlatformError({expected}, {limit}, {self.poses} poses)"

    def _shown(self, position: float, orientation: float) -> str:
        text = amount(position, "m")
        return f"{text}, {amount(orientation, 'rad')}" if "rad" in self.units else text


def unnoticed(chi2: float, degrees_of_freedom: float) -> float:
    """Return the 95 % limit of residuals over the noise by their reduced χ²; at least 1."""
    if not degrees_of_freedom:
        return 1.0
    return float(np.sqrt(max(1.0, chi2 * degrees_of_freedom / chdtri(degrees_of_freedom, 0.95))))


def outside_of(uncertain: Array, largest: Array) -> Array:
    """Return uncertainties of position and orientation, (N, 2), over the largest measured ones.

    The larger of both ratios, shape (N,), is above 1 outside the measured region, infinite where a
    pose is not determined, and NaN out of reach.
    """
    known = np.where(largest == 0.0, np.inf, np.nan_to_num(largest))  # 0: it does not turn
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios = np.where(np.isinf(uncertain), np.inf, uncertain / known).max(axis=1)
    return np.asarray(ratios * (1.0 - _ROUNDING))


def moved_by_readings(mechanism: Mechanism, legs: Legs, frames: Array | Seen | None) -> Array:
    """Return RMS sizes of visible motions, (N, 2), [m] and [rad], by unit errors of the readings.

    Conditions B δx + D δψ = 0 turn errors of readings into motions by B⁻¹ D. NaN at a type-2
    singularity; ``frames`` are as for ``platform_error``.
    """
    twists = least_squares(legs.pose, legs.reading)
    known = np.asarray(np.isfinite(twists).all(axis=(1, 2)))
    moved, units = seen_of(mechanism, legs.poses[known], twists[known], frames)
    by_readings = np.full((len(known), 2), np.nan)
    by_readings[known] = sizes(units, np.linalg.norm(moved, axis=2))
    return by_readings


@one_thread()
def platform_error(
    mechanism: Mechanism,
    covariance: Array,
    planned: Plan | Array,
    lost: Array | Unidentified | None = None,
    frames: Array | Seen | None = None,
    degrees_of_freedom: float | None = None,
) -> PlatformError:
    """Return the platform's error that follows from the covariance of the parameters.

    Args:
        mechanism: The mechanism.
        covariance: Covariance of the parameters of all legs, shape (n, n).
        planned: N poses over which means are taken, coordinates of shape (N, dof), or a plan.
        lost: Unidentified directions of parameters, columns of shape (n, n_lost): freedoms that
            they move are not determined. Held directions may move them by median standard errors.
        frames: Motions of unmeasured frames (see ``frames_moved``), shape (k, n_moved), whose best
            fit is subtracted; or a function that gives the measured part of twists.
        degrees_of_freedom: Degrees of freedom of the noise, if its scale was estimated.
    """
    legs = legs_at(mechanism, planned)
    gain = legs.gain
    held = np.isfinite(gain).all(axis=(1, 2))  # not at a type-2 singularity
    gain, units = seen_of(mechanism, legs.poses[held], gain[held], frames)
    rows = np.flatnonzero(legs.reached)[held]
    std = np.full((len(legs.reached), len(units)), np.nan)
    std[legs.reached] = np.inf
    values, axes = np.linalg.eigh(covariance)
    moves = gain @ (axes * np.sqrt(values.clip(0.0)))
    std[rows] = np.linalg.norm(moves, axis=2)
    held_moves = np.zeros((*std.shape, 0))
    if isinstance(lost, Unidentified):
        least = np.median(std[rows], axis=0) if len(rows) else np.zeros(len(units))
        held_moves = _motions_of_held(lost, planned, least, frames)
        std = np.sqrt(std**2 + (held_moves**2).sum(axis=2))
    elif lost is not None and lost.shape[1]:
        std[rows] = np.where(_moving(gain, lost), np.inf, std[rows])
    known, weights = np.isfinite(std[rows]).all(axis=1), []
    moves = np.concatenate((moves[known], held_moves[rows[known]]), axis=2)
    for unit in ("m", "rad"):
        G = moves[:, [name == unit for name in units]].reshape(-1, moves.shape[2])
        weights.append(np.linalg.eigvalsh(G.T @ G).clip(0.0) / max(len(moves), 1))
    return PlatformError(std, units, np.array(weights), degrees_of_freedom)


def _motions_of_held(
    lost: Unidentified, planned: Plan | Array, least: Array, frames: Array | Seen | None
) -> Array:
    """Return the motions by held directions at planned configurations, shape (N, r, k).

    A motion is zero below ``least``, the usual uncertainty of each freedom, (r,), [m] and [rad]. It
    is infinite above both ``least`` and the largest motion at poses where all was measured.
    Directions without any motion are dropped.
    """

    def seen_at(plan: Plan | Array) -> tuple[Mask, Array]:
        legs = legs_at(lost.nominal, plan)
        return legs.reached, seen_of(lost.nominal, legs.poses, legs.gain, frames)[0]

    (reached, gain), largest = seen_at(planned), least
    if lost.measured is not None:
        at_measured = np.abs(seen_at(lost.measured)[1] @ lost.directions)
        shown = at_measured.max(axis=(0, 2), where=np.isfinite(at_measured), initial=0.0)
        largest = np.maximum(least, shown * (1.0 + _ROUNDING))
    moving, undetermined = (_moving(gain, lost.directions, size) for size in (least, largest))
    moved = np.where(moving[:, :, None], gain @ lost.directions, 0.0)
    moved[undetermined] = np.inf
    moves = np.zeros((len(reached), *moved.shape[1:]))
    moves[reached] = moved
    return moves[:, :, moves.any(axis=(0, 1))]


def seen_of(
    mechanism: Mechanism, poses: Array, twists: Array, frames: Array | Seen | None, lever: float = 0
) -> tuple[Array, tuple[str, ...]]:
    """Return twists of the platform, (N, dof, k), less the best fit of frames, and their units.

    ``frames`` are as for ``platform_error``, poses are coordinates, (N, dof). For the fit angles
    count as lengths at a lever, [m]; 0 takes the mechanism's size.
    """
    twists, motions, units = motions_of(mechanism, poses, twists, frames)
    return unexplained(units, twists, motions, lever or mechanism.size), units


def motions_of(
    mechanism: Mechanism, poses: Array, twists: Array, frames: Array | Seen | None
) -> tuple[Array, Array, tuple[str, ...]]:
    """Return twists, (N, r, k), motions by frames, (N, r, m), and units: see ``Seen``."""
    platform = mechanism.platform
    if callable(frames):
        return frames(poses, twists)
    motions = np.zeros((*twists.shape[:2], 0))
    if frames is not None:
        motions = frame_motions(platform, platform.matrices(poses)) @ frames
    return twists, motions, platform.units


def seen_targets(
    observation: Observation, measured: Collection[str], values: External
) -> Seen | None:
    """Return the view of targets of which positions are measured, with their orientation if it is.

    It is apart from motions of unknown frames, offsets and turns at their values: the motion of a
    point far from the targets, which no such measurement can fix, is no error of the machine. It is
    None where instruments measure, or no positions.
    """
    platform = observation.platform
    positions = observation.setup.positions(platform).values()
    points = [name for axes in positions if set(axes) <= set(measured) for name in axes]
    if not points or observation.setup.instruments:
        return None
    turns = platform.freedoms[platform.lengths :]
    names = [*points, *(turns if set(turns) <= set(measured) else ())]
    places = [observation.names.index(name) for name in names]
    units = tuple(observation.units[place] for place in places)
    n_targets = len(points) / platform.space
    lengths = np.array([n_targets**0.5 if unit == "m" else 1.0 for unit in units])[:, None]

    def seen(poses: Array, twists: Array) -> tuple[Array, Array, tuple[str, ...]]:
        """Return the visible part of twists at poses: see ``Seen``."""
        at_poses = observation.anywhere().at(np.zeros(len(poses), dtype=np.intp))
        _, by_pose, by_outside = at_poses.residuals(platform.matrices(poses), values)
        return by_pose[:, places] @ twists / lengths, by_outside[:, places] / lengths, units

    return seen


def _moving(gain: Array, lost: Array, least: Array | float = 0.0) -> Mask:
    """Return a mask of freedoms that directions move by more than ``least``, shape (N, dof)."""
    largest = np.abs(gain).max(axis=(0, 2), initial=0.0) * np.abs(lost).max(initial=0.0)
    moved = np.abs(gain @ lost).max(axis=2, initial=0.0)
    return np.asarray(moved > np.maximum(NEGLIGIBLE * largest, least))


def sizes(units: tuple[str, ...], twists: Array) -> Array:
    """Return the lengths [m] and the angles [rad] of twists, (N, dof), as an array (N, 2)."""
    turns = np.array([unit == "rad" for unit in units], dtype=bool)
    parts = (np.linalg.norm(twists[:, columns], axis=1) for columns in (~turns, turns))
    return np.stack(tuple(parts), axis=1)


def root_mean_squares(sizes: Array, *, infinite: bool = False) -> tuple[float, float]:
    """Return the root mean squares of both columns, (N, 2), over finite rows; NaN without any.

    If ``infinite``, infinite rows count, and one makes the root mean square infinite.
    """
    known = sizes[~np.isnan(sizes).any(axis=1) if infinite else np.isfinite(sizes).all(axis=1)]
    if not len(known):
        return np.nan, np.nan
    position, orientation = np.sqrt((known**2).mean(axis=0)).tolist()
    return position, orientation
