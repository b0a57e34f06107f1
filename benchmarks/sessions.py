"""Sessions of ``pincal measure`` on simulated machines: what they promise, and what they save.

Each machine is disturbed anew, and measured with known noise until the session says "enough": which
poses it took against a plan made beforehand, whether the true error is below what was promised,
which slips of ten σ were caught when they came, how often a sound row was called off, and the
number of further poses that was forecast after each row over the number that it took.

    python benchmarks/sessions.py [MACHINES] [KIND …]

writes ``docs/tables/sessions.csv``. Slips are in sessions only; with ``--sound`` there are none,
and poses are printed. ``--kills N`` kills a session N times at random instead.
"""

from __future__ import annotations

import csv
import os
import random
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

import pincal
from pincal.blas import one_thread
from pincal.calibration.promise import seen_by
from pincal.calibration.session import Session, SessionOptions
from pincal.design.platform_error import root_mean_squares, seen_of, sizes
from pincal.design.simulate import platform_errors
from pincal.files.journal import Journal

ROOT = Path(__file__).parents[1]
TABLE = ROOT / "docs" / "tables" / "sessions.csv"
sys.path.insert(0, str(ROOT / "tests"))
from arms import loaded  # noqa: E402
from bench import NOISE, Bench  # noqa: E402

CANDIDATES, PLANNED = 300, 60  # poses to choose from; of the plan made beforehand, at most
SLIP, SHARE = 10.0, 0.25  # standard deviations; share of rows that slip on their first try


@dataclass(frozen=True)
class Kind:
    """A machine, what is measured of it, and what is enough."""

    mechanism: pincal.Mechanism
    accuracy: float
    setup: pincal.Setup = field(default_factory=pincal.Setup)
    measured: tuple[str, ...] | None = None


def kinds() -> dict[str, Kind]:
    """Return the kinds of machines."""
    unknown = pincal.Setup(unknown_frame=True)
    return {
        "3-RRR": Kind(pincal.load_mechanism("3RRR"), 4e-5),
        "6-UPS": Kind(pincal.load_mechanism("6UPS"), 8e-5),
        "UR5, position, unknown frame": Kind(loaded("ur5"), 5e-5, unknown, ("x", "y", "z")),
    }


def held(
    kind: Kind,
    bench: Bench,
    folder: Path,
    rng: np.random.Generator,
    slips: float,
    *,
    in_order: bool,
) -> dict[str, Any]:
    """Hold a session to its end; return counts, and whether its promise was kept."""
    options = SessionOptions(
        noise=NOISE,
        setup=kind.setup,
        measured=kind.measured,
        accuracy=kind.accuracy,
    )
    session = Session(Journal(folder), kind.mechanism, bench.plan, options)
    counts = dict.fromkeys(("slips", "caught", "later", "sound", "alarms", "blamed"), 0)
    slipped, trusted, forecast = set[int](), set[int](), list[tuple[int, int]]()
    while not session.enough and len(session.measured) < len(bench.plan):
        row = len(session.measured) if in_order else session.next_pose()[0]
        cells = bench.entry(session.columns, row)
        determined = session.error is not None and np.isfinite(session.error.position)
        if not in_order and determined and rng.random() < slips:
            head = str(rng.choice(session.observed))
            sigma = 0.02 if "mm" in head else float(np.degrees(2e-5))
            wrong = float(cells[head]) + SLIP * sigma * (1 if rng.random() < 0.5 else -1)
            counts["slips"] += 1
            if session.add({**cells, head: repr(wrong)}, row).off:
                counts["caught"] += 1
                session.undo()
            else:
                slipped.add(row)
        if row not in slipped:
            checked = session.add(cells, row)
            counts["sound"] += checked.sigma is not None
            if checked.off:  # measured again, it is as before
                counts["blamed" if slipped else "alarms"] += 1
                session.keep()
        while session.doubtful and session.measured[session.doubtful[0]] not in trusted:
            doubted = session.measured[session.doubtful[0]]
            if doubted in slipped:
                slipped.remove(doubted)
                counts["later"] += 1
            else:
                trusted.add(doubted)
                counts["blamed" if slipped else "alarms"] += 1
            session.undo(session.doubtful[0])
            session.add(bench.entry(session.columns, doubted), doubted)
            if session.questioned:
                session.keep()
        if not in_order and session.missing and not session.contradicted:
            forecast.append((len(session.measured), session.missing))
    session.journal.close()
    result = pincal.calibrate(
        kind.mechanism, session.journal.path, noise=NOISE, setup=session.options.setup
    )
    workspace = session.candidates.workspace
    error = result.expected_error(workspace)
    inside = workspace.rows(error.within)
    twists = platform_errors(result.identified, bench.truth, inside)[:, :, None]
    unseen, units = seen_of(kind.mechanism, inside.poses, twists, seen_by(result))
    true = root_mean_squares(sizes(units, unseen[:, :, 0]))[0]
    limit = session.error.limit[0] if session.error is not None else np.inf
    return counts | {
        "poses": len(session.measured),
        "forecast": [more / (len(session.measured) - n) for n, more in forecast if session.enough],
        "enough": session.enough,
        "kept": bool(true <= kind.accuracy),
        "within": bool(true <= limit),
        "missed": len(slipped),
        "true": true,
        "share": session.share,
    }


def measured(count: int, names: list[str], slips: float) -> None:
    """Hold sessions, and bring the rows of their kinds in the table up to date after each."""
    for name, kind in kinds().items():
        if names and name not in names:
            continue
        candidates = pincal.sample_configurations(kind.mechanism, CANDIDATES, 5)
        known: dict[str, Any] = {"measured": kind.measured, "setup": kind.setup, "noise": NOISE}
        plan = pincal.select_configurations(kind.mechanism, candidates, PLANNED, **known).plan
        plan = plan.rows(np.random.default_rng(0).permutation(len(plan)))
        sessions, fixed = [], []
        for seed in range(count):
            rng = np.random.default_rng(seed)
            bench = Bench(kind.mechanism, candidates, kind.setup, seed)
            beforehand = Bench(kind.mechanism, plan, kind.setup, seed)
            with tempfile.TemporaryDirectory() as folder:
                sessions.append(held(kind, bench, Path(folder) / "a", rng, slips, in_order=False))
                fixed.append(held(kind, beforehand, Path(folder) / "b", rng, 0.0, in_order=True))
            print(name, seed, sessions[-1], fixed[-1], flush=True)
            if slips:
                write(name, kind, sessions, fixed)
        if not slips:
            print(name, *(np.median([one["poses"] for one in kept]) for kept in (sessions, fixed)))


def write(
    name: str, kind: Kind, sessions: list[dict[str, Any]], fixed: list[dict[str, Any]]
) -> None:
    """Write the row of a kind of machine into the table, in place of what it was."""
    ratios = [ratio for one in sessions for ratio in one["forecast"]] or [np.nan]
    low, median, high = np.quantile(ratios, (0.05, 0.5, 0.95))
    counted = sessions[0].keys() - {"forecast"}
    total = {key: sum(one[key] for one in sessions) for key in counted}
    row = {
        "machine": name,
        "machines": len(sessions),
        "enough [mm]": 1e3 * kind.accuracy,
        "reached": total["enough"],
        "kept": sum(one["kept"] for one in sessions if one["enough"]),
        "poses": float(np.median([one["poses"] for one in sessions])),
        "poses of a fixed plan": float(np.median([one["poses"] for one in fixed])),
        "slips": total["slips"],
        "caught on entry": total["caught"],
        "caught later": total["later"],
        "sound rows": total["sound"],
        "false alarms": total["alarms"],
        "blamed for others' slips": total["blamed"],
        "poses forecast over needed": f"{median:.2f}",
        "from 5 %": f"{low:.2f}",
        "to 95 %": f"{high:.2f}",
    }
    rows = {name: row}
    if TABLE.is_file():
        with TABLE.open(newline="") as file:
            rows = {old["machine"]: old for old in csv.DictReader(file)} | rows
    with TABLE.open("w", newline="") as file:
        writer = csv.DictWriter(file, row, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows.values())


WORKER = """
import sys
from pathlib import Path
sys.path.insert(0, sys.argv[2])
import pincal
from bench import NOISE, Bench
from pincal.calibration.session import Session, SessionOptions
from pincal.files.journal import Journal
mechanism = pincal.load_mechanism("5R")
bench = Bench(mechanism, pincal.sample_configurations(mechanism, 30, 3))
session = Session(Journal(Path(sys.argv[1])), mechanism, bench.plan, SessionOptions(noise=NOISE))
print("open", len(session.journal.rows), flush=True)
while True:
    row = session.next_pose()[0]
    session.add(bench.entry(session.columns, row), row)
    print("row", len(session.journal.rows), flush=True)
    if len(session.journal.rows) % 7 == 0:
        session.undo()
        print("row", len(session.journal.rows), flush=True)
"""


def killed(times: int) -> None:
    """Kill a session at random moments; every row that it said is there must be there again."""
    lost = shown = 0
    with tempfile.TemporaryDirectory() as folder:
        for _ in range(times):
            worker = subprocess.Popen(
                [sys.executable, "-c", WORKER, f"{folder}/s", str(ROOT / "tests")],
                stdout=subprocess.PIPE,
                text=True,
            )
            assert worker.stdout is not None
            opened = int(worker.stdout.readline().split()[1])
            lost += max(0, shown - 1 - opened)  # a row may be on its way back
            time.sleep(random.random() * 2.0)
            os.kill(worker.pid, 9)
            lines = worker.stdout.read().splitlines()
            shown = int(lines[-1].split()[1]) if lines else opened
            worker.wait()
    print(f"killed {times} times: {lost} rows lost")


@one_thread()
def main(arguments: list[str]) -> None:
    if arguments[:1] == ["--kills"]:
        killed(int(arguments[1]))
        return
    slips, arguments = (0.0, arguments[1:]) if "--sound" in arguments[:1] else (SHARE, arguments)
    measured(int(arguments[0]) if arguments else 50, arguments[1:], slips)


if __name__ == "__main__":
    main(sys.argv[1:])
