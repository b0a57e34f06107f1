"""Simulated measurements: the nominal mechanism drives a disturbed one, which is measured.

As in the papers, the nominal inverse kinematics commands readings, the true mechanism goes to the
pose of its forward kinematics, and pose and readings are measured with noise. If legs are more than
freedoms, they cannot all obey the nominal mechanism: such a machine is moved to the planned poses
with every leg taut, and its readings are taken there.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from pincal.blas import one_thread
from pincal.design.forecast import touching
from pincal.design.platform_error import root_mean_squares, sizes
from pincal.errors import MeasurementError, PincalError
from pincal.estimation.observation import Observation
from pincal.files.columns import columns_of, reading_units
from pincal.files.measurements import as_noise, read_poses
from pincal.files.mechanism_folders import GivenMechanism, as_mechanism
from pincal.files.table import TextTable
from pincal.instruments.setup_file import read_setup
from pincal.kinematics.configurations import as_plan, command, planned_influences
from pincal.kinematics.forward import forward
from pincal.kinematics.influences import by_name, influences_of
from pincal.model import Measurements, Mechanism, Noise, Plan, Poses, Setup
from pincal.model.checks import counted, generator_of, number_of
from pincal.types import Array, Index
from pincal.words.numbers import Units, amount, listed

ERROR = 1e-3
"""Default standard deviation of a machine's parameters: over its size, [rad], or [1]."""


def disturb(
    mechanism: GivenMechanism,
    sigma: float | Mapping[str, float] | None = None,
    seed: int | np.random.Generator = 0,
) -> Mechanism:
    """Return the mechanism with normally distributed errors on every identified parameter.

    Args:
        mechanism: The nominal mechanism.
        sigma: Standard deviation, equal for lengths [m], angles [rad] and gains [1], or by
            parameter id. By default 0.001 of the machine's size (its longest leg, stretched)
            for lengths, 0.001 otherwise.
        seed: Seed or generator.

    Raises:
        MeasurementError: sigma is negative or infinite, or names an unknown parameter.
    """
    mechanism = as_mechanism(mechanism)
    parameters, rng = mechanism.parameters, generator_of(seed, MeasurementError)
    scales, of_lengths = np.ones(len(parameters)), mechanism.size if sigma is None else 1.0
    if isinstance(sigma, Mapping):
        if unknown := sorted(set(map(str, sigma)) - set(parameters.ids)):
            raise MeasurementError(
                f"{mechanism.name!r} has no parameter {unknown[0]!r} to disturb; it has "
                f"{listed(parameters.ids)}"
            )
        scales, sigma = np.array([sigma.get(id_, 0.0) for id_ in parameters.ids]), 1.0
    else:
        scales[[p.unit == "m" for p in parameters]] = of_lengths
        sigma = ERROR if sigma is None else number_of(sigma, "sigma", MeasurementError)
    if not (np.isfinite(scales * sigma).all() and (scales * sigma >= 0.0).all()):
        raise MeasurementError(f"the disturbance is {sigma}; expected 0 or more")
    errors = scales * (sigma * rng.standard_normal(len(scales)))
    values = (parameters.values + errors).tolist()
    return mechanism.with_parameters(dict(zip(parameters.ids, values, strict=True)))


@dataclass(frozen=True, repr=False)
class Simulation:
    """Simulated measurements, and the rows of the plan that could not be measured."""

    measurements: Measurements
    rows: Index
    """Row of the plan that each measurement belongs to, shape (N,)."""
    unreachable: tuple[tuple[int, str], ...]
    """Rows of the plan without a measurement, with the reason."""

    def __repr__(self) -> str:
        return f"Simulation({len(self.rows)} measurements, {len(self.unreachable)} not reached)"


@one_thread()
def simulate(
    mechanism: GivenMechanism,
    truth: GivenMechanism,
    plan: Plan,
    noise: Noise | None = None,
    seed: int | np.random.Generator = 0,
    setup: Setup | str | Path | None = None,
) -> Simulation:
    """Return simulated measurements of the true mechanism at planned poses.

    With contacts, the true mechanism is led until its targets touch; gauges read the remaining
    distances where it is driven. No pose is measured with contacts, distances between rows or
    cameras. Instruments have their nominal places; points that a camera does not see are NaN.

    Args:
        mechanism: The nominal mechanism, which commands the poses.
        truth: The true mechanism; with more legs than freedoms it goes to the poses exactly.
        plan: Poses to command.
        noise: Standard deviations of the measurements.
        seed: Seed or generator.
        setup: Instruments, and columns of the plan that name points that targets touch.

    Raises:
        MechanismError: poses have a wrong shape or are not finite; or a sensor is homed and its
            leg cannot reach the home pose.
    """
    mechanism, truth = as_mechanism(mechanism), as_mechanism(truth)
    setup, noise = read_setup(Setup() if setup is None else setup), as_noise(noise)
    plan, rng = read_poses(plan, mechanism, setup=setup), generator_of(seed, MeasurementError)
    count, platform, setup = len(plan.poses), mechanism.platform, setup.of_rows(plan.contacts)
    touched = setup.only_touched
    if touched.contacts:
        sigma = max(touched.noises(platform).values(), default=noise.position)
        errors = sigma * rng.standard_normal((count, 3))
        plan, mechanism = touching(truth, as_plan(truth, plan), touched, errors), truth
    if mechanism.redundant:
        poses, readings, causes = command(truth, plan)
        reasons = [cause and f"true mechanism: {cause}" for cause in causes]
    else:
        _, readings, poses, reasons = _driven(mechanism, truth, plan)
    rows = np.flatnonzero([not reason for reason in reasons])
    measured = replace(plan.rows(rows), poses=poses[rows], readings=readings[rows])
    influences = by_name(truth, planned_influences(truth, measured))
    # One draw for each planned pose, so that a lost pose does not change the noise of the others.
    pose_noise = noise.of_poses(mechanism) * rng.standard_normal((count, platform.dof))
    reading_noise = noise.reading * rng.standard_normal((count, len(mechanism.reading_names)))
    shown = np.nan if setup.frameless else platform.moved(measured.poses, pose_noise[rows])
    extra, units = _observed(truth, measured, setup), setup.columns(mechanism)
    sigmas = setup.noises(platform)
    for name in extra:
        sigma = sigmas.get(name, noise.of_unit(units[name]))
        extra[name] = extra[name] + (sigma * rng.standard_normal(count))[rows]
    measurements = Measurements(
        poses=np.broadcast_to(shown, measured.poses.shape),
        readings=readings[rows] + reading_noise[rows],
        sets=measured.sets,
        places=measured.places,
        extra=extra,
        contacts=measured.contacts,
        influences={**measured.influences, **influences},
    )
    lost = tuple((row, reason) for row, reason in enumerate(reasons) if reason)
    return Simulation(measurements, rows, lost)


def _observed(truth: Mechanism, plan: Plan, setup: Setup) -> dict[str, Array]:
    """Return exact distances and readings of instruments at true poses, by column, (N,)."""
    columns = [
        *setup.read_lengths,
        *(name for device in setup.instruments for name in device.columns),
    ]
    if not columns or not len(plan):
        return {}
    readings = np.zeros((len(plan), len(truth.reading_names)))
    zeros = dict.fromkeys(columns, np.zeros(len(plan)))
    data = Measurements(poses=plan.poses, readings=readings, extra=zeros, contacts=plan.contacts)
    observation, matrices = Observation(truth, data, setup), truth.platform.matrices(plan.poses)
    external = observation.at_touch(matrices, observation.external.start)
    observation = observation.visible(matrices, external)
    values = observation.residuals(matrices, external)[0]
    values = np.where(observation.measured, values, np.nan).T
    return {name: values[observation.names.index(name)] for name in columns}


def _driven(
    model: Mechanism, truth: Mechanism, planned: Plan
) -> tuple[Array, Array, Array, list[str]]:
    """Return commanded poses and readings, true poses, and by row why there is none, or ``""``."""
    targets, readings, reasons = command(model, planned)
    rows = np.flatnonzero([not reason for reason in reasons])
    reasons = [reason and f"nominal mechanism: {reason}" for reason in reasons]
    commanded = replace(planned.rows(rows), readings=readings[rows])
    solution = forward(truth, readings[rows], targets[rows], influences_of(truth, commanded))
    for row, reason in zip(rows, solution.reasons, strict=True):
        reasons[row] = f"true mechanism: {reason}" if reason else ""
    poses = np.full(targets.shape, np.nan)
    poses[rows] = solution.poses
    return targets, readings, poses, reasons


@dataclass(frozen=True, repr=False)
class Accuracy:
    """Errors between commanded and reached poses of the platform."""

    position: float
    """Root mean square distance, [m]."""
    orientation: float
    """Root mean square angle, [rad]; zero for a platform without orientation."""
    worst_position: float
    """Largest distance, [m]."""
    poses: int
    unreachable: int
    """Number of poses that the model cannot command or the true mechanism cannot reach."""

    def __repr__(self) -> str:
        turns = f", {amount(self.orientation, 'rad')}" if self.orientation else ""
        size = f"{amount(self.position, 'm')}{turns} RMS"
        return f"Accuracy({size}, {self.poses} poses, {self.unreachable} not reached)"


@one_thread()
def platform_errors(model: Mechanism, truth: Mechanism, poses: Plan | Poses) -> Array:
    """Return the errors of the true mechanism at poses that a model commands, shape (N, dof).

    They are twists from the commanded pose to the true one at the platform's origin, in base axes,
    [m] and [rad]; NaN where the model cannot command a pose or the true mechanism cannot reach it.
    With more legs than freedoms the true pose is the one of least gaps (see ``forward``).

    Raises:
        MechanismError: poses have a wrong shape, or are not finite.
    """
    platform = model.platform
    plan = poses if isinstance(poses, Plan) else Plan(platform.coordinates_of(poses))
    targets, _, reached, reasons = _driven(model, truth, plan)
    rows = np.flatnonzero([not reason for reason in reasons])
    errors = np.full(targets.shape, np.nan)
    errors[rows] = platform.twists_between(targets[rows], reached[rows])
    return errors


def accuracy(model: GivenMechanism, truth: GivenMechanism, poses: Plan | Poses) -> Accuracy:
    """Return the accuracy of the truth at poses, (N, dof), [m] and [rad], that a model commands.

    Root mean squares are the papers' RMSE of commanded against measured pose, without measurement
    noise.

    Raises:
        MechanismError: poses have a wrong shape, or are not finite.
    """
    model, truth = as_mechanism(model), as_mechanism(truth)
    errors = sizes(model.platform.units, platform_errors(model, truth, poses))
    reached = np.isfinite(errors).all(axis=1)
    if not reached.any():
        raise MeasurementError(
            f"none of {counted(len(errors), 'pose')} is in reach of {model.name!r} and of the true "
            "machine, so there is no mean; check the poses' units and frame"
        )
    worst, lost = float(errors[reached, 0].max(initial=0.0)), int((~reached).sum())
    return Accuracy(*root_mean_squares(errors), worst, len(errors), lost)


_SLIP = 10.0  # size of a slip, in standard deviations


class SimulatedMachine:
    """A simulated true machine, driven by readings, with slips and drift on request."""

    def __init__(
        self, mechanism: Mechanism, truth: Mechanism, noise: Noise, setup: Setup, units: Units
    ) -> None:
        self.mechanism, self.truth, self.noise, self.setup = mechanism, truth, noise, setup
        self.units = replace(units, names={"m": "mm", "rad": "deg", **units.names})
        self.rng = np.random.default_rng(0)
        self.slips, self.drift = 0.0, 0.0
        """Share of rows with a slip of ten standard deviations; drift along x per row, [m]."""
        self._rows = 0

    def measured(self, set_points: Mapping[str, float]) -> dict[str, float]:
        """Return the measurements at set points, by column with unit.

        Raises:
            MeasurementError: a reading has no set point, or the machine does not reach the pose.
        """
        names = [head.removesuffix("]").partition(" [")[::2] for head in set_points]
        text = {name: [str(v)] for (name, _), v in zip(names, set_points.values(), strict=True)}
        table = TextTable(Path("set points"), dict(names), text, [1], "row", self.mechanism.counts)
        readings = table.array(reading_units(self.mechanism))
        plan = Plan(forward(self.mechanism, readings).poses)
        if not np.isfinite(plan.poses).all():
            raise MeasurementError("the machine does not reach these set points")
        plan = replace(plan, readings=readings if self.mechanism.by_readings else None)
        made = simulate(self.mechanism, self.truth, plan, self.noise, self.rng, self.setup)
        if not len(data := made.measurements):
            raise MeasurementError(f"the machine is not measured: {made.unreachable[0][1]}")
        sigma = self.noise.of_poses(self.mechanism)
        place = self.rng.choice(np.flatnonzero(sigma))
        slip = _SLIP * sigma[place] * self.rng.choice((-1.0, 1.0))
        poses, self._rows = data.poses.copy(), self._rows + 1
        poses[0, place] += slip * (self.rng.random() < self.slips)
        poses[0, 0] += self.drift * self._rows
        way = "zyx" if self.mechanism.platform.turns == 3 else "tilt-torsion"
        columns = columns_of(self.mechanism, replace(data, poses=poses), way, self.setup)
        written = self.units.written(columns).items()
        return {head: float(np.asarray(values, dtype=float)[0]) for head, values in written}

    def answer(self, line: str) -> str:
        """Return the line that answers a line of set points, both JSON."""
        try:
            return json.dumps(self.measured(json.loads(line)))
        except (PincalError, ValueError, AttributeError) as error:
            return json.dumps({"trouble": str(error)})
