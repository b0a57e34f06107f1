"""Calibration and its findings are equivariant: they go with size, names, order, frames, mirrors.

A calibration of a random machine is done again of the machine in other units, under other names,
in another order, somewhere else, and seen in a mirror. Parameters, standard errors, limits and χ²
are transformed, findings are the same.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from marks import quick
from moved import moved, random_motion
from numpy.typing import NDArray
from random_mechanisms import KINDS, poses_near_home, random_mechanism
from resized import scaled

import pincal
from pincal import Element, Measurements, Mechanism, Setup
from pincal.symmetry.carry import carry
from pincal.symmetry.elements import isometry

Array = NDArray[np.float64]
Generator = np.random.Generator
#: Cases of the quick run: legs alone, one that is refused, an unknown frame, rows left out.
QUICK = (12, 31, 34, 65)
BUNDLED = ("5R", "3RRR", "6UPS", "delta", "3PRR")
SAME = 1e-5  # relative
STEPS = 1e-4  # of a standard error; frames of legs alone are found to less
BY_AXIS = frozenset(
    {"step", "model-lacks", "reference-moved"}
)  # asked of x, y and z as they were measured


@dataclass(frozen=True)
class Case:
    """A machine, what was measured of it and how it is calibrated."""

    mechanism: Mechanism
    data: Measurements
    options: dict[str, Any]

    def result(self) -> pincal.CalibrationResult | pincal.PincalError:
        """Return its calibration, or why there is none."""
        try:
            return pincal.calibrate(self.mechanism, self.data, **self.options)
        except pincal.PincalError as error:
            return error


@dataclass(frozen=True)
class Changed:
    """A case seen otherwise, and what becomes of each parameter."""

    case: Case
    ids: dict[str, str]
    """Of each parameter, by its id before."""
    factors: dict[str, float]
    """Of its change; negative where a mirror turns it round, whose ends change places then."""
    apart: frozenset[str] = frozenset()
    """Codes of findings that need not be the same."""


def random_case(seed: int) -> Case:
    """Return a machine that differs from its drawing, measured with noise, sometimes wrongly."""
    rng = np.random.default_rng(seed)
    kind = str(rng.choice([*KINDS, *BUNDLED]))
    if kind in KINDS:
        mechanism = random_mechanism(kind, int(rng.choice(KINDS[kind][0])), seed)
    else:
        mechanism = pincal.load_mechanism(kind)
    drawn = np.array([p.nominal for p in mechanism.parameters])
    true = drawn + 1e-3 * mechanism.legs[0].size * rng.standard_normal(len(drawn))
    truth = mechanism.with_parameters(dict(zip(mechanism.parameters.ids, true, strict=True)))
    poses = poses_near_home(mechanism, 60, seed, 0.35 * mechanism.legs[0].size)
    there = pincal.inverse(truth, poses)
    poses, readings = poses[there.reached.all(axis=1)], there.readings[there.reached.all(axis=1)]
    size = 10.0 ** rng.uniform(-6.0, -3.0) * mechanism.legs[0].size
    how = str(rng.choice(["rows", "estimated", "too small"]))
    if len(set(mechanism.reading_units)) > 1:  # one noise of radians and metres has no other unit
        how = "rows"
    noisy = (0.0 if how == "estimated" else 0.3) * size
    if rng.uniform() < 0.2:  # a drift of one reading
        readings[:, 0] += 5.0 * size * np.linspace(-1.0, 1.0, len(poses))
    if rng.uniform() < 0.2:  # gross errors
        poses[rng.choice(len(poses), 2, replace=False), 0] += 30.0 * size
    if rng.uniform() < 0.1:  # a sign
        readings[:, -1] *= -1.0
    data = Measurements(
        mechanism.platform.moved(poses, size * rng.standard_normal(poses.shape)),
        readings=readings + noisy * rng.standard_normal(readings.shape),
    )
    if how != "estimated":
        by = 1.0 if how == "rows" else 0.5
        data = replace(
            data,
            sigma_poses=np.full(poses.shape, by * size),
            sigma_readings=np.full(readings.shape, by * noisy),
        )
    options: dict[str, Any] = {"method": str(rng.choice(["all-legs", "all-legs", "per-leg"]))}
    options["loss"] = str(rng.choice(["none", "none", "reject"]))
    if rng.uniform() < 0.3 and options["method"] == "all-legs":
        options["setup"] = Setup(unknown_frame=True)
    return Case(mechanism, data, options)


def same_ids(mechanism: Mechanism) -> dict[str, str]:
    """Return that no parameter has another name."""
    return {one: one for one in mechanism.parameters.ids}


def other_size(case: Case, rng: Generator) -> Changed:
    """Return the case in another unit of length."""
    by = 10.0 ** rng.uniform(-3.0, 2.0)
    mechanism, factors = scaled(case.mechanism, by)
    readings = np.array([by if unit == "m" else 1.0 for unit in mechanism.reading_units])
    data, given = case.data, case.data.sigma_poses is not None
    data = replace(
        data,
        poses=factors * data.poses,
        readings=readings * data.readings,
        sigma_poses=factors * data.sigma_poses if given else None,
        sigma_readings=readings * data.sigma_readings if given else None,
    )
    units = {p.id: by if p.unit == "m" else 1.0 for p in mechanism.parameters}
    return Changed(replace(case, mechanism=mechanism, data=data), same_ids(mechanism), units)


def other_names(case: Case, rng: Generator) -> Changed:
    """Return the case with other names of legs and parameters."""
    names = rng.permutation(20)
    legs, ids = [], {}
    for i, leg in enumerate(case.mechanism.legs):
        new = {name: f"q{names[j]}_{i}" for j, name in enumerate(leg.parameter_names)}
        legs.append(renamed(leg, f"arm{names[i]}", new))
        ids |= {f"{leg.name}.{old}": f"{legs[-1].name}.{one}" for old, one in new.items()}
    return Changed(
        replace(case, mechanism=replace(case.mechanism, legs=tuple(legs))),
        ids,
        dict.fromkeys(ids, 1.0),
    )


def renamed(leg: pincal.Leg, name: str, new: dict[str, str]) -> pincal.Leg:
    """Return a leg whose parameters have other names."""

    def said(value: Any) -> Any:
        return new.get(value, value) if isinstance(value, str) else value

    def joint(one: pincal.Joint) -> pincal.Joint:
        coordinates = tuple(
            replace(c, values=tuple(said(value) for value in c.values))
            for c in one.placement.coordinates
        )
        return replace(one, placement=replace(one.placement, coordinates=coordinates))

    return replace(
        leg,
        name=name,
        joints=tuple(joint(one) for one in leg.joints),
        point=joint(leg.point),
        sensors=tuple(replace(s, gain=said(s.gain), offset=said(s.offset)) for s in leg.sensors),
        parameters=tuple((new[one], value) for one, value in leg.parameters),
    )


def other_order(case: Case, rng: Generator) -> Changed:
    """Return the case with legs, their parameters and rows in another order."""
    order = rng.permutation(len(case.mechanism.legs))
    legs = [case.mechanism.legs[i] for i in order]
    legs = [
        replace(
            leg, parameters=tuple(leg.parameters[i] for i in rng.permutation(len(leg.parameters)))
        )
        for leg in legs
    ]
    mechanism, data = replace(case.mechanism, legs=tuple(legs)), case.data
    given = data.sigma_readings is not None
    data = replace(
        data,
        readings=data.readings[:, order],
        sigma_readings=data.sigma_readings[:, order] if given else None,
    ).rows(np.arange(len(data))[::-1])  # a step in time stays one
    ids = same_ids(mechanism)
    return Changed(replace(case, mechanism=mechanism, data=data), ids, dict.fromkeys(ids, 1.0))


def other_place(case: Case, rng: Generator) -> Changed:
    """Return the case in a base frame that stands elsewhere; the platform's is turned."""
    platform = case.mechanism.platform
    base, body = random_motion(platform, rng)
    body[:3, 3] = 0.0
    mechanism = moved(case.mechanism, base, body)
    matrices = base @ platform.matrices(case.data.poses) @ np.linalg.inv(body)
    data = replace(case.data, poses=platform.from_matrices(matrices))
    ids = same_ids(mechanism)
    then = replace(case, mechanism=mechanism, data=data)
    return Changed(then, ids, dict.fromkeys(ids, 1.0), BY_AXIS)


def mirrored(case: Case, rng: Generator) -> Changed:
    """Return the case seen in a mirror across a coordinate plane."""
    plane = case.mechanism.platform.space == 2
    axes = np.eye(3)
    axes[int(rng.integers(2 if plane else 3))] *= -1.0
    plane_of = isometry(axes)
    mirror = Element.of(plane_of, plane_of)

    def image(one: Mechanism) -> Mechanism:
        legs = tuple(carry(leg, mirror) for leg in one.legs)
        home = mirror.poses(one.platform, np.array([one.platform.home]))[0]
        platform = replace(one.platform, home=tuple(home.tolist()))
        return replace(one, legs=legs, platform=platform)

    mechanism = image(case.mechanism)
    step = {p.id: p.nominal + 1e-3 for p in case.mechanism.parameters}
    there = image(case.mechanism.with_parameters(step)).parameters
    factors = {p.id: float(np.sign(there[p.id].nominal - p.nominal)) for p in mechanism.parameters}
    data = replace(case.data, poses=mirror.poses(mechanism.platform, case.data.poses))
    then = replace(case, mechanism=mechanism, data=data)
    return Changed(then, same_ids(mechanism), factors)


Change = Callable[[Case, Generator], Changed]
CHANGES: tuple[Change, ...] = (
    other_size,
    other_names,
    other_order,
    other_place,
    mirrored,
)


@cache
def known(seed: int) -> tuple[Case, pincal.CalibrationResult | pincal.PincalError]:
    """Return a random case and its calibration."""
    case = random_case(seed)
    return case, case.result()


def assert_goes_with(
    first: pincal.CalibrationResult | pincal.PincalError, changed: Changed
) -> None:
    """Check that a result is the one of the case before, transformed, and an error the same."""
    then = changed.case.result()
    if isinstance(first, pincal.PincalError) or isinstance(then, pincal.PincalError):
        assert type(then) is type(first)
        if set(changed.ids.values()) == set(changed.ids):  # legs may be named in another order
            assert sorted(re.findall(r"\w+", str(then))) == sorted(re.findall(r"\w+", str(first)))
        return
    codes = [
        [one.code for one in r.findings if one.code not in changed.apart] for r in (first, then)
    ]
    assert codes[0] == codes[1]
    assert then.converged == first.converged
    assert then.reduced_chi2 == pytest.approx(first.reduced_chi2, rel=SAME)
    assert then.degrees_of_freedom == first.degrees_of_freedom
    assert len(then.outliers) == len(first.outliers)
    for p in (p for leg in first.legs for p in leg.parameters):
        now, by = then[changed.ids[p.id]], changed.factors[p.id]
        assert now.std == pytest.approx(abs(by) * p.std, rel=SAME), p.id
        rounding = 1e-12 * max(1.0, abs(p.nominal)) * abs(by)
        ends = sorted(by * (end - p.nominal) for end in (p.low, p.high))
        for found, wanted in zip(
            (now.change, now.low - now.nominal, now.high - now.nominal),
            (by * p.change, *ends),
            strict=True,
        ):
            assert abs(found - wanted) <= STEPS * abs(by) * p.std + rounding, p.id


@pytest.mark.parametrize("change", CHANGES, ids=lambda one: one.__name__)
@pytest.mark.parametrize("seed", quick(1, QUICK))
def test_calibration_goes_with(change: Change, seed: int) -> None:
    """Answers are transformed with the machine and its measurements, findings are the same."""
    case, first = known(seed)
    assert_goes_with(first, change(case, np.random.default_rng(seed)))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1, 2, 4, 7])  # the others take five times as long
def test_calibration_of_any_machine_goes_with(seed: int) -> None:
    """The same of many machines."""
    case, rng = random_case(seed), np.random.default_rng(seed)
    first = case.result()
    for change in CHANGES:
        assert_goes_with(first, change(case, rng))
