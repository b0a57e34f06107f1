"""Forecasts of planned measurements: rank, standard errors, error of the platform.

At each pose all legs demand e(x, ψ; φ) = 0, and some quantities of the platform are measured. The
Gram matrix of these rows, freed of the pose and whitened, is the information that the best
estimator draws from the pose; its inverse is the covariance of the parameters, the Cramér-Rao
bound. For a single leg with measured poses the rows are e, whitened by the noise of e that follows
from pose and readings.
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
    identifiability,
    nearest_to_nominal,
    scaled_axes,
)
from pincal.estimation.observation import Observation
from pincal.estimation.rows import white_rows
from pincal.estimation.unknowns import External
from pincal.files.measurements import as_noise
from pincal.files.mechanism_folders import GivenMechanism, as_mechanism
from pincal.instruments.setup_file import read_setup
from pincal.kinematics.batches import block_diagonal
from pincal.kinematics.configurations import Legs, as_plan, check_reached, legs_at, nearby
from pincal.kinematics.derivatives import Demand
from pincal.model import ROW, Measurements, Mechanism, Noise, Plan, Setup
from pincal.model.checks import must_be
from pincal.types import Array


def leg_rows(demand: Demand, mechanism: Mechanism, noise: Noise) -> Array:
    """Return the whitened Jacobian of a single leg at measured poses by its parameters, (N, k, n).

    Rows out of reach are NaN.
    """
    by_pose, by_reading = demand.pose * noise.of_poses(mechanism), demand.reading * noise.reading
    root = np.concatenate((by_pose, by_reading), axis=2)
    return white_rows(demand.pose[:, :, :0], root)(demand.parameter)


def touching(mechanism: Mechanism, plan: Plan, setup: Setup, errors: Array | float = 0.0) -> Plan:
    """Return a plan whose contacts touch up to errors, (N, 3), [m]: see ``Observation``."""
    contacts = {n: replace(c, gauge=False) for n, c in setup.contacts.items() if n != ROW}
    if not contacts:
        return plan
    readings = np.zeros((len(plan), len(mechanism.reading_names)))
    data = Measurements(poses=plan.poses, readings=readings, contacts=plan.contacts)
    observation = Observation(mechanism, data, Setup(targets=setup.targets, contacts=contacts))
    return observation.touching(mechanism, plan, observation.external.start, errors)


def _measured_names(
    mechanism: Mechanism, measured: Sequence[str] | None, setup: Setup
) -> tuple[str, ...]:
    """Check and return the names of measured quantities; by default all of the setup's."""
    offered = (*mechanism.platform.freedoms, *setup.columns(mechanism))
    chosen = setup.measured(mechanism) if measured is None else measured
    named = must_be(chosen, Iterable, "measured", MeasurementError)
    texts = [must_be(name, str, "a measured quantity", MeasurementError) for name in named]
    names = setup.quantities(mechanism.platform, texts)
    if unknown := [name for name in names if name not in offered]:
        raise MeasurementError(
            f"{mechanism.name!r} has no freedom {unknown[0]!r} to measure; it has "
            f"{', '.join(offered)}"
        )
    return names


class Information(NamedTuple):
    """Information of N configurations on n unknowns: parameters, then external unknowns."""

    rows: Array
    """Rows freed of the poses and whitened, shape (N, k, n); their Gram is the information."""
    priors: Array
    """Rows of prior knowledge on external unknowns, shape (m, n)."""
    systematic: Array
    """Errors of the rows for one standard uncertainty of q systematic errors, (N, k, q)."""
    unknowns: tuple[str, ...]
    """Ids of the unknowns."""
    measured: tuple[str, ...]
    """Names of the measured quantities (see ``forecast``)."""
    observation: Observation
    """What is measured there."""
    external: External
    """Values of the external unknowns."""
    by_reading: Array
    """Derivatives of the rows by readings, shape (N, k, n_readings)."""


def information_rows(
    mechanism: Mechanism, legs: Legs, noise: Noise, measured: Sequence[str] | None, setup: Setup
) -> Information:
    """Return the information of configurations on parameters and external unknowns, by pose.

    Raises:
        MeasurementError: freedoms are unknown, or measurements have no noise or no equations.
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
    start = observation.at_touch(matrices, observation.external.start)
    observation = observation.visible(matrices, start)
    chosen = [observation.names.index(name) for name in names]
    value, *slopes = observation.residuals(matrices, start)
    predicted = {name: value[:, observation.names.index(name)] for name in columns}
    planned = replace(data, extra=predicted)  # so that residuals are zero
    scatter = observation.row_noise(planned, noise)
    by_all = np.concatenate((*slopes, observation.systematic(matrices, start)), axis=2)[:, chosen]
    single = scatter.correlation is None and (scatter.sigma[:, chosen] > 0.0).all()
    if single and len(chosen) > by_all.shape[2]:  # R of QR holds all information of a photograph
        by_all = np.asarray(np.linalg.qr(by_all / scatter.sigma[:, chosen, None], mode="r"))
        roots = np.broadcast_to(np.eye(by_all.shape[2]), (count, *by_all.shape[2:] * 2))
    else:
        roots = scatter.roots[:, chosen]
    places = np.cumsum([part.shape[2] for part in slopes])
    by_pose, by_external, systematic = np.split(by_all, places, axis=2)
    # ┌ A          0        ┐  legs           ┌ B ┐   ┌ σ ∂e/∂ψ    ┐
    # └ 0  by external      ┘  measured       └ B ┘   └          σ ┘
    pose = np.concatenate((legs.pose, by_pose), axis=1)
    n_rows = legs.parameter.shape[1]
    white = white_rows(pose, block_diagonal((noise.reading * legs.reading, roots)))
    rows = white(block_diagonal((legs.parameter, by_external)))
    if not rows.size:
        raise MeasurementError(
            f"measuring {', '.join(names) or 'nothing'} leaves no equation: {mechanism.name!r} has "
            f"{n_rows} equations for {platform.dof} freedoms. Measure more of the platform"
        )
    errors = white(np.pad(systematic, ((0, 0), (n_rows, 0), (0, 0))))
    by_reading = white(np.pad(legs.reading, ((0, 0), (0, by_pose.shape[1]), (0, 0))))
    ids, external = [p.id for p in mechanism.parameters], observation.external
    priors = np.eye(rows.shape[2])[len(ids) :] / external.priors[:, None]
    known = priors[priors.any(axis=1)]
    unknowns = *ids, *external.names
    return Information(rows, known, errors, unknowns, names, observation, start, by_reading)


def null_directions(lengths: Array, axes: Array, rank: int, count: int) -> Array:
    """Return independent directions that rows do not determine, columns of shape (count, n_lost).

    Directions among other than the first ``count`` unknowns are dropped. See ``scaled_axes``.
    """
    U, shares, _ = np.linalg.svd(axes[rank:, :count].T, full_matrices=False)
    return np.asarray(np.linalg.qr(U[:, shares > NEGLIGIBLE] / lengths[:count, None])[0])


def apart_from_frames(
    mechanism: Mechanism, legs: Legs, lost: Array, setup: Setup
) -> tuple[Array, Array, Array]:
    """Return undetermined directions, (n, n_lost), that only move frames, the others, the motions.

    Legs are at the poses to measure.
    """
    reached = Plan(legs.poses, readings=legs.readings)
    near = legs_at(mechanism, nearby(mechanism, reached, GENERIC, mechanism.size))
    matrices, scaled = mechanism.platform.matrices(near.poses), setup.frameless
    gauge, undetermined, moved = split_frames(mechanism, matrices, near.gain, lost, scaled=scaled)
    if gauge.shape[1]:  # the others are taken free of any part along the gauge
        undetermined = undetermined - gauge @ np.linalg.lstsq(gauge, undetermined, rcond=None)[0]
    return gauge, undetermined, moved


@dataclass(frozen=True, repr=False, eq=False)
class Forecast:
    """Forecast for a plan of measurements: rank, standard errors, error of the platform."""

    mechanism: Mechanism
    measured: tuple[str, ...]
    """Names of the measured quantities of the platform."""
    poses: int
    """Number of poses that all legs reach."""
    rank: Identifiability
    """Rank of all parameters and external unknowns together, by their ids."""
    covariance: Array
    """Cramér-Rao bound of the determined parameters' covariance, shape (n, n), leg by leg."""
    least: float
    """Fewest poses like these that can determine as many unknowns."""
    lost: Array
    """Undetermined directions without those of frames, columns of shape (n, n_lost)."""
    gauge: Array
    """Directions that only move unmeasured frames, columns of shape (n, n_gauge); along them
    parameters are taken nearest to nominal."""
    frames: Array
    """Motions of frames along the gauge directions (see ``frames_moved``), shape (k, n_moved)."""

    @cached_property
    def std(self) -> Array:
        """Standard error of each parameter, shape (n,); infinite where it is not determined."""
        blurred = np.abs(self.lost).max(axis=1, initial=0.0) > NEGLIGIBLE
        return np.where(blurred, np.inf, np.sqrt(np.diagonal(self.covariance)))

    @property
    def undetermined(self) -> list[tuple[str, ...]]:
        """Ids of unknowns that move together, of which a parameter has no standard error."""
        pairs = zip(self.mechanism.parameters, np.isinf(self.std), strict=True)
        blurred = {parameter.id for parameter, unknown in pairs if unknown}
        return [group for group in self.rank.groups if not blurred.isdisjoint(group)]

    def platform_error(self, poses: Plan | Array) -> PlatformError:
        """Return the expected error of the calibrated platform over poses, shape (N, dof).

        Where frames are not measured, it is the error after their best fit.
        """
        error = platform_error(self.mechanism, self.covariance, poses, self.lost, self.frames)
        if not error.poses:
            check_reached(self.mechanism, poses, "the poses")
        return error

    def poses_for(self, accuracy: float, poses: Plan | Array) -> float:
        """Return the number of poses like the planned ones that gives an accuracy of position.

        The accuracy is the RMS position error, [m], over ``poses``, shape (N, dof); it falls with
        the square root of the number of poses. The number is infinite if none suffices.

        Raises:
            MeasurementError: the accuracy is not positive and finite.
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
        """Return the table of standard errors, and the undetermined parameters."""


@one_thread()
def forecast(
    mechanism: GivenMechanism,
    poses: Plan | Array,
    noise: Noise | None = None,
    measured: Sequence[str] | None = None,
    setup: Setup | None = None,
) -> Forecast:
    """Forecast how well measurements at poses will determine the parameters of all legs.

    Args:
        mechanism: The mechanism, at its nominal parameters.
        poses: Poses to measure, coordinates of shape (N, dof), or a plan; all sensors are read.
        noise: Standard deviations of the measurements.
        measured: Freedoms of the platform that are measured (see ``Platform.freedoms``; axes of
            the measurements' frame) and columns of the setup. By default all columns, and all
            freedoms unless contacts or cameras measure.
        setup: Meaning of the measured numbers: unknown frame, targets, distances.

    Raises:
        MeasurementError: freedoms are unknown, measurements have no noise, or no pose is in reach.
        MechanismError: poses have a wrong shape, or are not finite.
    """
    mechanism, noise = as_mechanism(mechanism), as_noise(noise)
    plan = as_plan(mechanism, poses)
    setup = read_setup(Setup() if setup is None else setup).of_rows(plan.contacts)
    plan = touching(mechanism, plan.rows(~plan.verifying), setup)  # rows that a fit uses
    legs = legs_at(mechanism, plan)
    if not len(legs.poses):
        check_reached(mechanism, plan)
    information = information_rows(mechanism, legs, noise, measured, setup)
    rows, priors, systematic, unknowns, names, *_ = information
    white, n = rows.reshape(-1, rows.shape[2]), legs.parameter.shape[2]
    flat = np.concatenate((white, priors))
    rank = identifiability(flat, unknowns)
    lengths, s, axes = scaled_axes(flat)
    root = axes[: rank.rank] / lengths / s[: rank.rank, None]  # rootᵀ root is the pseudo-inverse
    undetermined = null_directions(lengths, axes, rank.rank, n)
    gauge, lost, frames = apart_from_frames(mechanism, legs, undetermined, setup)
    to_nominal = root[:, :n] @ nearest_to_nominal(mechanism, gauge).T
    # systematic errors add to the covariance, however many rows there are
    moved = to_nominal.T @ (root @ (white.T @ systematic.reshape(len(white), -1)))
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
