"""What a view says of what it shows, and of what it cannot draw."""

from __future__ import annotations

from collections.abc import Sequence

MECHANISM = "mechanism"
SETS, GHOSTS = "poses, as dots", "poses, as ghosts"
BASE, GRID = "base frame", "grid"
MEASURED, OUTLIERS = "measured → predicted", "outliers"
FRAME = "frame of the measurements"
TRACKER = "tracker"
POSE, READ = "pose", "readings, as measured"
GIVEN, NOMINAL = "readings, as given", "readings of the nominal model"
ERROR = "identified goes off by"
#: The workspace in colours of errors.
BY_ERROR = {
    "before": "workspace by error, nominal (before)",
    "after": "workspace by error, identified, as expected",
}


def identified(magnify: float) -> str:
    """Return what the identified machine is, its errors magnified by a factor."""
    return f"identified, errors × {magnify:g}"


def cloud(drawn: int, given: int, group: str) -> str:
    """Return what a cloud of positions is.

    Args:
        drawn: How many positions are drawn.
        given: Of how many.
        group: Whose fundamental domain has the stronger colour; empty where there is none.
    """
    count = f"{drawn:,}" + (f" of {given:,}" if given > drawn else "")
    share = f"; strong colour: fundamental domain of {group}" if group else ""
    return f"workspace, {count} positions{share}"


def misses(who: str, magnify: float, cut: int) -> str:
    """Return what arrows are, magnified by a factor, of which some are cut."""
    more = f", {cut} longer than drawn" if cut else ""
    return f"{who}, errors × {magnify:,.12g}{more}"


def weakest(magnify: float, named: str) -> str:
    """Return how far the machine moves along its weakest direction, and what moves most."""
    return f"weakest direction, ±{magnify:.3g} of its standard errors: {named}"


def stands(what: str, far: float) -> str:
    """Return where an instrument or frame stands, its distance in [m]."""
    return f"{what}, {far:.3g} m from the base frame"


def unreached(magnify: float | None, problems: Sequence[str]) -> str:
    """Return at how many poses a machine is not drawn in full; empty where it is everywhere.

    Args:
        magnify: Factor on the identified machine's errors; None of the mechanism itself.
        problems: Of each pose; empty strings where there is none.
    """
    some = [text for text in problems if text]
    if not some:
        return ""
    name = "the mechanism"
    if magnify is not None:
        name = f"the identified machine (errors × {magnify:g})"
    return (
        f"{name} is not drawn in full at {len(some)} of {len(problems)} poses; the first: {some[0]}"
    )
