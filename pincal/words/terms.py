"""What is said of terms: what residuals follow, and what pays."""

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
ALL_LENGTHS = "all lengths"
NOTHING = (
    "nothing that was tried is seen in the residuals: the least probable of {count} has a chance "
    "of {least}, their number taken in"
)
SEEN = "{reading} follows {kind}: {cause}; {share:.0%} of χ² ({chance})"
VERDICTS = {
    "as drawn": (
        "keep the machine as drawn: identified parameters predict rows that were held out no "
        "better; measure more poses, or better"
    ),
    "geometry": "geometry is enough: no term predicts rows that were held out better",
    "terms": (
        "these terms pay: held-out rows miss by {held_out} instead of {before} by geometry alone"
    ),
}
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
