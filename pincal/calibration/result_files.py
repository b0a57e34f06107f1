"""A result folder: ``result.json``, ``residuals.csv``, the nominal and the calibrated mechanism.

``result.json`` says what was found, for people and programs, and holds under ``data`` all
that the result is made of, bit for bit, so that ``load_result`` gives it back.
"""

from __future__ import annotations

import json
import math
import warnings
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, cast, get_origin, get_type_hints

import numpy as np
from cattrs import BaseConverter, Converter
from numpy.typing import NDArray

import pincal.files.output as output
from pincal import __version__
from pincal.calibration.assemble import unreproduced
from pincal.calibration.calibration import Calibration
from pincal.calibration.leg_result import IdentifiedParameter, LegResult
from pincal.calibration.options import Options, Progress, Tolerance
from pincal.calibration.promise import most_uncertain, uncovered
from pincal.calibration.result import CalibrationResult, HtmlPage
from pincal.calibration.validation import Validation
from pincal.errors import MeasurementError, PincalError
from pincal.estimation.noise import NoiseModel
from pincal.estimation.system import LOSSES, Loss, LossName
from pincal.files.measurement_writing import write_plan
from pincal.files.mechanism_folders import load_mechanism, write_mechanism
from pincal.files.table import write_table
from pincal.files.text import LARGEST_FILE, json_text, plain, read_text
from pincal.model.measurements import Measurements, Plan
from pincal.model.mechanism import Mechanism
from pincal.model.setup import Instrument
from pincal.types import Array
from pincal.words.sentences import sentence

_NOT_FINITE = ("inf", "-inf", "nan")
_SAVED_ELSEWHERE = ("calibration", "identified")


def _is_array(kind: Any) -> bool:
    return get_origin(kind) is np.ndarray or kind is np.ndarray


def _plain(array: NDArray[Any]) -> Any:
    """Return an array as its type, shape and numbers; those that are none as strings."""
    flat = array.ravel().tolist()
    numbers = [
        number if number == number and abs(number) < np.inf else str(number) for number in flat
    ]
    return {"type": array.dtype.str, "shape": list(array.shape), "values": numbers}


def _array(data: Any, _: Any) -> NDArray[Any]:
    values = [float(entry) if isinstance(entry, str) else entry for entry in data["values"]]
    return np.array(values, dtype=np.dtype(str(data["type"]))).reshape(data["shape"])


def _number(data: Any, _: Any) -> float:
    return float(data)


def _loss(name: str, _: Any) -> LossName | Loss:
    """Return a loss by its name; one of one's own is code, of which the name alone is known."""

    def weigh(_: Any) -> Any:
        raise MeasurementError(
            f"loss {name!r} is code, which a result's folder does not hold; give it as loss=…"
        )

    if name in ("none", *LOSSES):
        return cast(LossName, name)
    return Loss(name, weigh, 0.5)


def _converter() -> BaseConverter:
    converter = Converter(forbid_extra_keys=True)
    converter.register_unstructure_hook_func(_is_array, _plain)
    converter.register_unstructure_hook(np.ndarray, _plain)
    converter.register_structure_hook_func(_is_array, _array)
    converter.register_unstructure_hook(float, lambda x: x if abs(x) < np.inf else str(x))
    converter.register_structure_hook(float, _number)
    converter.register_structure_hook_func(lambda kind: kind == LossName | Loss, _loss)
    converter.register_structure_hook_func(
        lambda kind: kind == Tolerance, lambda data, _: converter.structure(data, dict[str, float])
    )
    converter.register_structure_hook_func(lambda kind: kind == Progress, lambda *_: None)
    converter.register_structure_hook_func(
        lambda kind: kind == tuple[Instrument, ...], lambda *_: ()
    )
    converter.register_structure_hook_func(lambda kind: kind is Any, lambda data, _: _frozen(data))
    return converter


def _frozen(data: Any) -> Any:
    """Return data of which lists are tuples, as findings hold them; named numbers are numbers."""
    if data in _NOT_FINITE:
        return float(data)
    if isinstance(data, list):
        return tuple(_frozen(entry) for entry in data)
    if isinstance(data, dict):
        return {name: _frozen(value) for name, value in data.items()}
    return data


_CONVERTER = _converter()
_HINTS = get_type_hints(CalibrationResult, localns={"Validation": Validation})


def stored(result: CalibrationResult) -> dict[str, Any]:
    """Return all that a result is made of, as plain data; the nominal mechanism apart.

    Raises:
        MeasurementError: instruments of one's own, which are code, not data.
    """
    if custom := [instrument.name for instrument in result.options.setup.instruments]:
        raise MeasurementError(
            f"instrument {custom[0]!r} is code, which a result's folder does not hold; save the "
            "calibrated mechanism (result.identified.save) and the report"
        )
    options = replace(result.options, progress=None, loss="none")
    return {
        "measurements": _CONVERTER.unstructure(result.measurements),
        "options": _CONVERTER.unstructure(options) | {"loss": result.loss},
        "start": _CONVERTER.unstructure(result.calibration.start),
        "noise_model": _CONVERTER.unstructure(result.calibration.noise),
        **{
            part.name: _CONVERTER.unstructure(getattr(result, part.name))
            for part in fields(CalibrationResult)
            if part.name not in _SAVED_ELSEWHERE
        },
    }


def _worked_out(data: dict[str, Any], name: str, kind: Any) -> Any:
    """Return what a calibration had worked out; None of results saved before this was kept."""
    return None if data.get(name) is None else _CONVERTER.structure(data[name], kind)


def restored(data: dict[str, Any], nominal: Mechanism) -> CalibrationResult:
    """Return the result of plain data; data of another shape raise whatever they raise."""
    options = {name: value for name, value in data["options"].items() if name != "intervals"}
    calibration = Calibration(
        nominal,
        _CONVERTER.structure(data["measurements"], Measurements),
        _CONVERTER.structure(options, Options),
        start=_worked_out(data, "start", Array),
        known_noise=_worked_out(data, "noise_model", NoiseModel),
    )
    fields_found = {
        name: _CONVERTER.structure(data[name], kind)
        for name, kind in _HINTS.items()
        if name not in _SAVED_ELSEWHERE and name in data
    }
    known = [(parameter.id, parameter.unit) for parameter in nominal.parameters]
    if known != [
        (parameter.id, parameter.unit)
        for leg in fields_found["legs"]
        for parameter in leg.parameters
    ]:
        raise ValueError("parameters of another mechanism than the nominal one")
    values = {leg.name: leg.identified for leg in fields_found["legs"]}
    return CalibrationResult(calibration, nominal.with_parameters(values), **fields_found)


FORMAT = 2
REPRODUCED = 1e-9
"""Of a machine's size, [m] and [rad]: within this its residuals, read back, are those reported."""
RESULT, REPORT = "result.json", "report.html"
MECHANISM, NOMINAL = "mechanism", "nominal"
RESULT_FILES = (RESULT, "residuals.csv", "poses.csv", REPORT, MECHANISM, NOMINAL)
"""What pincal writes in a result folder, first the file by which it is known."""


def save_result(
    result: CalibrationResult,
    folder: str | Path,
    *,
    force: bool = False,
    report: HtmlPage | None = None,
) -> Path:
    """Write a result folder, whole or not at all, then its report, and return it.

    A fit that did not converge has no calibrated mechanism, so none is written. One that is written
    reproduces the fit. Arguments are those of ``CalibrationResult.save``.

    Raises:
        FileError: the folder exists and ``force`` is not set, or cannot be written.
        PincalError: the mechanism that would be written does not reproduce the fit.
    """
    with output.writing(folder, force=force, folder=RESULT_FILES) as scratch:
        (scratch / RESULT).write_text(json_text(as_json(result)) + "\n", encoding="utf-8")
        mechanisms = {NOMINAL: result.nominal}
        mechanisms |= {MECHANISM: result.identified} if result.converged else {}
        for name, mechanism in mechanisms.items():
            (scratch / name).mkdir()
            write_mechanism(mechanism, scratch / name)
        if result.converged:
            check_reproduces(result, load_mechanism(scratch / MECHANISM))
        write_table(scratch / "residuals.csv", _residuals(result))
        if result.estimated_poses is not None:
            plan = Plan(result.estimated_poses)
            write_plan(plan, scratch / "poses.csv", result.identified)
    if report is not None:  # drawn when the result is safe
        with output.writing(Path(folder) / REPORT) as scratch:
            scratch.write_text(report.html(), encoding="utf-8")
    return Path(folder)


def check_reproduces(result: CalibrationResult, machine: Mechanism) -> None:
    """Raise if a calibrated machine, saved and loaded, does not give the residuals of its fit.

    Raises:
        PincalError: it does not.
    """
    ratio = unreproduced(result, machine)
    if not ratio <= REPRODUCED:
        raise PincalError(
            "the calibrated mechanism, read back, does not give the residuals of its calibration "
            f"(off by {ratio:.1g} of its size). This is a fault of pincal, not of the "
            "measurements: nothing is written; please report it with mechanism and measurements"
        )


def as_json(result: CalibrationResult) -> dict[str, Any]:
    """Return a result as plain data for JSON; numbers that do not exist are null."""
    noise = {} if result.noise is None else vars(result.noise)
    contents = {
        "pincal_result": FORMAT,
        "pincal": __version__,
        "mechanism": result.nominal.name,
        "calibrated_mechanism": MECHANISM if result.converged else None,
        "method": result.method,
        "residual": result.options.residual,
        "poses": "all" if result.options.every_pose else "own",
        **_named(result, "converged message evaluations reduced_chi2 degrees_of_freedom"),
        "promised": result.promises,
        "promise_leaves_out": uncovered(result),
        "measured_region": most_uncertain(result),
        "contradicted_by": [remark.code for remark in result.contradictions],
        "noise": {"source": result.noise_source, **noise},
        "warnings": result.warnings,
        "findings": [
            vars(remark) | {"rows": [row + 1 for row in remark.rows], "sentence": sentence(remark)}
            for remark in result.findings
        ],
        "loss": result.loss,
        "outliers": [vars(outlier) | {"row": outlier.row + 1} for outlier in result.outliers],
        "external": [_parameter(p) for p in result.external],
        "gauge": [sentence(freedom) for freedom in result.gauge],
        "observed": [_named(part, "name unit count rms sigma") for part in result.observed],
        "weakly_determined": result.weak,
        "validation": result.validation,
        "legs": [_leg(leg) for leg in result.legs],
        "covariance": result.parameter_covariance,
        "data": stored(result),
    }
    return dict(plain(contents))


def _named(instance: object, names: str) -> dict[str, Any]:
    """Return attributes by their names."""
    return {name: getattr(instance, name) for name in names.split()}


def _residuals(result: CalibrationResult) -> dict[str, list[str]]:
    """Return columns of residuals in SI: of the legs, and of what was measured of the platform.

    Legs of exact readings close by construction at poses that were estimated: they are left out.
    """
    series = [
        (leg.name, leg.quantity, leg.unit, leg.rows, leg.residuals, leg.sigma)
        for leg in result.legs
    ]
    series += [
        ("", part.name, part.unit, part.rows, part.residuals, part.sigmas)
        for part in result.observed
    ]
    lines = [
        (leg, str(row + 1), quantity, unit, repr(float(residual)), repr(float(sigma)))
        for leg, quantity, unit, *columns in series
        for row, residual, sigma in zip(*columns, strict=True)
        if sigma > 0.0 or not (leg and result.observed)
    ]
    names = ("leg", "row", "quantity", "unit", "residual", "sigma")
    return {name: [line[place] for line in lines] for place, name in enumerate(names)}


def _leg(leg: LegResult) -> dict[str, Any]:
    return {
        "name": leg.name,
        "parameters": [_parameter(p) for p in leg.parameters],
        "residual_unit": leg.unit,
        **_named(leg, "rank condition rms_before rms_after n_residuals"),
    }


def _parameter(p: IdentifiedParameter) -> dict[str, Any]:
    return {
        **_named(p, "id name unit nominal identified std"),
        "interval_95": [p.low, p.high],
        "given": p.given or None,
        "label": p.label or None,
    }


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"{text[:40]} is not a finite number")
    return value


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    pairs_by_name: dict[str, Any] = {}
    for name, value in pairs:
        if name in pairs_by_name:
            raise ValueError(f"{name[:40]!r} appears twice")
        pairs_by_name[name] = value
    return pairs_by_name


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
    contents = read_result(folder)
    if "data" not in contents:
        raise MeasurementError(
            f"{folder}: a result of version 0.1, which does not hold all that it was made from; "
            "calibrate again, or read it with pincal.calibration.result_files.read_result"
        )
    nominal = load_mechanism(Path(folder) / NOMINAL)
    try:
        with warnings.catch_warnings(action="error"):
            result = restored(contents["data"], nominal)
            as_json(result)
            str(result)  # all that is said of it can be said
    except Exception as error:  # what was saved raises nothing
        raise MeasurementError(
            f"{Path(folder) / RESULT} is damaged ({type(error).__name__}: {str(error)[:100]}); "
            "calibrate again, or take a copy that is whole"
        ) from error
    return result
