"""How far machines differ from their drawing, found with the parameters: ``--tolerance auto``.

The standard deviations of parameters, one for each unit, are variance components, as those of the
noise are: what the measurements say of all deviations together. Fits and sizes follow each other.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.special import chdtri

from pincal.calibration.calibration import Calibration
from pincal.calibration.fits import ROUNDS, SETTLED, Fits, fitted
from pincal.calibration.options import AUTO
from pincal.design.platform_error import CONFIDENCE
from pincal.errors import MeasurementError
from pincal.estimation.noise import Evidence, FoundTolerance, likeliest
from pincal.estimation.observability.indices import DIFFER
from pincal.kinematics.closure import largest_size
from pincal.model.checks import ALIKE


def with_found_tolerance(calibration: Calibration) -> Calibration:
    """Return a calibration with tolerances found by its measurements, if it asks for that.

    Raises:
        MeasurementError: residuals of readings, which are not white.
        ObservabilityError: what leaves parameters undetermined, tolerances or not.
    """
    if calibration.options.tolerance != AUTO:
        return calibration
    if calibration.options.residual == "joint":
        raise MeasurementError(
            "the size of tolerances is asked of white residuals, which those of readings "
            "(--residual joint) are not; leave that out, or give tolerances (--tolerance 0.5mm)"
        )
    units = _units(calibration)
    size = largest_size(calibration.mechanism.legs)
    far = {unit: DIFFER * (size if unit == "m" else 1.0) for unit in units}
    sought_units = [unit for unit, ids in units.items() if len(ids) > 2]  # one or two say nothing
    groups = {id_: place for place, unit in enumerate(sought_units) for id_ in units[unit]}
    ends = np.array([far[unit] for unit in sought_units])
    sizes = ends
    calibration = calibration.with_options(tolerance=dict(zip(sought_units, sizes, strict=True)))
    answer = None
    for _ in range(ROUNDS if sought_units else 0):
        calibration.options.report("finding how far the machine is from its drawing")
        parts = [Evidence.of(fit, groups) for fit in fitted(calibration).fits]
        rise = float(chdtri(1, 1.0 - CONFIDENCE))
        answer = likeliest(parts, sizes, (ALIKE * ends, ends), rise)
        moved = np.abs(np.log(answer.most / sizes)).max()
        sizes = answer.most
        known = {unit: float(one) for unit, one in zip(sought_units, sizes, strict=True)}
        calibration = calibration.with_options(tolerance=known)
        if moved <= SETTLED:
            break
    tolerances = []
    for unit, ids in units.items():
        place = sought_units.index(unit) if unit in sought_units else None
        if place is None or answer is None:
            tolerances.append(FoundTolerance(unit, np.inf, 0.0, np.inf, len(ids)))
            continue
        low, high = answer.ends[place].tolist()
        tolerances.append(FoundTolerance(unit, float(sizes[place]), low, high, len(ids)))
    return replace(calibration, tolerances=tuple(tolerances))


def with_unsure_tolerances(fits_of_all: Fits) -> Fits:
    """Return fits with what uncertain tolerances add to their covariances.

    By how far the estimate follows the logarithm of each, to first order: ∂φ/∂ log τ² =
    C (φ − φ₀) / τ² of the parameters of that unit (R. E. Kass and D. Steffey 1989). What the
    measurements determine of k of them is worth k − tr C / τ² (D. J. C. MacKay 1992), and log τ²
    is known as if so many were seen.
    """
    mechanism, fits = fits_of_all.calibration.mechanism, []
    units = {parameter.id: parameter.unit for parameter in mechanism.parameters}
    for fit in fits_of_all.fits:
        unknowns, widening = fit.unknowns, fit.widening
        values = np.zeros_like(unknowns.nominal)
        values[: len(fit.parameters)] = fit.parameters - unknowns.nominal[: len(fit.parameters)]
        for tolerance in fits_of_all.calibration.tolerances:
            of_unit = np.array([units.get(id_) == tolerance.unit for id_ in unknowns.labels])
            tolerated = of_unit & (
                unknowns.priors == tolerance.size
            )  # others have one of their own
            pull = np.where(tolerated, values / tolerance.size**2, 0.0)
            determined = (
                tolerated.sum() - np.diagonal(fit.covariance)[tolerated].sum() / tolerance.size**2
            )
            unsure = np.sqrt(2.0 / max(determined, 0.5))  # of the logarithm; at most a factor of e²
            follows = unsure / fit.noise_scale**2 * (fit.covariance @ pull)
            widening = widening + np.outer(follows, follows)
        fits.append(replace(fit, widening=widening))
    return replace(fits_of_all, fits=fits)


def _units(calibration: Calibration) -> dict[str, list[str]]:
    """Return ids of the parameters whose tolerance is to be found, by unit."""
    ids_by_unit: dict[str, list[str]] = {}
    free = calibration.unknowns()
    moved = dict(zip(free.labels, free.map.any(axis=1) & ~np.isfinite(free.priors), strict=True))
    for parameter in calibration.mechanism.parameters:
        if moved[parameter.id] and parameter.id not in calibration.mechanism.amplitudes:
            ids_by_unit.setdefault(parameter.unit, []).append(parameter.id)
    return ids_by_unit
