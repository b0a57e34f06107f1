"""One calibration after another by an older pincal and by this one, side by side.

    python benchmarks/side_by_side.py OLD_TREE [--only WORDS] [--write PAGE.md]

Both get the same rows, made once by the older one, and the same options; each runs in a process
of its own, and they are timed in turn. Parameters are compared in the older one's standard errors.
"""

from __future__ import annotations

import argparse
import json
import os
import pickle
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cache
from importlib.metadata import files
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

HERE = Path(__file__).parents[1]
GIVEN = (1e-4, 1e-4, 5e-5)  # noise of positions, orientations, readings
EXACT = (1e-4, 1e-4, 0.0)
METHODS: dict[str, dict[str, Any]] = {
    "per leg, own": {"method": "per-leg", "poses": "own"},
    "per leg, all": {"method": "per-leg", "poses": "all"},
    "together": {"method": "together", "poses": "all"},
    "latent": {"method": "latent"},
}
WHOLE = ("per leg, own", "per leg, all", "together", "latent")
COUNTS = {"5R": 40, "3RRR": 40, "6UPS": 60, "delta": 60, "3RPS": 60, "4cable": 45, "8cable": 60}
ARM = ("ur5_robot.urdf", "tool0", "base_link")


@dataclass(frozen=True)
class Scenario:
    """What is calibrated, from what, and how."""

    machine: str
    method: str
    data: str
    """Noise and kind of the rows, in a few words."""
    noise: tuple[float, float, float] = GIVEN
    """Of the rows."""
    measured: str = "poses"
    """``poses``, ``positions``, ``frame``, ``positions, frame``, ``target``, ``some``."""
    outliers: float = 0.0
    """Standard deviations by which a tenth of the rows are off."""
    options: dict[str, Any] = field(default_factory=dict)
    """Further ones, of ``calibrate``."""
    given: bool = True
    """Whether the noise is given."""

    @property
    def own(self) -> bool:
        """Whether each leg has its own poses."""
        return self.method == "per leg, own"

    def __str__(self) -> str:
        return f"{self.machine} {self.method} {self.data}"


def scenarios() -> Iterator[Scenario]:
    """Yield what is compared."""
    for machine in COUNTS:
        whole = ("latent",) if machine == "3RPS" else WHOLE
        for method in whole:
            yield Scenario(machine, method, "noisy readings")
        for method in whole[1:] or whole:
            yield Scenario(machine, method, "exact readings", EXACT)
    for machine in ("5R", "3RRR", "6UPS"):
        yield Scenario(machine, "latent", "noise not given", given=False)
        yield Scenario(machine, "together", "noise not given", EXACT, given=False)
    for machine in ("5R", "3RRR", "6UPS", "delta", "4cable", "ur5"):
        yield Scenario(machine, "latent", "positions, unknown frame", measured="positions, frame")
    yield Scenario("3RRR", "latent", "poses, unknown frame", EXACT, "frame")
    yield Scenario("6UPS", "latent", "unknown frame and target", EXACT, "target")
    yield Scenario("4cable", "latent", "36 of 45 poses not measured", measured="some")
    yield Scenario("8cable", "latent", "48 of 60 poses not measured", measured="some")
    yield Scenario("ur5", "latent", "exact readings", EXACT)
    yield Scenario("ur5", "latent", "noisy readings")
    yield Scenario(
        "ur5",
        "latent",
        "positions, rest held",
        measured="positions, frame",
        options={},
    )
    for method in ("per leg, all", "together", "latent"):
        for data, own in (
            ("L tied", {"tied": ["L"]}),
            ("prior on l", {"priors": {"l": 1e-4}}),
            ("k fixed", {"fixed": ["k"]}),
        ):
            yield Scenario("3RRR", method, data, EXACT, options=own)
    for method in ("latent", "together", "per leg, all"):
        yield Scenario("6UPS", method, "outliers", outliers=100, options={"loss": "reject"})


# Rows, made by the older pincal


def _mechanism(pincal: Any, machine: str) -> Any:
    if machine in COUNTS:
        return pincal.load_mechanism(machine)
    name, tip, base = ARM
    every = files("example-robot-data") or []
    path = next(Path(str(one.locate())) for one in every if one.name == name)
    load = getattr(pincal, "load_arm", None) or pincal.Mechanism.from_urdf  # as 0.1.0 has it
    return load(path, tip, base)


@cache
def _plan(pincal: Any, machine: str, own: bool) -> Any:
    """Return poses, each for one leg if asked for: as many as it has parameters, and ten more."""
    mechanism = _mechanism(pincal, machine)
    if mechanism.by_readings:
        return pincal.sample_configurations(mechanism, COUNTS.get(machine, 60), 0)
    legs = mechanism.leg_names
    count = len(legs) * (len(mechanism.legs[0].parameters) + 10) if own else COUNTS[machine]
    poses = pincal.sample_workspace(mechanism, count, 0)
    return pincal.Plan(poses, tuple(legs[i % len(legs)] for i in range(count)) if own else None)


def _rows(pincal: Any, one: Scenario) -> dict[str, Any]:
    """Return arrays of measurements, and numbers of the setup."""
    mechanism = _mechanism(pincal, one.machine)
    truth = pincal.disturb(mechanism, 2e-3, 1)
    rng = np.random.default_rng(2)
    plan = _plan(pincal, one.machine, one.own)
    data = pincal.simulate(mechanism, truth, plan, pincal.Noise(*one.noise), 3).measurements
    if one.outliers:
        rows = rng.choice(len(data), len(data) // 10, replace=False)
        off = np.zeros(data.poses.shape)
        columns = rng.integers(off.shape[1], size=len(rows))
        off[rows, columns] = one.outliers * 1e-4 * rng.choice([-1, 1], len(rows))
        data = replace(data, poses=mechanism.platform.moved(data.poses, off))
    poses = _seen(mechanism.platform, data.poses, one)
    if "positions" in one.measured:
        poses[:, [unit == "rad" for unit in mechanism.platform.units]] = np.nan
    if one.measured == "some":
        poses[np.arange(len(poses)) % 5 > 0] = np.nan
    setup = {
        "unknown_frame": "frame" in one.measured or one.measured == "target",
        "target": one.measured == "target",
        "offset": _offset(one),
    }
    return {"poses": poses, "readings": data.readings, "sets": data.sets, "setup": setup}


def _offset(one: Scenario) -> np.ndarray:
    """Return where the target is known to sit on the platform: off an arm's last axis."""
    return np.array(
        [0.05, 0.1, 0.02] if one.machine == "ur5" and "," in one.measured else [0.0] * 3
    )


def _seen(platform: Any, poses: np.ndarray, one: Scenario) -> np.ndarray:
    """Return poses as they are seen from elsewhere, if they are."""
    if "frame" not in one.measured and one.measured != "target":
        return np.array(poses)
    plane = platform.space == 2
    matrices = platform.transforms(poses).as_matrix()
    if one.measured == "target":
        matrices[:, :3, 3] += matrices[:, :3, :3] @ np.array([0.05, -0.03, 0.0 if plane else 0.04])
    matrices[:, :3, 3] += matrices[:, :3, :3] @ _offset(one)
    turn = 0.8
    frame = np.eye(4)
    frame[:2, :2] = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
    frame[:3, 3] = [1.0, 2.0, 0.0 if plane else 3.0]
    return np.asarray(platform.from_matrices(frame @ matrices))


# One calibration, by either pincal


def parameters_of(result: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return identified values and standard errors of the legs' parameters, shapes (n,).

    Of results with ``.legs[i].parameters[j]`` or with ``result["leg_1.l"]``.
    """
    if hasattr(result, "legs"):
        found = [p for leg in result.legs for p in leg.parameters]
    else:
        legs = result.nominal.legs
        found = [result[f"{leg.name}.{name}"] for leg in legs for name in leg.parameter_names]
    return np.array([p.identified for p in found]), np.array([p.std for p in found])


def _calibrated(pincal: Any, one: Scenario, rows: dict[str, Any]) -> dict[str, Any]:
    """Return what a calibration found, as plain numbers, and how long it took."""
    mechanism = _mechanism(pincal, one.machine)
    data = pincal.Measurements(poses=rows["poses"], readings=rows["readings"], sets=rows["sets"])
    how = rows["setup"]
    targets = {"platform": pincal.Target(tuple(how["offset"].tolist()), how["target"])}
    options = {
        **METHODS[one.method],
        **one.options,
        "setup": pincal.Setup(how["unknown_frame"], targets),
        "noise": pincal.Noise(*one.noise) if one.given else None,
    }
    if hasattr(pincal, "Options") and options["method"] in ("together", "latent"):
        del options["method"]  # the default, since 0.2
    begin = perf_counter()
    try:
        result = pincal.calibrate(mechanism, data, **options)
    except (
        Exception
    ) as error:  # any: what is not refused as a PincalError is to be seen in the table
        return {"refused": f"{type(error).__name__}: {error}"}
    time = perf_counter() - begin
    values, std = parameters_of(result)
    gauge = getattr(result, "gauge_directions", None)
    return {
        "time": time,
        "values": values.tolist(),
        "std": std.tolist(),
        "covariance": np.asarray(result.covariance)[: len(values), : len(values)].tolist(),
        "gauge": None if gauge is None else np.asarray(gauge).tolist(),
        "chi2": float(result.reduced_chi2) * int(result.degrees_of_freedom),
        "dof": int(result.degrees_of_freedom),
        "converged": bool(result.converged),
    }


def _serve(inputs: Path) -> None:
    """Answer numbers of scenarios on stdin by a line of JSON each on stdout."""
    import pincal

    out = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what anything else prints is no answer
    given = pickle.loads(inputs.read_bytes())
    for line in sys.stdin:
        out.write(json.dumps(_calibrated(pincal, *given[int(line)])) + "\n")
        out.flush()


def _make(outputs: Path, only: str) -> None:
    """Write all scenarios with their rows."""
    import pincal

    chosen = [one for one in scenarios() if only in str(one)]
    outputs.write_bytes(pickle.dumps([(one, _rows(pincal, one)) for one in chosen]))


# Side by side


def _started(tree: Path, *arguments: object, **more: Any) -> subprocess.Popen[str]:
    environment = {**os.environ, "PYTHONPATH": str(tree), "OPENBLAS_NUM_THREADS": "1"}
    command = [sys.executable, __file__, str(tree), *map(str, arguments)]
    return subprocess.Popen(command, env=environment, text=True, **more)


def compared(
    old_tree: Path, only: str
) -> Iterator[tuple[Scenario, dict[str, Any], dict[str, Any]]]:
    """Yield each scenario with what the older and this pincal find."""
    with tempfile.TemporaryDirectory() as folder:
        inputs = Path(folder) / "inputs"
        if _started(old_tree, "--make", inputs, "--only", only).wait():
            raise SystemExit("the older pincal could not make the rows")
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
        sides = [_started(tree, "--serve", inputs, **pipes) for tree in (old_tree, HERE)]

        def ask(side: subprocess.Popen[str], number: int) -> dict[str, Any]:
            assert side.stdin
            assert side.stdout
            side.stdin.write(f"{number}\n")
            side.stdin.flush()
            return dict(json.loads(side.stdout.readline()))

        for number, (one, _) in enumerate(pickle.loads(inputs.read_bytes())):
            answers = [ask(side, number) for side in sides]  # warms up, too
            times: list[list[float]] = [[], []]
            runs = 3 if max(a.get("time", 0.0) for a in answers) < 0.7 else 1
            for _ in range(runs if all("time" in a for a in answers) else 0):
                for side, own in zip(sides, times, strict=True):
                    own.append(ask(side, number)["time"])
            for answer, own in zip(answers, times, strict=True):
                answer["time"] = min([*own, answer["time"]]) if "time" in answer else None
            yield one, answers[0], answers[1]
        for side in sides:
            assert side.stdin
            side.stdin.close()
            side.wait()


HEAD = (
    "mechanism", "method", "rows", "parameters: largest", "rms", "rms, gauge apart",
    "standard errors", "χ² old", "χ² new", "dof", "converged", "time",
)  # fmt: skip


def row_of(one: Scenario, old: dict[str, Any], new: dict[str, Any]) -> tuple[str, ...]:
    """Return the cells of a scenario."""
    first = (one.machine, one.method, one.data)
    if "refused" in old or "refused" in new:
        words = [a.get("refused", "gives a result") for a in (old, new)]
        if words[0] == words[1]:
            return (*first, f"both refuse: {_short(words[0])}", *[""] * 8)
        return (*first, f"old: {_short(words[0])}; new: {_short(words[1])}", *[""] * 8)
    change = np.array(new["values"]) - np.array(old["values"])
    std, other = np.array(old["std"]), np.array(new["std"])
    free = std > 1e-9 * std.max()
    off = change[free] / std[free]
    ratio = other[free] / std[free]
    pairs = [
        f"{a:.6g}" if a == b else f"{a:.6g} → {b:.6g}"
        for a, b in ((old[key], new[key]) for key in ("dof", "converged"))
    ]
    pairs[1] = (
        "yes"
        if old["converged"] and new["converged"]
        else (f"{'yes' if old['converged'] else 'no'} → {'yes' if new['converged'] else 'no'}")
    )
    return (
        *first,
        f"{np.abs(off).max():.1e}",
        f"{np.sqrt((off**2).mean()):.1e}",
        f"{_observable(change, np.array(old['covariance']), old['gauge']):.1e}",
        f"{ratio.min():.4f}–{ratio.max():.4f}",
        f"{old['chi2']:.6g}",
        f"{new['chi2']:.6g}",
        *pairs,
        f"{new['time'] / old['time']:.2f}",
    )


def _observable(
    change: np.ndarray, covariance: np.ndarray, gauge: list[list[float]] | None
) -> float:
    """Return the change in standard errors of what is measured, root mean square.

    A part along the gauge, which is chosen and not measured, is taken out.
    """
    scale = np.sqrt(np.diag(covariance))
    scale[scale <= 1e-9 * scale.max()] = np.inf
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    kept = values > 1e-10 * values[-1]
    change = change / scale
    if gauge:
        G = np.array(gauge) / scale[:, None]
        G = G if len(G) == len(change) else G.T
        lost = vectors[:, ~kept].T  # constraints that chose the gauge
        change = change - G @ np.linalg.lstsq(lost @ G, lost @ change, rcond=None)[0]
    return float(np.sqrt(((vectors[:, kept].T @ change) ** 2 / values[kept]).mean()))


def _short(text: str, most: int = 100) -> str:
    text = " ".join(text.replace("|", "/").split())
    return text if len(text) <= most else text[: most - 2] + " …"


def table(rows: list[tuple[str, ...]]) -> str:
    """Return the Markdown table."""
    lines = [f"| {' | '.join(HEAD)} |", "|---|---|---|" + "---:|" * (len(HEAD) - 3)]
    return "\n".join([*lines, *(f"| {' | '.join(row)} |" for row in rows)])


PAGE = """# Side by side with the release before

Written by `python benchmarks/side_by_side.py OLD_TREE --write PAGE.md`.
The same rows and options for both. Change of parameters in standard errors of the older: the
largest, the root mean square, and the latter over what is measured, the gauge apart. Standard
errors and time as ratios, new over old: range over parameters, and best of several runs in turn.

"""


def main() -> None:
    """Compare, print, and write if asked to."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("old_tree", type=Path)
    parser.add_argument("--only", default="", help="scenarios whose name has these words")
    parser.add_argument("--write", type=Path, help="page to write")
    parser.add_argument("--make", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--serve", type=Path, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.make:
        return _make(given.make, given.only)
    if given.serve:
        return _serve(given.serve)
    rows, ratios = [], []
    print(table([]))
    for one, old, new in compared(given.old_tree.resolve(), given.only):
        rows.append(row_of(one, old, new))
        if old["time"] and new["time"]:
            ratios.append(new["time"] / old["time"])
        print(f"| {' | '.join(rows[-1])} |", flush=True)
    last = f"\n{len(rows)} scenarios; median of the time ratios {np.median(ratios):.2f}."
    print(last)
    if given.write:
        given.write.write_text(PAGE + table(rows) + "\n" + last + "\n", encoding="utf-8")
    return None


if __name__ == "__main__":
    main()
