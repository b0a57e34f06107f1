"""What decides whether to believe a calibration, in three cells: χ², the loss, held-out rows."""

from __future__ import annotations

from typing import NamedTuple

from pincal.calibration.result import CalibrationResult
from pincal.words.numbers import chance, counted, rounded


class Verdict(NamedTuple):
    """A cell: what it is of, its number, what that means."""

    name: str
    value: str
    text: str
    kind: str
    """``"good"``, ``"care"``, ``"bad"``, or empty if it says nothing."""


def verdicts(result: CalibrationResult) -> tuple[Verdict, ...]:
    """Return the three cells of a calibration."""
    return _chi2(result), _loss(result), _held_out(result)


def _chi2(result: CalibrationResult) -> Verdict:
    dof, value = result.degrees_of_freedom, rounded(result.reduced_chi2, 3)
    text = f"on {dof} degrees of freedom; "
    if result.noise_source == "estimated":
        return Verdict("reduced χ²", value, text + "these residuals made the noise", "")
    kind = "bad" if result.excess > 1.0 else "good"
    return Verdict("reduced χ²", value, text + chance(result.chi2_p_value), kind)


def _loss(result: CalibrationResult) -> Verdict:
    many = len(result.outliers)
    text = f"{counted(many, 'row')} {'does' if many == 1 else 'do'} not fit"
    if result.shift is not None:
        text += f"; without it parameters move by {result.shift:.2g} standard errors at most"
    return Verdict("loss", result.loss, text, "care" if many else "good")


def _held_out(result: CalibrationResult) -> Verdict:
    one = result.validation
    if one is None:
        return Verdict("held-out rows", "–", "not asked for", "")
    text = f"those of the fit {one.fit:.2f} σ, expected {one.expected:.2f} σ; {chance(one.p_value)}"
    worse = any(found.code.startswith("held-out") for found in one.findings)
    return Verdict("held-out rows", f"{one.held_out:.2f} σ", text, "bad" if worse else "good")
