"""What measurements will give before they are made: rank, standard errors, platform error.

The covariance is the inverse of the information that the best estimator draws from them (see
``information``): the Cramér-Rao bound.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pincal.attached import attached
from pincal.blas import one_thread
from pincal.design.information import (
    apart_from_frames,
    information_rows,
    null_directions,
    parameter_ids,
)
from pincal.design.platform_error import PlatformError, platform_error
from pincal.errors import MeasurementError
from pincal.estimation.observability.identifiable import WeakPair, weak_pairs
from pincal.estimation.observability.indices import (
    NEGLIGIBLE,
    Identifiability,
    identifiability,
    nearest_to_nominal,
    scaled_axes,
)
from pincal.files.measurements import as_noise
from pincal.files.mechanism_folders import GivenMechanism, as_mechanism
from pincal.files.yaml import read_setup
from pincal.kinematics.configurations import as_plan, check_reached, legs_at
from pincal.model.measurements import Noise, Plan
from pincal.model.mechanism import Mechanism
from pincal.model.setup import Setup
from pincal.types import Array


@dataclass(frozen=True, repr=False, eq=False)
class Forecast:
    """What a plan of measurements will give: rank, standard errors, error of the platform."""

    mechanism: Mechanism
    measured: tuple[str, ...]
    """What is measured of the platform."""
    poses: int
    """Number of poses that all legs reach."""
    rank: Identifiability
    """Of all parameters and external unknowns together, by their ids."""
    covariance: Array
    """Of what is determined, shape (n, n), parameters leg by leg: the Cramér-Rao bound."""
    least: float
    """Fewest poses like these that can determine as much."""
    lost: Array
    """Directions that are not determined, columns of shape (n, n_lost), less those of frames."""
    gauge: Array
    """Directions that only move frames that are not measured, columns of shape (n, n_gauge):
    parameters are those nearest to the nominal ones."""
    frames: Array
    """Motions of frames that these are (see ``frames_moved``), shape (k, n_moved)."""

    @cached_property
    def std(self) -> Array:
        """Standard error of each parameter, shape (n,); infinite where it is not determined."""
        blurred = np.abs(self.lost).max(axis=1, initial=0.0) > NEGLIGIBLE
        return np.where(blurred, np.inf, np.sqrt(np.diagonal(self.covariance)))

    @cached_property
    def weak(self) -> tuple[WeakPair, ...]:
        """Pairs of parameters that are weakly determined, the weakest first."""
        determined = np.isfinite(self.std)
        clear = np.outer(determined, determined)
        return weak_pairs(
            parameter_ids(self.mechanism), np.where(clear, self.covariance, 0.0), self.gauge
        )

    def platform_error(self, poses: Plan | Array) -> PlatformError:
        """Return the error to expect of the calibrated platform over poses, shape (N, dof).

        Where frames are not measured, less what a motion of the frames explains.
        """
        return platform_error(self.mechanism, self.covariance, poses, self.lost, self.frames)

    def poses_for(self, accuracy: float, poses: Plan | Array) -> float:
        """Return how many poses like the planned ones bring the position error to an accuracy.

        That is its root mean square [m] over some poses, shape (N, dof). Errors fall with the root
        of the number of poses. Infinite if no number does.

        Raises:
            MeasurementError: an accuracy that is not positive.
        """
        if not accuracy > 0.0:
            raise MeasurementError(f"the wanted accuracy is {accuracy:g} m; expected more than 0")
        position_error = self.platform_error(poses).position
        return float(max(self.least, np.ceil(self.poses * (position_error / accuracy) ** 2)))

    def __repr__(self) -> str:
        rank = f"rank {self.rank.rank} of {self.rank.n_params}"
        name = self.mechanism.name
        return f"Forecast({name!r}, {self.poses} poses, {rank})"

    @attached
    def __str__(self) -> str:
        """Return the table of standard errors, and what is not determined."""


@one_thread()
def forecast(
    mechanism: GivenMechanism,
    poses: Plan | Array,
    noise: Noise | None = None,
    measured: Sequence[str] | None = None,
    setup: Setup | None = None,
) -> Forecast:
    """Return what measurements at poses will say of the parameters of all legs.

    Args:
        mechanism: The mechanism, at its nominal parameters.
        poses: Poses to measure, coordinates of shape (N, dof), or a plan; all sensors are read.
        noise: Standard deviations of what is measured.
        measured: Freedoms of the platform that are measured (see ``Platform.freedoms``; axes of
            the measurements' frame) and columns of the setup; all if not given.
        setup: What measured numbers will mean: unknown frame, targets, distances.

    Raises:
        MeasurementError: unknown freedoms, measurements without any noise, or no pose in reach.
        MechanismError: poses of a wrong shape, or not finite.
    """
    mechanism = as_mechanism(mechanism)
    noise, setup = as_noise(noise), read_setup(setup or Setup())
    plan = as_plan(mechanism, poses)
    plan = plan.rows(~plan.verifying)  # no fit follows the others
    legs = legs_at(mechanism, plan)
    if not len(legs.poses):
        check_reached(mechanism, plan)
    rows, off, unknowns, names = information_rows(mechanism, legs, noise, measured, setup)
    flat, n = rows.reshape(-1, rows.shape[2]), legs.parameter.shape[2]
    rank = identifiability(flat, unknowns)
    lengths, s, axes = scaled_axes(flat)
    root = axes[: rank.rank] / lengths / s[: rank.rank, None]  # of the pseudo-inverse
    undetermined = null_directions(lengths, axes, rank.rank)
    gauge, lost, frames = apart_from_frames(mechanism, legs, undetermined[:n])
    to_nominal = root[:, :n] @ nearest_to_nominal(mechanism, gauge).T
    # what is off in all rows comes on top, however many they are
    moved = to_nominal.T @ (root @ (flat.T @ off.reshape(len(flat), -1)))
    return Forecast(
        mechanism,
        names,
        len(legs.poses),
        rank,
        covariance=to_nominal.T @ to_nominal + moved @ moved.T,
        least=float(np.ceil(rank.rank / rows.shape[1])),
        lost=lost,
        gauge=gauge,
        frames=frames,
    )
