"""What a screen of terms sees: how often true terms are named, false alarms, coverage.

    python benchmarks/terms.py [--sets 100] [--only 3RRR …] [--output FILE]
    python benchmarks/terms.py --coverage [--sets 100] [--only 3RRR …] [--terms gravity …]

Machines are drawn at random, measured with noise and fitted without terms. Each term is tried on
each: of so many standard errors (several amplitudes of one term in any direction of their
ellipsoid), its white rows are added to the residuals of the fit, which is what a fit of a machine
with it leaves, to first order (a test compares them). These are screened with all kinds at every
reading, length and angle, alone and together. ``temperature`` is of one reading,
``growth=temperature`` of all lengths as one, ``length=temperature`` of one length,
``link=gravity`` of a length or angle between two joints. Of two terms the first is taken out, and
the rest screened again: both must be named, in any order. Of each size, in percent:

- how often the true term is the first candidate, its kind and its place;
- how often a judge names it who knows the noise and that one term of this size is there, each
  candidate as likely and each direction of its amplitudes (Bayes): over all candidates no rule can
  do better on average; of single terms only;
- how often it is the first or one that ``explain`` says cannot be separated from the first; in
  brackets how many places are named so, on average;
- how often ``explain`` says so: the same, at chances below one in a hundred.

``any`` is a term drawn from all candidates. ``nothing``: machines in which some candidate has a
corrected chance below one in a hundred. ``--coverage`` measures machines with the terms, calibrates
them with these, and counts the amplitudes that lie in their 95 % intervals.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from pathlib import Path

import numpy as np
from scipy.special import hyp0f1

import pincal
from pincal.calibration.calibrate import prepared, started
from pincal.calibration.calibration import Calibration
from pincal.calibration.fits import fitted
from pincal.calibration.terms.candidates import with_terms
from pincal.calibration.terms.choice import LEVEL
from pincal.calibration.terms.kinds import GROWTH, Kind, every_pair, lengths
from pincal.calibration.terms.screen import Candidate, screened, trials
from pincal.estimation.observability.residuals import Residuals
from pincal.model.terms import Load
from pincal.workspace.sampling import sample_workspace

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from arms import loaded

NOISE = pincal.Noise(2e-5, 2e-5, 2e-5)
LOAD = Load(10.0, (0.01, 0.02, 0.05))
UPRIGHT = " upright"
COUNT = 80
POOL = 4000
SIZES = (3.0, 5.0, 7.0)
ANY = ("any",)
Pair = tuple[str, Kind]
Parts = list[tuple[Residuals, list[Candidate]]]
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


@cache
def pool(name: str) -> np.ndarray:
    """Return poses of a mechanism of which some are measured, shape (POOL, dof)."""
    return sample_workspace(machine(name), POOL)


def nominal_rows(name: str, draw: np.random.Generator) -> pincal.Measurements:
    """Return where a mechanism is to be measured, with a temperature."""
    mechanism = machine(name)
    temperature = {"temperature": draw.uniform(15.0, 30.0, COUNT)}
    if mechanism.by_readings:
        readings = draw.uniform(-1.2, 1.2, (COUNT, len(mechanism.reading_names)))
        poses = pincal.forward(mechanism, readings).poses
    else:
        poses = draw.choice(pool(name), COUNT, replace=False)
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
    return started(prepared(mechanism, data, noise=NOISE, strict=not held))


@dataclass(frozen=True)
class Seen:
    """What a screen says."""

    parts: Parts

    @cached_property
    def candidates(self) -> list[Candidate]:
        """All, the first first."""
        return screened(self.parts)

    @property
    def first(self) -> Candidate:
        """The first candidate."""
        return self.candidates[0]

    @property
    def chi2(self) -> float:
        """Of the residuals."""
        return sum(residuals.chi2 for residuals, _ in self.parts)

    @property
    def alike(self) -> list[Candidate]:
        """The first, and those that cannot be separated from it."""
        alike = [one for one in self.candidates if one.pair in self.first.or_else]
        return [self.first, *alike]

    def likeliest(self, size: float) -> Candidate:
        """Return what a judge names who knows the noise, and that one term has this size."""
        inside = [one.share * self.chi2 for one in self.candidates]
        odds = likelihoods(np.array(inside), np.array([one.rank for one in self.candidates]), size)
        return self.candidates[int(np.argmax(odds))]


def likelihoods(inside: np.ndarray, ranks: np.ndarray, size: float) -> np.ndarray:
    """Return how much likelier residuals are with a term of a size than without, but for a factor.

    With directions alike it is e^(-s²/2) 0F1(k/2; s² x/4) for k amplitudes of size s along which
    χ² is x.
    """
    return np.where(ranks > 0, hyp0f1(np.maximum(ranks, 1) / 2, size**2 * inside / 4), 0.0)


def with_term(parts: Parts, pair: Pair, size: float, draw: np.random.Generator) -> Parts:
    """Return residuals of a machine with a term, of so many standard errors in any direction."""

    def of(residuals: Residuals, terms: list[Candidate]) -> Residuals:
        own = [one for one in terms if (one.reading, one.kind) == pair]
        if not own:
            return residuals
        along = residuals.along(own[0].rows)
        way = draw.standard_normal(along.shape[1])
        more = (along @ way * size / np.linalg.norm(way)).reshape(residuals.left.shape)
        left = residuals.left + more
        return replace(residuals, left=left, chi2=float((left**2).sum()))

    return [(of(residuals, terms), terms) for residuals, terms in parts]


def without(parts: Parts, first: Candidate) -> Parts:
    """Return what is left with a term added: residuals without it, and terms to be tried."""
    rest = []
    for residuals, terms in parts:
        own = [one.rows for one in terms if one.names == first.names]
        others = [one for one in terms if not {*one.names} & {*first.names}]
        rest.append((residuals.without(own[0]) if own else residuals, others))
    return rest


def named(parts: Parts, count: int) -> list[Seen]:
    """Return what is seen, each time after the first candidates before it were added."""
    seen = [Seen(parts)]
    while len(seen) < count:
        seen.append(Seen(without(seen[-1].parts, seen[-1].first)))
    return seen


def drawn(
    said: Sequence[str],
    mechanism: pincal.Mechanism,
    seen: Sequence[Pair],
    draw: np.random.Generator,
) -> list[Pair]:
    """Return terms at places that are drawn at random, no two of them at one place.

    Args:
        said: Kinds of place and terms.
        mechanism: The mechanism.
        seen: Places and kinds that poses can show.
        draw: The generator.
    """
    if said == ANY:
        return [seen[draw.integers(len(seen))]]
    places = {
        "": mechanism.reading_names,
        "growth": (GROWTH,),
        "length": lengths(mechanism),
        "link": mechanism.load_names[len(mechanism.reading_names) :],
    }
    pairs: list[Pair] = []
    for one in said:
        where, _, text = one.rpartition("=")
        kind, taken = Kind.of(text), {place for place, _ in pairs}
        free = [at for at in places[where] if at not in taken and (at, kind) in seen]
        if not free:
            return []
        pairs.append((free[draw.integers(len(free))], kind))
    return pairs


def met(found: Sequence[Candidate], pairs: Sequence[Pair]) -> bool:
    """Return whether all terms are among those found."""
    return set(pairs) <= {(one.reading, one.kind) for one in found}


def screened_machine(name: str, seed: int) -> tuple[pincal.Measurements, Parts]:
    """Return measurements of a machine without terms, and what may be tried on its residuals."""
    mechanism, draw = machine(name), np.random.default_rng(seed)
    rows = nominal_rows(name, draw)
    data = measured(mechanism, pincal.disturb(mechanism, 1e-3, seed=seed), rows, seed)
    more = [("", Kind.of(one)) for said in CASES[name] for one in said if "=" not in one]
    own = [(at, kind) for _, kind in more for at in mechanism.reading_names]
    every = list(dict.fromkeys((*every_pair(mechanism, rows), *own)))
    return rows, trials(fitted(asked(mechanism, data)), every)


def seen_in(parts: Parts) -> list[Pair]:
    """Return places and kinds of term that poses can show."""
    return [(one.reading, one.kind) for one in screened(parts) if one.rank]


def table(name: str, sets: int, cases: Sequence[tuple[str, ...]]) -> Iterator[str]:
    """Yield the lines of a mechanism: how often terms are named, by size."""
    counts = {said: np.zeros((len(SIZES), 5)) for said in cases}
    drawn_in, false = dict.fromkeys(cases, 0), 0
    for seed in range(sets):
        _, parts = screened_machine(name, seed)
        false += Seen(parts).first.corrected < LEVEL
        seen = seen_in(parts)
        for said in cases:
            draw = np.random.default_rng((seed, cases.index(said)))
            pairs = drawn(said, machine(name), seen, draw)
            drawn_in[said] += bool(pairs)
            for place, size in enumerate(SIZES if pairs else ()):
                true = parts
                for pair in pairs:
                    true = with_term(true, pair, size, draw)
                counts[said][place] += judged(named(true, len(pairs)), pairs, size)
    yield f"| {name}, nothing (of {sets}) | {false} false alarms {'| – ' * (len(SIZES) - 1)}|"
    for said in cases:
        count, at = drawn_in[said], []
        for first, best, among, places, explained in counts[said] / max(count, 1):
            possible = f"{100 * best:.0f}" if len(said) == 1 else "–"
            shares = f"{100 * first:.0f} / {possible} / {100 * among:.0f} ({places:.1f})"
            at.append(f"{shares} / {100 * explained:.0f}")
        only = f" (of {count})" if count < sets else ""
        yield f"| {name}, {' and '.join(said)}{only} | {' | '.join(at)} |"


def judged(order: Sequence[Seen], pairs: Sequence[Pair], size: float) -> tuple[float, ...]:
    """Return whether terms are named: first, by the judge, among (how many places), explained."""
    among = met([c for one in order for c in one.alike], pairs)
    clear = all(one.first.corrected < LEVEL for one in order)
    return (
        met([one.first for one in order], pairs),
        met([order[0].likeliest(size)], pairs),
        among,
        float(np.mean([len(one.alike) for one in order])),
        among and clear,
    )


def coverage(name: str, sets: int, cases: Sequence[tuple[str, ...]]) -> Iterator[str]:
    """Yield how many amplitudes lie in their 95 % intervals, of calibrations with the terms."""
    mechanism = machine(name)
    covered: dict[tuple[str, ...], list[bool]] = {said: [] for said in cases}
    for seed in range(sets):
        rows, parts = screened_machine(name, seed)
        found = {(one.reading, one.kind): one for one in screened(parts)}
        whole = [pair for pair, one in found.items() if np.isfinite(one.std).all()]
        plain = pincal.disturb(mechanism, 1e-3, seed=seed)
        for said in cases:
            draw = np.random.default_rng((seed, cases.index(said)))
            pairs = drawn(said, mechanism, whole, draw)
            truth, ids = with_terms(plain, rows, pairs)
            values: dict[str, float] = {}
            for pair in pairs:
                std = found[pair].std
                scaled = SIZES[-1] * std * draw.choice((-1.0, 1.0), len(std))
                several = len(ids[pair]) // len(scaled)  # growth: one of all legs
                values |= dict(zip(ids[pair], np.tile(scaled, several).tolist(), strict=True))
            data = measured(mechanism, truth.with_parameters(values), rows, seed)
            extended, own_ids = with_terms(mechanism, rows, pairs)
            result = pincal.calibrate(
                extended,
                data,
                noise=NOISE,
                strict=not mechanism.by_readings,
                tied=[own[0].partition(".")[2] for (at, _), own in own_ids.items() if at == GROWTH],
            )
            for (place, _), own in own_ids.items():
                for id_ in own[:1] if place == GROWTH else own:
                    covered[said].append(result[id_].low <= values[id_] <= result[id_].high)
    for said, inside in covered.items():
        yield f"| {name}, {' and '.join(said)} | {100 * np.mean(inside):.1f} % of {len(inside)} |"


HEAD = (
    "| machine and terms | "
    + " | ".join(f"{size:g} standard errors" for size in SIZES)
    + " |\n"
    + "|---" * (len(SIZES) + 1)
    + "|"
)
HEAD_OF_COVERAGE = "| machine and terms | 95 % intervals cover |\n|---|---|"


def lines(given: argparse.Namespace) -> Iterator[str]:
    """Yield the lines of a table."""
    yield HEAD_OF_COVERAGE if given.coverage else HEAD
    wanted = None if given.terms is None else {tuple(one.split("+")) for one in given.terms}
    for name in given.only:
        cases = [said for said in CASES[name] if wanted is None or said in wanted]
        if given.coverage:
            yield from coverage(name, given.sets, cases)
        else:
            yield from table(name, given.sets, [*cases, *[ANY] * (wanted is None)])


def main() -> None:
    """Write the lines."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sets", type=int, default=100)
    parser.add_argument("--only", nargs="*", default=list(CASES))
    parser.add_argument("--coverage", action="store_true", help="of intervals, instead of naming")
    parser.add_argument("--output", type=Path)
    parser.add_argument("--terms", nargs="*", help="such as gravity or gravity+backlash")
    given = parser.parse_args()
    for text in lines(given):
        print(text, flush=True)
        if given.output is not None:
            with given.output.open("a", encoding="utf-8") as file:
                file.write(f"{text}\n")


if __name__ == "__main__":
    main()
