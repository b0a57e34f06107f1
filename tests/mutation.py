"""Which changes of the code would the tests see? A sample of mutants, with their survivors.

``python tests/mutation.py --sample 800 --seed 0`` draws mutants of the floors of calibration
evenly, lets mutmut (extra ``mutation``) try them, and prints a score for every floor; survivors and
their changes are written to ``mutants/survivors.txt``. To be quick, a mutant is tried by the tests
that know its function best, up to a budget of time: what survives is tried by all of them with
``--again``. docs/testing.md says how survivors were judged.
"""

from __future__ import annotations

import argparse
import json
import random
import subprocess
import sys
from collections import Counter
from pathlib import Path

MUTANTS = Path("mutants")
STATS = MUTANTS / "mutmut-stats.json"
WHOLE = MUTANTS / "all-tests.json"
FLOORS = ("kinematics", "symmetry", "estimation", "design", "calibration")
#: What exit codes of mutmut's workers mean; all others are time out and crashes.
OUTCOMES = {0: "survived", 1: "killed", 3: "killed", 5: "no test", 33: "no test"}


def mutmut(*arguments: str) -> str:
    """Run mutmut and return what it prints."""
    done = subprocess.run(
        [sys.executable, "-m", "mutmut", *arguments], text=True, stdout=subprocess.PIPE, check=True
    )
    return done.stdout


def outcomes(floor: str) -> dict[str, int | None]:
    """Return all mutants of a floor, with what their run came to."""
    found: dict[str, int | None] = {}
    for path in sorted((MUTANTS / "pincal" / floor).glob("*.meta")):
        found |= json.loads(path.read_text(encoding="utf-8"))["exit_code_by_key"]
    return found


def best_tests(budget: float) -> None:
    """Keep those tests of each function that run fewest other functions, up to a budget [s]."""
    if not WHOLE.exists():
        WHOLE.write_text(STATS.read_text(encoding="utf-8"), encoding="utf-8")
    stats = json.loads(WHOLE.read_text(encoding="utf-8"))
    seconds = stats["duration_by_test"]
    tests_of = stats["tests_by_mangled_function_name"]
    breadth = Counter(test for tests in tests_of.values() for test in tests)
    for function, tests in tests_of.items():
        kept, spent = [], 0.0
        for test in sorted(tests, key=lambda one: (breadth[one] * (0.1 + seconds[one]), one)):
            if kept and spent + seconds[test] > budget:
                continue
            kept.append(test)
            spent += seconds[test]
        tests_of[function] = kept
    STATS.write_text(json.dumps(stats), encoding="utf-8")


def main() -> None:
    """Try a sample of mutants, or its survivors again."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--sample", type=int, default=800, help="mutants, shared evenly")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--budget", type=float, default=15.0, help="of tests, s a mutant")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--again", action="store_true", help="survivors, by all their tests")
    given = parser.parse_args()
    jobs = ("--max-children", str(given.jobs))
    if not STATS.exists():
        mutmut("run", *jobs, "pincal.symmetry.elements.*x_wrapped*")  # makes all, tries few
    rng, drawn = random.Random(given.seed), MUTANTS / "drawn.json"
    if given.again:
        sample = json.loads(drawn.read_text(encoding="utf-8"))
        STATS.write_text(WHOLE.read_text(encoding="utf-8"), encoding="utf-8")
    else:
        share = given.sample // len(FLOORS)
        sample = {floor: rng.sample(sorted(outcomes(floor)), share) for floor in FLOORS}
        drawn.write_text(json.dumps(sample), encoding="utf-8")
        best_tests(given.budget)
    names = [name for floor in FLOORS for name in sample[floor]]
    if given.again:
        names = [n for floor in FLOORS for n in sample[floor] if outcomes(floor)[n] == 0]
    mutmut("run", *jobs, *names)
    lines = []
    for floor in FLOORS:
        codes = outcomes(floor)
        told = {name: OUTCOMES.get(codes[name] or 0, "stopped") for name in sample[floor]}
        print(f"{floor}: {len(codes)} mutants, of {len(told)}: {dict(Counter(told.values()))}")
        alive = [name for name, end in told.items() if end in ("survived", "no test")]
        lines += [f"{told[name]}: {mutmut('show', name)}" for name in alive]
    (MUTANTS / "survivors.txt").write_text("\n".join(lines), encoding="utf-8")


if __name__ == "__main__":
    main()
