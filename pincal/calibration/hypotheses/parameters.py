"""Hypotheses of parameters: zeros of motors, where a search starts, and frames that moved."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import fdtrc

from pincal.calibration.calibration import Calibration
from pincal.calibration.hypotheses.faults import zeros_by_poses
from pincal.calibration.hypotheses.judging import Case
from pincal.calibration.hypotheses.plausibility import judge_as_measured
from pincal.estimation.observability.gauge import frame_motions
from pincal.estimation.observability.indices import NEGLIGIBLE, plausible_changes
from pincal.finding import Finding
from pincal.kinematics.closure import largest_size
from pincal.kinematics.configurations import legs_at
from pincal.model.measurements import Plan
from pincal.model.mechanism import Mechanism
from pincal.model.setup import ORIGIN
from pincal.types import Array
from pincal.words.findings import finding

_CHANCE = 1e-5  # probability of so much motion as one body by chance, above which it is none
_MATTERS = 0.25  # of the platform's error: a motion of less is not worth a warning
_ZEROS = ("reading-offset", False)  # the fault that a search may start from
_ROWS_MOVED = 200  # enough, where the motion of a body is looked for


def misaligned(
    mechanism: Mechanism, changes: Array, poses: Array, readings: Array
) -> tuple[Finding, ...]:
    """Return a finding if parameters moved as one body, of fits in known frames, without ties.

    The share of the changes' squares, over what is plausible, in the directions that move a frame
    has the F distribution if all directions are alike.

    Args:
        mechanism: The nominal mechanism.
        changes: Identified less nominal parameters of all legs, shape (n_params,).
        poses: Measured or estimated, shape (N, dof), [m] and [rad].
        readings: Measured, shape (N, n_readings), [rad] or [m].
    """
    rows = np.linspace(0, len(poses) - 1, min(_ROWS_MOVED, len(poses))).astype(int)
    plan = Plan(poses[rows], readings=readings[rows] if mechanism.by_readings else None)
    if not np.isfinite(plan.poses).all() or (
        mechanism.by_readings and np.isnan(readings[rows]).any()
    ):
        return ()
    legs = legs_at(mechanism, plan)
    if not len(legs.gain) or not np.isfinite(legs.gain).all() or not changes.all():
        return ()  # out of reach, or parameters are held
    platform, scale = mechanism.platform, plausible_changes(mechanism)
    size, own, space = largest_size(mechanism.legs), changes / scale, platform.space
    lengths = np.where(np.array(platform.units) == "m", 1.0, size)[:, None]
    A = (legs.gain * lengths).reshape(-1, len(own)) * scale
    motions = frame_motions(platform, platform.matrices(legs.poses)) * lengths
    of_base, of_platform = np.split(
        motions.reshape(len(A), -1), [motions.shape[2] - platform.dof], axis=1
    )
    for frame, of_frame in (("base", of_base), ("platform", of_platform)):
        p_value, share, amounts = _as_one(A, of_frame, own)
        if p_value > _CHANCE or share < _MATTERS:
            continue
        shift, turn = (float(np.linalg.norm(part)) for part in np.split(amounts, [space]))
        motion = finding(
            "frame-misaligned",
            frame=frame,
            remedy=frame if "rad" in platform.units else "base",
            share=share,
            p_value=p_value,
            shift=shift,
            turn=turn if len(amounts) > space else None,
        )
        return (motion,)
    return ()


def _as_one(A: Array, b: Array, own: Array) -> tuple[float, float, Array]:
    """Return the chance of changes (n,) as one body, its share of what they move, and its motion.

    A, shape (m, n), is what parameters move, b, shape (m, k), what a frame does. The chance is 1 if
    parameters cannot move so.
    """
    D = np.linalg.lstsq(A, b, rcond=1e-9)[0]
    k, free = D.shape[1], len(own) - D.shape[1]
    misfit, sizes = np.linalg.norm(A @ D - b, axis=0), np.linalg.norm(b, axis=0)
    if free <= 0 or (misfit > NEGLIGIBLE * sizes).any():
        return 1.0, 0.0, np.zeros(k)
    Q, R = np.linalg.qr(D)
    along, moved = Q.T @ own, A @ own
    inside = along @ along
    p_value = float(fdtrc(k, free, inside / k / ((own @ own - inside) / free)))
    left = moved - b @ np.linalg.lstsq(b, moved, rcond=None)[0]
    share = float(1.0 - left @ left / (moved @ moved))
    return p_value, share, np.linalg.lstsq(R, along, rcond=None)[0]


def zeros_found(calibration: Calibration, faults: Sequence[Finding]) -> Array | None:
    """Return where the search starts, (n_params,), if zeros alone explain what does not fit.

    None if a fault among those found is another, or a zero is not identified.
    """
    names = calibration.mechanism.reading_names
    offsets = np.zeros(len(names))
    if [(fault.code, fault.values.get("unknown_frame")) for fault in faults] != [_ZEROS]:
        return None
    for name, off, _ in faults[0].values["offsets"]:
        offsets[names.index(name)] = off
    start, identified = _start(calibration, offsets)
    return start if identified[offsets != 0.0].all() else None


def zeros_measured(calibration: Calibration) -> Array | None:
    """Return where the search starts with the zeros that full poses show, shape (n_params,).

    None without full poses, or if no zero is identified.
    """
    mechanism, setup = calibration.mechanism, calibration.options.setup
    case = Case.of(mechanism, calibration.measurements, setup.unknown_frame, setup.targets[ORIGIN])
    nominal = judge_as_measured(case).nominal_readings if case and case.alone else None
    if case is None or nominal is None:
        return None
    offsets = zeros_by_poses(case, nominal)
    start, identified = _start(calibration, offsets)
    return start if offsets[identified].any() else None


def _start(calibration: Calibration, offsets: Array) -> tuple[Array, Array]:
    """Return nominal parameters (n_params,) with zeros moved by offsets (n_readings,), and which.

    ψ = d k q + γ grows with γ; q = d k ψ + γ falls by d k of it. Zeros with priors, ties or terms,
    or of several sensors, start at nominal.
    """
    unknowns, legs = calibration.unknowns, calibration.mechanism.legs
    free = unknowns.map != 0.0
    alone = free[:, free.sum(axis=0) == 1].sum(axis=1) == 1
    start, first = np.concatenate([leg.nominal for leg in legs]), 0
    identified = np.zeros(len(offsets), dtype=bool)
    for leg, columns in zip(legs, calibration.mechanism.reading_columns, strict=True):
        zeros = [sensor.offset for sensor in leg.sensors]
        for i, (sensor, name) in enumerate(zip(leg.sensors, zeros, strict=True), columns.start):
            if isinstance(name, str) and zeros.count(name) == 1 and not sensor.terms:
                place = first + leg.parameter_names.index(name)
                gain, _ = sensor.constants(leg.nominal_by_name)
                if alone[place] and np.isinf(unknowns.priors[place]):
                    start[place] += offsets[i] * (1.0 if sensor.form == "reading" else -gain)
                    identified[i] = True
        first += len(leg.parameters)
    return start, identified
