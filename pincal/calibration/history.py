"""A machine over months: which parameters changed between its calibrations, and how it drifts.

Differences of two calibrations are judged by their joint covariance, so that parameters count that
are well determined together although each alone is not.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import date, timedelta
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.special import chdtrc

from pincal.calibration.promise import measured_plan, seen_by
from pincal.calibration.result import CalibrationResult
from pincal.calibration.result_files import RESULT, load_result
from pincal.design.platform_error import seen_of
from pincal.errors import FileError, MeasurementError
from pincal.estimation.observability.identifiable import nearest_to_nominal, plausible_changes
from pincal.kinematics.configurations import legs_at
from pincal.model import Mechanism, Parameter
from pincal.types import Array

_ALARM = 1e-3  # probability of a difference at which a machine has changed
_NAMED = 5  # largest number of changed parameters that are named
_EQUIVALENT = 6.6  # χ² within which another parameter explains a change as well, at 99 %
_DETERMINED = 1e-12  # least variance relative to the largest
_DATE = re.compile(r"(\d{4})-?(\d\d)(?:-?(\d\d))?")


class Change(NamedTuple):
    """The change of a parameter, later minus earlier, SI, and ids that would explain as much."""

    parameter: Parameter
    value: float
    std: float
    alternatives: tuple[str, ...]


@dataclass(frozen=True)
class History:
    """Calibrations of a machine in the order of their dates."""

    names: tuple[str, ...]
    dates: tuple[date, ...]
    results: tuple[CalibrationResult, ...]

    @cached_property
    def changes(self) -> list[list[Change]]:
        """Changed parameters from each calibration to the next."""
        return [changes(*pair) for pair in zip(self.results, self.results[1:], strict=False)]

    @property
    def values(self) -> Array:
        """Identified parameters of the legs, shape (n_results, n)."""
        return np.array([result.identified.parameters.values for result in self.results])

    @cached_property
    def since_jump(self) -> History:
        """The calibrations since the last jump: a straight line explains the changes since then."""
        starts = [i for i, changed in enumerate(self.changes, 1) if changed]
        later = [History(self.names[i:], self.dates[i:], self.results[i:]) for i in starts]
        return next((part for part in (self, *later) if part._straight), [self, *later][-1])

    @property
    def _straight(self) -> bool:
        """Whether a straight line in time explains all changes of parameters."""
        days, values = self._centred_days, self.values
        if len(days) <= 2 or not days.any():
            return True
        covariance = np.mean([result.covariance for result in self.results], axis=0)
        white = _whitening(self.results[-1].nominal, covariance)
        line = np.column_stack((np.ones(len(days)), days))
        apart = (values - line @ np.linalg.lstsq(line, values, rcond=None)[0]) @ white.T
        return bool(chdtrc((len(days) - 2) * len(white), (apart**2).sum()) >= _ALARM)

    @property
    def _centred_days(self) -> Array:
        days = np.array([day.toordinal() for day in self.dates], dtype=float)
        return days - days.mean()

    @cached_property
    def drift(self) -> tuple[float, float] | None:
        """Root mean square drift of the platform at measured poses, and two standard errors, a day.

        It is in m, or in rad if the platform only turns; None for fewer than three dates since the
        last jump. It is by the straight line through the parameters, their covariances, and their
        further scatter.
        """
        if self.since_jump is not self:
            return self.since_jump.drift
        if len(set(self.dates)) < 3:
            return None
        last, centred = self.results[-1], self._centred_days
        legs = legs_at(last.identified, measured_plan(last))
        moved, units = seen_of(last.identified, legs.poses, legs.gain, seen_by(last))
        G = moved[:, [unit == units[0] for unit in units]].reshape(-1, moved.shape[2])
        G, weights = G / np.sqrt(len(moved)), centred / (centred @ centred)
        slope, covariances = weights @ self.values, np.array([r.covariance for r in self.results])
        errors = self.values - self.values.mean(axis=0) - np.outer(centred, slope)
        expected = np.trace(G @ covariances.mean(axis=0) @ G.T)
        excess = max(1.0, ((G @ errors.T) ** 2).sum() / (len(centred) - 2) / expected)
        variance = excess * np.trace(G @ np.tensordot(weights**2, covariances, 1) @ G.T)
        return float(np.linalg.norm(G @ slope)), 2.0 * float(np.sqrt(variance))

    def due(self, accuracy: float) -> date | None:
        """Return the date of the next check to stay within an accuracy, [m] or [rad].

        It is by the drift plus two standard errors, and the error of the last calibration; None if
        there are too few calibrations.
        """
        if not 0.0 < accuracy < np.inf:
            raise MeasurementError(f"--accuracy {accuracy:g}: a finite number above 0 is expected")
        if self.drift is None:
            return None
        last = self.results[-1].expected_error()
        error = last.position if self.results[-1].nominal.platform.lengths else last.orientation
        span = np.sqrt(max(accuracy**2 - error**2, 0.0)) / max(sum(self.drift), 1e-30)
        return self.dates[-1] + timedelta(days=min(int(span), 36_500))


def changes(before: CalibrationResult, after: CalibrationResult) -> list[Change]:
    """Return which parameters changed between two calibrations, the most certain first.

    Each explains most of the remaining difference, until what remains is noise.
    """
    mechanism = after.nominal
    difference = after.identified.parameters.values - before.identified.parameters.values
    white = _whitening(mechanism, before.covariance + after.covariance)
    lost = [d for d in (after.gauge_directions, after.undetermined_directions) if d is not None]
    X, y = white, white @ difference
    if lost:  # the change where directions are fixed by choice
        X = white @ nearest_to_nominal(mechanism, np.hstack(lost))
    chosen, residual, alternatives = list[int](), y, list[tuple[str, ...]]()
    while chdtrc(len(y) - len(chosen), residual @ residual) < _ALARM and len(chosen) < _NAMED:
        free = X - X[:, chosen] @ np.linalg.lstsq(X[:, chosen], X, rcond=None)[0]
        sizes = np.linalg.norm(free, axis=0)
        possible = sizes > 1e-6 * np.linalg.norm(X, axis=0)
        gains = np.where(possible, residual @ free / np.where(possible, sizes, 1.0), 0.0) ** 2
        best = int(np.argmax(gains))
        near = np.flatnonzero(possible & (gains > gains[best] - _EQUIVALENT))
        alternatives.append(tuple(mechanism.parameters[i].id for i in near if i != best))
        chosen.append(best)
        amounts = np.linalg.lstsq(X[:, chosen], y, rcond=None)[0]
        residual = y - X[:, chosen] @ amounts
    if not chosen:
        return []
    stds = np.sqrt(np.diag(np.linalg.inv(X[:, chosen].T @ X[:, chosen])))
    parameters = [mechanism.parameters[i] for i in chosen]
    rows = zip(parameters, amounts.tolist(), stds.tolist(), alternatives, strict=True)
    return sorted(map(Change._make, rows), key=lambda change: -abs(change.value / change.std))


def _whitening(mechanism: Mechanism, covariance: Array) -> Array:
    """Return the matrix (k, n) that makes the k determined directions of n parameters white."""
    scales = plausible_changes(mechanism)
    values, axes = np.linalg.eigh(covariance / np.outer(scales, scales))
    known = values > _DETERMINED * values.max()
    return np.asarray((axes[:, known] / np.sqrt(values[known])).T / scales)


def history_of(paths: Sequence[Path]) -> History:
    """Return the history of results in folders, dated by their names, else by their files.

    Raises:
        FileError: a folder has no result.
        MeasurementError: results are of different machines, or did not converge.
    """
    folders = dict[Path, Path]()  # by where they are: each once
    for path in paths:
        nested = sorted(file.parent for file in path.glob(f"*/{RESULT}"))
        inside = [path] if (path / RESULT).is_file() else nested
        if not inside:
            raise FileError(
                f"{path} holds no result; 'pincal calibrate MECH DATA.csv -o {path}/2026-03-31' "
                "makes one"
            )
        folders |= {folder.resolve(): folder for folder in inside if folder.suffix != ".bak"}
    if len(folders) < 2:
        raise MeasurementError("one calibration is no history; give two or more results")
    loaded = [(_date_of(folder), folder.name, load_result(folder)) for folder in folders.values()]
    loaded.sort(key=lambda dated: dated[:2])
    dates, names, results = zip(*loaded, strict=True)
    for name, result in zip(names, results, strict=True):
        if not result.converged:
            raise MeasurementError(f"{name}: the fit {result.message}; leave this result out")
        if result.nominal.parameters.ids != results[0].nominal.parameters.ids:
            raise MeasurementError(
                f"{name} is of a machine with other parameters than {names[0]}; give results of one"
            )
    return History(names, dates, results)


def _date_of(folder: Path) -> date:
    """Return the date in a folder's name, or of its result file; raise if it is not a date."""
    matches = list(_DATE.finditer(folder.name))
    for match in matches:
        with suppress(ValueError):
            return date(int(match[1]), int(match[2]), int(match[3] or 1))
    if impossible := [match[0] for match in matches if "-" in match[0]]:  # else a serial number
        raise MeasurementError(f"{folder.name}: {impossible[0]} is no date; rename the folder")
    return date.fromtimestamp((folder / RESULT).stat().st_mtime)
