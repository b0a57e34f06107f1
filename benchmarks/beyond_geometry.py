"""What calibrations say of errors that are no geometry: alarms, causes named, promises kept.

    python benchmarks/beyond_geometry.py [--sets 100] [--only compliance …] [--write]

A 3-RRR of 1.5 m links, 24 poses for each leg in turns (72 rows, all used), noise of 20 µm, 50 µrad
and 20 µrad on readings, which is given. Closed forms in plain NumPy make the data and say how far
the platform is off (tests/cramer_rao.py); weight's torques are differences of these. Machines are
drawn at random, and judged at 300 poses of the workspace, at any time of the run; after a slip, as
they are then. ``--write`` puts the table into docs/tables.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
import cramer_rao
from pages import write_table

import pincal
from pincal.calibration.promise import unnoticed
from pincal.calibration.terms.choice import LEVEL
from pincal.design.order import in_rounds
from pincal.design.platform_error import platform_error

Array = NDArray[np.float64]
NOISE = pincal.Noise(2e-5, 5e-5, 2e-5)
WEIGHT = np.array([0.0, -9.81 * 50.0, 0.0])  # of what the platform carries, upright, [N]
SIZE = 1e-3  # of the machines' differences from their drawing
SLIPPED = 36
BROKEN = 1.2


# Machines


@cache
def nominal() -> pincal.Mechanism:
    """Return the 3-RRR, upright, with what it carries."""
    load = pincal.Load(50.0, (0.0, 0.0, 0.0), (0.0, -9.81, 0.0))
    return replace(pincal.load_mechanism("3RRR"), load=load)


@cache
def planned() -> Array:
    """Return the poses that are measured, shape (72, 3)."""
    candidates = pincal.sample_workspace(nominal(), 3000, 0)
    chosen = pincal.select_poses(nominal(), candidates, 24, noise=NOISE)
    return in_rounds(nominal(), chosen.plan, every=0).poses


@cache
def judged() -> Array:
    """Return the poses at which promises are judged, shape (300, 3)."""
    return pincal.sample_workspace(nominal(), 300, 7)


def at(one: cramer_rao.Machine, poses: Array) -> cramer_rao.Machine:
    """Return a machine at other poses."""
    turns = Rotation.from_rotvec(np.pad(poses[:, 2:], ((0, 0), (2, 0))))
    return replace(one, positions=poses[:, :2], rotations=turns)


def geometry(one: cramer_rao.Machine, twists: Array) -> Array:
    """Return readings of a machine without other errors."""
    return one.readings(one.parameters, twists)


def by_pose(one: cramer_rao.Machine, twists: Array) -> Array:
    """Return ∂reading/∂twist by central differences, shape (N, 3, 3)."""
    h = 1e-6
    ends = [(geometry(one, twists + d), geometry(one, twists - d)) for d in h * np.eye(3)]
    return np.stack([(b - a) / (2 * h) for b, a in ends], axis=2)


def torques(one: cramer_rao.Machine, twists: Array) -> Array:
    """Return what the weight does along each reading, shape (N, 3), by virtual work."""
    J = by_pose(one, twists).transpose(0, 2, 1)
    return np.linalg.solve(J, np.broadcast_to(WEIGHT, (len(J), 3))[:, :, None])[:, :, 0]


def temperatures(time: Array) -> Array:
    """Return temperatures of a machine that warms up, from 20 to 26 degrees."""
    return 20.0 + 6.0 * (1.0 - np.exp(-2.0 * time)) / (1.0 - np.exp(-2.0))


# Errors


@dataclass(frozen=True)
class Error:
    """One kind of error: how the machine reads, how measured poses are off, what mends it."""

    name: str
    readings: Callable[[cramer_rao.Machine, Array, Array], Array] | None = None
    """Errors of readings of a machine at twists and times, 0 to 1 over the run."""
    moved: Callable[[Array, Array], Array] | None = None
    """Errors of measured poses."""
    named: str = ""
    """What ``explain`` names first if it names the cause, a regular expression."""
    terms: tuple[str, ...] = ()
    columns: Callable[[Array], dict[str, Array]] = field(default=lambda _: {})
    """Columns of the measurements by time."""
    after: bool = False
    """Whether the machine is judged as it is at the run's end."""


def compliance(_: np.random.Generator) -> Error:
    """Return drives or first links that give way by 0.1 mrad under the largest torque."""
    still = np.zeros((len(planned()), 3))

    def errors(one: cramer_rao.Machine, twists: Array, _: Array) -> Array:
        most = np.abs(torques(at(one, planned()), still)).max()
        return 1e-4 * torques(one, twists) / most

    return Error(
        "links give way by 0.1 mrad under weight",
        errors,
        named=r"(leg_\d|readings) gravity",
        terms=("gravity",),
    )


def harmonics(order: int) -> Callable[[np.random.Generator], Error]:
    """Return motors that are off by 0.3 mrad, so many periods in a turn, each its phase."""

    def drawn(draw: np.random.Generator) -> Error:
        phase = draw.uniform(0.0, 2.0 * np.pi, 3)

        def errors(one: cramer_rao.Machine, twists: Array, _: Array) -> Array:
            return 3e-4 * np.sin(order * geometry(one, twists) + phase)

        return Error(
            f"harmonics of 0.3 mrad, {order} in a turn",
            errors,
            named=r"(leg_\d|readings) (harmonics|polynomial)",
            terms=(f"harmonics:{order}",),
        )

    return drawn


def growth(_: np.random.Generator) -> Error:
    """Return links that grow by 30 µm in the course of the run; base and platform do not."""
    longer = np.array([p.name in ("l", "L") for p in nominal().parameters]) * 3e-5

    def errors(one: cramer_rao.Machine, twists: Array, time: Array) -> Array:
        more = one.readings(one.parameters + longer, twists) - geometry(one, twists)
        return more * ((temperatures(time) - 20.0) / 6.0)[:, None]

    return Error(
        "links grow by 30 µm as they warm up",
        errors,
        named=r"((leg_\d\.)?(l|L|OA|ob)|growth) temperature",
        terms=("l=temperature", "L=temperature"),
        columns=lambda time: {"temperature": temperatures(time)},
    )


def drift(_: np.random.Generator) -> Error:
    """Return an encoder whose offset drifts by 0.1 mrad."""
    return Error(
        "an encoder drifts by 0.1 mrad",
        lambda _, __, time: np.outer(time, [0.0, 1e-4, 0.0]),
        named="leg_2 time|drift of reading leg_2",
        terms=("leg_2=time",),
        columns=lambda time: {"time": time},
    )


def frame(draw: np.random.Generator) -> Error:
    """Return a frame that drifts by 50 µm, in any direction."""
    way = draw.uniform(0.0, 2.0 * np.pi)
    by = 5e-5 * np.array([np.cos(way), np.sin(way), 0.0])
    return Error(
        "the tracker's frame drifts by 50 µm",
        moved=lambda _, time: np.outer(time, by),
        named="drift of frame",
    )


def slip(_: np.random.Generator) -> Error:
    """Return an encoder of 10,000 counts in a turn that slips by one in the middle of the run."""
    row = SLIPPED / (len(planned()) - 1) - 1e-9
    return Error(
        "an encoder slips by a count of 10,000",
        lambda _, __, time: np.outer(time >= row, [0.0, 2e-4 * np.pi, 0.0]),
        named=f"slip of reading leg_2 at {SLIPPED}",
        terms=("leg_2=after",),
        columns=lambda time: {"after": (time >= row).astype(float)},
        after=True,
    )


def scale(_: np.random.Generator) -> Error:
    """Return a tracker whose scale is 200 µm/m off."""
    return Error(
        "the tracker's scale is 200 µm/m off",
        moved=lambda poses, _: poses * np.array([2e-4, 2e-4, 0.0]),
    )


def nothing(_: np.random.Generator) -> Error:
    """Return no error."""
    return Error("nothing")


ERRORS: dict[str, Callable[[np.random.Generator], Error]] = {
    "nothing": nothing,
    "compliance": compliance,
    "harmonics_1": harmonics(1),
    "harmonics_2": harmonics(2),
    "harmonics_3": harmonics(3),
    "growth": growth,
    "drift": drift,
    "frame": frame,
    "slip": slip,
    "scale": scale,
}


# One machine


@dataclass(frozen=True)
class Judge:
    """A true machine, its error, and where it is when."""

    one: cramer_rao.Machine
    error: Error
    time: Array

    def readings(self, twists: Array) -> Array:
        """Return what the machine reads at the judged poses, moved by twists."""
        more = self.error.readings
        plain = geometry(self.one, twists)
        return plain if more is None else plain + more(self.one, twists, self.time)

    def off(self, machine: pincal.Mechanism) -> Array:
        """Return how the platform misses the judged poses if a model commands it, (300, 3)."""
        known = {
            name: values
            for name, values in self.error.columns(self.time).items()
            if name in machine.influences
        }
        wanted = pincal.inverse(machine, judged(), **({"influences": known} if known else {}))
        twists = np.zeros((len(judged()), 3))
        for _ in range(4):
            gap = self.readings(twists) - wanted.readings
            twists -= np.linalg.solve(by_pose(self.one, twists), gap[:, :, None])[:, :, 0]
        return twists

    def of(self, result: pincal.CalibrationResult) -> tuple[float, float]:
        """Return the error over the limit, as if nothing spoke against it, and interval coverage.

        The limit is that of the noise as given: not larger because residuals are.
        """
        names = result.identified.influences
        known = {k: v for k, v in self.error.columns(self.time).items() if k in names}
        covariance = result.covariance / result.excess**2
        plan = pincal.Plan(judged(), influences=known)
        promised = platform_error(result.identified, covariance, plan)
        left = unnoticed(result.reduced_chi2 / result.excess**2, result.chi2_freedoms)
        twists = self.off(result.identified)
        size = np.sqrt((twists[:, :2] ** 2).sum(axis=1).mean())
        within = np.abs(twists) <= 1.959964 * promised.std
        return size / (left * promised.limit[0]), float(within.mean())


def machine(kind: str, seed: int) -> tuple[pincal.Measurements, Judge]:
    """Return measurements of a machine, and its judge."""
    draw = np.random.default_rng(seed)
    start = np.concatenate([leg.nominal for leg in nominal().legs])
    true = start + SIZE * draw.standard_normal(len(start))
    one = at(cramer_rao.Machine(nominal(), true, planned(), Rotation.identity()), planned())
    error, time = ERRORS[kind](draw), np.linspace(0.0, 1.0, len(planned()))
    still = np.zeros((len(time), 3))
    readings, poses = geometry(one, still), planned().copy()
    if error.readings is not None:
        readings = readings + error.readings(one, still, time)
    if error.moved is not None:
        poses = poses + error.moved(poses, time)
    data = pincal.Measurements(
        poses=poses + NOISE.of_poses(nominal()) * draw.standard_normal(poses.shape),
        readings=readings + NOISE.reading * draw.standard_normal(readings.shape),
        influences={} if error.after else error.columns(time),
    )
    when = np.ones(len(judged())) if error.after else draw.uniform(0.0, 1.0, len(judged()))
    return data, Judge(at(one, judged()), error, when)


def first_named(found: pincal.Explanation) -> list[str]:
    """Return what is named first, with what cannot be separated from it; nothing if nothing is.

    What slipped or drifts, else the first candidate.
    """
    for one in found.slips[:1]:
        if one.term == "step":
            return [f"slip of {one.what} {one.name} at {one.row}"]
        every = ((one.what, one.name), *one.or_else)
        return [f"drift of {what} {name}".strip() for what, name in every]
    first = found.candidates[0]
    return [f"{first.reading} {first.kind}"] if first.corrected < LEVEL else []


# Lines


def percent(given: list[bool] | list[float] | Array) -> str:
    """Return a mean as a percentage with its standard error."""
    found = np.asarray(given, dtype=float)
    if not len(found):
        return ""
    return f"{100 * found.mean():.0f} ± {100 * found.std() / np.sqrt(len(found)):.0f} %"


def line(kind: str, sets: int) -> tuple[str, str]:
    """Return a line of the table, and what was found how often."""
    rows: dict[str, list[float]] = {}
    said: Counter[str] = Counter()
    for seed in range(sets):
        data, judge = machine(kind, seed)
        error = judge.error
        found = pincal.explain(nominal(), data, noise=NOISE)
        first = first_named(found)
        said.update({f"`{one.code}`" for one in found.result.contradictions} | set(first[:1]))
        named = any(re.fullmatch(error.named, one) for one in first)
        values = {"named": named, "something": bool(first), "alarm": not found.result.promises}
        values["ratio"], values["within"] = judge.of(found.result)
        for name, terms in (("known", error.terms), ("found", found.terms)):
            if terms:
                time = np.linspace(0.0, 1.0, len(data))
                own = replace(data, influences=error.columns(time)) if name == "known" else data
                with_it = pincal.calibrate(nominal(), own, noise=NOISE, terms=terms)
                values[name], values[f"{name}_within"] = judge.of(with_it)
        for name, value in values.items():
            rows.setdefault(name, []).append(float(value))
    ratio, alarm = np.array(rows["ratio"]), np.array(rows["alarm"])
    broken = ratio > BROKEN
    cells = [
        error.name,
        f"{np.median(ratio):.2f}",
        percent(rows["within"]),
        percent(alarm),
        f"{percent(alarm[broken])} of {broken.sum()}" if broken.any() else "none",
        percent(rows["named"]) if error.named else f"anything: {percent(rows['something'])}",
        *(_kept(rows, name) for name in ("known", "found")),
    ]
    often = ", ".join(f"{one} {count}" for one, count in said.most_common(8))
    return f"| {' | '.join(cells)} |", f"- {error.name}: {often or 'nothing'}"


def _kept(rows: dict[str, list[float]], name: str) -> str:
    """Return how often limits are kept, and intervals cover, with terms."""
    if name not in rows:
        return "–"
    kept = percent(np.array(rows[name]) <= 1.0)
    return f"{kept}; {percent(rows[f'{name}_within'])} ({len(rows[name])})"


HEAD = (
    "| error | off / promised | 95 % intervals cover | alarm | alarm where off by more than 1.2 "
    "| cause named first | with its term: limit kept; intervals cover (sets) "
    "| with what `explain` adds |\n"
    f"|---{'|---:' * 3}{'|---' * 4}|"
)


def main() -> None:
    """Write the lines."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sets", type=int, default=100)
    parser.add_argument("--only", nargs="*", choices=ERRORS, default=list(ERRORS))
    parser.add_argument("--write", action="store_true", help="into docs/tables")
    given = parser.parse_args()
    print(HEAD)
    lines = []
    for kind in given.only:
        table, often = line(kind, given.sets)
        print(table, often, sep="\n", flush=True)
        lines.append(table)
    if given.write:
        write_table("beyond_geometry", [HEAD, *lines])


if __name__ == "__main__":
    main()
