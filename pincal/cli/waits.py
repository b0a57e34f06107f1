"""What people wait for, timed: the tasks of ``pincal bench``.

They use the top of pincal alone, as an older one had it too (``benchmarks/waits.py`` runs this file
with both). Beside a task stands its limit where something else shows one: the least that its
answer needs, done in NumPy or by the part of pincal that does the work itself.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

import pincal

Array = NDArray[np.float64]
COUNT = 30_000  # candidates, and poses
_RUNS = 3  # of which the median counts, after one that warms up
_EXCHANGE = "one leg's poses of 20,000 candidates by exchange in bare NumPy"
PROTOCOLS = ("symmetric", "independent", "orbits", "common")
MACHINES = {"3RRR": "3-RRR", "6UPS": "6-UPS"}
NOISE = pincal.Noise(1e-4, 1e-4, 5e-5)


@dataclass(frozen=True)
class Task:
    """Something that people wait for."""

    name: str
    what: str
    run: Callable[[], object]
    limit: str = ""
    """What shows how quick it could be, in words; nothing if nothing does."""
    least: Callable[[], object] | None = None
    """Does that."""


@dataclass(frozen=True)
class Wait:
    """How long a task took."""

    name: str
    what: str
    seconds: float
    limit: str
    least: float | None
    """Of the limit, [s]."""


def tasks() -> Iterator[Task]:
    """Yield all tasks, the inputs made when they are asked for."""
    for name, said in MACHINES.items():
        for protocol in PROTOCOLS:
            yield Task(
                f"select-{protocol}-{name}",
                f"select 24 of {COUNT:,}, {said}, {protocol}",
                lambda name=name, protocol=protocol: pincal.select_poses(  # type: ignore[misc]
                    _machine(name), _poses(name), 24, protocol
                ),
                *(
                    (_EXCHANGE, lambda name=name: bare_exchange(_rows(name), 24))
                    if protocol in ("symmetric", "independent")
                    else ()
                ),
            )
    for name, said in MACHINES.items():
        yield Task(
            f"sample-{name}",
            f"sample_workspace, {COUNT:,} poses, {said}",
            lambda name=name: pincal.sample_workspace(_machine(name), COUNT, seed=1),  # type: ignore[misc]
            f"inverse kinematics of {COUNT:,} poses",
            lambda name=name: pincal.inverse(_machine(name), _poses(name)),  # type: ignore[misc]
        )
    yield Task(
        "jacobians-3RRR",
        f"identification Jacobians, 3-RRR, 3 legs x {COUNT:,}",
        lambda: [
            pincal.identification_jacobian(_machine("3RRR"), leg.name, _poses("3RRR"))
            for leg in _machine("3RRR").legs
        ],
    )
    yield Task(
        "margins-6RUS",
        "margins of 10,000 poses, 6-RUS",
        lambda: pincal.margins(_machine("6RUS"), _poses("6RUS")[:10_000]),
    )
    for method, said in {
        "per-leg": "each leg alone",
        "all-legs": "all legs, poses unknown",
    }.items():
        yield Task(
            f"calibrate-{method}-6UPS",
            f"calibrate 6-UPS, 144 rows, noise given, {said}",
            lambda method=method: pincal.calibrate(  # type: ignore[misc]
                _machine("6UPS"), _read("6UPS"), noise=NOISE, method=_method(method)
            ),
        )
    yield Task(
        "command-calibrate",
        "pincal calibrate 3-RRR, 72 rows, with its report",
        lambda: _command("calibrate", "3RRR", _table("3RRR"), "-o", _scratch() / "out", "--force"),
        "the fit alone",
        lambda: pincal.calibrate(_machine("3RRR"), _read("3RRR"), method=_method("all-legs")),
    )
    yield Task(
        "command-help",
        "pincal --help",
        lambda: _command("--help"),
        "Python and NumPy",
        lambda: subprocess.run([sys.executable, "-c", "import numpy"], check=True),
    )


def measure(task: Task, runs: int = _RUNS) -> Wait:
    """Return how long a task and its limit take: medians of runs in turn, after one of each."""
    times: list[list[float]] = [[], []]
    for run in range(runs + 1):
        for function, own in zip((task.run, task.least), times, strict=True):
            if function is not None:
                begin = perf_counter()
                function()
                if run:
                    own.append(perf_counter() - begin)
    least = float(np.median(times[1])) if times[1] else None
    return Wait(task.name, task.what, float(np.median(times[0])), task.limit, least)


def bare_exchange(rows: Array, count: int) -> list[int]:
    """Return places chosen by exchange: the best row added, the worst dropped.

    Of candidates with one row each, shape (M, n), by rank-one updates; the start takes what adds
    most, one after the other.
    """
    rows = rows / np.linalg.norm(rows, axis=0)
    n = rows.shape[1]
    inverse = np.eye(n) * 1e8
    chosen: list[int] = []
    free = np.ones(len(rows), dtype=bool)

    def update(row: Array, sign: float) -> None:
        nonlocal inverse
        along = inverse @ row
        inverse = inverse - np.outer(along, along) * (sign / (1.0 + sign * row @ along))

    def best() -> tuple[int, float]:
        gain = np.einsum("mn,mn->m", rows @ inverse, rows)
        gain[~free] = -np.inf
        place = int(gain.argmax())
        return place, float(gain[place])

    for _ in range(count):
        place, _ = best()
        chosen.append(place)
        free[place] = False
        update(rows[place], 1.0)
    for _ in range(200):
        place, gain = best()
        update(rows[place], 1.0)
        own = rows[chosen]
        loss = np.einsum("mn,mn->m", own @ inverse, own)
        out = int(loss.argmin())
        if (1.0 + gain) * (1.0 - loss[out]) <= 1.0 + 1e-9:
            update(rows[place], -1.0)
            break
        free[chosen[out]], free[place] = True, False
        update(own[out], -1.0)
        chosen[out] = place
    return chosen


def _new() -> bool:
    """Return whether this pincal takes names of mechanisms."""
    return hasattr(pincal, "load_result")


@cache
def _machine(name: str) -> Any:
    return pincal.load_mechanism(name)


@cache
def _poses(name: str) -> Array:
    return np.asarray(pincal.sample_workspace(_machine(name), COUNT, seed=0))


@cache
def _rows(name: str) -> Array:
    leg = _machine(name).legs[0].name
    rows = pincal.identification_jacobian(_machine(name), leg, _poses(name)[:20_000])
    return np.asarray(rows[np.isfinite(rows).all(axis=1)])


@cache
def _scratch() -> Path:
    folder = tempfile.TemporaryDirectory()
    _kept.append(folder)
    return Path(folder.name)


_kept: list[Any] = []  # folders, until the process ends


@cache
def _table(name: str) -> Path:
    """Return a table of measurements: 24 poses a leg, in a fixed order for every pincal."""
    machine, rng = _machine(name), np.random.default_rng(0)
    poses = _poses(name)[rng.permutation(COUNT)[: 24 * len(machine.legs)]]
    truth = pincal.disturb(machine, 2e-3, seed=1)
    plan = pincal.Plan(poses)
    data = pincal.simulate(machine, truth, plan, NOISE, seed=1).measurements
    path = _scratch() / f"{name}.csv"
    if hasattr(data, "to_csv"):
        data.to_csv(path, machine, force=True)
    else:
        getattr(pincal, "write_measurements")(path, machine, data)  # noqa: B009
    return path


@cache
def _read(name: str) -> Any:
    read = getattr(pincal.Measurements, "from_csv", None) or getattr(pincal, "read_measurements")  # noqa: B009
    return read(_table(name), _machine(name))


def _method(name: str) -> str:
    """Return how this pincal calls a method."""
    return name if _new() else {"all-legs": "latent"}.get(name, name)


def _command(*typed: object) -> None:
    run = [sys.executable, "-m", "pincal", *map(str, typed)]
    subprocess.run(run, check=True, capture_output=True)


def main(names: list[str]) -> None:
    """Print waits as JSON, a line each, of the tasks named, or of all."""
    for task in tasks():
        if not names or task.name in names:
            print(json.dumps(vars(measure(task))), flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
