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
from cramer_rao import KINDS, statistics

CASES: dict[str, dict[str, object]] = {
    "default": {},
    "latent": {"method": "latent"},
    "default, noise not given": {"noise": None},
    "per leg, all poses": {"method": "per-leg", "poses": "all"},
}


def main() -> None:
    """Print one line of a Markdown table a mechanism and calibration."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sets", type=int, default=300, help="data sets (default: 300)")
    parser.add_argument("--cases", nargs="+", choices=CASES, default=["default", "latent"])
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
