"""What the reader of a calibration should know before its numbers, as data."""

from __future__ import annotations

import numpy as np

from pincal.calibration.result import UNEXPLAINED, CalibrationResult
from pincal.estimation.observability.drawings import plausible_changes
from pincal.estimation.observability.unobservable import Held
from pincal.finding import Finding
from pincal.model.setup import ORIGIN, Setup
from pincal.words.sentences import finding

_MUCH = 0.1  # share of rows that do not fit, from which the noise or the model is questioned
_FEW = 1.5  # residuals a parameter, below which more poses are advised


def findings_of(result: CalibrationResult, held: Held | None) -> tuple[Finding, ...]:
    """Return what to know first of a result.

    Args:
        result: The result.
        held: What the measurements cannot observe, if that was held.
    """
    found = []
    if held is not None and (held.groups or held.weak):
        found.append(finding("undetermined-held", groups=held.groups, weak=held.weak))
    return (*found, *_noise(result), *_far(result), *_rows(result), *_legs(result))


def _noise(result: CalibrationResult) -> list[Finding]:
    dof, chi2, noise = result.degrees_of_freedom, result.reduced_chi2, result.noise
    if result.noise_source == "estimated":
        seen = result.calibration.observation
        units = {unit for unit, own in zip(seen.units, seen.measured.T, strict=True) if own.any()}
        return [
            finding(
                "noise-estimated",
                position=noise.position if noise and "m" in units else None,
                orientation=noise.orientation if noise and "rad" in units else None,
                reading=noise.reading if noise else 0.0,
            )
        ]
    if not dof or UNEXPLAINED <= result.chi2_p_value <= 1.0 - UNEXPLAINED:
        return []
    code = "chi2-too-large" if chi2 > 1.0 else "chi2-too-small"
    return [finding(code, chi2=chi2, dof=dof, source=result.noise_source)]


def _far(result: CalibrationResult) -> list[Finding]:
    """Return findings if parameters moved farther than those of one machine differ, or might."""
    options = result.options
    found = [p for leg in result.legs for p in leg.parameters]
    plausible = plausible_changes(result.nominal)
    std, half = (
        np.array(v) for v in zip(*((p.std, (p.high - p.low) / 2) for p in found), strict=True)
    )
    if (weak := np.flatnonzero(std > plausible)).size:
        worst = found[int(np.argmax(std / plausible))]
        return [
            finding(
                "weakly-determined",
                parameters=[found[i].id for i in weak],
                parameter=worst.id,
                half=(worst.high - worst.low) / 2,
                unit=worst.unit,
                held=options.hold_undetermined,
            )
        ]
    surely = (np.abs([p.change for p in found]) - half) / plausible  # beyond its uncertainty
    far = found[int(np.argmax(surely))]
    if surely.max() <= 1.0 or options.rough:
        return []
    return [
        finding(
            "far-from-nominal",
            parameters=[far.id],
            parameter=far.id,
            change=far.change,
            unit=far.unit,
            options=unused_options(options.setup),
        )
    ]


def unused_options(setup: Setup) -> tuple[str, ...]:
    """Return which options that free frame and target a setup leaves out."""
    used = {
        "unknown-frame": setup.unknown_frame,
        "unknown-target": setup.targets[ORIGIN].unknown,
    }
    return tuple(name for name, said in used.items() if not said)


def _rows(result: CalibrationResult) -> list[Finding]:
    found, outliers, total = [], result.outliers, len(result.measurements)
    if outliers and result.loss == "none":
        worst = outliers[0]
        found.append(
            finding(
                "outliers",
                rows=[one.row for one in outliers],
                total=total,
                sigma=worst.sigma,
                quantity=worst.quantity,
                off=worst.off,
            )
        )
    if len(outliers) > _MUCH * total:
        found.append(finding("many-outliers", share=len(outliers) / total))
    return found


def _legs(result: CalibrationResult) -> list[Finding]:
    found = [
        finding("tie-contradicted", name=one.name, p_value=one.p_value)
        for one in result.ties
        if not one.holds
    ]
    return found + [
        finding("few-poses", legs=(leg.name,), poses=leg.n_poses, unknowns=len(leg.parameters))
        for leg in result.legs
        if leg.n_residuals < _FEW * len(leg.parameters)
    ]
