"""How near calibrations come to the Cramér-Rao bound, over many simulated data sets.

    python benchmarks/statistics_of_fits.py [--sets 300]

An independent simulator with noise on poses and readings, and the bound by central differences
(tests/cramer_rao.py).
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
import numpy as np
from cramer_rao import KINDS, NOISE, machine, values_of

import pincal

CASES: dict[str, dict[str, object]] = {
    "default": {},
    "default, noise not given": {"noise": None},
    "per leg, all poses": {"method": "per-leg", "poses": "all"},
}


@dataclass(frozen=True)
class Statistics:
    """What many data sets tell of an estimator."""

    ratio: float
    """Root mean square error of the parameters over the bound."""
    ratio_error: float
    """Its standard error, of so many data sets."""
    paired: float
    """The same over the efficient (linearised) estimate's on the same noise."""
    paired_error: float
    """Its standard error, which is far smaller."""
    coverage: float
    """Share of true values within the intervals of 95 %."""
    coverage_error: float
    promised: float
    """Root mean square of the standard errors over the bound."""
    chi2: float
    """Mean reduced χ²."""
    unconverged: int


def statistics(kind: str, sets: int = 300, **options: object) -> Statistics:
    """Return statistics of ``pincal.calibrate`` with some options, the noise given.

    Standard errors are those of a mean over data sets, whose parameters are correlated.
    """
    one = machine(kind)
    squares, efficient, within, promised, chi2, lost = [], [], [], [], [], 0
    for seed in range(sets):
        data, error = one.measured(seed)
        result = pincal.calibrate(one.nominal, data, **{"noise": NOISE, **options})  # type: ignore[arg-type]
        values, std, low, high = values_of(result)
        squares.append((((values - one.parameters) / one.bound) ** 2).mean())
        efficient.append(((error / one.bound) ** 2).mean())
        within.append(((low <= one.parameters) & (one.parameters <= high)).mean())
        promised.append(((std / one.bound) ** 2).mean())
        chi2.append(result.reduced_chi2)
        lost += not result.converged
    a, b, root = np.array(squares), np.array(efficient), np.sqrt(sets)
    ratio, paired = np.sqrt(a.mean()), np.sqrt(a.mean() / b.mean())
    return Statistics(
        ratio=float(ratio),
        ratio_error=float(a.std() / root / (2 * ratio)),
        paired=float(paired),
        paired_error=float((a - paired**2 * b).std() / root / (2 * paired * b.mean())),
        coverage=float(np.mean(within)),
        coverage_error=float(np.std(within) / root),
        promised=float(np.sqrt(np.mean(promised))),
        chi2=float(np.mean(chi2)),
        unconverged=lost,
    )


def main() -> None:
    """Print one line of a Markdown table a mechanism and calibration."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sets", type=int, default=300, help="data sets (default: 300)")
    parser.add_argument("--cases", nargs="+", choices=CASES, default=["default"])
    given = parser.parse_args()
    head = "mechanism", "calibration", "error / bound", "same noise", "standard errors / bound"
    print(f"| {' | '.join(head)} | within 95 % | χ² | not converged |\n|---|---|{'---:|' * 6}")
    for kind in KINDS:
        for name in given.cases:
            one = statistics(kind, given.sets, **CASES[name])
            print(
                f"| {kind} | {name} | {one.ratio:.3f} ± {one.ratio_error:.3f} "
                f"| {one.paired:.4f} ± {one.paired_error:.4f} | {one.promised:.4f} "
                f"| {100 * one.coverage:.1f} ± {100 * one.coverage_error:.1f} % "
                f"| {one.chi2:.4g} | {one.unconverged} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
