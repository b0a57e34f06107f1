"""What many machines show: the verdict, how errors are distributed, and what makes them."""

from __future__ import annotations

from collections import Counter

import numpy as np

from pincal.calibration.many import FAILURE, Columns
from pincal.calibration.montecarlo import MonteCarlo
from pincal.words.numbers import amount
from pincal.words.table import Cell, Table, Value

_QUANTILES = {"median": 0.5, "95 %": 0.95, "99 %": 0.99, "worst": 1.0}
_HEADS = {
    "before": "before calibration",
    "after": "after calibration",
    "worst": "after calibration, worst pose",
}


def montecarlo_lines(study: MonteCarlo) -> list[str | Table]:
    """Return the verdict of a study, why machines failed, how errors are distributed, and why."""
    name, fine = study.mechanism.name, study.columns[FAILURE] == ""
    if not fine.any():
        return [f"✗ {name}: no machine could be calibrated", *failure_lines(study.columns)]
    unit = study.mechanism.platform.units[0]
    before, after = (amount(float(np.quantile(e, 0.95)), unit) for e in study.known)
    verdict = (
        f"{'✓' if fine.all() else '⚠'} {name}: 95 % of calibrated machines are within {after} "
        f"({before} before calibration)"
    )
    rows: list[list[Value]] = []
    for head, errors in study.columns.items():
        key, _, unit = head.removesuffix("]").partition(" [")
        if key in _HEADS:
            sizes = np.quantile(errors[fine], [*_QUANTILES.values()]).tolist()
            rows.append([_HEADS[key], *(Cell(size, amount(size, unit)) for size in sizes)])
    title = f"Errors of the platform of {fine.sum()} machines, each over the workspace (RMS)"
    return [
        verdict,
        *failure_lines(study.columns),
        Table(title, ["", *_QUANTILES], rows),
        _costs(study),
    ]


def failure_lines(columns: Columns) -> list[str]:
    """Return how many machines have no result, and why, the most frequent cause first."""
    causes = Counter(cause for cause in columns[FAILURE] if cause)
    total = len(columns[FAILURE])
    return [f"{count} of {total} have no result: {cause}" for cause, count in causes.most_common(3)]


def _costs(study: MonteCarlo) -> Table:
    """Return which tolerance makes which share of the mean square error."""
    costs = study.costs()
    rows: list[list[Value]] = [
        [
            cost.name,
            Cell(cost.sigma, amount(cost.sigma, cost.unit)),
            *(100.0 * share for share in cost[3:]),
        ]
        for cost in costs
    ]
    rows.append(
        ["noise of the measurements", None, None, 100.0 * (1.0 - sum(cost.after for cost in costs))]
    )
    columns = ["", "tolerance (σ)", "before [%]:.0f", "after [%]:.0f"]
    return Table("What makes the mean square error", columns, rows)


def montecarlo_text(study: MonteCarlo) -> str:
    """Return what ``pincal montecarlo`` prints."""
    return "\n".join(map(str, montecarlo_lines(study)))
