"""All that a result is made of as plain data, bit for bit, and back again."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any, cast, get_origin, get_type_hints

import numpy as np
from cattrs import BaseConverter, Converter
from numpy.typing import NDArray

from pincal.calibration.calibration import Calibration
from pincal.calibration.checks.runs import RunComparison
from pincal.calibration.checks.validation import Validation
from pincal.calibration.options import Options, Progress, Tolerance
from pincal.calibration.result import CalibrationResult
from pincal.errors import MeasurementError
from pincal.estimation.residuals.losses import LOSSES, Loss, LossName
from pincal.estimation.variances.noise import NoiseModel
from pincal.model.measuring.instrument import Instrument
from pincal.model.measuring.measurements import Measurements
from pincal.model.mechanism import Mechanism

_NOT_FINITE = ("inf", "-inf", "nan")
_APART = ("calibration", "identified")
_REPORTS = {"Validation": Validation, "RunComparison": RunComparison}


def _is_array(kind: Any) -> bool:
    return get_origin(kind) is np.ndarray or kind is np.ndarray


def _plain(array: NDArray[Any]) -> Any:
    """Return an array as its type, shape and numbers; those that are none as strings."""
    flat = array.ravel().tolist()
    numbers = [one if one == one and abs(one) < np.inf else str(one) for one in flat]
    return {"type": array.dtype.str, "shape": list(array.shape), "values": numbers}


def _array(data: Any, _: Any) -> NDArray[Any]:
    values = [float(one) if isinstance(one, str) else one for one in data["values"]]
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
    found = Converter(forbid_extra_keys=True)
    found.register_unstructure_hook_func(_is_array, _plain)
    found.register_unstructure_hook(np.ndarray, _plain)
    found.register_structure_hook_func(_is_array, _array)
    found.register_unstructure_hook(float, lambda x: x if abs(x) < np.inf else str(x))
    found.register_structure_hook(float, _number)
    found.register_structure_hook_func(lambda kind: kind == LossName | Loss, _loss)
    found.register_structure_hook_func(
        lambda kind: kind == Tolerance, lambda data, _: found.structure(data, dict[str, float])
    )
    found.register_structure_hook_func(lambda kind: kind == Progress, lambda *_: None)
    found.register_structure_hook_func(lambda kind: kind == tuple[Instrument, ...], lambda *_: ())
    found.register_structure_hook_func(lambda kind: kind is Any, lambda data, _: _frozen(data))
    return found


def _frozen(data: Any) -> Any:
    """Return data of which lists are tuples, as findings hold them; named numbers are numbers."""
    if data in _NOT_FINITE:
        return float(data)
    if isinstance(data, list):
        return tuple(_frozen(one) for one in data)
    if isinstance(data, dict):
        return {name: _frozen(value) for name, value in data.items()}
    return data


_CONVERTER = _converter()
_HINTS = get_type_hints(CalibrationResult, localns=dict(_REPORTS))


def stored(result: CalibrationResult) -> dict[str, Any]:
    """Return all that a result is made of, as plain data; the nominal mechanism apart.

    Raises:
        MeasurementError: instruments of one's own, which are code, not data.
    """
    if own := [one.name for one in result.options.setup.instruments]:
        raise MeasurementError(
            f"instrument {own[0]!r} is code, which a result's folder does not hold; save the "
            "calibrated mechanism (result.identified.save) and the report"
        )
    options = replace(result.options, progress=None, loss="none")
    return {
        "measurements": _CONVERTER.unstructure(result.measurements),
        "options": _CONVERTER.unstructure(options) | {"loss": result.loss},
        "start": _CONVERTER.unstructure(result.calibration.start),
        "noise_model": _CONVERTER.unstructure(result.calibration.noise),
        **{
            one.name: _CONVERTER.unstructure(getattr(result, one.name))
            for one in fields(CalibrationResult)
            if one.name not in _APART
        },
    }


def _kept(data: dict[str, Any], name: str, kind: Any) -> Any:
    """Return what a calibration had worked out; None of results saved before this was kept."""
    return None if data.get(name) is None else _CONVERTER.structure(data[name], kind)


def restored(data: dict[str, Any], nominal: Mechanism) -> CalibrationResult:
    """Return the result of plain data; data of another shape raise whatever they raise."""
    calibration = Calibration(
        nominal,
        _CONVERTER.structure(data["measurements"], Measurements),
        _CONVERTER.structure(data["options"], Options),
        start=_kept(data, "start", NDArray[np.float64]),
        known_noise=_kept(data, "noise_model", NoiseModel),
    )
    found = {
        name: _CONVERTER.structure(data[name], kind)
        for name, kind in _HINTS.items()
        if name not in _APART and name in data
    }
    known = [(one.id, one.unit) for one in nominal.parameters]
    if known != [(one.id, one.unit) for leg in found["legs"] for one in leg.parameters]:
        raise ValueError("parameters of another mechanism than the nominal one")
    values = {leg.name: leg.identified for leg in found["legs"]}
    return CalibrationResult(calibration, nominal.with_parameters(values), **found)
