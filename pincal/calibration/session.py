"""A session beside the robot: which pose is next, whether its row can be right, when it is enough.

A session is its plan, its options and the measured rows; everything else follows from these. After
each row they are calibrated again, at first with the drawing as prior, so that something is known
from the first row on. Once they are more than the unknowns, they are calibrated alone: what is
stated then is what ``pincal.calibrate`` promises by these rows.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from pincal.blas import one_thread
from pincal.calibration.assemble import assemble
from pincal.calibration.calibrate import calibrate, prepared
from pincal.calibration.calibration import Calibration
from pincal.calibration.fits import fitted
from pincal.calibration.options import Options, Tolerance
from pincal.calibration.promise import errors_inside
from pincal.calibration.result import CalibrationResult
from pincal.calibration.verdicts import Checked, Predictor, doubtful_row
from pincal.design.candidates import COVERED, Candidates
from pincal.design.platform_error import PlatformError
from pincal.errors import MeasurementError, PincalError, located
from pincal.estimation.observability.identifiable import plausible_changes
from pincal.files.columns import sheet_columns
from pincal.files.journal import Journal
from pincal.files.table import cell_text
from pincal.files.text import plain_number
from pincal.kinematics.configurations import inverse
from pincal.model import Mechanism, Noise, Plan, Setup
from pincal.model.checks import LARGEST
from pincal.option import option
from pincal.types import Index, Mask
from pincal.words.numbers import SI, Units

PLANNED = "planned_"
"""Prefix of the sheet's columns with set points of the drives."""
_LARGEST = 3.0  # standard deviations of the largest differences of machines from the drawing
_FAR = 10.0  # standard deviations from the drawing at which a row says nothing of the machine


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


class Session:
    """Rows that are measured one by one, and are on disk before anything else is done with them.

    ``checked`` is the verdict on the last row. ``result`` is the calibration of all rows, except a
    last one that is off; it is None while there is none, for the reason ``why``. ``error`` is the
    platform's error over the ``share`` of the workspace in the measured region, without a limit
    while the drawing is a prior. It is ``enough`` if the wanted accuracy is promised, and the next
    pose would not widen that region. ``doubtful`` is the row that all others contradict, and by how
    many σ.
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
        self.forecast = self.candidates.limits(self.candidates.course)
        self._drawn = Predictor(mechanism, plan, self.candidates)
        self._from_drawing = dict[tuple[str, ...], float]()  # σ of each row by its cells
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
        self._predictor = self._drawn
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
        if (row := self.candidates.outermost(self.measured, self._outside)) is not None:
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

    @property
    def contradicted(self) -> bool:
        """Whether a row contradicts all others, or all the model or its noise: no error holds."""
        return self.doubtful is not None or not (self.result is None or self.result.explained)

    @property
    def limit(self) -> float:
        """The 95 % limit of the stated error, [m]; infinite if none, or if a row contradicts it."""
        contradicted = self.contradicted and not self.enough
        return np.inf if self.error is None or contradicted else self.error.limit[0]

    @property
    def missing(self) -> int:
        """Forecast number of further poses until it is enough (see ``Candidates.missing``).

        It is 0 if it is enough, or no accuracy is wanted, and holds if nothing is contradicted.
        """
        if self.options.accuracy is None or self.enough:
            return 0
        surplus, accuracy = 0.0, self.options.accuracy
        if self.result is not None and self.error is not None and self.error.promised:
            surplus = (self.result.reduced_chi2 - 1.0) * self.result.chi2_freedoms
            of_drawing = self.candidates.limit(self.measured, surplus)
            accuracy *= of_drawing / self.error.limit[0] if np.isfinite(of_drawing) else 1.0
        return max(1, self.candidates.missing(self.measured, accuracy, surplus))

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
        checked = self._predictor.check(calibration, self.measured[-1])
        self.checked = checked._replace(off=checked.off and not keep)
        if not self.checked.off:
            self._fit(calibration)
        return self.checked

    @one_thread()
    def _fit(self, calibration: Calibration) -> None:
        """Calibrate, and decide whether it is enough."""
        self._forget()
        workspace, wanted = self.candidates.workspace, self.options.accuracy or 0.0
        places = np.array(self.measured)[: len(calibration.measurements)]
        try:
            near = self._near(calibration, places)
            unaided, part = self.candidates.freedoms(places[near]) > 0, calibration.rows(near)
            fits = fitted(part.with_options(priors={}) if unaided else part)
            self.doubtful, self.result = doubtful_row(fits), assemble(fits)
            self._predictor = self._drawn._replace(fits=fits, excess=self.result.excess)
            if len(far := np.flatnonzero(~near)):
                sigmas = self._predictor.sigmas(calibration.rows(far), places[far])
                self.doubtful = int(far[sigmas.argmax()]), float(sigmas.max())
            expected, error = errors_inside(self.result, workspace)
            self.error = replace(error, promised=error.promised and unaided)
            self.share = len(error.std) / max(expected.poses, 1)
            if len(far) or not self.error.limit[0] <= wanted:
                return
            if self.share < COVERED:
                self._outside = np.nan_to_num(self.result.expected_error(self.plan).outside)
            if self.candidates.outermost(self.measured, self._outside) is None:
                result = calibrate(
                    self.mechanism, calibration.measurements, fits.calibration.options
                )
                self.error = errors_inside(result, workspace)[1]
                self.enough = self.error.limit[0] <= wanted
        except (PincalError, np.linalg.LinAlgError) as error:
            self.why = str(error)

    def _near(self, calibration: Calibration, places: Index) -> Mask:
        """Return which rows a machine like the drawing may have given, shape (N,).

        Others would spoil a fit, and take its search minutes. Where the drawing alone predicts
        none, as in an unknown frame, all do; so do rows that are as far off as half of all rows.
        """
        if len(calibration.observation.external):
            return np.ones(len(places), dtype=bool)
        cells = [tuple(row) for row in self.journal.rows[: len(places)]]
        if new := [place for place, row in enumerate(cells) if row not in self._from_drawing]:
            sigmas = self._drawn.sigmas(calibration.rows(np.array(new)), places[new])
            self._from_drawing |= zip([cells[place] for place in new], sigmas, strict=True)
        sigmas = np.array([self._from_drawing[row] for row in cells])
        return np.asarray(sigmas <= _FAR * max(1.0, np.sort(sigmas)[(len(cells) - 1) // 2]))


def place_of(noun: str, number: str, count: int) -> int:
    """Return the place, from 0, of a pose or row by its number from 1.

    Raises:
        MeasurementError: there is none of that number.
    """
    if number.isdecimal() and len(number) <= len(str(count)) and 0 < int(number) <= count:
        return int(number) - 1
    last = f"the last is {noun} {count}" if count else "nothing is recorded yet"
    raise MeasurementError(f"there is no {noun} {number!r}; {last}")
