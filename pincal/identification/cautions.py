"""What the reader of a calibration should know before its numbers."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import gammainc

from pincal.estimation.drawings import plausible_changes
from pincal.identification.result import UNEXPLAINED, LegResult, TieTest
from pincal.identification.robust import Outlier
from pincal.identification.task import Task, unsaid

_HOLD = ", hold what is not told (--method latent --hold-undetermined)"
_MUCH = 0.1  # share of rows that do not fit, from which the noise or the model is doubted


def _far(task: Task, legs: Sequence[LegResult]) -> list[str]:
    """Return warnings if parameters moved farther than those of one machine differ, or might."""
    found = [p for leg in legs for p in leg.parameters]
    plausible = plausible_changes(task.mechanism)
    moved = np.array([p.identified - p.nominal for p in found])
    std = np.array([p.std for p in found])
    names = [f"{p.name} of {leg.name}" for leg in legs for p in leg.parameters]
    warnings = []
    worst = int(np.argmax(std / plausible))
    if vague := int((std > plausible).sum()):
        half, hold = (found[worst].high - found[worst].low) / 2, "" if task.hold else _HOLD
        warnings.append(
            f"{vague} parameter{' is' if vague == 1 else 's are'} hardly told, {names[worst]} to "
            f"± {half:.2g} {found[worst].unit} only: measure poses that tell more{hold}, or say "
            "how well nominal values are known (--prior)"
        )
    within = np.array([(p.high - p.low) / 2 for p in found])
    surely = (np.abs(moved) - within) / plausible  # what the uncertainty does not explain
    worst = int(np.argmax(surely))
    if surely[worst] > 1.0 and not (task.rough or warnings):
        warnings.append(
            f"{names[worst]} moved by {moved[worst]:+.3g} {found[worst].unit}, farther than a "
            "machine differs from its drawing: check units, the order of the readings, and the "
            f"frame of the measurements{unsaid(task.setup)}"
        )
    return warnings


def warnings_of(
    task: Task,
    legs: Sequence[LegResult],
    outliers: Sequence[Outlier],
    ties: Sequence[TieTest],
    lost: Sequence[str],
    dof: int,
    chi2: float,
) -> list[str]:
    """Return what the reader of a result should know first."""
    found = [
        f"these measurements do not tell everything: {words}; held as near to nominal as can be, "
        "so that the machine is calibrated where it was measured only"
        for words in lost
    ]
    source, mechanism = task.noise.source, task.mechanism
    if source == "assumed":
        turns = "rad" in mechanism.platform.units
        what = "position [m]" + (" and orientation [rad]" if turns else "")
        if task.noise.noise.reading:
            what += " and readings"
        exact = "" if task.noise.noise.reading else ", exact readings"
        found.append(
            f"the noise was not given: equal standard deviations of {what}{exact} were assumed, "
            "and the scale estimated from the residuals"
        )
    elif dof and not UNEXPLAINED <= gammainc(dof / 2, dof * chi2 / 2) <= 1.0 - UNEXPLAINED:
        given = "repeated rows show" if source == "repeats" else "given"
        found.append(
            f"reduced χ² is {chi2:.3g} where 1 is expected: the noise is "
            f"{'larger' if chi2 > 1 else 'smaller'} than {given}"
            f"{', or the model lacks something' if chi2 > 1 else ''}; the uncertainties assume "
            "that noise"
        )
    found += _far(task, legs)
    listed = len(outliers)
    if listed and task.loss == "none":
        worst = outliers[0]
        found.append(
            f"{listed} of {len(task.data)} rows do{'es' * (listed == 1)} not fit the others, "
            f"{'data row' if listed == 1 else 'the worst data row'} {worst.row + 1} by "
            f"{worst.sigma:.1f} standard deviations ({worst.why}); look at "
            f"{'it' if listed == 1 else 'them'}, or use a robust loss (--robust reject)"
        )
    if listed > _MUCH * len(task.data):
        found.append(
            f"{100 * listed / len(task.data):.0f} % of the rows do not fit: rather the noise is "
            "larger than assumed, or the model lacks something, than that so many are wrong"
        )
    found += [
        f"{one.name} is tied over the legs, and the measurements contradict that "
        f"(p = {one.p_value:.2g})"
        for one in ties
        if not one.holds
    ]
    found += [
        f"{leg.name}: {leg.n_poses} poses for {len(leg.parameters)} parameters; two or three "
        "times as many poses as parameters are advised"
        for leg in legs
        if leg.n_residuals < 1.5 * len(leg.parameters)
    ]
    return found
