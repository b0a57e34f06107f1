"""What is said of hypotheses: what may explain measurements that no mechanism like this gives.

``says`` of each is what follows 'if'; hypotheses that explain measurements alike are one sentence.
"""

from __future__ import annotations

from collections.abc import Sequence

from pincal.finding import Finding
from pincal.words.numbers import counted, percent, rounded
from pincal.words.wording import Wording, Words

_UNIT_NAMES = {"mm": "in mm", "m": "in metres", "deg": "in degrees", "rad": "in radians"}
_HEADER = {
    ("m", "mm"): "a metre header",
    ("m", "m"): "a mm header",
    ("rad", "deg"): "a radian header",
    ("rad", "rad"): "a degree header",
}
_AXES = {axis: f"{axis} has the other sign" for axis in "xyz"} | {
    first + second: f"{first} and {second} are exchanged" for first, second in ("xy", "xz", "yz")
}
_SIGN = "Change {}, or the sensor's 'direction' in mechanism.yaml"
_ORDER = "Correct the order of columns"
#: What every hypothesis says beside its own values.
_COMMON = {
    "legs": "names of the legs whose readings it concerns; empty for all",
    "left": "misfit that it leaves, in lengths of a leg",
    "unknown_frame": "whether the base is elsewhere in the frame of the measurements too",
    "given": "misfit as measured, in lengths of a leg (median); None where nothing fits together",
    "questioned": "names of the legs that do not fit as measured",
    "other_side": "share of the poses on the other side of a singularity than home",
}


def _readings(finding: Finding) -> str:
    legs = finding.values["legs"]
    return f"the readings of {', '.join(legs)}" if legs else "the readings"


def _units(finding: Finding) -> str:
    return " and ".join(
        f"{_readings(finding) if name == 'readings' else f'the {name}'} are "
        f"{_UNIT_NAMES[written]} under {_HEADER[unit, written]}"
        for name, unit, written in finding.values["units"]
    )


def _exchanged(finding: Finding) -> str:
    fits = (f"column {column} fits {leg}" for leg, column in finding.values["order"])
    return f"legs are exchanged: {' and '.join(fits)}"


def _scales(finding: Finding) -> str:
    sizes = {name: _times(factor) for name, factor, _ in finding.values["factors"]}
    if len(set(sizes.values())) == 1:
        return f"{_readings(finding)} are {next(iter(sizes.values()))}"
    parts = (f"{name} are {times}" for name, times in sizes.items())
    return f"the readings of {', those of '.join(parts)}"


def _times(factor: float) -> str:
    """Return how far a scale is off: ``10 times too large``."""
    large = factor > 1.0
    times = rounded(factor if large else 1.0 / factor, 3)
    return f"{times} times too {'large' if large else 'small'}"


def _angles(finding: Finding) -> str:
    order = finding.values["order"]
    if len(order) == 2:
        return f"{order[0][0]} and {order[1][0]} are exchanged"
    below = (f"{name} is below {column}" for name, column in order)
    return f"columns of the orientation are exchanged: {', '.join(below)}"


def _mirrored(finding: Finding) -> str:
    right = finding.values["orientations_right"]
    addition = " and the orientations are right" if right else ", as in a left-handed frame"
    return f"{_AXES[finding.values['axis']]}{addition}"


def _shifted(finding: Finding) -> str:
    rows = finding.values["shift"]
    return (
        f"the readings stand {counted(abs(rows), 'row')} {'below' if rows > 0 else 'above'} the "
        "poses they belong to"
    )


def _zeros(finding: Finding) -> str:
    parts = (
        f"{name} by about {offset:.2g} {unit}" for name, offset, unit in finding.values["offsets"]
    )
    return f"the zeros of readings are off: {', '.join(parts)}"


def _wording(title: str, says: Words, means: str, remedy: str, **values: str) -> Wording:
    return Wording(title, {**values, **_COMMON}, says, means, remedy, "error")


HYPOTHESES: dict[str, Wording] = {
    "sign-of-readings": _wording(
        "Sign of the readings",
        lambda f: f"{_readings(f)} have the other sign",
        "Sensors count the other way than mechanism.yaml says.",
        _SIGN.format("their sign"),
    ),
    "sign-of-column": _wording(
        "Sign of one reading",
        "{column} has the other sign",
        "One sensor of a leg with several counts the other way.",
        _SIGN.format("its sign"),
        column="name of the reading",
    ),
    "columns-exchanged": _wording(
        "Exchanged columns of a leg",
        lambda f: f"{' and '.join(f.values['columns'])} are exchanged",
        "Two readings of a leg stand below each other's names.",
        _ORDER,
        columns="names of both",
    ),
    "legs-exchanged": _wording(
        "Exchanged legs",
        _exchanged,
        "Readings stand below the names of other legs.",
        _ORDER,
        order="legs and the columns that fit them",
    ),
    "unit": _wording(
        "Wrong unit",
        _units,
        "Numbers are in another unit than their header says.",
        "Correct the units in the headers",
        units='of each kind: "positions", "orientations" or "readings", SI unit, unit as written',
    ),
    "left-handed-frame": _wording(
        "Left-handed frame",
        _mirrored,
        "An axis of the poses points the other way, or two are exchanged.",
        "Give the poses in the right-handed frame of the base",
        axis='"x", "y" or "z" with the other sign, or "xy", "xz", "yz" exchanged',
        orientations_right="whether the orientations are right",
    ),
    "sign-of-angle": _wording(
        "Sign of an angle of the platform",
        "{column} has the other sign",
        "An angle of the platform's orientation turns the other way.",
        "Change the sign of that angle",
        column="name of the angle",
    ),
    "angles-exchanged": _wording(
        "Exchanged columns of the orientation",
        _angles,
        "Numbers of the platform's orientation stand below each other's names.",
        _ORDER,
        order="columns of the orientation, each with that in which its numbers are",
    ),
    "orientation-inverted": _wording(
        "Inverted orientation",
        "the orientations turn the other way (that of the base seen from the platform)",
        "The base's orientation in the platform's frame was given.",
        "Give the orientation of the platform in the base frame",
    ),
    "pose-inverted": _wording(
        "Inverted pose",
        "the poses are those of the base in the platform's frame",
        "The base's pose in the platform's frame was given.",
        "Give the poses of the platform in the base frame",
    ),
    "rows-shifted": _wording(
        "Logs out of step",
        _shifted,
        "Readings and poses of one row were not measured together.",
        "Bring the logs of poses and readings into step",
        shift="by how many rows readings stand below",
    ),
    "reading-offset": _wording(
        "Zero of a sensor",
        _zeros,
        "A sensor's zero is farther off than machines differ from their drawings.",
        "Set the sensor's zero, or correct its nominal offset",
        offsets="name, offset [unit] and unit of each reading",
    ),
    "scale-of-readings": _wording(
        "Scale of the readings",
        _scales,
        "Readings are in other units than said: counts of another scale, a gear that is left out.",
        "Correct the scale of the readings (--counts, or counts_per_unit or gain of the sensor in "
        "mechanism.yaml)",
        factors="name, how many times too large, and unit of each reading",
    ),
    "unknown-frame": _wording(
        "Frame of the measurements",
        "the poses are those in another frame than the base's",
        "The tracker's frame is not the base's.",
        "Say that the base is elsewhere in that frame (--unknown-frame; in Python "
        "Setup(unknown_frame=True))",
    ),
}


def explanation(findings: Sequence[Finding]) -> str:
    """Return one sentence for hypotheses that explain measurements alike, and their remedies."""
    first = findings[0].values
    causes = [f"by {percent(finding.values['left'])} if {cause(finding)}" for finding in findings]
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
            f"nominal one by {percent(first['given'])} of a leg's length (median), but only "
        )
    codes = [finding.code for finding in findings]
    codes += ["unknown-frame" for finding in findings if finding.values["unknown_frame"]]
    remedies = [str(HYPOTHESES[code].remedy) for code in dict.fromkeys(codes)]
    return f"{start}{', or '.join(causes)}. {'; or: '.join(dict.fromkeys(remedies))}"


def cause(finding: Finding) -> str:
    """Return what a hypothesis says, as what follows 'if'."""
    words = HYPOTHESES[finding.code].said(finding)
    if finding.values["unknown_frame"] and finding.code != "unknown-frame":
        words += " and the base is elsewhere in their frame"
    return words
