"""Do readings and what was measured contradict each other in the nominal mechanism?"""

from __future__ import annotations

import numpy as np

from pincal.errors import MeasurementError
from pincal.identification.alignment import settle
from pincal.identification.latent import LatentPoses
from pincal.identification.problem import State
from pincal.identification.task import unsaid
from pincal.kinematics.closure import largest_size

_MISSED = 0.03  # of the mechanism's size, median over the rows, from which nothing is identified


def check_start(problem: LatentPoses, state: State) -> None:
    """Raise if readings and what was measured cannot both be the nominal mechanism's.

    At poses settled at the nominal parameters, what legs and measured lengths miss together.

    Raises:
        MeasurementError: by how much they miss.
    """
    easy = problem.eased()
    state = settle(easy, state)
    size = largest_size(problem.legs, problem.residuals[0].platform)
    _, plain = easy.rows(state)
    missed = [np.linalg.norm(demand.value, axis=1) for demand in plain.demands]
    gaps = np.where(problem.used, np.stack(missed, axis=1), 0.0)
    seen = problem.observation.evaluate(plain.state.matrices, state.external).value
    lengths = np.array([unit == "m" for unit in problem.observation.units], dtype=bool)
    missed = np.sqrt((gaps**2).sum(axis=1) + (seen[:, lengths] ** 2).sum(axis=1))
    worst = float(np.median(missed))
    if worst > _MISSED * size:
        raise MeasurementError(
            f"readings and measured positions contradict each other by {1e3 * worst:.3g} mm in the "
            f"nominal mechanism (median over the rows, {100 * worst / size:.0f} % of a leg's "
            "length). Check the units, the order and signs of the readings, and the frame"
            f"{unsaid(problem.observation.setup)}. If the mechanism is known but roughly, say so "
            "(--rough)"
        )
