"""Derivatives by central differences: the reference of every analytic one.

Functions take a move from the place where the derivative is wanted, in coordinates of the tangent
space there: an addition where values are numbers, a twist where they are poses. Differences at
two steps are combined to fourth order,

        D₂(h) = (f(h) − f(−h)) / 2h,        D₄ = (4 D₂(h) − D₂(2h)) / 3,

so D₄ − D₂(h) is what D₂ misses by the step, and D₄ misses far less. The tolerance follows from the
step: a tenth of that, and the rounding of f over h.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
STEP = 1e-4
#: Relative rounding of functions that are a few operations; of those that iterate it is more.
PRECISION = 1e-14


def _both_orders(function: Callable[[Array], Array], n: int, step: float) -> tuple[Array, Array]:
    """Return D₄ and D₂, shape (…, n) each."""
    fourth, second = [], []
    for h in step * np.eye(n):
        near, far = (function(k * h) - function(-k * h) for k in (1, 2))
        second.append(near / (2 * step))
        fourth.append((8 * near - far) / (12 * step))
    return np.stack(fourth, axis=-1), np.stack(second, axis=-1)


def differentiated(function: Callable[[Array], Array], n: int, step: float = STEP) -> Array:
    """Return the derivative of a function by moves of n coordinates at zero, shape (…, n)."""
    return _both_orders(function, n, step)[0]


def assert_derivative(
    derivative: Array,
    function: Callable[[Array], Array],
    step: float = STEP,
    precision: float = PRECISION,
    within: float = 1e-7,
) -> None:
    """Assert that a derivative is that of a function by moves from where it was taken.

    Args:
        derivative: Analytic derivative, shape (…, n).
        function: Takes a move, shape (n,), and returns values, shape (…).
        step: Step of the moves.
        precision: Relative rounding of the function.
        within: What the tolerance may be at most, relative to the largest derivative: a step or a
            function that would let anything pass fails.
    """
    reference, coarse = _both_orders(function, derivative.shape[-1], step)
    assert derivative.shape == reference.shape, (derivative.shape, reference.shape)
    size = np.abs(function(np.zeros(derivative.shape[-1]))).max()
    tolerance = np.abs(reference - coarse).max() / 10 + precision * max(1.0, size) / step
    largest = np.abs(reference).max()
    assert tolerance <= within * largest, f"differences are sure to {tolerance:.1e} only"
    np.testing.assert_allclose(derivative, reference, rtol=0.0, atol=tolerance)


def assert_observed(observation: Any, platform: Any, matrices: Array, values: Any) -> None:
    """Assert the derivatives of an observation's residuals, by poses and by what is outside.

    At poses of a platform, shape (N, 4, 4), and values of the external unknowns.
    """
    outside = observation.external
    _, by_pose, by_outside = observation.residuals(matrices, values)
    assert_derivative(
        by_outside, lambda step: observation.residuals(matrices, outside.moved(values, step))[0]
    )
    assert_derivative(
        by_pose,
        lambda twist: observation.residuals(
            platform.displaced(matrices, np.tile(twist, (len(matrices), 1))), values
        )[0],
    )
