"""How far deployed kinematics are from pincal's, and their time a pose.

``python -m benchmarks.deployed_kinematics`` writes the table of docs/commanding.md. Least time of
five runs over all poses, calls from Python into C included.
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
from deployed import in_c, in_python

POSES, RUNS = 200, 5


def row(name: str, folder: Path) -> str:
    """Return the table's row of a bundled mechanism, off by 1 mm and mrad."""
    machine = pincal.disturb(pincal.load_mechanism(name), 1e-3, seed=1)
    plan = pincal.sample_configurations(machine, POSES, seed=3)
    matrices = machine.platform.matrices(plan.poses)[:, :3].reshape(-1, 12)
    readings = pincal.inverse(machine, plan.poses).readings
    deployed, largest, cells = Deployed(machine), 0.0, []
    for inverse, forward in (in_c(deployed, folder), in_python(deployed)):
        solved = [inverse(T, None, None) for T in matrices]
        back = [forward(reading, None) for reading in readings]
        assert all(reached for *_, reached in (*solved, *back))
        for (values, *_), wanted in zip((*solved, *back), (*readings, *matrices), strict=True):
            largest = max(largest, float(np.abs(np.subtract(values, wanted)).max()))
        cells += [
            microseconds(inverse, matrices, None, None),
            microseconds(forward, readings, None),
        ]
    return f"| {name} | {largest:.0e} | {' | '.join(cells)} |"


def microseconds(solve: Callable[..., Any], rows: np.ndarray, *others: None) -> str:
    """Return the time that solving takes a row, [µs], the least of some runs."""
    times = []
    for _ in range(RUNS):
        begun = time.perf_counter()
        for values in rows:
            solve(values, *others)
        times.append(time.perf_counter() - begun)
    return f"{1e6 * min(times) / len(rows):.0f}"


def table() -> Iterator[str]:
    """Yield the lines of the table."""
    columns = "C, inverse [µs] | C, forward | Python, inverse [µs] | Python, forward"
    yield f"| mechanism | largest difference [m], [rad] | {columns} |"
    yield "|---|---|---|---|---|---|"
    for name in bundled():
        with TemporaryDirectory() as folder:
            yield row(name, Path(folder))


if __name__ == "__main__":
    write_table("commanding.md", "deployed_kinematics.py", table())
