"""What rows of measurements determine: of all legs together, or of each by rows of its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pincal.design.information import Information, leg_whitener, parameter_ids
from pincal.errors import MeasurementError
from pincal.estimation.observability.frames import frames_moved, split_frames
from pincal.estimation.observability.generic import GENERIC
from pincal.estimation.observability.indices import Identifiability, identifiability, scaled_axes
from pincal.kinematics.configurations import Legs, legs_at, nearby
from pincal.kinematics.derivatives import leg_demand
from pincal.kinematics.legs.closure import largest_size
from pincal.model.measuring.measurements import Noise, Plan
from pincal.model.measuring.setup import Setup
from pincal.model.measuring.uncertainty import Systematic
from pincal.model.mechanism import Mechanism

Array = NDArray[np.float64]
Method = Literal["all-legs", "per-leg"]
"""All legs together from every row, or each leg alone."""


@dataclass(frozen=True)
class Estimable:
    """What rows of measurements determine."""

    measured: tuple[str, ...]
    """What is measured of the platform."""
    equations: int
    """Equations that a pose gives."""
    least: float
    """Fewest poses like these that can determine as much."""
    rank: Identifiability
    """Of all parameters and external unknowns together, by their ids."""
    covariance: Array
    """Of what is determined, shape (n, n), parameters leg by leg."""
    lost: Array
    """Directions that are not determined, columns of shape (n, n_lost)."""
    influence: Array
    """How parameters follow the noise of each reading, then of each quantity measured, at each
    pose, in standard deviations and but for a sign, shape (N, n, s)."""


def all_legs(legs: Legs, known: Information) -> Estimable:
    """Return what all legs' rows determine, external unknowns left out of the covariance.

    What is off in all rows comes on top, however many they are.
    """
    rows, off, n_legs = known.rows, known.off, legs.parameter.shape[2]
    flat = rows.reshape(-1, rows.shape[2])
    rank, equations = identifiability(flat, known.unknowns), rows.shape[1]
    root, lost = pseudo_inverse(flat, rank.rank)
    own = root[:, :n_legs]
    influence = (own.T @ root) @ rows.transpose(0, 2, 1) @ known.white.by_noise
    moved = own.T @ (root @ (flat.T @ off.reshape(len(flat), -1)))
    covariance = own.T @ own + moved @ moved.T
    least = float(np.ceil(rank.rank / equations))
    return Estimable(known.measured, equations, least, rank, covariance, lost[:n_legs], influence)


def check_whole(mechanism: Mechanism, measured: Sequence[str] | None, setup: Setup) -> None:
    """Raise if each leg cannot be calibrated alone.

    Raises:
        MeasurementError: poses are measured in part or in another frame, or do not determine the
            readings.
    """
    freedoms = mechanism.platform.freedoms
    part = measured is not None and not set(measured) >= set(freedoms)
    part |= setup.tracker is not None or setup.systematic != Systematic()
    if part or not setup.plain or mechanism.by_readings:
        raise MeasurementError(
            "each leg alone (method 'per-leg') takes whole poses in the base frame that determine "
            "the readings, measured without a tracker or systematic uncertainties; take method "
            "'all-legs'"
        )


def each_leg(
    mechanism: Mechanism, plan: Plan, reached: NDArray[np.bool_], noise: Noise
) -> Estimable:
    """Return what each leg's rows determine, poses that all legs reach, of the leg's set.

    With W e of a leg whitened and J = ∂(W e)/∂φ, δφ = −(Jᵀ J)⁻¹ Jᵀ W S ν: what legs do with the
    noise ν of one pose goes together.
    """
    sigma, count = noise.of_poses(mechanism), len(parameter_ids(mechanism))
    n_readings = len(mechanism.reading_names)
    noisy = np.zeros((len(reached), count, n_readings + len(sigma)))
    ranks, lost, least, equations, place = [], [], 0.0, 0, 0
    for leg, columns in zip(mechanism.legs, mechanism.reading_columns, strict=True):
        rows = np.flatnonzero(reached & plan.serves(leg.name))
        demand = leg_demand(mechanism, leg.name, plan.poses[rows])
        white = leg_whitener(demand, mechanism, noise)
        J = white(demand.parameter)
        flat = J.reshape(-1, J.shape[2])
        names = [f"{leg.name}.{name}" for name in leg.parameter_names]
        ranks.append(identifiability(flat, names))
        root, own_lost = pseudo_inverse(flat, ranks[-1].rank)
        moved = (root.T @ root) @ J.transpose(0, 2, 1) @ white.by_noise
        own = np.arange(place, place := place + J.shape[2])
        kinds = np.r_[n_readings : n_readings + len(sigma), columns.start : columns.stop]
        noisy[np.ix_(rows, own, kinds)] = moved
        lost.append(np.zeros((count, own_lost.shape[1])))
        lost[-1][own] = own_lost
        equations += J.shape[1]
        share = len(rows) / max(int(reached.sum()), 1)
        needed = np.ceil(ranks[-1].rank / J.shape[1] / share) if share else np.inf
        least = max(least, float(needed))
    rank = Identifiability(
        sum(one.rank for one in ranks),
        count,
        max((one.condition for one in ranks), default=1.0),
        tuple(group for one in ranks for group in one.groups),
    )
    covariance = np.einsum("nid,njd->ij", noisy, noisy, optimize=True)
    measured = mechanism.platform.freedoms
    gone = np.concatenate(lost, axis=1)
    return Estimable(measured, equations, least, rank, covariance, gone, noisy[reached])


def pseudo_inverse(rows: Array, rank: int) -> tuple[Array, Array]:
    """Return a root R of the pseudo-inverse Rᵀ R of rows' information, and what it lacks."""
    lengths, s, axes = scaled_axes(rows)
    return axes[:rank] / lengths / s[:rank, None], null_directions(lengths, axes, rank)


def null_directions(lengths: Array, axes: Array, rank: int) -> Array:
    """Return what rows do not determine, columns of shape (n, n_lost); see ``scaled_axes``."""
    return np.asarray(np.linalg.qr((axes[rank:] / lengths).T)[0])


def apart_from_frames(mechanism: Mechanism, legs: Legs, lost: Array) -> tuple[Array, Array, Array]:
    """Return freedoms of frames among directions that are lost, the others, and these motions.

    Args:
        mechanism: The mechanism.
        legs: What its parameters do, at the poses to measure.
        lost: Directions of the legs' parameters, columns of shape (n, n_lost).
    """
    platform, size = mechanism.platform, largest_size(mechanism.legs)
    reached = Plan(legs.poses, readings=legs.readings)
    near = legs_at(mechanism, nearby(mechanism, reached, GENERIC, size))
    there = platform.matrices(near.poses)
    gauge, rest = split_frames(platform, there, near.gain, lost, size)
    if gauge.shape[1]:  # which does not count: what is lost takes no part of it
        rest = rest - gauge @ np.linalg.lstsq(gauge, rest, rcond=None)[0]
    return gauge, rest, frames_moved(platform, there, near.gain, gauge)
