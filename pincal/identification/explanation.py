"""What would explain gaps that are not small: every suspect is put right in turn.

A suspect explains them if every leg then closes, and the doubtful ones much better than as
given. Those that do as well as the best cannot be told from it and are all named.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from pincal.errors import MeasurementError
from pincal.identification.leg_fit import leg_fit
from pincal.identification.suspects import Suspect, exchanged, several_units, single_faults
from pincal.model.mechanism import Mechanism

Array = NDArray[np.float64]
DOUBTFUL = 0.01  # median gap over the leg's size from which suspects are tried
EXPLAINED = 0.02  # to which a suspect brings every leg
REFUSED = 0.05  # gap from which nothing is identified
_BETTER = 1 / 3  # of the gaps as given, to which it brings the doubtful legs on average
_EQUAL = 2.0  # times the gap of the best explanation: cannot be told from it


def check_gaps(mechanism: Mechanism, poses: Array, readings: Array, gaps: Array) -> None:
    """Raise if a suspect explains the gaps, or they are too large for anything.

    Raises:
        MeasurementError: with the gaps as given, and as they would be.
    """
    indices, worst = range(len(gaps)), int(np.argmax(gaps))
    missed = (
        f"the measurements miss the nominal mechanism by {100 * gaps[worst]:.1f} % of a leg's "
        "length (median)"
    )

    def swapped() -> Iterable[Suspect]:
        if readings.shape[1] != len(gaps):
            return []
        table = [
            [leg_fit(mechanism, i, poses, column[:, None]).gap for column in readings.T]
            for i in indices
        ]
        return exchanged(mechanism, poses, readings, np.array(table))

    _accuse(mechanism, gaps, missed, [*single_faults(mechanism, poses, readings), *swapped()])
    _accuse(mechanism, gaps, missed, several_units(mechanism, poses, readings))
    if gaps[worst] > REFUSED:
        raise MeasurementError(
            f"{mechanism.leg_names[worst]}: {missed}, and no single fault in units, signs, order "
            "or frame explains it. Check the units, the order and signs of the readings, the frame "
            "of the poses, and that this is the right mechanism. If it is known but roughly, say "
            "so (--rough)"
        )


def _accuse(mechanism: Mechanism, gaps: Array, missed: str, suspects: Iterable[Suspect]) -> None:
    """Raise if suspects explain the gaps, naming the best, and others that do as well.

    Raises:
        MeasurementError: what they would put right.
    """
    names, doubtful = np.array(mechanism.leg_names), gaps > DOUBTFUL
    found = []
    for suspect in suspects:
        right = _explained(mechanism, gaps, suspect)
        if right is not None:
            concerned = np.isfinite(right)
            left = np.where(concerned, right, gaps)[doubtful]
            of = "" if concerned.all() else f" of {', '.join(names[concerned])}"
            words = suspect.words.format(readings=f"the readings{of}")
            found.append((float(left.mean()), f"by {100 * left.max():.2g} % if {words}", suspect))
    if found:
        best = min(gap for gap, _, _ in found)
        equal = [one for one in found if one[0] <= _EQUAL * best]
        remedies = dict.fromkeys(suspect.remedy for _, _, suspect in equal)
        raise MeasurementError(
            f"{', '.join(names[doubtful])}: {missed}, but only "
            f"{', or '.join(words for _, words, _ in equal)}. {'; or: '.join(remedies)}"
        )


def _explained(mechanism: Mechanism, gaps: Array, suspect: Suspect) -> Array | None:
    """Return the gaps with a suspect put right, NaN for legs it leaves alone; None if it fails.

    It must bring every leg to a small gap, bent as at home, and the doubtful ones to a much
    smaller one than as given.
    """
    right = np.full(len(gaps), np.nan)
    doubtful = gaps > DOUBTFUL
    if gaps.max() < suspect.least:
        return None
    for index in np.argsort(-gaps):
        if suspect.by_leg and not doubtful[index]:
            continue
        own = mechanism.reading_columns[index]
        fit = leg_fit(mechanism, int(index), suspect.poses, suspect.readings[:, own])
        if fit.rows < 2:
            continue
        most = min(EXPLAINED, _BETTER * gaps[index]) if suspect.by_leg else EXPLAINED
        if fit.as_home and fit.gap <= most:
            right[index] = fit.gap
        elif not suspect.by_leg or gaps[index] > EXPLAINED:
            return None
    left = np.where(np.isfinite(right), right, gaps)[doubtful]
    return right if left.mean() <= _BETTER * gaps[doubtful].mean() else None
