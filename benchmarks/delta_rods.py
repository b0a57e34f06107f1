"""What a delta of one rod a leg leaves of a machine that has six.

    python benchmarks/delta_rods.py [--machines 20] [--write]

Machines of six rods are drawn around ``six_rod_delta``, every length off by a standard deviation
and every angle by that over a rod, and measured at 40 configurations: positions of the platform's
origin, without noise, for the ``delta`` of one rod a leg; poses with 20 µm, 0.1 mrad and 0.05 mrad
of readings for both. A line has what is left at 200 others, root mean square over all machines: the
platform's origin, a tool 0.1 m below it, and the tilt, which one rod says is zero.
"""

from __future__ import annotations

import argparse

import numpy as np
from pages import write_table
from scipy.spatial.transform import Rotation

import pincal

ERRORS = (2e-5, 1e-4, 5e-4)
NOISE = pincal.Noise(2e-5, 1e-4, 5e-5)
EXACT = pincal.Noise(1e-6, 1e-6, 0.0)
TOOL, ROD, SEEN, UNSEEN = 0.1, 0.55, 40, 200
HEAD = (
    "| lengths off [mm] | model | noise | origin [mm] | tool 0.1 m below [mm] | tilt [mrad] |",
    "|---|---|---|---|---|---|",
)


def misses(origin: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """Return squares of misses of origin, tool and tilt, shape (N, 3), [m²] and [rad²].

    Of origins, shape (N, 3), [m], and rotation vectors, shape (N, 3), both true less modelled.
    """
    tool = origin + np.cross(turn, (0.0, 0.0, -TOOL))
    return np.stack([(part**2).sum(axis=1) for part in (origin, tool, turn)], axis=1)


def left(error: float, seed: int) -> dict[tuple[str, str], np.ndarray]:
    """Return what models leave of a machine, as squares: see ``misses``, by model and noise."""
    six, one = pincal.load_mechanism("six_rod_delta"), pincal.load_mechanism("delta")
    sizes = {"m": error, "rad": error / ROD}
    truth = pincal.disturb(six, {p.id: sizes[p.unit] for p in six.parameters}, seed)
    plan = pincal.sample_configurations(six, SEEN + UNSEEN, seed=seed)
    result = {}
    for noise, name in ((EXACT, "none"), (NOISE, "of a tracker")):
        data = pincal.simulate(six, truth, plan, noise, seed=seed).measurements
        seen = data.rows(np.arange(SEEN))
        true = pincal.forward(truth, plan.readings[SEEN:]).poses
        turns = Rotation.from_matrix(six.platform.matrices(true)[:, :3, :3])
        positions = pincal.Measurements(readings=seen.readings, poses=seen.poses[:, :3])
        for model, rows in ((one, positions), (six, seen)):
            calibrated = pincal.calibrate(model, rows, noise=noise, folds=0).identified
            found = pincal.forward(calibrated, plan.readings[SEEN:]).poses
            modelled = Rotation.from_matrix(calibrated.platform.matrices(found)[:, :3, :3])
            turn = (turns * modelled.inv()).as_rotvec()
            result[model.name, name] = misses(true[:, :3] - found[:, :3], turn)
    return result


def lines(machines: int) -> list[str]:
    """Return the table."""
    rows = list(HEAD)
    for error in ERRORS:
        squares = [left(error, seed) for seed in range(machines)]
        for key in (
            ("delta", "none"),
            ("delta", "of a tracker"),
            ("six_rod_delta", "of a tracker"),
        ):
            origin, tool, tilt = 1e3 * np.sqrt(np.mean([s[key] for s in squares], axis=(0, 1)))
            rows.append(
                f"| {1e3 * error:g} | {' | '.join(key)} | {origin:.2g} | {tool:.2g} | {tilt:.2g} |"
            )
    return rows


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--machines", type=int, default=20)
    parser.add_argument("--write", action="store_true", help="into docs/tables")
    options = parser.parse_args()
    table = lines(options.machines)
    print("\n".join(table))
    if options.write:
        write_table("delta_rods", table)
