"""Intervals by the profile of the cost, against an independent minimisation and Wald's."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import done
from cramer_rao import Machine, drawn, machine
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.special import ndtri

import pincal
from pincal.calibration.calibrate import prepared
from pincal.calibration.fits import fitted
from pincal.estimation.fit import Fit, curvature
from pincal.estimation.profile import profile

Array = NDArray[np.float64]
QUANTILE = float(ndtri(0.975))
#: As large as in "24 poses at 1 mm" of docs/accuracy.md: the problem is curved.
CURVED = pincal.Noise(1e-3, 1e-3, 1e-3)
SMALL = pincal.Noise(1e-5, 1e-5, 1e-5)


def of_legs(result: pincal.CalibrationResult) -> list[Any]:
    """Return the parameters of all legs."""
    return [p for leg in result.legs for p in leg.parameters]


def lowest(one: Machine, data: pincal.Measurements, one_fit: Fit, held: dict[int, float]) -> float:
    """Return the least χ² with some parameters held, poses as further unknowns (SciPy)."""
    true, n = one.coordinates(np.zeros((len(data), one.dof))), len(one.parameters)
    values = one_fit.parameters.copy()
    for index, value in held.items():  # the others where they follow, to first order
        C = one_fit.covariance
        values += C[: len(values), index] / C[index, index] * (value - values[index])
    poses = one.nominal.platform.from_matrices(one_fit.last.state.matrices)
    first = np.concatenate((values, (poses - true).ravel()))
    free = np.array([i for i in range(len(first)) if i not in held])
    noise = CURVED.of_poses(one.nominal)

    def residuals(every: Array) -> Array:
        twists = every[n:].reshape(len(data), one.dof)
        off = (true + twists - data.poses) / noise
        read = (one.readings(every[:n], twists) - data.readings) / CURVED.reading
        return np.concatenate((off, read), axis=1)

    def jacobian(x: Array) -> Array:
        """All poses at once: the rows of one do not follow another's."""
        every, h = put(x), 1e-6
        J = np.zeros((len(data), one.dof + read, len(every)))
        for step in np.eye(n):
            step = np.concatenate((h * step, np.zeros(len(every) - n)))
            J[:, :, np.argmax(step)] = (residuals(every + step) - residuals(every - step)) / (2 * h)
        for freedom, own in enumerate(np.eye(one.dof)):
            step = np.concatenate((np.zeros(n), np.tile(h * own, len(data))))
            change = (residuals(every + step) - residuals(every - step)) / (2 * h)
            rows = np.arange(len(data))
            J[rows, :, n + one.dof * rows + freedom] = change
        return J.reshape(-1, len(every))[:, free]

    def put(x: Array) -> Array:
        every = first.copy()
        every[free] = x
        return every

    read = data.readings.shape[1]
    found = least_squares(
        lambda x: residuals(put(x)).ravel(), first[free], jac=jacobian, x_scale="jac", xtol=1e-12
    )
    return 2.0 * float(found.cost)


def test_ends_are_where_the_least_cost_has_risen() -> None:
    """χ² with a parameter held at an end, all else free: 1.96² above the least, to a hundredth.

    By SciPy, with closed forms of a 3-RRR and all its poses as further unknowns.
    """
    one = machine("3RRR", 24)
    data = drawn(one, CURVED, 3)
    (found,) = fitted(prepared(one.nominal, data, noise=CURVED, rough=True)).fits
    assert curvature(found.fit) > 0.5
    n = len(one.parameters)
    chosen = [0, 16]
    halves = QUANTILE * np.sqrt(np.diagonal(found.fit.covariance)[chosen])
    ends = profile(found.fit, np.eye(n)[chosen], halves)
    least = lowest(one, data, found.fit, {})
    for index, both in zip(chosen, ends, strict=True):
        for end in both:
            value = found.fit.parameters[index] + end
            rise = lowest(one, data, found.fit, {index: value}) - least
            assert rise == pytest.approx(QUANTILE**2, rel=1e-2)
    assert (np.abs(ends).max(axis=1) > 1.03 * np.abs(ends).min(axis=1)).all()  # unequal


ALL_BUT_ONE = tuple(pincal.load_mechanism("5R").parameters.ids[1:])
UNKNOWN = {"setup": pincal.Setup(unknown_frame=True)}


@pytest.mark.parametrize(
    "options",
    [
        {},
        pytest.param({"noise": None}, marks=pytest.mark.slow),
        {"method": "per-leg"},
        pytest.param({"method": "per-leg", "tied": ("l",)}, marks=pytest.mark.slow),
        pytest.param({"fixed": ("k",), "priors": {"l": 1e-4}}, marks=pytest.mark.slow),
        pytest.param({"fixed": ALL_BUT_ONE}, marks=pytest.mark.slow),
        UNKNOWN,
        pytest.param({"loss": "reject"}, marks=pytest.mark.slow),
        {"residual": "joint", "noise": None},
    ],
    ids=lambda one: ", ".join(one),
)  # fmt: skip
def test_a_straight_problem_has_the_intervals_of_its_standard_errors(
    options: dict[str, Any],
) -> None:
    """With noise so small that nothing bends, profiles end where Wald's intervals do, to 1 %."""
    one = machine("5R", 30)
    data, how = drawn(one, SMALL, 0), {"noise": SMALL, **options}
    wald = pincal.calibrate(one.nominal, data, **how)
    profile = pincal.calibrate(one.nominal, data, **how, intervals="profile")
    for a, b in zip(wald.parameters, profile.parameters, strict=True):
        assert (b.identified, b.std) == (a.identified, a.std)
        assert b.ends == pytest.approx(a.ends, rel=1e-2, abs=1e-15), a.id
    assert [found.code for found in wald.findings] == [found.code for found in profile.findings]


def test_legs_alone_in_an_unknown_frame_have_none() -> None:
    """That is refused, with what to do."""
    one = machine("5R", 30)
    with pytest.raises(pincal.MeasurementError, match="leave out --intervals profile"):
        pincal.calibrate(
            one.nominal, drawn(one, SMALL, 0), method="per-leg", intervals="profile", **UNKNOWN
        )


def test_ends_are_said_saved_and_loaded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Unequal and infinite ends, in sentences, tables, JSON and a result that is read back."""
    one = machine("5R", 30)

    def uneven(_: Fit, __: Array, halves: Array) -> Array:
        ends = np.stack((-0.8 * halves, 1.3 * halves), axis=1)
        ends[1, 1] = np.inf
        return ends

    monkeypatch.setattr("pincal.calibration.assemble.profile", uneven)
    result = pincal.calibrate(
        one.nominal, drawn(one, SMALL, 0), noise=SMALL, intervals="profile", method="per-leg"
    )
    first, second = of_legs(result)[:2]
    assert first.ends[1] / first.ends[0] == pytest.approx(1.3 / 0.8)
    down, up = (1e3 * end for end in first.ends)
    assert f"-{down:.3f} +{up:.3f} mm" in first.text
    assert second.text.endswith("+∞ mm")
    (said,) = [found for found in result.findings if found.code == "interval-open"]
    assert said.parameters == ("leg_1.L", "leg_2.L")
    assert "+∞" in str(result)
    result.save(tmp_path / "result", report=result.report())
    data = json.loads((tmp_path / "result" / "result.json").read_text(encoding="utf-8"))
    assert data["intervals"] == "profile"
    assert data["legs"][0]["parameters"][1]["interval_95"] == [second.low, None]
    again = pincal.load_result(tmp_path / "result")
    assert again.options.intervals == "profile"
    assert [p.ends for p in of_legs(again)] == [p.ends for p in of_legs(result)]


@pytest.mark.slow
def test_an_interval_may_have_no_end() -> None:
    """12 poses of a 5R at 10 mm: beyond some length of a crank the others explain as much.

    At two standard errors the ends are unequal; at ten there is none above.
    """
    one, noise = machine("5R", 40), pincal.Noise(1e-2, 1e-2, 0.0)
    data = drawn(one, noise, 1).rows(np.arange(12))
    (found,) = fitted(prepared(one.nominal, data, noise=noise, rough=True)).fits
    index = [p.id for p in one.nominal.parameters].index("leg_2.l")
    row, std = np.eye(12)[[index]], float(np.sqrt(found.fit.covariance[index, index]))
    near, far = (profile(found.fit, row, np.array([times * std]))[0] / std for times in (2.0, 10.0))
    assert -2.0 < near[0] < -1.0
    assert 2.5 < near[1] < 4.0
    assert -10.0 < far[0] < near[0]
    assert far[1] == np.inf


def test_the_command_line_asks_for_them() -> None:
    """``--intervals`` has the choices of the option of that name, and its default."""
    assert "--intervals <wald|profile>" in done("calibrate", "--help").out
    assert pincal.Options().intervals == "wald"
    with pytest.raises(pincal.MeasurementError, match="unknown intervals"):
        pincal.Options(intervals="bootstrap")  # type: ignore[arg-type]


@pytest.mark.slow
def test_intervals_of_a_curved_problem_cover() -> None:
    """24 poses of a 3-RRR at 1 mm: of single parameters 95 % hold the true value, within chance.

    Errors of one data set go together: by the spread from set to set.
    """
    one, noise, shares = machine("3RRR", 24), pincal.Noise(1e-3, 1e-3, 0.0), []
    for seed in range(16):
        data = drawn(one, noise, seed)
        result = pincal.calibrate(one.nominal, data, noise=noise, intervals="profile", rough=True)
        ends = [(p.low, p.high) for p in of_legs(result)]
        inside = [a <= true <= b for (a, b), true in zip(ends, one.parameters, strict=True)]
        shares.append(np.mean(inside))
    spread = np.std(shares, ddof=1) / np.sqrt(len(shares))
    assert abs(np.mean(shares) - 0.95) < 3.0 * spread


@pytest.mark.slow
@pytest.mark.parametrize("size", [1e-3, 1e-4])
def test_every_end_of_a_well_determined_machine_is_found(size: float) -> None:
    """3-RRR, 24 poses, noise on everything: no end is infinite, all within a fifth of Wald's."""
    one = machine("3RRR", 24)
    noise = pincal.Noise(size, size, size)
    result = pincal.calibrate(one.nominal, drawn(one, noise, 0), noise=noise, intervals="profile")
    for leg in result.legs:
        for p in leg.parameters:
            for end in p.ends:
                assert 0.8 < end / (1.959964 * p.std) < 1.3


def test_what_no_residual_shows_is_added_to_profiles() -> None:
    """1 mm of noise and a scale off by 1 %: roots of sums of squares on both sides, to 1e-9."""
    one, most = machine("3RRR", 16), pincal.Systematic(scale=1e-2)
    data = drawn(one, CURVED, 0)
    free = {"leg_1.l", "leg_1.beta"}
    held = [p.id for p in one.nominal.parameters if p.id not in free]
    plain, said = (
        pincal.calibrate(
            one.nominal, data, noise=CURVED, setup=setup, intervals="profile", fixed=held
        )
        for setup in (pincal.Setup(), pincal.Setup(systematic=most))
    )
    assert said.systematic is not None
    more = QUANTILE * np.sqrt(np.diagonal(said.systematic))
    assert (more > [p.half for p in of_legs(plain)]).any()
    for p, q, off in zip(of_legs(plain), of_legs(said), more, strict=True):
        assert q.identified - q.low == pytest.approx(np.hypot(p.identified - p.low, off), rel=1e-9)
        assert q.high - q.identified == pytest.approx(
            np.hypot(p.high - p.identified, off), rel=1e-9
        )
