"""Error of the platform's pose that follows from the covariance of the parameters.

With e of all legs, δx = −(∂e/∂x)⁻¹ (∂e/∂φ) δφ: uncertain single parameters may still determine the
pose well together. Where frames are not measured, the error is taken after their best fit.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np

from pincal.blas import one_thread
from pincal.estimation.observability.gauge import frame_motions, unexplained
from pincal.estimation.observability.identifiable import NEGLIGIBLE
from pincal.kinematics.configurations import legs_at
from pincal.model import Mechanism, Plan
from pincal.model.checks import counted
from pincal.types import Array, Mask
from pincal.words.numbers import amount
from pincal.words.wording import UNCOVERED

Seen = Callable[[Array, Array], tuple[Array, Array, tuple[str, ...]]]
"""Function that projects twists of the platform, (N, dof, k), at poses, (N, dof), on r measured
quantities: (N, r, k). It also returns their motion by unknown frames, (N, r, m), and their units;
positions of several targets are divided by the square root of the number of targets."""
CONFIDENCE = 0.95
DRAWS = 10_000
_ROUNDING = 1e-6  # relative rounding error of a motion


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
        return f"PlatformError({self._shown(self.position, self.orientation)}, {self.poses} poses)"

    def __str__(self) -> str:
        lines = [f"platform error over {self.poses} poses, root mean square"]
        lines.append(f"  expected          {self._shown(self.position, self.orientation)}")
        if not self.promised:
            lines.append("  no limit: something contradicts the model or its noise")
        elif outside := int((self.outside > 1.0).sum()):
            lines.append(f"  no limit: outside the measured region at {counted(outside, 'pose')}")
        else:
            lines.append(f"  95 %: below       {self._shown(*self.limit)}")
            lines += [f"  not covered       {UNCOVERED[code]}" for code in self.uncovered]
        if missing := len(self.std) - int(self.determined.sum()):
            lines.append(f"  out of reach or not determined at {missing} of {len(self.std)} poses")
        return "\n".join(lines)

    def _shown(self, position: float, orientation: float) -> str:
        text = amount(position, "m")
        return f"{text}, {amount(orientation, 'rad')}" if "rad" in self.units else text


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
    held = np.isfinite(legs.gain).all(axis=(1, 2))  # not at a type-2 singularity
    gain, units = seen_of(mechanism, legs.poses[held], legs.gain[held], frames)
    rows = np.flatnonzero(legs.reached)[held]
    std = np.full((len(legs.reached), len(units)), np.nan)
    std[legs.reached] = np.inf
    std[rows] = np.sqrt((gain @ covariance * gain).sum(axis=2).clip(0.0))
    held_moves = np.zeros((*std.shape, 0))
    if isinstance(lost, Unidentified):
        least = np.median(std[rows], axis=0) if len(rows) else np.zeros(len(units))
        held_moves = _motions_of_held(lost, planned, least, frames)
        std = np.sqrt(std**2 + (held_moves**2).sum(axis=2))
    elif lost is not None and lost.shape[1]:
        std[rows] = np.where(_moving(gain, lost), np.inf, std[rows])
    determined = np.isfinite(std).all(axis=1)
    values, axes = np.linalg.eigh(covariance)
    root = axes * np.sqrt(values.clip(0.0))
    known, weights = determined[rows], []
    moves = np.concatenate((gain[known] @ root, held_moves[rows[known]]), axis=2)
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
    platform, units = mechanism.platform, mechanism.platform.units
    if frames is None:
        return twists, units
    if callable(frames):
        twists, motions, units = frames(poses, twists)
    else:
        motions = frame_motions(platform, platform.matrices(poses)) @ frames
    return unexplained(units, twists, motions, lever or mechanism.size), units


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
