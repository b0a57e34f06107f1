"""How near calibrations come to the Cramér-Rao bound, over many simulated data sets.

    python benchmarks/statistics_of_fits.py [--sets 300]

An independent simulator with noise on poses and readings, and the bound by central differences
(tests/cramer_rao.py).
"""

from __future__ import annotations

import argparse
import sys
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


def statistics(kind: str, sets: int, **options: object) -> list[str]:
    """Return cells of a line: what many data sets tell of ``pincal.calibrate`` with some options.

    Root mean square error of the parameters over the bound, and over the efficient (linearised)
    estimate's on the same noise; root mean square standard error over the bound; share of true
    values within the intervals of 95 %; mean reduced χ²; how many did not converge. Behind ± are
    standard errors of a mean over data sets, whose parameters are correlated.
    """
    one = machine(kind)
    squares, efficient, within, promised, chi2, lost = [], [], [], [], [], 0
    for seed in range(sets):
        data, error = one.measured(seed)
        result = pincal.calibrate(one.nominal, data, **{"noise": NOISE, **options})  # type: ignore[arg-type]
        values, std, low, high = values_of(result)
        squares.append((((values - one.parameters) / one.bound) ** 2).mean())
        efficient.append(((error / one.bound) ** 2).mean())
        within.append(100.0 * ((low <= one.parameters) & (one.parameters <= high)).mean())
        promised.append(((std / one.bound) ** 2).mean())
        chi2.append(result.reduced_chi2)
        lost += not result.converged
    a, b, root = np.array(squares), np.array(efficient), np.sqrt(sets)
    ratio, paired = np.sqrt(a.mean()), np.sqrt(a.mean() / b.mean())
    paired_error = (a - paired**2 * b).std() / root / (2 * paired * b.mean())
    return [
        f"{ratio:.3f} ± {a.std() / root / (2 * ratio):.3f}",
        f"{paired:.4f} ± {paired_error:.4f}",
        f"{np.sqrt(np.mean(promised)):.4f}",
        f"{np.mean(within):.1f} ± {np.std(within) / root:.1f} %",
        f"{np.mean(chi2):.4g}",
        f"{lost}",
    ]


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
            cells = kind, name, *statistics(kind, given.sets, **CASES[name])
            print(f"| {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
