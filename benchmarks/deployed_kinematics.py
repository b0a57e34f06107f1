"""How far deployed kinematics are from pincal's, and their time a pose.

``python -m benchmarks.deployed_kinematics`` writes docs/tables/deployed_kinematics.csv. Least
processor time of two runs over all poses, calls from Python into C included.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

import pincal
from benchmarks.pages import write_table
from pincal.files.mechanism_folders import bundled
from pincal.formats.deployed import Deployed

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from arms import loaded
from deployed import in_c, in_python
from test_deformations import machine_of

POSES, RUNS = 200, 2


def machines() -> Iterator[tuple[str, pincal.Mechanism]]:
    """Yield the bundled mechanisms and arms, off by 1 mm and mrad, one with terms of its loads."""
    for name in bundled():
        yield name, pincal.disturb(pincal.load_mechanism(name), 1e-3, seed=1)
    for name in ("ur5", "panda"):
        yield name, pincal.disturb(loaded(name), 1e-3, seed=1)
    yield "ur5, bending by gravity", machine_of("ur5", "load")[1]


def row(name: str, machine: pincal.Mechanism, folder: Path) -> str:
    """Return the table's row of a machine: of an arm, readings are compared by their poses."""
    plan = pincal.sample_configurations(machine, POSES, seed=3)
    matrices = machine.platform.matrices(plan.poses)[:, :3].reshape(-1, 12)
    arm = machine.by_readings
    readings = plan.readings if arm else pincal.inverse(machine, plan.poses).readings
    deployed, largest, cells = Deployed(machine), 0.0, []
    for inverse, forward in (in_c(deployed, folder), in_python(deployed)):
        solved = [inverse(T, None, None) for T in matrices]
        known = np.array([reached for *_, reached in solved])
        values = np.array([values for values, *_ in solved])[known]
        back = [forward(reading, None) for reading in readings]
        assert all(reached for *_, reached in back)
        assert known.mean() >= (0.99 if arm else 1.0)
        missed = misses(machine, values, plan.poses[known]) if arm else values - readings
        returned = np.array([T for T, *_ in back]) - matrices
        largest = max(largest, float(np.abs(missed).max()), float(np.abs(returned).max()))
        cells += [
            microseconds(inverse, matrices, None, None),
            microseconds(forward, readings, None),
        ]
    return f"| {name} | {largest:.0e} | {' | '.join(cells)} |"


def misses(machine: pincal.Mechanism, readings: np.ndarray, poses: np.ndarray) -> np.ndarray:
    """Return by what matrices of poses differ from those that pincal computes of readings."""
    there = pincal.forward(machine, readings).poses
    return machine.platform.matrices(there) - machine.platform.matrices(poses)


def microseconds(solve: Callable[..., Any], rows: np.ndarray, *others: None) -> str:
    """Return the time that solving takes a row, [µs], the least of some runs."""
    times = []
    for _ in range(RUNS):
        begun = time.process_time()
        for values in rows:
            solve(values, *others)
        times.append(time.process_time() - begun)
    return f"{1e6 * min(times) / len(rows):.0f}"


def table() -> Iterator[str]:
    """Yield the lines of the table."""
    columns = "C, inverse [µs] | C, forward | Python, inverse [µs] | Python, forward"
    yield f"| mechanism | largest difference [m], [rad] | {columns} |"
    yield "|---|---|---|---|---|---|"
    for name, machine in machines():
        with TemporaryDirectory() as folder:
            yield row(name, machine, Path(folder))


if __name__ == "__main__":
    write_table("deployed_kinematics", table())
