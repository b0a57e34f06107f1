"""What a calibration promises, against data made apart from it: docs/tables/statistics.csv.

    python benchmarks/statistics.py [--sets 40] [--only repeats sizes …]

Closed forms of 5R, 3-RRR and 6-UPS in plain NumPy make the data and say how far the platform is off
(tests/cramer_rao.py). Each line names what was done and gives numbers, over so many data sets.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2, kstest

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
import correlated
import cramer_rao
from cramer_rao import drawn, off
from measured import validated
from resized import scaled

import pincal

Array = NDArray[np.float64]
Lines = Iterator[tuple[str, str]]
NOISE = pincal.Noise(1e-4, 1e-4, 5e-5)
FINE = pincal.Noise(2e-5, 2e-5, 1e-5)
EXACT_READINGS = pincal.Noise(1e-4, 1e-4, 0.0)


# Data


def machine(
    kind: str, count: int = 40, size: float = 2e-3, factor: float = 1.0
) -> cramer_rao.Machine:
    """Return a true machine at poses, its lengths times a factor."""
    one = cramer_rao.machine(kind, count, size)
    if factor == 1.0:
        return one
    nominal, _ = scaled(one.nominal, factor)
    units = [p.unit for p in nominal.parameters]
    by = np.where(np.array(units) == "m", factor, 1.0)
    return replace(
        one, nominal=nominal, parameters=one.parameters * by, positions=one.positions * factor
    )


def part(one: cramer_rao.Machine, rows: Array) -> cramer_rao.Machine:
    """Return a machine at some of its poses."""
    return replace(one, positions=one.positions[rows], rotations=one.rotations[rows])


def repeated(one: cramer_rao.Machine, times: int) -> tuple[cramer_rao.Machine, tuple[str, ...]]:
    """Return a machine with each pose several times in turn, and the poses' names."""
    rows = np.repeat(np.arange(len(one.positions)), times)
    return part(one, rows), tuple(f"p{row}" for row in rows)


# Numbers


def values(result: pincal.CalibrationResult) -> Array:
    """Return identified values, standard errors and interval ends, shape (4, n)."""
    return cramer_rao.values_of(result)


def covers(result: pincal.CalibrationResult, truth: Array) -> float:
    """Return the share of true values within their intervals."""
    _, _, low, high = values(result)
    return float(((low <= truth) & (truth <= high)).mean())


def promise(result: pincal.CalibrationResult, poses: Array) -> float:
    """Return the position error that is promised, [m]: infinite if none is."""
    if not (result.converged and result.promises and result.corrects):
        return np.inf
    found = result.expected_error(poses)
    by = result.excess if not hasattr(result, "promise") else 1.0  # version 0.1 scaled the words
    return by * found.limit[0] if np.isfinite(found.limit[0]) else np.inf


def codes(result: pincal.CalibrationResult) -> set[str]:
    """Return the codes of what was found."""
    return {one.code for one in result.findings}


def percent(given: list[bool] | list[float]) -> str:
    """Return a mean as a percentage with its standard error."""
    found = np.asarray(given, dtype=float)
    error = found.std() / np.sqrt(max(len(found), 1))
    return f"{100 * found.mean():.1f} ± {100 * error:.1f} %"


def tried(work: Callable[[], object]) -> str:
    """Return the kind and beginning of the error that work raises, or "none"."""
    try:
        work()
    except Exception as error:
        return f"{type(error).__name__}: {str(error)[:90]}"
    return "none"


def uniform(p: list[float]) -> str:
    """Return spread, share below 0.05 and Kolmogorov–Smirnov probability of p-values."""
    spread, below = f"standard deviation {np.std(p):.3f} (0.289)", percent([x < 0.05 for x in p])
    return f"{spread}, below 0.05 {below}, KS p {kstest(p, 'uniform').pvalue:.3g}"


# Claims


def repeats(sets: int) -> Lines:
    """1: repeated rows."""
    one, places = repeated(machine("3RRR", 24), 3)
    false, cover, rows, reading = [], [], [], []
    for seed in range(sets):
        data = replace(drawn(one, EXACT_READINGS, seed), places=places)
        result = pincal.calibrate(one.nominal, data)
        false.append("chi2-too-large" in codes(result) or "chi2-too-small" in codes(result))
        cover.append(covers(result, one.parameters))
        rows.append(len(result.outliers))
        reading.append(result.noise.reading if result.noise else np.nan)
    yield (
        "24 poses thrice, readings equal to the last digit: reading noise",
        f"{np.median(reading):.2g}",
    )
    yield "… rows that do not fit, of 72", f"{np.median(rows):.0f}"
    yield "… χ² called wrong", percent(false)
    yield "… intervals of 95 % cover", percent(cover)
    small = machine("3RRR", 30)
    rows_of = np.concatenate((np.arange(len(small.positions)), np.arange(5)))
    few = part(small, rows_of)
    cover, limits = [], []
    for seed in range(4 * sets):
        data = drawn(few, NOISE, seed)
        data = replace(data, places=tuple(f"p{row}" for row in rows_of))
        result = pincal.calibrate(few.nominal, data)
        cover.append(covers(result, few.parameters))
        error = np.sqrt((off(small, values(result)[0]) ** 2).mean())
        limits.append(
            error <= promise(result, small.coordinates(np.zeros((len(small.positions), 3))))
        )
    yield "30 poses, 5 of them twice: intervals of 95 % cover", percent(cover)
    yield "… limits kept", percent(limits)
    data = replace(drawn(one, pincal.Noise(1e-6, 1e-6, 0.0), 0), places=places)
    coarse = replace(data, poses=np.round(data.poses, 5))
    yield (
        "repeats equal at the sensor's resolution, marked by pose: refused",
        tried(lambda: pincal.calibrate(one.nominal, coarse)),
    )


def _chance(result: pincal.CalibrationResult) -> float:
    """Return the probability of the result's χ² or a larger one, by its noise."""
    given = getattr(result, "chi2_p_value", None)
    if given is not None:
        return float(given)
    dof = result.degrees_of_freedom
    return float(chi2.sf(dof * result.reduced_chi2, dof))


def units(sets: int) -> Lines:
    """2: parameters suspected at different sizes."""
    for factor in (1.0, 0.1, 0.01, 0.001):
        found = []
        for seed in range(sets):
            one = cramer_rao.machine("3RRR", 40)
            rng = np.random.default_rng(seed)
            nominal = np.concatenate([leg.nominal for leg in one.nominal.legs])
            one = replace(one, parameters=nominal + 2e-3 * rng.standard_normal(len(nominal)))
            big, by = machine("3RRR", 40, factor=factor), None
            by = np.array([factor if p.unit == "m" else 1.0 for p in one.nominal.parameters])
            one = replace(big, parameters=one.parameters * by)
            noise = pincal.Noise(1e-4 * factor, 1e-4, 5e-5)
            result = pincal.calibrate(one.nominal, drawn(one, noise, seed), noise=noise)
            found.append("far-from-nominal" in codes(result))
        yield (
            f"correct data of a 3-RRR at size {factor:g}: parameters suspected",
            percent(found),
        )


def proportion(sets: int) -> Lines:
    """3: promises with noise in a wrong proportion; of errors: benchmarks/broken_promises.py."""
    one, where = machine("3RRR", 60), machine("3RRR", 90)
    poses = where.coordinates(np.zeros((len(where.positions), 3)))
    kept, passes = [], []
    for seed in range(sets):
        data = drawn(one, pincal.Noise(1.4e-4, 0.4e-4, 5e-5), seed)
        result = pincal.calibrate(one.nominal, data, noise=NOISE)
        error = np.sqrt((off(where, values(result)[0]) ** 2).mean())
        kept.append(error <= promise(result, poses))
        passes.append(not [f for f in result.findings if f.severity != "note"])
    yield (
        "noise given (1, 1), truly (1.4, 0.4): not warned; kept or withdrawn",
        f"{percent(passes)}; {percent(kept)}",
    )


def held_out(sets: int) -> Lines:
    """4: validation of clean and of misspecified data."""
    one = machine("3RRR", 60)
    for name, given in (("given", NOISE), ("estimated", None)):
        p = [
            validated(one.nominal, drawn(one, NOISE, seed), noise=given).p_value
            for seed in range(sets)
        ]
        yield f"clean data, noise {name}: held-out p-values", uniform(p)
    still = np.zeros((len(one.positions), 3))
    waves = 2e-4 * np.sin(3.0 * one.readings(one.parameters, still))
    for name, given in (("given", NOISE), ("estimated", None)):
        found = [
            bool(
                pincal.calibrate(
                    one.nominal,
                    drawn(one, pincal.Noise(5e-5, 5e-5, 2e-5), seed, waves),
                    noise=None if given is None else pincal.Noise(5e-5, 5e-5, 2e-5),
                )
                .validated()
                .contradictions
            )
            for seed in range(sets)
        ]
        yield f"harmonics of 0.2 mrad, noise {name}: validation warns", percent(found)


def order(sets: int) -> Lines:
    """5: drift over a plan with legs in blocks, against the same poses in a mixed order."""
    one = machine("3RRR", 60)
    count = len(one.positions)
    block = np.arange(count) * 3 // count
    names = np.array(one.nominal.leg_names)
    drift = 3e-4 * np.linspace(-1.0, 1.0, count)
    for said, at in (
        ("in blocks", np.arange(count)),
        ("mixed", np.random.default_rng(0).permutation(count)),
    ):
        found = []
        for seed in range(sets):
            time = np.argsort(at)
            data = drawn(one, NOISE, seed, drift[time][:, None])
            data = replace(data, sets=tuple(names[block]))
            result = pincal.calibrate(one.nominal, data, noise=NOISE, method="per-leg")
            found.append(np.sqrt((off(one, values(result)[0]) ** 2).mean()))
        yield (
            f"drift of ± 0.3 mrad, legs {said}, per leg: error of the platform",
            f"{1e6 * np.median(found):.0f} µm",
        )
    for said, legs in (("after leg", names[block]), ("in turns", np.resize(names, count))):
        broken, withdrawn = 0, 0
        for seed in range(sets):
            data = drawn(one, FINE, seed)
            moved = data.poses + np.linspace(0.0, 2e-4, count)[:, None] * [1.0, 0.0, 0.0]
            data = replace(data, poses=moved, sets=tuple(legs))
            result = pincal.calibrate(one.nominal, data, noise=FINE, method="per-leg")
            limit = promise(result, moved)
            withdrawn += not np.isfinite(limit)
            broken += np.sqrt((off(one, values(result)[0]) ** 2).mean()) > limit
        yield (
            f"tracker drifts by 0.2 mm, noise 20 µm, leg {said}: broken; withdrawn",
            f"{broken}; {withdrawn}",
        )


def shared(sets: int) -> Lines:
    """6: χ² of per-leg fits that share poses."""
    one = machine("6UPS", 60)
    p, reduced, dof = [], [], 1
    for seed in range(sets):
        result = pincal.calibrate(
            one.nominal, drawn(one, NOISE, seed), noise=NOISE, method="per-leg", poses="all"
        )
        p.append(_chance(result))
        dof = result.degrees_of_freedom
        reduced.append(result.reduced_chi2)
    yield (
        "6-UPS, each leg alone by all poses: variance of χ² over that of χ²",
        f"{np.var(reduced) * dof / 2:.2f}",
    )
    yield "… p-values", uniform(p)
    yield "… called wrong at 5 %", percent([(x < 0.025) or (x > 0.975) for x in p])


def sizes(sets: int) -> Lines:
    """7, 11: the same machine and data at other sizes; priors."""
    reference: list[Array] = []
    for factor in (1.0, 1e-3, 1e-2, 1e2):
        one, found, std, said = machine("3RRR", 40, factor=factor), [], [], set()
        by = np.array([factor if p.unit == "m" else 1.0 for p in one.nominal.parameters])
        for seed in range(min(sets, 10)):
            data = drawn(one, pincal.Noise(1e-4 * factor, 1e-4, 0.0), seed)
            try:
                result = pincal.calibrate(one.nominal, data)
            except pincal.PincalError as error:
                said.add(str(error)[:60])
                continue
            found.append(values(result)[0] / by)
            std.append(values(result)[1] / by)
            said |= codes(result)
        if factor == 1.0:
            reference = [np.array(found), np.array(std)]
            said_first = said
            continue
        if len(found) != len(reference[0]):
            yield f"size {factor:g}", f"refused: {said}"
            continue
        move = np.abs((np.array(found) - reference[0]) / reference[1]).max()
        ratio = (np.array(std) / reference[1]).max()
        yield (
            f"3-RRR at size {factor:g}: largest change in σ; ratio of σ; findings",
            f"{move:.2g}; {ratio:.6f}; {'the same' if said == said_first else said ^ said_first}",
        )
    for factor in (1.0, 1e-3, 1e2):
        one = machine("3RRR", 40, factor=factor)
        by = np.array([factor if p.unit == "m" else 1.0 for p in one.nominal.parameters])
        data = drawn(one, pincal.Noise(1e-4 * factor, 1e-4, 0.0), 0)
        data = replace(data, poses=_moved(data.poses, factor))
        setup = pincal.Setup(unknown_frame=True)
        result = pincal.calibrate(one.nominal, data, setup=setup, rough=True)
        if factor == 1.0:
            first = values(result) / by
            continue
        change = np.abs((values(result)[0] / by - first[0]) / first[1]).max()
        yield f"unknown frame at size {factor:g}: largest change in σ", f"{change:.2g}"
    for noise in (1e-6, 1e-4):
        one = machine("3RRR", 40)
        error = []
        for seed in range(min(sets, 10)):
            data = drawn(one, pincal.Noise(noise, noise, 0.0), seed)
            result = pincal.calibrate(one.nominal, data, priors={"l": 1e-4})
            error.append(np.sqrt((off(one, values(result)[0]) ** 2).mean()))
        yield (
            f"prior of 0.1 mm on l (truly 2 mm off), noise {noise:g} not given: error",
            f"{1e6 * np.median(error):.3g} µm",
        )


def _moved(poses: Array, factor: float) -> Array:
    c, s = np.cos(0.5), np.sin(0.5)
    moved = poses.copy()
    moved[:, :2] = poses[:, :2] @ np.array([[c, s], [-s, c]]) + factor * np.array([1.0, 2.0])
    moved[:, 2] += 0.5
    return moved


def robust(sets: int) -> Lines:
    """8: rejection of rows wrong by thirty standard deviations, and by ten."""
    for kind, method, given in (
        ("5R", "all-legs", NOISE),
        ("5R", "per-leg", NOISE),
        ("5R", "all-legs", None),
        ("3RRR", "all-legs", NOISE),
        ("3RRR", "all-legs", None),
    ):
        one = machine(kind, 60)
        for share, size in ((0.0, 3e-3), (0.05, 3e-3), (0.2, 3e-3), (0.2, 1e-3)):
            cover, held = [], []
            for seed in range(sets):
                data = _spoiled(one, seed, share, size)
                result = pincal.calibrate(
                    one.nominal, data, noise=given, method=method, poses="all", loss="reject"
                )
                cover.append(covers(result, one.parameters))
                held.append(result.promises)
            said = "noise given" if given else "noise estimated"
            yield (
                f"{kind}, {method}, {said}: {share:.0%} off by {1e3 * size:g} mm: "
                f"intervals cover; promised ({sets} sets)",
                f"{percent(cover)}; {percent(held)}",
            )


def _spoiled(one: cramer_rao.Machine, seed: int, share: float, size: float) -> pincal.Measurements:
    """Return data of which a share of the poses has gross errors of a size."""
    rng, data = np.random.default_rng(seed + 10**6), drawn(one, NOISE, seed)
    wrong = rng.permutation(len(data))[: round(share * len(data))]
    poses = data.poses.copy()
    poses[wrong] += size * rng.standard_normal((len(wrong), one.dof))
    return replace(data, poses=poses)


def chances(sets: int) -> Lines:
    """3: χ² and held-out rows of clean data: p-values."""
    for kind, method in product(("5R", "3RRR", "6UPS"), ("all-legs", "per-leg")):
        one, chi, held = machine(kind, 40), [], {"region": [], "turn": []}
        for seed in range(sets):
            options: dict[str, object] = {"noise": NOISE, "method": method, "poses": "all"}
            data = drawn(one, NOISE, seed)
            chi.append(_chance(pincal.calibrate(one.nominal, data, **options)))
            for by, found in held.items():
                found.append(validated(one.nominal, data, by=by, **options).p_value)
        yield f"clean {kind}, {method}: χ² p-values ({sets} sets)", uniform(chi)
        for by, found in held.items():
            yield f"… held-out rows by {by}", uniform(found)


def estimated(sets: int) -> Lines:
    """3: noise that is not given: intervals."""
    for kind, count, noise in (
        ("3RRR", 60, NOISE),
        ("3RRR", 40, NOISE),
        ("5R", 60, NOISE),
        ("6UPS", 40, NOISE),
        ("3RRR", 60, EXACT_READINGS),
        ("3RRR", 60, pincal.Noise(2e-5, 2e-5, 1e-3)),
    ):
        one = machine(kind, count)
        cover = [
            covers(pincal.calibrate(one.nominal, drawn(one, noise, seed)), one.parameters)
            for seed in range(sets)
        ]
        yield f"{kind}, {count} poses, {noise}, estimated: intervals cover", percent(cover)


def swapped(sets: int) -> Lines:
    """9: two rows swapped."""
    for loss in ("reject", "none"):
        found = [_swapped(seed, loss) for seed in range(sets)]
        names = [one for one, _ in found]
        wrong = {one: names.count(one) for one in set(names)}
        gain = max(one for _, one in found)
        yield f"two rows swapped, {loss}: errors raised; largest gain", f"{wrong}; {gain:.3g}"


def _swapped(seed: int, loss: str) -> tuple[str, float]:
    """Return the kind of error that two swapped rows raise, and the largest gain found."""
    one, gains = machine("3RRR", 40), []
    data = drawn(one, EXACT_READINGS, seed)
    i, j = np.random.default_rng(seed).permutation(len(one.positions))[:2]
    readings = data.readings.copy()
    readings[[i, j]] = readings[[j, i]]

    def work() -> None:
        swapped = replace(data, readings=readings)
        result = pincal.calibrate(one.nominal, swapped, loss=loss, noise=EXACT_READINGS)
        gains.append(max(abs(p.identified) for p in result.parameters if p.unit == "1"))

    return tried(work).partition(":")[0], max(gains, default=1.0)


def rows(sets: int) -> Lines:
    """10: anything found in clean data."""
    for count, draws in ((100, sets), (10_000, max(sets // 5, 4))):
        for kind, given in product(("5R", "3RRR"), (NOISE, None)):
            one, found, other = machine(kind, count), [], []
            for seed in range(draws):
                result = pincal.calibrate(one.nominal, drawn(one, NOISE, seed), noise=given)
                found.append(bool(result.outliers))
                other.append(bool(codes(result) - {"noise-estimated"}))
            said = "given" if given else "estimated"
            yield (
                f"clean {kind}, {len(one.positions)} rows, noise {said}: rows suspected; "
                f"any warning ({draws} sets)",
                f"{percent(found)}; {percent(other)}",
            )


def families(sets: int) -> Lines:
    """10: promises withdrawn from clean data of other machines."""
    for kind in ("6UPS", "3PUU", "3PRR", "6RUS", "3RPS", "delta"):
        plan = pincal.sample_configurations(kind, 40, 0)
        truth, alarms = pincal.disturb(kind, 1e-3, seed=1), []
        for seed in range(sets):
            data = pincal.simulate(kind, truth, plan, NOISE, seed).measurements
            alarms.append(not pincal.calibrate(kind, data, noise=NOISE).promises)
        yield f"clean {kind}, 40 rows: contradicted", percent(alarms)


def sines(sets: int) -> Lines:
    """10: a sine in one reading of a 6-UPS, a third of χ²."""
    one, named = machine("6UPS", 40), []
    psi = one.readings(one.parameters, np.zeros((len(one.positions), 6)))
    for seed in range(sets):
        waves = np.zeros_like(psi)
        waves[:, 1] = 1.55e-4 * np.sin(2 * np.pi * psi[:, 1] / np.ptp(psi[:, 1]) * 2)
        result = pincal.calibrate(one.nominal, drawn(one, NOISE, seed, waves), noise=NOISE)
        lacks = [str(f.values) for f in result.findings if f.code == "model-lacks"]
        named.append((any("leg_2" in values for values in lacks), result.reduced_chi2))
    hits, squares = zip(*named, strict=True)
    yield f"6-UPS, a sine in leg 2 (χ² {np.mean(squares):.2f}): named", percent(list(hits))


def limits(sets: int) -> Lines:
    """13: promises and intervals of few poses and much noise."""
    for kind, count, noise in product(("5R", "3RRR", "6UPS"), (16, 24), (3e-4, 1e-3)):
        one, kept, cover, said = machine(kind, count), [], [], pincal.Noise(noise, noise, 0.0)
        poses = one.coordinates(np.zeros((len(one.positions), one.dof)))
        for seed in range(sets):
            try:
                result = pincal.calibrate(one.nominal, drawn(one, said, seed), noise=said)
            except pincal.PincalError:
                continue
            missed = np.sqrt((off(one, values(result)[0]) ** 2).mean())
            kept.append(missed <= promise(result, poses))
            cover.append(covers(result, one.parameters))
        yield (
            f"{kind}, {count} poses, {1e3 * noise:g} mm, {len(kept)} sets: limit kept; cover",
            f"{percent(kept)}; {percent(cover)}",
        )


def curved(sets: int) -> Lines:
    """13: noise so large that the problem is curved."""
    for count, noise in ((24, 1e-3), (24, 1e-4)):
        one = machine("3RRR", count)
        joint, warned = [], []
        for seed in range(sets):
            data = drawn(one, pincal.Noise(noise, noise, 0.0), seed)
            try:
                result = pincal.calibrate(one.nominal, data, noise=pincal.Noise(noise, noise, 0.0))
            except pincal.PincalError:
                continue
            d = values(result)[0] - one.parameters
            weights, axes = np.linalg.eigh(result.covariance)
            determined = weights > 1e-12 * weights[-1]
            joint.append((((d @ axes) ** 2)[determined] / weights[determined]).mean())
            warned.append("curved" in codes(result))
        yield (
            f"{count} poses, {1e3 * noise:g} mm: joint square of errors per parameter (1); warned",
            f"{np.mean(joint):.2f}; {percent(warned)}",
        )


def polar(sets: int) -> Lines:
    """12: what a tracker's range and angles measure, taken as such or as independent."""
    one = machine("6UPS", 40)
    covariance = np.zeros((len(one.positions), 6, 6))
    covariance[:, :3, :3] = correlated.polar_covariance(one.positions, correlated.TRACKER)
    covariance[:, 3:, 3:] = 1e-8 * np.eye(3)
    least, squares, cover = correlated.bound(one, covariance, 1e-6), ([], []), []
    setups = (pincal.Setup(), pincal.Setup(tracker=correlated.TRACKER))
    turns = np.where(np.arange(6) < 3, np.nan, 1e-4 * np.ones((len(covariance), 6)))
    for seed in range(sets):
        plain = correlated.correlated(one, covariance, 1e-6, seed)
        rows = (plain, replace(plain, sigma_poses=turns))
        for own, data, setup in zip(squares, rows, setups, strict=True):
            result = pincal.calibrate(one.nominal, data, setup=setup)
            own.append((((values(result)[0] - one.parameters) / least) ** 2).mean())
        cover.append(covers(result, one.parameters))
    without, known = (np.sqrt(np.mean(own)) for own in squares)
    yield (
        "6-UPS, range to 2 µm, angles to 20 µrad: error over the bound, independent, by tracker; "
        "intervals cover",
        f"{without:.3f}, {known:.3f}; {percent(cover)}",
    )


def scale(sets: int) -> Lines:
    """An instrument whose scale is off, as its data sheet says it may be."""
    one = machine("3RRR", 40)
    poses = one.coordinates(np.zeros((len(one.positions), 3)))
    said = pincal.Setup(systematic=pincal.Systematic(scale=3e-4))
    kept = ([], [])
    for seed in range(sets):
        by = 3e-4 * np.random.default_rng([seed, 1]).standard_normal()
        data = correlated.scaled(drawn(one, NOISE, seed), by)
        for own, setup in zip(kept, (pincal.Setup(), said), strict=True):
            result = pincal.calibrate(one.nominal, data, noise=NOISE, setup=setup)
            missed = off(one, values(result)[0])
            own.append(np.sqrt((missed**2).mean()) <= promise(result, poses))
    yield (
        "3-RRR, scale of the instrument 300 µm/m: limit kept without saying so, with",
        f"{percent(kept[0])}, {percent(kept[1])}",
    )


def steps(sets: int) -> Lines:
    """14: an encoder that slips by a tooth."""
    one = machine("3RRR", 60)
    count = len(one.positions)
    named, where, false = [], [], []
    for seed in range(sets):
        slip = np.zeros((count, 3))
        slip[count // 2 :, 1] = 1e-3
        result = pincal.calibrate(one.nominal, drawn(one, NOISE, seed, slip), noise=NOISE)
        hits = [f for f in result.findings if f.code == "step"]
        named.append(any("leg_2" in str(f.values) for f in hits))
        where += [abs(f.rows[0] - count // 2) <= 2 for f in hits]
        clean = pincal.calibrate(one.nominal, drawn(one, NOISE, seed), noise=NOISE)
        false.append(any(f.code == "step" for f in clean.findings))
    yield (
        "leg 2 slips by 1 mrad halfway: leg named; row within 2; false alarms",
        f"{percent(named)}; {percent(where) if where else '—'}; {percent(false)}",
    )


CLAIMS: dict[str, Callable[[int], Lines]] = {
    one.__name__: one
    for one in (
        repeats, units, proportion, chances, held_out, order, shared, sizes, robust, estimated,
        swapped, rows, polar, scale, curved, steps, families, sines, limits,
    )
}  # fmt: skip


def main() -> None:
    """Print the table in Markdown."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sets", type=int, default=40, help="data sets (default: 40)")
    parser.add_argument("--only", nargs="+", choices=CLAIMS, default=list(CLAIMS))
    given = parser.parse_args()
    print("| claim | measured |\n|---|---|")
    for name in given.only:
        for what, found in CLAIMS[name](given.sets):
            print(f"| {what} | {found} |", flush=True)


if __name__ == "__main__":
    main()
