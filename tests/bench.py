"""A simulated machine beside which sessions are held: what it answers at each row of a plan."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import pincal
from pincal.files.columns import columns_of
from pincal.words.numbers import UNITS

NOISE = pincal.Noise(2e-5, 2e-5, 1e-5)


class Bench:
    """A disturbed machine, and the rows of a plan as they are measured there."""

    def __init__(
        self,
        mechanism: pincal.Mechanism,
        plan: pincal.Plan,
        setup: pincal.Setup | None = None,
        seed: int = 1,
        noise: pincal.Noise = NOISE,
    ) -> None:
        self.mechanism, self.truth = mechanism, pincal.disturb(mechanism, seed=seed)
        made = pincal.simulate(mechanism, self.truth, plan, noise, seed=1000 + seed, setup=setup)
        self.plan = plan.rows(made.rows)  # what the machine reaches
        self.measurements = replace(made.measurements, sets=None)
        way = "zyx" if mechanism.platform.turns == 3 else "tilt-torsion"
        self._columns = {
            head.partition(" [")[0]: np.asarray(values, dtype=float)
            for head, values in columns_of(mechanism, self.measurements, way).items()
        }

    def entry(self, columns: list[str], row: int) -> dict[str, str]:
        """Return what is entered at a row of the plan, in the units of columns."""
        cells = {}
        for head in columns:
            name, _, unit = head.removesuffix("]").partition(" [")
            cells[head] = repr(float(self._columns[name][row] / UNITS[unit][1]))
        return cells

    def line(self, columns: list[str], row: int) -> str:
        """Return the same as it is typed."""
        return " ".join(self.entry(columns, row).values())
