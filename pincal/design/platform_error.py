"""What uncertain parameters mean for the platform: the error of where it goes.

With e of all legs, δx = −(∂e/∂x)⁻¹ (∂e/∂φ) δφ: single parameters may be uncertain and yet well
known together. Where frames are not measured, motions of these frames are left out.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np

from pincal.blas import one_thread
from pincal.estimation.observability.gauge import frame_motions, unexplained
from pincal.estimation.observability.identifiable import NEGLIGIBLE
from pincal.kinematics.configurations import legs_at
from pincal.model.checks import counted
from pincal.model.measurements import Plan
from pincal.model.mechanism import Mechanism
from pincal.types import Array, Mask
from pincal.words.numbers import amount
from pincal.words.wording import UNCOVERED

Seen = Callable[[Array, Array], tuple[Array, Array, tuple[str, ...]]]
"""Returns what was measured of twists of the platform, (N, dof, k), at poses, (N, dof): (N, r, k),
how unknown frames move it, (N, r, m), and the unit of each of the r; positions of several targets
over the square root of how many they are."""
CONFIDENCE = 0.95
DRAWS = 10_000
_ROUNDING = 1e-6  # by which what is moved at one pose may differ


class Unidentified(NamedTuple):
    """Directions that were held at nominal, as the measurements do not determine them."""

    directions: Array
    """Columns of shape (n, n_lost), as long as parameters may differ from nominal."""
    nominal: Mechanism
    """The mechanism at which they were found."""
    measured: Plan | None = None
    """Where all that is seen of the platform was measured: no more than there do they move it."""


@dataclass(frozen=True, repr=False, eq=False)
class PlatformError:
    """Errors to expect of the platform: root mean squares over poses, and pose by pose.

    Infinite where what is not identified moves the platform.
    """

    std: Array
    """Standard error of each freedom at each planned pose, shape (N, dof), twists in base axes,
    [m] and [rad]; NaN out of reach, infinite where not determined."""
    units: tuple[str, ...]
    """``"m"`` or ``"rad"`` of each freedom."""
    weights: Array
    """Eigenvalues of the mean squares of position and orientation, shape (2, n)."""
    degrees_of_freedom: float | None = None
    """Of the noise, where its scale was estimated; None where it is known."""
    unnoticed: float = 1.0
    """Factor of the limit for errors that residuals cannot show, by χ² at 95 %."""
    hidden: tuple[float, float] = (0.0, 0.0)
    """Root mean squares of the machine's errors up to that scale, beside noise, [m] and [rad]."""
    promised: bool = True
    """Whether a limit is promised: not where something contradicts the model or its noise."""
    outside: Array = field(default_factory=lambda: np.zeros(0))
    """How many times as uncertain as any measured pose each is, (N,): above 1 outside the measured
    region, NaN out of reach; empty where no poses were measured."""
    uncovered: tuple[str, ...] = ()
    """What no limit covers: of ``"weight"``, ``"scale"``, ``"time"`` (``pincal.words.wording``)."""

    @cached_property
    def sizes(self) -> Array:
        """Standard errors of position [m] and orientation [rad] at each pose, shape (N, 2)."""
        return sizes(self.units, self.std)

    @cached_property
    def position(self) -> float:
        """Root mean square over the poses that all legs reach, [m]."""
        return root_mean_squares(self.sizes, infinite=True)[0]

    @cached_property
    def orientation(self) -> float:
        """The same, [rad]; zero for a platform without orientation."""
        return root_mean_squares(self.sizes, infinite=True)[1]

    @property
    def poses(self) -> int:
        """Number of poses that all legs reach."""
        return int((~np.isnan(self.std).any(axis=1)).sum())

    @cached_property
    def determined(self) -> Mask:
        """Planned poses that are reached and at which all is determined, shape (N,)."""
        return np.asarray(np.isfinite(self.std).all(axis=1))

    @cached_property
    def within(self) -> Mask:
        """Planned poses that are reached, determined and in the measured region, shape (N,)."""
        return self.determined & ~(self.outside > 1.0) if self.outside.size else self.determined

    @cached_property
    def limit(self) -> tuple[float, float]:
        """Below which root mean squares are in 95 of 100 such calibrations, [m] and [rad].

        With errors δ of covariance C, the mean square δᵀ M δ is a sum of squares of normal
        numbers, weighted by the eigenvalues of MC: drawn, with the scale of the noise if that was
        estimated. Infinite where nothing is promised, or a pose lies outside the measured region.
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
            lines += [f"  left out          {UNCOVERED[code]}" for code in self.uncovered]
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
    """Return what the covariance of the parameters means for the platform.

    Args:
        mechanism: The mechanism.
        covariance: Of the parameters of all legs, shape (n, n).
        planned: N poses over which to take the mean, coordinates of shape (N, dof), or a plan.
        lost: Directions of parameters that are not identified, columns of shape (n, n_lost): what
            they move at all is not determined; of held ones, by more than median standard errors.
        frames: Motions of frames that are not measured (see ``frames_moved``), shape (k, n_moved):
            what they explain is left out. Or what is seen of the platform, in place of all of it.
        degrees_of_freedom: Of the noise, where its scale was estimated.
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
    """Return what held directions may move at planned configurations, shape (N, r, k).

    Infinite where that is more than a least motion, by which each freedom is uncertain anyway, (r,)
    [m] and [rad], and than where all of it was measured; zero where it is less than a least motion.
    Directions that move nothing are left out.
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
    """Return what is seen of twists of the platform, (N, dof, k), and its units.

    Motions of frames explain the rest, see ``platform_error``; poses are coordinates, (N, dof),
    angles count as lengths at a lever, the mechanism's size if 0.
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
    """Return where directions move the platform by more than a least motion, shape (N, dof)."""
    largest = np.abs(gain).max(axis=(0, 2), initial=0.0) * np.abs(lost).max(initial=0.0)
    moved = np.abs(gain @ lost).max(axis=2, initial=0.0)
    return np.asarray(moved > np.maximum(NEGLIGIBLE * largest, least))


def sizes(units: tuple[str, ...], twists: Array) -> Array:
    """Return the sizes of positions [m] and of orientations [rad] of twists, (N, dof) to (N, 2)."""
    turns = np.array([unit == "rad" for unit in units], dtype=bool)
    parts = (np.linalg.norm(twists[:, columns], axis=1) for columns in (~turns, turns))
    return np.stack(tuple(parts), axis=1)


def root_mean_squares(sizes: Array, *, infinite: bool = False) -> tuple[float, float]:
    """Return root mean squares of both columns, (N, 2), over finite rows; NaN without any.

    Infinite rows may count: with one, the root mean square is infinite.
    """
    known = sizes[~np.isnan(sizes).any(axis=1) if infinite else np.isfinite(sizes).all(axis=1)]
    if not len(known):
        return np.nan, np.nan
    position, orientation = np.sqrt((known**2).mean(axis=0)).tolist()
    return position, orientation
