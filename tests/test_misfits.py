"""What explains measurements that do not fit: in unknown frames, zeros of motors, bad rows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from marks import quick
from measured import check_plausible, machine, put, seen_from_elsewhere

import pincal
from pincal import Options
from pincal.calibration.calibration import Calibration
from pincal.calibration.hypotheses.plausibility import explain_misfit
from pincal.estimation.observability.identifiable import DIFFER, plausible_changes
from pincal.show.misses import errors_at
from pincal.words.findings import sentences

FRAME = pincal.Setup(unknown_frame=True)
PLAIN = pincal.Setup()
KINDS = ["5R", "3RRR", "6UPS"]
Change = Callable[[pincal.Mechanism, pincal.Measurements], pincal.Measurements]


@cache
def sound(kind: str, free: bool) -> tuple[pincal.Mechanism, pincal.Measurements]:
    """Return a machine and its sound measurements, in an unknown frame if free: nothing is found.

    Of all faults that are tried on a machine: what is said of sound measurements is asked once.
    """
    mechanism, _, data = machine(kind, 36)
    data = seen_from_elsewhere(mechanism, data) if free else data
    assert misfit(mechanism, data, FRAME if free else PLAIN) == ()
    return mechanism, data


def misfit(
    mechanism: pincal.Mechanism, data: pincal.Measurements, setup: pincal.Setup = PLAIN
) -> tuple[pincal.Finding, ...]:
    """Return what would explain that measurements do not fit."""
    return explain_misfit(Calibration(mechanism, data, Options(setup=setup)))


def scaled(poses: float, readings: float) -> Change:
    """Return what scales positions and readings."""

    def change(mechanism: pincal.Mechanism, data: pincal.Measurements) -> pincal.Measurements:
        by = [poses if unit == "m" else 1.0 for unit in mechanism.platform.units]
        return replace(data, poses=data.poses * by, readings=data.readings * readings)

    return change


def zero(column: int, off: float) -> Change:
    """Return what adds a constant to the readings of a leg."""

    def change(_: pincal.Mechanism, data: pincal.Measurements) -> pincal.Measurements:
        readings = data.readings.copy()
        readings[:, column] += off
        return replace(data, readings=readings)

    return change


def rolled(rows: int) -> Change:
    """Return what moves readings down by rows."""
    return lambda _, data: replace(data, readings=np.roll(data.readings, rows, axis=0))


def order(*columns: int) -> Change:
    """Return what puts the first columns of readings in another order."""

    def change(_: pincal.Mechanism, data: pincal.Measurements) -> pincal.Measurements:
        rest = range(len(columns), data.readings.shape[1])
        return replace(data, readings=data.readings[:, [*columns, *rest]])

    return change


def sign(column: int) -> Change:
    """Return what changes the sign of one leg's readings."""

    def change(_: pincal.Mechanism, data: pincal.Measurements) -> pincal.Measurements:
        readings = data.readings.copy()
        readings[:, column] *= -1.0
        return replace(data, readings=readings)

    return change


ANYWHERE: list[tuple[str, Change, str, str]] = [
    *((kind, scaled(1e3, 1.0), "unit", "the positions are in mm under") for kind in KINDS),
    ("5R", scaled(1.0, 180 / np.pi), "unit", "the readings are in degrees under"),
    ("3RRR", scaled(1.0, 180 / np.pi), "unit", "the readings are in degrees under"),
    ("6UPS", scaled(1.0, 1e3), "unit", "the readings are in mm under"),
    ("5R", rolled(1), "rows-shifted", "1 row below their poses"),
    *((kind, rolled(-1), "rows-shifted", "1 row above their poses") for kind in ("3RRR", "6UPS")),
    *((kind, order(1, 0), "legs-exchanged", "column leg_2 fits leg_1") for kind in KINDS[1:]),
    ("3RRR", sign(1), "sign-of-readings", "the readings of leg_2 have the opposite sign"),
    ("6UPS", sign(4), "sign-of-readings", "the readings of leg_5 have the opposite sign"),
    ("5R", zero(0, 0.3), "reading-offset", "leg_1 by about"),
    ("3RRR", zero(1, 0.3), "reading-offset", "leg_2 by about"),
    ("6UPS", zero(3, 0.2), "reading-offset", "leg_4 by about"),
]


def _marks(kind: str, code: str, free: bool) -> list[pytest.MarkDecorator]:
    """Return the mark of slow cases: hexapods, and unknown frames of the 3-RRR.

    Others in unknown frames have no fault of their own: all but two are tried with -m fuzz.
    """
    if free and (kind, code) not in {("6UPS", "legs-exchanged"), ("5R", "unit")} and kind != "3RRR":
        return [pytest.mark.fuzz]
    quick = {"5R": ("reading-offset", False), "3RRR": ("rows-shifted", False), "6UPS": ("", False)}
    slow = (code, free) != quick[kind]
    return [pytest.mark.slow] if slow else []


CASES = [
    pytest.param(*case, free, marks=_marks(case[0], case[2], free))
    for case in ANYWHERE
    for free in (False, True)
]


@pytest.mark.parametrize(("kind", "change", "code", "words", "free"), CASES)
def test_faults_are_named_in_known_and_unknown_frames(
    kind: str, change: Change, code: str, words: str, free: bool
) -> None:
    """Units, shifts, orders, signs and zeros, these about as well as the drawing."""
    (mechanism, data), setup = sound(kind, free), FRAME if free else PLAIN
    wrong = change(mechanism, data)  # one object: what explains it is sought once
    found = misfit(mechanism, wrong, setup)
    assert code in [one.code for one in found]
    assert words in sentences(found)[0]
    assert len(found) <= 2
    if code == "reading-offset":
        off = (wrong.readings - data.readings).sum() / 36
        assert found[0].values["offsets"][0][1] == pytest.approx(off, abs=0.06)
    with pytest.raises(pincal.MeasurementError) as caught:
        check_plausible(mechanism, wrong, setup)
    assert str(caught.value) == sentences(found)[0]


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_poses_in_another_frame_are_recognised(kind: str) -> None:
    """Full poses of a tracker that stands elsewhere lead to --unknown-frame, alone or with more."""
    mechanism, _, data = machine(kind, 36)
    moved = seen_from_elsewhere(mechanism, data)
    with pytest.raises(
        pincal.MeasurementError, match=r"another frame than the base's.*--unknown-f"
    ):
        check_plausible(mechanism, moved)
    (one,) = misfit(mechanism, rolled(1)(mechanism, moved))
    assert one.code == "rows-shifted"
    assert "--unknown-frame" in sentences((one,))[0]


@pytest.mark.parametrize("kind", quick(1, KINDS))
@pytest.mark.parametrize("free", quick(1, [False, True]))
def test_positions_alone_are_explained_after_a_fit(kind: str, free: bool) -> None:
    """Without orientations nothing is refused beforehand, but what is wrong is found."""
    mechanism, _, data = machine(kind, 36)
    data = seen_from_elsewhere(mechanism, data) if free else data
    setup = FRAME if free else pincal.Setup()
    data = put(data, "poses", np.s_[:, mechanism.platform.space :], np.nan)
    assert misfit(mechanism, data, setup) == ()
    for right, code in ((rolled(1), "rows-shifted"), (scaled(1e3, 1.0), "unit")):
        assert code in [o.code for o in misfit(mechanism, right(mechanism, data), setup)]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", quick(2, range(5)))
def test_healthy_measurements_in_unknown_frames_pass(kind: str, seed: int) -> None:
    """Nothing is found where nothing is wrong."""
    mechanism, _, data = machine(kind, 36, seed=seed, sigma=(2e-3, 5e-3)[seed % 2])
    data = seen_from_elsewhere(mechanism, data)
    check_plausible(mechanism, data, FRAME)
    assert misfit(mechanism, data, FRAME) == ()


def test_zeros_of_all_motors_are_found() -> None:
    """Zeros 0.7, 0.2 and -1.6 rad off: each leg's, within what the drawing is off by."""
    mechanism, _, data = machine("3RRR", 36)
    off = np.array([0.7, 0.2, -1.6])
    (one,) = misfit(mechanism, replace(data, readings=data.readings + off))
    assert one.code == "reading-offset"
    np.testing.assert_allclose([value for _, value, _ in one.values["offsets"]], off, atol=0.02)


@pytest.mark.parametrize("options", quick(1, [{}, {"rough": True}, {"method": "per-leg"}]), ids=str)
@pytest.mark.parametrize("kind", quick(1, KINDS))
def test_machines_are_the_same_whatever_their_zeros(kind: str, options: dict[str, Any]) -> None:
    """Identified zeros may be far off: the search starts at those that full poses show."""
    mechanism, _, data = machine(kind, 36)
    off = np.array([0.7, 0.2, -1.6, 0.3, 0.0, -0.1])[: len(mechanism.legs)]
    off = off if mechanism.reading_units[0] == "rad" else 0.1 * off
    noise = pincal.Noise(5e-5, 5e-5, 5e-5)
    here = pincal.calibrate(mechanism, data, noise=noise, **options)
    moved = replace(data, readings=data.readings + off)
    there = pincal.calibrate(mechanism, moved, noise=noise, **options)
    assert here.converged
    assert there.converged
    assert there.reduced_chi2 == pytest.approx(here.reduced_chi2, rel=1e-6)
    zeros = [sensor.offset for leg in mechanism.legs for sensor in leg.sensors]
    for p in here.parameters:
        other = there[p.id]
        if p.name not in zeros:
            assert other.identified == pytest.approx(p.identified, abs=1e-4 * p.std)
    codes = [one.code for one in there.findings]
    assert ("zeros-found" in codes) == (not options.get("rough"))
    assert "zeros-found" not in [one.code for one in here.findings]
    assert "far-from-nominal" not in codes
    assert np.isfinite(errors_at(there, there.poses).mean_before()).all()


@pytest.mark.slow
def test_zeros_that_are_not_identified_are_refused() -> None:
    """Held fixed, or given with a prior, a zero that is far off remains a fault."""
    mechanism, _, data = machine("3RRR", 36)
    moved = replace(data, readings=data.readings + np.array([0.0, 0.3, 0.0]))
    for options in ({"fixed": ("gamma",)}, {"priors": {"gamma": 1e-3}}):
        with pytest.raises(pincal.MeasurementError, match="reading zeros are off: leg_2"):
            pincal.calibrate(mechanism, moved, **options)


@pytest.mark.parametrize("kind", KINDS)
def test_one_bad_row_is_found(kind: str) -> None:
    """3 mm at 20 µm, of a machine whose drawing is off by as much: the row, and no other."""
    noise = pincal.Noise(2e-5, 5e-5)
    mechanism, _, data = machine(kind, 72, noise)
    assert misfit(mechanism, data) == ()
    data = put(data, "poses", (10, 0), data.poses[10, 0] + 3e-3)
    (one,) = misfit(mechanism, data)
    assert (one.code, one.rows) == ("bad-rows", (10,))
    assert sentences((one,))[0].startswith("data row 11 misses the nominal mechanism")


def test_plausible_changes_follow_the_declared_order() -> None:
    """Each parameter has the change of its own unit, in whatever order parameters are declared."""
    mechanism = pincal.load_mechanism("3RRR")
    for turned in (False, True):
        legs = tuple(
            replace(leg, parameters=leg.parameters[:: -1 if turned else 1])
            for leg in mechanism.legs
        )
        changes = plausible_changes(replace(mechanism, legs=legs))
        units = [leg.units[name] for leg in legs for name in leg.parameter_names]
        assert {u for u, c in zip(units, changes, strict=True) if c == DIFFER} == {"rad", "1"}
        assert {u for u, c in zip(units, changes, strict=True) if c != DIFFER} == {"m"}


@pytest.mark.parametrize("kind", quick(1, ["3RRR", "6UPS"]))
def test_a_leg_fits_whatever_the_order_of_its_parameters(kind: str) -> None:
    """What machines near nominal leave does not depend on the order of declaration."""
    mechanism, _, data = machine(kind, 36)
    legs = tuple(replace(leg, parameters=leg.parameters[::-1]) for leg in mechanism.legs)
    wrong = zero(0, 0.3)(mechanism, data)
    first, second = (
        misfit(one, wrong)[0].values["left"] for one in (mechanism, replace(mechanism, legs=legs))
    )
    assert first == pytest.approx(second, rel=1e-6)
