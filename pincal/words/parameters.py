"""What is said of a calibration's parameters: poses that are too few, values that moved far, ties.

Each code's ``values`` say what a finding of it holds, in SI; ids are those of parameters
(``leg_1.l``). Parameters concerned are the finding's own ``parameters``.
"""

from __future__ import annotations

from math import isfinite

from pincal.finding import Finding
from pincal.words.numbers import amount, listed
from pincal.words.wording import P_VALUE, Wording, groups_in_words

#: How each option is named that lets a calibration look for what its data leave open.
_OPTIONS = {
    "unknown-frame": "the base may be elsewhere in the frame of the measurements (--unknown-frame)",
    "unknown-target": "what was measured may not be the platform's origin (--unknown-target or "
    "--setup)",
}


def _weak(finding: Finding) -> str:
    v, count = finding.values, len(finding.parameters)
    subject = f"{v['parameter']} is" if count == 1 else f"{count} parameters are"
    worst = "known" if count == 1 else f"{v['parameter']}"
    return (
        f"{subject} weakly determined, {worst} to ± {v['half']:.2g} {_si(v['unit'])} only".replace(
            "  ", " "
        )
    )


def _weak_remedy(finding: Finding) -> str:
    hold = "" if finding.values["held"] else ", hold it at nominal (--hold-undetermined)"
    return f"Measure poses that determine more{hold}, or say how well nominal values are known " + (
        "(--priors)"
    )


def _si(unit: str) -> str:
    return "" if unit == "1" else unit


def _far(finding: Finding) -> str:
    v = finding.values
    size = f"{v['change']:+.3g} {_si(v['unit'])}".strip()
    return f"{v['parameter']} moved by {size}, farther than a machine differs from its drawing"


def _far_remedy(finding: Finding) -> str:
    return (
        "Check units, the order of the readings, and the frame of the measurements"
        f"{options(finding.values['options'])}"
    )


def options(codes: tuple[str, ...]) -> str:
    """Return options that were not used and may help, in brackets; empty if there are none."""
    return f" ({'; '.join(_OPTIONS[code] for code in codes)})" if codes else ""


def _few_poses(finding: Finding) -> str:
    v = finding.values
    return f"{', '.join(v['legs'])}: {v['poses']} poses for {v['unknowns']} parameters"


def _zeros(finding: Finding) -> str:
    zeros = [
        f"{id_} by {change:.3g} {_si(unit)}" for id_, change, unit in finding.values["changes"]
    ]
    return f"zeros of readings are far from the drawing's: {listed(zeros)}"


def _signs(finding: Finding) -> str:
    parts = [f"{id_} from {a:.4g} to {b:.4g} m" for id_, a, b in finding.values["lengths"]]
    return f"lengths changed their sign: {listed(parts)}"


def _held(finding: Finding) -> str:
    v = finding.values
    parts = [groups_in_words(v["groups"])] if v["groups"] else []
    parts += [f"{listed(v['weak'])} are weakly determined"] if v["weak"] else []
    return f"these measurements do not determine everything: {'; '.join(parts)}"


def _tolerance(finding: Finding) -> str:
    v = finding.values
    quantities = {"m": "lengths", "rad": "angles", "1": "gains"}[v["unit"]]
    if not isfinite(v["size"]):
        return f"how far {quantities} are from the drawing is not said by {v['count']} of them"
    low, high = (amount(v[end], v["unit"]) if isfinite(v[end]) else "" for end in ("low", "high"))
    ends = f"{low} to {high}" if high else f"{low} or more"
    return (
        f"{quantities} differ from the drawing by {amount(v['size'], v['unit'])}, standard "
        f"deviation of {v['count']} (95 %: {ends})"
    )


def _tolerance_remedy(finding: Finding) -> str:
    if not isfinite(finding.values["size"]):
        return "They are free; give their tolerance (--tolerance, --priors), if it is known"
    return "" if finding.values["low"] else "Measurements do not separate them from the drawing"


PARAMETERS: dict[str, Wording] = {
    "tolerance-found": Wording(
        "Tolerances found with the parameters",
        {
            "unit": "of the parameters",
            "size": "standard deviation of their differences from the drawing [unit]; infinite "
            "where the measurements do not say it",
            "low": "lower end of its 95 % interval; 0 where the drawing may be exact",
            "high": "upper end; infinite where there is none",
            "count": "number of parameters",
        },
        _tolerance,
        "--tolerance auto: one variance component for each unit, found by restricted maximum "
        "likelihood, is the prior of the parameters of that unit.",
        _tolerance_remedy,
        "info",
        "Where measurements do not say it, give the tolerance (--tolerance 0.5mm,5mrad)",
    ),
    "few-poses": Wording(
        "Few poses",
        {
            "legs": "names of the legs",
            "poses": "number of poses of each",
            "unknowns": "number of parameters of each",
        },
        _few_poses,
        "So few equations that residuals are small whatever the machine is.",
        "Measure more: two or three times as many poses as parameters are advised",
    ),
    "unused-poses": Wording(
        "Poses that serve one leg only",
        {"unused": "number of poses that do not serve every leg", "total": "number of poses"},
        "{unused} of {total} measured poses serve other legs only",
        "Each leg was identified by the poses of its set only.",
        "Leave out --method per-leg, or add --poses all: then every leg uses every pose",
        "info",
    ),
    "weakly-determined": Wording(
        "Weakly determined parameters",
        {
            "parameter": "id of the worst",
            "half": "half width of its 95 % interval [unit]",
            "unit": "its unit",
            "held": "whether undetermined directions were held already",
        },
        _weak,
        "A standard error is larger than machines differ from their drawings: the number is noise. "
        "The finding's parameters are all of them.",
        _weak_remedy,
        general="Measure poses that determine more (pincal select), hold what is undetermined "
        "(--hold-undetermined, --fixed), or say how well nominal values are known (--priors)",
    ),
    "undetermined-held": Wording(
        "Undetermined parameters were held",
        {
            "groups": "ids of parameters that move together, a tuple for each lost direction",
            "weak": "ids of parameters that are weakly determined and were held too",
        },
        _held,
        "What is named was held as near to nominal as can be: the machine is calibrated where it "
        "was measured; elsewhere it may be off.",
        "Held as near to nominal as can be, so that the machine is calibrated where it was "
        "measured only",
    ),
    "far-from-nominal": Wording(
        "A parameter moved far",
        {
            "parameter": "id",
            "change": "identified less nominal [unit]",
            "unit": "its unit",
            "options": 'options that were not used: of "unknown-frame", "unknown-target"',
        },
        _far,
        "A parameter moved by more than 5 % of the mechanism's size, or 0.05 rad or 1. If the "
        "drawing is known roughly only, say so (--rough).",
        _far_remedy,
        general="Check units, the order of the readings, and the frame and target of the "
        "measurements (--unknown-frame, --unknown-target)",
    ),
    "zeros-found": Wording(
        "Zeros of motors are far off",
        {"changes": "parameter's id, identified less nominal, and unit, of each zero"},
        _zeros,
        "Nothing but other zeros explains the measurements, and full poses give these in closed "
        "form: the search started there. The other parameters stay near the drawing.",
        "Nothing to do if the motors were zeroed anew; else look at the columns of these readings",
    ),
    "sign-changed": Wording(
        "A length changed its sign",
        {"lengths": "parameter's id, nominal and identified value [m], of each"},
        _signs,
        "The mirror image of a leg fits, or the search went astray: a length of the drawing cannot "
        "be negative.",
        "Correct the nominal values (zeros of motors first), or fix these lengths (--fixed)",
    ),
    "tie-contradicted": Wording(
        "A tie does not hold",
        {"name": "name of the tied parameters, or several with commas", "p_value": P_VALUE},
        "{name} is tied over the legs, and the measurements contradict that ({chance})",
        "The legs differ in this parameter by more than their standard errors explain (1 %).",
        "Leave the tie out (--tied)",
    ),
}


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
BOUNDS = {
    "steps": (
        "{quantity} comes in steps of {size}: its noise is {least} at least, a step over √12"
    ),
    "play": ("{quantity}: with a play of {size} that no term models its noise is {least} at least"),
}
TOO_SMALL = "{bound}, and {reckoned} is reckoned with: give it as its noise, or model its cause"
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
