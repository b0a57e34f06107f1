"""What is said of gauge freedoms: what no measurement of a kind determines, fixed by a choice."""

from __future__ import annotations

from pincal.finding import Finding
from pincal.words.numbers import counted
from pincal.words.wording import Wording, groups_in_words


def _base(found: Finding) -> str:
    why = (
        "the frame of the measurements is unknown"
        if found.values["unknown_frame"]
        else "what was measured does not fix it"
    )
    return f"the base frame: {_freedoms(found)}, since {why}"


def _freedoms(found: Finding) -> str:
    return counted(int(found.values["freedoms"]), "freedom")


def _redundant(found: Finding) -> str:
    v = found.values
    are = "parameter is" if v["count"] == 1 else "parameters are"
    return f"{v['count']} {are} redundant, whatever is measured: {groups_in_words(v['groups'])}"


_CHOICE = "Of equal parameters, those nearest to nominal were taken."
FREEDOMS: dict[str, Wording] = {
    "gauge-base-frame": Wording(
        "Gauge freedom of the base frame",
        {
            "freedoms": "how many",
            "unknown_frame": "whether the frame of the measurements is unknown",
        },
        _base,
        f"Moving the base frame with all base points changes nothing that is measured. {_CHOICE}",
        "",
        "info",
    ),
    "gauge-platform-frame": Wording(
        "Gauge freedom of the platform's frame",
        {"freedoms": "how many"},
        lambda f: (
            f"the platform's frame: {_freedoms(f)}, since what was measured does not say how the "
            "platform's points lie in it"
        ),
        f"Moving the platform's frame in the platform changes nothing that is measured. {_CHOICE}",
        "",
        "info",
    ),
    "redundant-parameters": Wording(
        "Redundant parameters",
        {"count": "how many are not needed", "groups": "ids of parameters that move together"},
        _redundant,
        f"Some parameters do the same to the platform as others. {_CHOICE}",
        "",
        "info",
    ),
}
