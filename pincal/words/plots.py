"""The words of plots and drawings: labels of axes, titles, legends, and why one is refused."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from pincal.words.numbers import SMALL, STORED, amount, minus

NORMAL = "95 of 100"
"""Between which levels, or below which, what is drawn lies if noise alone makes it."""
ROW, TIME = "data row", "time, in the unit of its column"
OUTLIER = "outlier"
MEAN = "mean residual / its standard error"
RUN = "run less mean / its standard error"
CHANGE = "change / half width of its 95 % interval"
CORRELATION = "correlation"
STEP, COST = "step of the search", "residuals, root mean square [σ]"
POSES, FIRST, BOUND = "poses n", "first n rows", "bound"
SINGULAR = "singular value (columns scaled)"
BED = f"z, true less commanded [{SMALL['m']}]"
EXPECTED = f"expected error of position [{SMALL['m']}]"
MOVED = f"moves the platform by [{SMALL['m']}]"
IMAGES = (
    "What cameras saw: arrows from each point as seen towards where it is predicted, magnified "
    "alike in all images. Where arrows of a region point one way, the lens is other than its model."
)
IDENTIFIED_LESS_NOMINAL = "identified − nominal, ± 95 %"
OBSERVABILITY = "|Rᵢᵢ|"
WHITE, DENSITY, NORMALLY = "residual [standard deviations]", "density", "normal distribution"
BEFORE_AFTER = "before", "after"
NOMINAL_IDENTIFIED = "nominal parameters (before)", "identified parameters (after)"
PLATFORM = "position", "orientation"
AFTER_EXPECTED = "after, expected"
CHANGES = (
    "Change of each parameter from nominal, with its 95 % interval. Where the interval holds "
    "zero, the measurements do not distinguish the nominal value from the identified one."
)
CLEAR, WITHIN = "changed by more than its ±", "by less"


def residual(*, standardised: bool) -> str:
    """Return what a residual is divided by: σ√(1−h) of its leverage h, or σ if that is unknown."""
    return "residual / (σ√(1−h))" if standardised else "residual / σ"


def largest(*, standardised: bool) -> str:
    """Return the same of the largest residual of a row."""
    return f"largest {residual(standardised=standardised)} of the row"


def of_point(*, standardised: bool) -> str:
    """Return the same of the larger residual of a point."""
    return f"larger {residual(standardised=standardised)} of the point"


def along(axis: str) -> str:
    """Return what names an axis of the base frame, with its unit."""
    return f"{axis} [{STORED['m']}]"


def height(value: float | None) -> str:
    """Return at which z something is drawn, [m]; nothing where there is no z."""
    return "" if value is None else minus(f"z = {amount(value, 'm', 3, STORED)}")


def rejected(rows: Iterable[int], most: int) -> str:
    """Return which rows have no residual to draw, counted from 0, so many at most."""
    every = sorted(set(rows))
    some = ", ".join(str(row + 1) for row in every[:most])
    return f"rejected, not drawn: rows {some}{' …' if len(every) > most else ''}"


def unchecked(count: int) -> str:
    """Return how many residuals nothing else checks; nothing if there are none."""
    return f"{count} not drawn: the fit follows them" if count else ""


def weakest(parts: Sequence[tuple[float, str]]) -> str:
    """Return the weakest direction, by shares of parameters."""
    return "weakest: " + " ".join(f"{minus(f'{share:+.2f}')}\u00a0{name}" for share, name in parts)


def directions(fixed: int) -> str:
    """Return what is counted along an axis of directions, of which some are fixed."""
    return "direction" + (f" ({fixed} more are fixed by choice)" if fixed else "")


def some_of(shown: int, count: int) -> str:
    """Return that only the largest of many are drawn."""
    return f"the {shown} largest of {count}"


def fit(number: int) -> str:
    """Return the name of a fit of several legs at once."""
    return f"fit {number}"


def unexplained(machine: str, excess: float) -> str:
    """Return why no accuracy is drawn while residuals contradict the noise."""
    return (
        f"{machine}: residuals are {excess:.3g} times as large as the noise given makes them, so "
        "no accuracy can be promised and none is drawn"
    )


def no_map(machine: str, *, by_readings: bool) -> str:
    """Return why there is no map of errors."""
    if by_readings:
        return f"{machine}: its poses follow from readings: errors over x and y are not drawn"
    return f"{machine}: no workspace was found to draw errors over x and y"


def no_steps(machine: str) -> str:
    """Return why an old result has no convergence."""
    return f"{machine}: this result does not hold the steps of its search; calibrate again"


def not_rows_alone(machine: str) -> str:
    """Return why accuracy by the number of poses is refused."""
    return (
        f"{machine}: more than the rows and their noise made this result (priors, legs alone, a "
        "loss), so what fewer rows would give is not drawn"
    )


def uneven_noise(machine: str) -> str:
    """Return why accuracy by the number of poses needs one noise."""
    return f"{machine}: noise differs between rows; expected one noise for all of them"


def no_runs(machine: str) -> str:
    """Return why no runs are drawn."""
    return (
        f"{machine}: no runs were compared; measurements need several runs, and result.compared() "
        "compares them"
    )


def no_bed(machine: str, why: str) -> str:
    """Return why there is no bed: ``axes``, ``readings`` or ``height``."""
    said = {
        "axes": "a bed needs a platform that moves in x, y and z",
        "readings": "its poses follow from readings, so no bed is drawn",
        "height": "no workspace at the height of home",
    }
    return f"{machine}: {said[why]}"


def no_images(machine: str) -> str:
    """Return why there are no images."""
    return (
        f"{machine}: no camera measured it: no instrument of the setup has an image; expected one "
        "with a pincal.Image as its 'image'"
    )


def key(pixels: float) -> str:
    """Return what the length of a line beside images means."""
    return f"{pixels:g} px of residual, predicted less seen"


def points(count: int, rms: float) -> str:
    """Return how many points an image holds, and how far these are off."""
    return f"{count} points, {rms:.2g} px"


SHEET = {
    "parameter": "parameter",
    "nominal": "nominal",
    "beneath": "beneath",
    "fixed": "held fixed",
    "several": "one of these legs; values of all below",
    "alone": "values below",
}
"""Words of a drawing's table."""
CHANGED = ("changed by less than its ±", "by 1 to 5 times its ±", "by more than 5 times its ±")


def was(value: str) -> str:
    """Return a nominal value beneath an identified one."""
    return f"nominal {value}"


def foot(noise: str, date: str, excess: float | None = None) -> str:
    """Return what values of a drawing are worth, and when it was made if that is said.

    Args:
        noise: Standard deviations of what was measured.
        date: When it was drawn; empty if that is not said.
        excess: How many times as large as the noise residuals are, if that says that no ± holds.
    """
    made = f" Drawn {date}." if date else ""
    doubt = f" Residuals are {excess:.3g} times as large: no ± can be relied on." if excess else ""
    return f"±: half of the 95 % interval. Noise: {noise}.{doubt} ◆ zero on the drawing.{made}"


def poses(count: int, *, plane: bool, turns: bool) -> str:
    """Return what a report shows of measured poses, in a plane or from three sides."""
    what = "seen from above, from the front and from the side; grey: the mechanism at home"
    if plane:
        what = "over its workspace (grey), and the mechanism at home"
        what += "; strokes show the orientation" if turns else ""
    return f"The {count} measured poses of the platform, {what}."


def dimensions(leg: str, *, several: bool) -> str:
    """Return what a report's drawing of a leg shows, of several alike or of one."""
    alike = ", those of the others alike" if several else ""
    return (
        f"Where the parameters of {leg} are{alike}: lines in the colours of their changes. Values "
        "stand in the table above; diamonds are parameters that are zero."
    )


def errors(where: str, whose: str) -> str:
    """Return what bars of errors show: the platform's ``where``, if any is promised, and whose."""
    platform = f"the platform's {where} (after: as expected), and " if where else ""
    return f"Root mean square errors before and after: {platform}the residuals of each {whose}."


def observability(*, by_readings: bool) -> str:
    """Return what the observability of each parameter is."""
    what = "the leg's end" if by_readings else "the readings"
    return (
        f"Observability of each parameter at the poses used: what it moves {what} by, all poses "
        "together, less what the parameters to its left can explain. Compare legs with it; "
        "parameters differ in their units."
    )


def residuals(whose: str) -> str:
    """Return what residuals of legs or coordinates are drawn with."""
    return (
        f"Residuals of each {whose} against the row of the measurements, before and after; the "
        "scales differ. Grey bars: where 95 of 100 are expected, the noise less what the fit "
        "takes up of it, ±1.96 σ√(1−h). Rings: rows that do not fit the others; crosses at the "
        "upper edge: rows that were rejected."
    )


def counted(count: int) -> str:
    """Return how many residuals a distribution holds."""
    return f"{count} residuals"


def distribution(percent: float) -> str:
    """Return what a distribution of residuals shows, and how many are larger than 5 % should be."""
    return (
        "Distribution of the residuals after the calibration, each over its own standard "
        "deviation: the noise, less what the fit takes up of it. "
        f"{percent:.0f} % are larger than 1.96; expected are 5 %."
    )


def maps(*, turns: bool) -> str:
    """Return what maps of errors show, of a platform that turns or not."""
    where = "the workspace at home orientation" if turns else "the workspace"
    return (
        f"Error of the platform over {where}: how far the nominal model is off, and what is to be "
        "expected of the calibrated one (standard error). One scale of decades for both; white: "
        "not in the workspace."
    )
