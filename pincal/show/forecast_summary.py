"""What a forecast means, in sentences: rank, errors to expect, what a drift or a scale would do."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from pincal.design.drift import Drift
from pincal.design.forecast import Forecast
from pincal.design.instrument_scale import SCALE, ScaleEffect
from pincal.design.platform_error import PlatformError
from pincal.estimation.residuals.losses import CLEAR
from pincal.show.summary import weak_lines
from pincal.words.numbers import amount, listed
from pincal.words.wording import LISTED, group_in_words

_BEST = "the best that any calibration can reach; 'pincal calibrate' does"
_SAY_SCALE = (
    "no poses separate it from gains and lengths. Say how well the scale is known "
    "(systematic: {scale: …} in the setup), or measure lengths that are known"
)
_MATTERS = 0.5, 1.0  # standard errors: a bias by drift that adds an eighth to what noise leaves
_VERDICTS = (
    "that does not matter beside the noise",
    "that matters little; a drift twice as large would",
    "that matters: measure in turns (pincal select writes such an order), or again in parts",
)
_ALONE = "with --per-leg, which takes each leg alone by the poses of its set"


def forecast_lines(
    found: Forecast, error: PlatformError, planned: int, alone: PlatformError | None
) -> list[str]:
    """Return what a plan determines, and what error of the platform that gives.

    Arguments are those of ``forecast_table``.
    """
    turning = "rad" in found.mechanism.platform.units
    lines = [*_rank(found), *weak_lines(found.weak, found.mechanism)]
    best = f"; {_BEST}" if error.position < np.inf else ""
    lines.append(f"platform over the workspace: {_expected(error, turning)}{best}")
    if alone is not None:
        lines.append(f"{_ALONE}: {_expected(alone, turning)}")
    if found.poses < planned:
        lines.append(f"{planned - found.poses} of {planned} poses are out of reach")
    return lines


def drift_lines(drifts: Sequence[Drift]) -> list[str]:
    """Return what a drift over the run would do, of all legs together and of each leg alone."""
    heads = (
        "a drift of each measured quantity by one σ over the run, in this order",
        "the same with --per-leg",
    )
    lines = []
    for head, one in zip(heads, drifts, strict=False):
        if not np.isfinite(one.most):  # nothing is determined that could be off
            continue
        text = f"{head}: {one.worst} off by {one.most:.2g} standard errors"
        if np.isfinite(one.share):
            text += f", the platform by {one.share:.2g} of its expected error"
        much = max(one.most, float(np.nan_to_num(one.share)))
        text += f": {_VERDICTS[int(np.searchsorted(_MATTERS, much))]}"
        lines.append(text)
    return lines


def scale_line(one: ScaleEffect | None) -> list[str]:
    """Return what a wrong scale of the instrument would do.

    Nothing if no lengths are measured, or the platform is not determined in the first place.
    """
    if one is None or not np.isfinite(one.platform.position):
        return []
    off = amount(one.platform.position, "m")
    text = f"all lengths measured {1e6 * SCALE:.0f} µm/m too long: the platform off by {off}"
    if one.seen > CLEAR:
        return [f"{text}; residuals would show it, by {one.seen:.2g} standard deviations"]
    known = "that is taken into what is promised" if one.said else _SAY_SCALE
    return [f"{text}, and no residual shows it ({one.seen:.2g} standard deviations): {known}"]


def scale_answer(one: ScaleEffect | None) -> dict[str, Any] | None:
    """Return what a wrong scale of the instrument would do, as JSON."""
    if one is None:
        return None
    return {
        "relative": SCALE,
        "standard_deviations": one.seen,
        "platform": {"position": one.platform.position, "orientation": one.platform.orientation},
    }


def drift_answer(one: Drift) -> dict[str, Any]:
    """Return what a drift over the run would do, as JSON."""
    return {
        "parameter": one.worst if np.isfinite(one.most) else None,
        "standard_errors": one.most,
        "platform": {"position": one.platform.position, "orientation": one.platform.orientation},
        "platform_share": one.share,
    }


def _rank(found: Forecast) -> list[str]:
    """Return what is not determined: first what is no fault of the plan, then what is."""
    rank, count = found.rank, found.gauge.shape[1]
    start = f"rank {rank.rank} of {rank.n_params}"
    groups = [group_in_words(group) for group in rank.groups]
    lines = [start if count else f"{start}, condition {rank.condition:.3g}"]
    if count:
        which = f" ({groups[0]})" if len(groups) == 1 else ""
        lines = [
            f"{start}: {count} {'is a freedom' if count == 1 else 'are freedoms'} of frames, or of "
            f"redundant parameters{which}, which such measurements cannot determine. Of "
            "equal parameters those nearest to nominal are meant, and errors of the platform are "
            "what no motion of the base or platform frame explains"
        ]
    if found.lost.shape[1]:
        more = f"; and {len(groups) - LISTED} more (--json)" if len(groups) > LISTED else ""
        lines.append(f"not determined (—): {'; '.join(groups[:LISTED])}{more}")
    return lines


def _expected(error: PlatformError, turning: bool) -> str:
    """Return an error of the platform, and what of it is not determined."""
    sizes = {"position": (error.position, "m")}
    if turning:
        sizes["orientation"] = (error.orientation, "rad")
    known = [amount(value, unit) for value, unit in sizes.values() if value < np.inf]
    lost = [f"{name} not determined" for name, (value, _) in sizes.items() if not value < np.inf]
    return ", ".join([*([f"root mean square {listed(known)}"] if known else []), *lost])


def poses_line(accuracy: float, needed: float, alone: float | None) -> str:
    """Return how many poses an accuracy [m] takes, also with each leg alone if that is known."""
    many = f"{needed:,.0f} poses like these" if np.isfinite(needed) else "no number of poses"
    text = f"for {amount(accuracy, 'm', 6)}: {many}"
    text += "" if alone is None else f", {alone:,.0f} with --per-leg"
    if 1e5 < needed < np.inf:
        text += ", which nobody measures: that takes less noise, not more poses"
    return text
