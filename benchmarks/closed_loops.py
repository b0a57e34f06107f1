"""Machines with closed loops: made, or imported from URDF, URDF with its own loops, and MJCF.

    python benchmarks/closed_loops.py [--sets 20] [--only quattro …] [--write]
    python benchmarks/closed_loops.py --models example-parallel-robots/robots/*

A line says how a machine is read, its legs, drives and parameters, how far Pinocchio leaves its
ends apart at poses of readings [m, rad], how far the machine calibrated by noise-free data of
another one misses poses that it has not seen [m, 1], the mean square of standardised errors over
sets (1: at the Cramér-Rao bound), and the time of a calibration [s].
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
import neighbours
from command_line import done
from machines import MACHINES, configurations, pinocchio_gap, standardised
from pages import write_table

import pincal

HEAD = [
    "| machine | read from | legs | drives | parameters | Pinocchio's gap | "
    "held-out poses missed | χ² of errors | s |",
    "|---|---|---|---|---|---|---|---|---|",
]
CURVED = ("ankle",)
"""Machines whose rows leave single directions (the scale of the rods) open to a hundredth of the
size: errors along them bend the precise ones, of which covariances are to first order."""

FILES: dict[str, Callable[[Path], Path]] = {
    make.__name__: make
    for make in (
        neighbours.four_bar,
        neighbours.five_bar,
        neighbours.coupled_five_bar,
        neighbours.geared_five_bar,
        neighbours.six_rod_delta,
        neighbours.ankle,
        neighbours.hexapod,
    )
}


def machines(
    folder: Path, models: Sequence[Path]
) -> Iterator[tuple[str, str, Callable[[], pincal.Mechanism]]]:
    """Yield names, where machines are read from, and what makes them: of models, or of our own."""

    def imported(file: Path, target: Path) -> pincal.Mechanism:
        done("import", file, "-o", target)
        return pincal.load_mechanism(target)

    for model in models:
        yield model.name, "URDF, YAML", lambda m=model: imported(m / "robot.urdf", folder / m.name)
    if models:
        return
    for name, make in MACHINES.items():
        yield name, "its dimensions", make
    for name, write in FILES.items():
        file = write(folder / name)
        yield name, "URDF, YAML", lambda f=file, n=name: imported(f, folder / f"{n}_urdf")
    for name in MACHINES:
        if name != "agile_eye":  # its legs close turns alone, which MJCF has no equality for

            def through(name: str = name) -> pincal.Mechanism:
                MACHINES[name]().save(folder / f"{name}_made")
                done("export", folder / f"{name}_made", "-o", folder / f"{name}.xml")
                return imported(folder / f"{name}.xml", folder / f"{name}_mjcf")

            yield name, "MJCF", through


def missed(mechanism: pincal.Mechanism) -> tuple[float, float]:
    """Return how far a machine calibrated by exact data misses held-out poses, and the time [s]."""
    plan, exact = configurations(mechanism, 40), pincal.Noise(1e-7, 1e-7, 1e-7)
    truth, none = pincal.disturb(mechanism, 1e-4, seed=1), pincal.Noise(0.0, 0.0, 0.0)
    data = pincal.simulate(mechanism, truth, plan, none).measurements
    seen, verification = data.rows(slice(-8)), data.rows(slice(-8, None))
    start = time.perf_counter()
    identified = pincal.calibrate(mechanism, seen, noise=exact, folds=0).identified
    seconds = time.perf_counter() - start
    matrices = mechanism.platform.matrices
    under_driven = mechanism.constraints < mechanism.platform.dof
    near = verification.poses if under_driven else None
    found = matrices(pincal.forward(identified, verification.readings, near).poses)
    return float(np.abs(found - matrices(verification.poses)).max()), seconds


def row(name: str, source: str, mechanism: pincal.Mechanism, sets: int) -> str:
    """Return a line of the table."""
    plan = configurations(mechanism, 24)
    gap, (error, seconds) = pinocchio_gap(mechanism, plan), missed(mechanism)
    spread = f"{np.concatenate(standardised(mechanism, plan, sets)).mean():.2f}" if sets else ""
    counts = f"{len(mechanism.legs)} | {len(mechanism.reading_names)} | {len(mechanism.parameters)}"
    return f"| {name} | {source} | {counts} | {gap:.0e} | {error:.0e} | {spread} | {seconds:.1f} |"


def main() -> None:
    """Print the table, and write it where the documentation has it if asked."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sets", type=int, default=20)
    parser.add_argument("--only", nargs="*")
    parser.add_argument("--models", nargs="*", type=Path, default=[], metavar="FOLDER")
    parser.add_argument("--write", action="store_true")
    options, lines = parser.parse_args(), list(HEAD)
    print("\n".join(HEAD))
    with tempfile.TemporaryDirectory() as folder:
        for name, source, make in machines(Path(folder), options.models):
            if options.only and name not in options.only:
                continue
            try:
                compared = source == "its dimensions" and name not in CURVED
                line = row(name, source, make(), options.sets * compared)
            except (AssertionError, ValueError, pincal.PincalError) as error:
                line = f"| {name} | {source} | refused: {' '.join(str(error).split())[:160]} |"
            print(line, flush=True)
            lines.append(line)
    if options.write:
        write_table("closed_loops", lines)


if __name__ == "__main__":
    main()
