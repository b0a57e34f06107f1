"""Calibration: parameters of all legs from what was measured.

One family of estimators. Per leg (the papers' divide and conquer) or all legs together, on
poses measured in full; or with latent poses, on whatever was measured. Robust losses, priors,
ties and unknown frames serve all of them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from typing import Literal, get_args

import numpy as np

from pincal.errors import MeasurementError, PincalError
from pincal.identification.assemble import assemble
from pincal.identification.estimate import Estimate
from pincal.identification.failure import check_cause
from pincal.identification.latent_fit import latent_fit
from pincal.identification.losses import LossName
from pincal.identification.measured import measured_fits
from pincal.identification.noise import noise_model
from pincal.identification.plausibility import check_copies, check_noise, check_plausible
from pincal.identification.residuals import Residual
from pincal.identification.result import CalibrationResult
from pincal.identification.task import Method, Task
from pincal.model.measurements import Measurements, Noise
from pincal.model.mechanism import Mechanism
from pincal.model.setup import Setup


def calibrate(
    mechanism: Mechanism,
    measurements: Measurements,
    *,
    method: Method = "per-leg",
    residual: Residual = "closure",
    poses: Literal["own", "all"] = "own",
    noise: Noise | None = None,
    setup: Setup | None = None,
    loss: LossName = "none",
    fixed: Iterable[str] = (),
    tied: Iterable[str] = (),
    priors: Mapping[str, float] | None = None,
    rough: bool = False,
    hold_undetermined: bool = False,
    progress: Callable[[str], None] | None = None,
) -> CalibrationResult:
    """Return the identified parameters of a mechanism, with uncertainties.

    Args:
        mechanism: The nominal mechanism, where the search starts.
        measurements: What was measured; whole poses and all readings, except for ``"latent"``.
        method: ``"per-leg"`` identifies each leg alone; ``"together"`` all legs at once,
            using that residuals at one pose share its noise; ``"latent"`` all legs at once, every
            pose an unknown of which any part, or none, was measured.
        residual: ``"closure"``, whitened, or ``"joint"``, as the papers have it, unweighted.
        poses: ``"own"`` uses for each leg the poses chosen for it (their ``set``), ``"all"``
            every pose for every leg. Latent poses always serve every leg.
        noise: Standard deviations of the measurements. If neither this nor the measurements
            say them, they are taken from repeated rows; without such, equal ones are assumed and
            their scale is estimated from the residuals.
        setup: What the measured numbers mean: unknown frame, targets, distances.
        loss: A robust loss by which rows that do not fit count less, ``"huber"``, ``"cauchy"``
            or ``"tukey"``; ``"reject"`` leaves them out.
        fixed: Parameters held at their nominal values: ``"l"`` of every leg, ``"leg_1.l"`` of one.
        tied: Parameters that have one value for all legs, which are then identified together; the
            result tests whether that holds.
        priors: Standard deviations with which nominal values are known, by name as above.
        rough: Whether the nominal mechanism is known so roughly that measurements need not look
            like its own; units, signs and the order of legs are then not checked.
        hold_undetermined: Whether directions of parameters that the measurements do not tell are
            held as near to nominal as can be, and named; else they are refused.
        progress: Called with what is being done.

    Raises:
        ObservabilityError: too few poses, or poses that leave parameters undetermined.
        MeasurementError: measurements that cannot be this mechanism's; noise that is given
            twice, or leaves a residual without any; the joint residual out of reach; an unknown
            parameter, loss or method.
    """
    task = calibration_task(
        mechanism,
        measurements,
        method=method,
        residual=residual,
        poses=poses,
        noise=noise,
        setup=setup,
        loss=loss,
        fixed=fixed,
        tied=tied,
        priors=priors,
        rough=rough,
        hold_undetermined=hold_undetermined,
        progress=progress,
    )
    check_copies(measurements, every_pose=task.every_pose)
    if task.setup.plain and not task.rough:
        check_plausible(mechanism, measurements)
    try:
        found = estimate(task)
    except PincalError as error:
        check_cause(task, error)
        raise
    return assemble(task, found, estimate(replace(task, untied=True)) if task.tied else None)


def estimate(task: Task) -> Estimate:
    """Return the fits of a task.

    Raises:
        ObservabilityError: too few poses, or poses that leave parameters undetermined.
        MeasurementError: measurements that do not suit the method.
    """
    if task.hold and task.method != "latent":
        raise MeasurementError("what is not told is held with --method latent only")
    return latent_fit(task) if task.method == "latent" else measured_fits(task)


def calibration_task(
    mechanism: Mechanism,
    data: Measurements,
    *,
    method: Method = "per-leg",
    residual: Residual = "closure",
    poses: Literal["own", "all"] = "own",
    noise: Noise | None = None,
    setup: Setup | None = None,
    loss: LossName = "none",
    fixed: Iterable[str] = (),
    tied: Iterable[str] = (),
    priors: Mapping[str, float] | None = None,
    rough: bool = False,
    hold_undetermined: bool = False,
    progress: Callable[[str], None] | None = None,
) -> Task:
    """Return what is to be identified, checked: arguments and errors are those of ``calibrate``."""
    _check_shapes(mechanism, data)
    for what, given, known in (("method", method, Method), ("loss", loss, LossName)):
        if given not in get_args(known):
            raise MeasurementError(
                f"unknown {what} {given!r}; expected one of {', '.join(get_args(known))}"
            )
    if method == "latent" and residual != "closure":
        raise MeasurementError("latent poses take the closure residual; leave out the other")
    if residual == "joint" and mechanism.by_readings:
        raise MeasurementError(
            f"readings of {mechanism.name!r} do not follow from its poses, so there is no joint "
            "residual; take the closure residual (--residual closure)"
        )
    if noise is not None:
        check_noise(mechanism, noise)
    return Task(
        mechanism,
        data,
        setup or Setup(),
        noise_model(mechanism, data, noise),
        fixed=tuple(fixed),
        tied=tuple(tied),
        priors=dict(priors or {}),
        loss=loss,
        method=method,
        kind=residual,
        every_pose=method == "latent" or poses == "all",
        untied=False,
        rough=rough,
        hold=hold_undetermined,
        tell=progress or (lambda _: None),
    )


def _check_shapes(mechanism: Mechanism, data: Measurements) -> None:
    if not len(data):
        raise MeasurementError("there are no measurements; give a row for each measured pose")
    expected = ((len(data), mechanism.platform.dof), (len(data), len(mechanism.reading_names)))
    if (data.poses.shape, data.readings.shape) != expected:
        raise MeasurementError(
            f"poses {data.poses.shape} and readings {data.readings.shape} do not fit "
            f"{mechanism.name!r}; expected {expected[0]} and {expected[1]}"
        )
    if np.isinf(data.poses).any() or np.isinf(data.readings).any():
        raise MeasurementError("a measured pose or reading is infinite")
