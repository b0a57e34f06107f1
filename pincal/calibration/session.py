"""A session beside the robot: which pose is next, whether its row can be right, when it is enough.

A session is its plan, its options and the measured rows; everything else follows from these. After
each row they are calibrated again, with the drawing as prior, so that something is known from the
first row on:

    check    χ² = rᵀ (s² (1 + J C Jᵀ))⁻¹ r    a row r against its prediction by a fit without it,
    enough   the limit that ``pincal.calibrate`` promises by these rows without priors.

The next pose is chosen by ``pincal.design.order``.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from scipy.special import chdtrc, ndtri

from pincal.blas import one_thread
from pincal.calibration.assemble import assemble
from pincal.calibration.calibrate import calibrate, prepared
from pincal.calibration.calibration import Calibration
from pincal.calibration.fits import Fits, fitted
from pincal.calibration.hypotheses.faults import faults_of_a_row
from pincal.calibration.hypotheses.judging import Case, Hypothesis
from pincal.calibration.options import Options, Tolerance
from pincal.calibration.promise import errors_inside
from pincal.calibration.result import CalibrationResult
from pincal.design.order import Candidates
from pincal.design.platform_error import PlatformError
from pincal.errors import MeasurementError, PincalError, located
from pincal.estimation.observability.identifiable import plausible_changes
from pincal.estimation.problem import Linear
from pincal.estimation.solver import solve_poses
from pincal.estimation.unknowns import State
from pincal.files.columns import sheet_columns
from pincal.files.journal import Journal
from pincal.files.table import cell_text
from pincal.files.text import plain_number
from pincal.finding import Finding
from pincal.kinematics.configurations import inverse
from pincal.model import Mechanism, Noise, Plan, Setup
from pincal.model.checks import LARGEST
from pincal.option import option
from pincal.types import Array, Index, Mask
from pincal.words.findings import finding
from pincal.words.numbers import SI, Units

PLANNED = "planned_"
"""Prefix of the sheet's columns with set points of the drives."""
FALSE_ALARM = 3e-3
"""Probability with which each of two tests calls a sound row wrong."""
ENOUGH = 0.95
"""Share of the workspace that the measured region, in which errors are stated, should cover."""
_LARGEST = 3.0  # standard deviations of the largest differences of machines from the drawing
_FAR = 10.0  # standard deviations from the drawing at which a row says nothing of the machine
_CAUSES = 3  # largest number of causes that are named
_SEEN = 1e-6  # least share of a slip's square that shows in a residual
_CONFIRMED = 1e-8  # least share of the variance of a row's residuals that other rows predict
_LEAST = float(np.finfo(float).tiny)  # smallest probability that a float can hold
_NEARLY = 1e-4  # share of a row's χ² that rounding of a typed number may leave


@dataclass(frozen=True)
class SessionOptions:
    """Options of a session: what is measured, and the accuracy that is wanted."""

    accuracy: float | None = option(
        None, "Root mean square position error that is enough [m], or as 0.05mm.", unit="m"
    )
    tolerance: Tolerance = option(
        dict,
        "How far the machine may be from its drawing, which checks the first rows better "
        "[default: 2 % of a leg, 17 mrad].",
        metavar="0.5mm,5mrad",
        kind=str | None,
    )
    noise: Noise = field(default_factory=Noise)
    setup: Setup = field(default_factory=Setup)
    measured: tuple[str, ...] | None = None
    """Measured freedoms of the platform and columns of the setup; None for all."""
    units: Units = SI
    """Units of the columns; by default mm and degrees."""
    following: str = ""
    """What the user does once it is enough."""


class Checked(NamedTuple):
    """The verdict on a row when it was entered."""

    row: int
    """Index of the row, from 0."""
    sigma: float | None
    """Size of a normal residual as unlikely as the row, in standard deviations of prediction and
    noise; infinite if the row has no pose, None if nothing can be predicted yet."""
    off: bool = False
    """Whether it is farther off than sound rows are."""
    quantity: str = ""
    """The number whose slip would explain most of the residual."""
    causes: tuple[Finding, ...] = ()
    """Faults that would explain it: units, signs, swapped columns."""


class Session:
    """Rows that are measured one by one, and are on disk before anything else is done with them.

    ``checked`` is the verdict on the last row. ``result`` is the calibration of all rows, except a
    last one that is off; it is None while there is none, for the reason ``why``. ``error`` is the
    platform's error over the ``share`` of the workspace in the measured region. It is ``enough`` if
    the wanted accuracy is promised, and the next pose would not widen that region. ``doubtful`` is
    the row that all others contradict, and by how many σ.
    """

    def __init__(
        self, journal: Journal, mechanism: Mechanism, plan: Plan, options: SessionOptions
    ) -> None:
        """Open a session, new or as it was left, with a plan of poses to choose from.

        Raises:
            FileError: the rows on disk have other columns, or cannot be read.
            MeasurementError: a row on disk is none of the plan, or cannot be measured.
        """
        setup = options.setup.of_rows(plan.contacts)
        if plan.readings is None:
            plan = replace(plan, readings=inverse(mechanism, plan.poses).readings)
        tolerance: Any = Options(tolerance=options.tolerance).tolerance
        changes = plausible_changes(mechanism, mechanism.legs) / _LARGEST
        priors = {
            parameter.id: tolerance.get(parameter.unit, float(change))
            for parameter, change in zip(mechanism.parameters, changes, strict=True)
        }
        self.mechanism, self.plan, self.options = mechanism, plan, options
        self._options = Options(noise=options.noise, setup=setup, priors=priors)
        columns = sheet_columns(mechanism, plan, options.measured, setup, options.units)
        influences = [name for name in mechanism.influences if name not in mechanism.followed]
        columns |= {name: ("",) * len(plan) for name in influences}
        self.sheet = {head: [cell_text(cell) for cell in cells] for head, cells in columns.items()}
        known = ("row", "set", "pose", PLANNED, *plan.contacts)
        self.columns = [head for head in self.sheet if not head.startswith(known)]
        read = set(mechanism.reading_names)
        self.observed = [head for head in self.columns if head.partition(" [")[0] not in read]
        self.candidates = Candidates(
            mechanism, plan, options.noise, options.measured, setup, priors
        )
        self.forecast = self.candidates.limits(self.candidates.course())
        self.chosen: int | None = None
        """Row of the plan that the user chose to measure next, if any."""
        self._skipped = list[int]()
        self.journal = journal
        journal.open(list(self.sheet))
        with located(journal.path, MeasurementError):
            self._restart()

    def _restart(self) -> None:
        """Restore the session from the rows on disk."""
        self.checked: Checked | None = None
        self._forget()
        if count := len(self.journal.rows):
            calibration = self._read()
            if count > 1:
                self._fit(calibration.rows(np.arange(count - 1)))
            self._judge(calibration)

    def _forget(self) -> None:
        self.result: CalibrationResult | None = None
        self.error: PlatformError | None = None
        self.share, self.why, self.enough = 0.0, "", False
        self.doubtful: tuple[int, float] | None = None
        self._fits: Fits | None = None
        self._outside = np.zeros(len(self.plan))

    @property
    def measured(self) -> list[int]:
        """Rows of the plan that were measured, in this order, including rows that are off."""
        place = self.journal.columns.index("row")
        return [place_of("pose", row[place], len(self.plan)) for row in self.journal.rows]

    @property
    def questioned(self) -> bool:
        """Whether the last row is off, and is yet to be kept or undone."""
        return self.checked is not None and self.checked.off

    def next_pose(self) -> tuple[int, float]:
        """Return the row of the plan to measure next, and the share by which it lowers errors.

        It is the last row while that is questioned, else the chosen one. When it is enough, or no
        other row is left, rows for verification come first.
        """
        if self.questioned:
            return self.measured[-1], 0.0
        if self.chosen is not None:
            return self.chosen, 0.0
        reserved = self._reserved
        if len(reserved) and (self.enough or self._exhausted):
            return int(reserved[0]), 0.0
        if (row := self._outermost()) is not None:
            return row, 0.0
        return self.candidates.best(self.measured)

    @property
    def finished(self) -> bool:
        """Whether it is enough, or no row is left, and all rows for verification were measured."""
        done = self._exhausted or (self.enough and not self.doubtful)
        return done and not self.questioned and not len(self._reserved)

    @property
    def _reserved(self) -> Index:
        """Rows for verification that are still to be measured."""
        return np.setdiff1d(np.flatnonzero(self.plan.verifying), [*self.measured, *self._skipped])

    @property
    def _exhausted(self) -> bool:
        return not self.candidates.fresh(self.measured).any()

    def _outermost(self) -> int | None:
        """Return the row of the plan farthest outside a measured region that is too small."""
        outside = np.where(self.candidates.fresh(self.measured), self._outside, 0.0)
        return int(outside.argmax()) if outside.max() > 1.0 else None

    @property
    def limit(self) -> float:
        """The 95 % limit of the stated error, [m]; infinite if none, or if a row contradicts it."""
        contradicted = self.doubtful is not None and not self.enough
        return np.inf if self.error is None or contradicted else self.error.limit[0]

    @property
    def missing(self) -> int:
        """Forecast number of further poses until the wanted accuracy; 0 if it is enough."""
        if self.options.accuracy is None or self.enough:
            return 0
        expected = self.candidates.limit(*self.measured)
        goal = self.options.accuracy * (expected / self.limit if np.isfinite(self.limit) else 1.0)
        limits, levels = np.array(self.forecast), np.array([expected, goal])
        beyond = len(limits) * (limits[-1] / levels) ** 2
        reached = np.searchsorted(-limits, -levels)  # both decrease
        before, after = np.where(limits[-1] <= levels, reached, beyond)
        return max(1, round(after - before))

    def add(self, entry: Mapping[str, str], row: int | None = None) -> Checked:
        """Record and check what was measured at a row of the plan, by default the next one.

        It replaces a last row of the same pose that is off.

        Args:
            entry: Cells by header or name of the column, in the units of the headers. Readings that
                are left out are the commanded ones.
            row: Row of the plan, from 0.

        Raises:
            MeasurementError: a cell is not a number, or nothing was measured; nothing is recorded.
        """
        row = self.next_pose()[0] if row is None else row
        cells = self._cells(entry, row)
        last = len(self.journal.rows) - 1
        replaced = self.questioned and row == self.measured[last]
        self.journal.append(cells)
        try:
            calibration = self._read()
            if replaced:
                self.journal.undo(last)
                calibration = self._read()
            checked = self._judge(calibration)
        except MeasurementError:
            self.journal.undo(len(self.journal.rows) - 1)
            raise
        self.chosen = None
        return checked

    def _cells(self, entry: Mapping[str, str], row: int) -> dict[str, str]:
        """Return all cells of the sheet at a row of the plan, with those entered."""
        cells = {head: column[row] for head, column in self.sheet.items()}
        heads = {name: head for head in self.columns for name in (head, head.partition(" [")[0])}
        for name in heads.keys() & entry.keys():  # an instrument may send more
            cell, head = entry[name].strip(), heads[name]
            if cell and not abs(plain_number(cell)) <= LARGEST:
                raise MeasurementError(f"{head}: {cell!r} is no number; enter the row again")
            cells[head] = cell
        if self.observed and not any(cells[head] for head in self.observed):
            raise MeasurementError(
                f"nothing was measured: got {', '.join(entry) or 'no number'}; expected "
                f"{', '.join(self.observed)}"
            )
        for head in set(self.columns) - set(self.observed):
            cells[head] = cells[head] or cells[f"{PLANNED}{head}"]
        return cells

    def skip(self, row: int) -> None:
        """Do not offer a row of the plan again until the session is reopened."""
        self.candidates.offered[row], self.chosen = False, None
        self._skipped.append(row)

    def keep(self) -> None:
        """Keep the last row although it is off."""
        self._judge(self._read(), keep=True)

    def undo(self, row: int | None = None) -> None:
        """Undo a row, by default the last."""
        self.journal.undo(len(self.journal.rows) - 1 if row is None else row)
        self._restart()

    def _read(self) -> Calibration:
        return prepared(self.mechanism, self.journal.path, self._options)

    def _judge(self, calibration: Calibration, *, keep: bool = False) -> Checked:
        """Return the verdict on the last row, and calibrate if it is not off."""
        checked = self._check(calibration)
        self.checked = checked._replace(off=checked.off and not keep)
        if not self.checked.off:
            self._fit(calibration)
        return self.checked

    @one_thread()
    def _fit(self, calibration: Calibration) -> None:
        """Calibrate, and decide whether it is enough."""
        self._forget()
        workspace, wanted = self.candidates.workspace, self.options.accuracy or 0.0
        try:
            near, rows = self._near(calibration), self.measured
            self._fits = fitted(calibration.rows(near))
            self.doubtful, self.result = _doubtful_row(self._fits), assemble(self._fits)
            if len(far := np.flatnonzero(~near)):
                others = self._predicted(calibration.rows(far), [rows[row] for row in far])
                sigmas = _row_verdicts(*others, slice(None))[1]
                self.doubtful = int(far[sigmas.argmax()]), float(sigmas.max())
            expected, self.error = errors_inside(self.result, workspace)
            self.share = len(self.error.std) / max(expected.poses, 1)
            if len(far) or not self.error.limit[0] <= wanted:
                return
            if self.share < ENOUGH:
                self._outside = np.nan_to_num(self.result.expected_error(self.plan).outside)
            if self._outermost() is None:
                options = replace(self._options, priors={})  # promises do not rest on the drawing
                result = calibrate(self.mechanism, calibration.measurements, options)
                self.error = errors_inside(result, workspace)[1]
                self.enough = self.error.limit[0] <= wanted
        except (PincalError, np.linalg.LinAlgError) as error:
            self.why = str(error)

    @one_thread()
    def _check(self, calibration: Calibration) -> Checked:
        """Return the verdict on the last row by its prediction from the others."""
        row, place = len(calibration.measurements) - 1, self.measured[-1:]
        if self._fits is None and len(calibration.observation.external):
            return Checked(row, None)
        last = calibration.rows(np.array([row]))
        r, S, linear = self._predicted(last, place)
        square, sigma, chance, worst, left = (v[0] for v in _row_verdicts(r, S, linear, slice(1)))
        if chance >= FALSE_ALARM:
            return Checked(row, float(sigma))
        tried = list(faults_of_a_row(Case(calibration, np.array([row]))))
        squares = _squares(*self._predicted(_righted(last, tried), place * len(tried))[:2])
        equations = max(int(linear.equations[0]), 1)
        nearly = _NEARLY * square if np.isfinite(square) else 0.0
        fits = (chdtrc(equations, squares) >= FALSE_ALARM) | (squares <= nearly)
        likely = [tried[place] for place in np.argsort(squares) if fits[place]][:_CAUSES]
        quantities = tuple(linear.problem.quantities)
        quantity = linear.problem.observation.named(quantities[worst], 0)
        if not likely and equations > 1 and chdtrc(equations - 1, left) >= FALSE_ALARM:
            likely = [Hypothesis("slip", lambda data: data, {"quantity": quantity})]
        names = self.mechanism.leg_names
        causes = tuple(
            finding(
                hypothesis.code,
                **hypothesis.values,
                legs=tuple(names[leg] for leg in hypothesis.legs),
                unknown_frame=False,
            )
            for hypothesis in likely
        )
        return Checked(row, float(sigma), True, quantity, causes)

    def _near(self, calibration: Calibration) -> Mask:
        """Return which rows a machine like the drawing may have given, shape (N,).

        Others would spoil a fit, and take its search minutes. Where the drawing alone predicts
        none, as in an unknown frame, all do; so do rows that are as far off as half of all rows.
        """
        count = len(calibration.measurements)
        if len(calibration.observation.external):
            return np.ones(count, dtype=bool)
        predicted = self._predicted(calibration, self.measured[:count])
        sigmas = _row_verdicts(*predicted, slice(None))[1]
        return np.asarray(sigmas <= _FAR * max(1.0, np.sort(sigmas)[(count - 1) // 2]))

    def _predicted(
        self, calibration: Calibration, places: Sequence[int]
    ) -> tuple[Array, Array, Linear]:
        """Return residuals of rows against predictions, (N, k), their covariances, conditions.

        Predictions are those of the last fit; of the drawing, if there is none. Conditions are at
        the poses that fit best, searched from those planned at ``places``.
        """
        parameters = self.mechanism.parameters.values
        external = calibration.observation.external.start
        rows, excess = self.candidates.beforehand, 1.0
        if self._fits is not None and self.result is not None:
            fit, excess = self._fits.fits[0], self.result.excess
            parameters, external = fit.parameters, self._fits.external
            known_rows = fit.last.jacobian[fit.good].reshape(-1, rows.shape[1])
            rows = np.concatenate((rows, known_rows / excess))
        planned = self.mechanism.platform.matrices(self.plan.poses[places])
        state = State(parameters, planned, external=external)
        with np.errstate(all="ignore"):
            linear, _ = solve_poses(calibration.latent_problem.evaluate(state))
            R = np.asarray(np.linalg.qr(rows, mode="r"))
            W = np.linalg.solve(R.T, linear.jacobian.mT)
            return linear.residuals, excess**2 * np.eye(W.shape[2]) + W.mT @ W, linear


def _righted(row: Calibration, hypotheses: Sequence[Hypothesis]) -> Calibration:
    """Return the calibration of a row as it should read under hypotheses, a row each."""
    trials = [hypothesis.right(row.measurements) for hypothesis in hypotheses]
    data = replace(
        row.measurements.rows(np.zeros(len(trials), dtype=np.intp)),
        poses=np.concatenate([trial.poses for trial in trials]),
        readings=np.concatenate([trial.readings for trial in trials]),
    )
    return replace(row, measurements=data, known_noise=None)


def place_of(noun: str, number: str, count: int) -> int:
    """Return the place, from 0, of a pose or row by its number from 1.

    Raises:
        MeasurementError: there is none of that number.
    """
    if number.isdecimal() and len(number) <= len(str(count)) and 0 < int(number) <= count:
        return int(number) - 1
    last = f"the last is {noun} {count}" if count else "nothing is recorded yet"
    raise MeasurementError(f"there is no {noun} {number!r}; {last}")


def _squares(r: Array, S: Array) -> Array:
    """Return χ² = rᵀ S⁻¹ r of rows, shape (N,); infinite where a row has no pose."""
    known = np.isfinite(S).all(axis=(1, 2)) & np.isfinite(r).all(axis=1)
    squares = np.full(len(r), np.inf)
    squares[known] = (r[known] * np.linalg.solve(S[known], r[known, :, None])[:, :, 0]).sum(axis=1)
    return squares


def _row_verdicts(r: Array, S: Array, linear: Linear, rows: Index | slice) -> tuple[Array, ...]:
    """Return χ² of rows, σ, p-value, the worst quantity, and χ² without it, shape (N,) each.

    The residuals r, (N, k), have covariances S. A slip of one standard deviation moves residuals by
    its column w of the noise's root, and explains (wᵀ S⁻¹ r)² / wᵀ S⁻¹ w of χ². The p-value is that
    of χ² or, if less, of the most that a quantity explains. σ is the size of a normal number as
    unlikely; infinite where a row has no pose.
    """
    squares, equations = _squares(r, S), linear.equations[rows]
    w = np.nan_to_num(linear.white(linear.noise_root)[rows, :, : len(linear.problem.quantities)])
    known = np.isfinite(squares)
    gains, weighted = np.zeros((len(r), w.shape[2])), np.linalg.solve(S[known], w[known])
    sizes = (w[known] * weighted).sum(axis=1)
    taken = (r[known, None] @ weighted)[:, 0] ** 2
    gains[known] = np.where(sizes > _SEEN, taken / np.maximum(sizes, _SEEN), 0.0)
    worst, most = gains.argmax(axis=1), gains.max(axis=1)
    slips = (gains > 0.0).sum(axis=1) * chdtrc(1, most)
    chances = np.minimum(chdtrc(np.maximum(equations, 1), squares), np.where(most > 0, slips, 1.0))
    sigmas = np.where(chances > _LEAST, -ndtri(chances / 2.0), np.sqrt(squares))
    return squares, sigmas, chances, worst, np.maximum(squares - most, 0.0)


def _doubtful_row(fits: Fits) -> tuple[int, float] | None:
    """Return the row farthest from its prediction by all others, and by how many σ; or None.

    A fit without a row leaves it the residual (1 − Q Qᵀ)⁻¹ r, with orthonormal columns Q, and the
    covariance (1 − Q Qᵀ)⁻¹. Where no other row determines it, r is rounding, and S is bounded.
    """
    fit = fits.fits[0]
    rows, r = np.flatnonzero(fit.good), fit.last.residuals[fit.good]
    unpredicted = (1.0 + _CONFIRMED) * np.eye(r.shape[1]) - fit.Q @ fit.Q.mT
    S = np.asarray(np.linalg.inv(unpredicted), dtype=float)
    _, sigmas, chances, *_ = _row_verdicts((S @ r[:, :, None])[:, :, 0], S, fit.last, rows)
    worst = int(sigmas.argmax())  # chances may all be zero
    if chances[worst] * len(rows) >= FALSE_ALARM:
        return None
    return int(rows[worst]), float(sigmas[worst])
