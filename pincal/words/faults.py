"""What is said of measurements that cannot be right though no hypothesis explains them."""

from __future__ import annotations

from pincal.finding import Finding
from pincal.words.numbers import chance, counted, size
from pincal.words.wording import Wording


def _still(found: Finding) -> str:
    each = (
        f"{name} reads the same in all rows ({value:.6g} {unit})"
        for name, value, unit, _ in found.values["readings"]
    )
    moves = (f"{moved:.2g} {unit}" for _, _, unit, moved in found.values["readings"])
    return (
        f"{', '.join(each)}, where readings of the nominal mechanism differ by "
        f"{', '.join(moves)} over these poses"
    )


def _turns(found: Finding) -> str:
    v, count = found.values, len(found.rows)
    return (
        f"{v['leg']}: {counted(count, 'reading is', 'readings are')} off by whole turns, the first "
        f"in data row {found.rows[0] + 1}: {v['reading']:.6g} rad, where the nominal mechanism "
        f"reads {v['nominal']:.6g} rad"
    )


def _bent(found: Finding) -> str:
    each = (
        f"{leg} ({' and '.join(passive)}, in {bent} of {rows} rows)"
        for leg, passive, bent, rows in found.values["legs"]
    )
    return (
        "readings and poses close the legs, but these bend the other way than in mechanism.yaml's "
        f"home: {', '.join(each)}"
    )


def _other_mechanism(found: Finding) -> str:
    return (
        f"{found.values['leg']}: the measurements miss the nominal mechanism by "
        f"{100 * found.values['gap']:.1f} % of a leg's length (median), and no single fault in "
        "units, signs, order, zeros or frame explains it"
    )


def _apart(found: Finding) -> str:
    v = found.values
    return (
        f"{v['leg']}: the readings do not follow those of the nominal mechanism (machines near it "
        f"leave {100 * v['left']:.2g} % of the leg's length where readings move it by "
        f"{100 * v['stroke']:.2g} %)"
    )


def _copies(found: Finding) -> str:
    (one, other), pairs = found.values["first"], found.values["pairs"]
    more = f" (and {pairs - 1} more such pairs)" if pairs > 1 else ""
    return (
        f"data rows {one + 1} and {other + 1} are identical in all that was measured{more}; "
        "measured twice, they would differ by noise"
    )


def _large(found: Finding) -> str:
    v = found.values
    if v["what"] == "position":
        return (
            f"the noise of position is given as {v['given']:g} m, more than "
            f"{100 * v['most'] / v['size']:.0f} % of a leg's length ({v['size']:.3g} m)"
        )
    return f"the noise of orientation is given as {v['given']:g} rad; expected less than " + (
        f"{v['most']:g}"
    )


def _slips(found: Finding) -> str:
    v, others = found.values, len(found.rows) - 1
    more = f", and {counted(others, 'more row')} so" if others else ""
    return (
        f"data row {v['worst'] + 1} misses the nominal mechanism {v['times']:.3g} times as far as "
        f"rows usually do{more}"
    )


def _one_body(found: Finding) -> str:
    v = found.values
    return (
        f"{100 * v['share']:.0f} % of what the nominal model is off by (in squares) is one motion "
        f"of the {v['frame']}'s frame, by {size(v['shift'], v['turn'])}, and parameters that "
        f"differ each in its own way hardly move so ({chance(v['p_value'])})"
    )


def _one_body_remedy(found: Finding) -> str:
    how = {
        "base": "Is the tracker's frame the base's (--unknown-frame)?",
        "platform": "Is the target the platform's origin (--unknown-target)?",
    }[found.values["remedy"]]
    return f"{how} Else where the frame lies is taken for errors of the machine"


FAULTS: dict[str, Wording] = {
    "readings-still": Wording(
        "A sensor does not move",
        {"readings": "name, value, unit, and by how much the nominal one differs, of each"},
        _still,
        "A sensor gave one number while the poses moved it.",
        "Check the sensor, its cable and the log",
        "error",
    ),
    "whole-turns": Wording(
        "Readings off by whole turns",
        {"leg": "name", "reading": "the first such [rad]", "nominal": "what it should be [rad]"},
        _turns,
        "A counter lost a turn, or counts on where others begin again. The finding's rows are all "
        "of them.",
        "Count without the turns, or correct the nominal offset",
        "error",
    ),
    "other-working-mode": Wording(
        "Another working mode",
        {"legs": "name, passive joints, rows bent the other way, and rows, of each leg"},
        _bent,
        "Readings and poses have several solutions; the machine was measured in another one.",
        "Correct 'home' there, or measure in its working mode",
        "error",
    ),
    "not-this-mechanism": Wording(
        "Measurements of another mechanism",
        {"leg": "name of the worst", "gap": "median misfit, in lengths of the leg"},
        _other_mechanism,
        "Poses and readings are those of a machine unlike the nominal one.",
        "Check the units, the order and signs of the readings, the frame of the poses, and that "
        "this is the right mechanism. If it is known but roughly, say so (--rough)",
        "error",
    ),
    "readings-do-not-follow": Wording(
        "Readings do not follow the poses",
        {
            "leg": "name",
            "left": "misfit that machines near the nominal one leave, in lengths of the leg",
            "stroke": "by how much readings move the leg, in its lengths",
        },
        _apart,
        "The poses say nothing of what the readings say, in a workspace too small to see why.",
        "Check their order and signs, the signs and frame of the poses, and the mechanism",
        "error",
    ),
    "rows-copied": Wording(
        "Copied rows",
        {"first": "rows of the first pair, counted from 0", "pairs": "how many pairs"},
        _copies,
        "A copy counts as a measurement, and makes intervals too narrow.",
        "Remove the copies",
        "error",
    ),
    "noise-too-large": Wording(
        "Noise far too large",
        {
            "what": '"position" or "orientation"',
            "given": "standard deviation given [unit]",
            "unit": '"m" or "rad"',
            "most": "the largest that is taken [unit]",
            "size": "length of a leg [m]",
        },
        _large,
        "So large a noise is a slip in a unit.",
        lambda f: f"It is in {'metres' if f.values['unit'] == 'm' else 'radians'}",
        "error",
        general="Give it in metres and radians",
    ),
    "bad-rows": Wording(
        "Few rows far from the nominal mechanism",
        {"worst": "row, counted from 0", "times": "how many times as far as usual it misses"},
        _slips,
        "The fit failed, and few rows are far from where the others are. The finding's rows are "
        "those.",
        "Look for a slip there first, or leave such rows out (--robust reject)",
    ),
    "frame-misaligned": Wording(
        "Parameters moved as one body",
        {
            "frame": '"base" or "platform"',
            "remedy": 'whose place to leave open: "base" or "platform"',
            "share": "share of the squares of the nominal model's error",
            "shift": "translation of the frame [m]",
            "turn": "rotation of the frame [rad]; None for a platform that does not turn",
            "p_value": "probability of so much motion as one body by chance",
        },
        _one_body,
        "More likely the tracker, or the target, was not aligned, than that the machine is such.",
        _one_body_remedy,
        general="Leave that frame open (--unknown-frame, --unknown-target), or align and measure "
        "again",
    ),
}
