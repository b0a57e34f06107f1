"""What is said of measurements that are not such as the mechanism makes: hypotheses why.

``wrong-measurements`` holds the hypotheses that explain as much as the best one. A hypothesis is a
code of ``HYPOTHESES`` with its values; each has a clause that follows 'if', and a remedy.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from pincal.model.finding import Finding
from pincal.words.numbers import counted, listed, percent
from pincal.words.wording import Wording

Values = Mapping[str, Any]


@dataclass(frozen=True)
class Hypothesis:
    """What is said of one way in which measurements go wrong."""

    values: Mapping[str, str]
    """What each value is."""
    clause: Callable[[Values], str]
    """Follows 'if'."""
    remedy: str
    """A sentence without full stop."""


def readings(names: tuple[str, ...]) -> str:
    """Return which readings, all if none are named."""
    return f"the readings of {', '.join(names)}" if names else "the readings"


def _units(values: Values) -> str:
    return listed(
        f"{readings(values['names']) if what == 'readings' else 'the ' + what} are in {unit} under "
        f"a {header} header"
        for what, unit, header in values["wrong"]
    )


def _mirror(values: Values) -> str:
    axes = values["axes"]
    what = "x and y are exchanged" if axes == "xy" else f"{axes} has the other sign"
    right = " and the orientations are right"
    return f"{what}{right if values['orientations_right'] else ', as in a left-handed frame'}"


_NAMES = "names of the legs or sensors concerned; empty if all are"
_SIGN = "Change their sign, or the sensor's 'direction' in mechanism.yaml"
_FRAME = "Give the poses in the right-handed frame of the base"
HYPOTHESES: dict[str, Hypothesis] = {
    "reading-sign": Hypothesis(
        {"names": _NAMES}, lambda v: f"{readings(v['names'])} have the other sign", _SIGN
    ),
    "columns-exchanged": Hypothesis(
        {"columns": "names of two readings"},
        lambda v: f"{listed(v['columns'])} are exchanged",
        "Correct the order of columns",
    ),
    "legs-exchanged": Hypothesis(
        {"fits": "pairs of names: whose column, and the leg that it fits"},
        lambda v: (
            "legs are exchanged: "
            + " and ".join(f"column {column} fits {leg}" for column, leg in v["fits"])
        ),
        "Correct the order of columns",
    ),
    "unit": Hypothesis(
        {
            "wrong": 'triples: "positions", "orientations" or "readings"; the unit that numbers '
            'are in, such as "mm" or "degrees"; the unit of their header, such as "metre"',
            "names": _NAMES,
        },
        _units,
        "Correct the units in the headers",
    ),
    "mirrored-frame": Hypothesis(
        {
            "axes": '"x", "y" or "z" of the other sign, "xy" for two exchanged',
            "orientations_right": "whether only positions are mirrored",
        },
        _mirror,
        _FRAME,
    ),
    "angle-sign": Hypothesis(
        {"name": "name of the column"},
        lambda v: f"{v['name']} has the other sign",
        "Change the sign of that angle",
    ),
    "orientation-inverse": Hypothesis(
        {},
        lambda _: "the orientations turn the other way (that of the base seen from the platform)",
        "Give the orientation of the platform in the base frame",
    ),
    "pose-inverse": Hypothesis(
        {},
        lambda _: "the poses are those of the base in the platform's frame",
        "Give the poses of the platform in the base frame",
    ),
    "rows-shifted": Hypothesis(
        {"rows": "by how many rows the readings are below their poses; negative: above"},
        lambda v: (
            f"the readings stand {counted(abs(v['rows']), 'row')} "
            f"{'below' if v['rows'] > 0 else 'above'} the poses they belong to"
        ),
        "Bring the logs of poses and readings into step",
    ),
}


def _wrong(found: Finding) -> str:
    v = found.values
    ifs = (
        f"by {percent(one['left'])} if {HYPOTHESES[one['code']].clause(one['values'])}"
        for one in v["hypotheses"]
    )
    return (
        f"{', '.join(v['legs'])}: the measurements miss every mechanism near the nominal one by "
        f"{percent(v['left'])} of a leg's length (median), but only {', or '.join(ifs)}"
    )


def _wrong_remedy(found: Finding) -> str:
    return "; or: ".join(
        dict.fromkeys(HYPOTHESES[one["code"]].remedy for one in found.values["hypotheses"])
    )


def _still(found: Finding) -> str:
    sensors = found.values["sensors"]
    same = ", ".join(
        f"{s['name']} reads the same in all rows ({s['value']:.6g} {s['unit']})" for s in sensors
    )
    moves = ", ".join(f"{s['moves']:.2g} {s['unit']}" for s in sensors)
    return f"{same}, where readings of the nominal mechanism differ by {moves} over these poses"


FAULTS: dict[str, Wording] = {
    "sensor-still": Wording(
        "A reading does not move",
        {"sensors": "mappings with name, value and moves (of the nominal mechanism) [unit], unit"},
        _still,
        "A sensor reads the same in all rows though the poses move it.",
        "Check the sensor, its cable and the log",
        "error",
    ),
    "wrong-measurements": Wording(
        "Measurements that one fault explains",
        {
            "legs": "names of the legs that do not fit",
            "left": "what machines near the nominal one leave of the gaps, over a leg's length",
            "hypotheses": "mappings, the best first, with code and values (see HYPOTHESES), and "
            "left: what they leave of the gaps",
        },
        _wrong,
        "The measurements do not fit the nominal mechanism, but would if what is named were put "
        "right: a sign, a unit, exchanged legs, a frame.",
        _wrong_remedy,
        "error",
    ),
}
