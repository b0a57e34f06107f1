"""Ratios, measured in one run: what symmetry, early exits and matrix products save.

The total orientation workspace of the 6-UPS at one height, legs of 1.6 to 2.6 m.
"""

from __future__ import annotations

import subprocess
import sys
from typing import Any

import numpy as np
import pytest
from conftest import in_turn
from numpy.typing import NDArray

import pincal
from pincal.workspace.region import BLOCK, PositionTest

Array = NDArray[np.float64]
NONE = pincal.Margins.none()
_MEMORY = """
import sys
import pincal
mechanism = pincal.load_mechanism("6UPS")
turns = pincal.Orientations.of(mechanism.platform, *eval(sys.argv[1]))
grid = pincal.Grid.of(*eval(sys.argv[2]))
pincal.compute_workspace(mechanism, sys.argv[3], grid, turns, pincal.Margins.none())
peak = next(line for line in open("/proc/self/status") if line.startswith("VmHWM"))
print(grid.size * len(turns), int(peak.split()[1]) / 1024)
"""
TILTS = ["azimuth [deg]=-175:180:5", "tilt=0:0.6:0.05", "torsion=-0.6:0.6:0.05"]


@pytest.fixture(scope="module")
def hexapod() -> pincal.Mechanism:
    return pincal.load_mechanism("6UPS")


def computed_everywhere(
    mechanism: pincal.Mechanism, grid: pincal.Grid, turns: pincal.Orientations
) -> Array:
    """Compute all positions of a total-orientation workspace, without symmetry."""
    test, size = PositionTest(mechanism, turns, True, NONE), max(1, BLOCK // len(turns))
    parts = np.split(np.arange(grid.size), range(size, grid.size, size))
    return np.concatenate([test(grid.at(part)) for part in parts])


def brute_force(mechanism: pincal.Mechanism, positions: Array, turns: Array) -> Array:
    """Compute all leg lengths of all poses in NumPy, a few positions at a time."""
    base = np.array([leg.joints[0].placement.xyz for leg in mechanism.legs])
    arms = np.einsum("oij,kj->oki", turns, [leg.point.placement.xyz for leg in mechanism.legs])
    inside = np.empty(len(positions), dtype=bool)
    for begin in range(0, len(positions), 4):
        part = slice(begin, begin + 4)
        lengths = np.linalg.norm(positions[part, None, None] + (arms - base), axis=-1)
        inside[part] = ((lengths >= 1.6) & (lengths <= 2.6)).all(axis=(1, 2))
    return inside


def test_symmetry_and_brute_force(benchmark: Any, ratios: Any, hexapod: pincal.Mechanism) -> None:
    grid = pincal.Grid.of("radius=0.01:1.5:0.02", "bearing [deg]=0:359.5:0.5", "z=1.8")
    turns = pincal.Orientations.of(hexapod.platform, *TILTS)
    arguments = (hexapod, "total-orientation", grid, turns, NONE)
    few = grid.at(np.arange(0, grid.size, 180))  # brute force at every 180th position
    matrices = turns.rotations.as_matrix()
    short, long, brute = in_turn(
        lambda: pincal.compute_workspace(*arguments),
        lambda: computed_everywhere(hexapod, grid, turns),
        lambda: brute_force(hexapod, few, matrices),
        runs=3,
    )
    brute *= grid.size / len(few)
    poses = grid.size * len(turns)
    where = f"total orientations, {poses:,} poses"
    ratios(f"{where}: without symmetry over with it", long / short, ">= 5")
    ratios(f"{where}: vectorised NumPy brute force over with symmetry", brute / short, ">= 4")
    ratios(f"{where}: vectorised NumPy brute force over without symmetry", brute / long, "")
    benchmark.extra_info["ratio"] = long / short
    benchmark.pedantic(lambda: pincal.compute_workspace(*arguments), rounds=1)


def test_cost_per_pose_is_flat(benchmark: Any, ratios: Any, hexapod: pincal.Mechanism) -> None:
    turns = pincal.Orientations.of(hexapod.platform, "tilt=0:0.6:0.1", "torsion=-0.6:0.6:0.1")
    grids = [
        pincal.Grid.of(f"x=-1.5:1.5:{step}", f"y=-1.5:1.5:{step}", "z=1.8") for step in (0.5, 0.05)
    ]
    times = in_turn(
        *(lambda grid=grid: computed_everywhere(hexapod, grid, turns) for grid in grids),
        runs=7,
    )
    sizes = [grid.size * len(turns) for grid in grids]
    ratio = (times[1] / sizes[1]) / (times[0] / sizes[0])
    ratios(f"cost per pose at {sizes[1]:,} over {sizes[0]:,} poses", ratio, "flat, or less")
    benchmark.extra_info["ratio"] = ratio
    benchmark.pedantic(lambda: None, rounds=1)


@pytest.mark.parametrize(
    ("kind", "turns", "axes"),
    [
        ("total-orientation", TILTS, ["x=-1.5:1.5:0.046", "y=-1.5:1.5:0.046", "z=1.8"]),
        ("constant-orientation", ["tilt=0"], [f"{n}=-3:3:0.0129" for n in "xyz"]),
    ],
)
def test_peak_memory(
    benchmark: Any, ratios: Any, kind: str, turns: list[str], axes: list[str]
) -> None:
    line = [sys.executable, "-c", _MEMORY, repr(turns), repr(axes), kind]
    poses, peak = subprocess.run(line, check=True, capture_output=True, text=True).stdout.split()
    ratios(f"peak memory of a process, {kind}, {int(poses):,} poses [MiB]", float(peak), "< 500")
    benchmark.extra_info["mib"] = float(peak)
    benchmark.pedantic(lambda: None, rounds=1)


def test_symmetric_against_independent_selection(
    benchmark: Any, ratios: Any, hexapod: pincal.Mechanism
) -> None:
    poses = pincal.sample_workspace(hexapod, 20_000, seed=0)
    symmetric, independent = in_turn(
        lambda: pincal.select_poses(hexapod, poses, 24, "symmetric"),
        lambda: pincal.select_poses(hexapod, poses, 24, "independent"),
        runs=5,
    )
    ratio = symmetric / independent
    ratios("symmetric over independent selection for six legs, 24 of 20,000 poses", ratio, "<= 0.2")
    benchmark.extra_info["ratio"] = ratio
    benchmark.pedantic(lambda: None, rounds=1)
