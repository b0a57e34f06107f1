"""What slipped during the run: a frame, a target on the platform, an encoder, from one row on.

A slip is a constant error of some measured quantities after a row: of all positions alike in the
axes of the measurements (the frame, or the robot's base), of one target's position in the axes of
the platform (the target, or the tool that carries it), of the measured orientation, of one reading.
Each is asked with all its directions at once, and against a steady drift of the same. The clearest
is taken up, and the rest is asked again.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pincal.estimation.fit import Fit
from pincal.estimation.residuals.courses import errors_of, of_frame, of_target
from pincal.estimation.residuals.losses import CLEAR, FALSE_ALARM
from pincal.estimation.residuals.score import Residuals
from pincal.model.measuring.setup import ORIGIN

Array = NDArray[np.float64]
What = Literal["frame", "target", "orientation", "reading"]
_MOST = 3


@dataclass(frozen=True)
class Slip:
    """What is off from one row on, or more and more."""

    what: What
    name: str
    """The target or reading; empty of the frame."""
    row: int
    """The first row after it, among those of the fit; 0 of a drift."""
    size: Array
    """How far it is off after that row, shape (f,): in the axes of the measurements, of a target
    in those of the platform; of a drift from the first row to the last. [m] or [rad]."""
    axes: tuple[str, ...]
    """What the components of the size are along, such as ``("x", "y", "z")``."""
    unit: str
    """``"m"`` or ``"rad"``."""
    steady: bool
    """Whether it is a drift over the whole run rather than a slip."""
    p_value: float
    """Of so clear a change anywhere, by chance, all that was tried taken in."""
    or_else: tuple[tuple[What, str], ...] = ()
    """What else may have slipped: these rows cannot separate it."""


@dataclass(frozen=True)
class _Trial:
    slip: Slip
    inside: float
    white: Array
    """Of the error with its course, shape (n_used, m, f)."""


def slips(one: Fit) -> list[Slip]:
    """Return what slipped or drifted, the clearest first; empty if nothing did."""
    if not one.problem.weighted or one.degrees_of_freedom < 2 or not one.chi2 > 0.0:
        return []
    left, found = Residuals.of(one), list[Slip]()
    candidates = list(_candidates(one, left.used))
    while len(found) < _MOST:
        tried = [trial for own in candidates for trial in _tried(left, *own)]
        tried = sorted(tried, key=lambda trial: (trial.slip.p_value, -trial.inside))
        if not tried or tried[0].slip.p_value * len(tried) >= FALSE_ALARM:
            break
        first = tried[0]
        free = max(left.degrees_of_freedom - len(first.slip.size), 1)
        clear = CLEAR**2 * (left.chi2 - first.inside) / free  # by what is left, as F tests have it
        alike = tuple(
            (other.slip.what, other.slip.name)
            for other in tried[1:]
            if other.slip.steady == first.slip.steady and first.inside - other.inside < clear
            if other.slip.unit == first.slip.unit and len(other.slip.size) == len(first.slip.size)
        )
        chance = first.slip.p_value * len(tried)
        found.append(replace(first.slip, p_value=chance, or_else=alike))
        left = left.without(first.white)
    return found


def _tried(left: Residuals, slip: Slip, W: Array) -> Iterator[_Trial]:
    """Yield a slip at its clearest row, and a steady drift of the same quantities."""
    change = left.change(W)
    course = (left.used >= change.row).astype(float)
    after = replace(slip, row=change.row, size=change.size, p_value=change.p_value)
    yield _Trial(after, change.inside, W * course[:, None, None])
    time = (left.used - left.used[0]) / max(float(np.ptp(left.used)), 1.0)
    drift = left.amplitudes(W * time[:, None, None])
    if drift.rank == W.shape[2]:
        steady = replace(slip, size=-drift.values, steady=True, p_value=drift.p_value)
        yield _Trial(steady, drift.inside, W * time[:, None, None])


def _slip(what: What, name: str, axes: tuple[str, ...], unit: str) -> Slip:
    return Slip(what, name, 0, np.zeros(len(axes)), axes, unit, steady=False, p_value=1.0)


def _candidates(one: Fit, used: NDArray[np.intp]) -> Iterator[tuple[Slip, Array]]:
    """Yield what may slip, and the white rows of its unit errors, shape (n_used, m, f)."""
    problem, platform = one.problem, one.problem.platform
    errors = dict(errors_of(one, used))
    names = [name for leg in problem.legs for name in leg.reading_names]
    units = [unit for leg in problem.legs for unit in leg.reading_units]
    for name, unit, w in zip(names, units, errors.values(), strict=False):
        yield _slip("reading", name, ("",), unit), w[:, :, None]
    if not problem.latent:
        return
    seen, state, axes = problem.observation, one.last.state, "xyz"[: platform.space]
    turns = (state.external.frame[:3, :3] @ state.matrices[used, :3, :3])[:, :, : len(axes)]
    for target in seen.setup.targets:
        there = of_target(problem, errors, target)
        if there.any():
            turned = np.einsum("nma,nab->nmb", there, turns[:, : len(axes)])
            yield _slip("target", target, tuple(axes), "m"), turned
    moved, known = of_frame(problem, errors)
    if known:
        yield _slip("frame", "", known, "m"), moved
    pairs = zip(platform.freedoms, platform.units, strict=True)
    angles = tuple(name for name, unit in pairs if unit == "rad")
    if angles and all(errors[f"measured {name}"].any() for name in angles):
        W = np.stack([errors[f"measured {name}"] for name in angles], axis=2)
        yield _slip("orientation", ORIGIN, angles, "rad"), W
