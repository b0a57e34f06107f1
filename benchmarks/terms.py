"""What a screen of terms sees: how often true terms are named first, false alarms, coverage.

    python benchmarks/terms.py [--sets 100] [--only 3RRR …] [--output FILE]

Machines are drawn at random, each with one term or two, of amplitudes of so many of their standard
errors (as the screen of a machine without them finds them), measured with noise and screened with
all kinds at every reading, length and angle, alone and together. ``temperature`` is of one reading,
``growth=temperature`` of all lengths as one, ``length=temperature`` of one length,
``link=gravity`` of a length or angle between two joints. Of two terms the first is added, the
machine fitted again, and screened again: both must be named, in any order. Of a length that grows
or stretches another length of its leg counts too, of an angle that bends another angle.

Of each size: how often a term is the first candidate; how often it is the first, or one that
``explain`` says cannot be separated from the first; in brackets, how often the chance was below one
in a hundred. Of single terms at the first size also how often a judge names it who knows the noise,
and that there is one term of this size, each candidate as likely, each direction of its amplitudes
(Bayes): no rule does better. False alarms: machines without terms in which some candidate has a
corrected chance below one in a hundred. Coverage: the amplitudes' 95 % intervals, of calibrations
with the true terms. Each line is written as soon as it is known.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
from scipy.special import hyp0f1

import pincal
from pincal.calibration.calibrate import prepared, started
from pincal.calibration.calibration import Calibration
from pincal.calibration.fits import fitted
from pincal.calibration.terms.candidates import tied_by, with_terms
from pincal.calibration.terms.kinds import GRAVITY, GROWTH, ORDER, Kind, every_pair, lengths
from pincal.calibration.terms.path import RULES
from pincal.calibration.terms.screen import Candidate, inseparable, screen
from pincal.model.sensors.load import Load
from pincal.workspace.sampling import sample_workspace

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from arms import loaded

NOISE = pincal.Noise(2e-5, 2e-5, 2e-5)
LOAD = Load(10.0, (0.01, 0.02, 0.05))
UPRIGHT = " upright"
COUNT = 80
SIZES = (3.0, 5.0, 7.0)
#: What is drawn, machine by machine: terms alone and in pairs.
GROWS = (("growth=temperature",), ("length=temperature",))
CASES: dict[str, tuple[tuple[str, ...], ...]] = {
    "5R": (
        ("temperature",),
        ("backlash",),
        ("polynomial",),
        ("temperature", "backlash"),
        *GROWS,
    ),
    "3RRR": (
        ("temperature",),
        ("backlash",),
        ("polynomial",),
        ("harmonics:5",),
        ("temperature", "backlash"),
        *GROWS,
    ),
    "3RRR upright": (("gravity",), ("link=gravity",)),
    "6UPS": (
        ("temperature",),
        ("backlash",),
        ("gravity",),
        ("polynomial",),
        ("gravity", "backlash"),
        ("temperature", "polynomial"),
        *GROWS,
    ),
    "delta": (
        ("temperature",),
        ("backlash",),
        ("gravity",),
        ("gravity", "backlash"),
        *GROWS,
        ("link=gravity",),
    ),
    "ur5": (
        ("temperature",),
        ("backlash",),
        ("gravity",),
        ("harmonics",),
        ("gravity", "harmonics"),
        ("temperature", "backlash"),
        ("link=gravity",),
    ),
}


@cache
def machine(name: str) -> pincal.Mechanism:
    """Return a mechanism that carries something, if it stands upright."""
    plain = loaded(name) if name == "ur5" else pincal.load_mechanism(name.removesuffix(UPRIGHT))
    if name.endswith(UPRIGHT):
        return replace(plain, load=Load(LOAD.mass, gravity=(0.0, -9.81, 0.0)))
    return plain if plain.platform.space == 2 else replace(plain, load=LOAD)


def nominal_rows(mechanism: pincal.Mechanism, draw: np.random.Generator) -> pincal.Measurements:
    """Return where a mechanism is to be measured, with a temperature."""
    temperature = {"temperature": draw.uniform(15.0, 30.0, COUNT)}
    if mechanism.by_readings:
        readings = draw.uniform(-1.2, 1.2, (COUNT, len(mechanism.reading_names)))
        poses = pincal.forward(mechanism, readings).poses
    else:
        poses = sample_workspace(mechanism, COUNT, seed=int(draw.integers(1 << 30)))
        readings = pincal.inverse(mechanism, poses).readings
    return pincal.Measurements(poses=poses, readings=readings, influences=temperature)


def measured(
    mechanism: pincal.Mechanism, truth: pincal.Mechanism, rows: pincal.Measurements, seed: int
) -> pincal.Measurements:
    """Return measurements of a machine."""
    readings = rows.readings if mechanism.by_readings else None
    plan = pincal.Plan(rows.poses, readings=readings, influences=rows.influences)
    data = pincal.simulate(mechanism, truth, plan, NOISE, seed=seed).measurements
    given = {name: data.influences[name] for name in rows.influences}
    return replace(data, influences=given)  # loads and sides are worked out, as of real ones


def asked(mechanism: pincal.Mechanism, data: pincal.Measurements) -> Calibration:
    """Return the calibration to be done; an arm's frames leave parameters undetermined."""
    held = mechanism.by_readings
    return started(prepared(mechanism, data, noise=NOISE, hold_undetermined=held))


@dataclass(frozen=True)
class Seen:
    """What a screen says."""

    candidates: list[Candidate]
    chi2: float

    @property
    def first(self) -> Candidate:
        """The first candidate."""
        return self.candidates[0]

    @property
    def alike(self) -> list[Candidate]:
        """The first, and those that cannot be separated from it."""
        return [self.first, *inseparable(self.first, self.candidates[1:], self.chi2)]

    def likeliest(self, size: float) -> Candidate:
        """Return what a judge names who knows the noise, and that one term has this size.

        With directions alike the density of residuals is e^(-s²/2) 0F1(k/2; s² x/4) times that
        of noise, x the χ² along the k amplitudes.
        """

        def density(one: Candidate) -> float:
            inside = one.share * self.chi2
            return float(hyp0f1(one.rank / 2, size**2 * inside / 4)) if one.rank else 0.0

        return max(self.candidates, key=density)


def named(
    mechanism: pincal.Mechanism,
    data: pincal.Measurements,
    every: Sequence[tuple[str, Kind]],
    count: int,
) -> Iterator[Seen]:
    """Yield what is seen, each time after the first candidates before it were added."""
    added: list[tuple[str, Kind]] = []
    for _ in range(count):
        extended, _ = with_terms(mechanism, data, added)
        found = fitted(asked(extended, data))
        seen = Seen(screen(found, every), sum(one.fit.chi2 for one in found.fits))
        first = seen.first
        yield seen
        if first.kind.name == ORDER:  # no term
            return
        added.append((first.reading, first.kind))


def drawn(
    said: Sequence[str],
    mechanism: pincal.Mechanism,
    rows: pincal.Measurements,
    draw: np.random.Generator,
) -> list[tuple[str, Kind]]:
    """Return terms at places that are drawn at random, no two of them at one place."""
    every = {place for place, kind in every_pair(mechanism, rows) if kind.name == GRAVITY}
    places = {
        "": list(mechanism.reading_names),
        "growth": [GROWTH],
        "length": lengths(mechanism),
        "link": [one.id for one in mechanism.parameters if one.id in every],
    }
    parts = [one.rpartition("=") for one in said]
    chosen = draw.choice(places[parts[0][0]], len(parts), replace=False)
    return [(str(place), Kind.of(kind)) for place, (_, _, kind) in zip(chosen, parts, strict=True)]


def alike(place: str, mechanism: pincal.Mechanism) -> set[str]:
    """Return the places that are as good a name for a cause: lengths, or angles, of one leg."""
    every = mechanism.parameters
    if place not in {one.id for one in every}:
        return {place}
    owner, unit = every[place].owner, every[place].unit
    return {one.id for one in every if (one.owner, one.unit) == (owner, unit)}


def met(
    found: Sequence[Candidate], pairs: Sequence[tuple[str, Kind]], mechanism: pincal.Mechanism
) -> bool:
    """Return whether all terms are among those found."""
    return all(
        any(one.kind == kind and one.reading in alike(at, mechanism) for one in found)
        for at, kind in pairs
    )


def tried(name: str, said: tuple[str, ...], sets: int) -> str:
    """Return a line of a table: how often terms are named first, by size, and coverage."""
    mechanism = machine(name)
    first, among, clear = np.zeros((3, len(SIZES)))
    judged = 0
    covered = count = machines = seed = 0
    while machines < sets:
        draw = np.random.default_rng(seed)
        rows = nominal_rows(mechanism, draw)
        pairs = drawn(said, mechanism, rows, draw)
        plain = pincal.disturb(mechanism, 1e-3, seed=seed)
        truth, ids = with_terms(plain, rows, pairs)
        data = measured(mechanism, plain, rows, seed)
        every = list(dict.fromkeys((*every_pair(mechanism, rows), *pairs)))
        found = screen(fitted(asked(mechanism, data)), every)
        own = [c for pair in pairs for c in found if (c.reading, c.kind) == pair]
        seed += 1
        if len(own) < len(pairs) or not all(np.isfinite(c.std).all() and c.rank for c in own):
            continue  # nothing weighs on the joint, or geometry takes the term up
        machines += 1
        for place, size in enumerate(SIZES):
            values = {}
            for pair, one in zip(pairs, own, strict=True):
                way = draw.standard_normal(len(one.std))
                scaled = size / np.linalg.norm(way / one.std) * way
                names, every_one = ids[pair], len(ids[pair]) // len(way)  # growth: one of all legs
                values |= dict(zip(names, np.tile(scaled, every_one).tolist(), strict=True))
            data = measured(mechanism, truth.with_parameters(values), rows, seed)
            order = list(named(mechanism, data, every, len(pairs)))
            first[place] += met([one.first for one in order], pairs, mechanism)
            among[place] += met([c for one in order for c in one.alike], pairs, mechanism)
            clear[place] += all(one.first.corrected < RULES.level for one in order)
            judged += not place and met([order[0].likeliest(size)], pairs, mechanism)
        extended, own_ids = with_terms(mechanism, rows, pairs)
        result = pincal.calibrate(
            extended,
            data,
            noise=NOISE,
            hold_undetermined=mechanism.by_readings,
            tied=tied_by(own_ids),
        )
        names = [own[0] if place == GROWTH else own for (place, _), own in own_ids.items()]
        for id_ in np.hstack(names).tolist():
            covered += result[id_].low <= values[id_] <= result[id_].high
            count += 1
    shares = zip(100 * first / sets, 100 * among / sets, 100 * clear / sets, strict=True)
    at = [f"{n:.0f}, {m:.0f} % ({s:.0f} %)" for n, m, s in shares]
    at.insert(1, f"{100 * judged / sets:.0f} %" if len(said) == 1 else "–")
    within = f"{100 * covered / count:.1f} % of {count}"
    return f"| {name}, {' and '.join(said)} | {' | '.join(at)} | {within} |"


def alarms(name: str, sets: int) -> str:
    """Return a line: how often something is seen in machines without terms."""
    false, chances = 0, []
    for seed in range(sets):
        draw, mechanism = np.random.default_rng(10_000 + seed), machine(name)
        rows = nominal_rows(mechanism, draw)
        data = measured(mechanism, pincal.disturb(mechanism, 1e-3, seed=seed), rows, seed)
        found = screen(fitted(asked(mechanism, data)), every_pair(mechanism, rows))
        false += min(one.corrected for one in found) < RULES.level
        chances += [one.p_value for one in found if one.rank]
    return f"| {name}, none | {false} of {sets} | mean chance {np.mean(chances):.3f} |"


def main() -> None:
    """Write the lines."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sets", type=int, default=100)
    parser.add_argument("--only", nargs="*", default=list(CASES))
    parser.add_argument("--output", type=Path)
    parser.add_argument("--terms", nargs="*", help="such as gravity or gravity+backlash")
    given = parser.parse_args()
    wanted = None if given.terms is None else {tuple(one.split("+")) for one in given.terms}
    for name in given.only:
        lines = [lambda name=name: alarms(name, given.sets)] * (wanted is None)
        lines += [
            lambda name=name, said=said: tried(name, said, given.sets)
            for said in CASES[name]
            if wanted is None or said in wanted
        ]
        for line in lines:
            text = line()
            print(text, flush=True)
            if given.output is not None:
                with given.output.open("a", encoding="utf-8") as file:
                    file.write(f"{text}\n")


if __name__ == "__main__":
    main()
