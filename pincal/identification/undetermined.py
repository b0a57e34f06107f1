"""What the measurements leave undetermined may be held: parameters stay nearest to nominal there.

The machine is then calibrated where it was measured; elsewhere these directions may move it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pincal.experiment.observability import identifiability
from pincal.identification.consistent import consistent, lost_directions
from pincal.identification.latent import LatentPoses
from pincal.identification.unknowns import Unknowns
from pincal.model.mechanism import Mechanism

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Held:
    """What measurements do not tell and was held as near to nominal as can be."""

    unknowns: Unknowns
    """Less these freedoms."""
    of_legs: Array
    """Directions in the legs' parameters, columns of shape (n_params, n_lost)."""
    words: str
    """Empty if there are none."""


def hold_undetermined(mechanism: Mechanism, problem: LatentPoses, unknowns: Unknowns) -> Held:
    """Return the unknowns less what the measurements leave undetermined.

    Of all parameters that fit as well, those nearest to the nominal ones, each change measured by
    what it alone would do to the measurements.

    Args:
        mechanism: The nominal mechanism.
        problem: The problem, at its start.
        unknowns: Of the problem, less gauge freedoms.
    """
    J = consistent(mechanism, problem, unknowns, generic=False).jacobian(unknowns)
    lost, lengths = lost_directions(J)
    n_legs = problem.columns[-1].stop
    if not len(lost):
        return Held(unknowns, np.empty((n_legs, 0)), "")
    return Held(
        unknowns.held(lost * lengths),
        ((lost / lengths) @ unknowns.map.T)[:, :n_legs].T,
        identifiability(J, unknowns.free_labels).in_words(),
    )
