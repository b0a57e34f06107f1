"""What is said of terms of joints: what residuals follow, which terms pay, what files lack.

Templates for ``str.format``.
"""

from __future__ import annotations

#: What a mechanic looks at, by kind of term; other kinds are columns.
CAUSES = {
    "harmonics": "an eccentric gear, encoder or screw",
    "polynomial": "the pitch of a screw or belt, a table of the drive that is off",
    "backlash": "play, or friction that winds the drive up: it follows the side of approach",
    "gravity": "something gives way under weight: a gear, a bearing, a link",
    "order": "a drift in the order of rows: warming, or a frame or reflector that moves",
}
COLUMN = "warming, a load or a setting that is in this column"
GROWN = "lengths that grow with this column"
PLACES = {"growth": "every length", "readings": "each reading"}
OF_LEGS = "{name} of each leg"
NOTHING = (
    "nothing that was tried is seen in the residuals: the least probable of {count} has a chance "
    "of {least}, their number taken in"
)
SEEN = "{reading} follows {kind}: {cause}; {share:.0%} of χ²{or_else} ({chance})"
UNPROMISED = (
    "but no limit is promised while residuals follow something: with --terms {terms} it is modelled"
)
VERDICTS = {
    "as drawn": (
        "keep the nominal machine: identified parameters predict rows that were held out no "
        "better; measure more poses, or better"
    ),
    "rigid alignment": (
        "rigid alignment only: keep the nominal machine, and find where it stands; identified "
        "parameters predict rows that were held out no better; measure more poses, or better"
    ),
    "not compared": (
        "models cannot be compared: the rows without any fold do not determine the geometry; "
        "measure more poses"
    ),
    "geometry": "geometry is enough: no term predicts rows that were held out better",
    "terms": (
        "these terms pay: held-out rows miss by {held_out} instead of {before} by geometry alone"
    ),
}
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
#: What slipped, and what to do about it.
SLIPPED = {
    "frame": (
        "the frame of the measurements, or the robot's base,",
        "look for a tracker, a tripod or a base that was moved",
    ),
    "target": ("the target {name!r} on the platform", "look for a target or tool that was hit"),
    "orientation": (
        "the orientation measured on the platform",
        "look for a target or tool that was turned",
    ),
    "reading": (
        "the reading of {name}",
        "look for an encoder that slipped, or a belt that jumped a tooth",
    ),
}
SLIP = "from data row {row} on {what} is off by {size}: {look}{or_else} ({chance})"
DRIFT = "{what} drifts, by {size} from the first row to the last: {look}{or_else} ({chance})"
OR_ELSE = "; or it is {what}, which these rows cannot separate"
OTHER_KIND = "{} of the same reading"
MEND = (
    "mend that first: measure what came after a slip again, or name the parts in a column run; "
    "while it is there other terms may only follow it"
)
LOST = "fold {fold} is left out of the comparison, the other rows do not determine it: {why}"
NO_TERM = (
    "a drift in the order of rows is no term that can be commanded: find what moves, measure "
    "reference poses (pincal select --reference), or give what drifts as a column"
)
NO_LOAD = (
    "gravity was not tried: mechanism.yaml does not say what weighs on the mechanism "
    "(load: {mass: …, centre: […]})"
)
AMPLITUDES = (
    "amplitude: as one step of the fit would find it, at the scale in which the term is added"
)
HELD_OUT = (
    "chance: when the term was added; free: parameters; held out: white residuals of rows that the "
    "fit has not seen; ±: against the best"
)
