"""Zeros of motors that are far from the drawing's: where the search for them starts.

Full poses give the nominal readings in closed form; what was read less these is the zero. The
search starts there if nothing else explains the measurements and the zero is identified.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pincal.calibration.calibration import Calibration
from pincal.calibration.hypotheses.faults import offsets_of
from pincal.calibration.hypotheses.sample import placed, sample_of
from pincal.finding import Finding

Array = NDArray[np.float64]


def zeros_found(calibration: Calibration, found: Sequence[Finding]) -> Array | None:
    """Return where the search starts if zeros explain what does not fit, shape (n_params,).

    None if something else may explain it, or if a zero is not identified.

    Args:
        calibration: What is to be identified.
        found: Hypotheses that explain the measurements.
    """
    offsets = np.zeros(len(calibration.mechanism.reading_names))
    for one in found:
        if one.code != "reading-offset" or one.values["unknown_frame"]:
            return None
        for name, off, _ in one.values["offsets"]:
            offsets[calibration.mechanism.reading_names.index(name)] = off
    return _started(calibration, offsets) if len(found) == 1 else None


def zeros_measured(calibration: Calibration) -> Array | None:
    """Return where the search starts with the zeros that full poses show, shape (n_params,).

    None without full poses, or if no zero is identified.
    """
    mechanism = calibration.mechanism
    sample = sample_of(mechanism, calibration.measurements, calibration.options.setup)
    if sample is None or mechanism.by_readings or sample.free or not sample.oriented:
        return None
    (there,) = placed([sample])
    if there is None:
        return None
    offsets = offsets_of(sample, there[0])
    own = [index for index, _ in _zeros(calibration)]
    return _started(calibration, np.where(np.isin(np.arange(len(offsets)), own), offsets, 0.0))


def _started(calibration: Calibration, offsets: Array) -> Array | None:
    """Return the nominal parameters with zeros of readings that are off, if all are identified."""
    start = np.concatenate([leg.nominal for leg in calibration.mechanism.legs])
    zeros = dict(_zeros(calibration))
    for index in np.flatnonzero(offsets).tolist():
        if index not in zeros:
            return None
        place, by_reading = zeros[index]
        start[place] += by_reading * offsets[index]
    return start if offsets.any() else None


def _zeros(calibration: Calibration) -> list[tuple[int, tuple[int, float]]]:
    """Return of each reading whose zero is identified: its parameter, and how that follows.

    ψ = d k q + γ grows with γ; q = d k ψ + γ falls by d k of it. Zeros with priors, ties or terms,
    or of several sensors, start at nominal.
    """
    unknowns = calibration.unknowns()
    free = unknowns.map != 0.0
    alone = free[:, free.sum(axis=0) == 1].sum(axis=1) == 1
    found, first, index = [], 0, 0
    for leg in calibration.mechanism.legs:
        offsets = [sensor.offset for sensor in leg.sensors]
        for sensor, name in zip(leg.sensors, offsets, strict=True):
            if isinstance(name, str) and offsets.count(name) == 1 and not sensor.terms:
                place = first + leg.parameter_names.index(name)
                gain, _ = sensor.constants(leg.nominal_by_name)
                if alone[place] and np.isinf(unknowns.priors[place]):
                    found.append((index, (place, 1.0 if sensor.form == "reading" else -gain)))
            index += 1
        first += len(leg.parameters)
    return found
