"""A result folder: ``result.json``, ``residuals.csv``, the nominal and the calibrated mechanism.

``result.json`` says what was found, for people and programs, and holds under ``data`` all
that the result is made of, bit for bit, so that ``load_result`` gives it back.
"""

from __future__ import annotations

import json
import math
import warnings
from pathlib import Path
from typing import Any

import pincal.files.output as output
from pincal import __version__
from pincal.calibration.checks.runs import RunComparison
from pincal.calibration.leg_result import IdentifiedParameter, LegResult
from pincal.calibration.promise import most_uncertain, uncovered
from pincal.calibration.result import CalibrationResult, Page
from pincal.calibration.result_data import restored, stored
from pincal.errors import MeasurementError
from pincal.files.input import LARGEST_FILE, read_text
from pincal.files.json_text import json_text, plain
from pincal.files.mechanism_folders import load_mechanism
from pincal.files.mechanism_writing import write_mechanism
from pincal.files.tables.measurement_writing import write_poses
from pincal.files.tables.table import write_table
from pincal.model.measuring.measurements import Plan
from pincal.words.sentences import sentence

FORMAT = 2
RESULT, REPORT = "result.json", "report.html"
MECHANISM, NOMINAL = "mechanism", "nominal"
RESULT_FILES = (RESULT, "residuals.csv", "poses.csv", REPORT, MECHANISM, NOMINAL)
"""What pincal writes in a result folder, first the file by which it is known."""


def save_result(
    result: CalibrationResult,
    folder: str | Path,
    *,
    force: bool = False,
    report: Page | None = None,
) -> Path:
    """Write a result folder, whole or not at all, then its report, and return it.

    A fit that did not converge has no calibrated mechanism, so none is written. Arguments are
    those of ``CalibrationResult.save``.

    Raises:
        FileError: the folder exists and ``force`` is not set, or cannot be written.
    """
    with output.writing(folder, force=force, folder=RESULT_FILES) as scratch:
        (scratch / RESULT).write_text(json_text(as_json(result)) + "\n", encoding="utf-8")
        mechanisms = {NOMINAL: result.nominal}
        mechanisms |= {MECHANISM: result.identified} if result.converged else {}
        for name, mechanism in mechanisms.items():
            (scratch / name).mkdir()
            write_mechanism(mechanism, scratch / name)
        write_table(scratch / "residuals.csv", _residuals(result))
        if result.estimated_poses is not None:
            plan = Plan(result.estimated_poses)
            write_poses(scratch / "poses.csv", result.identified, plan)
    if report is not None:  # drawn when the result is safe
        with output.writing(Path(folder) / REPORT) as scratch:
            scratch.write_text(report.html(), encoding="utf-8")
    return Path(folder)


def as_json(result: CalibrationResult) -> dict[str, Any]:
    """Return a result as plain data for JSON; numbers that do not exist are null."""
    found = {
        "pincal_result": FORMAT,
        "pincal": __version__,
        "mechanism": result.nominal.name,
        "calibrated_mechanism": MECHANISM if result.converged else None,
        "method": result.method,
        "residual": result.options.residual,
        "poses": "all" if result.options.every_pose else "own",
        "intervals": result.options.intervals,
        "converged": result.converged,
        "message": result.message,
        "evaluations": result.evaluations,
        "reduced_chi2": result.reduced_chi2,
        "degrees_of_freedom": result.degrees_of_freedom,
        "promised": result.promises,
        "promise_leaves_out": list(uncovered(result)),
        "measured_region": most_uncertain(result),
        "contradicted_by": [one.code for one in result.contradictions],
        "noise": {"source": result.noise_source, **(vars(result.noise) if result.noise else {})},
        "warnings": list(result.warnings),
        "findings": [
            vars(one) | {"rows": [row + 1 for row in one.rows], "sentence": sentence(one)}
            for one in result.findings
        ],
        "loss": result.loss,
        "outliers": [vars(one) | {"row": one.row + 1} for one in result.outliers],
        "shift_without_loss": result.shift,
        "external": [_parameter(p) for p in result.external],
        "gauge": [sentence(one) for one in result.gauge],
        "ties": [vars(one) | {"holds": one.holds} for one in result.ties],
        "observed": [
            {"name": one.name, "unit": one.unit, "count": one.count}
            | {"rms": one.rms, "sigma": one.sigma}
            for one in result.observed
        ],
        "weakly_determined": result.weak,
        "validation": result.validation,
        "runs": None if result.runs is None else _runs(result.runs),
        "legs": [_leg(leg) for leg in result.legs],
        "covariance": result.parameter_covariance,
        "data": stored(result),
    }
    return dict(plain(found))


def _residuals(result: CalibrationResult) -> dict[str, list[str]]:
    """Return columns of residuals in SI: of the legs, and of what was measured of the platform.

    Legs of exact readings close by construction at poses that were estimated: they are left out.
    """
    parts = [
        (leg.name, leg.quantity, leg.unit, *row)
        for leg in result.legs
        for row in zip(leg.rows, leg.residuals, leg.sigma, strict=True)
        if row[2] > 0.0 or not result.observed
    ]
    parts += [
        ("", one.name, one.unit, *row)
        for one in result.observed
        for row in zip(one.rows, one.residuals, one.sigmas, strict=True)
    ]
    return {
        "leg": [leg for leg, *_ in parts],
        "row": [str(row + 1) for *_, row, _, _ in parts],
        "quantity": [quantity for _, quantity, *_ in parts],
        "unit": [unit for _, _, unit, *_ in parts],
        "residual": [repr(float(value)) for *_, value, _ in parts],
        "sigma": [repr(float(sigma)) for *_, sigma in parts],
    }


def _leg(leg: LegResult) -> dict[str, Any]:
    return {
        "name": leg.name,
        "parameters": [_parameter(p) for p in leg.parameters],
        "rank": leg.rank,
        "condition": leg.condition,
        "residual_unit": leg.unit,
        "rms_before": leg.rms_before,
        "rms_after": leg.rms_after,
        "n_residuals": leg.n_residuals,
    }


def _parameter(p: IdentifiedParameter) -> dict[str, Any]:
    return {
        "id": p.id,
        "name": p.name,
        "unit": p.unit,
        "nominal": p.nominal,
        "identified": p.identified,
        "std": p.std,
        "interval_95": [p.low, p.high],
        "given": p.given or None,
        "label": p.label or None,
    }


def _runs(runs: RunComparison) -> dict[str, Any]:
    return {
        "runs": list(runs.runs),
        "ratio": runs.ratio,
        "p_value": runs.p_value,
        "parameters": [
            {"name": name, "spread": spread, "predicted": predicted, "values": values}
            for name, spread, predicted, values in zip(
                runs.names,
                runs.spread,
                runs.predicted,
                runs.values.T,
                strict=True,
            )
        ],
    }


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"{text[:40]} is not a finite number")
    return value


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name, value in pairs:
        if name in found:
            raise ValueError(f"{name[:40]!r} appears twice")
        found[name] = value
    return found


def read_result(folder: str | Path) -> dict[str, Any]:
    """Return the contents of a result folder's ``result.json``.

    Raises:
        FileError: the file is missing or cannot be read.
        MeasurementError: not a result of pincal, or of an unknown version.
    """
    path = Path(folder) / RESULT
    text = read_text(path, LARGEST_FILE["result"], MeasurementError)
    try:
        data = json.loads(
            text, parse_float=_finite, parse_constant=_finite, object_pairs_hook=_once
        )
    except (ValueError, RecursionError) as error:
        raise MeasurementError(f"{path}: not JSON as pincal writes it: {error}") from error
    if not isinstance(data, dict) or data.get("pincal_result") not in range(1, FORMAT + 1):
        raise MeasurementError(f"{path}: not a result of pincal in format {FORMAT} or before")
    return data


def load_result(folder: str | Path) -> CalibrationResult:
    """Return the result that a folder holds: what was saved, bit for bit.

    Raises:
        FileError: a file is missing or cannot be read.
        MeasurementError: not a result of pincal, a damaged one, or one of version 0.1, which did
            not hold all.
        MechanismError: a nominal mechanism that cannot be loaded.
    """
    found = read_result(folder)
    if "data" not in found:
        raise MeasurementError(
            f"{folder}: a result of version 0.1, which does not hold all that it was made from; "
            "calibrate again, or read it with pincal.calibration.result_files.read_result"
        )
    nominal = load_mechanism(Path(folder) / NOMINAL)
    try:
        with warnings.catch_warnings(action="error"):
            result = restored(found["data"], nominal)
            as_json(result)
            str(result)  # all that is said of it can be said
    except Exception as error:  # what was saved raises nothing
        raise MeasurementError(
            f"{Path(folder) / RESULT} is damaged ({type(error).__name__}: {str(error)[:100]}); "
            "calibrate again, or take a copy that is whole"
        ) from error
    return result
