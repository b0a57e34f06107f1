"""What it costs to give no noise, where the model holds and where it lacks something.

    python benchmarks/unknown_noise.py [--machines 126] [--only 3RRR …]

Machines are drawn at 1 mm and 1 mrad; their drives are eccentric (twice a turn) by 0 to 10 times
the noise of what is measured, which no parameter holds. 60 rows are fitted with the noise given and
with none; a line says by how many times farther the second misses 30 others: mean and largest ratio
over the machines and how many are above 1.03, of positions as measured and of the true ones.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from arms import loaded

import pincal

NOISE = pincal.Noise(5e-5, 5e-5, 1e-5)
LACKS = (0.0, 0.5, 1.0, 2.0, 5.0, 10.0)
"""Amplitudes of what the model lacks, over the noise of positions."""
POSITIONS = "_positions"
"""Behind the name of a machine whose orientation is not measured."""
NAMES = ("5R", "3RRR", "delta", "ur5", f"ur5{POSITIONS}", "6UPS", f"6UPS{POSITIONS}")


def eccentric(mechanism: pincal.Mechanism, amplitude: float, seed: int) -> pincal.Mechanism:
    """Return a mechanism off by 1 mm and 1 mrad whose drives follow harmonics twice a turn."""
    truth = pincal.disturb(mechanism, 1e-3, seed=seed)
    draw = np.random.default_rng(seed)
    legs = []
    for leg in truth.legs:
        names = [
            f"ecc_{i}_{phase}" for i in range(len(leg.sensors)) for phase in ("sine", "cosine")
        ]
        terms = [pincal.Term(name, pincal.Harmonic(2, name.rpartition("_")[2])) for name in names]
        sensors = tuple(
            replace(sensor, terms=tuple(terms[2 * i : 2 * i + 2]))
            for i, sensor in enumerate(leg.sensors)
        )
        values = amplitude * draw.standard_normal(len(names))
        parameters = (*leg.parameters, *zip(names, values.tolist(), strict=True))
        legs.append(replace(leg, sensors=sensors, parameters=parameters))
    return replace(truth, legs=tuple(legs))


def ratios(name: str, lacks: float, seed: int) -> tuple[float, float]:
    """Return how much farther a fit without a given noise misses than the same with it.

    Positions of held-out rows as measured, and the true ones.
    """
    stem = name.removesuffix(POSITIONS)
    mechanism = loaded(stem) if stem == "ur5" else pincal.load_mechanism(stem)
    plan = pincal.sample_configurations(mechanism, 90, seed=seed)
    truth = eccentric(mechanism, lacks * NOISE.position, seed)
    data = pincal.simulate(mechanism, truth, plan, NOISE, seed=seed).measurements
    seen, verification = data.rows(np.arange(60)), data.rows(np.arange(60, len(data)))
    clean = pincal.forward(truth, verification.readings, verification.poses).poses
    lengths, missed = mechanism.platform.lengths, []
    if name != stem:
        turns = np.arange(mechanism.platform.dof) >= lengths
        seen = replace(seen, poses=np.where(turns, np.nan, seen.poses))
    for noise in (NOISE, None):
        identified = pincal.calibrate(mechanism, seen, noise=noise).identified
        poses = pincal.forward(identified, verification.readings, verification.poses).poses
        gaps = (poses - verification.poses)[:, :lengths], (poses - clean)[:, :lengths]
        missed.append([np.sqrt(np.mean(gap**2)) for gap in gaps])
    measured, true = np.divide(missed[1], missed[0]).tolist()
    return measured, true


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--machines", type=int, default=126)
    parser.add_argument("--only", nargs="*", default=NAMES)
    given = parser.parse_args()
    print("| machine | lacks [of noise] | machines | as measured | the true positions |")
    print("|---|---|---|---|---|")
    for name in given.only:
        for place, lacks in enumerate(LACKS):
            seeds = range(place, given.machines, len(LACKS))
            both = np.array([ratios(name, lacks, seed) for seed in seeds])
            cells = [
                f"{column.mean():.3f}, {column.max():.3f}, {(column > 1.03).sum()}"
                for column in both.T
            ]
            print(f"| {name} | {lacks:g} | {len(both)} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
