"""Messages on terms of joints: where they turn back, and how files without them make up for them.

Templates for ``str.format``.
"""

from __future__ import annotations

TURNS_BACK = (
    "{reading}: with its terms the joint turns back at a reading of {where:.4g} {unit}, so that "
    "readings mean two positions; give smaller amplitudes, or a narrower range of the joint"
)
#: How to make up for what an exported file has no place for.
OFFERS = {
    "table": (
        "to correct for terms pose by pose (what to add to readings, or which pose to command "
        "instead): pincal export {mech} -o corrections.csv{more}{columns}"
    ),
    "code": (
        "to turn joint positions into readings and back, as code: pincal export {mech} -o "
        "corrections.py{more} (or .h, for C)"
    ),
}
WITH_COLUMNS = " (with what terms follow: {columns})"
AT_REFERENCE = (
    "all terms of {name!r} follow {columns}: at their reference there is nothing to correct; give "
    "poses with these columns (--poses)"
)
NOT_IN_LAWS = (
    "terms of {parameters} are in no law of a joint; a table over poses (.csv) corrects for them"
)
NO_CORRECTION = (
    "{name!r} has no terms: a controller with its geometry, gains and offsets needs no correction"
)
