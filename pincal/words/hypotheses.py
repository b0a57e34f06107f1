"""Sentences about measurements that cannot be right, and what to do about each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from pincal.model.finding import Finding

_MANY = {"mm": "in mm", "m": "in metres", "deg": "in degrees", "rad": "in radians"}
_HEADER = {
    ("m", "mm"): "a metre header",
    ("m", "m"): "a mm header",
    ("rad", "deg"): "a radian header",
    ("rad", "rad"): "a degree header",
}
_AXES = {axis: f"{axis} has the other sign" for axis in "xyz"} | {"xy": "x and y are exchanged"}
_SIGN = "Change {}, or the sensor's 'direction' in mechanism.yaml"
_ORDER = "Correct the order of columns"
_REMEDIES = {
    "sign-of-readings": _SIGN.format("their sign"),
    "sign-of-column": _SIGN.format("its sign"),
    "columns-exchanged": _ORDER,
    "legs-exchanged": _ORDER,
    "unit": "Correct the units in the headers",
    "left-handed-frame": "Give the poses in the right-handed frame of the base",
    "sign-of-angle": "Change the sign of that angle",
    "orientation-inverted": "Give the orientation of the platform in the base frame",
    "pose-inverted": "Give the poses of the platform in the base frame",
    "rows-shifted": "Bring the logs of poses and readings into step",
    "reading-offset": "Set the sensor's zero, or correct its nominal offset",
    "unknown-frame": "Say that the base stands elsewhere in that frame (--unknown-frame)",
}
#: Codes of hypotheses: what may explain measurements that do not fit.
HYPOTHESES = tuple(_REMEDIES)


def explanation(findings: Sequence[Finding]) -> str:
    """Return one sentence for hypotheses that explain measurements alike, and their remedies."""
    first = findings[0].values
    causes = [f"by {_percent(one.values['left'])} if {cause(one)}" for one in findings]
    if first["other_side"] > 0.5:
        start = (
            f"{100 * first['other_side']:.0f} % of the poses lie on the other side of a "
            "singularity than mechanism.yaml's home; they would lie on its side, and miss "
        )
    elif first["given"] is None:
        start = "readings and measured positions cannot be brought together; they would miss "
    else:
        start = (
            f"{', '.join(first['questioned'])}: the measurements miss every mechanism near the "
            f"nominal one by {_percent(first['given'])} of a leg's length (median), but only "
        )
    return f"{start}{', or '.join(causes)}. {'; or: '.join(_remedies(findings))}"


def cause(finding: Finding) -> str:
    """Return what a hypothesis says, as what follows 'if'."""
    values = finding.values
    legs = f" of {', '.join(values['legs'])}" if values.get("legs") else ""
    words = _cause(finding.code, values, f"the readings{legs}")
    if values["unknown_frame"] and finding.code != "unknown-frame":
        words += " and the base stands elsewhere in their frame"
    return words


def _cause(code: str, values: Mapping[str, Any], readings: str) -> str:
    match code:
        case "sign-of-readings":
            return f"{readings} have the other sign"
        case "sign-of-column" | "sign-of-angle":
            return f"{values['column']} has the other sign"
        case "columns-exchanged":
            return f"{' and '.join(values['columns'])} are exchanged"
        case "legs-exchanged":
            fits = (f"column {column} fits {leg}" for leg, column in values["order"])
            return f"legs are exchanged: {' and '.join(fits)}"
        case "unit":
            return " and ".join(
                f"{readings if name == 'readings' else f'the {name}'} are {_MANY[given]} under "
                f"{_HEADER[unit, given]}"
                for name, unit, given in values["units"]
            )
        case "left-handed-frame" if values["orientations_right"]:
            return f"{_AXES[values['axis']]} and the orientations are right"
        case "left-handed-frame":
            return f"{_AXES[values['axis']]}, as in a left-handed frame"
        case "orientation-inverted":
            return "the orientations turn the other way (that of the base seen from the platform)"
        case "pose-inverted":
            return "the poses are those of the base in the platform's frame"
        case "rows-shifted":
            count, way = abs(values["rows"]), "below" if values["rows"] > 0 else "above"
            rows = "1 row" if count == 1 else f"{count} rows"
            return f"the readings stand {rows} {way} the poses they belong to"
        case "reading-offset":
            off = (f"{name} by about {off:.2g} {unit}" for name, off, unit in values["offsets"])
            return f"the zeros of readings are off: {', '.join(off)}"
        case "unknown-frame":
            return "the poses are those in another frame than the base's"
    raise KeyError(code)


def _remedies(findings: Sequence[Finding]) -> list[str]:
    found = [_REMEDIES[one.code] for one in findings]
    found += [_REMEDIES["unknown-frame"] for one in findings if one.values["unknown_frame"]]
    return list(dict.fromkeys(found))


def _percent(share: float) -> str:
    return f"{float(f'{100 * share:.2g}'):g} %"


def sentence(finding: Finding) -> str:
    """Return the sentence of any finding about measurements that cannot be right."""
    values = finding.values
    if finding.code in _REMEDIES:
        return explanation([finding])
    match finding.code:
        case "readings-still":
            each = (
                f"{name} reads the same in all rows ({value:.6g} {unit})"
                for name, value, unit, _ in values["readings"]
            )
            moves = (f"{moved:.2g} {unit}" for _, _, unit, moved in values["readings"])
            return (
                f"{', '.join(each)}, where readings of the nominal mechanism differ by "
                f"{', '.join(moves)} over these poses. Check the sensor, its cable and the log"
            )
        case "whole-turns":
            many = "reading is" if len(finding.rows) == 1 else "readings are"
            return (
                f"{values['leg']}: {len(finding.rows)} {many} off by whole turns, the first in "
                f"data row {finding.rows[0] + 1}: {values['reading']:.6g} rad, where the nominal "
                f"mechanism reads {values['nominal']:.6g} rad. Count without the turns, or correct "
                "the nominal offset"
            )
        case "other-working-mode":
            each = (
                f"{leg} ({' and '.join(passive)}, in {bent} of {rows} rows)"
                for leg, passive, bent, rows in values["legs"]
            )
            return (
                "readings and poses close the legs, but these bend the other way than in "
                f"mechanism.yaml's home: {', '.join(each)}. Correct 'home' there, or measure in "
                "its working mode"
            )
        case "not-this-mechanism":
            return (
                f"{values['leg']}: the measurements miss the nominal mechanism by "
                f"{100 * values['gap']:.1f} % of a leg's length (median), and no single fault in "
                "units, signs, order, zeros or frame explains it. Check the units, the order and "
                "signs of the readings, the frame of the poses, and that this is the right "
                "mechanism. If it is known but roughly, say so (--rough)"
            )
        case "readings-do-not-follow":
            return (
                f"{values['leg']}: the readings do not follow those of the nominal mechanism "
                f"(machines near it leave {100 * values['left']:.2g} % of the leg's length where "
                f"readings move it by {100 * values['stroke']:.2g} %). Check their order and "
                "signs, the signs and frame of the poses, and the mechanism"
            )
        case "rows-copied":
            (one, other), pairs = values["first"], values["pairs"]
            more = f" (and {pairs - 1} more such pairs)" if pairs > 1 else ""
            return (
                f"data rows {one + 1} and {other + 1} are identical in all that was measured"
                f"{more}; measured twice, they would differ by noise. Remove the copies"
            )
        case "noise-too-large" if values["what"] == "position":
            return (
                f"the noise of position is given as {values['given']:g} m, more than "
                f"{100 * values['most'] / values['size']:.0f} % of a leg's length "
                f"({values['size']:.3g} m). It is in metres"
            )
        case "noise-too-large":
            return (
                f"the noise of orientation is given as {values['given']:g} rad; expected less than "
                f"{values['most']:g}. It is in radians"
            )
        case "bad-rows":
            more = f", and {len(finding.rows) - 1} more rows so" if len(finding.rows) > 1 else ""
            return (
                f"data row {values['worst'] + 1} misses the nominal mechanism "
                f"{values['times']:.3g} times as far as rows usually do{more}: look for a slip "
                "there first, or leave such rows out (--robust reject)"
            )
        case "frame-misaligned":
            how = {
                "base": "is the tracker's frame the base's (--unknown-frame)?",
                "platform": "is the target the platform's origin (--unknown-target)?",
            }
            shift = f"{1e3 * values['shift']:.3g} mm"
            if values["turn"] is not None:
                shift += f" and {1e3 * values['turn']:.3g} mrad"
            return (
                f"{100 * values['share']:.0f} % of what the nominal model is off by (in squares) "
                f"is one motion of the {values['frame']}'s frame, by {shift}, and parameters that "
                f"differ each in its own way hardly move so (p = {values['p_value']:.1g}): "
                f"{how[values['remedy']]} Else where the frame lies is taken for errors of the "
                "machine"
            )
    raise KeyError(finding.code)
