"""A result folder: ``result.json``, ``residuals.csv``, the nominal and the calibrated mechanism.

``result.json`` has the result for people and programs, and under ``data`` all its parts bit for
bit, from which ``load_result`` restores it.
"""

from __future__ import annotations

import json
import math
import warnings
from dataclasses import replace
from functools import partial
from operator import eq
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_origin

import numpy as np
from cattrs import Converter
from numpy.typing import NDArray

import pincal.files.output as output
from pincal import __version__
from pincal.calibration.calibration import Calibration, located
from pincal.calibration.options import Progress, Tolerance
from pincal.calibration.promise import most_uncertain, uncovered
from pincal.calibration.result import CalibrationResult
from pincal.calibration.result_parts import IdentifiedParameter
from pincal.errors import FileError, MeasurementError, PincalError
from pincal.estimation.unknowns import State
from pincal.files.columns import write_plan
from pincal.files.mechanism_folders import load_mechanism, write_mechanism
from pincal.files.table import write_table
from pincal.files.text import LARGEST_FILE, plain, read_text
from pincal.instruments.camera import Camera, Markers
from pincal.instruments.lens import Lens
from pincal.kinematics.configurations import planned_influences
from pincal.kinematics.influences import by_name
from pincal.model import LOAD, Mechanism, Plan
from pincal.model.checks import check_kinds
from pincal.model.relations import Instrument
from pincal.types import Array
from pincal.words.findings import sentence

if TYPE_CHECKING:
    from pincal.show.report import Report


def _plain(array: NDArray[Any]) -> Any:
    """Return an array as its type, shape and numbers; NaN and infinities as strings."""
    numbers = [_CONVERTER.unstructure(number) for number in array.ravel().tolist()]
    return {"type": array.dtype.str, "shape": list(array.shape), "values": numbers}


def _array(data: Any, _: Any) -> NDArray[Any]:
    values = [float(entry) if isinstance(entry, str) else entry for entry in data["values"]]
    return np.array(values, dtype=np.dtype(str(data["type"]))).reshape(data["shape"])


def _frozen(data: Any) -> Any:
    """Return data with tuples for lists, as findings have them, and numbers for their names."""
    if data in ("inf", "-inf", "nan"):
        return float(data)
    if isinstance(data, list):
        return tuple(_frozen(entry) for entry in data)
    if isinstance(data, dict):
        return {name: _frozen(value) for name, value in data.items()}
    return data


def _converter() -> Converter:
    """Return the converter between results and plain data, without mechanisms and code."""
    converter = Converter(forbid_extra_keys=True)

    def checked(data: dict[str, Any], kind: type) -> Any:
        """Return a part of a camera, whose constructor checks the data."""
        parts = {"lens": Lens, "markers": Markers}
        return kind(
            **{
                n: converter.structure(v, parts[n]) if n in parts else _frozen(v)
                for n, v in data.items()
            }
        )

    def is_array(kind: Any) -> bool:
        return get_origin(kind) is np.ndarray or kind is np.ndarray

    converter.register_unstructure_hook_func(is_array, _plain)
    converter.register_unstructure_hook(np.ndarray, _plain)
    converter.register_unstructure_hook(float, lambda x: x if abs(x) < np.inf else str(x))
    converter.register_unstructure_hook(Mechanism, lambda _: None)
    converter.register_unstructure_hook_func(lambda kind: kind == Progress, lambda _: None)
    converter.register_structure_hook_func(is_array, _array)
    converter.register_structure_hook(float, lambda data, _: float(data))
    for structured, structure in (
        (Progress, lambda *_: None),
        (Tolerance, lambda data, _: converter.structure(data, dict[str, float])),
        (tuple[Instrument, ...], lambda data, _: tuple(checked(part, Camera) for part in data)),
        (Any, lambda data, _: _frozen(data)),
    ):
        converter.register_structure_hook_func(partial(eq, structured), structure)
    for kind in (Lens, Markers):
        converter.register_structure_hook(kind, checked)
    return converter


_CONVERTER = _converter()


FORMAT = 8
REPRODUCED = 1e-9
"""Largest difference of reported residuals from the saved machine's, of its size and [rad]."""
_REMEDY = "calibrate the measurements again, or take a copy that is whole"
RESULT, REPORT = "result.json", "report.html"
MECHANISM, NOMINAL = "mechanism", "nominal"
RESULT_FILES = (RESULT, "residuals.csv", "poses.csv", REPORT, MECHANISM, NOMINAL)
"""Files of a result folder; the first one identifies it."""


def save_result(
    result: CalibrationResult,
    folder: str | Path,
    *,
    force: bool = False,
    report: Report | None = None,
) -> Path:
    """Write a result folder; arguments and errors are as in ``CalibrationResult.save``.

    A calibrated mechanism is written only if the fit converged and the mechanism reproduces it.

    Raises:
        MeasurementError: there are a user's instruments, which are code, not data.
        PincalError: the mechanism that would be written does not reproduce the fit.
    """
    devices = result.options.setup.instruments
    if custom := [device.name for device in devices if not isinstance(device, Camera)]:
        raise MeasurementError(
            f"instrument {custom[0]!r} is code, which a result's folder does not hold; save the "
            "calibrated mechanism (result.identified.save) and the report"
        )
    with output.writing(folder, force=force, folder=RESULT_FILES) as scratch:
        text = json.dumps(plain(as_json(result)), indent=2, ensure_ascii=False, allow_nan=False)
        (scratch / RESULT).write_text(f"{text}\n", encoding="utf-8")
        mechanisms = {NOMINAL: result.nominal}
        mechanisms |= {MECHANISM: result.identified} if result.converged else {}
        for name, mechanism in mechanisms.items():
            (scratch / name).mkdir()
            write_mechanism(mechanism, scratch / name)
        if result.converged:
            check_reproduces(result, load_mechanism(scratch / MECHANISM))
        write_table(scratch / "residuals.csv", _residuals(result))
        if result.estimated_poses is not None:
            write_plan(Plan(result.estimated_poses), scratch / "poses.csv", result.identified)
    if report is not None:  # drawn when the result is safe
        with output.writing(Path(folder) / REPORT) as scratch:
            scratch.write_text(report.html(), encoding="utf-8")
    return Path(folder)


def check_reproduces(result: CalibrationResult, machine: Mechanism) -> None:
    """Raise if a calibrated machine, saved and loaded, does not give the residuals of its fit.

    Compared are the least twists of the platform that close the legs at poses and rows of the fit,
    of the machine with the influences that it computes itself, and by the fitted parameters.
    """
    calibration, rows = result.calibration, np.arange(len(result.poses))
    data = replace(calibration.measurements, influences=_influences_again(calibration, machine))
    fitted = replace(calibration, mechanism=result.identified)  # whose legs have the same sizes
    saved = replace(calibration, mechanism=machine, measurements=data)
    identified = np.concatenate([leg.identified for leg in result.legs])
    twists: list[list[Array]] = []
    for fit, parameters in ((fitted, identified), (saved, machine.parameters.values)):
        block = fit.leg_block(range(len(result.legs)), rows, fit.used)
        missing = block.evaluate(State(parameters, machine.platform.matrices(result.poses)))
        undone = (
            np.linalg.pinv(missing.by_pose[:, leg]) @ missing.value[:, leg, None]
            for leg in block.leg_rows
        )
        twists.append([twist[leg.rows] for twist, leg in zip(undone, result.legs, strict=True)])
    off = np.concatenate([(a - b).ravel() for a, b in zip(*twists, strict=True)])
    ratio = np.abs(off).max(initial=0.0) / max(1.0, machine.size)
    if not ratio <= REPRODUCED:  # NaN neither
        raise PincalError(
            "the calibrated mechanism, read back, does not give the residuals of its calibration "
            f"(off by {ratio:.1g} of its size). This is a fault of pincal, not of the "
            "measurements: nothing is written; please report it with mechanism and measurements"
        )


def _influences_again(calibration: Calibration, machine: Mechanism) -> dict[str, Array]:
    """Return the influences at the rows of a calibration as the machine computes them itself.

    They are at the poses of the fit; measured influences, which no mechanism knows, are omitted.
    """
    data = calibration.measurements
    names = calibration.mechanism.followed & set(calibration.mechanism.influences)
    if not names:
        return dict(data.influences)
    loads = names & {f"{LOAD}_{name}" for name in calibration.mechanism.load_names}
    rows = located(calibration) if loads else data
    measured = {name: v for name, v in data.influences.items() if name not in names}
    rows = replace(rows, influences=measured)
    before, after = (
        by_name(mechanism, planned_influences(mechanism, rows))
        for mechanism in (calibration.mechanism, machine)
    )
    followed = {
        name: after[name]
        for name in names
        if np.allclose(before[name], data.influences[name], rtol=1e-9, atol=0.0, equal_nan=True)
    }
    return {**data.influences, **followed}


def as_json(result: CalibrationResult) -> dict[str, Any]:
    """Return a result as plain data for JSON, with null for NaN and infinities.

    ``data`` has all parts of the result except mechanisms.
    """
    held_out, noise = result.validation, {} if result.noise is None else vars(result.noise)
    contents = {
        "pincal_result": FORMAT,
        "pincal": __version__,
        "mechanism": result.nominal.name,
        "calibrated_mechanism": MECHANISM if result.converged else None,
        "method": result.method,
        "poses": "all" if result.options.every_pose else "own",
        **_named(result, "converged message reduced_chi2 degrees_of_freedom"),
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
        "observed": [
            _named(part, "name unit")
            | {"count": part.n_residuals, "rms": part.rms_after, "sigma": part.rms_noise}
            for part in result.observed
        ],
        "validation": held_out and vars(held_out) | _named(held_out, "position orientation"),
        "legs": [
            _named(leg, "name rank condition rms_before rms_after n_residuals")
            | {"parameters": [_parameter(p) for p in leg.parameters], "residual_unit": leg.unit}
            for leg in result.legs
        ],
        "covariance": result.parameter_covariance,
        "data": _CONVERTER.unstructure(result),
    }
    return dict(plain(contents))


def _residuals(result: CalibrationResult) -> dict[str, list[str]]:
    """Return columns of residuals in SI, without legs that close by construction."""
    groups = [*((leg.name, leg) for leg in result.legs), *(("", part) for part in result.observed)]
    lines = [
        (leg, str(row + 1), part.quantity, part.unit, repr(float(residual)), repr(float(sigma)))
        for leg, part in groups
        for row, residual, sigma in zip(part.rows, part.residuals, part.sigma, strict=True)
        if sigma > 0.0 or not (leg and result.observed)
    ]
    names = ("leg", "row", "quantity", "unit", "residual", "sigma")
    return {name: [line[place] for line in lines] for place, name in enumerate(names)}


def _named(instance: object, names: str) -> dict[str, Any]:
    return {name: getattr(instance, name) for name in names.split()}


def _parameter(p: IdentifiedParameter) -> dict[str, Any]:
    return {
        **_named(p, "id name unit nominal identified std"),
        "interval_95": [p.low, p.high],
        "given": p.given or None,
        "label": p.label or None,
    }


def _finite(text: str) -> float:
    if not math.isfinite(float(text)):
        raise ValueError(f"{text[:40]} is not a finite number")
    return float(text)


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    names = [name for name, _ in pairs]
    if twice := [name for place, name in enumerate(names) if name in names[:place]]:
        raise ValueError(f"{twice[0][:40]!r} appears twice")
    return dict(pairs)


def read_result(folder: str | Path) -> dict[str, Any]:
    """Return the contents of a folder's ``result.json``; errors are as in ``load_result``."""
    check_kinds(locals(), read_result, FileError)
    path = Path(folder) / RESULT
    try:
        text = read_text(path, LARGEST_FILE["result"], MeasurementError)
    except FileError as error:
        raise FileError(f"{error}; 'pincal calibrate … -o RESULT' makes a result") from error
    try:
        data = json.loads(
            text, parse_float=_finite, parse_constant=_finite, object_pairs_hook=_once
        )
    except (ValueError, RecursionError) as error:
        cause = str(error).partition(";")[0]
        raise MeasurementError(f"{path} is damaged ({cause}); {_REMEDY}") from error
    if not isinstance(data, dict) or "pincal_result" not in data:
        raise MeasurementError(f"{path} is not a result of pincal; {_REMEDY}")
    if data["pincal_result"] != FORMAT:
        version = str(data.get("pincal", "of unknown version"))[:20]
        raise MeasurementError(
            f"{path} was saved by pincal {version} in a format that this version does not load; "
            "calibrate the measurements again, or load it with that version"
        )
    return data


def load_result(folder: str | Path) -> CalibrationResult:
    """Return the result that was saved to a folder, bit for bit.

    Raises:
        FileError: a file is missing or cannot be read.
        MeasurementError: it is not a result of pincal, or is damaged, or of another version.
        MechanismError: the nominal mechanism cannot be loaded.
    """
    contents = read_result(folder)
    nominal, converter = load_mechanism(Path(folder) / NOMINAL), _CONVERTER.copy()
    converter.register_structure_hook(Mechanism, lambda *_: nominal)
    try:
        with warnings.catch_warnings(action="error"):
            result = converter.structure(contents["data"], CalibrationResult)
            parameters = [(p.id, p.unit) for leg in result.legs for p in leg.parameters]
            if parameters != [(p.id, p.unit) for p in nominal.parameters]:
                raise ValueError("parameters of another mechanism than the nominal one")
            as_json(result)
            str(result)  # all that is said of it can be said
    except Exception as error:  # what was saved raises nothing
        raise MeasurementError(
            f"{Path(folder) / RESULT} is damaged, or was saved by another version of pincal: it is "
            f"no whole result of the mechanism beside it; {_REMEDY}"
        ) from error
    return result
