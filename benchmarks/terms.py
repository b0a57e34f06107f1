"""What a screen of terms sees: how often the true term is named first, and false alarms.

    python benchmarks/terms.py [--sets 100] [--only 3RRR …]

Machines are drawn at random, each with one term of an amplitude of so many of its standard errors
(as the screen of a machine without it finds them), measured with noise and screened with all
kinds. False alarms: machines without terms in which some candidate has a corrected chance below one
in a hundred. Coverage: the amplitude's 95 % interval, of a calibration with the term.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace

import numpy as np

import pincal
from pincal.calibration.calibrate import prepared, started
from pincal.calibration.fits import fitted
from pincal.calibration.terms.candidates import Kind, kinds_of, with_terms
from pincal.calibration.terms.choice import RULES
from pincal.calibration.terms.screen import screen
from pincal.model.sensors.load import Load
from pincal.workspace.sampling import sample_workspace

NOISE = pincal.Noise(2e-5, 2e-5, 2e-5)
LOAD = Load(10.0, (0.01, 0.02, 0.05))
COUNT = 80


def machine(name: str) -> pincal.Mechanism:
    """Return a mechanism that carries something, if it stands upright."""
    plain = pincal.load_mechanism(name)
    return plain if plain.platform.space == 2 else replace(plain, load=LOAD)


def nominal_rows(mechanism: pincal.Mechanism, draw: np.random.Generator) -> pincal.Measurements:
    """Return where a mechanism is to be measured, with a temperature."""
    poses = sample_workspace(mechanism, COUNT, seed=int(draw.integers(1 << 30)))
    return pincal.Measurements(
        poses=poses,
        readings=pincal.inverse(mechanism, poses).readings,
        influences={"temperature": draw.uniform(15.0, 30.0, len(poses))},
    )


def measured(
    mechanism: pincal.Mechanism, truth: pincal.Mechanism, rows: pincal.Measurements, seed: int
) -> pincal.Measurements:
    """Return measurements of a machine."""
    plan = pincal.Plan(rows.poses, influences=rows.influences)
    return pincal.simulate(mechanism, truth, plan, NOISE, seed=seed).measurements


def tried(name: str, kind: Kind, sizes: tuple[float, ...], sets: int) -> None:
    """Print how often a term is named first, by its size in standard errors, and its coverage."""
    named, seen, covered, count = np.zeros(len(sizes)), np.zeros(len(sizes)), 0, 0
    for seed in range(sets):
        draw = np.random.default_rng(seed)
        mechanism = machine(name)
        rows = nominal_rows(mechanism, draw)
        reading = str(draw.choice(mechanism.reading_names))
        truth = pincal.disturb(mechanism, 1e-3, seed=seed)
        extended, ids = with_terms(truth, rows, [(reading, kind)])
        data = measured(mechanism, truth, rows, seed)
        calibration = started(prepared(mechanism, data, noise=NOISE))
        kinds = tuple(dict.fromkeys((*kinds_of(mechanism, rows), kind)))
        found = screen(fitted(calibration), kinds)
        own = next(one for one in found if (one.reading, one.kind) == (reading, kind))
        if not np.isfinite(own.std).all() or not own.rank:
            continue
        for place, size in enumerate(sizes):
            direction = draw.standard_normal(len(own.std))
            scale = size / np.linalg.norm(direction / own.std)
            true = extended.with_parameters(
                dict(zip(ids[reading, kind], (scale * direction).tolist(), strict=True))
            )
            data = measured(mechanism, true, rows, seed)
            again = replace(calibration, measurements=data)
            again.__dict__.pop("observation", None)
            first = screen(fitted(again), kinds)[0]
            named[place] += (first.reading, first.kind) == (reading, kind)
            seen[place] += first.corrected < RULES.level
        result = pincal.calibrate(mechanism, data, noise=NOISE, terms=(f"{reading}={kind}",))
        for name_, value in zip(ids[reading, kind], scale * direction, strict=True):
            covered += result[name_].low <= value <= result[name_].high
            count += 1
    shares = ", ".join(
        f"{size:g} SE {100 * n / sets:.0f} % ({100 * s / sets:.0f} % below {RULES.level})"
        for size, n, s in zip(sizes, named, seen, strict=True)
    )
    cover = 100 * covered / max(count, 1)
    print(f"{name} {kind}: named first {shares}; intervals cover {cover:.1f} %")


def alarms(name: str, sets: int) -> None:
    """Print how often something is seen in machines without terms."""
    false, chances = 0, []
    for seed in range(sets):
        draw = np.random.default_rng(seed)
        mechanism = machine(name)
        rows = nominal_rows(mechanism, draw)
        truth = pincal.disturb(mechanism, 1e-3, seed=seed)
        data = measured(mechanism, truth, rows, seed)
        calibration = started(prepared(mechanism, data, noise=NOISE))
        found = screen(fitted(calibration), kinds_of(mechanism, rows))
        false += min(one.corrected for one in found) < RULES.level
        chances += [one.p_value for one in found if one.rank]
    print(f"{name}: false alarms {100 * false / sets:.1f} %, mean chance {np.mean(chances):.3f}")


KINDS: dict[str, Callable[[], tuple[str, ...]]] = {
    "5R": lambda: ("temperature", "backlash"),
    "3RRR": lambda: ("temperature", "backlash", "harmonics:5"),
    "6UPS": lambda: ("temperature", "backlash", "gravity", "polynomial"),
    "delta": lambda: ("temperature", "backlash", "gravity"),
}

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sets", type=int, default=100)
    parser.add_argument("--only", nargs="*", default=list(KINDS))
    asked = parser.parse_args()
    for one in asked.only:
        alarms(one, asked.sets)
        for kind in KINDS[one]():
            tried(one, Kind.of(kind), (3.0, 5.0), asked.sets)
