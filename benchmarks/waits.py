"""What people wait for, by an older pincal and by this one, in turn in one run.

    python benchmarks/waits.py OLD_TREE [--rounds 3] [--write docs/waits.md]

Tasks are those of ``pincal bench`` (pincal/cli/waits.py), run in processes of their own as a user
starts them: no number of threads is set. Medians of the rounds.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import numpy as np

HERE = Path(__file__).parents[1]
FILE = HERE / "pincal" / "cli" / "waits.py"
#: How many times as fast as 0.1.0 each task was to be.
ASKED = {
    **{f"select-{name}-3RRR": 10.0 for name in ("symmetric", "independent", "orbits", "common")},
    **{f"select-{name}-6UPS": 10.0 for name in ("symmetric", "independent", "orbits")},
    "select-common-6UPS": 15.0,
    "sample-6UPS": 5.0,
    "calibrate-all-legs-6UPS": 3.0,
    "command-calibrate": 3.0,
    "command-help": 4.0,
}


def timed(tree: Path) -> dict[str, dict[str, object]]:
    """Return what each task took by the pincal of a tree."""
    environment = {**os.environ, "PYTHONPATH": str(tree)}
    run = subprocess.run(
        [sys.executable, "-P", str(FILE)],
        cwd=tree,
        env=environment,
        check=True,
        stdout=subprocess.PIPE,
        text=True,
    )
    found = [json.loads(line) for line in run.stdout.splitlines() if line.startswith("{")]
    return {one["name"]: one for one in found}


def page(old: list[dict[str, dict[str, object]]], new: list[dict[str, dict[str, object]]]) -> str:
    """Return the page of what was measured."""

    def middle(rounds: list[dict[str, dict[str, object]]], name: str, key: str) -> float | None:
        values = [one[name][key] for one in rounds]
        return None if values[0] is None else float(np.median(np.array(values, dtype=float)))

    packages = ", ".join(f"{name} {version(name)}" for name in ("pin", "numpy", "scipy"))
    lines = [
        "# What people wait for",
        "",
        "Written by `python benchmarks/waits.py OLD_TREE --write docs/waits.md`; seconds, medians",
        f"of three runs in {len(new)} round(s) in turn, with defaults. `pincal bench` prints these",
        "tasks on your machine; like all commands it has one thread of BLAS. Asked are aims,",
        "how many times as fast as 0.1.0; not all are reached. A limit does the least of the work.",
        f"Python {platform.python_version()}, {packages}, {os.cpu_count()} cores, "
        f"{platform.machine()}.",
        "",
        "| what | 0.1.0 | now | times as fast | asked | limit | now over it | what the limit is |",
        "|---|---:|---:|---:|---:|---:|---:|---|",
    ]
    for name, one in new[0].items():
        then, now = middle(old, name, "seconds"), middle(new, name, "seconds")
        assert then is not None
        assert now is not None
        least = middle(new, name, "least")
        limit = ("", "") if least is None else (f"{least:.3g}", f"{now / least:.3g}")
        asked = f"{ASKED[name]:g}" if name in ASKED else ""
        lines.append(
            f"| {one['what']} | {then:.3g} | {now:.3g} | {then / now:.3g} | {asked} | "
            f"{limit[0]} | {limit[1]} | {one['limit']} |"
        )
    return "\n".join(lines) + "\n"


def main() -> None:
    """Run and print."""
    words = argparse.ArgumentParser(description=__doc__)
    words.add_argument("old", type=Path)
    words.add_argument("--rounds", type=int, default=3)
    words.add_argument("--write", type=Path)
    given = words.parse_args()
    old, new = [], []
    for _ in range(given.rounds):
        old.append(timed(given.old.resolve()))
        new.append(timed(HERE))
    text = page(old, new)
    print(text)
    if given.write:
        given.write.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
