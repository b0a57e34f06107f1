"""What tolerances are worth: promises in unknown frames, and rows held out after few.

    python benchmarks/tolerances.py [--sets 100] [--only left …] [--framed 3RRR …]

Machines are drawn 0.5 mm, 2 mrad and 0.001 (of gains) around their drawing, and seen in an unknown
frame at 24 poses with noise of 100 µm, 100 µrad and 20 µrad: the error expected of what is measured
at 40 other poses, over the true one, root mean square of sets and median. Of the real arms (where
``PINCAL_DATA`` is): root mean square of rows not used, of few rows at random, with free parameters
and with tolerances.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
import motoman
import real_machines
from arms import ARMS, loaded

import pincal
from pincal.design.platform_error import root_mean_squares

SIZES = {"m": 5e-4, "rad": 2e-3, "1": 1e-3}
NOISE = pincal.Noise(1e-4, 1e-4, 2e-5)
TRACKER = pincal.Noise(5e-5, 1e-4, 0.0)
ROUGHLY = {"m": 5e-4, "rad": 5e-3}
POSES, DRAWS = 24, 10
ROWS = (12, 16, 23, 40, 100)


def framed(name: str, sets: int) -> str:
    """Return a line of machines drawn at random and seen in an unknown frame."""
    drawing = loaded(name) if name in ARMS else pincal.load_mechanism(name)
    platform = drawing.platform
    sizes = {p.id: SIZES[p.unit] for p in drawing.parameters}
    squares = []
    for seed in range(sets):
        draw = np.random.default_rng(seed)
        truth = pincal.disturb(drawing, sizes, draw)
        frame, turn = np.eye(4), 0.5 * draw.standard_normal(3)
        frame[: platform.space, 3] = draw.standard_normal(platform.space)
        turn[:2] *= platform.space == 3
        frame[:3, :3] = Rotation.from_rotvec(turn).as_matrix()
        plan = pincal.sample_configurations(drawing, POSES + 40, seed=seed)
        data = pincal.simulate(drawing, truth, plan, NOISE, seed=seed).measurements
        seen, held_out = data.rows(np.arange(POSES)), data.rows(np.arange(POSES, len(data)))
        seen = replace(seen, poses=platform.from_matrices(frame @ platform.matrices(seen.poses)))
        result = pincal.calibrate(
            drawing,
            seen,
            noise=NOISE,
            tolerance=SIZES,
            setup=pincal.Setup(unknown_frame=True),
        )
        true, poses = (
            pincal.forward(machine, held_out.readings, held_out.poses).poses
            for machine in (truth, result.identified)
        )
        off = result.outside.frame @ platform.matrices(poses) - frame @ platform.matrices(true)
        plan = pincal.Plan(poses, readings=held_out.readings if drawing.by_readings else None)
        expected = root_mean_squares(result.expected_error(plan).sizes)[0]
        squares.append((expected**2, (off[:, :3, 3] ** 2).sum(axis=1).mean()))
    promised, true = np.transpose(squares)
    ratio = np.sqrt(promised.mean() / true.mean())
    median = np.median(np.sqrt(promised / true))
    return f"| {name}, unknown frame | {ratio:.2f}, {median:.2f} | {sets} |"


def missed(side: str, count: int, seed: int, tolerance: object) -> float:
    """Return by how much rows not used are missed, root mean square, [m]; NaN if refused."""
    data = motoman.measurements(side)
    order = np.random.default_rng(seed).permutation(len(data))
    held_out = data.rows(order[count:])
    try:
        result = pincal.calibrate(
            motoman.mechanism(side),
            data.rows(order[:count]),
            noise=TRACKER,
            setup=pincal.Setup(unknown_frame=True),
            rough=True,
            tolerance=tolerance,
        )
    except pincal.ObservabilityError:
        return np.nan
    return real_machines.missed(result, held_out)


def said(errors: list[float]) -> str:
    """Return the median of errors in mm, and how many draws were refused."""
    lost = int(np.isnan(errors).sum())
    return f"{1e3 * np.nanmedian(errors):.3f}" + f", {lost} refused" * bool(lost)


def main() -> None:
    """Print the lines."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sets", type=int, default=100)
    parser.add_argument("--only", nargs="*", default=motoman.SIDES)
    parser.add_argument("--framed", nargs="*", default=["3RRR", "6UPS", "delta", "ur5"])
    given = parser.parse_args()
    for name in given.framed:
        print(framed(name, given.sets), flush=True)
    for name in given.only:
        for count in ROWS if motoman.data_file(name).is_file() else ():
            cells = [
                said([missed(name, count, seed, how) for seed in range(DRAWS)])
                for how in ({}, ROUGHLY)
            ]
            print(f"| {name}, {count} rows | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
