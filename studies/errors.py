"""Errors that are no geometry: what a calibration says of them, and what modelling them gives."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

import pincal

from . import drawing
from .study import Cell, Study, by_rows

Array = NDArray[np.float64]
NOISE = pincal.Noise(2e-5, 5e-5, 2e-5)
SIGMA = 1e-3  # of the parameters' errors
LEAST = 0.01  # chance, below which something is named
_LARGEST = 1000.0  # torque on a drive, about [N m]

#: Nominal table of a seven-joint arm (Motoman): a [m], d [m], α [deg], θ [deg]. α of the first row
#: has the other sign for the right arm.
TABLE = (
    (0.0, -0.263, -15.0, -90.0),
    (0.15, 1.4159, -90.0, 0.0),
    (0.614, 0.0, 180.0, -90.0),
    (0.2, 0.0, -90.0, 0.0),
    (0.0, -0.64, 90.0, 0.0),
    (0.03, 0.0, 90.0, -90.0),
    (0.0, 0.2, 0.0, 0.0),
)
REFLECTOR = (0.05, 0.0, 0.25)
SEEN = pincal.Noise(5e-5, 1e-4, 0.0)


def run(study: Study) -> None:
    """Calibrate simulated machines and, where their measurements are, real ones."""
    simulated(study)
    folder = os.environ.get("PINCAL_DATA", "")
    sides = [s for s in ("left", "right") if _file(folder, s).is_file() and not study.quick]
    study.heading("Two real arms")
    if sides:
        arms(study, {side: _file(folder, side) for side in sides})
    else:
        study.say("Left out by `--quick`, or as `PINCAL_DATA` does not say where they are.")


# Simulated machines


def drawn() -> pincal.Mechanism:
    """Return a 3-RRR that stands upright and carries 50 kg."""
    load = pincal.Load(50.0, (0.0, 0.0, 0.0), (0.0, -9.81, 0.0))
    return replace(pincal.load_mechanism("3RRR"), load=load)


def with_sensor_terms(
    machine: pincal.Mechanism, terms: dict[pincal.Term, float]
) -> pincal.Mechanism:
    """Return a machine whose every sensor has terms of these amplitudes."""
    more = tuple((term.parameter, value) for term, value in terms.items())
    legs = tuple(
        replace(
            leg,
            sensors=tuple(replace(one, terms=tuple(terms)) for one in leg.sensors),
            parameters=(*leg.parameters, *more),
        )
        for leg in machine.legs
    )
    return replace(machine, legs=legs)


def gives_way(machine: pincal.Mechanism) -> pincal.Mechanism:
    """Return a machine whose drives give way by 0.1 mrad under the largest torque."""
    return with_sensor_terms(
        machine, {pincal.Term("give", pincal.Share(_LARGEST), of="load"): 1e-4}
    )


def eccentric(machine: pincal.Mechanism) -> pincal.Mechanism:
    """Return a machine whose motors are off by 0.3 mrad, three periods in a turn."""
    sine, cosine = (pincal.Term(f"{w}_3", pincal.Harmonic(3, w)) for w in ("sine", "cosine"))
    return with_sensor_terms(machine, {sine: 2e-4, cosine: 2.2e-4})


def plays(machine: pincal.Mechanism) -> pincal.Mechanism:
    """Return a machine whose gears have a play of 0.1 mrad."""
    return with_sensor_terms(machine, {pincal.Term("play", pincal.Share(), of="approach"): 5e-5})


def warms(machine: pincal.Mechanism) -> pincal.Mechanism:
    """Return a machine whose links are 0.05 mm longer at 26 degrees than at 20."""
    basis = pincal.Share(6.0, 20.0)
    terms = {name: pincal.Term(f"{name}_grows", basis, of="temperature") for name in ("l", "L")}
    more = tuple((term.parameter, 5e-5) for term in terms.values())
    legs = tuple(
        replace(leg, terms=tuple(terms.items()), parameters=(*leg.parameters, *more))
        for leg in machine.legs
    )
    return replace(machine, legs=legs)


ERRORS: dict[str, Callable[[pincal.Mechanism], pincal.Mechanism]] = {
    "none": lambda machine: machine,
    "drives give way by 0.1 mrad": gives_way,
    "motors off by 0.3 mrad, thrice a turn": eccentric,
    "play of 0.1 mrad": plays,
    "links grow by 0.05 mm": warms,
}


@dataclass
class Found:
    """What was found of machines with one kind of error."""

    before: list[float]
    """Errors of the platform by geometry alone, [m]."""
    after: list[float]
    """With the terms that explain adds, or the first that is seen."""
    limits: list[float]
    """Promised then, infinite if nothing is."""
    promised: list[bool]
    """Whether a limit was promised by geometry alone."""
    first: Counter[str]
    """What was named first."""


def simulated(study: Study) -> None:
    """Calibrate machines with each error, and with what explains it."""
    count, folds = (1, 2) if study.quick else (20, 5)
    mechanism = drawn()
    candidates = pincal.sample_workspace(mechanism, 3000, study.seed)
    selection = pincal.select_poses(mechanism, candidates, 24, noise=NOISE, seed=study.seed)
    draw = np.random.default_rng(study.seed)
    poses = selection.plan.poses[draw.permutation(len(selection.plan.poses))]
    warm = 20.0 + 6.0 * (1.0 - np.exp(-3.0 * np.linspace(0.0, 1.0, len(poses))))
    plan = pincal.Plan(poses, influences={"temperature": warm})
    there = pincal.sample_workspace(mechanism, 200, study.seed + 1)
    course = {"temperature": draw.uniform(20.0, 26.0, len(there))}
    judged = pincal.Plan(there, influences=course)
    found = {}
    for name, faulty in ERRORS.items():
        study.progress(f"{count} machines: {name}")
        found[name] = Found([], [], [], [], Counter())
        for seed in range(count):
            truth = faulty(pincal.disturb(mechanism, SIGMA, study.seed + seed))
            tried(found[name], mechanism, truth, (plan, judged), study.seed + seed, folds)
    study.heading("Simulated: a 3-RRR upright")
    study.say(
        f"""{len(poses)} poses, chosen for each leg and all used, in a random order, with the
        temperature of a machine that warms up from 20 to 26 degrees; noise of 20 µm, 50 µrad and 20
        µrad on readings, which is given. {count} machines a line, parameters off by 1 mm and 1
        mrad. *Promised*: machines of which a limit of the platform's error is promised. *Named*:
        what `pincal.explain` names first, if its chance is below {LEAST}. *Off*: how far the true
        machine misses poses over the workspace, at any of these temperatures, root mean square,
        median over machines. *Then*: with the terms that pay by held-out rows, or, if none does
        and no limit is promised, the first that is named."""
    )
    study.table(
        "simulated", "By geometry alone, and with what explains the residuals.", _table(found)
    )
    figure, (axes,) = drawing.panels(1, 8.0, 3.6)
    for place, (before, colour, said) in enumerate(
        (("before", drawing.BEFORE, "geometry alone"), ("after", drawing.AFTER, "then"))
    ):
        at = np.arange(len(found)) + 0.36 * place - 0.18
        sizes = [1e6 * float(np.median(getattr(one, before))) for one in found.values()]
        axes.bar(at, sizes, 0.34, color=colour, label=said, hatch=drawing.HATCHES[place])
    limits = [1e6 * float(np.median(one.limits)) for one in found.values()]
    axes.plot(np.arange(len(found)) + 0.18, limits, "k_", ms=18, label="promised then")
    axes.set_xticks(
        range(len(found)), [name.replace(" by", "\nby", 1) for name in found], fontsize=7
    )
    axes.set_ylabel("platform off [µm]")
    axes.legend(fontsize=8)
    study.figure("simulated", "Error of the platform, and what is promised of it", figure)


def tried(
    found: Found,
    mechanism: pincal.Mechanism,
    truth: pincal.Mechanism,
    plans: tuple[pincal.Plan, pincal.Plan],
    seed: int,
    folds: int,
) -> None:
    """Calibrate one machine, explain it, and calibrate it with what explains it."""
    plan, judged = plans
    data = pincal.simulate(mechanism, truth, plan, NOISE, seed=seed).measurements
    given = {name: data.influences[name] for name in plan.influences}
    data = replace(data, influences=given)  # no loads: they are worked out
    answer = pincal.explain(mechanism, data, noise=NOISE, folds=folds)
    result, terms = answer.result, answer.terms
    first = answer.candidates[0]
    seen = first.corrected < LEAST and first.kind.name != "order"
    found.first[f"{first.reading} {first.kind}" if seen else "nothing"] += 1
    if not terms and seen and not result.promises:
        terms = (
            str(first.kind) if first.reading == "readings" else f"{first.reading}={first.kind}",
        )
    then = pincal.calibrate(mechanism, data, noise=NOISE, terms=terms) if terms else result
    found.promised.append(result.promises)
    found.limits.append(then.expected_error(_known(then.identified, judged)).limit[0])
    for sizes, one in ((found.before, result), (found.after, then)):
        sizes.append(pincal.accuracy(one.identified, truth, judged).position)


def _known(machine: pincal.Mechanism, plan: pincal.Plan) -> pincal.Plan:
    """Return a plan with what a machine's terms depend on."""
    names = set(machine.influences) & set(plan.influences)
    return replace(plan, influences={name: plan.influences[name] for name in names})


def _table(found: dict[str, Found]) -> dict[str, list[Cell]]:
    """Return the table of all errors."""
    rows = []
    for name, one in found.items():
        (often, times), count = one.first.most_common(1)[0], len(one.before)
        kept = np.array(one.after) <= np.array(one.limits)
        rows.append(
            (
                name,
                f"{sum(one.promised)} of {count}",
                f"{often} ({times})",
                1e6 * float(np.median(one.before)),
                1e6 * float(np.median(one.after)),
                1e6 * float(np.median(one.limits)),
                f"{int(kept.sum())} of {count}",
            )
        )
    heads = ("error", "promised", "named", "off [µm]", "off then [µm]", "limit then [µm]", "kept")
    return by_rows(heads, rows)


# Real arms


def _file(folder: str, side: str) -> Path:
    return Path(folder or ".") / f"motoman_{side}" / "measurements.csv"


def arm(side: str) -> pincal.Mechanism:
    """Return the arm of the nominal table, with something at its end that weighs."""
    (a, d, alpha, theta), *rest = TABLE
    rows = [(a, d, alpha if side == "left" else -alpha, theta), *rest]
    lines = ["a [m],d [m],alpha [deg],theta [deg]", *(",".join(map(repr, row)) for row in rows)]
    with TemporaryDirectory() as folder:
        table = Path(folder, "dh.csv")
        table.write_text("\n".join(lines), encoding="utf-8")
        made = pincal.new_mechanism("arm", dh=table)
    return replace(made, load=pincal.Load(10.0, (0.0, 0.0, 0.1)))


def arms(study: Study, files: dict[str, Path]) -> None:
    """Compare models of two real arms that a laser tracker measured."""
    study.say(
        """Two arms of seven joints (Motoman), a reflector seen by a laser tracker, its place and
        the arm's unknown; public measurements of ctu-vras/multirobot-calibration. They are read
        where `PINCAL_DATA` says, and are no part of the project. Which model predicts rows that
        its fit has not seen? Masses of links are not known: gravity is that of 10 kg at the
        flange, as a shape."""
    )
    free = pincal.Setup(unknown_frame=True, targets={"platform": pincal.Target(REFLECTOR)})
    for side, path in files.items():
        study.progress(f"models of the {side} arm")
        heads, *rows = path.read_text(encoding="utf-8").splitlines()
        joints = [head.split()[0] for head in heads.split(",") if head.startswith("q_")]
        setup = replace(free, headers={name: f"joint_{i + 1}" for i, name in enumerate(joints)})
        answer = pincal.explain(arm(side), path, noise=SEEN, setup=setup, rough=True)
        models = answer.models
        first = answer.candidates[:3]
        study.table(
            f"motoman_{side}",
            f"The {side} arm, {len(rows)} rows: models on rows held out, five folds; ± is against "
            "the best, in standard deviations of 50 µm.",
            {
                "model": [one.name if i < 2 else f"+ {one.name}" for i, one in enumerate(models)],
                "chosen": ["→" if i == answer.chosen else "" for i in range(len(models))],
                "free": [one.parameters for one in models],
                "held out [σ]": [one.held_out for one in models],
                "±": [one.spread for one in models],
                "held out [mm]": [1e3 * one.position for one in models],
            },
        )
        named = "; ".join(f"{c.reading} {c.kind} ({100 * c.share:.0f} % of χ²)" for c in first)
        gravity = pincal.explain(
            arm(side),
            path,
            noise=SEEN,
            setup=setup,
            rough=True,
            terms="gravity",
        )
        tail = gravity.models[1:]
        said = ", ".join(f"{1e3 * one.position:.4f}" for one in tail)
        study.say(
            f"""Named first: {named}. Gravity on joints' readings alone: {said} mm held out,
            geometry first, then a term more each time."""
        )
