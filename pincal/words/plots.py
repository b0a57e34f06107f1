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
    return "" if value is None else f"z = {amount(value, 'm', 3, STORED)}"


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


def foot(noise: str, date: str) -> str:
    """Return what values of a drawing are worth, and when it was made if that is said."""
    made = f" Drawn {date}." if date else ""
    return f"±: half of the 95 % interval. Noise: {noise}. ◆ zero on the drawing.{made}"
