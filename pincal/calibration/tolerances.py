"""How far machines differ from their drawing, found with the parameters: ``--tolerance auto``.

The standard deviations of parameters, one for each unit, are variance components, as those of the
noise are: what the measurements say of all deviations together. Fits and sizes follow each other.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.special import chdtri

from pincal.calibration.calibration import Calibration
from pincal.calibration.fits import BY, Fits, fitted
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
    asked = [unit for unit, ids in units.items() if len(ids) > 2]  # one or two say nothing
    groups = {id_: place for place, unit in enumerate(asked) for id_ in units[unit]}
    ends = np.array([far[unit] for unit in asked])
    sizes = ends
    calibration = calibration.with_options(tolerance=dict(zip(asked, sizes, strict=True)))
    answer = None
    for _ in range(BY.rounds if asked else 0):
        calibration.options.report("finding how far the machine is from its drawing")
        parts = [Evidence.of(one.fit, groups) for one in fitted(calibration).fits]
        rise = float(chdtri(1, 1.0 - CONFIDENCE))
        answer = likeliest(parts, sizes, (ALIKE * ends, ends), rise)
        moved = np.abs(np.log(answer.most / sizes)).max()
        sizes = answer.most
        known = {unit: float(one) for unit, one in zip(asked, sizes, strict=True)}
        calibration = calibration.with_options(tolerance=known)
        if moved <= BY.alike:
            break
    found = []
    for unit, ids in units.items():
        place = asked.index(unit) if unit in asked else None
        if place is None or answer is None:
            found.append(FoundTolerance(unit, np.inf, 0.0, np.inf, len(ids)))
            continue
        low, high = answer.ends[place].tolist()
        found.append(FoundTolerance(unit, float(sizes[place]), low, high, len(ids)))
    return replace(calibration, tolerances=tuple(found))


def with_unsure_tolerances(found: Fits) -> Fits:
    """Return fits with what uncertain tolerances add to their covariances.

    By how far the estimate follows the logarithm of each, to first order: ∂φ/∂ log τ² =
    C (φ − φ₀) / τ² of the parameters of that unit (R. E. Kass and D. Steffey 1989). What the
    measurements determine of k of them is worth k − tr C / τ² (D. J. C. MacKay 1992), and log τ²
    is known as if so many were seen.
    """
    mechanism, fits = found.calibration.mechanism, []
    units = {one.id: one.unit for one in mechanism.parameters}
    for robust in found.fits:
        fit = robust.fit
        unknowns, covariance = fit.unknowns, fit.covariance
        values = fit.system.values(fit.last.state) - unknowns.nominal
        for one in found.calibration.tolerances:
            alike = np.array([units.get(id_) == one.unit for id_ in unknowns.labels])
            own = alike & (unknowns.priors == one.size)  # others have one of their own
            pull = np.where(own, values / one.size**2, 0.0)
            seen = own.sum() - np.diagonal(fit.covariance)[own].sum() / one.size**2
            unsure = np.sqrt(2.0 / max(seen, 0.5))  # of the logarithm; at most a factor of e²
            by = unsure / fit.noise_scale**2 * (fit.covariance @ pull)
            covariance = covariance + np.outer(by, by)
        fits.append(replace(robust, fit=replace(fit, covariance=covariance)))
    return replace(found, fits=fits)


def _units(calibration: Calibration) -> dict[str, list[str]]:
    """Return ids of the parameters whose tolerance is to be found, by unit."""
    found: dict[str, list[str]] = {}
    free = calibration.unknowns()
    moved = dict(zip(free.labels, free.map.any(axis=1) & ~np.isfinite(free.priors), strict=True))
    for one in calibration.mechanism.parameters:
        if moved[one.id] and one.id not in calibration.mechanism.amplitudes:
            found.setdefault(one.unit, []).append(one.id)
    return found
