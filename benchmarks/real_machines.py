"""Real machines by the default options: rows not used, beside least squares of equal weights.

    python benchmarks/real_machines.py [--splits 10] [--only irb120 …]

Sets of measurements are looked for where ``PINCAL_DATA`` says, or beside the project. 70 % of the
rows are fitted; a line has root mean square distances of the targets at the others [mm], by least
squares (which SciPy's of all displacements equals), by default, and with terms of gravity (by
measured torques, masses of links, or 10 kg at the end where none is known); how many of the default
fits converged, how large the error of the platform is promised over what its targets miss by (root
mean squares of all splits), and the longest processor time of a default fit [s].
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
import motoman
from arms import loaded

import pincal
from pincal.design.platform_error import root_mean_squares

Set = tuple[pincal.Mechanism, pincal.Measurements, pincal.Setup]
PAYLOAD = pincal.Load(10.0, (0.0, 0.0, 0.1))
LEAST_SQUARES = pincal.Noise(5e-5, 5e-4, 0.0)
FRAME = pincal.Setup(unknown_frame=True)


def arm(folder: str, urdf: str, tip: str, table: str, setup: str | None) -> Set:
    """Return a set of an arm's URDF, measurements and setup."""
    source = motoman.DATA / folder
    machine = pincal.Mechanism.from_urdf(source / urdf, tip) if urdf else loaded(tip)
    how = (
        pincal.Setup.from_yaml(source / setup)
        if setup
        else pincal.Setup(unknown_frame=True, targets={"platform": pincal.Target(unknown=True)})
    )
    data = pincal.Measurements.from_csv(source / table, machine, how, partial=True)
    return machine, data, how


def positions(name: str) -> Set:
    """Return a set of poses as one of positions alone."""
    machine, data, how = SETS[name]()
    poses = data.poses.copy()
    poses[:, 3:] = np.nan
    return machine, replace(data, poses=poses), how


SETS: dict[str, Callable[[], Set]] = {
    "motoman_left": lambda: (motoman.mechanism("left"), motoman.measurements("left"), FRAME),
    "motoman_right": lambda: (motoman.mechanism("right"), motoman.measurements("right"), FRAME),
    "irb120_60": lambda: arm("irb120_60", "irb.urdf", "tool0", "ice60.csv", "ice.yaml"),
    "iiwa7": lambda: arm("iiwa7", "iiwa.urdf", "flange", "iiwaL.csv", None),
    "iiwa7_positions": lambda: positions("iiwa7"),
    "tiago": lambda: arm("tiago", "", "tiago", "tiago.csv", "tiago.yaml"),
}


def missed(result: pincal.CalibrationResult, rows: pincal.Measurements) -> float:
    """Return the root mean square distance by which targets are missed at rows, [m]."""
    outside, squares = result.outside, []
    if outside is None:
        raise TypeError("the frame was known")
    measured = {name: rows.influences.get(name, np.nan) for name in result.identified.influences}
    poses = pincal.forward(result.identified, rows.readings, influences=measured).poses
    matrices = outside.frame @ result.identified.platform.matrices(poses)
    for name, offset in zip(result.options.setup.targets, outside.offsets, strict=True):
        columns = [f"{name}_{axis}" for axis in "xyz"]
        where = rows.poses[:, :3]
        if columns[0] in rows.extra:
            where = np.column_stack([rows.extra[column] for column in columns])
        squares.append((matrices[:, :3, :3] @ offset + matrices[:, :3, 3] - where) ** 2)
    return float(np.sqrt(np.nanmean(np.concatenate(squares).sum(axis=1))))


def line(name: str, splits: int) -> str:
    """Return the line of a set."""
    machine, data, setup = SETS[name]()
    weighing = machine if machine.weighs or data.influences else replace(machine, load=PAYLOAD)
    found, promised, seconds, converged = [], [], [], 0
    for seed in range(splits):
        order = np.random.default_rng(seed).permutation(len(data))
        fit, others = np.split(order, [int(0.7 * len(data))])
        seen, verification = data.rows(np.sort(fit)), data.rows(np.sort(others))
        even = pincal.calibrate(machine, seen, setup=setup, noise=LEAST_SQUARES)
        begun = time.process_time()
        result = pincal.calibrate(machine, seen, setup=setup)
        seconds.append(time.process_time() - begun)
        converged += result.converged
        sagging = pincal.calibrate(weighing, seen, setup=setup, terms="gravity")
        found.append([missed(fit, verification) for fit in (even, result, sagging)])
        poses = pincal.forward(result.identified, verification.readings).poses
        expected = result.expected_error(pincal.Plan(poses, readings=verification.readings))
        promised.append(root_mean_squares(expected.sizes)[0])
    held_out = 1e3 * np.sqrt(np.mean(np.square(found), axis=0))
    over_seen = 1e3 * np.sqrt(np.mean(np.square(promised))) / held_out[1]
    numbers = " | ".join(f"{distance:.4f}" for distance in held_out)
    numbers += f" | {converged} of {splits}"
    return f"| {name} | {numbers} | {over_seen:.2f} | {max(seconds):.1f} |"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--splits", type=int, default=10)
    parser.add_argument("--only", nargs="*", default=list(SETS))
    given = parser.parse_args()
    heads = "least squares | default | with gravity | converged | promised over seen | longest"
    print(f"| set | {heads} |\n|---|---|---|---|---|---|---|")
    for name in given.only:
        if (motoman.DATA / name.removesuffix("_positions")).is_dir():
            print(line(name, given.splits), flush=True)


if __name__ == "__main__":
    main()
