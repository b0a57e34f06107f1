"""What measurements will give before they are made: rank, standard errors, platform error.

At each pose all legs demand e(x, ψ; φ) = 0, and something is measured of the platform. The Gram
matrix of these rows, freed of the pose and whitened, is the information that the best estimator
draws from the pose; its inverse is the covariance of the parameters, the Cramér-Rao bound. Of a leg
alone, with poses as measured, the rows are e, whitened by what the noise of pose and readings does
to it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from pincal.attached import attached
from pincal.blas import one_thread
from pincal.design.platform_error import PlatformError, platform_error
from pincal.errors import MeasurementError
from pincal.estimation.observability.gauge import split_frames
from pincal.estimation.observability.identifiable import (
    GENERIC,
    NEGLIGIBLE,
    Identifiability,
    WeakPair,
    identifiability,
    nearest_to_nominal,
    scaled_axes,
    weak_pairs,
)
from pincal.estimation.observation import Observation
from pincal.estimation.relations import at_touch
from pincal.estimation.relations import touching as led_to_touch
from pincal.estimation.rows import white_rows
from pincal.files.measurements import as_noise
from pincal.files.mechanism_folders import GivenMechanism, as_mechanism
from pincal.instruments.setup_file import read_setup
from pincal.kinematics.batches import block_diagonal
from pincal.kinematics.configurations import Legs, as_plan, check_reached, legs_at, nearby
from pincal.kinematics.derivatives import Demand
from pincal.model.checks import described
from pincal.model.measurements import Measurements, Noise, Plan
from pincal.model.mechanism import Mechanism
from pincal.model.relations import ROW
from pincal.model.setup import Setup
from pincal.types import Array


def leg_rows(demand: Demand, mechanism: Mechanism, noise: Noise) -> Array:
    """Return the whitened rows of a leg alone by its parameters, poses as measured, (N, k, n).

    NaN where out of reach.
    """
    by_pose, by_reading = demand.pose * noise.of_poses(mechanism), demand.reading * noise.reading
    root = np.concatenate((by_pose, by_reading), axis=2)
    return white_rows(demand.pose[:, :, :0], root)(demand.parameter)


def touching(mechanism: Mechanism, plan: Plan, setup: Setup, errors: Array | float = 0.0) -> Plan:
    """Return a plan whose contacts touch, but for errors (N, 3): see ``relations.touching``."""
    touched = {name: contact for name, contact in setup.contacts.items() if name != ROW}
    contacts = {name: replace(contact, gauge=False) for name, contact in touched.items()}
    if not contacts:
        return plan
    readings = np.zeros((len(plan), len(mechanism.reading_names)))
    data = Measurements(poses=plan.poses, readings=readings, contacts=plan.contacts)
    observation = Observation(mechanism, data, Setup(targets=setup.targets, contacts=contacts))
    return led_to_touch(observation, mechanism, plan, observation.external.start, errors)


def _measured_names(
    mechanism: Mechanism, measured: Sequence[str] | None, setup: Setup
) -> tuple[str, ...]:
    """Return names of what is measured, all that a setup says if none are given."""
    offered = (*mechanism.platform.freedoms, *setup.columns(mechanism))
    if measured is not None and not isinstance(measured, Iterable):
        raise MeasurementError(
            f"measured: expected names of {', '.join(offered)}; got {described(measured)}"
        )
    chosen = setup.measured(mechanism) if measured is None else measured
    names = setup.quantities(mechanism.platform, chosen)
    if unknown := [name for name in names if name not in offered]:
        raise MeasurementError(
            f"{mechanism.name!r} has no freedom {unknown[0]!r} to measure; it has "
            f"{', '.join(offered)}"
        )
    return names


class Information(NamedTuple):
    """What configurations say of n parameters and external unknowns."""

    rows: Array
    """Free of the poses and whitened, shape (N, k, n): their Gram matrix is the information."""
    priors: Array
    """Rows of what is known of external unknowns beforehand, shape (m, n)."""
    systematic: Array
    """Errors of rows by what is off in all, one standard uncertainty each, shape (N, k, q)."""
    unknowns: tuple[str, ...]
    """Ids."""
    measured: tuple[str, ...]
    """Names of what is measured (see ``forecast``)."""


def information_rows(
    mechanism: Mechanism, legs: Legs, noise: Noise, measured: Sequence[str] | None, setup: Setup
) -> Information:
    """Return what configurations say of parameters and external unknowns, pose by pose.

    Raises:
        MeasurementError: unknown freedoms, or measurements without noise or equations.
    """
    platform, count = mechanism.platform, len(legs.poses)
    matrices, turning = platform.matrices(legs.poses), platform.freedoms[platform.lengths :]
    columns = dict.fromkeys(setup.columns(mechanism), np.zeros(count))
    names = _measured_names(mechanism, measured, setup)
    coordinates = platform.from_matrices(matrices)
    if not set(names) & set(turning):
        coordinates[:, platform.lengths :] = np.nan
    readings = np.zeros((count, legs.reading.shape[2]))
    data = Measurements(poses=coordinates, readings=readings, extra=columns, contacts=legs.contacts)
    observation = Observation(mechanism, data, setup)
    start = at_touch(observation, matrices, observation.external.start)
    observation = observation.visible(matrices, start)
    chosen = [observation.names.index(name) for name in names]
    value, *slopes = observation.residuals(matrices, start)
    predicted = {name: value[:, observation.names.index(name)] for name in columns}
    planned = replace(data, extra=predicted)  # less what was measured: zero
    scatter = observation.row_noise(planned, noise)
    by_all = np.concatenate((*slopes, observation.systematic(matrices, start)), axis=2)[:, chosen]
    single = scatter.correlation is None and (scatter.sigma[:, chosen] > 0.0).all()
    if single and len(chosen) > by_all.shape[2]:  # a photograph says no more than R: seen / σ = Q R
        by_all = np.asarray(np.linalg.qr(by_all / scatter.sigma[:, chosen, None], mode="r"))
        roots = np.broadcast_to(np.eye(by_all.shape[2]), (count, *by_all.shape[2:] * 2))
    else:
        roots = scatter.roots[:, chosen]
    places = np.cumsum([part.shape[2] for part in slopes])
    by_pose, by_external, systematic = np.split(by_all, places, axis=2)
    # ┌ A          0        ┐  legs           ┌ B ┐   ┌ σ ∂e/∂ψ    ┐
    # └ 0  by external      ┘  what is seen   └ B ┘   └          σ ┘
    pose = np.concatenate((legs.pose, by_pose), axis=1)
    n_rows = legs.parameter.shape[1]
    white = white_rows(pose, block_diagonal((noise.reading * legs.reading, roots)))
    rows = white(block_diagonal((legs.parameter, by_external)))
    if not rows.size:
        raise MeasurementError(
            f"{', '.join(names) or 'nothing'} measured leaves no equation: {mechanism.name!r} has "
            f"{n_rows} equations for {platform.dof} freedoms. Measure more of the platform"
        )
    errors = white(np.pad(systematic, ((0, 0), (n_rows, 0), (0, 0))))
    ids, external = [p.id for p in mechanism.parameters], observation.external
    priors = np.eye(rows.shape[2])[len(ids) :] / external.priors[:, None]
    known = priors[priors.any(axis=1)]
    return Information(rows, known, errors, (*ids, *external.names), names)


def null_directions(lengths: Array, axes: Array, rank: int, count: int) -> Array:
    """Return independent directions that rows do not determine, columns of shape (count, n_lost).

    They are of the first unknowns; those of others alone are none. See ``scaled_axes``.
    """
    U, shares, _ = np.linalg.svd(axes[rank:, :count].T, full_matrices=False)
    return np.asarray(np.linalg.qr(U[:, shares > NEGLIGIBLE] / lengths[:count, None])[0])


def apart_from_frames(
    mechanism: Mechanism, legs: Legs, lost: Array, setup: Setup
) -> tuple[Array, Array, Array]:
    """Return freedoms of frames among lost directions, (n, n_lost), the others, these motions.

    Legs are at the poses to measure.
    """
    reached = Plan(legs.poses, readings=legs.readings)
    near = legs_at(mechanism, nearby(mechanism, reached, GENERIC, mechanism.size))
    matrices, scaled = mechanism.platform.matrices(near.poses), setup.frameless
    gauge, undetermined, moved = split_frames(mechanism, matrices, near.gain, lost, scaled=scaled)
    if gauge.shape[1]:  # which does not count: what is lost takes no part of it
        undetermined = undetermined - gauge @ np.linalg.lstsq(gauge, undetermined, rcond=None)[0]
    return gauge, undetermined, moved


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
        clear, ids = np.outer(determined, determined), [p.id for p in self.mechanism.parameters]
        return weak_pairs(ids, np.where(clear, self.covariance, 0.0))

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
            MeasurementError: an accuracy that is not positive and finite.
        """
        if not 0.0 < accuracy < np.inf:
            raise MeasurementError(f"the wanted accuracy is {accuracy:g} m; expected more than 0")
        position_error = self.platform_error(poses).position
        return float(max(self.least, np.ceil(self.poses * (position_error / accuracy) ** 2)))

    def __repr__(self) -> str:
        rank = f"rank {self.rank.rank} of {self.rank.n_params}"
        return f"Forecast({self.mechanism.name!r}, {self.poses} poses, {rank})"

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
            the measurements' frame) and columns of the setup; all if not given, but no freedom
            where contacts or cameras measure.
        setup: What measured numbers will mean: unknown frame, targets, distances.

    Raises:
        MeasurementError: unknown freedoms, measurements without any noise, or no pose in reach.
        MechanismError: poses of a wrong shape, or not finite.
    """
    mechanism = as_mechanism(mechanism)
    noise, setup = as_noise(noise), read_setup(setup or Setup())
    plan = as_plan(mechanism, poses)
    setup = setup.of_rows(plan.contacts)
    plan = touching(mechanism, plan.rows(~plan.verifying), setup)  # no fit follows the others
    legs = legs_at(mechanism, plan)
    if not len(legs.poses):
        check_reached(mechanism, plan)
    information = information_rows(mechanism, legs, noise, measured, setup)
    rows, priors, systematic, unknowns, names = information
    seen, n = rows.reshape(-1, rows.shape[2]), legs.parameter.shape[2]
    flat = np.concatenate((seen, priors))
    rank = identifiability(flat, unknowns)
    lengths, s, axes = scaled_axes(flat)
    root = axes[: rank.rank] / lengths / s[: rank.rank, None]  # of the pseudo-inverse
    undetermined = null_directions(lengths, axes, rank.rank, n)
    gauge, lost, frames = apart_from_frames(mechanism, legs, undetermined, setup)
    to_nominal = root[:, :n] @ nearest_to_nominal(mechanism, gauge).T
    # what is off in all rows comes on top, however many they are
    moved = to_nominal.T @ (root @ (seen.T @ systematic.reshape(len(seen), -1)))
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
