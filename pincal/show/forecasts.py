"""What a plan promises, in sentences and for scripts: rank and platform error."""

from __future__ import annotations

import numpy as np

from pincal.design.forecast import Forecast
from pincal.design.platform_error import PlatformError
from pincal.show.answers import weak_lines
from pincal.words.numbers import amount, listed
from pincal.words.wording import groups_in_words

_BEST = "the best that any calibration can reach; 'pincal calibrate' does"


def forecast_lines(forecast: Forecast, error: PlatformError) -> list[str]:
    """Return what a plan determines, and what error of the platform over the workspace."""
    lines = [*_rank_lines(forecast), *weak_lines(forecast.weak, forecast.mechanism)]
    best = f"; {_BEST}" if error.position < np.inf else ""
    lines.append(f"platform over the workspace: {_expected(error)}{best}")
    return lines


def _rank_lines(forecast: Forecast) -> list[str]:
    """Return what is not determined: first what is no fault of the plan, then what is."""
    rank, count = forecast.rank, forecast.gauge.shape[1]
    start = f"rank {rank.rank} of {rank.n_params}"
    lines = [start if count else f"{start}, condition {rank.condition:.3g}"]
    if count:
        group_name = f" ({groups_in_words(rank.groups)})" if len(rank.groups) == 1 else ""
        lines = [
            f"{start}: {count} {'is a freedom' if count == 1 else 'are freedoms'} of frames, or of "
            f"redundant parameters{group_name}, which such measurements cannot determine. Of "
            "equal parameters those nearest to nominal are meant, and errors of the platform are "
            "what no motion of the base or platform frame explains"
        ]
    if forecast.lost.shape[1]:
        lines.append(f"not determined (—): {groups_in_words(rank.groups)}")
    return lines


def _expected(error: PlatformError) -> str:
    """Return an error of the platform, and what of it is not determined."""
    sizes = [("position", error.position, "m"), ("orientation", error.orientation, "rad")]
    sizes = sizes if "rad" in error.units else sizes[:1]
    known = [amount(size, unit) for _, size, unit in sizes if size < np.inf]
    lost = [f"{name} not determined" for name, size, _ in sizes if not size < np.inf]
    return ", ".join([*([f"root mean square {listed(known)}"] if known else []), *lost])


def poses_line(accuracy: float, needed: float) -> str:
    """Return how many poses an accuracy [m] takes."""
    poses = f"{needed:,.0f} poses like these" if np.isfinite(needed) else "no number of poses"
    text = f"for {amount(accuracy, 'm', 6)}: {poses}"
    if 1e5 < needed < np.inf:
        text += ", which nobody measures: that takes less noise, not more poses"
    return text
