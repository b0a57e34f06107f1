"""Are the measurements such as this mechanism can have made?

Readings and poses that fit the nominal mechanism leave closure gaps that machines near it explain,
with the legs bent as at home. Else what often goes wrong is put right, one hypothesis at a time,
and those that then fit much better are named. If none does, nothing is identified.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
from scipy.special import fdtrc

from pincal.calibration.calibration import Calibration
from pincal.calibration.hypotheses.faults import zeros_by_poses
from pincal.calibration.hypotheses.judging import (
    QUESTIONED,
    Case,
    Judged,
    judge,
    other_side,
    poses_as_measured,
)
from pincal.calibration.hypotheses.ranking import as_findings, explanations
from pincal.errors import MeasurementError
from pincal.estimation.observability.gauge import frame_motions, unexplained
from pincal.estimation.observability.indices import DIFFER, NEGLIGIBLE, plausible_changes
from pincal.estimation.unknowns import External
from pincal.finding import Finding
from pincal.kinematics.closing import sensor_law
from pincal.kinematics.closure import largest_size, nominal_legs
from pincal.kinematics.configurations import legs_at
from pincal.model.checks import ROUNDING
from pincal.model.measurements import Measurements, Noise, Plan
from pincal.model.mechanism import Mechanism
from pincal.model.setup import ORIGIN, Setup, Target
from pincal.types import Array
from pincal.words.sentences import finding, sentence, sentences

_STILL = 1e-3  # readings that differ by less hardly move, of a leg's size and [rad]
_FOLLOWS = 0.5  # of the stroke: what is left of readings that follow the nominal ones
_PAST = 0.1  # [rad] past half a turn from home that a joint may be read: readings have a cut there
_SLIP = 10.0  # times the median that a row misses by, if fewer than one row in so many does
_CHANCE = 1e-5  # probability of so much motion as one body by chance, above which it is none
_MATTERS = 0.25  # of the platform's error: a motion of less is not worth a warning
_ZEROS = ("reading-offset", False)  # the fault that a search may start from
_PLAIN = Setup()
_ROWS_MOVED = 200  # enough, where the motion of a body is looked for


def check_plausible(mechanism: Mechanism, data: Measurements, setup: Setup = _PLAIN) -> None:
    """Raise if measurements cannot come from a mechanism like the nominal one.

    Raises:
        MeasurementError: they do not fit; the message says what would explain it.
    """
    if faults := implausible(mechanism, data, setup):
        raise MeasurementError(said(faults))


def implausible(
    mechanism: Mechanism, data: Measurements, setup: Setup = _PLAIN
) -> tuple[Finding, ...]:
    """Return why measurements cannot come from a mechanism like the nominal one; empty if they can.

    Only rows with complete poses are looked at, and of a leg those with its reading.
    """
    case = Case.of(mechanism, data, setup.unknown_frame, setup.targets[ORIGIN])
    return () if case is None or not case.oriented else _faults(case, _strange)


def explain_misfit(
    mechanism: Mechanism,
    data: Measurements,
    setup: Setup = _PLAIN,
    frame: External | None = None,
) -> tuple[Finding, ...]:
    """Return what would explain that measurements do not fit; empty if nothing does.

    Args:
        mechanism: The nominal mechanism.
        data: What was measured.
        setup: What the numbers mean.
        frame: Frames and targets as they were estimated, if they were.
    """
    target = setup.targets[ORIGIN]
    if frame is not None and target.unknown:
        x, y, z = frame.offsets[0].tolist()
        target = Target((x, y, z))
    case = Case.of(mechanism, data, setup.unknown_frame, target)
    return () if case is None else _faults(case, _slips)


def hypotheses_of(
    mechanism: Mechanism, data: Measurements, setup: Setup
) -> list[tuple[Finding, Judged]]:
    """Return hypotheses that explain measurements that do not fit, each with what it says."""
    case = Case.of(mechanism, data, setup.unknown_frame, setup.targets[ORIGIN])
    if case is None:
        return []
    explaining, as_measured = _explaining(case)
    return list(zip(as_findings(mechanism, as_measured, explaining), explaining, strict=True))


def said(findings: tuple[Finding, ...]) -> str:
    """Return findings of one cause as one message."""
    return sentences(findings)[0]


def _faults(
    case: Case, unexplained: Callable[[Case, Judged], tuple[Finding, ...]]
) -> tuple[Finding, ...]:
    """Return what is wrong: readings that stand still, what explains the misfit, or the rest."""
    if faults := _still(case):
        return faults
    explaining, as_measured = _explaining(case)
    return as_findings(case.mechanism, as_measured, explaining) or unexplained(case, as_measured)


@lru_cache(maxsize=4)
def _explaining(case: Case) -> tuple[list[Judged], Judged]:
    """Return what explains measurements that do not fit, and how these fit as given."""
    (as_measured,) = judge(case)
    elsewhere = other_side(case.mechanism, as_measured.matrices)
    as_measured = replace(as_measured, elsewhere=elsewhere)
    if as_measured.fits_well:
        return [], as_measured
    if slips := _slips(case, as_measured):  # few rows may be all that is wrong
        sound = replace(case, rows=np.setdiff1d(case.rows, slips[0].rows))
        if judge(sound)[0].fits_well:
            return [], as_measured
    return explanations(case, as_measured), as_measured


def _strange(case: Case, as_measured: Judged) -> tuple[Finding, ...]:
    """Return what bars a fit though no hypothesis explains it."""
    mechanism = case.mechanism
    judged = [
        (leg, fit)
        for leg, fit in zip(mechanism.legs, as_measured.fits, strict=False)
        if fit.rows > 1
    ]
    if not judged:
        return ()
    leg, worst = max(judged, key=lambda pair: pair[1].gap)
    if worst.gap > DIFFER:
        return (finding("not-this-mechanism", leg=leg.name, gap=worst.gap),)
    bent = tuple(
        (leg.name, tuple(leg.moving[i].name for i in leg.passive), fit.bent, fit.rows)
        for leg, fit in judged
        if not fit.as_home
    )
    if bent:
        return (finding("other-working-mode", legs=bent),)
    if turned := _turns(case):
        return turned
    for leg, fit in judged:
        if fit.near > max(_FOLLOWS * fit.stroke, _STILL):
            return (
                finding("readings-do-not-follow", leg=leg.name, left=fit.near, stroke=fit.stroke),
            )
    return ()


def _still(case: Case) -> tuple[Finding, ...]:
    """Return which readings are the same in all rows though the poses move their sensors."""
    mechanism, readings = case.mechanism, case.readings
    still = np.ptp(readings, axis=0) == 0.0
    if mechanism.by_readings or case.free or not still.any():
        return ()
    matrices = poses_as_measured(case)
    if matrices is None:
        return ()
    nominal, named = case.nominal_readings(matrices), []
    for index, (leg, name) in enumerate(zip(mechanism.legs, mechanism.reading_names, strict=True)):
        known = nominal[np.isfinite(nominal[:, index]), index]
        unit = mechanism.reading_units[index]
        moved = float(np.ptp(known)) if len(known) > 1 else 0.0
        if still[index] and moved > _STILL * (1.0 if unit == "rad" else leg.size):
            named.append((name, float(readings[0, index]), unit, moved))
    return (finding("readings-still", readings=tuple(named)),) if named else ()


def _turns(case: Case) -> tuple[Finding, ...]:
    """Return readings that are whole turns off the nominal ones, of the first such leg."""
    mechanism, matrices = case.mechanism, poses_as_measured(case)
    several = any(len(leg.active) > 1 for leg in mechanism.legs)
    turning = "rad" in mechanism.reading_units and not several
    if mechanism.by_readings or matrices is None or not turning:
        return ()
    nominal = case.nominal_readings(matrices)
    for index, leg in enumerate(mechanism.legs):
        if leg.reading_units[0] != "rad":
            continue
        measured, expected = case.readings[:, index], nominal[:, index]
        gain, _ = leg.sensors[0].constants(leg.nominal_by_name)
        turn = 2 * np.pi * (abs(gain) if leg.sensors[0].form == "reading" else 1 / abs(gain))
        law, (joint,) = sensor_law(nominal_legs(mechanism)[index]), leg.active
        position = law.position(measured[:, None])[:, 0] - leg.home[joint]
        turned = np.nan_to_num(np.round((measured - expected) / turn)) != 0.0
        off = np.flatnonzero(turned & (np.abs(position) > np.pi + _PAST))  # not at the cut
        if len(off) and np.isfinite(measured - expected).sum() > 1:
            values = {"reading": measured[off[0]], "nominal": expected[off[0]]}
            return (finding("whole-turns", case.rows[off], leg=leg.name, **values),)
    return ()


def _slips(case: Case, as_measured: Judged) -> tuple[Finding, ...]:
    """Return which few rows miss machines near the nominal one much farther than the others.

    Where poses were measured in full: those filled in by forward kinematics vary in precision.
    """
    judged = [leg_fit.left for leg_fit in as_measured.fits if leg_fit.rows > 1]
    if not case.oriented or not judged:
        return ()
    left = np.array(judged)
    usual = np.maximum(np.nanmedian(left, axis=1, keepdims=True), ROUNDING)
    times = np.nan_to_num(left / usual).max(axis=0)
    far = np.flatnonzero(times > _SLIP)
    if not 0 < len(far) <= max(1.0, len(times) / _SLIP):
        return ()
    worst = int(case.rows[np.argmax(times)])
    return (finding("bad-rows", case.rows[far], worst=worst, times=float(times.max())),)


def check_copies(data: Measurements, *, every_pose: bool = False) -> None:
    """Raise if rows that serve the same leg are equal in all that was measured.

    Rows chosen for several legs may be copies of each other: each leg has its own. But if
    ``every_pose`` serves every leg, whatever its set, copies would count as so many measurements.
    Where equal readings come with different poses, measurements were repeated, and poses
    written with few digits may be equal by chance; rows of one ``pose`` are repeats, not copies.

    Raises:
        MeasurementError: rows that are copies.
    """
    measured = np.column_stack([data.poses, *data.extra.values()])
    first: dict[tuple[str, bytes], int] = {}
    copies = []
    for row in range(len(data)):
        served = "" if data.sets is None or every_pose else data.sets[row]
        first_row = first.setdefault((served, data.readings[row].tobytes()), row)
        if first_row == row:
            continue
        if not np.array_equal(measured[first_row], measured[row], equal_nan=True):
            return
        if (
            data.places is None
            or not data.places[row]
            or data.places[row] != data.places[first_row]
        ):
            copies.append((first_row, row))
    if copies:
        rows = tuple(sorted({row for pair in copies for row in pair}))
        copied = finding("rows-copied", rows, first=copies[0], pairs=len(copies))
        raise MeasurementError(sentence(copied))


def check_noise(mechanism: Mechanism, noise: Noise) -> None:
    """Raise if the noise given is so large that a unit must be wrong.

    Raises:
        MeasurementError: position noise above 2 % of a leg's size, or 0.02 rad of orientation.
    """
    size = largest_size(mechanism.legs)
    turns = "rad" in mechanism.platform.units
    for what, given, unit, most in (
        ("position", noise.position, "m", QUESTIONED * size),
        ("orientation", noise.orientation, "rad", QUESTIONED if turns else np.inf),
    ):
        if given > most:
            values: dict[str, Any] = {
                "what": what,
                "given": given,
                "unit": unit,
                "most": most,
                "size": size,
            }
            raise MeasurementError(sentence(finding("noise-too-large", **values)))


def misaligned(
    mechanism: Mechanism, changes: Array, poses: Array, readings: Array
) -> tuple[Finding, ...]:
    """Return a finding if parameters moved as one body.

    Of fits in frames that were said to be known, without ties.

    Args:
        mechanism: The nominal mechanism.
        changes: Identified less nominal parameters of all legs, shape (n_params,).
        poses: Measured or estimated, shape (N, dof), [m] and [rad].
        readings: Measured, shape (N, n_readings), [rad] or [m].
    """
    rows = np.linspace(0, len(poses) - 1, min(_ROWS_MOVED, len(poses))).astype(int)
    read = readings[rows] if mechanism.by_readings else None
    if not np.isfinite(poses[rows]).all() or (read is not None and np.isnan(read).any()):
        return ()
    legs = legs_at(mechanism, Plan(poses[rows], readings=read))
    gain = legs.gain
    if not len(gain) or not np.isfinite(gain).all() or not changes.any():
        return ()
    platform = mechanism.platform
    size = largest_size(mechanism.legs)
    motions = frame_motions(platform, platform.matrices(legs.poses))
    moved, scale = gain @ changes, plausible_changes(mechanism)
    n_base, space = motions.shape[2] - platform.dof, platform.space
    lengths = np.array([1.0 if unit == "m" else size for unit in platform.units])
    for frame, own in (("base", motions[:, :, :n_base]), ("platform", motions[:, :, n_base:])):
        chance, amounts = _as_one(gain, own, changes, scale)
        left = unexplained(platform.units, moved[:, :, None], own, size)[:, :, 0]
        share = 1.0 - ((left * lengths) ** 2).sum() / ((moved * lengths) ** 2).sum()
        if chance > _CHANCE or share < _MATTERS:
            continue
        turns = len(amounts) > space
        values: dict[str, Any] = {
            "frame": frame,
            "remedy": frame if "rad" in platform.units else "base",
            "share": float(share),
            "p_value": chance,
            "shift": float(np.linalg.norm(amounts[:space])),
            "turn": float(np.linalg.norm(amounts[space:])) if turns else None,
        }
        return (finding("frame-misaligned", **values),)
    return ()


def _as_one(gain: Array, motions: Array, changes: Array, scale: Array) -> tuple[float, Array]:
    """Return the probability of so much motion as one body by chance, and that motion.

    The share of the changes' squares, in parameters over their scale (n,), that lies in the
    directions that move a frame has the F distribution if all directions are alike. 1 if parameters
    cannot move so, or some are held. Gains of parameters have shape (N, dof, n), what unit motions
    of a frame do to the platform (N, dof, k).
    """
    A, b = gain.reshape(-1, gain.shape[2]) * scale, motions.reshape(-1, motions.shape[2])
    D = np.linalg.lstsq(A, b, rcond=1e-9)[0]
    misfit, sizes = np.linalg.norm(A @ D - b, axis=0), np.linalg.norm(b, axis=0)
    rigid = (misfit <= NEGLIGIBLE * sizes).all() and len(changes) > D.shape[1]
    if not rigid or not changes.all():
        return 1.0, np.zeros(D.shape[1])
    Q, R = np.linalg.qr(D)
    along, own = Q.T @ (changes / scale), changes / scale
    k, n = len(along), len(changes)
    inside, outside = along @ along, own @ own - along @ along
    amounts = np.linalg.lstsq(R, along, rcond=None)[0]
    return float(fdtrc(k, n - k, inside / k / (outside / (n - k)))), amounts


def zeros_found(calibration: Calibration, faults: Sequence[Finding]) -> Array | None:
    """Return where the search starts if zeros explain what does not fit, shape (n_params,).

    None if something else may explain it, or if a zero is not identified.

    Args:
        calibration: What is to be identified.
        faults: Hypotheses that explain the measurements.
    """
    names = calibration.mechanism.reading_names
    offsets = np.zeros(len(names))
    if [(fault.code, fault.values.get("unknown_frame")) for fault in faults] != [_ZEROS]:
        return None
    for name, off, _ in faults[0].values["offsets"]:
        offsets[names.index(name)] = off
    start, by_zeros = _zeros(calibration)
    identified = by_zeros.any(axis=0) | (offsets == 0.0)
    return start + by_zeros @ offsets if identified.all() else None


def zeros_measured(calibration: Calibration) -> Array | None:
    """Return where the search starts with the zeros that full poses show, shape (n_params,).

    None without full poses, or if no zero is identified.
    """
    mechanism, setup = calibration.mechanism, calibration.options.setup
    case = Case.of(mechanism, calibration.measurements, setup.unknown_frame, setup.targets[ORIGIN])
    matrices = None if case is None or not case.alone else poses_as_measured(case)
    if case is None or matrices is None or mechanism.by_readings:
        return None
    start, by_zeros = _zeros(calibration)
    shift = by_zeros @ zeros_by_poses(case, matrices)
    return start + shift if shift.any() else None


def _zeros(calibration: Calibration) -> tuple[Array, Array]:
    """Return the nominal parameters (n_params,), and how they follow zeros of readings.

    ψ = d k q + γ grows with γ; q = d k ψ + γ falls by d k of it. Zeros with priors, ties or terms,
    or of several sensors, start at nominal: columns of zeros, of (n_params, n_readings).
    """
    unknowns, legs = calibration.unknowns, calibration.mechanism.legs
    free = unknowns.map != 0.0
    alone = free[:, free.sum(axis=0) == 1].sum(axis=1) == 1
    start = np.concatenate([leg.nominal for leg in legs])
    by_zeros, first, column = np.zeros((len(start), len(calibration.mechanism.reading_names))), 0, 0
    for leg in legs:
        offsets = [sensor.offset for sensor in leg.sensors]
        for sensor, name in zip(leg.sensors, offsets, strict=True):
            if isinstance(name, str) and offsets.count(name) == 1 and not sensor.terms:
                place = first + leg.parameter_names.index(name)
                gain, _ = sensor.constants(leg.nominal_by_name)
                if alone[place] and np.isinf(unknowns.priors[place]):
                    by_zeros[place, column] = 1.0 if sensor.form == "reading" else -gain
            column += 1
        first += len(leg.parameters)
    return start, by_zeros
