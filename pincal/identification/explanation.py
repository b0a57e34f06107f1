"""What would explain measurements that do not fit: every suspect is put right in turn.

A suspect explains them if every leg then closes, and machines near the nominal one leave much
less of the doubtful legs' gaps than as given. Those that do as well as the best cannot be told
from it and are all named.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from pincal.errors import MeasurementError
from pincal.identification.leg_fit import LegFit, leg_fit
from pincal.identification.suspects import Suspect, exchanged, several_units, single_faults
from pincal.kinematics.singularity import margins
from pincal.model.mechanism import Mechanism

Array = NDArray[np.float64]
DOUBTFUL = 0.01  # median gap over the leg's size from which suspects are tried
_CONTRADICTS = 0.02  # gap that no machine near nominal explains, over the stroke that was measured
EXPLAINED = 0.02  # median gap over the leg's size to which a suspect brings every leg
REFUSED = 0.05  # gap from which nothing is identified
_BETTER = 1 / 3  # of what is left as given, to which it brings the doubtful legs on average
_EQUAL = 2.0  # times what the best explanation leaves: cannot be told from it


def doubtful(fits: Sequence[LegFit]) -> NDArray[np.bool_]:
    """Return which legs' gaps are not small, of the leg or of the stroke that was measured."""
    return np.array(
        [
            one.rows > 1 and (one.gap > DOUBTFUL or one.left > _CONTRADICTS * one.stroke)
            for one in fits
        ]
    )


def check_gaps(
    mechanism: Mechanism,
    poses: Array,
    readings: Array,
    fits: Sequence[LegFit],
    more: Iterable[Suspect] = (),
) -> None:
    """Raise if a suspect explains the gaps, or they are too large for anything.

    Args:
        mechanism: The nominal mechanism.
        poses: Complete poses, shape (N, dof).
        readings: Shape (N, n_readings); NaN where not measured.
        fits: How these fit each leg.
        more: Suspects of the order of the rows.

    Raises:
        MeasurementError: with the gaps as given, and as they would be.
    """
    found = explained(mechanism, poses, readings, fits, more)
    if found:
        raise MeasurementError(found)
    gaps = np.array([one.gap if one.rows > 1 else 0.0 for one in fits])
    worst = int(np.argmax(gaps))
    if gaps[worst] > REFUSED:
        raise MeasurementError(
            f"{mechanism.leg_names[worst]}: the measurements miss the nominal mechanism by "
            f"{100 * gaps[worst]:.1f} % of a leg's length (median), and no single fault in units, "
            "signs, order or frame explains it. Check the units, the order and signs of the "
            "readings, the frame of the poses, and that this is the right mechanism. If it is "
            "known but roughly, say so (--rough)"
        )


def explained(
    mechanism: Mechanism,
    poses: Array,
    readings: Array,
    fits: Sequence[LegFit],
    more: Iterable[Suspect] = (),
) -> str:
    """Return what explains the gaps and what to do about it, in words; empty if nothing does.

    Arguments are those of ``check_gaps``.
    """
    indices = range(len(fits))

    def swapped() -> Iterable[Suspect]:
        if readings.shape[1] != len(fits):
            return []
        table = [
            [leg_fit(mechanism, i, poses, column[:, None]).left for column in readings.T]
            for i in indices
        ]
        strokes = np.array([one.stroke for one in fits])
        return exchanged(mechanism, poses, readings, np.array(table), strokes)

    single = [*single_faults(mechanism, poses, readings), *swapped(), *more]
    return _accused(mechanism, fits, single) or _accused(
        mechanism, fits, several_units(mechanism, poses, readings)
    )


def _accused(mechanism: Mechanism, fits: Sequence[LegFit], suspects: Iterable[Suspect]) -> str:
    """Return the suspects that explain the gaps best, in words; empty if none does."""
    names, doubts = np.array(mechanism.leg_names), doubtful(fits)
    given = np.array([one.left for one in fits])
    found = []
    for suspect in suspects:
        right = _left_by(mechanism, fits, suspect)
        if right is not None:
            concerned = np.isfinite(right)
            left = np.where(concerned, right, given)[doubts]
            of = "" if concerned.all() else f" of {', '.join(names[concerned])}"
            words = suspect.words.format(readings=f"the readings{of}")
            found.append((float(left.mean()), f"by {_percent(left)} if {words}", suspect))
    if not found:
        return ""
    best = min(left for left, _, _ in found)
    equal = [one for one in found if one[0] <= _EQUAL * best]
    equal = [one for one in equal if beyond(mechanism, one[2].poses) <= 0.5] or equal
    remedies = dict.fromkeys(suspect.remedy for _, _, suspect in equal)
    return (
        f"{', '.join(names[doubts])}: the measurements miss every mechanism near the nominal one "
        f"by {_percent(given[doubts])} of a leg's length (median), but only "
        f"{', or '.join(words for _, words, _ in equal)}. {'; or: '.join(remedies)}"
    )


def _percent(shares: Array) -> str:
    return f"{float(f'{100 * shares.max():.2g}'):g} %"


def beyond(mechanism: Mechanism, poses: Array) -> float:
    """Return the share of poses beyond a type-2 singularity from home."""
    if mechanism.by_readings:
        return 0.0
    return float((margins(mechanism, poses).type2 < 0.0).mean())


def _left_by(mechanism: Mechanism, fits: Sequence[LegFit], suspect: Suspect) -> Array | None:
    """Return what a suspect put right leaves, NaN for legs it leaves alone; None if it fails.

    It must bring every leg to a small gap, bent as at home, and of the doubtful ones leave much
    less than as given.
    """
    right = np.full(len(fits), np.nan)
    doubts = doubtful(fits)
    gaps, given = np.array([(one.gap, one.left) for one in fits]).T
    if np.nanmax(gaps) < suspect.least:
        return None
    for index in np.argsort(-gaps):
        if suspect.by_leg and not doubts[index]:
            continue
        own = mechanism.reading_columns[index]
        fit = leg_fit(mechanism, int(index), suspect.poses, suspect.readings[:, own])
        if fit.rows < 2:
            continue
        enough = not suspect.by_leg or fit.left <= _BETTER * given[index]
        if fit.as_home and fit.gap <= EXPLAINED and enough:
            right[index] = fit.left
        elif not suspect.by_leg or gaps[index] > EXPLAINED:
            return None
    left = np.where(np.isfinite(right), right, given)[doubts]
    return right if left.mean() <= _BETTER * given[doubts].mean() else None
