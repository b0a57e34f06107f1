"""What is given as exact counts as a thousand times better than what is typical."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pincal.errors import MeasurementError

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
_EXACT = 1e-3  # of the typical standard deviation: that of what is given as exact


def least_sigmas(
    by_reading: Array,
    legs: Array,
    used: Mask,
    sigma: Array,
    seen: Mask,
    noisy: Mask,
    lengths: Mask,
    *,
    eased: bool,
) -> tuple[Array, Array]:
    """Return least standard deviations of the legs' rows [m], and those of observed quantities.

    Shapes (N, K) and (N, r).

    Args:
        by_reading: How far the legs' rows follow each reading, shape (N, n_readings), [m/rad] or
            [1].
        legs: Standard deviations of the rows by their readings' noise, shape (N, K), [m].
        used: Which of the rows are told, shape (N, K).
        sigma: Standard deviations of the observed quantities, shape (N, r), [m] and [rad].
        seen: Which of them take part, shape (N, r).
        noisy: Which of them were measured with noise, whether they take part or not, shape (N, r).
        lengths: Which of them are lengths, shape (r,).
        eased: Whether what is exact is as uncertain as the rest.

    Raises:
        MeasurementError: nothing has noise.
    """
    size = float(np.median(np.abs(by_reading)))
    own = [sigma[:, lengths][noisy[:, lengths]], size * sigma[:, ~lengths][noisy[:, ~lengths]]]
    noisy_legs = legs[used & (legs > 0.0)]
    known = next((v for v in (own[0], noisy_legs, own[1]) if len(v)), np.zeros(0))
    if not len(known):
        raise MeasurementError(
            "nothing that was measured has noise; give a standard deviation above zero for "
            "positions or readings (only their ratios matter to the estimate)"
        )
    typical = float(np.median(known))
    if eased:
        floor = np.where(lengths, typical, typical / size)
        return np.full(legs.shape, typical), np.where(seen, np.maximum(sigma, floor), 1.0)
    small = _EXACT * float(np.median(noisy_legs)) if len(noisy_legs) else 0.0
    least = _EXACT * typical
    exact = np.where(lengths, least, least / size)
    return (
        np.where(legs > 0.0, small, least),
        np.where(seen, np.where(sigma > 0.0, sigma, exact), 1.0),
    )
