"""Promises kept, withdrawn and broken where something is wrong: ten errors of three machines.

    python benchmarks/broken_promises.py [--sets 20] [--only 3RRR …] [--errors nothing …]
        [--middle] [--write]

Closed forms of 5R, 3-RRR and 6-UPS in NumPy make the data and say how far the platform is off
(tests/cramer_rao.py): 60 poses, noise of 20 µm, 50 µrad, readings 20 µrad or 20 µm, which is given,
or not. Errors of the 6-UPS are 0.3 m long for each radian. A promise is of 150 other poses, as far
as these lie in the measured region; beyond it none is made. Lines have, noise given and not: how
often a limit is promised; how often one is promised and broken, and by more than a fifth; how often
95 % intervals hold the parameters. ``--middle`` measures 60 poses of the middle of the workspace
alone. ``--write`` puts the table into docs/tables.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
import correlated
from cramer_rao import KINDS, Machine, drawn, machine, off, values_of
from pages import write_table

import pincal

Array = NDArray[np.float64]
Error = Callable[[Machine], Array]
NOISE = pincal.Noise(2e-5, 5e-5, 2e-5)
SCALE = 3e-4
PER_RADIAN = 0.3  # [m] of a strut


def readings_of(one: Machine) -> Array:
    """Return the readings of a machine without other errors, in radians, shape (N, n_legs)."""
    values = one.readings(one.parameters, np.zeros((len(one.positions), one.dof)))
    return values / PER_RADIAN if one.kind == "6UPS" else values


def wave(periods: float, *, phased: bool = False) -> Error:
    """Return an eccentric gear's error: so many periods a turn, each motor at its phase or none."""
    return lambda one: np.sin(
        periods * readings_of(one) + 2.0 * phased * np.arange(len(one.nominal.legs))
    )


def in_time(one: Machine) -> Array:
    """Return how late each row was measured, from -1 to 1, for every reading."""
    return np.linspace(-1.0, 1.0, len(one.positions))[:, None] * np.ones(len(one.nominal.legs))


def growth(one: Machine) -> Array:
    """Return what lengths that grow in the course of the run change of readings."""
    lengths = np.array([p.unit == "m" for p in one.nominal.parameters])
    still = np.zeros((len(one.positions), one.dof))
    ends = [one.readings(one.parameters * (1.0 + s * lengths), still) for s in (1.0, 0.0)]
    change = (ends[0] - ends[1]) / (PER_RADIAN if one.kind == "6UPS" else 1.0)
    return 0.5 * in_time(one) * change


def sag(one: Machine) -> Array:
    """Return readings that follow where the platform is across."""
    across = one.positions[:, :1] - one.positions[:, :1].mean()
    return across / np.abs(across).max() * np.ones(len(one.nominal.legs))


def play(one: Machine) -> Array:
    """Return the sides from which readings came to their values."""
    return np.sign(np.diff(readings_of(one), axis=0, prepend=0.0))


ERRORS: dict[str, tuple[Error, float, bool]] = {
    "nothing": (sag, 0.0, True),
    "harmonics of 0.2 mrad, three a turn": (wave(3.0), 2e-4, True),
    "harmonics of 0.2 mrad, two a turn, phased": (wave(2.0, phased=True), 2e-4, True),
    "links that give way by 0.1 mrad": (lambda one: np.cos(2.0 * readings_of(one)), 1e-4, True),
    "sag of 0.2 mrad across": (sag, 2e-4, True),
    "clearance of ± 0.1 mrad": (lambda one: np.sign(np.sin(2.0 * readings_of(one))), 1e-4, True),
    "counts of 0.5 mrad": (lambda one: (readings_of(one) / 5e-4 + 0.5) % 1.0 - 0.5, 5e-4, False),
    "play of ± 0.2 mrad": (play, 2e-4, False),
    "drift of ± 0.3 mrad": (in_time, 3e-4, False),
    "lengths that grow by 0.05 %": (growth, 5e-4, False),
    "instrument scale of 300 µm/m": (sag, 0.0, True),
}
"""Errors of readings, [rad], their sizes, and whether they stay when the machine is used."""


def elsewhere(one: Machine, seed: int = 7) -> Machine:
    """Return a machine at 150 other poses of its workspace."""
    platform = one.nominal.platform
    matrices = platform.matrices(pincal.sample_workspace(one.nominal, 150, seed))
    rotations = Rotation.from_matrix(matrices[:, :3, :3])
    moved = replace(one, positions=matrices[:, : platform.space, 3], rotations=rotations)
    known = np.isfinite(readings_of(moved)).all(axis=1)
    return replace(moved, positions=moved.positions[known], rotations=rotations[known])


def line(one: Machine, name: str, sets: int) -> str:
    """Return the line of an error."""
    error, size, stays = ERRORS[name]
    size *= PER_RADIAN if one.kind == "6UPS" else 1.0
    where, cells = elsewhere(one), []
    poses = where.coordinates(np.zeros((len(where.positions), one.dof)))
    more = size * error(where) if stays else np.zeros((len(poses), 1))
    for noise in (NOISE, None):
        rows = []
        for seed in range(sets):
            data = drawn(one, NOISE, seed, size * error(one))
            if "scale" in name:
                draw = np.random.default_rng([seed, 1]).standard_normal()
                data = correlated.scaled(data, SCALE * draw)
            result = pincal.calibrate(one.nominal, data, noise=noise)
            values, _, low, high = values_of(result)
            inside = result.expected_error(poses).within
            limit = result.expected_error(poses[inside]).limit[0]
            missed = np.sqrt((off(where, values, more)[inside] ** 2).mean())
            cover = ((low <= one.parameters) & (one.parameters <= high)).mean()
            rows.append((np.isfinite(limit), missed > limit, missed > 1.2 * limit, cover))
        cells.append([f"{100 * share:.0f}" for share in np.mean(rows, axis=0)])
    shares = " | ".join(", ".join(pair) for pair in zip(*cells, strict=True))
    return f"| {one.kind} | {name} | {shares} |"


HEAD = (
    "| machine | error | limit promised [%] | promises broken [%] | by more than a fifth [%] "
    "| intervals cover [%] |\n|---|---|---|---|---|---|"
)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sets", type=int, default=20)
    parser.add_argument("--only", nargs="*", choices=KINDS, default=list(KINDS))
    parser.add_argument("--errors", nargs="*", choices=ERRORS, default=list(ERRORS))
    parser.add_argument("--middle", action="store_true")
    parser.add_argument("--write", action="store_true", help="into docs/tables")
    given = parser.parse_args()
    lines = [HEAD]
    print(HEAD)
    for kind in given.only:
        one = machine(kind, 480 if given.middle else 60)
        away = np.linalg.norm(one.positions - np.median(one.positions, axis=0), axis=1)
        rows = np.sort(np.argsort(away)[:60])
        one = replace(one, positions=one.positions[rows], rotations=one.rotations[rows])
        for name in given.errors:
            lines.append(line(one, name, given.sets))
            print(lines[-1], flush=True)
    if given.write:
        write_table("broken_promises", lines)


if __name__ == "__main__":
    main()
