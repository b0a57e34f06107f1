"""What a plan of measurements will tell, for people: standard errors, and what they mean."""

from __future__ import annotations

import numpy as np
from rich.console import Group

from pincal.design.forecast import Forecast
from pincal.design.platform_error import PlatformError
from pincal.show.tables import SHOWN, plain_table, titled, weak_in_words

_MANY = 1e5  # poses: more are not measured
_LISTED = 6  # groups of what moves together
_BEST = (
    "the best that any calibration can reach: --method latent does, --method together --poses all "
    "comes near where poses are measured in full"
)
_ALONE = "calibrate without options, which takes each leg alone by the poses of its set"


def forecast_table(
    found: Forecast, error: PlatformError, planned: int, alone: PlatformError | None = None
) -> Group:
    """Return what a plan will tell: standard errors by parameter and leg, and what they mean.

    Args:
        found: The forecast.
        error: Of the platform over the workspace.
        planned: Number of poses in the plan.
        alone: The same error with each leg calibrated alone, if that can be.
    """
    mechanism = found.mechanism
    table = plain_table()
    table.add_column("parameter")
    table.add_column("unit")
    for name in mechanism.leg_names:
        table.add_column(name, justify="right")
    errors: dict[str, dict[str, float]] = {}
    place = 0
    for leg in mechanism.legs:
        own = found.std[place : place + len(leg.parameters)]
        errors[leg.name] = dict(zip(leg.parameter_names, own.tolist(), strict=True))
        place += len(leg.parameters)
    units = {name: leg.units[name] for leg in mechanism.legs for name in leg.parameter_names}
    for name, unit in units.items():
        shown, factor = SHOWN[unit]
        cells = [errors[leg].get(name) for leg in mechanism.leg_names]
        table.add_row(
            name,
            shown,
            *("" if v is None else f"{factor * v:.4g}" if v < np.inf else "—" for v in cells),
        )
    measured = ", ".join(found.measured) or "nothing"
    lines = [*_rank(found), *weak_in_words(found.weak, mechanism)]
    turns = "rad" in mechanism.platform.units
    best = f"; {_BEST}" if error.position < np.inf else ""
    lines.append(f"platform over the workspace: {_platform(error, turns)}{best}")
    if alone is not None:
        lines.append(f"{_ALONE}: {_platform(alone, turns)}")
    if found.poses < planned:
        lines.append(f"{planned - found.poses} of {planned} poses are out of reach")
    title = (
        f"{mechanism.name}: standard errors (1 σ) from {found.poses} poses, measured: {measured}"
    )
    return titled(title, table, "\n".join(lines))


def _rank(found: Forecast) -> list[str]:
    """Return what is not told: first what is no fault of the plan, then what is."""
    rank, count = found.rank, found.gauge.shape[1]
    start = f"rank {rank.rank} of {rank.n_params}"
    groups = rank.sentences
    lines = [start if count else f"{start}, condition {rank.condition:.3g}"]
    if count:
        which = f" ({groups[0]})" if len(groups) == 1 else ""
        lines = [
            f"{start}: {count} {'is a freedom' if count == 1 else 'are freedoms'} of frames, or of "
            f"redundant parameters{which}, which such measurements cannot tell. Of "
            "equal parameters those nearest to nominal are meant, and errors of the platform are "
            "what no motion of the base or platform frame explains"
        ]
    if found.lost.shape[1]:
        more = f"; and {len(groups) - _LISTED} more (--json)" if len(groups) > _LISTED else ""
        lines.append(f"not determined (—): {'; '.join(groups[:_LISTED])}{more}")
    return lines


def poses_in_words(accuracy: float, needed: float, alone: float | None) -> str:
    """Return how many poses an accuracy [m] takes, also with each leg alone if that is known."""
    many = f"{needed:,.0f} poses like these" if np.isfinite(needed) else "no number of poses"
    text = f"for {1e3 * accuracy:g} mm: {many} with --method latent"
    text += "" if alone is None else f", {alone:,.0f} with each leg alone"
    if _MANY < needed < np.inf:
        text += ", which nobody measures: that takes less noise, not more poses"
    return text


def _platform(error: PlatformError, turns: bool) -> str:
    """Return an error of the platform in words."""
    parts = [("position", "mm", error.position)]
    parts += [("orientation", "mrad", error.orientation)] if turns else []
    told = [f"{1e3 * size:.3g} {unit}" for _, unit, size in parts if size < np.inf]
    open_ = [f"{name} not determined" for name, _, size in parts if not size < np.inf]
    return ", ".join([*([f"root mean square {' and '.join(told)}"] if told else []), *open_])
